"""The locked cell in space, as a page that turns, and its way from the slack pose, as an animation."""

from __future__ import annotations

import os

import numpy as np

from rve.common.drawing.page import write_page
from rve.common.drawing.render import check_render, render
from rve.common.drawing.solids import Solid, arrow, quads_cut, sphere
from rve.common.drawing.views import Camera, Lines, Scale, Surface, View, merged
from rve.common.errors import InputError, NotConverged
from rve.common.types import Array
from rve.equilibrium.interior_point import Equilibrium
from rve.equilibrium.locked_states import LockedStates
from rve.equilibrium.system import Equations
from rve.localization.files import tubes
from rve.paper.stewart_trinkle import Motion, StewartTrinkleOptions, follow_motion
from rve.plots import (
    CLASS_COLOURS,
    CONTACT_COLOUR,
    FORCE_COLOUR,
    case_title,
    contacts_mm,
    corner_forces,
    locked_row,
    swapped,
)
from rve.table import StrainTable

AROUND = (64, 16)
"""Points along and around a ring."""
LEAST = 0.02
"""Forces below this part of the largest one have no arrow."""
FRAMES = 40
"""Frames of an animation, at even steps of the way."""
CAMERA = Camera("cell", (-0.35, 0.45, -1.0))
FORCE_NOTE = "forces under a Cauchy line load of 1 N/mm, the root of s11^2 + 2 s12^2 + s22^2"


def cell_view(states: LockedStates, title: str, largest: float | None = None) -> View:
    """The first of the states: rings as tori, contacts coloured by force, forces between rings and on the corners.

    largest: force in N at which the scale ends and whose arrow between rings is 0.8 r1 long; by default the largest.
    On the corners an arrow has 1.2 mm per N.
    """
    r1 = states.cell.r1
    points, normals, forces = contacts_mm(states)
    forces = r1 * forces
    largest = max(float(forces.max(initial=0.0)), 1e-12) if largest is None else largest
    scale = Scale("force in the contact, N", 0.0, largest, float(forces.max(initial=0.0)))
    parts = [*_rings(states), _outline(states)]
    if len(points):
        points, normals = swapped(points, states.cell), swapped(normals, states.cell)
        parts.append(_balls(points, forces, 1.15 * states.cell.r2))
        pairs = np.concatenate([normals, -normals]) * np.tile(np.minimum(forces / largest, 1.5), 2)[:, None]
        parts += _arrows("force between rings", CONTACT_COLOUR, np.tile(points, (2, 1)), 0.8 * r1 * pairs, r1)
    at, nodal = corner_forces(states)
    most = float(np.linalg.norm(nodal, axis=1).max())
    name = f"force on a corner, longest {r1 * most:.3g} N"
    parts += _arrows(name, FORCE_COLOUR, at, 1.2 * r1 * nodal, r1)
    return View(title, tuple(parts), scale, (CAMERA,), (FORCE_NOTE,))


def _rings(states: LockedStates) -> list[Surface | Lines]:
    """Tori of the rings that the weave draws, one surface for each class."""
    pose, cell, found = states.pose, states.cell, []
    for k in range(cell.weave.classes):
        shifts = cell.weave.rings[cell.weave.rings[:, 0] == k, 1:]
        if not len(shifts):
            continue
        flat = pose.centres[0, k] + shifts @ np.stack([pose.a1[0], pose.a2[0]])
        centre = swapped(cell.r1 * np.column_stack([flat, np.zeros(len(flat))]), cell)
        normal = np.tile(swapped(pose.normals[:1, k], cell), (len(flat), 1))
        points, quads = tubes(centre, normal, (cell.r1, cell.r2), AROUND)
        colour = CLASS_COLOURS[k % len(CLASS_COLOURS)]
        found.append(Surface(f"rings of class {k + 1}", points, quads_cut(quads.reshape(-1, 4)), colour))
    return list(found)


def _outline(states: LockedStates) -> Lines:
    """The parallelogram of the lattice vectors."""
    at, _ = corner_forces(states)
    return Lines("periodic cell", at[[0, 1, 3, 2, 0]][None], 0.02 * states.cell.r1, "#4d4d4d", width=2.0)


