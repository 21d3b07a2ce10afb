"""Locked states by the direct solver: equations, interior point, limits, largest work, compliance."""
