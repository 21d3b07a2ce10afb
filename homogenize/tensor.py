"""Symmetric 2 x 2 tensors as triples (11, 12, 22) of tensor components on the last axis."""

from __future__ import annotations

import numpy as np

from homogenize.protocol import Array

WEIGHT = np.array([1.0, 2.0, 1.0])
"""The shear component counts twice: A:B = sum(WEIGHT * A * B)."""

IDENTITY = np.array([1.0, 0.0, 1.0])


def double_dot(A: Array, B: Array) -> Array:
    """A:B of triples A (..., 3) and B (..., 3), (...)."""
    return A[..., 0] * B[..., 0] + 2.0 * A[..., 1] * B[..., 1] + A[..., 2] * B[..., 2]


def trace(A: Array) -> Array:
    """A11 + A22 of triples (..., 3), (...)."""
    return A[..., 0] + A[..., 2]


def dyad(v: Array) -> Array:
    """v v^T of plane vectors v (..., 2) as triples (..., 3)."""
    return np.stack([v[..., 0] ** 2, v[..., 0] * v[..., 1], v[..., 1] ** 2], axis=-1)


def eigenvalues(A: Array) -> tuple[Array, Array]:
    """Smaller and larger eigenvalue of triples (..., 3), each (...)."""
    mean = 0.5 * (A[..., 0] + A[..., 2])
    radius = np.hypot(0.5 * (A[..., 0] - A[..., 2]), A[..., 1])
    return mean - radius, mean + radius


def mirror(A: Array) -> Array:
    """The weave's mirror image of triples (..., 3): the shear component changes its sign."""
    return A * np.array([1.0, -1.0, 1.0])
