"""Vectors of the plane in space: x to the right, y up, z towards the viewer."""

from __future__ import annotations

import numpy as np

from rve.common.types import Array


def in_space_of(plane: Array, d: int) -> Array:
    """Vectors (n, 2) as (n, d), where further components are 0; a copy."""
    return np.column_stack([plane, np.zeros((len(plane), d - plane.shape[1]))])


def padded(vectors: Array) -> Array:
    """Vectors (n, 2) or (n, 3) with a third component, 0 where there was none."""
    return in_space_of(vectors, 3)
