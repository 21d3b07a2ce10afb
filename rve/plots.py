"""Pictures of cells: rings, contact points, normals and forces, as in Figs. 10-12 of the paper."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rve.common.errors import SENTENCES, InputError, NotConverged, require
from rve.common.files import atomic_path
from rve.common.types import Array
from rve.equilibrium.interior_point import DirectOptions, Equilibrium
from rve.equilibrium.system import lattice_load
from rve.geometry.cell import Cell
from rve.geometry.circles import tangent_frame
from rve.solve import locked

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
    """Write a figure whole or not at all; the ending of the name is the format, PNG without one.

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


def ring_points(found: Equilibrium, case: int, ring: Array, cell: Cell, count: int = 97) -> Array:
    """Centre circle (count, 3) in mm, in weave axes, of the ring (class, i, j)."""
    k, i, j = (int(x) for x in ring)
    pose = found.pose
    centre = pose.centres[case, k] + i * pose.a1[case] + j * pose.a2[case]
    e1, e2 = tangent_frame(pose.normals[case, k])
    t = np.linspace(0.0, 2.0 * np.pi, count)[:, None]
    circle = np.cos(t) * e1 + np.sin(t) * e2
    return cell.r1 * (circle + np.append(centre, 0.0))


def contacts_mm(found: Equilibrium, case: int, cell: Cell) -> tuple[Array, Array, Array]:
    """Loaded contacts of the drawn rings: points (m, 3) in mm, normals (m, 3), forces (m,) in units of s r1."""
    weave, pose = cell.weave, found.pose
    drawn = {tuple(int(x) for x in ring) for ring in weave.rings}
    shift = found.contacts.take(np.array([case]))
    slots = np.argwhere(shift.present[0])
    points, normals, forces = [], [], []
    for (p, slot), normal, rho_a, rho_b in zip(
        slots, shift.minima.normal, shift.minima.rho_a, shift.minima.rho_b, strict=True
    ):
        force = found.lam[case, p, slot]
        if force < 1e-6:
            continue
        a, b, i, j = (int(x) for x in weave.pairs[p])
        for ring, di, dj in drawn:
            if ring != a or (b, di + i, dj + j) not in drawn:
                continue
            origin = pose.centres[case, a] + di * pose.a1[case] + dj * pose.a2[case]
            target = pose.centres[case, b] + (di + i) * pose.a1[case] + (dj + j) * pose.a2[case]
            middle = 0.5 * (rho_a + rho_b + np.append(origin + target, 0.0))
            points.append(cell.r1 * middle)
            normals.append(normal)
            forces.append(force)
    return np.array(points).reshape(-1, 3), np.array(normals).reshape(-1, 3), np.array(forces)


def draw_cell(ax: Axes, found: Equilibrium, case: int, s: Array, cell: Cell) -> Axes:
    """Rings seen along z, contact points with normals (blue) and the forces on the corner rings (red); returns `ax`."""
    pose = found.pose
    swap = (lambda x: x[..., ::-1]) if cell.grain == "x" else (lambda x: x)
    for ring in cell.weave.rings:
        line = swap(ring_points(found, case, ring, cell)[:, :2])
        colour = CLASS_COLOURS[int(ring[0]) % len(CLASS_COLOURS)]
        ax.plot(*line.T, color=colour, lw=1.6, solid_capstyle="round")
    a1, a2 = cell.r1 * pose.a1[case], cell.r1 * pose.a2[case]
    corners = swap(np.array([0 * a1, a1, a1 + a2, a2, 0 * a1]))
    ax.plot(*corners.T, color="0.45", lw=0.8, ls="--", zorder=0)
    points, normals, forces = contacts_mm(found, case, cell)
    if len(points):
        flat, tips = swap(points[:, :2]), swap(normals[:, :2])
        ax.scatter(flat[:, 0], flat[:, 1], s=16, color=CONTACT_COLOUR, zorder=3)
        reach = 0.5 * cell.r1 * (forces / forces.max())[:, None] * tips
        for sign in (1.0, -1.0):
            ax.quiver(
                *flat.T, *(sign * reach).T, angles="xy", scale_units="xy", scale=1.0, color=CONTACT_COLOUR, width=3e-3
            )
    f, _ = lattice_load(pose.take(np.array([case])), s[case : case + 1])
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


def draw_case(alpha_deg: float, beta_deg: float, cell: Cell, options: DirectOptions | None = None) -> Figure:
    """Picture of the locked cell under one load direction; raises NotConverged."""
    found, s, unique = locked(np.array([alpha_deg]), np.array([beta_deg]), cell, options or DirectOptions())
    status = str(found.status[0])
    if status != "converged":
        raise NotConverged(f"{status}: {SENTENCES[status]}")
    fig, ax = figure(6.4, 6.8)
    draw_cell(ax, found, 0, s, cell)
    note = "" if unique[0] else " (strain not unique: limit shown)"
    ax.set_title(
        f"locked cell, alpha = {alpha_deg:g} deg, beta = {beta_deg:g} deg{note}\n"
        f"r1 = {cell.r1:g} mm, r2 = {cell.r2:g} mm; contacts and forces between rings blue, line-load forces red",
        fontsize=9,
    )
    return fig
