"""The locked cell in space, as a page that turns, and its way from the slack pose, as an animation."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rve.common.drawing.page import check_page, write_page
from rve.common.drawing.plane import BLUE, VERMILION
from rve.common.drawing.scale import Scale
from rve.common.drawing.space import add, arrows, balls, check_render, compose, lines, look, new_plotter, save_animation
from rve.common.errors import InputError, NotConverged
from rve.equilibrium.interior_point import Equilibrium
from rve.equilibrium.locked_states import LockedStates
from rve.equilibrium.system import Equations
from rve.paper.stewart_trinkle import CellMotion, StewartTrinkleOptions, follow_motion
from rve.plots import CLASS_COLOURS, case_title, contacts_mm, corner_forces, drawn_rings, locked_row, swapped
from rve.table import StrainTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pyvista import Plotter

AROUND = (64, 16)
"""Points along and around a ring."""
LEAST = 0.02
"""Arrows shorter than this, in r1, are left out."""
FRAMES = 40
"""Frames of an animation, at even steps of the way."""
DIRECTION = (-0.35, 0.45, -1.0)
"""What the camera looks along."""
FORCE_NOTE = "forces under a Cauchy line load of 1 N/mm, the root of s11^2 + 2 s12^2 + s22^2"


def draw_cell_in_space(states: LockedStates, plotter: Plotter | None = None, largest: float | None = None) -> Plotter:
    """The first of the states: rings as tori, contacts coloured by force, forces between rings and on the corners.

    largest: force in N at which the scale ends and whose arrow between rings is 0.8 r1 long; by default the largest.
    On the corners an arrow has 1.2 mm per N. Returns the plotter, by default a new one.
    """
    plotter = new_plotter() if plotter is None else plotter
    cell, r1 = states.cell, states.cell.r1
    for k in range(cell.weave.classes):
        mesh = drawn_rings(states, k).tori(*AROUND)
        add(plotter, f"rings of class {k + 1}", mesh, CLASS_COLOURS[k % len(CLASS_COLOURS)])
    at, nodal = corner_forces(states)
    add(plotter, "periodic cell", lines(at[[0, 1, 3, 2, 0]][None]), "#4d4d4d", line_width=3)
    points, normals, forces = contacts_mm(states)
    forces = r1 * forces
    most = float(forces.max(initial=0.0))
    largest = max(most, 1e-12) if largest is None else largest
    if len(points):
        points, normals = swapped(points, cell), swapped(normals, cell)
        scale = Scale("force in the contact, N", 0.0, largest, most)
        add(plotter, "contacts", balls(points, 1.15 * cell.r2, **{scale.label: forces}), scale)
        ways = 0.8 * r1 * np.minimum(forces / largest, 1.5)[:, None] * normals
        pairs = arrows(np.tile(points, (2, 1)), np.concatenate([ways, -ways]), LEAST * r1)
        add(plotter, "force between rings", pairs, BLUE)
    name = f"force on a corner, longest {r1 * float(np.linalg.norm(nodal, axis=1).max()):.3g} N"
    add(plotter, name, arrows(at, 1.2 * r1 * nodal, LEAST * r1), VERMILION)
    look(plotter, DIRECTION)
    return plotter


def write_case_page(table: StrainTable, path: str | os.PathLike[str], row: int = 0) -> None:
    """Write the locked cell of a row of a table that was solved here as one HTML file.

    NotConverged or InputError where there is none, InputError without plotly.
    """
    check_page(str(path))
    write_page(path, draw_cell_in_space(locked_row(table, row)), f"{case_title(table, row)}\n{FORCE_NOTE}")


def locking_motion(table: StrainTable, row: int = 0) -> list[tuple[LockedStates, int]]:
    """States of a row on its way from the slack to the locked pose, the damped motion of the paper's scheme, with the
    step of each.

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
    return [(_moving(states, motion), int(motion.steps[0])) for motion in _even(way)]


def _moving(states: LockedStates, motion: CellMotion) -> LockedStates:
    told = (motion.R, motion.steps, np.array(["converged"]), motion.rejected)
    return replace(states, found=Equilibrium(motion.pose, motion.lam, motion.contacts, *told))


def _even(way: list[CellMotion]) -> list[CellMotion]:
    """About `FRAMES` of the motions, at even distances of rings and lattice, the first and the last among them."""
    places = np.array(
        [np.concatenate([np.ravel(m.pose.lattice), np.ravel(m.pose.centres), np.ravel(m.pose.normals)]) for m in way]
    )
    run = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    return [way[i] for i in np.unique(np.searchsorted(run, np.linspace(0.0, run[-1], FRAMES)))]


def locking_frames(table: StrainTable, row: int = 0) -> Iterator[Figure]:
    """Figures of `locking_motion` with one scale of forces and one box."""
    motion = locking_motion(table, row)
    last, steps = motion[-1]
    r1 = last.cell.r1
    largest = max(r1 * float(contacts_mm(last)[2].max(initial=0.0)), 1e-12)
    plotter, boxes = new_plotter(), []
    for states, _ in (motion[0], motion[-1]):
        draw_cell_in_space(states, plotter, largest)
        boxes.append(np.reshape(plotter.bounds, (3, 2)).T)
        plotter.clear_actors()
    box = np.stack([np.min(boxes, axis=(0, 1)), np.max(boxes, axis=(0, 1))])
    for states, step in motion:
        a, b = (r1 * float(np.linalg.norm(vector[0])) for vector in (states.pose.a1, states.pose.a2))
        told = f"alpha = {table.alpha_deg[row]:g} deg, beta = {table.beta_deg[row]:g} deg: step {step} of {steps}"
        draw_cell_in_space(states, plotter, largest)
        look(plotter, DIRECTION, box=box)
        yield compose(plotter, f"{told}\nsides of the cell {a:.2f} mm and {b:.2f} mm", FORCE_NOTE)
        plotter.clear_actors()
    plotter.close()


def write_locking(table: StrainTable, path: str | os.PathLike[str], row: int = 0) -> None:
    """Write `locking_frames` as an animation, GIF; InputError for another ending or without pyvista."""
    check_animation(path)
    save_animation(path, locking_frames(table, row))


def check_animation(path: str | os.PathLike[str]) -> None:
    """InputError if no animation of this name can be drawn."""
    if not os.fspath(path).endswith(".gif"):
        raise InputError(f"--animation = {path}: is written as GIF; give a name that ends in .gif")
    check_render("--animation", "leave it out")
