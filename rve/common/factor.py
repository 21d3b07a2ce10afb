"""Factors of sparse symmetric matrices: CHOLMOD where scikit-sparse is installed, else SuperLU, which scipy has."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from rve.common.records import Array, Index

Solve = Callable[[Array], Array]
"""x (n, ...) of b (n, ...)."""


def linear_solver() -> str:
    """The library that factorizes: "cholmod" where scikit-sparse is installed, else "superlu"."""
    return "superlu" if find_spec("sksparse") is None else "cholmod"


class Factorizer:
    """Factors of symmetric matrices (n, n); CHOLMOD keeps the ordering of the last pattern.

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
        return self._cholmod(matrix) if self._method == "cholmod" else _superlu(matrix)

    def _cholmod(self, matrix: sparse.csc_matrix) -> Solve | Index:
        from sksparse import cholmod

        pattern = matrix.indptr, matrix.indices
        if self._pattern is None or not all(map(np.array_equal, self._pattern, pattern)):
            # Unknowns from which CHOLMOD orders by METIS, which takes longer to find and fills in less.
            ordering = "metis" if matrix.shape[0] >= 300_000 else "amd"
            self._order = cholmod.analyze(matrix, mode="supernodal", ordering_method=ordering)
            self._pattern = matrix.indptr.copy(), matrix.indices.copy()
        try:
            factor: Solve = self._order.cholesky(matrix)
        except cholmod.CholmodNotPositiveDefiniteError as error:
            return np.asarray(self._order.P()[[error.column]])
        return factor


def _superlu(matrix: sparse.csc_matrix) -> Solve | Index:
    try:
        how = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "panel_size": 4}  # of 20: a fifth slower
        lu = splu(matrix, **how, options={"SymmetricMode": True})
    except RuntimeError:  # SuperLU's only sign of an exactly singular matrix
        return np.arange(matrix.shape[0])
    if not np.array_equal(lu.perm_r, lu.perm_c):
        return np.arange(matrix.shape[0])
    # Without pivoting L U is L D L^T: the signs of the diagonal of U are those of the eigenvalues.
    bad = ~(lu.U.diagonal() > 0.0)
    solve: Solve = lu.solve
    return np.flatnonzero(bad[lu.perm_c]) if bad.any() else solve
