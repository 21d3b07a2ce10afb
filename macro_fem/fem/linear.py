"""Solving K x = b for a symmetric positive definite stiffness matrix whose pattern stays while its numbers change.

Three stages, so that each is paid only as often as needed: `analyze` (once per pattern: ordering, symbolic factor),
`LinearSolver.factorize` (once per Newton iteration), `Factor.solve` (once per right-hand side).

Methods: "cholmod" (supernodal Cholesky; needs scikit-sparse), "superlu" (comes with scipy), "multigrid" (conjugate
gradients preconditioned by smoothed aggregation; needs pyamg) and "jacobi" (conjugate gradients scaled by the diagonal
blocks of the nodes; for small or well-conditioned systems). "auto" takes the first factorization there is, and beyond
`LinearOptions.factor_limit` unknowns multigrid if there is pyamg.

Example:
    >>> import numpy as np, skfem
    >>> from macro_fem.fem.assembly import discretize, sparsity, stiffness
    >>> disc = discretize(skfem.MeshTri().refined(3), "P1")
    >>> pattern = sparsity(disc, d=2, free=disc.nodes[:, 0] > 0.0)
    >>> A = np.broadcast_to(np.eye(4).reshape(2, 2, 2, 2), (disc.n_points, 2, 2, 2, 2))
    >>> solver = analyze(pattern, LinearOptions(method="superlu"))
    >>> data = stiffness(disc, pattern, A)
    >>> solution = solver.factorize(data).solve(np.ones(pattern.n))
    >>> solution.status.name, bool(np.allclose(pattern.full(data) @ solution.x, 1.0))
    ('SOLVED', True)
"""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy import sparse

from macro_fem.fem.assembly import Pattern
from rve.common.types import Array

METHODS = ("auto", "cholmod", "superlu", "multigrid", "jacobi")


class LinearStatus(Enum):
    """How a linear solve ended, with what to try."""

    SOLVED = "the residual is below the tolerance"
    NOT_CONVERGED = (
        "conjugate gradients reached max_iterations before the residual fell below rtol; "
        "try method 'cholmod' or 'superlu', or more iterations"
    )


class NotPositiveDefiniteError(ArithmeticError):
    """The matrix has a direction of no or negative stiffness: add regularisation or hold more nodes."""


@dataclass(frozen=True)
class LinearOptions:
    """How to solve linear systems.

    method: one of `METHODS`. ordering: fill-reducing order of CHOLMOD, "amd" (quick to find), "metis" (less fill for
    large meshes) or "auto" (metis from 300,000 unknowns, where it pays for itself). rtol: residual of conjugate
    gradients relative to the right-hand side; factorizations ignore it. max_iterations: of conjugate gradients.
    factor_limit: number of unknowns beyond which "auto" no longer factorizes.
    """

    method: str = "auto"
    ordering: str = "auto"
    rtol: float = 1e-10
    max_iterations: int = 500
    factor_limit: int = 2_000_000

    def __post_init__(self) -> None:
        """Refuse values that no solver knows."""
        if self.method not in METHODS:
            raise ValueError(f"method = {self.method!r} is not one of {', '.join(METHODS)}")
        if self.ordering not in ("auto", "amd", "metis"):
            raise ValueError(f"ordering = {self.ordering!r} is not one of auto, amd, metis")
        if not (0.0 < self.rtol < 1.0 and self.max_iterations > 0):
            asked = f"rtol = {self.rtol}, max_iterations = {self.max_iterations}"
            raise ValueError(f"{asked}: rtol must lie between 0 and 1, max_iterations must be 1 or more")


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """x (n,), status, iterations of conjugate gradients (0 for a factor) and the relative residual |K x - b| / |b|."""

    x: Array
    status: LinearStatus
    iterations: int
    residual: float


@dataclass(frozen=True, eq=False)
class Factor:
    """A matrix ready to be solved with.

    method, entries of the factor or of all grids (None where the library does not say), and seconds spent on it.
    """

    method: str
    entries: int | None
    seconds: float
    solve: Callable[[Array], LinearSolution]


@dataclass(frozen=True, eq=False)
class LinearSolver:
    """An analysed pattern: `factorize(data)` takes the lower triangle's data (nnz,) in the order of the pattern.

    `factorize` raises NotPositiveDefiniteError where the method notices it (CHOLMOD and SuperLU do).
    """

    method: str
    seconds: float
    factorize: Callable[[Array], Factor]


