"""The rigid curtain as a cone program solved by clarabel: an independent oracle for `macro_fem.rigid`.

    minimise -l.z   subject to   ||F_q(z) L_i||_F <= c_i,   S_i = L_i L_i^T,   c_i^2 = 2 h_i + tr S_i

Second-order cones of dimension 1 + d rank S_i, at every point for the half-spaces the law starts with; those that the
answer violates are added and the program is solved again (cutting planes). clarabel's homogeneous embedding needs no
interior point and returns a certificate when there is no admissible state. P. J. Goulart, Y. Chen, arXiv 2405.12762.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from homogenize.law import Array, MembraneLaw
from macro_fem.cones import Cones, first_cones, law_cut, times_triple, with_cuts
from macro_fem.fem import SupportedFem
from macro_fem.interior import Iteration
from macro_fem.rigid import STATUSES, RigidResult
from rve.errors import require

FLAT = 1e-12
"""Eigenvalues of S below this (S has unit trace) count as zero: the half-space of a single direction."""


@dataclass(frozen=True)
class ConicOptions:
    """`gap` and `feasibility` of clarabel (relative), `violation` of the law that stops the cutting planes (strain)."""

    gap: float = 1e-10
    feasibility: float = 1e-10
    violation: float = 1e-9
    max_rounds: int = 30


def solve_conic(
    fem: SupportedFem, law: MembraneLaw, load: Array, size: float, options: ConicOptions = ConicOptions()
) -> RigidResult:
    """The rigid curtain under generalised forces `load` (n,) of a curtain of extent `size`; see `RigidResult`.

    InputError if clarabel is not installed.
    """
    total = float(np.abs(load).sum()) or 1.0
    task = _Task(fem, load, size, total, gradient_matrix(fem), fem.gradient(np.zeros(fem.n)).ravel())
    clarabel = _clarabel()
    cones = first_cones(law, len(fem.weight))
    history: list[Iteration] = []
    for _ in range(options.max_rounds):
        answer, lam = _solve(clarabel, task, cones, options)
        status = str(answer.status)
        if "Infeasible" in status or "Solved" not in status:
            break
        z = size * np.array(answer.x)
        S, h, g = law_cut(law, fem.gradient(z))
        new = np.flatnonzero(g < -options.violation)
        gap = float(answer.obj_val - answer.obj_val_dual)
        history.append(Iteration(gap, float(answer.r_dual), float(max(0.0, -g.min())), 1.0, 1.0, len(cones)))
        if not len(new):
            return _record("converged", task, cones, answer, lam, history)
        cones, _ = with_cuts(cones, new, S[new], h[new])
    verdict = "infeasible" if "PrimalInfeasible" in status else "iterations" if "Solved" in status else "stalled"
    return _record(verdict, task, cones, answer, np.zeros(len(cones)), history)


@dataclass(frozen=True, eq=False)
class _Task:
    """What stays the same in all rounds: B and the part F0 of the flat gradients that supports impose."""

    fem: SupportedFem
    load: Array
    size: float
    total: float
    B: sparse.csr_matrix
    F0: Array


def gradient_matrix(fem: SupportedFem) -> sparse.csr_matrix:
    """B (nq d 2, n): free unknowns to flat deformation gradients."""
    disc, d = fem.disc, fem.d
    n_points, n_local = disc.n_points, disc.dofs.shape[1]
    point = np.repeat(np.arange(n_points), n_local)
    scalar = [
        sparse.csr_matrix((disc.grad[:, :, j].ravel(), (point, disc.dofs.ravel())), shape=(n_points, disc.n_nodes))
        for j in range(2)
    ]
    rows, columns, values = [], [], []
    for a in range(d):
        for j in range(2):
            entry = scalar[j].tocoo()
            rows.append((entry.row * d + a) * 2 + j)
            columns.append(entry.col * d + a)
            values.append(entry.data)
    shape = (n_points * d * 2, disc.n_nodes * d)
    full = sparse.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
    if fem.tie is not None:
        return (full @ fem.tie).tocsr()
    return full[:, np.flatnonzero(fem.free)]


def square_roots(S: Array) -> tuple[Array, np.ndarray]:
    """L (n, 2, 2) with L L^T = S for triples S (n, 3), larger column first, and the ranks (n,) 1 or 2."""
    values, vectors = np.linalg.eigh(np.stack([S[:, [0, 1]], S[:, [1, 2]]], axis=1))
    values = values[:, ::-1]
    return vectors[:, :, ::-1] * np.sqrt(np.maximum(values, 0.0))[:, None, :], 1 + (values[:, 1] > FLAT)


def _clarabel() -> Any:
    require("clarabel", "cones", "[solver] kind = 'conic'", "use kind = 'rigid'")
    import clarabel

    return clarabel


def _solve(clarabel: Any, task: _Task, cones: Cones, options: ConicOptions) -> tuple[Any, Array]:
    """clarabel's answer in units of the size and the total load, and multipliers lam (nc,) in N/mm."""
    fem, B, size = task.fem, task.B, task.size
    d = fem.d
    L, rank = square_roots(cones.S)
    dimension = 1 + d * rank
    start = np.concatenate([[0], np.cumsum(dimension)])
    c = np.sqrt(2.0 * cones.size)
    rows, columns, values = [], [], []
    for k in range(2):
        use = np.flatnonzero(rank > k)
        for a in range(d):
            for j in range(2):
                rows.append(start[use] + 1 + k * d + a)
                columns.append((cones.point[use] * d + a) * 2 + j)
                values.append(L[use, j, k])
    shape = (int(start[-1]), B.shape[0])
    M = sparse.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
    b = M @ task.F0
    b[start[:-1]] = c
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = options.gap
    settings.tol_feas = options.feasibility
    A = (-size * (M @ B)).tocsc()
    kinds = [clarabel.SecondOrderConeT(int(n)) for n in dimension]
    answer = clarabel.DefaultSolver(
        sparse.csc_matrix((fem.n, fem.n)), -task.load / task.total, A, b, kinds, settings
    ).solve()
    if not len(answer.z):
        return answer, np.zeros(len(cones))
    y_head = task.total * size * np.array(answer.z)[start[:-1]] / fem.weight[cones.point]
    return answer, y_head / c


def _record(status: str, task: _Task, cones: Cones, answer: Any, lam: Array, history: list[Iteration]) -> RigidResult:
    fem = task.fem
    solved = status == "converged"
    z = task.size * np.array(answer.x) if solved else np.zeros(fem.n)
    S = cones.stress(lam)
    message = STATUSES[status].format(n=len(history), error=float(answer.obj_val - answer.obj_val_dual), excess=np.nan)
    if status == "infeasible":
        message = "the supports are farther apart than the mesh can stretch (clarabel found a certificate)"
    return RigidResult(
        status=status,
        message=message,
        z=z,
        lam=lam,
        y_tail=np.zeros((len(lam), 2 * fem.d)),
        cones=cones,
        P=times_triple(fem.gradient(z), S),
        S=S,
        primal=-float(task.load @ z) if solved else np.nan,
        dual=float(answer.obj_val_dual) * task.total * task.size if solved else np.nan,
        residual=float(answer.r_dual),
        iterations=int(answer.iterations),
        history=tuple(history),
    )
