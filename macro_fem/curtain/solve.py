"""The curtain of a discrete problem: one cone program for rigid and elastic rings; and forces that rigid rings leave
open, decided by the elasticity of the rings: a second step after the rigid shape.

Forces of supports are unique if balance alone decides them, or if they act at two points: balance then leaves one pull
along their line, the slope of the least potential over their distance. Level supports at more points, as far apart as
the mesh is wide, are where the potential has a kink: columns of rings lock side by side and may share the load in many
ways. Elastic rings have one answer.
"""

import time
from dataclasses import dataclass, replace

import numpy as np

from macro_fem.curtain.problem import CurtainProblem, gathered_start, stabilising_tension, strength_at_points
from macro_fem.curtain.shape import solve_shape
from macro_fem.curtain.solution import CurtainSolution, slackened
from macro_fem.curtain.state import InnerForces
from macro_fem.fem.cells import components
from macro_fem.fem.discretization import Discretization
from macro_fem.fem.supported import SupportedFem
from macro_fem.scene.supports import check_pins
from macro_fem.solvers.central_path import solve_path
from macro_fem.solvers.cones import Cones, first_cones, green_strain
from macro_fem.solvers.path import COUNTED, PATH, Flow, PathOptions, PathResult, Terms
from macro_fem.solvers.status import FREE, Evidence, Reach, load_scale
from macro_fem.solvers.stretch_limit import reach_of, solve_at_stretch_limit
from macro_fem.solvers.walls import TOUCHED, Walls
from rve.common import Array, InputError, part_of


@dataclass(frozen=True)
class SolveOptions:
    """Numbers of the solver of a curtain."""

    inward: float = 0.05
    """How far the start of a load step is drawn from the last curtain, where no cone has any margin left, to the slack
    start; farther away more steps are needed."""
    elastic_gap: float = 1e-2
    """Stresses of an elastic curtain are off by the square root of the gap: its path goes on to this part of the
    gap."""
    rank: float = 1e-9
    """Singular values of the equations of balance below this part of the largest count as none."""


SOLVE = SolveOptions()
NOT_UNIQUE = (
    "rigid rings can share the load in many ways, and forces of single points, line loads and the safety factor are "
    'those of one of them; kind = "elastic" under [solver] gives those that the stiffness of the rings decides'
)
"""What a rigid curtain says of forces that it leaves open."""
SHEETS = "sheets that only lock", "a sheet that stretches by the stiffness of its law, which may be an assumed one"
"""What stands for rigid and for elastic rings where a law has none."""


def solve_problem(problem: CurtainProblem, start: CurtainSolution | None = None) -> CurtainSolution:
    """The curtain of a discrete problem, by the solver its scene names; with bodies or wind on its shape in rounds
    (`macro_fem.curtain.shape`).

    `start` is a curtain on the same mesh, say that of the last load step: its half-spaces are the first ones, the first
    positions are near its own, and its matrix pattern and symbolic factor are kept.
    """
    if problem.bodies or problem.winds:
        return held_in_place(solve_shape(problem, start, solve_convex))
    return held_in_place(solve_convex(problem, start))


def solve_convex(problem: CurtainProblem, start: CurtainSolution | None = None) -> CurtainSolution:
    """The curtain of a problem without bodies or wind on its shape; forces at its pins are left unchecked."""
    begin = time.perf_counter()
    if start is not None and is_alike(problem.fem, start.problem.fem):
        problem = replace(problem, fem=start.problem.fem.moved(problem.fem.x_held))
    spec, relaxation = problem.scene.solver, None
    reach = FREE if spec.is_plastic and spec.strings is not True else supports_reach(problem, start)
    if spec.is_elastic and reach.is_out:
        # More than the loads stretch its rings would be the elasticity of rings beyond what the law was made for.
        line_load = float(np.abs(problem.force).sum()) * problem.mesh.size / float(problem.disc.weight.sum())
        if reach.excess < line_load * float(np.trace(problem.law.compliance)) / 3.0:
            reach = replace(reach, upper=1.0)
    if reach.is_out:
        result = _unsolved(problem, "infeasible")
    elif problem.walls.stuck(problem.fem) > TOUCHED * problem.mesh.size:
        result = _unsolved(problem, "blocked")
    else:
        if spec.is_plastic:  # of ten paths that began at rings which flow one did not end
            start = None
        cones, x = problem.cones, gathered_start(problem) if start is None else slackened(start, SOLVE.inward)
        if cones is None and start is not None and start.problem.disc.n_points == problem.disc.n_points:
            cones = start.cones
        result, relaxation = _solve_within_reach(problem, reach, cones, x)
        reach = result.reach if result.stop == "infeasible" else reach
    found = make_solution(problem, result, reach, relaxation)
    return replace(found, wall_s=time.perf_counter() - begin)


