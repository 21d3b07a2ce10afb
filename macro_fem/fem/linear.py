"""Solving K x = b for a symmetric positive definite stiffness matrix whose pattern stays while its numbers change.

Three stages, each paid only as often as needed: `analyze` (once per pattern: ordering, symbolic factor),
`LinearSolver.factorize` (once per matrix), and the function it returns (once per right-hand side).

Methods: "cholmod" (supernodal Cholesky; needs scikit-sparse) and "superlu" (comes with scipy); "mumps" and "multigrid"
over the processes of an MPI run (need petsc4py, see `macro_fem.fem.petsc`). "auto" takes MUMPS where several processes
run and petsc4py is installed, else the first of the others that is installed.

Example:
    >>> import skfem
    >>> from macro_fem.fem.assembly import stiffness
    >>> from macro_fem.fem.discretization import discretize
    >>> from macro_fem.fem.sparsity import sparsity
    >>> disc = discretize(skfem.MeshTri().refined(3), "P1")
    >>> pattern = sparsity(disc, d=2, free=disc.nodes[:, 0] > 0.0)
    >>> A = np.broadcast_to(np.eye(4).reshape(2, 2, 2, 2), (disc.n_points, 2, 2, 2, 2))
    >>> data = stiffness(disc, pattern, A)
    >>> x = analyze(pattern, "superlu").factorize(data)(np.ones(pattern.n))
    >>> bool(np.allclose(pattern.full(data) @ x, 1.0))
    True
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
from scipy import sparse

from macro_fem.fem import petsc
from macro_fem.fem.sparsity import Pattern
from rve.common.types import Array

METHODS = ("auto", "cholmod", "superlu", "mumps", "multigrid")
METIS_FROM = 300_000
"""Unknowns from which CHOLMOD orders by METIS, which takes longer to find and fills in less."""

Solve = Callable[[Array], Array]


class NotPositiveDefiniteError(ArithmeticError):
    """The matrix has a direction of no or negative stiffness: add regularisation or hold more nodes."""


@dataclass(frozen=True, eq=False)
class LinearSolver:
    """An analysed pattern: `factorize(data)` takes the lower triangle's data (nnz,) in the order of the pattern.

    It returns the function that gives x (n,) for b (n,), and raises NotPositiveDefiniteError.
    """

    method: str
    factorize: Callable[[Array], Solve]


def has_cholmod() -> bool:
    """Whether scikit-sparse is installed."""
    return find_spec("sksparse") is not None


def chosen(method: str) -> str:
    """The method that is used: that of "auto", else itself. ValueError for one that is unknown or not installed.

    >>> chosen("superlu")
    'superlu'
    """
    if method not in METHODS:
        raise ValueError(f"method = {method!r} is not one of {', '.join(METHODS)}")
    if method == "auto":
        is_spread = petsc.processes()[1] > 1 and find_spec("petsc4py") is not None
        return "mumps" if is_spread else "cholmod" if has_cholmod() else "superlu"
    if method == "cholmod" and not has_cholmod():
        raise ValueError("method = 'cholmod' needs scikit-sparse, which is not installed; take 'auto' or 'superlu'")
    if method in ("mumps", "multigrid") and find_spec("petsc4py") is None:
        raise ValueError(f"method = {method!r} needs petsc4py, which is not installed; take 'auto' or 'superlu'")
    return method


def analyze(pattern: Pattern, method: str = "auto") -> LinearSolver:
    """The solver for all matrices of a pattern. Raises ValueError for a method that is unknown or not installed."""
    method = chosen(method)
    if pattern.n == 0:
        return LinearSolver(method, lambda data: lambda b: np.zeros(0))
    made = {"cholmod": _cholmod, "superlu": _superlu, "mumps": petsc.mumps, "multigrid": petsc.multigrid}
    return LinearSolver(method, made[method](pattern))


def _cholmod(pattern: Pattern) -> Callable[[Array], Solve]:
    from sksparse import cholmod

    ones = pattern.lower(np.ones(pattern.nnz))
    ordering = "metis" if pattern.n >= METIS_FROM else "amd"
    symbolic = cholmod.analyze(ones, mode="supernodal", ordering_method=ordering)

    def factorize(data: Array) -> Solve:
        try:
            with _one_team():
                numeric: Solve = symbolic.cholesky(pattern.lower(data))
        except cholmod.CholmodNotPositiveDefiniteError as error:
            raise NotPositiveDefiniteError(f"CHOLMOD found a pivot that is not positive: {error}") from error
        if not np.isfinite(data.sum()):
            raise NotPositiveDefiniteError("the matrix holds an entry that is not finite")
        return numeric

    return factorize


@contextmanager
def _one_team() -> Iterator[None]:
    """Keep CHOLMOD's own OpenMP loops on the calling thread.

    CHOLMOD is compiled with four threads for its copy loops whatever OMP_NUM_THREADS says, and waking them for each
    supernode costs more than the factor: 0.20 s with, 0.09 s without for 80,000 unknowns on two cores. BLAS keeps its
    threads, they are not OpenMP's here.
    """
    try:
        gomp = ctypes.CDLL("libgomp.so.1", mode=getattr(os, "RTLD_NOLOAD", 0) | getattr(os, "RTLD_LAZY", 0))
    except OSError:  # another compiler's OpenMP, or none: nothing to keep
        yield
        return
    levels = gomp.omp_get_max_active_levels()
    gomp.omp_set_max_active_levels(0)
    try:
        yield
    finally:
        gomp.omp_set_max_active_levels(levels)


def _superlu(pattern: Pattern) -> Callable[[Array], Solve]:
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
