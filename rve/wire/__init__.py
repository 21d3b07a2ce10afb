"""Mechanics of one ring: internal forces, flexibility between points, first yield and plastic collapse."""
