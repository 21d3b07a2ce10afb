"""The curtain of a discrete problem: one cone program for rigid and elastic rings, or clarabel for rigid ones."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from homogenize import MembraneLaw, with_material
from macro_fem.elastic_curtain import polished
from macro_fem.fem.rotated import RotatedLaw
from macro_fem.fem.supported import SupportedFem
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.obstacles import is_flat
from macro_fem.scene.schema import Scene
from macro_fem.shape_loop import solve_shape
from macro_fem.solution import (
    CurtainSolution,
    Decision,
    Problem,
    gathered_start,
    make_problem,
    spread_allowance,
    spread_tension,
    unit_tensors,
)
from macro_fem.solvers.central_path import PathResult, solve_path, unsolved
from macro_fem.solvers.clarabel import ClarabelOptions, solve_clarabel
from macro_fem.solvers.cones import Cones, green_strain, taken_from
from macro_fem.solvers.options import PathOptions, StepOptions
from macro_fem.solvers.status import ROUNDING, Reach, load_scale
from macro_fem.solvers.stretch_limit import Solve, reach_of, solve_taut
from macro_fem.solvers.walls import Walls
from rve.common.errors import InputError
from rve.common.types import Array
from rve.common.values import Options, number, whole


@dataclass(frozen=True)
class CurtainOptions(Options):
    """How a solve begins; InputError for values that make no sense."""

    coarse_from: int = whole(4000, least=0, most=10**9)
    """Points from which a coarser curtain is solved first: on fewer the law's own half-spaces are as quick."""
    coarse_ratio: int = whole(4, least=2, most=100)
    """Cells of the mesh per cell of the coarser one. Coarser ones are cheaper and tell less."""
    coarse_tolerance: float = number(1e-4, above=0.0, most=1.0)
    """Tolerance of the coarser curtain. Only its half-spaces are used, which smaller tolerances hardly change."""

    inward: float = number(0.05, above=0.0, most=1.0)
    """How far the start of a load step is drawn from the last curtain to the slack start, where 1 is that. On the last
    curtain itself no cone has room left; farther away more steps are needed."""


SLIDES = 1e-6
"""Part of the loads that nothing needs to carry where a curtain is free to slide: above the errors of solvers."""
CURTAIN = CurtainOptions()
"""The defaults."""
ELASTIC_STEPS = StepOptions(least_gap=1e-2)
"""Stresses of an elastic curtain are off by the square root of the gap, so its path is followed further down."""


def solve_scene(scene: Scene, law: MembraneLaw) -> CurtainSolution:
    """The curtain of a scene at its full load.

    >>> from homogenize.io import default_law
    >>> from macro_fem.scene.schema import read_scene
    >>> scene = read_scene({"curtain": {"width": 100.0, "height": 100.0}, "mesh": {"cells": 4},
    ...                     "support": {"kind": "top"}})
    >>> solution = solve_scene(scene, default_law())
    >>> solution.status
    'converged'
    """
    law = with_material(law, dict(scene.material), f"{scene.source}: [material]")
    mesh = build_mesh(scene, law.cell)
    return solve_problem(make_problem(scene, law, mesh))


def solve_problem(
    problem: Problem, start: CurtainSolution | None = None, options: CurtainOptions = CURTAIN
) -> CurtainSolution:
    """The curtain of a discrete problem, by the solver its scene names.

    `start` is a curtain on the same mesh, say that of the last load step: its half-spaces are the first ones, the first
    positions are near its own, and its matrix pattern and symbolic factor are kept.

    A problem with bodies or following pressure is solved in rounds (`macro_fem.shape_loop`).
    """
    if problem.bodies or problem.follows:
        return held_in_place(solve_shape(problem, start, solve_problem))
    begin = time.perf_counter()
    if start is not None and _is_alike(problem.fem, start.problem.fem):
        problem = replace(problem, fem=start.problem.fem.moved(problem.fem.x_held))
    reach, give = _known_reach(problem, start) or supports_reach(problem), None
    decided: tuple[Decision, ...] = ()
    if is_elastic(problem.scene) and reach.is_out and reach.excess < elastic_stretch(problem):
        reach = replace(reach, upper=1.0)
    if reach.is_out:
        result = unsolved(problem.fem, problem.law, problem.fem.unknowns(gathered_start(problem)))
    else:
        cones, decided = _first_cones(problem, start, options)
        result, give = _solved(problem, reach, cones, _first_positions(problem, start, options))
        reach = result.reach if result.stop == "infeasible" else reach
    found = _solution(problem, result, reach, give)
    left = problem.scene.solver.max_iterations - found.iterations
    if found.elastic and not reach.is_out and left > 0 and not found.asked.is_met(found.evidence, ROUNDING):
        if problem.walls is None:
            found = polished(found, left)
        else:
            decided += (Decision("polish", False, "Newton's method on the law itself knows no floors and obstacles"),)
    found = replace(found, decided=decided, wall_s=time.perf_counter() - begin)
    return found if problem.walls is None else held_in_place(found)


