"""What the rows alone prove about the support function: a bound from inside and one from outside, no reference needed.

Inside: each row's strain is admissible, so h(S) >= max S:E_i. Outside: each row's half-space S_i:E <= h_i holds, and
C = I + 2E is positive semidefinite for every deformation, so h(S) <= max S:E over these. Half-spaces of singular C,
v.C v >= 0 for `DIRECTIONS` vectors v, keep the outer polyhedron bounded where the rows' loads do not reach.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homogenize.protocol import Array, InputError
from homogenize.rows import Rows, with_mirror
from homogenize.tensor import WEIGHT, dyad, trace

DIRECTIONS = 180


@dataclass(frozen=True, eq=False)
class Bounds:
    """Vertices of the inner hull and of the outer polyhedron, as strains: inner (k, 3), outer (m, 3)."""

    inner: Array
    outer: Array

    def lower(self, S: Array) -> Array:
        """Lower bound of h at S (n, 3), (n,)."""
        return highest(S, self.inner)

    def upper(self, S: Array) -> Array:
        """Upper bound of h at S (n, 3), (n,)."""
        return highest(S, self.outer)


def highest(S: Array, points: Array) -> Array:
    """max over points E_k (m, 3) of S:E_k for S (n, 3), (n,), in blocks that stay small."""
    weighted = np.ascontiguousarray((points * WEIGHT).T)
    return np.concatenate([(block @ weighted).max(axis=1) for block in np.array_split(S, len(S) // 4096 + 1)])


def bounds_of(rows: Rows) -> Bounds:
    """Inner and outer bound of the convex set behind the rows, mirror images included.

    InputError if the half-spaces do not bound the strain under tension (all loads along one direction, for instance).
    """
    both = with_mirror(rows)
    return Bounds(both.E, outer_vertices(both.S, both.h))


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
