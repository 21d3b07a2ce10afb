"""Solidity: the share of the plane that the rings of a mesh cover."""

import numpy as np
import shapely

from rve.common import Array, checked
from rve.geometry.cell import Cell
from rve.geometry.pose import Pose
from rve.geometry.ring_pair import tangent_frame
from rve.locking.interior_point import DirectOptions
from rve.solve import reference_pose

POINTS = 720
"""Points on every centre circle; four times as many make the shadow 1e-5 of itself larger."""


@checked
def solidity(cell: Cell, options: DirectOptions | None = None) -> float:
    """Projected area of the rings over the total area, in the reference state (locked under a pull along the grain).

    Overlaps of rings count once. Wind drag is computed from it. NotConverged if the reference state is not found.

    >>> round(solidity(Cell(r1=5.0, r2=0.5)), 2)
    0.36
    """
    pose, weave = reference_pose(cell, options or DirectOptions()), cell.weave
    return shadow(pose, cell.wire * weave.wires, weave.radii)


def shadow(pose: Pose, wire: Array | float, radii: Array | float = 1.0) -> float:
    """Share of the plane that the rings of one cell (n = 1) with these radii and wires of radius `wire`, in units of
    r1, (K,) or one number, cover.

    A ring is all points within r2 of its centre circle, so its projection is all points within r2 of an ellipse.

    >>> flat = Pose(np.array([[3.0, 3.0, 0.0]]), np.zeros((1, 1, 2)), np.array([[[0.0, 0.0, 1.0]]]))
    >>> [round(shadow(flat, wire) / (4.0 * np.pi * wire / 9.0), 2) for wire in (0.1, 0.003)]
    [1.0, 1.0]
    """
    axes = np.stack([pose.a1[0], pose.a2[0]])
    e1, e2 = (e[:, None, :2] for e in tangent_frame(pose.normals[0]))
    angle = np.linspace(0.0, 2.0 * np.pi, POINTS, endpoint=False)[:, None]
    radii, wire = (np.broadcast_to(size, len(pose.normals[0])) for size in (radii, wire))
    circles = pose.centres[0][:, None] + radii[:, None, None] * (np.cos(angle) * e1 + np.sin(angle) * e2)
    shifts = np.array([[i, j] for i in range(-3, 4) for j in range(-3, 4)]) @ axes
    copies = (shifts[:, None, None] + circles).reshape(-1, POINTS, 2)
    cell = shapely.Polygon([(0.0, 0.0), axes[0], axes[0] + axes[1], axes[1]])
    rings = shapely.intersection(shapely.buffer(shapely.linearrings(copies), np.tile(wire, len(shifts))), cell)
    return float(shapely.union_all(rings).area / cell.area)
