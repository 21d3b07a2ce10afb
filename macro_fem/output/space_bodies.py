"""Obstacles of a scene as surfaces in space, cut off where they are far larger than the curtain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from macro_fem.fem.space import padded
from macro_fem.scene.obstacles import Box, Cylinder, Floor, Obstacle, Sphere, Wall, unit
from macro_fem.scene.tables import in_3d
from macro_fem.solution import CurtainSolution
from rve.common.drawing.solids import Solid, box, cylinder, rectangle, rounded_box, sphere
from rve.common.drawing.views import Surface, merged
from rve.common.types import Array

OBSTACLE = "#c9b18f"
SHRUNK = 0.003
"""Obstacles are drawn smaller by this part of the size of the curtain."""


def ground_level(solution: CurtainSolution, room: Array, lowest: float = np.inf) -> float:
    """Height of the floor of the scene, or of a ground a little below the curtain's box `room` (2, 3) and below
    `lowest`, the y of all else that must be seen."""
    floors = [item.height + shift[1] for item, shift in _obstacles(solution) if isinstance(item, Floor)]
    below = min(float(room[0, 1] - 0.06 * np.linalg.norm(room[1] - room[0])), lowest)
    return float(max(floors)) if floors else below


def _obstacles(solution: CurtainSolution) -> list[tuple[Obstacle, Array]]:
    """The obstacles of the scene and how far each is moved (3,) at this load step, mm."""
    problem = solution.problem
    as_solved = {body.number: body.obstacle for body in problem.bodies}  # with the rounding of boxes
    items = [as_solved.get(number, item) for number, item in enumerate(problem.scene.obstacle)]
    return [(item, problem.factor * np.array(in_3d(item.move))) for item in items]


def obstacles(solution: CurtainSolution, room: Array, ground: float) -> list[Surface]:
    """What the curtain lies on, where it is at this load step, `SHRUNK` a little so that the curtain is seen on it.

    A kind that has no drawing of its own is shown by plates at the nodes that are pushed. A floor is the ground.
    """
    beside = Beside(room, ground, SHRUNK * float(np.linalg.norm(room[1] - room[0])))
    found = []
    for item, shift in _obstacles(solution):
        if isinstance(item, Floor):
            continue
        draw = DRAWN.get(type(item))
        solids = plates(solution, room) if draw is None else [draw(item, shift, beside)]
        if solids:
            opacity = 0.35 if isinstance(item, Wall) else 0.75
            is_smooth = isinstance(item, Sphere | Cylinder)
            found.append(merged(item.name, solids, OBSTACLE, is_smooth=is_smooth, opacity=opacity))
    return found


@dataclass(frozen=True, eq=False)
class Beside:
    """Where an obstacle is drawn: beside the box (2, 3) of the curtain, above the ground, smaller by `less` mm."""

    room: Array
    ground: float
    less: float

    @property
    def size(self) -> float:
        """Diagonal of the box, mm."""
        return float(np.linalg.norm(self.room[1] - self.room[0]))


def _sphere(item: Sphere, shift: Array, beside: Beside) -> Solid:
    return sphere(np.array(item.centre) + shift, item.radius - min(beside.less, 0.1 * item.radius), 64)


def _cylinder(item: Cylinder, shift: Array, beside: Beside) -> Solid:
    """The part of the endless cylinder beside the curtain."""
    axis = unit(item.axis)
    point, room = np.array(in_3d(item.point)) + shift, beside.room
    corners = np.array([[room[i, 0], room[j, 1], room[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    along = (corners - point) @ axis
    start, end = along.min() - 0.04 * beside.size, along.max() + 0.04 * beside.size
    return cylinder(point + start * axis, point + end * axis, item.radius - min(beside.less, 0.1 * item.radius), 72)


def _box(item: Box, shift: Array, beside: Beside) -> Solid:
    """The part of the box above the ground and not far from the curtain, with flat faces where it is cut off."""
    reach = 0.25 * beside.size
    corner = np.array(item.corner) + shift
    low, high = corner + beside.less, corner + np.array(item.size) - beside.less
    points, triangles = rounded_box(low, high, item.rounding) if item.rounding else box(low, high)
    least = np.maximum(beside.room[0] - reach, [-np.inf, beside.ground, -np.inf])
    most = beside.room[1] + reach
    apart = (high < least) | (low > most)
    return np.clip(points, np.where(apart, -np.inf, least), np.where(apart, np.inf, most)), triangles


def _wall(item: Wall, shift: Array, beside: Beside) -> Solid:
    """The part of the endless wall beside the curtain."""
    normal = unit(item.facing)
    point, middle = np.array(in_3d(item.point)) + shift, 0.5 * (beside.room[0] + beside.room[1])
    centre = middle - ((middle - point) @ normal + beside.less) * normal
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    return rectangle(centre, 0.5 * beside.size * first, 0.5 * beside.size * np.cross(normal, first))


DRAWN: dict[type, Callable[[Any, Array, Beside], Solid]] = {
    Sphere: _sphere,
    Cylinder: _cylinder,
    Box: _box,
    Wall: _wall,
}
"""How obstacles of each kind are drawn."""


def plates(solution: CurtainSolution, room: Array) -> list[Solid]:
    """Small plates under the nodes that half-spaces push, along their planes."""
    walls, x = solution.problem.walls, padded(solution.x)
    if walls is None or not len(solution.wall_forces):
        return []
    size, force = float(np.linalg.norm(room[1] - room[0])), solution.wall_forces
    pushed = np.flatnonzero(force > 1e-3 * force.max(initial=0.0))
    normals = padded(walls.normal[pushed])
    ends = zip(walls.only(pushed).places(x), normals, strict=True)
    return [cylinder(at - 0.004 * size * n, at, 0.01 * size, 12) for at, n in ends]
