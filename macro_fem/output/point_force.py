"""What rings bear at hooks, corners and loaded points, from the force there instead of the cells of the mesh.

The force goes through the ring or the few rings that the hook passes: `hook_rings`. The mesh around is next:

Around a force f at a point the line load grows until it is spread over the rings of one cell of the weave. A mesh whose
cells are larger spreads f over its own cells: utilisation is then too low in proportion to the side of the cells. But f
itself, and the direction m (reference) along which the curtain takes it up, hardly depend on the mesh. Balance says
that S carries f through every section across m,

    S = f / (w lambda) m m^T,

with lambda the stretch along m at which rings lock, and w the width of the averages of `macro_fem.output.line_load`:
their area over the longest chord along the line from the point. If all of f goes along that line this is the largest
average of the continuous curtain; if f fans out it is more than that, at most by the ratio of this chord to the radius
of the average at the point itself (1.4 at a square corner, 1 to 2 at an edge). Utilisation is an estimate, no bound:
rings are weaker along other lines of the fan, up to twofold. At the corners of examples/corner_hung.toml it is 0.76,
that of averages on cells of 1.5 mm 0.83 (docs/measured/steel.md).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from homogenize import Strength
from macro_fem.fem.hung_law import largest_stretch
from macro_fem.output.forces import PointForce, point_forces
from macro_fem.output.line_load import Nearby, Peak
from macro_fem.solution import CurtainSolution
from rve import pulled_ring
from rve.common.tensor import dyad
from rve.common.types import Array

RESOLVED = 0.125
"""Sides of mesh cells at a point over that of the averaging area with which the averages themselves are used."""
STEPS = np.linspace(0.0, 1.5, 7)
"""Centres of averages along the line of the force, in radii of the average at the point."""
SHARPEST = np.pi / 6.0
"""Angle of a corner in which averages reach farthest; bounds their chord, so that few points are looked at."""


def hook_rings(solution: CurtainSolution, known: Strength) -> list[Peak]:
    """The ring that bears most of all at hooks, corners, runners, held and loaded points: its utilisations at first
    yield and at collapse; [] without any.

    Each of the rings there is pulled by two opposed forces, its share of the force and that of its neighbours
    (`rve.pulled_ring`). A butted ring turns on its hook, so its joint is where it is worst.
    """
    cell, points = solution.problem.law.cell, [one for one in point_forces(solution) if one.rings]
    if cell is None or not points:
        return []
    joint = "welded" if known.joint == "welded" else "butted:worst"
    ring = pulled_ring(cell.r1_mm, cell.r2_mm, known.material, joint)
    most = max(points, key=lambda one: one.force / one.rings)
    limits = ring.first_yield_N, ring.collapse_N
    return [Peak(most.force / most.rings / limit, most.at, force=most) for limit in limits]


def largest_borne(
    solution: CurtainSolution, near: Nearby, S: Array, value: Callable[[Array], Array], most: float
) -> Peak:
    """The largest value that any force at a point asks for, where the mesh is too coarse to tell; 0 without any.

    `near`: averages of the line loads S (n_cells, 3) of the curtain in its own frame; `value` (n,) of line loads (n, 3)
    in the frame of the weave, at most `most` times their trace.
    """
    law, best = solution.problem.law, Peak(0.0, np.full(2, np.nan))
    longest = 2.0 * np.sqrt(2.0 * near.area / SHARPEST)
    for one in sorted(point_forces(solution), key=lambda one: -one.force):
        if one.force * longest / near.area * most <= best.value:
            break
        cells = _cells_at(solution, one)
        side = float(np.sqrt(solution.problem.disc.cell_area[cells].max()))
        if side <= RESOLVED * max(np.sqrt(near.area), one.spread):
            continue
        m = _direction(solution, S, cells, one.at)
        if m is None:
            continue
        width = max(near.area / _chord(near, one.at, m), one.spread)
        load = law.in_weave(one.force / (width * float(largest_stretch(law, m[None])[0])) * dyad(m[None]))
        found = float(value(load)[0])
        best = Peak(found, one.at, load[0], one) if found > best.value else best
    return best


def _cells_at(solution: CurtainSolution, one: PointForce) -> np.ndarray:
    """Numbers of the mesh cells that touch a point, or whose corners lie in its patch; the nearest one if none do."""
    mesh = solution.problem.mesh
    distance = np.linalg.norm(mesh.mesh.p - one.at[:, None], axis=0)
    near = max(0.5 * one.spread, float(distance.min())) + 1e-9 * mesh.size
    return np.flatnonzero((distance[mesh.mesh.t] <= near).any(axis=0))


def _direction(solution: CurtainSolution, S: Array, cells: np.ndarray, at: Array) -> Array | None:
    """The reference direction (2,) of the larger principal line load of some cells, into the curtain; None if slack."""
    mesh, area = solution.problem.mesh.mesh, solution.problem.disc.cell_area[cells]
    S11, S12, S22 = area @ S[cells] / area.sum()
    if not np.hypot(S11 - S22, 2.0 * S12) + S11 + S22 > 0.0:
        return None
    angle = 0.5 * np.arctan2(2.0 * S12, S11 - S22)
    m = np.array([np.cos(angle), np.sin(angle)])
    inwards = area @ mesh.p[:, mesh.t[:, cells]].mean(axis=1).T / area.sum() - at
    return m if inwards @ m >= 0.0 else -m


def _chord(near: Nearby, at: Array, m: Array) -> float:
    """Longest part in mm of the line from `at` (2,) along m (2,) that lies in one of the averages centred on it."""
    steps = STEPS * near.radius_at(at)
    radii = [near.radius_at(at + t * m) for t in steps]
    return max(radius + min(t, radius) for t, radius in zip(steps, radii, strict=True))