def _unsolved(problem: CurtainProblem, stop: str) -> PathResult:
    """What stands for an answer where supports or obstacles leave none: the slack start without stress."""
    z, n = problem.fem.unknowns(gathered_start(problem)), problem.disc.n_points
    worst, cones = Evidence(np.inf, np.inf, np.inf), first_cones(problem.law.half_spaces(), n)
    P, pushes = 0.0 * problem.fem.gradient(z), np.zeros(len(problem.walls))
    return PathResult(stop, worst, PATH.accuracy, z, np.zeros((n, 3)), np.zeros(n), cones, P, np.nan, np.nan, 0, pushes)


def held_in_place(found: CurtainSolution) -> CurtainSolution:
    """The curtain; InputError if obstacles or wind push it along a direction in which nothing but a pin holds it."""
    problem, pins = found.problem, found.problem.supports.pins
    if len(pins.nodes) and found.status in ("converged", "taut"):
        table = "obstacle" if problem.scene.obstacle else "load.wind" if problem.winds else "load"
        check_pins(pins, found.unbalanced, found.noise, problem.scene, table)
    return found


def is_alike(one: SupportedFem, other: SupportedFem) -> bool:
    """Whether two discretisations differ in their held positions only."""
    same = one.T.shape == other.T.shape and np.array_equal(one.disc.cell_dofs, other.disc.cell_dofs)
    return same and (one.tie is None) == (other.tie is None) and (one.T != other.T).nnz == 0


def supports_reach(problem: CurtainProblem, start: CurtainSolution | None = None) -> Reach:
    """How much farther apart the supports could be; that of the curtain before where it has not changed."""
    fem = problem.fem
    if start is not None and start.stop != "infeasible" and start.problem.law.own is problem.law.own:
        before = start.problem.fem
        if is_alike(fem, before) and np.array_equal(fem.x_held, before.x_held):
            return start.reach
    return reach_of(fem, problem.last_law, fem.unknowns(gathered_start(problem)), problem.mesh.size)


def _solve_within_reach(
    problem: CurtainProblem, reach: Reach, cones: Cones | None, x: Array
) -> tuple[PathResult, float | None]:
    """The solver's record from positions x (n_nodes, d), and the relaxation of a law at its stretch limit."""
    spec, size, z = problem.scene.solver, problem.mesh.size, problem.fem.unknowns(x)
    load = problem.fem.gather(problem.force) + problem.fem.force(stabilising_tension(problem) * problem.frame)
    violation = max(PathOptions.violation, COUNTED * spec.tolerance)
    options = PathOptions(gap=spec.tolerance, violation=violation, max_iterations=spec.max_iterations, cones=cones)
    if problem.scene.solver.is_elastic:
        law = problem.elastic_law
        terms = Terms(law.compliance, problem.walls)
        return solve_path(problem.fem, law, load, z, size, replace(options, least_gap=SOLVE.elastic_gap), terms), None

    if problem.scene.solver.is_plastic:
        terms = Terms(walls=problem.walls, flow=flow_of(problem, problem.disc))
        return solve_path(problem.fem, problem.plastic_law, load, z, size, options, terms), None

    def solve(fem: SupportedFem, z: Array, options: PathOptions, walls: Walls) -> PathResult:
        return solve_path(fem, problem.law, load, z, size, options, Terms(walls=walls))

    if reach.is_at_limit:
        return solve_at_stretch_limit(solve, problem.fem, z, options, reach, problem.walls)
    return solve(problem.fem, z, options, problem.walls), None


def flow_of(problem: CurtainProblem, disc: Discretization) -> Flow:
    """How rings flow at the points of a discretisation of the problem."""
    return Flow(strength_at_points(problem, disc), problem.plastic_law.parts())


def make_solution(
    problem: CurtainProblem, result: PathResult, reach: Reach, relaxation: float | None
) -> CurtainSolution:
    """The record, the dual value of the spread problem made a bound for the load's own potential."""
    fem, elastic = problem.fem, problem.scene.solver.is_elastic
    x, F = fem.positions(result.z), fem.gradient(result.z)
    tension = stabilising_tension(problem)
    work = float((problem.force * (x - fem.reference)).sum())
    shift = float(fem.gather(problem.force) @ result.z) - work  # what supports and the choice of origin add to -l.z
    held = fem.gradient(np.zeros_like(result.z))
    held_part = float((fem.disc.weight[:, None, None] * tension * problem.frame * held).sum())
    allowance = _tension_allowance(problem, tension, F)
    scale = load_scale(problem.force, problem.disc.weight) * problem.mesh.size * result.evidence.drawn
    stored = float(fem.disc.weight @ problem.elastic_law.response(green_strain(F)).energy) if elastic else 0.0
    stored += 0.0 if result.tau is None else float(fem.disc.weight @ result.tau)
    return CurtainSolution(
        problem=problem,
        stop=result.stop,
        asked=replace(result.asked, gap=result.asked.gap + 2.0 * allowance / scale),
        x=x,
        inner=InnerForces(result.P, result.S, tension, result.wall_forces, result.S_strings),
        primal=stored - work,
        dual=result.dual + shift - allowance - held_part,
        iterations=result.iterations,
        wall_s=0.0,
        reach=reach,
        relaxation=relaxation,
        cones=result.cones,
        tau=result.tau,
        drawn=result.evidence.drawn,
    )