def _balls(points: Array, forces: Array, radius: float) -> Surface:
    solids = [sphere(point, radius, 16) for point in points]
    surface = merged("contacts", solids, CONTACT_COLOUR)
    values = np.repeat(forces, len(solids[0][0]))
    return Surface("contacts", surface.points, surface.triangles, CONTACT_COLOUR, values)


def _arrows(name: str, colour: str, tails: Array, ways: Array, r1: float) -> list[Surface | Lines]:
    length = np.linalg.norm(ways, axis=1)
    drawn = np.flatnonzero(length > LEAST * r1)
    solids: list[Solid] = [arrow(tails[i], ways[i], min(0.05 * r1, 0.1 * length[i])) for i in drawn]
    return [merged(name, solids, colour)] if solids else []


def case_view(table: StrainTable, row: int = 0) -> View:
    """The locked cell of a row of a table that was solved here; NotConverged or InputError where there is none."""
    return cell_view(locked_row(table, row), case_title(table, row))


def write_case_page(table: StrainTable, path: str | os.PathLike[str], row: int = 0) -> None:
    """Write the locked cell of a row as one HTML file; InputError without plotly."""
    write_page(path, case_view(table, row))


def locking_views(table: StrainTable, row: int = 0) -> list[View]:
    """The cell of a row on its way from the slack to the locked pose, the damped motion of the paper's scheme.

    Its contacts give way by the paper's stiffness. NotConverged if the row is not, or the motion does not come to rest.
    """
    states = locked_row(table, row)
    options = StewartTrinkleOptions(r1_mm=states.cell.r1, density=states.cell.density)
    way = follow_motion(states.s, Equations.of(states.cell.weave, states.cell.wire), options)
    if way[-1].R[0] >= options.tolerance:
        raise NotConverged(
            f"the motion of the paper's scheme has not come to rest in {len(way)} steps: R = {way[-1].R[0]:.1e}; "
            "ask for --plot or --html, which show the locked cell of the direct solver"
        )
    last = _moving(states, way[-1])
    largest = max(states.cell.r1 * float(contacts_mm(last)[2].max(initial=0.0)), 1e-12)
    title = f"alpha = {table.alpha_deg[row]:g} deg, beta = {table.beta_deg[row]:g} deg"
    views = []
    for motion in _even(way):
        x2, x3 = (states.cell.r1 * float(np.linalg.norm(vector[0])) for vector in (motion.pose.a1, motion.pose.a2))
        told = f"{title}: step {motion.steps[0]} of {way[-1].steps[0]}\nsides of the cell {x2:.2f} mm and {x3:.2f} mm"
        views.append(cell_view(_moving(states, motion), told, largest))
    return views


def _moving(states: LockedStates, motion: Motion) -> LockedStates:
    found = Equilibrium(
        motion.pose, motion.lam, motion.contacts, motion.R, motion.steps, np.array(["converged"]), motion.rejected
    )
    return LockedStates(found, states.s, states.unique, states.cell, states.reach)


def _even(way: list[Motion]) -> list[Motion]:
    """About `FRAMES` of the motions, at even distances of rings and lattice, the first and the last among them."""
    places = np.array(
        [np.concatenate([np.ravel(m.pose.lattice), np.ravel(m.pose.centres), np.ravel(m.pose.normals)]) for m in way]
    )
    run = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    return [way[i] for i in np.unique(np.searchsorted(run, np.linspace(0.0, run[-1], FRAMES)))]


def write_locking(table: StrainTable, path: str | os.PathLike[str], row: int = 0) -> None:
    """Write `locking_views` as an animation, GIF; InputError for another ending or without pyvista."""
    check_animation(path)
    render(path, locking_views(table, row))


def check_animation(path: str | os.PathLike[str]) -> None:
    """InputError if no animation of this name can be drawn."""
    if not os.fspath(path).endswith(".gif"):
        raise InputError(f"--animation = {path}: is written as GIF; give a name that ends in .gif")
    check_render("--animation", "leave it out")
