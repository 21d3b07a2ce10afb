"""Forces and Newton matrix of a finite mesh: exact, symmetric, sparse, one block per pair of rings.

The unknowns of a ring are its centre (3) and two tilts about the axes of its tangent frame, `BLOCK` = 5 numbers. A gap
depends on where ring b is as seen from ring a and on the tilts of both, d = x_b - x_a (3), theta_a (2), theta_b (2),
`PAIR` = 7 numbers, in which the blocks of pairs are kept.
"""

import numpy as np
from scipy import sparse

from rve.common import Array, Index
from rve.finite.task import BLOCK
from rve.finite.touching import Touching
from rve.finite.walls import wall_derivatives
from rve.geometry.contacts import distance_gradient, distance_hessian
from rve.geometry.ring_pair import tangent_frame

PAIR = 7
METRIC = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.5])
"""Weights (7,) of d, theta_a, theta_b squared: how far two rings move relative to each other, how far they turn."""
_CHUNK = 2048
"""Pairs whose blocks are made together: they stay in the cache of a processor."""


def gradients(con: Touching) -> Array:
    """Derivative (m, 7) of each gap with respect to d, theta_a, theta_b of its pair."""
    g, pair = distance_gradient(con.minima), con.minima.pair
    frame = np.stack(tangent_frame(con.placed.normal), axis=2)
    tilt_a = (g[:, 3:6, None] * frame[con.a[pair]]).sum(axis=1)
    out = np.concatenate([g[:, :3], tilt_a, (g[:, 6:9, None] * frame[con.b[pair]]).sum(axis=1)], axis=1)
    if con.placed.walls:
        out[con.at_wall] = _of_walls(con, np.flatnonzero(con.at_wall))[0]
    return out


def _of_walls(con: Touching, rows: Index) -> tuple[Array, Array]:
    """First and second derivative of the gaps of contacts `rows`, which are with half-spaces or balls."""
    pair, x, normal = con.minima.pair[rows], con.placed.x, con.placed.normal
    ring, wall = con.a[pair], con.b[pair]
    radius = con.placed.radius[wall - con.placed.rings]
    return wall_derivatives(x[ring], normal[ring], x[wall], normal[wall], radius)


def rows_of(con: Touching, pair: Index, v: Array) -> sparse.csr_matrix:
    """Derivatives (k r, 5 n) by all unknowns of what has the derivatives v (k, r, 7) by those of pairs `pair` (k,)."""
    by_a = np.concatenate([-v[..., :3], v[..., 3:5]], axis=2)
    by_b = np.concatenate([v[..., :3], v[..., 5:]], axis=2)
    values = np.stack([by_a, by_b], axis=1).reshape(-1, v.shape[1], BLOCK)
    columns = np.stack([con.a[pair], con.b[pair]], axis=1).ravel()
    shape = len(pair) * v.shape[1], BLOCK * len(con.placed.x)
    return sparse.bsr_matrix((values, columns, 2 * np.arange(len(pair) + 1)), shape=shape).tocsr()


def spread(con: Touching, G: Array, force: Array) -> Array:
    """Generalised forces (n, 5) of contact forces (m,): sum of G^T force."""
    return np.asarray(rows_of(con, con.minima.pair, G[:, None]).T @ force).reshape(-1, BLOCK)


def block_diagonal(pairs: Array, weight: Array) -> sparse.csr_matrix:
    """The matrix (k, k) of blocks (p, 7, 7) along its diagonal from the beginning, plus that of weights (k,)."""
    rows, end = np.arange(len(pairs) + 1), PAIR * len(pairs)
    out = sparse.bsr_matrix((pairs, rows[:-1], rows), shape=(end, end)).tocsr()
    out.resize(len(weight), len(weight))
    return out + sparse.diags(weight, format="csr")


def blocks(con: Touching, G: Array, stiff: Array, force: Array, idle: Array) -> Array:
    """Blocks (p, 7, 7) of the pairs: sum of stiff G G^T - force d2(gap); contacts below `idle` (m,) have no
    curvature."""
    first = np.searchsorted(con.minima.pair, np.arange(len(con.key) + 1))
    out = np.zeros((len(con.key), PAIR, PAIR))
    frame = np.stack(tangent_frame(con.placed.normal), axis=2)
    for part in range(0, len(con.key), _CHUNK):
        ends = first[part : part + _CHUNK + 1]
        rows = np.arange(ends[0], ends[-1])
        per = (stiff[rows, None] * G[rows])[:, :, None] * G[rows, None, :]
        curved = np.flatnonzero(force[rows] > idle[rows])
        per[curved] -= force[rows[curved], None, None] * _curvatures(con, rows[curved], frame)
        add = sparse.csr_matrix((np.ones(len(rows)), rows - ends[0], ends - ends[0]), shape=(len(ends) - 1, len(rows)))
        out[part : part + _CHUNK] = (add @ per.reshape(-1, PAIR**2)).reshape(-1, PAIR, PAIR)
    return out


def _curvatures(con: Touching, rows: Index, frame: Array) -> Array:
    """Second derivatives (k, 7, 7) of the gaps of contacts `rows` (k,); frame (n, 3, 2) of each ring."""
    pair, normal = con.minima.pair[rows], con.placed.normal
    a, b = con.a[pair], con.b[pair]
    H = distance_hessian(con.minima.take(rows), normal[a], normal[b], con.fixed[rows])
    B = np.zeros((len(rows), 9, PAIR))
    B[:, [0, 1, 2], [0, 1, 2]] = 1.0
    B[:, 3:6, 3:5], B[:, 6:9, 5:7] = frame[a], frame[b]
    second = np.matmul(B.transpose(0, 2, 1), np.matmul(H, B))
    if con.placed.walls:
        at_wall = b >= con.placed.rings
        second[at_wall] = _of_walls(con, rows[at_wall])[1]
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
