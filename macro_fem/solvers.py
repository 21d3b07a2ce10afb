"""One problem, three solvers: ideal locking by our interior point or by clarabel, elasticity by Newton's method."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from homogenize.law import Array, InputError, MembraneLaw
from macro_fem.cones import Cones, taken_from
from macro_fem.conic import ConicOptions, solve_conic
from macro_fem.elastic import solve_elastic
from macro_fem.mesh import build_mesh
from macro_fem.rigid import RigidOptions, RigidResult, solve_rigid
from macro_fem.scene import Scene
from macro_fem.solution import CurtainSolution, Problem, gathered_start, make_problem, spread_tension
from macro_fem.turned import TurnedLaw

COARSE_FROM = 4000
"""Points from which a coarse curtain is solved first."""
COARSE_TOLERANCE = 1e-4


def solve_scene(scene: Scene, law: MembraneLaw) -> CurtainSolution:
    """The curtain of a scene at its full load.

    >>> from homogenize.law import default_law
    >>> from macro_fem.scene import read_scene
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
    if problem.scene.solver.kind == "newton":
        return solve_elastic(problem, coarse_cones(problem))
    return solve_locked(problem)


def solve_locked(problem: Problem) -> CurtainSolution:
    """The rigid curtain of a discrete problem, by our own interior-point method or, for "conic", by clarabel."""
    begin = time.perf_counter()
    spec = problem.scene.solver
    fem = problem.fem
    tension = spread_tension(problem)
    load = fem.gather(problem.force) + fem.force(tension * _unit(problem))
    if spec.kind == "conic":
        result = solve_conic(fem, problem.law, load, problem.mesh.size, ConicOptions(gap=spec.tolerance))
    else:
        violation = max(RigidOptions.violation, 10.0 * spec.tolerance)
        options = RigidOptions(spec.tolerance, violation, spec.max_iterations, cones=coarse_cones(problem))
        result = solve_rigid(fem, problem.law, load, fem.unknowns(gathered_start(problem)), problem.mesh.size, options)
    return _solution(problem, result, tension, time.perf_counter() - begin)


def coarse_cones(problem: Problem) -> Cones | None:
    """Half-spaces to begin with, from a loosely solved curtain on a mesh four times as coarse; None for small meshes.

    They are half as many as the law's own first ones and nearly the right ones, so that few rounds remain.
    """
    scene = problem.scene
    if (
        problem.disc.n_points < COARSE_FROM
        or scene.curtain.shape == "file"
        or scene.solver.adapt
        or scene.mesh.cells < 8
    ):
        return None
    law = problem.law.law if isinstance(problem.law, TurnedLaw) else problem.law
    loose = replace(scene.solver, tolerance=max(COARSE_TOLERANCE, scene.solver.tolerance))
    coarse = replace(scene, mesh=replace(scene.mesh, cells=scene.mesh.cells // 4), solver=loose)
    try:
        solution = solve_locked(make_problem(coarse, law, build_mesh(coarse, law.cell), problem.factor))
    except InputError:  # hooks or patches too small for the coarse mesh: begin with the law's own half-spaces
        return None
    if solution.status != "converged" or solution.cones is None:
        return None
    _, nearest = cKDTree(solution.problem.disc.points).query(problem.disc.points)
    return taken_from(solution.cones, nearest)


def spread_allowance(problem: Problem, tension: float) -> float:
    """How much more than the spread problem's a bound of the load's own potential must allow, N mm.

    -l.z = -(l + l_e).z + l_e.z, and l_e.z = tension times the integral of tr F over the area, |tr F|^2 <= 2 tr C with
    tr C = 2 + 2 tr E <= 2 + 4 h(I/2).
    """
    half = np.array([[0.5, 0.0, 0.5]])
    largest = np.sqrt(2.0 * (2.0 + 4.0 * float(problem.law.support(half)[0])))
    return tension * largest * float(problem.disc.weight.sum())


def _unit(problem: Problem) -> Array:
    """The unit tensor at every point (nq, d, 2)."""
    return np.broadcast_to(np.eye(problem.fem.d, 2), (problem.disc.n_points, problem.fem.d, 2))


def _solution(problem: Problem, result: RigidResult, tension: float, wall_s: float) -> CurtainSolution:
    """The record. The dual value is that of the spread problem, made a bound for the load's own potential."""
    fem = problem.fem
    x = fem.positions(result.z)
    primal = -float((problem.force * (x - problem.disc.nodes)).sum())
    own_load = fem.gather(problem.force)
    shift = primal + float(own_load @ result.z)  # what supports and the choice of origin add to -l.z
    held_part = float(
        (fem.weight[:, None, None] * tension * _unit(problem) * fem.gradient(np.zeros_like(result.z))).sum()
    )
    allowance = spread_allowance(problem, tension) + held_part
    return CurtainSolution(
        problem=problem,
        status=result.status,
        message=result.message,
        x=x,
        F=problem.fem.gradient(result.z),
        P=result.P,
        S=result.S,
        primal=primal,
        dual=result.dual + shift - allowance,
        residual=result.residual,
        iterations=result.iterations,
        wall_s=wall_s,
        cones=result.cones,
        history=result.history,
    )
