"""The upper bound, a quadratic curtain that obeys the law everywhere; meshes that follow the error: triangles that hold
most of the gap between the bounds are refined.

In a triangle F of a P2 curtain is linear and |F L| convex, so that its largest value is at a corner: with half-spaces
at the corners, not at quadrature points, a P2 curtain is admissible everywhere and its potential an upper bound.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import skfem
from scipy.spatial import cKDTree

from homogenize import MembraneLaw
from macro_fem.bounds.interval import CurtainBounds, bound
from macro_fem.curtain import solve_problem
from macro_fem.fem.discretization import reference_shapes
from macro_fem.problem import CurtainProblem, make_problem
from macro_fem.scene.meshing.mesh import CurtainMesh, build_mesh, refine
from macro_fem.scene.schema import Scene
from macro_fem.solution import CurtainSolution
from macro_fem.solvers.cones import take_from
from rve.common import Array, part_of

BULK = 0.6
"""Share of the gap whose triangles are refined in one go (W. Doerfler, doi 10.1137/0733054)."""
CORNERS = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
"""Corners (2, 3) of the reference triangle, in the order of the corners of cells."""


@dataclass(frozen=True, eq=False)
class Level:
    """The curtain on one mesh and its bounds."""

    solution: CurtainSolution
    bounds: CurtainBounds


def levels(
    scene: Scene,
    law: MembraneLaw,
    outer: MembraneLaw | None = None,
    mesh: CurtainMesh | None = None,
    first: CurtainSolution | None = None,
) -> Iterator[Level]:
    """The curtain on the scene's mesh and on `scene.solver.adapt` refinements of it, each with its bounds.

    The lower bound is that of an `outer` law that contains `law`. `first`: the curtain of the admissible problem on the
    first mesh where it is solved already. Ends early if a solver did not converge.
    """
    mesh = build_mesh(scene, law.cell) if mesh is None else mesh
    solution = first
    for number in range(scene.solver.adapt + 1):
        work = f"{mesh.mesh.t.shape[1]} cells"
        if solution is None or number:
            with part_of(work, 0.0, 0.5):
                solution = solve_problem(with_cones_of(admissible_problem(scene, law, mesh), solution))
        if solution.status != "converged":
            return
        with part_of(f"{work}, bounds", 0.5, 1.0):
            level = Level(solution, bound(solution, outer=outer))
        yield level
        if level.bounds.status != "converged":
            return
        if number < scene.solver.adapt:
            mesh = refine(mesh, mark(level.bounds.error))


def admissible_problem(scene: Scene, law: MembraneLaw, mesh: CurtainMesh, factor: float = 1.0) -> CurtainProblem:
    """The P2 problem of a scene with the law at the corners of the triangles; with walls the P1 problem, whose curtain
    is inside a plane where its nodes are.
    """
    quadratic = replace(scene, mesh=replace(scene.mesh, element="P2"))
    problem = make_problem(quadratic, law, mesh, factor)
    if len(problem.walls):
        return make_problem(replace(scene, mesh=replace(scene.mesh, element="P1")), law, mesh, factor)
    values, gradients = reference_shapes(skfem.ElementTriP2(), CORNERS, 6)
    weight = np.tile(problem.disc.cell_area / 3.0, 3)  # exact for linear functions
    disc = replace(problem.disc, shape_values=values, shape_gradients=gradients, weight=weight)
    return replace(problem, disc=disc, fem=problem.supports.fem(disc))


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
    if reached[-1] <= 0.0:
        return order[:0]
    return order[: int(np.searchsorted(reached, bulk * reached[-1])) + 1]
