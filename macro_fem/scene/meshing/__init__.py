"""Meshes of curtains: outlines, edges, places that need nodes, and mesh files."""
