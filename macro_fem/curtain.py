"""One problem, three solvers: ideal locking by our interior point or by clarabel, elasticity by Newton's method."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from homogenize import MembraneLaw
from macro_fem.elastic_curtain import solve_elastic
from macro_fem.fem.rotated import RotatedLaw
from macro_fem.fem.space import in_space, padded
from macro_fem.fem.supported import SupportedFem
from macro_fem.scene.mesh import build_mesh
from macro_fem.scene.schema import Scene
from macro_fem.solution import (
    CurtainSolution,
    Problem,
    gathered_start,
    make_problem,
    spread_allowance,
    spread_tension,
    unit_tensors,
)
from macro_fem.solvers.clarabel import ConicOptions, solve_conic
from macro_fem.solvers.cones import Cones, facets_of, same_cones, taken_from
from macro_fem.solvers.rigid import COUNTED, RigidOptions, RigidResult, solve_rigid, unsolved
from macro_fem.solvers.status import Reach, load_scale
from macro_fem.solvers.stretch_limit import Solve, reach_of, solve_taut
from rve.common.errors import InputError
from rve.common.types import Array

COARSE_FROM = 4000
"""Points from which a coarse curtain is solved first."""
COARSE_TOLERANCE = 1e-4
MOST_CONES = 2_000_000
"""Half-spaces that may be forced in: some 2 GB."""


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
    mesh = build_mesh(scene, law.cell)
    return solve_problem(make_problem(scene, law, mesh))


def solve_problem(problem: Problem) -> CurtainSolution:
    """The curtain of a discrete problem, by the solver its scene names."""
    if problem.scene.solver.forces("ties"):
        problem = replace(problem, fem=problem.fem.tied())
    if problem.scene.solver.kind == "elastic":
        reach = supports_reach(problem)
        return solve_elastic(problem, reach, None if reach.is_out else coarse_cones(problem))
    return solve_locked(problem)


def supports_reach(problem: Problem) -> Reach:
    """How much farther apart the supports could be, by clarabel where the scene asks for it."""
    fem, size = problem.fem, problem.mesh.size
    by_clarabel = _by_clarabel(problem) if problem.scene.solver.kind == "clarabel" else None
    return reach_of(fem, problem.law, fem.unknowns(gathered_start(problem)), size, by_clarabel)


def solve_locked(problem: Problem) -> CurtainSolution:
    """The rigid curtain of a discrete problem, by our own interior-point method or, for "clarabel", by that."""
    begin = time.perf_counter()
    spec, fem = problem.scene.solver, problem.fem
    start, force = gathered_start(problem), problem.force
    if spec.forces("third-coordinate"):
        fem, start, force = in_space(fem), padded(start), padded(force)
    tension = spread_tension(problem)
    load = fem.gather(force) + fem.force(tension * unit_tensors(replace(problem, fem=fem)))
    violation = max(RigidOptions.violation, COUNTED * spec.tolerance)
    options = RigidOptions(spec.tolerance, violation, spec.max_iterations)
    z, reach, give = fem.unknowns(start), supports_reach(problem), None
    if reach.is_out:
        result = unsolved(fem, problem.law, z)
    else:
        solve = _by_clarabel(problem) if spec.kind == "clarabel" else _by_interior_point(problem)
        if reach.is_at_limit:
            result, give = solve_taut(fem, load, z, options, reach, solve)
        else:
            result = solve(fem, load, z, options)
            reach = result.reach if result.stop == "infeasible" else reach
    return _solution(problem, fem, result, tension, reach, give, time.perf_counter() - begin)


def _by_interior_point(problem: Problem) -> Solve:
    """Our own solver, with the half-spaces that the scene begins with."""
    forced = problem.scene.solver.forces("all-half-spaces")
    cones = all_cones(problem) if forced else coarse_cones(problem)

    def solve(fem: SupportedFem, load: Array, z: Array, options: RigidOptions) -> RigidResult:
        options = replace(options, cones=cones, drop_idle=not forced)
        return solve_rigid(fem, problem.law, load, z, problem.mesh.size, options)

    return solve


def _by_clarabel(problem: Problem) -> Solve:
    def solve(fem: SupportedFem, load: Array, z: Array, options: RigidOptions) -> RigidResult:
        return solve_conic(fem, problem.law, load, problem.mesh.size, ConicOptions(gap=options.gap))

    return solve


def all_cones(problem: Problem) -> Cones:
    """All half-spaces of the law at every point; InputError if they are too many, or not a finite list."""
    facets = facets_of(problem.law)
    source, points = problem.scene.source, problem.disc.n_points
    if facets is None:
        raise InputError(
            f"{source}: [solver] force = 'all-half-spaces': the law {problem.law.name!r} has no finite list of them"
        )
    if len(facets.h) * points > MOST_CONES:
        raise InputError(
            f"{source}: [solver] force = 'all-half-spaces': {len(facets.h)} at {points} points are more than "
            f"{MOST_CONES}; use fewer cells"
        )
    return same_cones(facets, points)


def starts_coarse(problem: Problem) -> bool:
    """Whether a coarser curtain is solved first: it pays on large meshes; clarabel and some meshes cannot use one."""
    scene = problem.scene
    pays = problem.disc.n_points >= COARSE_FROM or scene.solver.forces("coarse-start")
    possible = scene.curtain.shape != "file" and not scene.solver.adapt and scene.mesh.cells >= 8
    return pays and possible and scene.solver.kind != "clarabel"


def coarse_cones(problem: Problem) -> Cones | None:
    """Half-spaces to begin with, from a loosely solved curtain on a mesh four times as coarse; None for small meshes.

    They are half as many as the law's own first ones and nearly the right ones, so that few rounds remain.
    """
    if not starts_coarse(problem):
        return None
    scene = problem.scene
    law = problem.law.law if isinstance(problem.law, RotatedLaw) else problem.law
    loose = replace(scene.solver, tolerance=max(COARSE_TOLERANCE, scene.solver.tolerance), force=())
    coarse = replace(scene, mesh=replace(scene.mesh, cells=scene.mesh.cells // 4), solver=loose)
    try:
        solution = solve_locked(make_problem(coarse, law, build_mesh(coarse, law.cell), problem.factor))
    except InputError:  # hooks or patches too small for the coarse mesh: begin with the law's own half-spaces
        return None
    if solution.status != "converged" or solution.cones is None:
        return None
    _, nearest = cKDTree(solution.problem.disc.points).query(problem.disc.points)
    return taken_from(solution.cones, nearest)


def _solution(
    problem: Problem,
    fem: SupportedFem,
    result: RigidResult,
    tension: float,
    reach: Reach,
    give: float | None,
    wall_s: float,
) -> CurtainSolution:
    """The record. The dual value is that of the spread problem, made a bound for the load's own potential."""
    x = fem.positions(result.z)[:, :2]
    primal = -float((problem.force * (x - problem.disc.nodes)).sum())
    own_load = fem.gather(problem.force if fem.d == 2 else padded(problem.force))
    shift = primal + float(own_load @ result.z)  # what supports and the choice of origin add to -l.z
    held_part = float(
        (
            fem.weight[:, None, None]
            * tension
            * unit_tensors(replace(problem, fem=fem))
            * fem.gradient(np.zeros_like(result.z))
        ).sum()
    )
    allowance = spread_allowance(problem, tension)
    scale = load_scale(problem.force, problem.disc.weight) * problem.mesh.size
    return CurtainSolution(
        problem=problem,
        stop=result.stop,
        asked=replace(result.asked, gap=result.asked.gap + 2.0 * allowance / scale),
        x=x,
        F=fem.gradient(result.z)[:, :2],
        P=result.P[:, :2],
        S=result.S,
        primal=primal,
        dual=result.dual + shift - allowance - held_part,
        iterations=result.iterations,
        wall_s=wall_s,
        reach=reach,
        give=give,
        cones=result.cones,
        history=result.history,
        tension=tension,
    )