def _known_reach(problem: Problem, start: CurtainSolution | None) -> Reach | None:
    """The reach of the curtain before where nothing it depends on has changed."""
    if start is None or start.stop == "infeasible" or start.problem.law is not problem.law:
        return None
    one, other = problem.fem, start.problem.fem
    return start.reach if _is_alike(one, other) and np.array_equal(one.x_held, other.x_held) else None


def held_in_place(found: CurtainSolution) -> CurtainSolution:
    """The curtain; InputError if obstacles or following pressure push it along a direction in which nothing holds it.

    Supports that let a curtain slide are given a pin, which must stay without force.
    """
    problem = found.problem
    pinned = problem.supports.pinned
    if pinned.any() and found.status == "converged":
        forces = np.where(pinned, found.unbalanced, 0.0).sum(axis=0)
        axis = int(np.abs(forces).argmax())
        if abs(forces[axis]) > SLIDES * load_scale(problem.force, problem.disc.weight):
            table = "obstacle" if problem.scene.obstacle else "load.wind"
            raise InputError(
                f"{problem.scene.source}: [{table}]: nothing carries the force of {-forces[axis]:.6g} N along "
                f"{'xyz'[axis]}, in which the supports let the curtain slide: hold it there"
            )
    return found


def _is_alike(one: SupportedFem, other: SupportedFem) -> bool:
    """Whether two discretisations differ in their held positions only."""
    if not (np.array_equal(one.free, other.free) and np.array_equal(one.disc.cell_dofs, other.disc.cell_dofs)):
        return False
    if one.tie is None or other.tie is None:
        return one.tie is other.tie
    return one.tie.shape == other.tie.shape and (one.tie != other.tie).nnz == 0


def is_elastic(scene: Scene) -> bool:
    """Whether the scene asks for elastic rings instead of ideal locking."""
    return scene.solver.kind == "elastic"


def by_clarabel(scene: Scene) -> bool:
    """Whether the scene asks for clarabel instead of our own solver."""
    return scene.solver.kind == "clarabel"


def supports_reach(problem: Problem) -> Reach:
    """How much farther apart the supports could be, by clarabel where the scene asks for it."""
    fem, size = problem.fem, problem.mesh.size
    solve = _clarabel(problem) if by_clarabel(problem.scene) else None
    return reach_of(fem, problem.law, fem.unknowns(gathered_start(problem)), size, solve)


def elastic_stretch(problem: Problem) -> float:
    """About how far the loads of a scene stretch its rings: load times size over area, times the mean compliance.

    Supports out of reach by more end as "infeasible": an answer would be the elasticity of rings drawn beyond what the
    law was made for.
    """
    line_load = float(np.abs(problem.force).sum()) * problem.mesh.size / float(problem.disc.weight.sum())
    return line_load * float(np.trace(problem.law.compliance)) / 3.0


def _solved(problem: Problem, reach: Reach, cones: Cones | None, x: Array) -> tuple[PathResult, float | None]:
    """The solver's record from positions x (n_nodes, d), and by how much rings gave in a problem that was relaxed.

    The even tension that opens out slack parts stays in a rigid curtain, whose bounds allow for it; an elastic one is
    only guided by it.
    """
    spec, fem, law, size = problem.scene.solver, problem.fem, problem.law, problem.mesh.size
    load, z = fem.gather(problem.force), fem.unknowns(x)
    tension = fem.force(spread_tension(problem) * unit_tensors(problem))
    violation = max(PathOptions.violation, PathOptions.counted * spec.tolerance)
    options = PathOptions(gap=spec.tolerance, violation=violation, max_iterations=spec.max_iterations, cones=cones)
    if is_elastic(problem.scene):
        law = problem.elastic_law
        knows = cones is not None and (cones.extra is None) == (law.half_spaces().extra is None)
        options = replace(options, steps=ELASTIC_STEPS, cones=cones if knows else None)
        compliance = law.compliance
        return solve_path(
            fem, law, load, z, size, options, compliance=compliance, guide=tension, walls=problem.walls
        ), None

    def by_path(fem: SupportedFem, load: Array, z: Array, options: PathOptions, walls: Walls | None) -> PathResult:
        return solve_path(fem, law, load, z, size, options, walls=walls)

    solve = _clarabel(problem) if by_clarabel(problem.scene) else by_path
    if reach.is_at_limit:
        return solve_taut(fem, load + tension, z, options, reach, solve, walls=problem.walls)
    return solve(fem, load + tension, z, options, problem.walls), None


def _clarabel(problem: Problem) -> Solve:
    def solve(fem: SupportedFem, load: Array, z: Array, options: PathOptions, walls: Walls | None) -> PathResult:
        return solve_clarabel(fem, problem.law, load, problem.mesh.size, ClarabelOptions(gap=options.gap), walls)

    return solve