def available() -> dict[str, bool]:
    """Which of the optional methods can run here."""
    return {"cholmod": find_spec("sksparse") is not None, "multigrid": find_spec("pyamg") is not None}


def analyze(
    pattern: Pattern, options: LinearOptions = LinearOptions(), near_kernel: Array | None = None
) -> LinearSolver:
    """The solver for all matrices of a pattern.

    near_kernel (n, m): motions that cost next to nothing, such as rigid ones, for "multigrid" (see `rigid_motions`);
    None takes one constant per component, which is poorer. Raises ValueError if the method asked for is not installed.
    """
    method = _choose(pattern.n, options)
    start = time.perf_counter()
    if pattern.n == 0:
        factorize: Callable[[Array], Factor] = _factorize_nothing
    elif method == "cholmod":
        factorize = _cholmod(pattern, options)
    elif method == "superlu":
        factorize = _superlu(pattern)
    elif method == "multigrid":
        factorize = _multigrid(pattern, options, near_kernel)
    else:
        factorize = _jacobi(pattern, options)
    return LinearSolver(method, time.perf_counter() - start, factorize)


def rigid_motions(pattern: Pattern, nodes: Array) -> Array:
    """Translations and the rotation in the plane, restricted to the free unknowns, (n, d + 1); nodes (n_nodes, 2)."""
    d = pattern.d
    modes = np.zeros((len(nodes), d, d + 1))
    for i in range(d):
        modes[:, i, i] = 1.0
    centred = nodes - nodes.mean(axis=0)
    scale = float(np.abs(centred).max()) or 1.0
    modes[:, 0, d] = -centred[:, 1] / scale
    modes[:, 1, d] = centred[:, 0] / scale
    return modes.reshape(-1, d + 1)[pattern.free]


def _choose(n: int, options: LinearOptions) -> str:
    has = available()
    method = options.method
    if method == "auto":
        if n > options.factor_limit and has["multigrid"]:
            return "multigrid"
        return "cholmod" if has["cholmod"] else "superlu"
    if not has.get(method, True):
        needs = {"cholmod": "scikit-sparse", "multigrid": "pyamg"}[method]
        raise ValueError(f"method = {method!r} needs {needs}, which is not installed; take 'auto' or 'superlu'")
    return method


def _factorize_nothing(data: Array) -> Factor:
    return Factor("empty", 0, 0.0, _solve_nothing)


def _solve_nothing(b: Array) -> LinearSolution:
    return LinearSolution(np.zeros(0), LinearStatus.SOLVED, 0, 0.0)


def _dot(a: Array, b: Array) -> float:
    """a.b without BLAS, which would wake its threads for ten thousand numbers.

    With OMP_NUM_THREADS unset that took 8 ms of both cores on 10,000 unknowns, a sum on one thread takes 0.01 ms; the
    direct solve it was to check takes 0.8 ms.
    """
    return float(np.einsum("i,i->", a, b))


def _length(a: Array) -> float:
    return float(np.sqrt(_dot(a, a)))


def _direct(solve: Callable[[Array], Array], multiply: Callable[[Array], Array]) -> Callable[[Array], LinearSolution]:
    """A direct solve that reports its residual."""

    def solve_with_residual(b: Array) -> LinearSolution:
        x = solve(b)
        scale = _length(b) or 1.0
        return LinearSolution(x, LinearStatus.SOLVED, 0, _length(multiply(x) - b) / scale)

    return solve_with_residual


def _cholmod(pattern: Pattern, options: LinearOptions) -> Callable[[Array], Factor]:
    from sksparse import cholmod

    ordering = options.ordering
    if ordering == "auto":
        ordering = "metis" if pattern.n >= 300_000 else "amd"
    ones = pattern.lower(np.ones(pattern.nnz))
    symbolic = cholmod.analyze(ones, mode="supernodal", ordering_method=ordering)

    def factorize(data: Array) -> Factor:
        start = time.perf_counter()
        matrix = pattern.lower(data)
        try:
            with _one_team():
                numeric = symbolic.cholesky(matrix)
        except cholmod.CholmodNotPositiveDefiniteError as error:
            raise NotPositiveDefiniteError(f"CHOLMOD found a pivot that is not positive: {error}") from error
        if not np.isfinite(data.sum()):
            raise NotPositiveDefiniteError("the matrix holds an entry that is not finite")
        seconds = time.perf_counter() - start
        return Factor("cholmod", None, seconds, _direct(numeric, lambda x: _symmetric_product(matrix, x)))

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


