"""Solving K x = b for a symmetric positive definite stiffness matrix whose pattern stays while its numbers change.

Three stages, each paid only as often as needed: `analyze` (once per pattern: ordering, symbolic factor), the function
that it returns (once per matrix), and the function that this one returns (once per right-hand side). CHOLMOD
(supernodal Cholesky) factorizes where scikit-sparse is installed, else SuperLU, which comes with scipy.

Example:
    >>> import skfem
    >>> from macro_fem.fem.assembly import stiffness
    >>> from macro_fem.fem.discretization import discretize
    >>> from macro_fem.fem.sparsity import sparsity
    >>> disc = discretize(skfem.MeshTri().refined(3), "P1")
    >>> pattern = sparsity(disc, d=2, free=disc.nodes[:, 0] > 0.0)
    >>> A = np.broadcast_to(np.eye(4).reshape(2, 2, 2, 2), (disc.n_points, 2, 2, 2, 2))
    >>> data = stiffness(disc, pattern, A)
    >>> x = analyze(pattern)(data)(np.ones(pattern.n))
    >>> bool(np.allclose(pattern.full(data) @ x, 1.0))
    True
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from scipy import sparse

from macro_fem.fem.sparsity import SparsityPattern
from rve.common.types import Array

METIS_FROM = 300_000
"""Unknowns from which CHOLMOD orders by METIS, which takes longer to find and fills in less."""

Solve = Callable[[Array], Array]
"""x (n,) of b (n,)."""
Factorize = Callable[[Array], Solve]
"""Takes the lower triangle's data (nnz,) in the order of the pattern; raises NotPositiveDefiniteError."""


class NotPositiveDefiniteError(ArithmeticError):
    """The matrix has a direction of no or negative stiffness: add regularisation or hold more nodes."""


def linear_solver() -> str:
    """The library that factorizes: "cholmod" where scikit-sparse is installed, else "superlu"."""
    return "superlu" if find_spec("sksparse") is None else "cholmod"


def analyze(pattern: SparsityPattern) -> Factorize:
    """The function that factorizes the matrices of a pattern."""
    if pattern.n == 0:
        return lambda data: lambda b: np.zeros(0)
    return cholmod(pattern) if linear_solver() == "cholmod" else superlu(pattern)


def cholmod(pattern: SparsityPattern) -> Factorize:
    """CHOLMOD with its symbolic factor made once; needs scikit-sparse."""
    from sksparse import cholmod

    ones = pattern.lower(np.ones(pattern.nnz))
    ordering = "metis" if pattern.n >= METIS_FROM else "amd"
    symbolic = cholmod.analyze(ones, mode="supernodal", ordering_method=ordering)

    def factorize(data: Array) -> Solve:
        try:
            numeric: Solve = symbolic.cholesky(pattern.lower(data))
        except cholmod.CholmodNotPositiveDefiniteError as error:
            raise NotPositiveDefiniteError(f"CHOLMOD found a pivot that is not positive: {error}") from error
        if not np.isfinite(data.sum()):
            raise NotPositiveDefiniteError("the matrix holds an entry that is not finite")
        return numeric

    return factorize


def superlu(pattern: SparsityPattern) -> Factorize:
    """SuperLU without pivoting; its ordering is found once and the matrix is handed over in that order."""
    from scipy.sparse.linalg import splu

    options = {"SymmetricMode": True}
    # A matrix that is certainly definite: the graph's Laplacian plus one.
    count = np.diff(pattern.full(np.ones(pattern.nnz)).indptr)
    model = -np.ones(pattern.nnz)
    model[pattern.diagonal] = count + 1.0
    order = splu(pattern.full(model), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).perm_c
    numbered = pattern.full(np.arange(1.0, pattern.nnz + 1.0))
    place = np.empty(pattern.n, dtype=np.int64)
    place[order] = np.arange(pattern.n)
    # perm_c[j] is the new place of column j.
    moved = numbered[place][:, place].tocsc()
    moved.sort_indices()
    source = moved.data.astype(np.int64) - 1

    def factorize(data: Array) -> Solve:
        matrix = sparse.csc_matrix((data[source], moved.indices, moved.indptr), shape=moved.shape)
        if not np.all(np.isfinite(data)):
            raise NotPositiveDefiniteError("the matrix holds an entry that is not finite")
        try:
            lu = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options=options)
        except RuntimeError as error:  # SuperLU's only sign of an exactly singular matrix
            raise NotPositiveDefiniteError(f"SuperLU: {error}") from error
        if not np.all(lu.U.diagonal() > 0.0):
            raise NotPositiveDefiniteError("SuperLU found a pivot that is not positive")
        return lambda b: np.asarray(lu.solve(b[place])[order])

    return factorize
