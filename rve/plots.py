"""Pictures of a locked cell with contacts and forces."""

from __future__ import annotations

from typing import Any

import numpy as np

from rve.common import Array, digits
from rve.common.drawing.plane import BLUE, VERMILION, new_axes
from rve.common.optional import Axes
from rve.geometry.cell import Cell
from rve.geometry.pattern import padded
from rve.geometry.pose import pair_geometry
from rve.locking.interior_point import LockedStates, unit_loads
from rve.locking.strings import StringStates
from rve.locking.system import lattice_load
from rve.placed.drawn import DrawnRings
from rve.table import StrainTable

CLASS_COLOURS = ("#5d6672", "#a9b0b9", "#8a7a66")
"""Rings are grey, so that forces stand out."""


def drawn_rings(states: LockedStates, k: int) -> DrawnRings:
    """The rings of class k of a single state that the weave draws."""
    cell, pose = states.cell, states.pose
    at = cell.weave.rings[cell.weave.rings[:, 0] == k, 1:]
    flat = pose.centres[0, k, :2] + at @ np.concatenate([pose.a1, pose.a2])
    centre = padded(swapped(cell.r1 * flat, cell))
    normal = np.tile(swapped(pose.normals[0, k], cell), (len(flat), 1))
    return DrawnRings(centre, normal, cell.r1 * cell.weave.radii[k], cell.r2 * cell.weave.wires[k])


def contacts_in_mm(states: LockedStates) -> tuple[Array, Array, Array]:
    """Loaded contacts of the drawn rings of a single state seen along z: points (m, 2) in mm, normals (m, 2), forces
    (m,) in units of s r1."""
    cell, pose, contacts, lam = states.cell, states.pose, states.found.contacts, states.found.lam[0]
    drawn, lattice = {tuple(ring) for ring in cell.weave.rings.tolist()}, np.concatenate([pose.a1, pose.a2])
    wires = cell.weave.wires[cell.weave.pairs[:, :2]]
    share = (wires[:, 0] / wires.sum(axis=1))[:, None, None]  # of the way between both centre circles
    rho = (1.0 - share) * contacts.rho[0]
    rho += share * (contacts.rho_b[0] + pair_geometry(pose, cell.weave)[0][0][:, None])
    rows = []
    for p, slot in np.argwhere(contacts.present[0] & (lam >= 1e-6)):
        a, b, i, j = cell.weave.pairs[p].tolist()
        point, normal = pose.centres[0, a, :2] + rho[p, slot, :2], contacts.normal[0, p, slot, :2]
        shifts = [(di, dj) for ring, di, dj in drawn if ring == a and (b, di + i, dj + j) in drawn]
        rows += [[*cell.r1 * (point + np.array(shift) @ lattice), *normal, lam[p, slot]] for shift in shifts]
    table = np.array(rows).reshape(-1, 5)
    return swapped(table[:, :2], cell), swapped(table[:, 2:4], cell), table[:, 4]


def swapped(vectors: Array, cell: Cell) -> Array:
    """Vectors (..., 2) or (..., 3) from weave axes to the axes x, y of the mesh, which the grain names."""
    return np.concatenate([vectors[..., 1::-1], vectors[..., 2:]], axis=-1) if cell.grain == "x" else vectors


def corner_forces(states: LockedStates) -> tuple[Array, Array]:
    """Corners (4, 2) of the cell of a single state in mm, and the line load on its faces as forces there (4, 2).

    Fig. 4 of the paper: the load on a face goes in equal parts to the two rings at its ends. Forces are in units of the
    size of the line load times r1.
    """
    (a1,), (a2,) = states.pose.a1, states.pose.a2
    f1, f2 = lattice_load(states.pose, unit_loads(states.s))[0].reshape(2, 2)
    at = states.cell.r1 * np.array([0 * a1, a1, a2, a1 + a2])
    return swapped(at, states.cell), swapped(0.5 * np.array([-f1 - f2, f1 - f2, f2 - f1, f1 + f2]), states.cell)


