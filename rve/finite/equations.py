"""Forces and Newton matrix of a finite mesh: exact, symmetric, sparse, one block per pair of rings.

The unknowns of a ring are its centre (3) and two tilts about the axes of its tangent frame, `BLOCK` = 5 numbers. Held
ones, and z in the plane, keep their place in the matrix with a one on the diagonal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from rve.common.types import Array
from rve.finite.touching import Index, Placed, Touching
from rve.finite.walls import wall_derivatives
from rve.geometry.circles import distance_gradient, distance_hessian, tangent_frame

BLOCK = 5
_CHUNK = 2048
"""Pairs whose blocks are made together: they stay in the cache of a processor."""


def gradients(placed: Placed, touching: Touching) -> Array:
    """Derivative (m, 10) of each gap with respect to the unknowns of its two rings."""
    g = distance_gradient(touching.minima)
    Ea, Eb = _frames(placed, touching)
    out = np.empty((len(g), 2 * BLOCK))
    out[:, 0:3], out[:, 5:8] = -g[:, :3], g[:, :3]
    out[:, 3:5] = (g[:, 3:6, None] * Ea).sum(axis=1)
    out[:, 8:10] = (g[:, 6:9, None] * Eb).sum(axis=1)
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
    pair = touching.minima.pair
    out = np.zeros((n, BLOCK))
    for rings, part in ((touching.a[pair], G[:, :BLOCK]), (touching.b[pair], G[:, BLOCK:])):
        for k in range(BLOCK):
            out[:, k] += np.bincount(rings, part[:, k] * force, minlength=n)
    return out


def blocks(placed: Placed, touching: Touching, G: Array, stiff: Array, force: Array, idle: float) -> Array:
    """Blocks (p, 10, 10) of the pairs: sum of stiff G G^T - force d2(gap); contacts below `idle` have no curvature."""
    pair = touching.minima.pair
    first = np.searchsorted(pair, np.arange(len(touching.a) + 1))
    some = np.flatnonzero(first[1:] > first[:-1])
    out = np.zeros((len(touching.a), 10, 10))
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
    """Second derivatives (k, 10, 10) of the gaps of contacts `rows` (k,); frame (n, 3, 2) of each ring."""
    pair = touching.minima.pair[rows]
    a, b = touching.a[pair], touching.b[pair]
    H = distance_hessian(touching.minima.take(rows), placed.normal[a], placed.normal[b], 1.0, touching.fixed[rows])
    B = np.zeros((len(rows), 9, 10))
    for k in range(3):
        B[:, k, k], B[:, k, BLOCK + k] = -1.0, 1.0
    B[:, 3:6, 3:5], B[:, 6:9, 8:10] = frame[a], frame[b]
    second = np.matmul(B.transpose(0, 2, 1), np.matmul(H, B))
    if placed.walls:
        at_wall = touching.at_wall[rows]
        second[at_wall] = _of_walls(placed, touching, rows[at_wall])[1]
    return np.asarray(second)


def lacking(pairs: Array) -> Array:
    """What the blocks (p, 10, 10) lack to be positive semidefinite, each by itself."""
    felt = np.flatnonzero(pairs.any(axis=(1, 2)))
    values, vectors = np.linalg.eigh(pairs[felt])
    out = np.zeros_like(pairs)
    out[felt] = np.matmul(vectors * np.maximum(-values, 0.0)[:, None, :], vectors.transpose(0, 2, 1))
    return out


def metric(weight: Array) -> Array:
    """Blocks (p, 10, 10) that measure, by pair, how far two rings move relative to each other and how far they turn."""
    one = np.zeros((2 * BLOCK, 2 * BLOCK))
    for k in range(3):
        one[k, k] = one[BLOCK + k, BLOCK + k] = 1.0
        one[k, BLOCK + k] = one[BLOCK + k, k] = -1.0
    for k in (3, 4):
        one[k, k] = one[BLOCK + k, BLOCK + k] = 0.5
    return weight[:, None, None] * one


def pair_vectors(touching: Touching, q: Array) -> Array:
    """The unknowns (p, 10) of both rings of each pair, of q (n, 5)."""
    return np.concatenate([q[touching.a], q[touching.b]], axis=1)


def times(touching: Touching, pairs: Array, q: Array, n: int) -> Array:
    """The product (n, 5) of the matrix of blocks (p, 10, 10) with q (n, 5)."""
    w = np.matmul(pairs, pair_vectors(touching, q)[:, :, None])[:, :, 0]
    columns = [np.bincount(touching.a, w[:, k], minlength=n) for k in range(BLOCK)]
    others = [np.bincount(touching.b, w[:, BLOCK + k], minlength=n) for k in range(BLOCK)]
    return np.asarray(np.stack(columns, axis=1) + np.stack(others, axis=1))


def matrix(touching: Touching, pairs: Array, diagonal: Array, free: NDArray[np.bool_]) -> sparse.csc_matrix:
    """The symmetric matrix (5 n, 5 n) of blocks of pairs (p, 10, 10) and a diagonal (n, 5); free (n, 5)."""
    n = len(free)
    felt = np.flatnonzero(pairs.any(axis=(1, 2)))  # pairs without contact stay out of the pattern
    a, b, pairs = touching.a[felt], touching.b[felt], pairs[felt]
    own = np.zeros((n, BLOCK, BLOCK))
    for rings, part in ((a, pairs[:, :BLOCK, :BLOCK]), (b, pairs[:, BLOCK:, BLOCK:])):
        flat = part.reshape(len(part), BLOCK * BLOCK)
        for k in range(BLOCK * BLOCK):
            own.reshape(n, -1)[:, k] += np.bincount(rings, flat[:, k], minlength=n)
    own[:, np.arange(BLOCK), np.arange(BLOCK)] += diagonal
    rows = np.concatenate([np.arange(n), a, b])
    columns = np.concatenate([np.arange(n), b, a])
    off = pairs[:, :BLOCK, BLOCK:]
    data = np.concatenate([own, off, off.transpose(0, 2, 1)])
    data *= free[rows][:, :, None] & free[columns][:, None, :]
    data[:n][:, np.arange(BLOCK), np.arange(BLOCK)] += ~free
    order = np.lexsort((columns, rows))
    indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=n))])
    whole = sparse.bsr_matrix((data[order], columns[order], indptr), shape=(BLOCK * n, BLOCK * n))
    return whole.tocsc()
