"""Solvers of the discrete curtain: cones, interior points, cutting planes, Newton, clarabel, statuses."""
