"""Pictures of cells: rings, contact points, normals and forces, as in Figs. 10-12 of the paper."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rve.common.errors import SENTENCES, InputError, NotConverged, require
from rve.common.files import atomic_path
from rve.common.types import Array
from rve.equilibrium.locked_states import LockedStates
from rve.equilibrium.system import lattice_load
from rve.geometry.circles import tangent_frame
from rve.table import StrainTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


CLASS_COLOURS = ("#33658a", "#d17a22", "#5b8c5a")
CONTACT_COLOUR = "#1f3fd0"
FORCE_COLOUR = "#c1121f"


def figure(width: float, height: float, **options: Any) -> tuple[Figure, Any]:
    """An empty matplotlib figure and its axes; needs the extra `plots`. Raises InputError with the way to get it."""
    require("matplotlib", "plots", "a picture")
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt.subplots(figsize=(width, height), constrained_layout=True, **options)


def save(fig: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure, atomically; the ending of the name is the format, PNG without one.

    Raises InputError for unknown endings.
    """
    import matplotlib.pyplot as plt

    try:
        with atomic_path(path) as temporary:
            fig.savefig(temporary, dpi=150, format=Path(path).suffix[1:] or "png")
    except ValueError as error:
        raise InputError(f"{path}: {str(error).splitlines()[0]}") from error
    finally:
        plt.close(fig)


def ring_points(states: LockedStates, ring: Array, count: int = 97) -> Array:
    """Centre circle (count, 3) in mm, in weave axes, of the ring (class, i, j) of the first state."""
    k, i, j = (int(x) for x in ring)
    pose = states.pose
    centre = pose.centres[0, k] + i * pose.a1[0] + j * pose.a2[0]
    e1, e2 = tangent_frame(pose.normals[0, k])
    t = np.linspace(0.0, 2.0 * np.pi, count)[:, None]
    circle = np.cos(t) * e1 + np.sin(t) * e2
    return states.cell.r1 * (circle + np.append(centre, 0.0))


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
    return np.array(points).reshape(-1, 3), np.array(normals).reshape(-1, 3), np.array(forces)


def draw_cell(ax: Axes, states: LockedStates) -> Axes:
    """Rings of the first state seen along z, contact points with normals (blue) and the forces on the corner rings
    (red); returns `ax`."""
    pose, cell = states.pose, states.cell
    swap = (lambda x: x[..., ::-1]) if cell.grain == "x" else (lambda x: x)
    for ring in cell.weave.rings:
        line = swap(ring_points(states, ring)[:, :2])
        colour = CLASS_COLOURS[int(ring[0]) % len(CLASS_COLOURS)]
        ax.plot(*line.T, color=colour, lw=1.6, solid_capstyle="round")
    a1, a2 = cell.r1 * pose.a1[0], cell.r1 * pose.a2[0]
    corners = swap(np.array([0 * a1, a1, a1 + a2, a2, 0 * a1]))
    ax.plot(*corners.T, color="0.45", lw=0.8, ls="--", zorder=0)
    points, normals, forces = contacts_mm(states)
    if len(points):
        flat, tips = swap(points[:, :2]), swap(normals[:, :2])
        ax.scatter(flat[:, 0], flat[:, 1], s=16, color=CONTACT_COLOUR, zorder=3)
        reach = 0.5 * cell.r1 * (forces / forces.max())[:, None] * tips
        for sign in (1.0, -1.0):
            ax.quiver(
                *flat.T, *(sign * reach).T, angles="xy", scale_units="xy", scale=1.0, color=CONTACT_COLOUR, width=3e-3
            )
    f, _ = lattice_load(pose, states.s)
    f1, f2 = f[0, :2], f[0, 2:]
    # Fig. 4: the line load on a face goes in equal parts to the two rings at its ends.
    nodal = swap(0.5 * np.array([-f1 - f2, f1 - f2, f2 - f1, f1 + f2]))
    at = swap(np.array([0 * a1, a1, a2, a1 + a2]))
    size = 1.3 * cell.r1 / max(np.abs(nodal).max(), 1e-300)
    ax.quiver(
        *at.T, *(size * nodal).T, angles="xy", scale_units="xy", scale=1.0, color=FORCE_COLOUR, width=5e-3, zorder=4
    )
    for number, place in enumerate(at, 1):
        ax.annotate(str(number), place, textcoords="offset points", xytext=(4, 4), fontsize=9)
    ax.set_aspect("equal")
    ax.margins(0.12)
    ax.set_xlabel("x in mm")
    ax.set_ylabel("y in mm")
    return ax


def draw_case(table: StrainTable, row: int = 0) -> Figure:
    """Picture of the locked cell of a row of a table that was solved here.

    Raises NotConverged for a row that has not converged, InputError for a table without `states`.
    """
    status = str(table.status[row])
    if status != "converged":
        raise NotConverged(f"{status}: {SENTENCES[status]}")
    if table.states is None:
        raise InputError("a table read from a file has no locked states to draw; solve it again with solve_table")
    states, cell = table.states.take(np.array([row])), table.states.cell
    fig, ax = figure(6.4, 6.8)
    draw_cell(ax, states)
    note = "" if states.unique[0] else " (strain not unique: limit shown)"
    ax.set_title(
        f"locked cell, alpha = {table.alpha_deg[row]:g} deg, beta = {table.beta_deg[row]:g} deg{note}\n"
        f"r1 = {cell.r1:g} mm, r2 = {cell.r2:g} mm; contacts and forces between rings blue, line-load forces red",
        fontsize=9,
    )
    return fig
