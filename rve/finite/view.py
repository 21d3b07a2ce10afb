"""A finite mesh of rings in space: its rings coloured by contact force, what holds it, and with which forces."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rve.common.drawing.solids import arrow, sphere
from rve.common.drawing.views import FRONT, THREE_QUARTERS, Surface, View, merged
from rve.localization.picture import ring_view

if TYPE_CHECKING:
    from rve.finite.solution import FiniteSolution

HELD, REACTION, NO_FORCE = "#009e73", "#0072B2", "#808890"
LEAST = 1e-3
"""Forces of supports below this part of the largest one have no arrow."""


def finite_view(solution: FiniteSolution) -> View:
    """The rings of a solution; grey where there are no forces because supports are out of reach."""
    cell, has_forces = solution.mesh.cell, bool(np.isfinite(solution.force).all())
    force = np.nan_to_num(solution.largest_force)
    height = f"mean height {solution.mean_height:.1f} mm, lowest point {solution.centre[:, 1].min():.1f} mm"
    title = f"{len(solution.centre)} rings: {solution.status}\n{height}"
    view = ring_view(title, (solution.centre, solution.normal), (cell.r1, cell.r2), force)
    if not has_forces:
        rings = replace(view.parts[0], values=None, colour=NO_FORCE)
        return replace(view, parts=(rings,), scale=None, cameras=(FRONT, THREE_QUARTERS))
    return replace(view, parts=(*view.parts, *_supports(solution)), cameras=(FRONT, THREE_QUARTERS))


def _supports(solution: FiniteSolution) -> list[Surface]:
    """Balls at held rings, and arrows of the forces on them."""
    r1, size = solution.mesh.cell.r1, float(np.linalg.norm(np.ptp(solution.centre, axis=0)))
    force = np.linalg.norm(solution.reaction, axis=1)
    held = np.flatnonzero(force > LEAST * force.max(initial=0.0))
    if not len(held):
        return []
    ball = max(0.5 * r1, 0.004 * size)
    balls = [sphere(solution.centre[i], ball, 12) for i in held]
    way = 0.15 * size * solution.reaction / force.max()
    arrows = [arrow(solution.centre[i], way[i], min(0.006 * size, 0.1 * float(np.linalg.norm(way[i])))) for i in held]
    name = f"force of supports, longest {force.max():.3g} N"
    return [merged("held rings", balls, HELD), merged(name, arrows, REACTION)]
