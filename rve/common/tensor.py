"""Symmetric 2 x 2 tensors as triples (11, 12, 22) of tensor components on the last axis."""

import numpy as np

from rve.common.records import Array

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
    return np.asarray(A * np.array([1.0, -1.0, 1.0]))


def disc(S: Array) -> Array:
    """The load S (n, 3) of unit trace as a point of the unit disc, (n, 2): (S11 - S22, 2 S12); the rim is rank one."""
    return np.stack([S[:, 0] - S[:, 2], 2.0 * S[:, 1]], axis=1)


def from_disc(x: Array) -> Array:
    """Loads S (n, 3) of unit trace from points (n, 2) of the unit disc."""
    return np.stack([0.5 * (1.0 + x[:, 0]), 0.5 * x[:, 1], 0.5 * (1.0 - x[:, 0])], axis=1)
