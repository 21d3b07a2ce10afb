"""The matrix of a Newton step from the blocks of its pairs, and how its factor serves when a few pairs are stiffened.

A change of rank k in a matrix A with a factor needs k more solutions instead of another factor: by Woodbury's formula
(A + U C U^T)^-1 b = x - Y (C^-1 + U^T Y)^-1 U^T x with x = A^-1 b and Y = A^-1 U.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import nnls

from rve.common.types import Array
from rve.finite.equations import BLOCK, PAIR
from rve.finite.factor import Solve
from rve.finite.touching import Index, Touching

if TYPE_CHECKING:
    from rve.finite.iterate import Work


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
    def of(
        cls,
        touching: Touching,
        felt: NDArray[np.bool_],
        free: NDArray[np.bool_],
        tie: sparse.csr_matrix | None = None,
    ) -> Pattern:
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
            tie,
        )

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


def _expansion() -> tuple[Index, Array]:
    """Entries (100,) of a pair's block (7, 7), with signs, in its four blocks (5, 5) aa, ab, ba, bb of the matrix."""
    place = np.array([[0, 1, 2, 3, 4], [0, 1, 2, 5, 6]])
    sign = np.array([[-1.0, -1.0, -1.0, 1.0, 1.0], [1.0] * BLOCK])
    index = PAIR * place[:, None, :, None] + place[None, :, None, :]
    return index.ravel(), (sign[:, None, :, None] * sign[None, :, None, :]).ravel()


_EXPAND, _SIGN = _expansion()


class Factored:
    """A factor of the matrix of a step and how it serves for stiffer contacts and pairs.

    extra (m,), local (p,), damping, convex: what the matrix has on top of the exact one, see `iterate.Work`. Columns of
    U are told by names: i < m is the gradient of contact i, m + 7 p + k the coordinate k of pair p.
    """

    def __init__(self, solve: Solve, touching: Touching, G: Array, work: Work, n: int) -> None:
        self.solve, self.extra, self.local = solve, work.extra.copy(), work.local.copy()
        self.damping, self.convex = work.damping, work.convex.copy()
        self._touching, self._G, self._n = touching, G, n
        self._names: Index = np.zeros(0, dtype=np.intp)
        self._Y = np.zeros((BLOCK * n, 0))

    def is_of(self, work: Work) -> bool:
        """Whether the damping and convexity of a step are those of the matrix still."""
        return self.damping == work.damping and np.array_equal(self.convex, work.convex)

    def columns(self, names: Index) -> tuple[sparse.csc_matrix, Array]:
        """U (5 n, k), sparse, and Y = A^-1 U, each column of which is found once."""
        new = np.setdiff1d(names, self._names)
        if len(new):
            right = self._vectors(new).toarray().reshape(self._n, BLOCK, len(new))
            self._Y = np.concatenate([self._Y, self.solve(right).reshape(-1, len(new))], axis=1)
            self._names = np.concatenate([self._names, new])
        order = np.argsort(self._names)
        return self._vectors(names), self._Y[:, order[np.searchsorted(self._names[order], names)]]

    def _vectors(self, names: Index) -> sparse.csc_matrix:
        con, m = self._touching, len(self._G)
        is_contact = names < m
        component = np.where(is_contact, 0, names - m)
        pair = np.where(is_contact, con.minima.pair[np.where(is_contact, names, 0)], component // PAIR)
        v = np.where(is_contact[:, None], self._G[np.where(is_contact, names, 0)], np.eye(PAIR)[component % PAIR])
        a, b, along = BLOCK * con.a[pair, None], BLOCK * con.b[pair, None], np.arange(BLOCK)
        rows = np.concatenate([a + along, b + along], axis=1)
        values = np.concatenate([-v[:, :3], v[:, 3:5], v[:, :3], v[:, 5:]], axis=1)
        first = np.arange(len(names) + 1) * 2 * BLOCK
        return sparse.csc_matrix((values.ravel(), rows.ravel(), first), shape=(BLOCK * self._n, len(names)))

    def stiffened(self, names: Index, weight: Array) -> Solve:
        """A function that solves with A + U diag(weight) U^T, right-hand sides (n, 5); weight (k,) > 0."""
        if not len(names):
            return self.solve
        U, Y = self.columns(names)
        small = np.diag(1.0 / weight) + U.T @ Y

        def solved(push: Array) -> Array:
            x = self.solve(push)
            return x - (Y @ np.linalg.solve(small, U.T @ x.ravel())).reshape(x.shape)

        return solved


def forces_that_stop(S: Array, missing: Array) -> Array:
    """f >= 0 (k,) with S f >= missing and f (S f - missing) = 0, S (k, k) positive semidefinite: what keeps gaps open.

    They are the least squares with f >= 0 of a square root of S.
    """
    scale = 1.0 / np.sqrt(np.diag(S))
    values, vectors = np.linalg.eigh(0.5 * (S + S.T) * scale[:, None] * scale)
    root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))  # two contacts side by side are the same but for rounding
    try:
        force = nnls(root[:, None] * vectors.T, vectors.T @ (scale * missing) / root)[0]
    except RuntimeError:  # its limit of iterations, in cycles between such contacts: each force by itself is enough
        force = np.maximum(scale * missing, 0.0)
    return np.asarray(scale * force)
