"""Factors of the Newton matrix of a finite mesh, and whether it is positive definite: fronts, or SuperLU as a check."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from rve.common.errors import InputError
from rve.common.types import Array
from rve.finite.fronts import BLOCK, Blocks, Index, Plan, Solve, factored, plan

METHODS = ("nested", "superlu")


class Factorizer:
    """Factors of matrices of rings at points (n, d), whose pattern may change; None where one is not positive definite.

    The order of elimination is kept as long as the pairs are the same.
    """

    def __init__(self, points: Array, method: str = "nested") -> None:
        """InputError for a method that is none."""
        if method not in METHODS:
            raise InputError(f"method {method!r} is none of {', '.join(METHODS)}")
        self.method, self._points = method, points
        self._pairs: tuple[Index, Index] | None = None
        self._plan: Plan | None = None

    def __call__(self, blocks: Blocks) -> Solve | None:
        """A function that solves with the matrix, or None."""
        if self.method == "superlu":
            return _superlu(matrix(blocks))
        known = self._pairs
        if self._plan is None or known is None or not all(map(np.array_equal, known, (blocks.a, blocks.b))):
            self._pairs = blocks.a, blocks.b
            self._plan = plan(self._points, blocks.a, blocks.b)
        return factored(self._plan, blocks)


def matrix(blocks: Blocks) -> sparse.csc_matrix:
    """The symmetric matrix (5 n, 5 n) of its blocks."""
    n, a, b = len(blocks.own), blocks.a, blocks.b
    rows = np.concatenate([np.arange(n), a, b])
    columns = np.concatenate([np.arange(n), b, a])
    data = np.concatenate([blocks.own, blocks.off, blocks.off.transpose(0, 2, 1)])
    order = np.lexsort((columns, rows))
    indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=n))])
    whole = sparse.bsr_matrix((data[order], columns[order], indptr), shape=(BLOCK * n, BLOCK * n))
    return whole.tocsc()


def _superlu(whole: sparse.csc_matrix) -> Solve | None:
    try:
        factor = splu(
            whole, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True, "Equil": False}
        )
    except RuntimeError:
        return None
    # Without pivoting L U is L D L^T: the signs of the diagonal of U are those of the eigenvalues.
    pivoted = not np.array_equal(factor.perm_r, factor.perm_c)
    if pivoted or not (factor.U.diagonal() > 0.0).all():
        return None
    solve: Solve = factor.solve
    return solve