def _tension_allowance(problem: CurtainProblem, tension: float, F: Array) -> float:
    """How much more than the spread problem's a bound of the load's own potential must allow, N mm.

    -l.z = -(l + l_e).z + l_e.z, and l_e.z = tension times the integral of Q:F over the area, where Q is the frame, two
    orthogonal unit vectors: (Q:F)^2 <= 2 tr C with tr C = 2 + 2 tr E <= 2 + 4 h(I/2), or that of rings which flow.
    """
    half = np.array([[0.5, 0.0, 0.5]])
    flowing = float((F**2).sum(axis=(1, 2)).max()) if problem.scene.solver.is_plastic else 0.0
    largest = np.sqrt(2.0 * max(2.0 + 4.0 * float(problem.law.support(half)[0]), flowing))
    return float(tension * largest * float(problem.disc.weight.sum()))


def self_balanced(problem: CurtainProblem, x: Array) -> int:
    """How many independent sets of support forces at positions x (n_nodes, d) balance without any load; 0 if the forces
    are unique. A component that slides on a sloping line counts as held.
    """
    number, label = components(problem.disc.cell_dofs, problem.disc.n_nodes)
    found = 0
    for piece in range(number):
        nodes, axes = np.nonzero(problem.supports.mask & (label == piece)[:, None])
        if len(np.unique(nodes)) > 2:
            found += len(nodes) - int(np.linalg.matrix_rank(_balance(x[nodes], axes), SOLVE.rank))
    return found


def _balance(x: Array, axes: np.ndarray) -> Array:
    """Forces and moments (3 or 6, k) of unit forces along `axes` (k,) at positions x (k, d), size 1."""
    d = x.shape[1]
    away = x - x.mean(axis=0)
    arm, force = np.zeros((len(x), 3)), np.eye(3)[axes]
    arm[:, :d] = away / max(float(np.abs(away).max()), 1e-300)
    moment = np.cross(arm, force)
    return np.concatenate([force[:, :d].T, moment[:, 2:].T if d == 2 else moment.T])


def with_forces(found: CurtainSolution) -> CurtainSolution:
    """The curtain with line loads and forces of elastic rings where rigid ones leave them open, its shape unchanged.

    For `kind = "auto"`; `second_step` says what was done, or why elastic rings give no answer and rigid forces stay.
    """
    problem = found.problem
    if problem.scene.solver.kind != "auto" or found.status != "converged":
        return found
    count = self_balanced(problem, found.x)
    if not count:
        why = "balance, or the distance of two points, decides the forces of the supports"
        return replace(found, second_step=(False, why))
    elastic, why = None, f"as a law of kind {problem.law.name} has no stiffness"
    stiff, soft = ("rigid rings", "elastic rings") if problem.law.cell else SHEETS
    if problem.law.compliance.any():
        solver = replace(problem.scene.solver, kind="elastic", bounds=False, adapt=0)
        second = replace(problem, scene=replace(problem.scene, solver=solver), bodies=(), winds=())
        try:
            with part_of("forces by elastic rings"):
                elastic = solve_problem(second, found)
                why = f"with {soft} {elastic.message}"
        except InputError as error:
            why = f"with {soft} {error}"
    if elastic is None or elastic.status != "converged":
        return replace(found, second_step=(False, f"forces are one choice of many: {why}"))
    why = (
        f"the supports are statically indeterminate, to the degree {count}: forces, line loads and the safety factor "
        f"are those of {soft}, {elastic.iterations} more steps of the solver; the shape is that of {stiff}"
    )
    return replace(
        found,
        second_step=(True, why),
        inner=elastic.inner,
        asked=replace(found.asked, unbalanced=max(found.asked.unbalanced, elastic.asked.unbalanced)),
        wall_s=found.wall_s + elastic.wall_s,
    )


def forces_by(found: CurtainSolution) -> str:
    """Which rings the forces are those of: "rigid" or "elastic"."""
    return "elastic" if found.elastic or (found.second_step or (False,))[0] else "rigid"


def forces_note(found: CurtainSolution) -> str | None:
    """How forces that rigid rings leave open were found, or why they are one choice; None if they are unique."""
    if found.elastic or not self_balanced(found.problem, found.x):
        return None
    return NOT_UNIQUE if found.second_step is None else found.second_step[1]
