"""Factorised matrices, and points in polygons."""
