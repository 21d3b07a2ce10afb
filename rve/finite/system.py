"""The matrix of a Newton step from the blocks of its pairs, and how its factor serves when a few pairs are stiffened.

A change of rank k in a matrix A with a factor needs k more solutions instead of another factor: by Woodbury's formula
(A + U C U^T)^-1 b = x - Y (C^-1 + U^T Y)^-1 U^T x with x = A^-1 b and Y = A^-1 U.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from rve.common.types import Array
from rve.finite.equations import BLOCK, PAIR, pair_vectors
from rve.finite.factor import Solve
from rve.finite.touching import Index, Touching


@dataclass(frozen=True, eq=False)
class Pattern:
    """Where the blocks of pairs go in the matrix of the free unknowns: made once for all factors of a step.

    felt: pairs with a block; free (k,): the free unknowns among 5 n; add: sums blocks of pairs to those of the matrix;
    take: the entries of these by column; indices, indptr: of the compressed columns; diagonal: its entries among them.
    """

    felt: Index
    free: Index
    add: sparse.csr_matrix
    take: Index
    indices: Index
    indptr: Index
    diagonal: Index

    @classmethod
    def of(cls, touching: Touching, felt: NDArray[np.bool_], free: NDArray[np.bool_]) -> Pattern:
        """The pattern of the pairs that are `felt` (p,), of unknowns `free` (n, 5)."""
        n, rows = len(free), np.flatnonzero(felt)
        a, b = touching.a[rows], touching.b[rows]
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
        return cls(
            rows,
            np.flatnonzero(mask),
            add,
            whole.data[keep].astype(np.intp),
            indices,
            np.concatenate([[0], np.cumsum(count)]).astype(np.int32),
            np.flatnonzero(indices == columns),
        )

    def matrix(self, pairs: Array, soft: float) -> sparse.csc_matrix:
        """The symmetric matrix (k, k) of blocks of pairs (p, 7, 7), `soft` added to its diagonal."""
        parts = pairs[self.felt].reshape(-1, PAIR * PAIR)[:, _EXPAND] * _SIGN
        data = (self.add @ parts.reshape(-1, BLOCK * BLOCK)).ravel()[self.take]
        data[self.diagonal] += soft
        k = len(self.free)
        return sparse.csc_matrix((data, self.indices, self.indptr), shape=(k, k))

    def solver(self, solve: Solve) -> Solve:
        """A function of right-hand sides (n, 5, ...) that solves for the free unknowns; the others are 0."""

        def solved(push: Array) -> Array:
            flat = push.reshape(push.shape[0] * BLOCK, *push.shape[2:])
            out = np.zeros(flat.shape)
            out[self.free] = solve(flat[self.free])
            return out.reshape(push.shape)

        return solved


def _expansion() -> tuple[Index, Array]:
    """Entries (100,) of a pair's block (7, 7), with signs, in its four blocks (5, 5) aa, ab, ba, bb of the matrix."""
    place = np.array([[0, 1, 2, 3, 4], [0, 1, 2, 5, 6]])
    sign = np.array([[-1.0, -1.0, -1.0, 1.0, 1.0], [1.0] * BLOCK])
    index = PAIR * place[:, None, :, None] + place[None, :, None, :]
    return index.ravel(), (sign[:, None, :, None] * sign[None, :, None, :]).ravel()


_EXPAND, _SIGN = _expansion()


def stiffened(solve: Solve, touching: Touching, pair: Index, vectors: Array, weight: Array, n: int) -> Solve:
    """A function that solves with the matrix of `solve` plus the sum of weight v v^T, right-hand sides (n, 5).

    v: vectors (k, 7) in the coordinates of the pairs `pair` (k,); weight (k,) > 0.
    """
    if not len(pair):
        return solve
    k, a, b = np.arange(len(pair)), touching.a[pair], touching.b[pair]
    U = np.zeros((n, BLOCK, len(pair)))
    U[a, :3, k], U[b, :3, k] = -vectors[:, :3], vectors[:, :3]
    U[a, 3:, k], U[b, 3:, k] = vectors[:, 3:5], vectors[:, 5:]
    Y = solve(U)
    flat = Y.reshape(-1, len(pair))
    small = np.diag(1.0 / weight) + U.reshape(-1, len(pair)).T @ flat

    def solved(push: Array) -> Array:
        x = solve(push)
        seen = (vectors * pair_vectors(touching, x)[pair]).sum(axis=1)
        return x - (flat @ np.linalg.solve(small, seen)).reshape(x.shape)

    return solved
