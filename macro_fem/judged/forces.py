"""Forces on a curtain: of supports, of obstacles and at points; in sum and as tables."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from macro_fem.curtain import CurtainSolution, CurtainState
from macro_fem.scene.meshing.mesh import point_node
from macro_fem.scene.scene import Scene
from macro_fem.scene.support_kinds import Hanging, Held
from macro_fem.scene.tables import PatchLoad, PointLoad, in_3d
from macro_fem.summary import HeldPoint, ObstacleForce, ObstacleStep, RingSupport, Rounds, SupportForce
from rve.common import Array, digits
from rve.geometry import padded

TOUCHES = 1e-6
"""A push below this part of the loads does not count as contact of its node."""
IDLE, CHANGED = 0.02, 1.2
"""Share of the largest force below which that of a point does not matter, and from how many times on its change with
the mesh is told."""


@dataclass(frozen=True)
class PointForce:
    """A force in N at a point `at` (2,) of the reference state, and the diameter over which it is spread, mm; `rings`
    share it at the point `place`, such as "hook 3", none of a patch, whose rings are many."""

    name: str
    at: Array
    force: float
    spread: float = 0.0
    rings: int = 0
    place: str = ""


def point_forces(solution: CurtainState) -> Iterator[PointForce]:
    """Forces of supports that hold single points, and of loads on points and patches, at their present share; loads at
    one node, or on patches of one radius around it, are one force."""
    problem = solution.problem
    nodes, scene, factor = problem.disc.nodes, problem.scene, problem.factor
    size = np.linalg.norm(solution.reactions, axis=1)
    for held in problem.supports.held:
        item, number = scene.support[held.number], held.number + 1
        of = f" of support {number}" if len(scene.support) > 1 else ""
        for count, node in enumerate(held.nodes if not len(held.facets) else (), 1):
            name, rings = f"support {number} ({held.name})", item.rings_per_hook
            yield PointForce(name, nodes[node], float(size[node]), 0.0, rings, f"{item.one} {count}{of}")
    spots: dict[tuple[int, float], dict[str, PointLoad | PatchLoad]] = {}
    for name, load in spot_loads(scene):
        node = int(point_node(load.at, problem.disc)[0])
        spots.setdefault((node, load.radius if isinstance(load, PatchLoad) else 0.0), {})[name] = load
    for (_, radius), own in spots.items():
        loads, name = [*own.values()], " and ".join(own)
        force = factor * float(np.linalg.norm(np.sum([in_3d(load.force) for load in loads], axis=0)))
        rings = min(load.rings_per_hook if isinstance(load, PointLoad) else 0 for load in loads)
        yield PointForce(name, np.array(loads[0].at), force, 2.0 * radius, rings, name)


def first_of_largest(sizes: Sequence[float]) -> int:
    """The first of the forces that are the largest up to 1e-4: which of two mirrored hooks bears more is rounding."""
    return int(np.argmax(np.asarray(sizes) >= 0.9999 * max(sizes)))


def spot_loads(scene: Scene) -> list[tuple[str, PointLoad | PatchLoad]]:
    """Loads at points and on patches with their names, such as "load.point 1"."""
    kinds: tuple[type[PointLoad | PatchLoad], ...] = (PointLoad, PatchLoad)
    return [(f"load.{kind.kind} {number}", one) for kind in kinds for number, one in enumerate(scene.of(kind), 1)]


def support_forces(solution: CurtainState) -> tuple[SupportForce, ...]:
    """Force of each support on the curtain in N, in sum and at each of its nodes, and what it holds: nothing of one
    that has let go.

    A component held by two supports counts for the first, so that the forces of all points balance the loads;
    `nodes_held`, `length_held_mm` and `largest_nodal_force_N` are also of what an earlier support holds.
    """
    problem, forces, scene = solution.problem, [], solution.problem.scene
    each = [Held.nothing(item.kind, number, scene.d) for number, item in enumerate(scene.support)]
    for one in problem.supports.held:
        each[one.number] = one
    shares = own_forces([held.components(solution.x.shape) for held in each], solution.reactions)
    for item, held, (own, part, largest) in zip(scene.support, each, shares, strict=True):
        columns = {"at_mm": problem.disc.nodes, "force_N": part, "place_mm": solution.x}
        row = problem.mesh.hooks.get(held.number)
        points = tuple(
            HeldPoint(point=f"{item.one} {count}", **{name: values[node].tolist() for name, values in columns.items()})
            for count, node in enumerate(held.nodes, 1)
            if own[node].any()
        )
        force = SupportForce(
            support=held.name,
            force_N=part.sum(axis=0).tolist(),
            largest_nodal_force_N=largest,
            largest_force_per_ring_N=None if len(held.facets) else largest / item.rings_per_hook,
            capacity_N=None if len(held.facets) else item.capacity,
            pitch_mm=row and row.pitch,
            pitch_asked_mm=item.pitch if isinstance(item, Hanging) else None,
            nodes_held=len(held.nodes),
            length_held_mm=float(np.hypot(*problem.mesh.sides[held.facets].T).sum()),
            points=points,
        )
        forces.append(force)
    return tuple(forces)


def change_of_forces(supports: Sequence[SupportForce], coarser: Sequence[SupportForce] | None) -> str | None:
    """By how much forces of single points differ from those on a `coarser` mesh, in a sentence; None where they hardly
    do. None for that: the mesh has one cell between two of them, and none is coarser."""
    if coarser is None:
        return (
            "cells are about as wide as hooks or runners are apart, so that no coarser mesh tells how well forces of "
            "single ones are known; they may change by more than twice: twice as many cells let them be compared"
        )
    each: list[tuple[str, float, float]] = []
    for number, (one, other) in enumerate(zip(supports, coarser, strict=True), 1):
        of = f" of support {number}" if len(supports) > 1 else ""
        for point, same in zip(one.points, other.points, strict=False):
            if one.largest_force_per_ring_N is not None:
                each.append((f"{point.point}{of}", point.size_N, same.size_N))
    if not each:
        return None
    most = max(one[1] for one in each), max(one[2] for one in each)
    bearing = [one for one in each if max(one[1:]) > IDLE * most[0]]
    name, fine, coarse = max(bearing, key=lambda one: abs(math.log(max(one[1], 1e-12) / max(one[2], 1e-12))))
    if (ratio := max(fine, coarse) / max(min(fine, coarse), 1e-12)) < CHANGED:
        return None
    return (
        f"forces of single points change with the mesh: {name} bears {digits(fine)} N, on cells twice as large "
        f"{digits(coarse)} N, {digits(ratio, 2)} times; the largest force is {digits(most[0])} N, there "
        f"{digits(most[1])} N; take more cells until they stay"
    )


def own_forces(holds: Iterable[np.ndarray], reactions: Array) -> Iterator[tuple[np.ndarray, Array, float]]:
    """Of each support, by the components (n, d) that it holds: those that none before it holds, their forces (n, d) in
    N, and the largest force at a point of all that it holds."""
    taken = np.zeros(reactions.shape, bool)
    for held in holds:
        own, largest = held & ~taken, np.linalg.norm(np.where(held, reactions, 0.0), axis=1).max(initial=0.0)
        taken |= held
        yield own, np.where(own, reactions, 0.0), float(largest)


def support_rows(supports: Sequence[SupportForce | RingSupport]) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    """Columns and rows of support_forces.csv: each point with number and name of its support, reference position, force
    and place, and its own name, if it has one.
    """
    columns = [f"{what}_{axis}_{unit}" for what, unit in (("force", "N"), ("place", "mm")) for axis in "xyz"]
    points = [(number, one.support, point) for number, one in enumerate(supports, 1) for point in one.points]
    unknown: Any = 3 * (None,)
    rows = [
        (*whose, *one.at_mm, *in_3d(tuple(one.force_N or unknown)), *in_3d(tuple(one.place_mm)), one.point)
        for *whose, one in points
    ]
    return ("support_number", "support", "x_mm", "y_mm", *columns, "point"), rows


def pushes_of(solution: CurtainState, number: int) -> Array:
    """Pushes (n_nodes, 3) of obstacle `number` of the scene on the nodes of the curtain, N."""
    return padded(solution.pushed[number])


def obstacle_forces(steps: Sequence[CurtainSolution]) -> tuple[ObstacleForce, ...]:
    """Of each obstacle the force on the curtain in N and how many nodes touch it at full load, and over the load steps
    forces and displacements, mm."""
    last, obstacles = steps[-1].problem, []
    for number, item in enumerate(last.scene.obstacle):
        push, way = [pushes_of(step, number) for step in steps], float(np.linalg.norm(item.move))
        touching = np.linalg.norm(push[-1], axis=1) > TOUCHES * float(np.abs(last.force).sum())
        curve = tuple(
            ObstacleStep(displacement_mm=step.problem.factor * way, reaction_N=one.sum(axis=0).tolist())
            for step, one in zip(steps, push, strict=True)
        )
        touched = int(np.count_nonzero(touching))
        line = ObstacleForce(
            obstacle=item.name, kind=item.kind, nodes_touched=touched, **curve[-1].parts(), steps=curve
        )
        obstacles.append(line)
    return tuple(obstacles)


def settling_of(solution: CurtainSolution) -> Rounds | None:
    """Residuals of the rounds of a shape with bodies or wind."""
    if (one := solution.settling) is None:
        return None
    return Rounds(
        rounds=one.rounds,
        misfit=one.misfit,
        complementarity=one.complementarity,
        asked=one.asked,
        smoothing=one.smoothing,
        penetration_between_nodes_mm=one.between_nodes_mm,
    )
