"""Forces and Newton matrix of a finite mesh: exact, symmetric, sparse, one block per pair of rings.

The unknowns of a ring are its centre (3) and two tilts about the axes of its tangent frame, `BLOCK` = 5 numbers. A gap
depends on where ring b is as seen from ring a and on the tilts of both, d = x_b - x_a (3), theta_a (2), theta_b (2),
`PAIR` = 7 numbers, in which the blocks of pairs are kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from rve.common import Array, Flags, Index
from rve.common.factor import Solve
from rve.finite.task import BLOCK
from rve.finite.touching import Touching
from rve.finite.walls import wall_derivatives
from rve.geometry.circles import tangent_frame
from rve.geometry.contacts import distance_gradient, distance_hessian

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
    out[con.at_wall] = _of_walls(con, np.flatnonzero(con.at_wall))[0]
    return out


def _of_walls(con: Touching, rows: Index) -> tuple[Array, Array]:
    """First and second derivative of the gaps of contacts `rows`, which are with half-spaces or balls."""
    pair, x, normal = con.minima.pair[rows], con.placed.x, con.placed.normal
    ring, wall = con.a[pair], con.b[pair]
    radius = con.placed.radius[wall - con.placed.rings]
    return wall_derivatives(x[ring], normal[ring], x[wall], normal[wall], radius)


def spread(con: Touching, G: Array, force: Array) -> Array:
    """Generalised forces (n, 5) of contact forces (m,): sum of G^T force."""
    pair, p = con.minima.pair, len(con.key)
    return on_rings(con, np.stack([np.bincount(pair, G[:, k] * force, p) for k in range(PAIR)], axis=1))


def on_rings(con: Touching, w: Array) -> Array:
    """Generalised forces (n, 5) of those of pairs (p, 7)."""
    a, b, n = con.a, con.b, len(con.placed.x)
    ways = [np.bincount(b, w[:, k], n) - np.bincount(a, w[:, k], n) for k in range(3)]
    tilts = [np.bincount(a, w[:, 3 + k], n) + np.bincount(b, w[:, 5 + k], n) for k in range(2)]
    return np.stack(ways + tilts, axis=1)


def pair_vectors(con: Touching, q: Array) -> Array:
    """d, theta_a, theta_b (p, 7) of each pair, of q (n, 5)."""
    a, b = q[con.a], q[con.b]
    return np.concatenate([b[:, :3] - a[:, :3], a[:, 3:], b[:, 3:]], axis=1)


def times(con: Touching, pairs: Array, q: Array) -> Array:
    """The product (n, 5) of the matrix of blocks (p, 7, 7) with q (n, 5)."""
    return on_rings(con, np.matmul(pairs, pair_vectors(con, q)[:, :, None])[:, :, 0])


def blocks(con: Touching, G: Array, stiff: Array, force: Array, idle: Array) -> Array:
    """Blocks (p, 7, 7) of the pairs: sum of stiff G G^T - force d2(gap); contacts below `idle` (m,) have no
    curvature."""
    first = np.searchsorted(con.minima.pair, np.arange(len(con.key) + 1))
    some = np.flatnonzero(first[1:] > first[:-1])
    out = np.zeros((len(con.key), PAIR, PAIR))
    frame = np.stack(tangent_frame(con.placed.normal), axis=2)
    for part in range(0, len(some), _CHUNK):
        mine = some[part : part + _CHUNK]
        rows = np.arange(first[mine[0]], first[mine[-1] + 1])
        per = (stiff[rows, None] * G[rows])[:, :, None] * G[rows, None, :]
        curved = np.flatnonzero(force[rows] > idle[rows])
        per[curved] -= force[rows[curved], None, None] * _curvatures(con, rows[curved], frame)
        out[mine] = np.add.reduceat(per, first[mine] - rows[0], axis=0)
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


@dataclass(frozen=True, eq=False)
class Pattern:
    """Where the blocks of pairs go in the matrix of the free unknowns: made once for all factors of a step.

    felt: pairs with a block; free (k,): the free unknowns among 5 n; add: sums blocks of pairs to those of the matrix;
    take: the entries of these by column; indices, indptr: of the compressed columns; diagonal: its entries among them.
    tie (k, u): the free unknowns of the u that rings on bars leave, None without bars.
    """

    felt: Index
    free: Index
    add: sparse.csr_matrix
    take: Index
    indices: Index
    indptr: Index
    diagonal: Index
    tie: sparse.csr_matrix | None = None

    @classmethod
    def of(cls, con: Touching, felt: Flags, free: Flags, tie: sparse.csr_matrix | None = None) -> Pattern:
        """The pattern of the pairs that are `felt` (p,), of unknowns `free` (n, 5)."""
        n, rows = len(free), np.flatnonzero(felt)
        a, b = con.a[rows], con.b[rows]
        first, second = np.concatenate([np.arange(n), a, b]), np.concatenate([np.arange(n), b, a])
        order = np.lexsort((second, first))
        place = np.empty(len(order), dtype=np.intp)
        place[order] = np.arange(len(order))
        p = len(rows)
        to = np.stack([place[a], place[n : n + p], place[n + p :], place[b]], axis=1).ravel()
        add = sparse.csr_matrix((np.ones(4 * p), (to, np.arange(4 * p))), shape=(len(order), 4 * p))
        indptr = np.concatenate([[0], np.cumsum(np.bincount(first, minlength=n))])
        entries = np.arange(len(order) * BLOCK**2, dtype=float).reshape(-1, BLOCK, BLOCK)
        size = BLOCK * n
        whole = sparse.bsr_matrix((entries, second[order], indptr), shape=(size, size)).tocsr()
        mask, number = free.ravel(), (np.cumsum(free) - 1).astype(np.int32)
        column = np.repeat(np.arange(size), np.diff(whole.indptr))
        keep = mask[column] & mask[whole.indices]
        count = np.bincount(column[keep], minlength=size)[mask]
        indices, columns = number[whole.indices[keep]], number[column[keep]]
        # The matrix is symmetric: its rows are its columns.
        take, indptr = whole.data[keep].astype(np.intp), np.concatenate([[0], np.cumsum(count)]).astype(np.int32)
        return cls(rows, np.flatnonzero(mask), add, take, indices, indptr, np.flatnonzero(indices == columns), tie)

    def matrix(self, pairs: Array, soft: Array) -> sparse.csc_matrix:
        """The symmetric matrix (k, k) of blocks of pairs (p, 7, 7), `soft` (n, 5) on its diagonal; ties applied."""
        parts = pairs[self.felt].reshape(-1, PAIR * PAIR)[:, _EXPAND] * _SIGN
        data = (self.add @ parts.reshape(-1, BLOCK * BLOCK)).ravel()[self.take]
        data[self.diagonal] += soft.ravel()[self.free]
        k = len(self.free)
        full = sparse.csc_matrix((data, self.indices, self.indptr), shape=(k, k))
        if self.tie is None:
            return full
        tied = (self.tie.T @ full @ self.tie).tocsc()
        tied.sort_indices()
        return tied

    def rings(self, rows: Index) -> Index:
        """The rings that rows of the matrix belong to."""
        if self.tie is not None:
            rows = self.tie[:, rows].nonzero()[0]
        return np.asarray(self.free[rows] // BLOCK)

    def solver(self, solve: Solve) -> Solve:
        """A function of right-hand sides (n, 5, ...) that solves for the free unknowns; the others are 0."""

        def solved(push: Array) -> Array:
            flat = push.reshape(push.shape[0] * BLOCK, *push.shape[2:])
            out = np.zeros(flat.shape)
            right = flat[self.free]
            out[self.free] = solve(right) if self.tie is None else self.tie @ solve(self.tie.T @ right)
            return out.reshape(push.shape)

        return solved


# Entries (100,) of a pair's block (7, 7), with signs, in its four blocks (5, 5) aa, ab, ba, bb of the matrix.
_PLACE = np.array([[0, 1, 2, 3, 4], [0, 1, 2, 5, 6]])
_SIGNS = np.array([[-1.0, -1.0, -1.0, 1.0, 1.0], [1.0] * BLOCK])
_EXPAND = (PAIR * _PLACE[:, None, :, None] + _PLACE[None, :, None, :]).ravel()
_SIGN = (_SIGNS[:, None, :, None] * _SIGNS[None, :, None, :]).ravel()
