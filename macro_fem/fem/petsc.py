"""K x = b over the processes of an MPI run, by PETSc: MUMPS' Cholesky factor, or conjugate gradients with multigrid.

    mpiexec -n 2 python -m macro_fem run scene.toml --out out        # [solver] linear_solver = "mumps"

Every process runs the same program and holds the whole curtain; the factor, which is most of the memory of a large
curtain, and its work are distributed. Solutions are gathered to all, so that every process takes the same steps; the
first one writes the files.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from rve.common.types import Array

if TYPE_CHECKING:
    from macro_fem.fem.linear import Solve
    from macro_fem.fem.sparsity import Pattern

NEGATIVE_PIVOTS = 12
"""MUMPS' INFOG with the number of negative pivots."""
MULTIGRID_RTOL = 1e-10
"""Relative residual of conjugate gradients; `macro_fem.fem.supported` refines the rest away."""
MULTIGRID_STEPS = 300
"""Most steps of conjugate gradients. Matrices that need more, near the end of a rigid curtain's path, are factored."""


def petsc() -> Any:
    """The module PETSc of petsc4py, initialised."""
    import petsc4py

    petsc4py.init(sys.argv[:1])
    from petsc4py import PETSc

    return PETSc


def mumps(pattern: Pattern) -> Callable[[Array], Solve]:
    """Factorisation of the pattern's matrices over all processes."""
    return lambda data: _factored(_matrix(pattern, data))


def multigrid(pattern: Pattern) -> Callable[[Array], Solve]:
    """Conjugate gradients with algebraic multigrid; a matrix for which they fail is factorized."""

    def factorize(data: Array) -> Solve:
        A = _matrix(pattern, data)
        P = petsc()
        ksp = P.KSP().create(A.getComm())
        ksp.setOperators(A)
        ksp.setType("cg")
        ksp.getPC().setType("gamg")
        ksp.setTolerances(rtol=MULTIGRID_RTOL, max_it=MULTIGRID_STEPS)
        factor: list[Solve] = []

        def solve(b: Array) -> Array:
            if not factor:
                x = _solved(ksp, A, b)
                if ksp.getConvergedReason() > 0:
                    return x
                factor.append(_factored(A))
            return factor[0](b)

        return solve

    return factorize


def _matrix(pattern: Pattern, data: Array) -> Any:
    """The rows of this process of the whole matrix."""
    from macro_fem.fem.linear import NotPositiveDefiniteError

    if not np.isfinite(data.sum()):
        raise NotPositiveDefiniteError("the matrix holds an entry that is not finite")
    P = petsc()
    whole = pattern.full(data)  # symmetric: its columns are its rows
    layout = P.Vec().createMPI(pattern.n, comm=P.COMM_WORLD)
    first, last = layout.getOwnershipRange()
    part = slice(whole.indptr[first], whole.indptr[last])
    rows = (whole.indptr[first : last + 1] - whole.indptr[first]).astype(P.IntType)
    csr = (rows, whole.indices[part].astype(P.IntType), whole.data[part])
    size = ((last - first, pattern.n), (last - first, pattern.n))
    A = P.Mat().createAIJ(size, csr=csr, comm=P.COMM_WORLD)
    A.setOption(P.Mat.Option.SYMMETRIC, True)
    return A


def _factored(A: Any) -> Solve:
    from macro_fem.fem.linear import NotPositiveDefiniteError

    P = petsc()
    ksp = P.KSP().create(A.getComm())
    ksp.setOperators(A)
    ksp.setType("preonly")
    pc = ksp.getPC()
    pc.setType("cholesky")
    pc.setFactorSolverType("mumps")
    try:
        ksp.setUp()
        negative = pc.getFactorMatrix().getMumpsInfog(NEGATIVE_PIVOTS)
    except P.Error as error:
        raise NotPositiveDefiniteError(f"MUMPS: {' '.join(str(error).split())}") from error
    if negative or ksp.getConvergedReason() < 0:
        raise NotPositiveDefiniteError(f"MUMPS found {negative} pivots that are not positive, or a zero one")
    return lambda b: _solved(ksp, A, b)


def _solved(ksp: Any, A: Any, b: Array) -> Array:
    """x (n,) on every process."""
    P = petsc()
    x, right = A.createVecs()
    first, last = right.getOwnershipRange()
    right.setArray(b[first:last])
    ksp.solve(right, x)
    gather, everything = P.Scatter.toAll(x)
    gather.scatter(x, everything)
    return np.array(everything.getArray())


def processes() -> tuple[int, int]:
    """Rank of this process and number of processes, as MPI launchers tell them; (0, 1) outside MPI."""
    for rank, size in (("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"), ("PMI_RANK", "PMI_SIZE")):
        if rank in os.environ and size in os.environ:
            return int(os.environ[rank]), int(os.environ[size])
    return 0, 1


@contextmanager
def first_writes(out: Path) -> Iterator[Path]:
    """`out` on the first process; on the others a folder that is removed, and nothing is printed."""
    if processes()[0] == 0:
        yield out
        return
    with TemporaryDirectory() as folder, Path(os.devnull).open("w") as nowhere, redirect_stdout(nowhere):
        yield Path(folder) / "out"