def _symmetric_product(lower: sparse.csc_matrix, x: Array) -> Array:
    """K x from the lower triangle of K, whose columns begin with the diagonal."""
    diagonal = lower.data[lower.indptr[:-1]]
    return np.asarray(lower @ x + lower.T @ x - diagonal * x)


def _superlu(pattern: Pattern) -> Callable[[Array], Factor]:
    """SuperLU without pivoting; its ordering is found once and the matrix is handed over in that order."""
    from scipy.sparse.linalg import splu

    options = {"SymmetricMode": True}
    # A matrix that is surely definite: the graph's Laplacian plus one.
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

    def factorize(data: Array) -> Factor:
        start = time.perf_counter()
        matrix = sparse.csc_matrix((data[source], moved.indices, moved.indptr), shape=moved.shape)
        if not np.all(np.isfinite(data)):
            raise NotPositiveDefiniteError("the matrix holds an entry that is not finite")
        try:
            lu = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options=options)
        except RuntimeError as error:  # SuperLU's only sign of an exactly singular matrix
            raise NotPositiveDefiniteError(f"SuperLU: {error}") from error
        if not np.all(lu.U.diagonal() > 0.0):
            raise NotPositiveDefiniteError("SuperLU found a pivot that is not positive")
        seconds = time.perf_counter() - start
        return Factor("superlu", lu.nnz, seconds, _direct(lambda b: lu.solve(b[place])[order], _product(pattern, data)))

    return factorize


def _product(pattern: Pattern, data: Array) -> Callable[[Array], Array]:
    lower = pattern.lower(data)
    return lambda x: _symmetric_product(lower, x)


def _multigrid(pattern: Pattern, options: LinearOptions, near_kernel: Array | None) -> Callable[[Array], Factor]:
    import pyamg

    kernel = near_kernel
    if kernel is None:
        kernel = np.zeros((pattern.n, pattern.d))
        kernel[np.arange(pattern.n), pattern.free % pattern.d] = 1.0

    def factorize(data: Array) -> Factor:
        start = time.perf_counter()
        matrix = pattern.full(data).tocsr()
        grids = pyamg.smoothed_aggregation_solver(matrix, B=kernel, max_coarse=200)
        entries = int(sum(level.A.nnz for level in grids.levels))
        seconds = time.perf_counter() - start
        precondition = grids.aspreconditioner(cycle="V").matvec
        return Factor("multigrid", entries, seconds, lambda b: conjugate_gradients(matrix, b, precondition, options))

    return factorize


def _jacobi(pattern: Pattern, options: LinearOptions) -> Callable[[Array], Factor]:
    def factorize(data: Array) -> Factor:
        start = time.perf_counter()
        matrix = pattern.full(data).tocsr()
        diagonal = data[pattern.diagonal]
        if not np.all(diagonal > 0.0):
            raise NotPositiveDefiniteError("a diagonal entry of the matrix is not positive")
        seconds = time.perf_counter() - start
        return Factor(
            "jacobi", matrix.nnz, seconds, lambda b: conjugate_gradients(matrix, b, lambda r: r / diagonal, options)
        )

    return factorize


def conjugate_gradients(
    matrix: Any, b: Array, precondition: Callable[[Array], Array], options: LinearOptions
) -> LinearSolution:
    """Preconditioned conjugate gradients that say whether they converged; the residual is recomputed at the end.

    Raises NotPositiveDefiniteError when a search direction has no positive stiffness.
    """
    scale = _length(b)
    x = np.zeros_like(b)
    if scale == 0.0:
        return LinearSolution(x, LinearStatus.SOLVED, 0, 0.0)
    r = b.copy()
    z = precondition(r)
    p = z.copy()
    rz = _dot(r, z)
    iterations = 0
    while _length(r) > options.rtol * scale and iterations < options.max_iterations:
        Kp = matrix @ p
        curvature = _dot(p, Kp)
        if not (curvature > 0.0 and rz > 0.0):
            raise NotPositiveDefiniteError("conjugate gradients met a direction without stiffness")
        step = rz / curvature
        x += step * p
        r -= step * Kp
        z = precondition(r)
        rz, last = _dot(r, z), rz
        p = z + (rz / last) * p
        iterations += 1
    residual = _length(matrix @ x - b) / scale
    # The recurrence drifts from the true residual by round-off; ten times the tolerance is still the answer asked for.
    status = LinearStatus.SOLVED if residual <= 10.0 * options.rtol else LinearStatus.NOT_CONVERGED
    return LinearSolution(x, status, iterations, residual)
