"""Vertices of polyhedra in strain space and the support function that they define."""

from __future__ import annotations

import numpy as np

from rve.common.errors import InputError
from rve.common.tensor import WEIGHT, dyad, trace
from rve.common.types import Array

DIRECTIONS = 180


def highest(S: Array, points: Array) -> Array:
    """max over points E_k (m, 3) of S:E_k for S (n, 3), (n,), in blocks that stay small."""
    weighted = np.ascontiguousarray((points * WEIGHT).T)
    return np.concatenate([(block @ weighted).max(axis=1) for block in np.array_split(S, len(S) // 4096 + 1)])


def outer_vertices(S: Array, h: Array) -> Array:
    """Vertices (m, 3) of {S_i:E <= h_i, v.(I + 2E) v >= 0}: S (n, 3), h (n,)."""
    from scipy.spatial import HalfspaceIntersection, QhullError

    angle = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    V = dyad(np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    normals = np.vstack([S * WEIGHT, -V * WEIGHT])
    limits = np.concatenate([h, 0.5 * trace(V)])
    inside = feasible_point(normals, limits)
    try:
        polyhedron = HalfspaceIntersection(np.column_stack([normals, -limits]), inside)
    except QhullError as error:
        raise InputError(f"the rows' half-spaces enclose no volume: {str(error).splitlines()[0]}") from error
    vertices = polyhedron.intersections
    if not np.isfinite(vertices).all():
        raise InputError("the rows' loads do not bound the strain under tension: add load directions to the table")
    return np.unique(np.round(vertices, 13), axis=0)


def feasible_point(normals: Array, limits: Array) -> Array:
    """Centre (3,) of the largest ball in {normals E <= limits}, as the half-space intersection needs it."""
    from scipy.optimize import linprog

    lengths = np.linalg.norm(normals, axis=1)
    answer = linprog(
        [0.0, 0.0, 0.0, -1.0],
        A_ub=np.column_stack([normals, lengths]),
        b_ub=limits,
        bounds=[(None, None)] * 3 + [(0.0, None)],
    )
    if answer.status == 3:
        raise InputError("the rows' loads do not bound the strain under tension: add load directions to the table")
    if answer.status != 0 or answer.x[3] <= 1e-9:
        raise InputError("the rows' half-spaces enclose no strain: the rows contradict each other")
    return np.asarray(answer.x[:3])
