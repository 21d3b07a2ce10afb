"""Forces and Newton matrix of a finite mesh: exact, symmetric, sparse, one block per pair of rings.

The unknowns of a ring are its centre (3) and two tilts about the axes of its tangent frame, `BLOCK` = 5 numbers. A gap
depends on where ring b is as seen from ring a and on the tilts of both, d = x_b - x_a (3), theta_a (2), theta_b (2),
`PAIR` = 7 numbers, in which the blocks of pairs are kept.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rve.common.types import Array
from rve.finite.touching import Index, Placed, Touching
from rve.finite.walls import wall_derivatives
from rve.geometry.circles import tangent_frame
from rve.geometry.distance import distance_gradient, distance_hessian

BLOCK = 5
PAIR = 7
_CHUNK = 2048
"""Pairs whose blocks are made together: they stay in the cache of a processor."""
_TILT = 0.5
"""Weight of a tilt against that of a way in r1, both squared."""


def gradients(placed: Placed, touching: Touching) -> Array:
    """Derivative (m, 7) of each gap with respect to d, theta_a, theta_b of its pair."""
    g = distance_gradient(touching.minima)
    Ea, Eb = _frames(placed, touching)
    out = np.empty((len(g), PAIR))
    out[:, 0:3] = g[:, :3]
    out[:, 3:5] = (g[:, 3:6, None] * Ea).sum(axis=1)
    out[:, 5:7] = (g[:, 6:9, None] * Eb).sum(axis=1)
    if placed.walls:
        out[touching.at_wall] = _of_walls(placed, touching, touching.at_wall)[0]
    return out


def _of_walls(placed: Placed, touching: Touching, rows: Index | NDArray[np.bool_]) -> tuple[Array, Array]:
    """First and second derivative of the gaps of contacts `rows`, which are with half-spaces."""
    pair = touching.minima.pair[rows]
    ring, wall = touching.a[pair], touching.b[pair]
    return wall_derivatives(placed.x[ring], placed.normal[ring], placed.x[wall], placed.normal[wall])


def _frames(placed: Placed, touching: Touching) -> tuple[Array, Array]:
    """Tangent frames (m, 3, 2) of both rings of each contact."""
    frame = np.stack(tangent_frame(placed.normal), axis=2)
    pair = touching.minima.pair
    return frame[touching.a[pair]], frame[touching.b[pair]]


def spread(touching: Touching, G: Array, force: Array, n: int) -> Array:
    """Generalised forces (n, 5) of contact forces (m,): sum of G^T force."""
    pair, p = touching.minima.pair, len(touching.a)
    return on_rings(touching, np.stack([np.bincount(pair, G[:, k] * force, p) for k in range(PAIR)], axis=1), n)


def on_rings(touching: Touching, w: Array, n: int) -> Array:
    """Generalised forces (n, 5) of those of pairs (p, 7)."""
    a, b = touching.a, touching.b
    ways = [np.bincount(b, w[:, k], n) - np.bincount(a, w[:, k], n) for k in range(3)]
    tilts = [np.bincount(a, w[:, 3 + k], n) + np.bincount(b, w[:, 5 + k], n) for k in range(2)]
    return np.stack(ways + tilts, axis=1)


def pair_vectors(touching: Touching, q: Array) -> Array:
    """d, theta_a, theta_b (p, 7) of each pair, of q (n, 5)."""
    a, b = q[touching.a], q[touching.b]
    return np.concatenate([b[:, :3] - a[:, :3], a[:, 3:], b[:, 3:]], axis=1)


def times(touching: Touching, pairs: Array, q: Array, n: int) -> Array:
    """The product (n, 5) of the matrix of blocks (p, 7, 7) with q (n, 5)."""
    return on_rings(touching, np.matmul(pairs, pair_vectors(touching, q)[:, :, None])[:, :, 0], n)


def blocks(placed: Placed, touching: Touching, G: Array, stiff: Array, force: Array, idle: float) -> Array:
    """Blocks (p, 7, 7) of the pairs: sum of stiff G G^T - force d2(gap); contacts below `idle` have no curvature."""
    pair = touching.minima.pair
    first = np.searchsorted(pair, np.arange(len(touching.a) + 1))
    some = np.flatnonzero(first[1:] > first[:-1])
    out = np.zeros((len(touching.a), PAIR, PAIR))
    frame = np.stack(tangent_frame(placed.normal), axis=2)
    for part in range(0, len(some), _CHUNK):
        mine = some[part : part + _CHUNK]
        rows = np.arange(first[mine[0]], first[mine[-1] + 1])
        per = (stiff[rows, None] * G[rows])[:, :, None] * G[rows, None, :]
        curved = np.flatnonzero(force[rows] > idle)
        per[curved] -= force[rows[curved], None, None] * _curvatures(placed, touching, rows[curved], frame)
        out[mine] = np.add.reduceat(per, first[mine] - rows[0], axis=0)
    return out


def _curvatures(placed: Placed, touching: Touching, rows: Index, frame: Array) -> Array:
    """Second derivatives (k, 7, 7) of the gaps of contacts `rows` (k,); frame (n, 3, 2) of each ring."""
    pair = touching.minima.pair[rows]
    a, b = touching.a[pair], touching.b[pair]
    H = distance_hessian(touching.minima.take(rows), placed.normal[a], placed.normal[b], 1.0, touching.fixed[rows])
    B = np.zeros((len(rows), 9, PAIR))
    B[:, [0, 1, 2], [0, 1, 2]] = 1.0
    B[:, 3:6, 3:5], B[:, 6:9, 5:7] = frame[a], frame[b]
    second = np.matmul(B.transpose(0, 2, 1), np.matmul(H, B))
    if placed.walls:
        at_wall = touching.at_wall[rows]
        second[at_wall] = _of_walls(placed, touching, rows[at_wall])[1]
    return np.asarray(second)


def lacking(pairs: Array) -> Array:
    """What the blocks (p, 7, 7) lack to be positive semidefinite, each by itself.

    It is found, and least, in the unknowns of the two rings, where d has the length sqrt(2).
    """
    felt = np.flatnonzero(pairs.any(axis=(1, 2)))
    size = np.sqrt([2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0])
    values, vectors = np.linalg.eigh(pairs[felt] * (size[:, None] * size))
    vectors = vectors / size[:, None]
    out = np.zeros_like(pairs)
    out[felt] = np.matmul(vectors * np.maximum(-values, 0.0)[:, None, :], vectors.transpose(0, 2, 1))
    return out


def metric() -> Array:
    """Weights (7,) of d, theta_a, theta_b squared: how far two rings move relative to each other, how far they turn."""
    return np.array([1.0, 1.0, 1.0, _TILT, _TILT, _TILT, _TILT])


def add_metric(pairs: Array, weight: Array) -> None:
    """Add weight (p,) times the metric to blocks (p, 7, 7)."""
    for k, one in enumerate(metric()):
        pairs[:, k, k] += one * weight
