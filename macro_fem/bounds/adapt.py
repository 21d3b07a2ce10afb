"""Meshes that follow the error: triangles that hold most of the gap between the bounds are refined."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from homogenize import MembraneLaw
from macro_fem.bounds.interval import Bounds, bound
from macro_fem.curtain import solve_problem
from macro_fem.scene.mesh import CurtainMesh, build_mesh, refine
from macro_fem.scene.schema import Scene
from macro_fem.solution import CurtainSolution, make_problem
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
    law: MembraneLaw,
    factor: float = 1.0,
    mesh: CurtainMesh | None = None,
    first: CurtainSolution | None = None,
) -> Iterator[Level]:
    """The curtain on the scene's mesh and on `scene.solver.adapt` refinements of it, each with its bounds.

    `first` is the curtain on the first mesh where it is solved already. Ends early if a solver did not converge.
    """
    mesh = build_mesh(scene, law.cell) if mesh is None else mesh
    for number in range(scene.solver.adapt + 1):
        solution = first if first and not number else solve_problem(make_problem(scene, law, mesh, factor))
        if solution.status != "converged":
            return
        level = Level(solution, bound(solution, factor))
        yield level
        if level.bounds.status != "converged":
            return
        if number < scene.solver.adapt:
            mesh = refine(mesh, marked(level.bounds.error), scene)


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
