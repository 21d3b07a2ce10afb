"""Pictures of rings: of many in the plane and in space, also as files; of a locked cell with contacts and forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rve.common import Array, digits
from rve.common.drawing import space
from rve.common.drawing.plane import BLUE, VERMILION, Scale, new_axes, round_top
from rve.common.files import write_mesh_file
from rve.common.optional import Axes, Plotter
from rve.equilibrium.interior_point import LockedStates, unit_loads
from rve.equilibrium.system import lattice_load
from rve.geometry.cell import Cell
from rve.geometry.pose import pair_geometry
from rve.geometry.ring_pair import tangent_frame
from rve.table import StrainTable

CLASS_COLOURS = ("#5d6672", "#a9b0b9", "#8a7a66")
"""Rings are grey, so that forces stand out."""


ALONG, AROUND = 24, 8
"""Points along and around the wire of a ring in files: lines of 100,000 rings stay below 60 MB."""
LEAST = 3e-3
"""The scale of contact forces begins at this part of its top end."""
MOST_FINE, MOST_TUBES, MOST_POINTS = 200, 1000, 300_000
"""Of a view these numbers of rings are fine tori, and coarse ones; more are lines with this many points together."""
NO_FORCE = "#808890"


@dataclass(frozen=True, eq=False)
class DrawnRings:
    """Rings to draw: centre (n, 3) in mm, unit normal (n, 3), radii r1 and r2 in mm, and the force (n,) in N by which
    they are coloured; None for grey rings. balls: names, centres (3,) and radii in mm of balls beside them."""

    centre: Array
    normal: Array
    r1: float
    r2: float
    force: Array | None = None
    balls: tuple[tuple[str, Array, float], ...] = ()

    def circles(self, count: int) -> tuple[Array, Array]:
        """Points (n, count, 3) of the centre circles, and the unit vectors from the centre to them."""
        e1, e2 = tangent_frame(self.normal)
        t = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)[None, :, None]
        out = np.cos(t) * e1[:, None] + np.sin(t) * e2[:, None]
        return self.centre[:, None] + self.r1 * out, out

    def closed_circles(self, count: int) -> Array:
        """Points (n, count + 1, 3) of the centre circles, the last one that of the beginning."""
        return self.circles(count)[0][:, [*range(count), 0]]

    def tubes(self, along: int, around: int) -> tuple[Array, NDArray[np.intp]]:
        """Points (p, 3) and quadrilaterals (n, along * around, 4) of tori."""
        line, out = self.circles(along)
        v = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)[:, None]
        points = line[:, :, None] + self.r2 * (np.cos(v) * out[:, :, None] + np.sin(v) * self.normal[:, None, None])
        here = np.arange(along)[:, None] * around + np.arange(around)
        ahead = np.roll(here, -1, axis=0)
        quads = np.stack([here, ahead, np.roll(ahead, -1, axis=1), np.roll(here, -1, axis=1)], axis=2).reshape(-1, 4)
        first = along * around * np.arange(len(self.centre))
        return points.reshape(-1, 3), quads[None] + first[:, None, None]

    def write_vtu(self, path: Path, data: Mapping[str, Array], *, tubes: bool = False, real: type = np.float32) -> None:
        """A VTU of the centre circles, each a line of `ALONG` cells, or of the tori, by meshio.

        data: numbers per ring (n,) or (n, w), which each cell of a ring has; real: type of numbers that are not whole.
        """
        import meshio

        points, cells = self.tubes(ALONG, AROUND)
        if not tubes:
            points, here = self.circles(ALONG)[0].reshape(-1, 3), np.arange(len(self.centre) * ALONG).reshape(-1, ALONG)
            cells = np.stack([here, np.roll(here, -1, axis=1)], axis=2)
        each: dict[str, list[NDArray[Any]]] = {}
        for name, values in data.items():
            kind = np.int32 if np.issubdtype(np.asarray(values).dtype, np.integer) else real
            each[name] = [np.repeat(np.asarray(values, kind), cells.shape[1], axis=0)]
        blocks = [("quad" if tubes else "line", cells.reshape(-1, cells.shape[2]).astype(np.int32))]
        write_mesh_file(path, meshio.Mesh(points.astype(real), blocks, cell_data=each))

    def write_stl(self, path: Path, along: int = 48, around: int = 16) -> None:
        """A binary STL of the tori, closed surfaces of triangles whose normals point outwards, by meshio."""
        import meshio

        points, quads = self.tubes(along, around)
        triangles = quads[..., [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
        meshio.write(path, meshio.Mesh(points, [("triangle", triangles)]), file_format="stl", binary=True)

    def plot(self, ax: Axes | None = None, *, width: float = 0.7, series: Sequence[DrawnRings] = ()) -> Axes:
        """Centre lines of the rings seen along z, on `ax` or axes of their own; series: as of `draw`."""
        ax = new_axes(7.0, 6.0) if ax is None else ax
        from matplotlib.collections import LineCollection
        from matplotlib.patches import Circle

        grey = "0.5" if self.force is None else None  # any colour that is given would hide those of the forces
        drawn = LineCollection(list(self.closed_circles(ALONG)[:, :, :2]), linewidths=width, colors=grey)
        if self.force is not None:
            scale = force_scale(series or (self,))
            drawn.set(array=np.maximum(self.force, scale.low), cmap=scale.colour_map(), norm=scale.norm())
            scale.add_bar(ax, shrink=0.75, pad=0.02)
        ax.add_collection(drawn)
        for _, centre, radius in self.balls:
            ax.add_patch(Circle((centre[0], centre[1]), radius, color=space.BODY, alpha=space.BODY_OPACITY))
        ax.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", title=f"{len(self.centre)} rings")
        ax.autoscale_view()
        return ax

    def draw(self, plotter: Plotter | None = None, series: Sequence[DrawnRings] = ()) -> Plotter:
        """Draw the rings in space: tori where there are few, else centre lines. The plotter, by default a new one.

        series: the rings at several moments, which share colours and camera.
        """
        plotter = space.new_plotter() if plotter is None else plotter
        count = len(self.centre)
        if count <= MOST_TUBES:
            points, quads = self.tubes(*((36, 12) if count <= MOST_FINE else (20, 6)))
            mesh = space.surface(points, quads.reshape(-1, 4))
        else:
            mesh = space.lines(self.closed_circles(int(np.clip(MOST_POINTS // count, 8, ALONG))))
        colours: str | Scale = NO_FORCE
        if self.force is not None:
            colours = force_scale(series or (self,))
            mesh[colours.label] = np.repeat(self.force, mesh.n_points // count)
        space.add(plotter, "rings", mesh, colours, line_width=2)
        for name, centre, radius in self.balls:
            space.add(plotter, name, space.balls(centre, radius, 64), space.BODY, opacity=space.BODY_OPACITY)
        box = None
        if series:
            places = np.concatenate([rings.centre for rings in series])
            box = np.stack([places.min(axis=0) - self.r1, places.max(axis=0) + self.r1])
        space.look(plotter, space.THREE_QUARTERS, box=box)
        return plotter


def force_scale(rings: Sequence[DrawnRings]) -> Scale:
    """Colours of contact forces in N by their logarithm; 0.2 % of the rings are above its round top end."""
    force = np.concatenate([part.force for part in rings if part.force is not None])
    largest = float(force.max(initial=0.0))
    top = round_top(max(float(np.quantile(force, 0.998)), 1e-12), largest)
    return Scale("largest contact force on the ring, N", LEAST * top, top, largest, "log")


def drawn_rings(states: LockedStates, k: int) -> DrawnRings:
    """The rings of class k of a single state that the weave draws."""
    cell, pose = states.cell, states.pose
    at = cell.weave.rings[cell.weave.rings[:, 0] == k, 1:]
    flat = pose.centres[0, k, :2] + at @ np.concatenate([pose.a1, pose.a2])
    centre = np.pad(swapped(cell.r1 * flat, cell), ((0, 0), (0, 1)))
    normal = np.tile(swapped(pose.normals[0, k], cell), (len(flat), 1))
    return DrawnRings(centre, normal, cell.r1, cell.r2)


def contacts_in_mm(states: LockedStates) -> tuple[Array, Array, Array]:
    """Loaded contacts of the drawn rings of a single state seen along z: points (m, 2) in mm, normals (m, 2), forces
    (m,) in units of s r1."""
    cell, pose, contacts, lam = states.cell, states.pose, states.found.contacts, states.found.lam[0]
    drawn, lattice = {tuple(ring) for ring in cell.weave.rings.tolist()}, np.concatenate([pose.a1, pose.a2])
    rho = contacts.rho[0] + contacts.rho_b[0] + pair_geometry(pose, cell.weave)[0][0][:, None]
    rows = []
    for p, slot in np.argwhere(contacts.present[0] & (lam >= 1e-6)):
        a, b, i, j = cell.weave.pairs[p].tolist()
        point, normal = pose.centres[0, a, :2] + 0.5 * rho[p, slot, :2], contacts.normal[0, p, slot, :2]
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
    below: dict[str, Any] = {"loc": "outside lower center", "ncols": 2, "frameon": False}
    ax.figure.legend(fontsize=10, title="forces in N at a line load of 1 N/mm", title_fontsize=10, **below)
    return ax


def _arrows(ax: Axes, at: Array, way: Array, colour: str, width: float, label: str) -> None:
    """Arrows in mm that lead from `at` (n, 2) along `way` (n, 2)."""
    ax.quiver(*at.T, *way.T, angles="xy", scale_units="xy", scale=1.0, color=colour, width=width, zorder=4)
    ax.plot([], [], color=colour, marker=r"$\rightarrow$", ms=14, ls="none", label=label)
    ax.update_datalim(at + way)
