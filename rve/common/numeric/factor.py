"""Factors of sparse symmetric matrices whose pattern stays while their numbers change.

The ordering is found once per pattern. CHOLMOD (supernodal Cholesky) factorizes where scikit-sparse is installed, else
SuperLU without pivoting, which comes with scipy.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from rve.common.records import Array, Index

METIS_FROM = 300_000
"""Unknowns from which CHOLMOD orders by METIS, which takes longer to find and fills in less."""

Solve = Callable[[Array], Array]
"""x (n, ...) of b (n, ...)."""


def linear_solver() -> str:
    """The library that factorizes: "cholmod" where scikit-sparse is installed, else "superlu"."""
    return "superlu" if find_spec("sksparse") is None else "cholmod"


class Factorizer:
    """Factors of symmetric matrices (n, n), the ordering of the last pattern kept.

    >>> solve = Factorizer()(sparse.csc_matrix([[2.0, 1.0], [1.0, 2.0]]))
    >>> solve(np.array([3.0, 3.0])).round(12), Factorizer("superlu")(sparse.csc_matrix([[1.0, 2.0], [2.0, 1.0]])).size
    (array([1., 1.]), 1)
    """

    def __init__(self, method: str | None = None) -> None:
        self._method = method or linear_solver()
        self._pattern: tuple[Array, Array] | None = None
        self._order: Any = None

    def __call__(self, matrix: sparse.csc_matrix) -> Solve | Index:
        """A function that solves with the matrix, or rows whose pivots are not positive (all rows where none is known).

        Such a pivot is negative curvature along its row and some of those before it.
        """
        is_known = self._pattern is not None and all(
            np.array_equal(old, new) for old, new in zip(self._pattern, (matrix.indptr, matrix.indices), strict=True)
        )
        if not is_known:
            self._pattern, self._order = (matrix.indptr.copy(), matrix.indices.copy()), None
        return self._cholmod(matrix) if self._method == "cholmod" else self._superlu(matrix)

    def _cholmod(self, matrix: sparse.csc_matrix) -> Solve | Index:
        from sksparse import cholmod

        if self._order is None:
            ordering = "metis" if matrix.shape[0] >= METIS_FROM else "amd"
            self._order = cholmod.analyze(matrix, mode="supernodal", ordering_method=ordering)
        try:
            factor: Solve = self._order.cholesky(matrix)
        except cholmod.CholmodNotPositiveDefiniteError as error:
            return np.asarray(self._order.P()[[error.column]])
        return factor

    def _superlu(self, matrix: sparse.csc_matrix) -> Solve | Index:
        spec, place = "MMD_AT_PLUS_A", np.arange(matrix.shape[0])
        if self._order is not None:
            spec, (order, place, source, indices, indptr) = "NATURAL", self._order
            matrix = sparse.csc_matrix((matrix.data[source], indices, indptr), shape=matrix.shape)
        try:
            lu = splu(matrix, permc_spec=spec, diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError:  # SuperLU's only sign of an exactly singular matrix
            return np.arange(len(place))
        if not np.array_equal(lu.perm_r, lu.perm_c):
            return np.arange(len(place))
        # Without pivoting L U is L D L^T: the signs of the diagonal of U are those of the eigenvalues.
        bad = ~(lu.U.diagonal() > 0.0)
        if bad.any():
            return np.asarray(place[bad[lu.perm_c]])
        if self._order is None:
            self._order = _ordered(matrix, lu.perm_c)
            solve: Solve = lu.solve
            return solve
        return lambda b: np.asarray(lu.solve(b[place])[order])


def _ordered(matrix: sparse.csc_matrix, order: Index) -> tuple[Index, ...]:
    """The new place of every row, the old row of every place, and of the matrix in that order: where its entries are
    in the data, indices and indptr. Entries need not be sorted."""
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    numbered = sparse.csc_matrix((np.arange(1.0, matrix.nnz + 1.0), matrix.indices, matrix.indptr), shape=matrix.shape)
    moved = numbered[place][:, place].tocsc()
    moved.sort_indices()
    return order, place, moved.data.astype(np.int64) - 1, moved.indices, moved.indptr
