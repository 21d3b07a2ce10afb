"""Obstacles of a scene as meshes of pyvista, cut off where they are far larger than the curtain."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from macro_fem.scene.obstacles import Box, Cylinder, Floor, Obstacle, Sphere, Wall, unit
from macro_fem.scene.tables import in_3d
from macro_fem.solution import CurtainSolution
from rve.common.types import Array

if TYPE_CHECKING:
    from pyvista import PolyData

SHRUNK = 0.003
"""Obstacles are drawn smaller by this part of the size of the curtain, so that the curtain is seen on them."""
REACH = 0.25
"""Obstacles are cut off at this part of the size of the curtain away from it."""


def moved_obstacles(solution: CurtainSolution) -> list[tuple[Obstacle, Array]]:
    """The obstacles of the scene and how far each is moved (3,) at this load step, mm."""
    problem = solution.problem
    as_solved = {body.number: body.obstacle for body in problem.bodies}  # with the rounding of boxes
    items = [as_solved.get(number, item) for number, item in enumerate(problem.scene.obstacle)]
    return [(item, problem.factor * np.array(in_3d(item.move))) for item in items]


def ground_level(solution: CurtainSolution, room: Array, lowest: float = np.inf) -> float:
    """Height of the floor of the scene, or of a ground a little below the curtain's box `room` (2, 3) and below
    `lowest`, the y of all else that must be seen."""
    floors = [item.height + shift[1] for item, shift in moved_obstacles(solution) if isinstance(item, Floor)]
    below = min(float(room[0, 1] - 0.06 * np.linalg.norm(room[1] - room[0])), lowest)
    return float(max(floors)) if floors else below


def obstacle_mesh(item: Obstacle, shift: Array, room: Array, ground: float) -> PolyData | None:
    """The part of an obstacle, moved by `shift`, that is near the curtain's box `room` (2, 3) and above the ground.

    None for a floor, which is the ground, and for a kind that has no drawing.
    """
    import pyvista

    size, middle = float(np.linalg.norm(room[1] - room[0])), 0.5 * (room[0] + room[1])
    less = SHRUNK * size
    match item:
        case Sphere():
            radius = item.radius - min(less, 0.1 * item.radius)
            return pyvista.Sphere(
                radius=radius, center=np.array(item.centre) + shift, theta_resolution=64, phi_resolution=64
            )
        case Cylinder():
            axis, point = unit(item.axis), np.array(in_3d(item.point)) + shift
            centre, radius = point + ((middle - point) @ axis) * axis, item.radius - min(less, 0.1 * item.radius)
            height = 1.08 * float(np.abs(room[1] - room[0]) @ np.abs(axis))
            return pyvista.Cylinder(center=centre, direction=axis, radius=radius, height=height, resolution=72)
        case Box():
            corner = np.array(item.corner) + shift
            return _cut_box(corner + less, corner + item.size - less, item.rounding or 0.0, room, ground)
        case Wall():
            normal = unit(item.facing)
            centre = middle - ((middle - np.array(in_3d(item.point)) - shift) @ normal + less) * normal
            return pyvista.Plane(center=centre, direction=normal, i_size=size, j_size=size)
    return None


def _cut_box(low: Array, high: Array, rounding: float, room: Array, ground: float) -> PolyData:
    """A box with rounded edges, flat where it is cut off."""
    import pyvista

    radius = min(rounding, 0.499 * float((high - low).min()))
    mesh = pyvista.Box(bounds=(-1.0, 1.0) * 3, level=23 if radius > 0.0 else 0)
    # Points of a cube: the inner half of each side is the flat part of a face, the outer half its rounded edge.
    away = np.abs(mesh.points)
    out = np.tan(0.25 * np.pi * np.clip(2.0 * away - 1.0, 0.0, 1.0))
    out = radius * out / np.linalg.norm(out, axis=1, keepdims=True)
    flat = np.clip(2.0 * away, 0.0, 1.0) * (0.5 * (high - low) - radius)
    mesh.points = 0.5 * (low + high) + np.sign(mesh.points) * (flat + out)
    reach = REACH * float(np.linalg.norm(room[1] - room[0]))
    least, most = np.maximum(room[0] - reach, [-np.inf, ground, -np.inf]), room[1] + reach
    apart = (high < least) | (low > most)
    mesh.points = np.clip(mesh.points, np.where(apart, -np.inf, least), np.where(apart, np.inf, most))
    return mesh
