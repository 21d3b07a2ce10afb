"""The rigid curtain as a cone program solved by clarabel: an independent oracle for `macro_fem.solvers.central_path`.

    minimise -l.z   subject to   ||F_q(z) L_i||_F <= c_i,   S_i = L_i L_i^T,   c_i^2 = 2 h_i + tr S_i

The cones of `benchmarks.cone_form`, at every point for the half-spaces the law starts with; those that the
answer violates are added and the program is solved again (cutting planes). clarabel's homogeneous embedding needs no
interior point and returns a certificate when there is no admissible state. P. J. Goulart, Y. Chen, arXiv 2405.12762.
"""

from dataclasses import dataclass
from itertools import count

import clarabel
import numpy as np
from scipy import sparse

from benchmarks.cone_form import ConeForm, gradient_matrix
from homogenize import MembraneLaw
from macro_fem.curtain import CurtainProblem, CurtainSolution, make_solution, stabilising_tension
from macro_fem.fem import SupportedFem, internal_force
from macro_fem.solvers import (
    Cones,
    Evidence,
    PathResult,
    Reach,
    WallRows,
    Walls,
    all_cuts,
    first_cones,
    green_strain,
    least_slack,
    load_scale,
    with_cuts,
)
from macro_fem.solvers.cone_program import REACH
from macro_fem.solvers.status import FREE
from rve.common import Array, tell

ATTAINED = Evidence(gap=1e-5, unbalanced=1e-6, violation=1e-7)
"""Errors up to which an answer counts as one: clarabel often ends "almost solved", short of what is asked."""
ASKED, VIOLATION, ROUNDS = 1e-10, 1e-8, 30
"""Relative gap and residuals that clarabel is asked for; violation of the law (strain) that ends the cutting planes;
programs solved at most, each with the half-spaces that the one before violated."""


def curtain_by_clarabel(problem: CurtainProblem) -> CurtainSolution:
    """The rigid curtain of a problem whose supports can move farther apart, with status and numbers like our own."""
    load = problem.force + internal_force(problem.disc, stabilising_tension(problem) * problem.frame)
    found = solve_clarabel(problem.fem, problem.law, problem.fem.gather(load), problem.mesh.size, walls=problem.walls)
    return make_solution(problem, found, FREE, None)


def solve_clarabel(
    fem: SupportedFem, law: MembraneLaw, load: Array, size: float, walls: Walls | None = None
) -> PathResult:
    """The rigid curtain under generalised forces `load` (n,) of a curtain of extent `size`; see `PathResult`.

    `walls` are half-spaces on nodes, further linear rows of the program.
    """
    total = load_scale(load, fem.disc.weight)
    F0, rows = fem.gradient(np.zeros(fem.n)).ravel(), WallRows(fem, walls or Walls.none(fem.x_held.shape), size)
    task = _Task(fem, load, size, total, gradient_matrix(fem), F0, rows, rows.A)
    cones = first_cones(law.half_spaces(), len(fem.disc.weight))
    tell("clarabel, round 1")
    found = _solve(task, cones)
    for number in count(1):
        if "PrimalInfeasible" in found.status:
            stop = "blocked" if task.A.shape[0] else "infeasible"
            break
        cut = all_cuts(law, green_strain(fem.gradient(found.z)))
        new = np.flatnonzero(cut.violation > VIOLATION)
        if not found.status.endswith("Solved") or not len(new):
            stop = "closed" if found.status.endswith("Solved") else "stalled"
            break
        if number == ROUNDS:
            stop = "iterations"
            break
        cones, _ = with_cuts(cones, new, cut.take(new))
        tell(f"clarabel, round {number + 1}")
        found = _solve(task, cones)
    room = min(least_slack(law, green_strain(fem.gradient(found.z))), rows.slack(found.z).min(initial=np.inf))
    return PathResult(
        stop=stop,
        evidence=Evidence(found.gap, found.unbalanced, -float(room)),
        asked=ATTAINED,
        z=found.z,
        S=cones.stress(found.lam),
        psi=cones.sum(2.0 * cones.size * found.lam),
        cones=cones,
        P=found.P,
        primal=-float(load @ found.z),
        dual=found.dual,
        iterations=number,
        reach=Reach(0.0, 1.0) if stop in ("blocked", "infeasible") else FREE,
        wall_forces=rows.reactions(found.u),
    )


@dataclass(frozen=True, eq=False)
class _Task:
    """What stays the same in all rounds: B and the part F0 of the flat gradients that supports impose, half-spaces on
    nodes and their matrix A (m, n)."""

    fem: SupportedFem
    load: Array
    size: float
    total: float
    B: sparse.csr_matrix
    F0: Array
    rows: WallRows
    A: sparse.csr_matrix


@dataclass(frozen=True, eq=False)
class _Found:
    """clarabel's last iterate: z (n,), multipliers lam (nc,) and u (m,) in N/mm, stress P (nq, d, 2). Bounds and
    unbalanced forces are computed from these; `status` is what clarabel says."""

    z: Array
    lam: Array
    u: Array
    P: Array
    dual: float
    gap: float
    unbalanced: float
    status: str


def _solve(task: _Task, cones: Cones) -> _Found:
    """clarabel's answer to the program of these half-spaces, posed in units of the size and the total load."""
    fem, size = task.fem, task.size
    form = ConeForm(fem, cones, size, task.B)
    M, c, start, d = form.M, form.c, form.start, fem.d
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = ASKED
    settings.tol_feas = ASKED
    A = sparse.vstack([form.A, -size * task.A]).tocsc()
    zero = np.zeros(fem.n)
    b = np.concatenate([form.b, task.rows.slack(zero)])
    kinds = [clarabel.SecondOrderConeT(int(n)) for n in form.dimension]
    if task.A.shape[0]:
        kinds.append(clarabel.NonnegativeConeT(task.A.shape[0]))
    answer = clarabel.DefaultSolver(
        sparse.csc_matrix((fem.n, fem.n)), -task.load / task.total, A, b, kinds, settings
    ).solve()
    x, z = np.array(answer.x), np.array(answer.z)
    if "PrimalInfeasible" in str(answer.status) or not (np.isfinite(x).all() and np.isfinite(z).all()):
        x, z = np.zeros(fem.n), np.zeros(len(b))
    y, push = np.split(task.total * size * z, [int(start[-1])])
    w_head, w_tail = y[start[:-1]], np.where(np.isin(np.arange(len(y)), start[:-1]), 0.0, y)
    flat = -np.asarray(M.T @ w_tail)  # w P at the points
    weight = fem.disc.weight[:, None, None]
    P = flat.reshape(-1, d, 2) / weight
    z = size * x
    unbalanced = float(np.abs(task.load - fem.force(P) + task.A.T @ push).sum()) / task.total
    dual = -float(w_head @ c) + float(flat @ task.F0) - float(push @ task.rows.slack(zero))
    dual -= REACH * unbalanced * task.total * size
    return _Found(
        z=z,
        lam=w_head / fem.disc.weight[cones.point] / c,
        u=push / task.rows.v,
        P=P,
        dual=dual,
        gap=(-float(task.load @ z) - dual) / (task.total * size),
        unbalanced=unbalanced,
        status=str(answer.status),
    )
