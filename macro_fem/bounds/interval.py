"""A certified interval for the potential of the continuous curtain, where its width comes from, and finer meshes there.

Upper bound: a quadratic curtain. In a triangle its F is linear and |F L| convex, so that the largest value is at a
corner: with half-spaces at the corners, not at quadrature points, it obeys the law everywhere. Lower bound: the
equilibrated stress of `macro_fem.bounds.equilibrated`, for the whole law. With an outer law below and an inner one
above, the interval holds for every law between. Supports and loads at points are spread over the edges around the
point: a place at a distance s from it stays within kappa s, kappa the largest stretch along the edge, so that the
integral of kappa |r| s over the spread reaction r is subtracted. The width of the interval is the sum over the
triangles of  integral of psi*(P) - P:F >= 0  plus what points cost.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import skfem
from scipy.spatial import cKDTree

from homogenize import MembraneLaw
from macro_fem.bounds.equilibrated import DualProblem, at_dual_nodes, dual_problem
from macro_fem.curtain import (
    CurtainProblem,
    CurtainSolution,
    flow_of,
    gathered_start,
    make_problem,
    slackened,
    solve_problem,
)
from macro_fem.fem.assembly import internal_force
from macro_fem.fem.discretization import MEETS, reference_shapes
from macro_fem.fem.hung_law import largest_stretch
from macro_fem.scene.meshing.mesh import CurtainMesh, refine
from macro_fem.scene.scene import Scene
from macro_fem.solvers.central_path import solve_path
from macro_fem.solvers.cones import take_from
from macro_fem.solvers.path import PathOptions, PathResult, Terms
from rve.common import Array, part_of

PATH_OF_BOUNDS = PathOptions(gap=2e-5, violation=5e-3, drawn=False)
"""How the dual program is solved. Larger gaps and half-spaces left out weaken the bound."""
BULK = 0.6
"""Share of the gap whose triangles are refined in one go (W. Doerfler, doi 10.1137/0733054)."""


@dataclass(frozen=True, eq=False)
class CurtainBounds:
    """The curtain on one mesh, and upper and lower bounds of the potential of the continuous one, N mm; `status` of the
    dual solver.

    error (n_cells,): share of every triangle in upper - lower, N mm; `points`: the part of it that is due to supports
    and loads at points, with the solvers' own gaps; 0 without any. law_part: how much of upper - lower the distance
    between inner and outer law may make, N mm; None where both bounds are those of one law.
    """

    solution: CurtainSolution
    upper: float
    lower: float
    error: Array
    points: float
    status: str
    wall_s: float
    law_part: float | None = None

    @property
    def gap(self) -> float:
        """upper - lower, N mm."""
        return self.upper - self.lower


@dataclass(frozen=True, eq=False)
class Loads:
    """Stresses of a curtain as directions S (n, 3) of unit trace, in the curtain's frame, and what they weigh.

    weight (n,): reference area times trace, N mm; width (n,): h of the outer law minus h of the inner one.
    """

    S: Array
    weight: Array
    width: Array

    @property
    def law_part(self) -> float:
        """The sum of weight times width, N mm: the potentials under both laws differ by no more."""
        return float((self.weight * self.width).sum())


def loads_of(weight: Array, S: Array, inner: MembraneLaw, outer: MembraneLaw) -> Loads:
    """The stresses S (n, 3) at points of these reference areas (n,) under two laws, without points that have none.

    With multipliers S of the inner law, potential(inner) - potential(outer) <= sum of weight width (weak duality).
    """
    size = S[:, 0] + S[:, 2]
    there = size > 0.0
    direction = S[there] / size[there, None]
    width = np.maximum(outer.support(direction) - inner.support(direction), 0.0)
    return Loads(direction, weight[there] * size[there], width)


def bound(solution: CurtainSolution, outer: MembraneLaw | None = None) -> CurtainBounds:
    """Bounds of the potential around an admissible solution in P1, or in P2 with the law at the corners of triangles.

    `outer`: a law, in the frame of the weave, that contains the solution's; the lower bound is then for it. InputError
    for a piece of the curtain that hangs on a single corner of another.
    """
    _check_points(solution.problem)
    begin, upper, inner, area = time.perf_counter(), solution.primal, solution.problem.law, solution.problem.disc.weight
    tiles = 3 // solution.problem.disc.n_quad
    gradients, work = np.tile(solution.F, (tiles, 1, 1)), 0.0 if solution.tau is None else np.tile(solution.tau, tiles)
    flat = linear_part(solution, outer)
    problem = flat.problem
    # How far the start is drawn from the P1 curtain, where steps get stuck, to its slack start; farther: more steps.
    dual, result = _solve(flat, 0.05)
    if result.stop == "infeasible":
        dual, result = _solve(flat, 1.0)
    held = dual.fem.positions(np.zeros(dual.fem.n))
    value = result.dual - float((dual.force * held).sum())
    tether_cost, moment = _tether_cost(dual, problem.last_law, result, held)
    lower = value - tether_cost - float(dual.load_cost.sum()) + float((problem.force * problem.fem.reference).sum())
    pushed = result.wall_forces * dual.walls.gap(at_dual_nodes(flat.x, dual.mesh))  # pushes times distances
    error = error_map(gradients, dual, replace(result, psi=result.psi + work))
    error += pushed.reshape(-1, dual.fem.disc.n_cells).sum(axis=0)
    points = upper - lower - float(error.sum())
    loads = None if outer is None else loads_of(area, solution.S, inner, problem.law)
    return CurtainBounds(
        solution=solution,
        upper=upper,
        lower=lower if result.status == "converged" else float("nan"),
        error=error + _near_points(dual, moment, points),
        points=points if len(dual.facet) or dual.load_cost.any() else 0.0,
        status=result.status,
        wall_s=time.perf_counter() - begin,
        law_part=None if loads is None else min(loads.law_part, upper - lower),
    )


def _solve(solution: CurtainSolution, inward: float) -> tuple[DualProblem, PathResult]:
    """The hybrid problem of a P1 solution and its answer, edges around points held where the P1 curtain is, drawn
    `inward`. The P1 part of a P2 curtain may leave the law by more than that where points are close.
    """
    problem, x = solution.problem, at_dual_nodes(slackened(solution, inward), solution.problem.mesh)
    dual = dual_problem(problem, x)
    path = replace(PATH_OF_BOUNDS, max_iterations=problem.scene.solver.max_iterations, cones=solution.cones)
    law, terms = problem.law, Terms(walls=dual.walls)
    if problem.scene.solver.is_plastic:
        law, terms = problem.plastic_law, replace(terms, flow=flow_of(problem, dual.fem.disc))
        path = replace(path, gap=0.1 * path.gap)  # what the dual program leaves is part of the interval of the work
        x = at_dual_nodes(gathered_start(problem), dual.mesh)
    load, start = dual.fem.gather(dual.force), dual.fem.unknowns(x)
    return dual, solve_path(dual.fem, law, load, start, problem.mesh.size, path, terms)


def linear_part(solution: CurtainSolution, outer: MembraneLaw | None) -> CurtainSolution:
    """The solution as one in P1, under `outer` where given, with its half-spaces at the three corners of every
    triangle.
    """
    problem, cones = solution.problem, solution.cones
    if cones is not None and problem.disc.n_quad == 1:
        cones = take_from(cones, np.tile(np.arange(len(cones.first)), 3))
    flat = replace(problem.scene, mesh=replace(problem.scene.mesh, element="P1"))
    if outer is not None or problem.disc.element != "P1":
        wind = None if problem.wind is None else problem.disc.cell_mean(problem.wind)
        problem = make_problem(flat, problem.law.own if outer is None else outer, problem.mesh, problem.factor)
        problem = replace(problem, wind=wind)
    if outer is not None and cones is not None:
        cones = replace(cones, h=problem.law.support(cones.S))
    return replace(solution, problem=problem, x=solution.x[: problem.disc.n_nodes], cones=cones)


def _near_points(dual: DualProblem, moment: Array, points: float) -> Array:
    """What points cost, laid on the triangles (n_cells,) beside their edges in proportion to the moments there."""
    share, cost = np.zeros(dual.fem.disc.n_cells), dual.load_cost.copy()
    np.add.at(cost, dual.facet, moment)
    for side in dual.mesh.mesh.f2t:
        np.add.at(share, side[side >= 0], cost[side >= 0])
    return points * share / share.sum() if share.sum() > 0.0 else share


def _tether_cost(dual: DualProblem, law: MembraneLaw, result: PathResult, held: Array) -> tuple[float, Array]:
    """What the lower bound loses because reactions r of points act along edges, N mm, and each edge's moment (k,).

    The program took the work r.x at the positions of the edges; it is at least that at the point, less the integral of
    kappa |r| s. With end values r_a (at the point) and r_b of r, that of |r| s is at most
    length^2 (|r_a| / 6 + |r_b| / 3).
    """
    facet, near, edges = dual.facet, dual.near, dual.mesh.sides[dual.facet]
    balance = internal_force(dual.fem.disc, result.P) - dual.force
    node = np.stack([2 * facet + near, 2 * facet + 1 - near])
    is_held = np.isfinite(dual.centre)
    R = np.where(is_held, balance[node], 0.0)  # (2, k, d): nodal reactions at the near and the far end
    moved = (R * np.where(is_held, held[node] - dual.centre, 0.0)).sum()
    length = np.hypot(*edges.T)
    r = (4.0 * R - 2.0 * R[::-1]) / length[:, None]
    size = np.linalg.norm(r, axis=-1)
    moment = largest_stretch(law, edges) * length**2 * (size[0] / 6.0 + size[1] / 3.0)
    return float(moved + moment.sum()), moment


def error_map(F: Array, dual: DualProblem, result: PathResult) -> Array:
    """Integral of psi*(P) - P:F over every triangle (n_cells,), psi* from above by `result.psi`.

    F (3 n_cells, d, 2) is that of the admissible curtain at the corners of triangles. P and F are linear, so that the
    integral of P:F is A/12 (sum P_i:F_i + sum P_i : sum F_i) over the corners i of a triangle of area A.
    """
    n = dual.fem.disc.n_cells
    weight = dual.fem.disc.weight.reshape(3, n)
    P, F = result.P.reshape(3, n, -1), F.reshape(3, n, -1)
    work = 0.25 * ((P * F).sum(axis=(0, 2)) + (P.sum(axis=0) * F.sum(axis=0)).sum(axis=1))
    return np.asarray((weight * result.psi.reshape(3, n)).sum(axis=0) - weight[0] * work)


def levels(first: CurtainSolution, outer: MembraneLaw | None = None) -> Iterator[CurtainBounds]:
    """The curtain of an admissible problem and those on `solver.adapt` refinements of its mesh, each with its bounds.

    The lower bound is that of an `outer` law that contains the curtain's. Ends early if a solver did not converge.
    """
    solution, scene, law = first, first.problem.scene, first.problem.law.own
    for number in range(scene.solver.adapt + 1):
        with part_of(f"{solution.problem.disc.n_cells} cells, bounds"):
            bounds = bound(solution, outer=outer)
        yield bounds
        if bounds.status != "converged" or number == scene.solver.adapt:
            return
        mesh = refine(solution.problem.mesh, mark(bounds.error))
        with part_of(f"{mesh.mesh.t.shape[1]} cells"):
            problem = admissible_problem(scene, law, mesh)
            solution = solve_problem(problem if solution.tau is not None else with_cones_of(problem, solution))
        if solution.status != "converged":
            return


def admissible_problem(scene: Scene, law: MembraneLaw, mesh: CurtainMesh, factor: float = 1.0) -> CurtainProblem:
    """The P2 problem of a scene with the law at the corners of the triangles; with walls the P1 problem, whose curtain
    is inside a plane where its nodes are.
    """
    quadratic = replace(scene, mesh=replace(scene.mesh, element="P2"))
    problem = make_problem(quadratic, law, mesh, factor)
    _check_points(problem)
    if len(problem.walls):
        return make_problem(replace(scene, mesh=replace(scene.mesh, element="P1")), law, mesh, factor)
    values, gradients = reference_shapes(skfem.ElementTriP2(), MEETS[:, :3], 6)
    weight = np.tile(problem.disc.cell_area / 3.0, 3)  # exact for linear functions
    disc = replace(problem.disc, shape_values=values, shape_gradients=gradients, weight=weight)
    return replace(problem, disc=disc, fem=problem.supports.fem(disc))


def _check_points(problem: CurtainProblem) -> None:
    """InputError for points around which no largest stretch bounds what the spread force does."""
    if problem.scene.solver.strings == "elastic" and len(problem.points):
        problem.scene.refuse(
            "[solver] strings = 'elastic': bounds do not go with points held or loaded one by one, where elastic "
            "strings stretch without end; take strings = true, or edges and patches"
        )


def with_cones_of(problem: CurtainProblem, before: CurtainSolution | None) -> CurtainProblem:
    """The problem, to begin with the half-spaces of an earlier solution at the nearest points, under its own law."""
    if before is None or before.cones is None:
        return problem
    _, nearest = cKDTree(_moved_in(before.problem)).query(_moved_in(problem))
    cones = take_from(before.cones, nearest)
    return replace(problem, cones=replace(cones, h=problem.law.support(cones.S)))


def _moved_in(problem: CurtainProblem) -> Array:
    """Points of the discretisation, drawn to the middle of their triangles so that each has its own, (n_points, 2)."""
    disc = problem.disc
    middle = disc.cell_mean(disc.points)
    return 0.5 * (disc.points + np.tile(middle, (disc.n_quad, 1)))


def mark(error: Array, bulk: float = BULK) -> np.ndarray:
    """The fewest triangles that together hold the part `bulk` of the error, largest first.

    >>> mark(np.array([1.0, 5.0, 0.0, 4.0])).tolist()
    [1, 3]
    """
    order = np.argsort(-error, kind="stable")
    reached = np.cumsum(np.maximum(error[order], 0.0))
    if not (reached > 0.0).any():
        return order[:0]
    return order[: int(np.searchsorted(reached, bulk * reached[-1])) + 1]
