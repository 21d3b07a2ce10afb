"""How much of the mesh is wire when it is seen face on: the solidity that wind drag is computed from."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from rve.drawn import DrawnRings
from rve.equilibrium.interior_point import DirectOptions
from rve.geometry.cell import Cell
from rve.geometry.pose import Pose
from rve.solve import reference_pose

POINTS = 720
"""Points on every centre circle. The shadow of a ring is short by less than r1 (2 pi / POINTS)^2 / 8 at each side."""
SIGHT_LINES = 100_000
"""Places of the cell at which the shadow is looked for, a Kronecker sequence: the solidity errs by a few 1e-4."""
STEPS = np.array([0.7548776662466927, 0.5698402909980532])
"""1/g and 1/g^2 with g^3 = g + 1: the places are no grid, with which rings could be in line."""


def solidity(cell: Cell, options: DirectOptions | None = None) -> float:
    """Projected area of the rings over the total area, in the reference state (locked under a pull along the grain).

    A ring is all points within r2 of its centre circle, so its projection is all points within r2 of the projected
    circle, an ellipse. Overlaps of rings count once. NotConverged if the reference state is not found.

    >>> round(solidity(Cell(r1=5.0, r2=0.5)), 2)
    0.36
    """
    return shadow(reference_pose(cell, options or DirectOptions()), cell.wire)


def shadow(pose: Pose, wire: float) -> float:
    """Share of the plane that the rings of one cell (n = 1) with wires of radius `wire`, in units of r1, cover.

    >>> flat = Pose(np.array([[3.0, 3.0, 0.0]]), np.zeros((1, 1, 2)), np.array([[[0.0, 0.0, 1.0]]]))
    >>> round(shadow(flat, 0.1) / (np.pi * (1.1**2 - 0.9**2) / 9.0), 3)
    1.0
    """
    axes = np.stack([pose.a1[0], pose.a2[0]])
    centre = np.pad(pose.centres[0], ((0, 0), (0, 1)))
    circles = DrawnRings(centre, pose.normals[0], 1.0, wire).circles(POINTS)[0][..., :2].reshape(-1, 2)
    shifts = np.array([[i, j] for i in range(-3, 4) for j in range(-3, 4)]) @ axes
    tree = cKDTree((shifts[:, None] + circles).reshape(-1, 2))
    places = (np.arange(SIGHT_LINES)[:, None] * STEPS % 1.0) @ axes
    distance, _ = tree.query(places, distance_upper_bound=wire)
    return float(np.isfinite(distance).mean())
