"""Membrane laws, one per file, and what they are made of: vertices, projection."""
