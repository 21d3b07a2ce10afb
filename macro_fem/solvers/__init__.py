"""Solvers of the discrete curtain: cones, interior points, cutting planes, statuses."""
