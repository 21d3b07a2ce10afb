"""Forces on a curtain: of supports in sum, at each point and as a table, of obstacles, and of what acts at points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from macro_fem.fem.cells import padded
from macro_fem.problem import CurtainProblem
from macro_fem.scene.tables import PatchLoad, PointLoad, in_3d
from macro_fem.solution import CurtainSolution
from rve.common import Array

TOUCHES = 1e-6
"""A push below this part of the loads does not count as contact of its node."""


@dataclass(frozen=True)
class PointForce:
    """A force in N at a point `at` (2,) of the reference state, and the diameter over which it is spread, mm.

    `rings` share the force at the point `place`, such as "hook 3"; none of a patch, whose rings are many.
    """

    name: str
    at: Array
    force: float
    spread: float = 0.0
    rings: int = 0
    place: str = ""


def point_forces(solution: CurtainSolution) -> Iterator[PointForce]:
    """Forces of supports that hold single points, and of loads on points and patches, at their present share."""
    problem = solution.problem
    nodes, scene, factor = problem.disc.nodes, problem.scene, problem.factor
    size = np.linalg.norm(solution.reactions, axis=1)
    for number, (item, held) in enumerate(zip(scene.support, problem.supports.held, strict=True), 1):
        of = f" of support {number}" if len(scene.support) > 1 else ""
        for count, node in enumerate(held.nodes if not len(held.facets) else (), 1):
            name, rings = f"support {number} ({held.name})", getattr(item, "rings_per_hook", 1)
            yield PointForce(name, nodes[node], float(size[node]), 0.0, rings, f"{item.one} {count}{of}")
    for number, point in enumerate(scene.of(PointLoad), 1):
        force, name = factor * float(np.linalg.norm(point.force)), f"load.point {number}"
        yield PointForce(name, np.array(point.at), force, 0.0, point.rings_per_hook, name)
    for number, patch in enumerate(scene.of(PatchLoad), 1):
        force = factor * float(np.linalg.norm(patch.force))
        yield PointForce(f"load.patch {number}", np.array(patch.at), force, 2.0 * patch.radius)


def support_forces(solution: CurtainSolution) -> list[dict[str, Any]]:
    """Force of each support on the curtain in N, in sum and at each of its nodes, and what it holds.

    A component held by two supports counts for the first, so that the forces of all points balance the loads.
    `pitch_mm` is the distance of hooks or runners along the mesh, `pitch_asked_mm` what the scene asks for. `at_mm` is
    the reference position, `place_mm`, in space, where the point is. `capacity_N` is that of each hook or runner of a
    support by hooks or a track, None if none is stated.
    `nodes_held` and `length_held_mm` also count what an earlier support holds.
    """
    problem, reactions = solution.problem, solution.reactions
    taken = np.zeros(reactions.shape, bool)
    forces = []
    for number, (item, held) in enumerate(zip(problem.scene.support, problem.supports.held, strict=True)):
        row = problem.mesh.hooks.get(number)
        own = np.zeros_like(taken)
        own[held.nodes] = held.mask
        own &= ~taken
        taken |= own
        part = np.where(own, reactions, 0.0)
        largest = float(np.linalg.norm(part, axis=1).max())
        columns = {"at_mm": problem.disc.nodes, "force_N": part}
        columns |= {"place_mm": solution.x} if part.shape[1] == 3 else {}
        found = {"support": held.name, "force_N": part.sum(axis=0).tolist(), "largest_nodal_force_N": largest}
        if not len(held.facets):
            found["largest_force_per_ring_N"] = largest / getattr(item, "rings_per_hook", 1)
        if hasattr(item, "capacity"):
            found["capacity_N"] = item.capacity
        if row:
            found |= {"pitch_mm": row.pitch, "pitch_asked_mm": getattr(item, "pitch", None)}
        nodes = held.nodes[own[held.nodes].any(axis=1)]
        points = [{name: values[node].tolist() for name, values in columns.items()} for node in nodes]
        held_mm = held_length(problem, [held.facets])
        forces.append(found | {"nodes_held": len(held.nodes), "length_held_mm": held_mm, "points": points})
    return forces


def held_length(problem: CurtainProblem, facets: list[np.ndarray]) -> float:
    """Length in mm of the facets (k,) of several supports, each counted once."""
    mesh = problem.mesh.mesh
    ends = mesh.p[:, mesh.facets[:, np.unique(np.concatenate(facets))]]
    return float(np.hypot(*(ends[:, 1] - ends[:, 0])).sum())


def support_rows(supports: list[dict[str, Any]]) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    """Columns and rows of the forces of supports point by point: number and name of the support, reference position,
    force; in space the third component of the force follows, and where the point is held.

    >>> support_rows([{"support": "top", "points": [{"at_mm": [0.0, 9.0], "force_N": [0.5, 2.0]}]}])[1]
    [(1, 'top', 0.0, 9.0, 0.5, 2.0)]
    """
    points = [(number, one["support"], point) for number, one in enumerate(supports, 1) for point in one["points"]]
    in_space = any("place_mm" in point for *_, point in points)
    more = ("force_z_N", "place_x_mm", "place_y_mm", "place_z_mm") if in_space else ()
    rows = [
        (number, name, *point["at_mm"], *(point["force_N"] or (None, None, None)), *point.get("place_mm", ()))
        for number, name, point in points
    ]
    return ("support_number", "support", "x_mm", "y_mm", "force_x_N", "force_y_N", *more), rows


def pushes_of(solution: CurtainSolution, number: int) -> tuple[np.ndarray, Array]:
    """Nodes (m,) that obstacle `number` of the scene may push, and its pushes (m, 3) on the curtain, N."""
    walls = solution.problem.walls
    if walls is None:
        return np.zeros(0, np.int64), np.zeros((0, 3))
    own = walls.take(walls.owner == number)
    nodes = np.unique(own.at.node[own.at.share != 0.0])
    nodal = own.nodal(solution.wall_forces[walls.owner == number], solution.problem.disc.n_nodes)
    return nodes, padded(nodal[nodes])


def obstacle_forces(solution: CurtainSolution) -> list[dict[str, Any]]:
    """Force of each obstacle on the curtain in N, how far it has moved, mm, and how many nodes touch it."""
    problem, lines = solution.problem, []
    for number, item in enumerate(problem.scene.obstacle):
        _, push = pushes_of(solution, number)
        touching = np.linalg.norm(push, axis=1) > TOUCHES * float(np.abs(problem.force).sum())
        lines.append(
            {
                "obstacle": item.name,
                "kind": type(item).__name__.lower(),
                "reaction_N": push.sum(axis=0).tolist(),
                "displacement_mm": float(np.linalg.norm(problem.factor * np.array(in_3d(item.move)))),
                "nodes_touched": int(np.count_nonzero(touching)),
            }
        )
    return lines


def obstacle_summary(steps: Sequence[CurtainSolution]) -> dict[str, Any]:
    """Obstacles at full load, each with its reactions and displacements over the load steps; residuals of the rounds.

    Nothing for a scene without obstacles and following pressure.
    """
    each, settling = [obstacle_forces(step) for step in steps], steps[-1].settling
    found: dict[str, Any] = {"obstacles": each[-1]} if each[-1] else {}
    for number, line in enumerate(each[-1]):
        line["steps"] = [{key: one[number][key] for key in ("displacement_mm", "reaction_N")} for one in each]
    if settling is not None:
        residuals = {name: getattr(settling, name) for name in ("rounds", "misfit", "complementarity", "asked")}
        found["settling"] = residuals | {"penetration_between_nodes_mm": settling.between_nodes_mm}
    return found