def _first_positions(problem: Problem, start: CurtainSolution | None, options: CurtainOptions) -> Array:
    """The slack start (n_nodes, d), or a place near the last curtain."""
    slack = gathered_start(problem)
    return slack if start is None else start.x + options.inward * (slack - start.x)


def _first_cones(
    problem: Problem, start: CurtainSolution | None, options: CurtainOptions
) -> tuple[Cones | None, tuple[Decision, ...]]:
    """Half-spaces to begin with, None for the law's own, and where they come from.

    A coarser curtain has half as many as the law's own first ones and nearly the right ones.
    """
    scene, points = problem.scene, problem.disc.n_points

    def told(why: str, cones: Cones | None = None) -> tuple[Cones | None, tuple[Decision, ...]]:
        return cones, (Decision("coarse-start", cones is not None, why),)

    if by_clarabel(scene):
        return told("clarabel takes no start")
    if problem.cones is not None:
        return problem.cones, (
            Decision("last-mesh", True, "half-spaces begin with those of the mesh or law before"),
            Decision("coarse-start", False, "the mesh or law before is nearer"),
        )
    if start is not None and start.cones is not None and len(start.cones.first) == points:
        return start.cones, (
            Decision("last-step", True, "half-spaces and positions begin with those of the last load step"),
            Decision("coarse-start", False, "the last load step is nearer"),
        )
    if any(not is_flat(item) for item in scene.obstacle) or any(wind.follows for wind in scene.load.wind):
        return told("bodies and following pressure are met on this mesh alone")
    if points < options.coarse_from:
        return told(f"{points} points are fewer than {options.coarse_from}")
    if scene.curtain.shape == "file" or scene.solver.adapt or scene.mesh.cells < 2 * options.coarse_ratio:
        return told("this mesh has no coarser one")
    coarse = _coarser(problem, options)
    if coarse is None:
        return told("the coarser mesh does not fit hooks or patches")
    if coarse.status != "converged" or coarse.cones is None:
        return told(f"the coarser curtain ended as {coarse.status}")
    _, nearest = cKDTree(coarse.problem.disc.points).query(problem.disc.points)
    return told(f"{points} points: a coarser curtain tells the first half-spaces", taken_from(coarse.cones, nearest))


def _coarser(problem: Problem, options: CurtainOptions) -> CurtainSolution | None:
    """The loosely solved curtain on a coarser mesh; None where the scene cannot be meshed that coarsely.

    Rigid, for its half-spaces serve an elastic one as well, unless rings give by direction.
    """
    scene = problem.scene
    law = problem.law.law if isinstance(problem.law, RotatedLaw) else problem.law
    tolerance = max(options.coarse_tolerance, scene.solver.tolerance)
    is_rigid = not is_elastic(scene) or problem.elastic_law is problem.law
    coarse = replace(
        scene,
        mesh=replace(scene.mesh, cells=scene.mesh.cells // options.coarse_ratio),
        solver=replace(scene.solver, kind="rigid" if is_rigid else "elastic", tolerance=tolerance),
    )
    try:
        discrete = make_problem(coarse, law, build_mesh(coarse, law.cell), problem.factor)
    except InputError:
        return None
    return solve_problem(discrete, None, options)


def _solution(problem: Problem, result: PathResult, reach: Reach, give: float | None) -> CurtainSolution:
    """The record. The dual value is that of the spread problem, made a bound for the load's own potential."""
    fem, elastic = problem.fem, is_elastic(problem.scene)
    x, F = fem.positions(result.z), fem.gradient(result.z)
    tension = 0.0 if elastic else spread_tension(problem)
    work = float((problem.force * (x - fem.reference)).sum())
    shift = float(fem.gather(problem.force) @ result.z) - work  # what supports and the choice of origin add to -l.z
    held = fem.gradient(np.zeros_like(result.z))
    held_part = float((fem.weight[:, None, None] * tension * unit_tensors(problem) * held).sum())
    allowance = spread_allowance(problem, tension)
    scale = load_scale(problem.force, problem.disc.weight) * problem.mesh.size
    stored = float(fem.weight @ problem.elastic_law.response(green_strain(F)).energy) if elastic else 0.0
    return CurtainSolution(
        problem=problem,
        stop=result.stop,
        asked=replace(result.asked, gap=result.asked.gap + 2.0 * allowance / scale),
        x=x,
        F=F,
        P=result.P,
        S=result.S,
        primal=stored - work,
        dual=result.dual + shift - allowance - held_part,
        iterations=result.iterations,
        wall_s=0.0,
        reach=reach,
        give=give,
        elastic=elastic,
        cones=result.cones,
        history=result.history,
        tension=tension,
        wall_forces=result.wall_forces if result.wall_forces.size else np.zeros(len(problem.walls or ())),
    )
