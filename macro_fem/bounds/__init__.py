"""Certified intervals: equilibrated stresses, upper and lower bound, adaptive meshes."""
