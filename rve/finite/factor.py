"""Factors of sparse symmetric matrices, or where they are not positive definite: CHOLMOD if it is there, or SuperLU."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from rve.common.types import Array
from rve.finite.touching import Index

Solve = Callable[[Array], Array]


class Factorizer:
    """Factors of matrices whose pattern may change."""

    def __init__(self, method: str = "auto") -> None:
        there = find_spec("sksparse") is not None
        self.method = ("cholmod" if there else "superlu") if method == "auto" else method
        self._pattern: tuple[Array, Array] | None = None
        self._symbolic: Any = None

    def __call__(self, matrix: sparse.csc_matrix) -> Solve | Index:
        """A function that solves with the matrix, or rows whose pivots are not positive (all rows where none is known).

        Such a pivot is negative curvature along its row and some of those before it.
        """
        return self._cholmod(matrix) if self.method == "cholmod" else _superlu(matrix)

    def _cholmod(self, matrix: sparse.csc_matrix) -> Solve | Index:
        from sksparse import cholmod

        if self._pattern is None or not (
            np.array_equal(self._pattern[0], matrix.indptr) and np.array_equal(self._pattern[1], matrix.indices)
        ):
            self._pattern = matrix.indptr.copy(), matrix.indices.copy()
            self._symbolic = cholmod.analyze(matrix, mode="supernodal", ordering_method="amd")
        try:
            factor: Solve = self._symbolic.cholesky(matrix)
        except cholmod.CholmodNotPositiveDefiniteError as error:
            return np.asarray(self._symbolic.P()[[error.column]])
        return factor


def _superlu(matrix: sparse.csc_matrix) -> Solve | Index:
    try:
        factor = splu(
            matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True, "Equil": False}
        )
    except RuntimeError:
        return np.arange(matrix.shape[0])
    if not np.array_equal(factor.perm_r, factor.perm_c):
        return np.arange(matrix.shape[0])
    # Without pivoting L U is L D L^T: the signs of the diagonal of U are those of the eigenvalues.
    bad = ~(factor.U.diagonal() > 0.0)
    if bad.any():
        return np.flatnonzero(bad[factor.perm_c])
    solve: Solve = factor.solve
    return solve
