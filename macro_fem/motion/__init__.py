"""A curtain in motion: implicit steps, each one convex program of the static solver with the mass term added."""
