"""dolfinx 0.5 (Debian 12) with MUMPS, run by the system's Python."""

import dolfinx
import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx.fem.petsc import NonlinearProblem, assemble_vector
from dolfinx.nls.petsc import NewtonSolver
from mpi4py import MPI
from petsc4py import PETSc


def run(n):
    """Clamped unit square, N x N Q1, stretched to 1.5 in ten steps."""
    square = mesh.create_unit_square(MPI.COMM_WORLD, n, n, mesh.CellType.quadrilateral)
    V = fem.VectorFunctionSpace(square, ("CG", 1))
    u, v = fem.Function(V), ufl.TestFunction(V)
    F = ufl.Identity(2) + ufl.grad(u)
    C = F.T * F
    W = 0.5 * (ufl.tr(C) + 1 / ufl.det(C) - 3)
    form = ufl.derivative(W * ufl.Measure("dx", metadata={"quadrature_degree": 3}), u, v)
    pull = fem.Constant(square, PETSc.ScalarType(0.0))
    zero = PETSc.ScalarType(0.0)

    def dofs(side, i):
        edges = mesh.locate_entities_boundary(square, 1, lambda x: np.isclose(x[0], side))
        return fem.locate_dofs_topological(V.sub(i), 1, edges)

    supports = [fem.dirichletbc(zero, dofs(0.0, i), V.sub(i)) for i in range(2)]
    supports += [fem.dirichletbc(pull, dofs(1.0, 0), V.sub(0)), fem.dirichletbc(zero, dofs(1.0, 1), V.sub(1))]
    newton = NewtonSolver(MPI.COMM_WORLD, NonlinearProblem(form, u, supports))
    newton.rtol, newton.atol, newton.convergence_criterion = 1e-9, 1e-10, "residual"
    newton.krylov_solver.setType("preonly")
    newton.krylov_solver.getPC().setType("lu")
    newton.krylov_solver.getPC().setFactorSolverType("mumps")
    yield {}
    iterations, ok = 0, True
    for step in range(1, 11):
        pull.value = 0.05 * step
        count, converged = newton.solve(u)
        iterations, ok = iterations + count, ok and converged
    yield {}
    yield {
        "version": f"dolfinx {dolfinx.__version__}, PETSc {'.'.join(map(str, PETSc.Sys.getVersion()))}, MUMPS",
        "ok": bool(ok),
        "reaction": float(assemble_vector(fem.form(form)).array[dofs(1.0, 0)].sum()),
        "iterations": iterations,
        "factorizations": iterations,
        "note": "setup holds the compiled forms, from its cache after the first run",
    }
