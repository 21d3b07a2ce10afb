"""Meshes that follow the error: triangles that hold most of the gap between the bounds are refined."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from homogenize import LawInterval, MembraneLaw
from macro_fem.bounds.admissible import admissible_problem
from macro_fem.bounds.interval import Bounds, bound
from macro_fem.curtain import solve_problem
from macro_fem.scene.meshing.mesh import CurtainMesh, build_mesh, refine
from macro_fem.scene.schema import Scene
from macro_fem.solution import CurtainSolution, Problem
from macro_fem.solvers.cones import supported, taken_from
from rve.common.progress import part_of
from rve.common.types import Array

BULK = 0.6
"""Share of the gap whose triangles are refined in one go (W. Doerfler, doi 10.1137/0733054)."""


@dataclass(frozen=True, eq=False)
class Level:
    """The curtain on one mesh and its bounds."""

    solution: CurtainSolution
    bounds: Bounds


def levels(
    scene: Scene,
    law: MembraneLaw | LawInterval,
    factor: float = 1.0,
    mesh: CurtainMesh | None = None,
    first: CurtainSolution | None = None,
) -> Iterator[Level]:
    """The curtain on the scene's mesh and on `scene.solver.adapt` refinements of it, each with its bounds.

    Of an interval of laws the curtain is that of the inner law, and the lower bound that of the outer one. `first` is
    the curtain of the admissible problem on the first mesh where it is solved already. Ends early if a solver did not
    converge.
    """
    own, outer = (law.inner, law.outer) if isinstance(law, LawInterval) else (law, None)
    mesh = build_mesh(scene, own.cell) if mesh is None else mesh
    solution = first
    for number in range(scene.solver.adapt + 1):
        work = f"{mesh.mesh.t.shape[1]} cells"
        if solution is None or number:
            with part_of(work, 0.0, 0.5):
                solution = solve_problem(with_cones_of(admissible_problem(scene, own, mesh, factor), solution))
        if solution.status != "converged":
            return
        with part_of(f"{work}, bounds", 0.5, 1.0):
            level = Level(solution, bound(solution, factor, outer))
        yield level
        if level.bounds.status != "converged":
            return
        if number < scene.solver.adapt:
            mesh = refine(mesh, marked(level.bounds.error), scene)


def with_cones_of(problem: Problem, before: CurtainSolution | None) -> Problem:
    """The problem, to begin with the half-spaces of an earlier solution at the nearest points, under its own law."""
    if before is None or before.cones is None:
        return problem
    _, nearest = cKDTree(_moved_in(before.problem)).query(_moved_in(problem))
    return replace(problem, cones=supported(taken_from(before.cones, nearest), problem.law))


def _moved_in(problem: Problem) -> Array:
    """Points of the discretisation, drawn to the middle of their triangles so that each has its own, (n_points, 2)."""
    disc = problem.disc
    middle = disc.cell_mean(disc.points)
    return 0.5 * (disc.points + np.tile(middle, (disc.n_quad, 1)))


def marked(error: Array, bulk: float = BULK) -> np.ndarray:
    """The fewest triangles that together hold the part `bulk` of the error, largest first.

    >>> marked(np.array([1.0, 5.0, 0.0, 4.0])).tolist()
    [1, 3]
    """
    order = np.argsort(-error, kind="stable")
    reached = np.cumsum(np.maximum(error[order], 0.0))
    if reached[-1] <= 0.0:
        return order[:0]
    return order[: int(np.searchsorted(reached, bulk * reached[-1])) + 1]
