"""Finite elements: assembly, linear solvers, supports as held components, the elastic membrane."""