def draw_case(table: StrainTable) -> Axes:
    """The locked cell of a table of one row that was solved here and has converged, on axes of their own.

    Rings are seen along z, contact points with the forces between rings (blue) and those on the corner rings
    (vermilion).
    """
    states, ax = table.states, new_axes(6.8, 7.6)
    assert states is not None
    cell, r1 = states.cell, states.cell.r1
    for k in range(cell.weave.classes):
        x, y, _ = drawn_rings(states, k).closed_circles(96).T
        first, *_ = ax.plot(x, y, color=CLASS_COLOURS[k % len(CLASS_COLOURS)], lw=1.8)
        first.set_label(f"rings of class {k + 1}")
    at, nodal = corner_forces(states)
    ax.plot(*at[[0, 1, 3, 2, 0]].T, color="0.3", lw=0.9, ls="--", zorder=0, label="periodic cell")
    points, normals, forces = contacts_in_mm(states)
    if len(points):
        ax.scatter(points[:, 0], points[:, 1], s=18, color=BLUE, zorder=3, label="contact")
        reach = 0.5 * r1 * (forces / forces.max())[:, None] * normals
        longest = f"force between rings, longest {digits(r1 * forces.max())}"
        _arrows(ax, np.tile(points, (2, 1)), np.concatenate([reach, -reach]), BLUE, 3e-3, longest)
    largest = max(float(np.linalg.norm(nodal, axis=1).max()), 1e-300)
    _arrows(ax, at, 1.3 * r1 * nodal / largest, VERMILION, 5e-3, f"force on a corner, longest {digits(r1 * largest)}")
    for number, (place, force) in enumerate(zip(at, nodal, strict=True), 1):
        away = tuple(-11.0 * force / max(float(np.linalg.norm(force)), 1e-300))  # on the other side than the arrow
        ax.annotate(str(number), place, textcoords="offset points", xytext=away, ha="center", va="center", fontsize=11)
    ax.margins(0.12)
    ax.set(aspect="equal", xlabel="x, mm", ylabel="y, mm")
    note = "" if states.unique[0] else " (strain not unique: limit shown)"
    title = f"locked cell, alpha = {table.alpha_deg[0]:g} deg, beta = {table.beta_deg[0]:g} deg{note}"
    ax.set_title(f"{title}\nr1 = {r1:g} mm, r2 = {cell.r2:g} mm", fontsize=12)
    _legend_below(ax, title="forces in N at a line load of 1 N/mm", title_fontsize=10)
    return ax


def draw_strings(states: StringStates, row: int) -> Axes:
    """Two by two cells of rings drawn to strings, on axes of their own: wires, polygons of contacts and touching wires.

    A loop runs about each wire with the sum of both wires' radii.
    """
    cell, mesh, ax = states.cell, states.mesh, new_axes(6.8, 7.6)
    corners, touching, lattice = states.corners(row), states.contacts(row), states.lattice(row)
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    normals = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    shifts = [np.array([i, j]) @ lattice for i in range(2) for j in range(2)]
    for k in range(cell.weave.classes):
        polygon = corners[mesh.ring == k]
        around = polygon[(normals @ polygon.T).argmax(axis=1)] + cell.r1 * mesh.thin[k] * normals
        closed = polygon[[*range(len(polygon)), 0]]
        for n, shift in enumerate(shifts):
            colour, label = CLASS_COLOURS[k % len(CLASS_COLOURS)], None if n else f"wire of class {k + 1}"
            ax.plot(*(around + shift).T, color=colour, lw=1.8, label=label)
            ax.plot(*(closed + shift).T, color=BLUE, lw=0.9, label=None if n or k else "polygon of a ring")
    at = np.concatenate([touching + shift for shift in shifts])
    ax.scatter(*at.T, s=18, color=VERMILION, zorder=3, label="wires touch")
    ax.margins(0.08)
    ax.set(xlabel="x, mm", ylabel="y, mm")
    ax.set_aspect("equal", adjustable="datalim")
    E = ", ".join(f"{name} = {x:.3f}" for name, x in zip(("E11", "E12", "E22"), states.E[row], strict=True))
    ax.set_title(f"rings drawn to strings, h = {states.h[row]:.4g}\n{E}", fontsize=12)
    _legend_below(ax)
    return ax


def _legend_below(ax: Axes, **title: Any) -> None:
    """The legend of the figure of some axes, below them."""
    below: dict[str, Any] = {"loc": "outside lower center", "ncols": 2, "frameon": False}
    ax.figure.legend(fontsize=10, **title, **below)


def _arrows(ax: Axes, at: Array, way: Array, colour: str, width: float, label: str) -> None:
    """Arrows in mm that lead from `at` (n, 2) along `way` (n, 2)."""
    ax.quiver(*at.T, *way.T, angles="xy", scale_units="xy", scale=1.0, color=colour, width=width, zorder=4)
    ax.plot([], [], color=colour, marker=r"$\rightarrow$", ms=14, ls="none", label=label)
    ax.update_datalim(at + way)
