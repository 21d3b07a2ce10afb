"""What floors, walls and bodies do to a curtain, as numbers of the summary."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from macro_fem.fem.space import padded
from macro_fem.scene.tables import in_3d
from macro_fem.solution import CurtainSolution
from rve.common.types import Array

TOUCHES = 1e-6
"""A push below this part of the loads does not count as contact of its node."""


def pushes_of(solution: CurtainSolution, number: int) -> tuple[np.ndarray, Array]:
    """Nodes (m,) that obstacle `number` of the scene may push, and its pushes (m, 3) on the curtain, N."""
    walls = solution.problem.walls
    if walls is None:
        return np.zeros(0, np.int64), np.zeros((0, 3))
    own = walls.only(walls.owner == number)
    nodes = np.unique(own.node[own.share != 0.0])
    nodal = own.nodal(solution.wall_forces[walls.owner == number], solution.problem.disc.n_nodes)
    return nodes, padded(nodal[nodes])


def obstacle_forces(solution: CurtainSolution) -> list[dict[str, Any]]:
    """Force of each obstacle on the curtain in N, how far it has moved, mm, and how many nodes touch it."""
    scene, total = solution.problem.scene, float(np.abs(solution.problem.force).sum())
    lines = []
    for number, item in enumerate(scene.obstacle):
        _, push = pushes_of(solution, number)
        shift = solution.problem.factor * np.array(in_3d(item.move))
        lines.append(
            {
                "obstacle": item.name,
                "kind": type(item).__name__.lower(),
                "reaction_N": push.sum(axis=0).tolist(),
                "displacement_mm": float(np.linalg.norm(shift)),
                "nodes_touched": int(np.count_nonzero(np.linalg.norm(push, axis=1) > TOUCHES * total)),
            }
        )
    return lines


def summary(steps: Sequence[CurtainSolution]) -> dict[str, Any]:
    """Obstacles at full load, each with its reactions and displacements over the load steps; residuals of the rounds.

    Nothing for a scene without obstacles and following pressure.
    """
    lines = obstacle_forces(steps[-1])
    for number, line in enumerate(lines):
        each = [obstacle_forces(step)[number] for step in steps]
        line["steps"] = [{key: one[key] for key in ("displacement_mm", "reaction_N")} for one in each]
    found: dict[str, Any] = {"obstacles": lines} if lines else {}
    settling = steps[-1].settling
    if settling is not None:
        found["settling"] = {
            "rounds": settling.rounds,
            "misfit": settling.misfit,
            "complementarity": settling.complementarity,
            "asked": settling.asked,
            "penetration_between_nodes_mm": settling.between_nodes_mm,
        }
    return found
