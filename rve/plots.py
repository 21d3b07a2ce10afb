"""Pictures of cells: rings, contact points, normals and forces, as in Figs. 10-12 of the paper, in the plane and in
space; and the way of a cell from the slack to the locked pose, as an animation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rve.common.drawing.page import write_page
from rve.common.drawing.plane import BLUE, VERMILION, new_axes
from rve.common.drawing.scale import Scale
from rve.common.drawing.space import add, arrows, balls, compose, lines, look, new_plotter, save_animation
from rve.common.errors import SENTENCES, InputError, NotConverged
from rve.common.files import AnyPath
from rve.common.types import Array
from rve.drawn import DrawnRings
from rve.equilibrium.interior_point import Equilibrium, unit_loads
from rve.equilibrium.locked_states import LockedStates
from rve.equilibrium.system import Equations, lattice_load
from rve.geometry.cell import Cell
from rve.paper.stewart_trinkle import CellMotion, StewartTrinkleOptions, solve
from rve.table import StrainTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pyvista import Plotter

CLASS_COLOURS = ("#5d6672", "#a9b0b9", "#8a7a66")
"""Rings are grey, so that forces stand out."""
AROUND = (64, 16)
"""Points along and around a ring in space."""
LEAST = 0.02
"""Arrows shorter than this, in r1, are left out in space."""
FRAMES = 40
"""Frames of an animation, at even steps of the way."""
DIRECTION = (-0.35, 0.45, -1.0)
"""What the camera looks along."""
FORCE_NOTE = "forces under a Cauchy line load of 1 N/mm, the root of s11^2 + 2 s12^2 + s22^2"


def drawn_rings(states: LockedStates, k: int, shifts: Array | None = None) -> DrawnRings:
    """The rings of class k of the first state, by default those that the weave draws, at lattice shifts (m, 2)."""
    cell, pose = states.cell, states.pose
    at = cell.weave.rings[cell.weave.rings[:, 0] == k, 1:] if shifts is None else shifts
    flat = pose.centres[0, k] + at @ np.stack([pose.a1[0], pose.a2[0]])
    centre = swapped(cell.r1 * np.column_stack([flat, np.zeros(len(flat))]), cell)
    normal = np.tile(swapped(pose.normals[0, k], cell), (len(flat), 1))
    return DrawnRings(centre, normal, cell.r1, cell.r2)


def contacts_mm(states: LockedStates) -> tuple[Array, Array, Array]:
    """Loaded contacts of the drawn rings of the first state: points (m, 3) in mm, normals (m, 3), forces (m,)."""
    cell, pose, contacts = states.cell, states.pose, states.contacts
    drawn = {tuple(int(x) for x in ring) for ring in cell.weave.rings}
    points, normals, forces = [], [], []
    for p, slot in np.argwhere(contacts.present[0] & (states.lam[0] >= 1e-6)):
        rho_a, rho_b = contacts.rho[0, p, slot], contacts.rho_b[0, p, slot]
        a, b, i, j = (int(x) for x in cell.weave.pairs[p])
        for ring, di, dj in drawn:
            if ring != a or (b, di + i, dj + j) not in drawn:
                continue
            origin = pose.centres[0, a] + di * pose.a1[0] + dj * pose.a2[0]
            target = pose.centres[0, b] + (di + i) * pose.a1[0] + (dj + j) * pose.a2[0]
            points.append(0.5 * cell.r1 * (rho_a + rho_b + np.append(origin + target, 0.0)))
            normals.append(contacts.normal[0, p, slot])
            forces.append(states.lam[0, p, slot])
    at, along = (swapped(np.array(part).reshape(-1, 3), cell) for part in (points, normals))
    return at, along, np.array(forces)


def swapped(vectors: Array, cell: Cell) -> Array:
    """Vectors (..., 2) or (..., 3) from weave axes to the axes x, y of the mesh, which the grain names."""
    return np.concatenate([vectors[..., 1::-1], vectors[..., 2:]], axis=-1) if cell.grain == "x" else vectors


def corner_forces(states: LockedStates) -> tuple[Array, Array]:
    """Corners (4, 3) of the cell of the first state in mm, and the line load on its faces as forces there (4, 3).

    Fig. 4 of the paper: the load on a face goes in equal parts to the two rings at its ends. Forces are in units of the
    size of the line load times r1.
    """
    pose, cell = states.pose, states.cell
    a1, a2 = cell.r1 * pose.a1[0], cell.r1 * pose.a2[0]
    f, _ = lattice_load(pose, unit_loads(states.s))
    f1, f2 = f[0, :2], f[0, 2:]
    at = np.array([0 * a1, a1, a2, a1 + a2])
    nodal = 0.5 * np.array([-f1 - f2, f1 - f2, f2 - f1, f1 + f2])
    return tuple(swapped(np.pad(part, ((0, 0), (0, 1))), cell) for part in (at, nodal))  # type: ignore[return-value]


def locked_row(table: StrainTable, row: int = 0) -> LockedStates:
    """The locked state of a row of a table that was solved here.

    Raises NotConverged for a row that has not converged, InputError for a table without `states`.
    """
    status = str(table.status[row])
    if status != "converged":
        raise NotConverged(f"{status}: {SENTENCES[status]}")
    if table.states is None:
        raise InputError("a table read from a file has no locked states to draw; solve it again with solve_table")
    return table.states.take(np.array([row]))


def case_title(table: StrainTable, row: int = 0) -> str:
    """Two lines above the picture of the locked cell of a row."""
    states = locked_row(table, row)
    note = "" if states.unique[0] else " (strain not unique: limit shown)"
    return (
        f"locked cell, alpha = {table.alpha_deg[row]:g} deg, beta = {table.beta_deg[row]:g} deg{note}\n"
        f"r1 = {states.cell.r1:g} mm, r2 = {states.cell.r2:g} mm"
    )


def draw_case(table: StrainTable, row: int = 0, ax: Axes | None = None) -> Axes:
    """The locked cell of a row of a table that was solved here, on `ax` or axes of their own, which it returns.

    Rings are seen along z, contact points with the forces between rings (blue) and those on the corner rings
    (vermilion). Raises NotConverged for a row that has not converged, InputError for a table without `states`.
    """
    states = locked_row(table, row)
    ax = new_axes(6.8, 7.6) if ax is None else ax
    cell, r1 = states.cell, states.cell.r1
    for k in range(cell.weave.classes):
        x, y, _ = drawn_rings(states, k).closed_circles(96).T
        first, *_ = ax.plot(x, y, color=CLASS_COLOURS[k % len(CLASS_COLOURS)], lw=1.8)
        first.set_label(f"rings of class {k + 1}")
    at, nodal = (part[:, :2] for part in corner_forces(states))
    ax.plot(*at[[0, 1, 3, 2, 0]].T, color="0.3", lw=0.9, ls="--", zorder=0, label="periodic cell")
    points, normals, forces = contacts_mm(states)
    if len(points):
        ax.scatter(points[:, 0], points[:, 1], s=18, color=BLUE, zorder=3, label="contact")
        reach = 0.5 * r1 * (forces / forces.max())[:, None] * normals[:, :2]
        longest = f"force between rings, longest {r1 * forces.max():.3g}"
        _arrows(ax, np.tile(points[:, :2], (2, 1)), np.concatenate([reach, -reach]), BLUE, 3e-3, longest)
    largest = max(float(np.linalg.norm(nodal, axis=1).max()), 1e-300)
    _arrows(ax, at, 1.3 * r1 * nodal / largest, VERMILION, 5e-3, f"force on a corner, longest {r1 * largest:.3g}")
    for number, (place, force) in enumerate(zip(at, nodal, strict=True), 1):
        away = tuple(-11.0 * force / max(float(np.linalg.norm(force)), 1e-300))  # on the other side than the arrow
        ax.annotate(str(number), place, textcoords="offset points", xytext=away, ha="center", va="center", fontsize=11)
    ax.margins(0.12)
    ax.set(aspect="equal", xlabel="x, mm", ylabel="y, mm")
    ax.set_title(case_title(table, row), fontsize=12)
    below: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.1), "ncols": 2, "frameon": False}
    ax.legend(fontsize=10, title="forces in N at a line load of 1 N/mm", title_fontsize=10, **below)
    return ax


def _arrows(ax: Axes, at: Array, way: Array, colour: str, width: float, label: str) -> None:
    """Arrows in mm that lead from `at` (n, 2) along `way` (n, 2)."""
    style: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "color": colour, "width": width}
    ax.quiver(*at.T, *way.T, zorder=4, **style)
    ax.plot([], [], color=colour, marker=r"$\rightarrow$", ms=14, ls="none", label=label)
    ax.update_datalim(at + way)


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
        scale = Scale("force in the contact, N", 0.0, largest, most)
        add(plotter, "contacts", balls(points, 1.15 * cell.r2, **{scale.label: forces}), scale)
        ways = 0.8 * r1 * np.minimum(forces / largest, 1.5)[:, None] * normals
        pairs = arrows(np.tile(points, (2, 1)), np.concatenate([ways, -ways]), LEAST * r1)
        add(plotter, "force between rings", pairs, BLUE)
    name = f"force on a corner, longest {r1 * float(np.linalg.norm(nodal, axis=1).max()):.3g} N"
    add(plotter, name, arrows(at, 1.2 * r1 * nodal, LEAST * r1), VERMILION)
    look(plotter, DIRECTION)
    return plotter


def write_case_page(table: StrainTable, path: AnyPath) -> None:
    """Write the locked cell of the first row of a table that was solved here as one HTML file.

    NotConverged or InputError where there is none, InputError without plotly.
    """
    write_page(path, draw_cell_in_space(locked_row(table)), f"{case_title(table)}\n{FORCE_NOTE}")


def locking_motion(table: StrainTable) -> list[tuple[LockedStates, int]]:
    """About `FRAMES` states of the first row on its way from the slack to the locked pose, the damped motion of the
    paper's scheme, at even distances of rings and lattice, with the step of each.

    Its contacts give way by the paper's stiffness. NotConverged if the row is not, or the motion does not come to rest.
    """
    states = locked_row(table)
    options = StewartTrinkleOptions(r1_mm=states.cell.r1, density=states.cell.density)
    way: list[CellMotion] = []
    rest = solve(states.s, Equations.of(states.cell.weave, states.cell.wire), options, watch=way.append)
    if rest.status[0] != "converged":
        raise NotConverged(
            f"the motion of the paper's scheme has not come to rest in {len(way)} steps: R = {rest.R[0]:.1e}; "
            "ask for --plot or --html, which show the locked cell of the direct solver"
        )
    places = [np.concatenate([*map(np.ravel, (m.pose.lattice, m.pose.centres, m.pose.normals))]) for m in way]
    run = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    status, moving = np.array(["converged"]), []
    for i in np.unique(np.searchsorted(run, np.linspace(0.0, run[-1], FRAMES))):
        found = Equilibrium(way[i].pose, way[i].lam, way[i].contacts, way[i].R, way[i].steps, status, way[i].rejected)
        moving.append((replace(states, found=found), int(way[i].steps[0])))
    return moving


def _locking_frames(table: StrainTable) -> Iterator[Figure]:
    """Figures of `locking_motion` with one scale of forces and one box."""
    motion = locking_motion(table)
    last, steps = motion[-1]
    r1 = last.cell.r1
    largest = max(r1 * float(contacts_mm(last)[2].max(initial=0.0)), 1e-12)
    plotter, boxes = new_plotter(), []
    for states in (motion[0][0], last):
        draw_cell_in_space(states, plotter, largest)
        boxes.append(np.reshape(plotter.bounds, (3, 2)).T)
        plotter.clear_actors()
    box = np.stack([np.min(boxes, axis=(0, 1)), np.max(boxes, axis=(0, 1))])
    for states, step in motion:
        a, b = (r1 * float(np.linalg.norm(vector[0])) for vector in (states.pose.a1, states.pose.a2))
        told = f"alpha = {table.alpha_deg[0]:g} deg, beta = {table.beta_deg[0]:g} deg: step {step} of {steps}"
        draw_cell_in_space(states, plotter, largest)
        look(plotter, DIRECTION, box=box)
        yield compose(plotter, f"{told}\nsides of the cell {a:.2f} mm and {b:.2f} mm", FORCE_NOTE)
        plotter.clear_actors()
    plotter.close()


def write_locking(table: StrainTable, path: AnyPath) -> None:
    """Write the motion of the first row into the locked pose as an animation, GIF, with one scale of forces."""
    save_animation(path, _locking_frames(table))
