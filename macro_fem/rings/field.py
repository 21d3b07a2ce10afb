"""What `localize` returns: every ring of a curtain, with its files, its picture and its summary."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from macro_fem.output.html_page import write_page
from macro_fem.output.images import save_picture, save_view
from macro_fem.output.pictures import Drawings, Pictures, draw_all
from macro_fem.rings.curtain import Curtain, Sites
from rve import Cell
from rve.common import Array, Index, InputError, JsonObject, checked, csv_text, digits, job, versions, write_text
from rve.common.drawing.space import THREE_QUARTERS, add, add_length, lines, look, new_plotter, sheet_axes
from rve.common.optional import Axes, Plotter
from rve.geometry import padded
from rve.placed import NEAR, POSE_MEANINGS, CellForces, DrawnRings, Fit, NearestPoses, write_solids

RECORD = "localize.json"
"""The file that stands for the job; it lists the others by their checksums."""
CLOSE, BLACK, FLAT_PART = 8.0, "#111111", 0.3
"""Radius of the close-up, in r1, the colour of the circle around it, and how thick a flat piece of mesh may be over its
smaller side."""
MOST_RENDERED = 5000
"""Rings at most that `render` draws, each a fine surface."""


@dataclass(frozen=True)
class WorstCell:
    """The cell around a ring with the largest line load: number, status of its pose, contact forces, and the turn
    (3, 3) into the curtain."""

    number: int
    pose: str
    forces: CellForces
    turn: Array

    def table(self) -> str:
        """Its contacts as CSV: rings, point, force, direction, in the axes of the curtain."""
        names = ["a_class", "a_i", "a_j", "b_class", "b_i", "b_j", "x_mm", "y_mm", "z_mm", "force_N", "nx", "ny", "nz"]
        one = self.forces
        numbers = np.column_stack([one.point @ self.turn.T, one.force, one.normal @ self.turn.T])
        pairs = zip(one.a.tolist(), one.b.tolist(), numbers, strict=True)
        return csv_text(names, ([*a, *b, *(f"{x:.12g}" for x in row)] for a, b, row in pairs))


@dataclass(frozen=True, eq=False, repr=False)
class RingField:
    """Every ring of a curtain, n rings in m cells of its mesh.

    sites: where in the reference; centre_mm, normal (n, 3): centres and unit normals in the axes of the curtain;
    states: poses of the m cells, and row (n,) the cell of each ring in it; fit: gaps and links of the rings as placed;
    contact_force_N (n,): largest contact force on each ring; worst: the cell around a ring with most line load;
    wall_s: seconds it took.
    """

    curtain: Curtain
    cell: Cell
    sites: Sites
    centre_mm: Array
    normal: Array
    states: NearestPoses
    row: Index
    fit: Fit
    contact_force_N: Array
    worst: WorstCell
    wall_s: float

    def __len__(self) -> int:
        return len(self.row)

    @property
    def status(self) -> NDArray[np.str_]:
        """How the pose of each ring relates to the strain there, (n,): a key of `rve.placed.POSE_MEANINGS`."""
        return self.states.status[self.row]

    @cached_property
    def summary(self) -> JsonObject:
        """The numbers of localize.json: lengths in mm, forces in N, line loads in N/mm."""
        cell, curtain, states, fit, worst = self.cell, self.curtain, self.states, self.fit, self.worst
        told, forces, status, gap = curtain.told, worst.forces, self.status, self.data["drawn_gap_mm"]
        names, counts = np.unique(states.status, return_counts=True)
        reference = curtain.X[curtain.triangles[worst.number]].mean(axis=0)
        return {
            "curtain": curtain.source,
            "curtain_status": told.status,
            "weave": cell.weave.name,
            "grain": cell.grain,
            "r1_mm": cell.r1,
            "r2_mm": cell.r2,
            "hang_deg": told.hang_deg,
            "rings": len(self),
            "cells": len(states.E),
            "solves": states.solves,
            "cells_by_status": {str(name): int(count) for name, count in zip(names, counts, strict=True)},
            "meanings": {str(name): POSE_MEANINGS[str(name)] for name in names},
            "largest_strain_short": float(states.short.max()),
            "largest_strain_fold": float(states.fold.max()),
            "smallest_gap_in_a_cell_mm": float(states.gap_mm.min()),
            "drawn_gap_mm_quantiles_0_5_25_50": {
                str(name): [float(x) for x in np.quantile(gap[status == name], [0.0, 0.05, 0.25, 0.5])]
                for name in np.unique(status)
            },
            "links": fit.links,
            "links_intact": fit.linked,
            "largest_contact_force_N": float(self.contact_force_N.max()),
            "ring_at_support": told.at_support,
            "worst_cell": {
                "cell": worst.number,
                "reference_mm": reference.tolist(),
                "largest_principal_line_load_N_per_mm": float(curtain.line_load[worst.number]),
                "normal": worst.turn[:, 2].tolist(),
                "pose": worst.pose,
                "alpha_deg": forces.alpha_deg,
                "beta_deg": forces.beta_deg,
                "status": forces.status,
                "contacts": len(forces.force),
                "largest_force_N": float(forces.force.max(initial=0.0)),
                "cauchy_line_load_11_12_22_N_per_mm": forces.s.tolist(),
                "line_load_of_contacts_11_12_22_N_per_mm": forces.virial.tolist(),
            },
            "wall_s": self.wall_s,
            "versions": versions(),
        }

    @property
    def drawn(self) -> DrawnRings:
        """The rings to draw, coloured by contact force."""
        cell, kind = self.cell, self.sites.index[:, 0]
        radii, wires = cell.r1 * cell.weave.radii[kind], cell.r2 * cell.weave.wires[kind]
        return DrawnRings(self.centre_mm, self.normal, radii, wires, self.contact_force_N)

    @property
    def data(self) -> dict[str, Array]:
        """Numbers per ring, (n,) or (n, w), by their names in rings.vtu; gaps are at most NEAR r1, as far as is
        searched."""
        sites, states, row = self.sites, self.states, self.row
        names = list(POSE_MEANINGS)
        code = np.array([names.index(str(status)) for status in states.status])
        return {
            "ring": np.arange(len(row)),
            "class_i_j": sites.index,
            "macro_cell": sites.triangle,
            "state_0_slack_1_wrinkled_2_taut": self.curtain.state[sites.triangle],
            f"pose_{'_'.join(f'{i}_{name}' for i, name in enumerate(names))}": code[row],
            "strain_short": states.short[row],
            "strain_fold": states.fold[row],
            "cell_gap_mm": states.gap_mm[row],
            "drawn_gap_mm": np.minimum(self.fit.gap_mm, NEAR * self.cell.r1),
            "broken_link": self.fit.broken.astype(int),
            "contact_force_N": self.contact_force_N,
            "reference_mm": padded(sites.X),
        }

    @checked
    def save(
        self,
        folder: str | Path,
        *,
        picture: bool = True,
        tubes: bool = False,
        html: bool = False,
        solids: str | None = None,
        render: bool = False,
        inputs: Iterable[str | Path | None] = (),
    ) -> JsonObject:
        """Write rings.vtu, worst_cell.csv, localize.json and rings.png into `folder`; the summary.

        `tubes`: write tori instead of centre lines; `solids`: "3mf", "glb" or "stl", writes rings.3mf and so on, for
        printers, CAD and browsers; `html`: rings.html, which turns in a browser; `render`: render.png, the rings as
        metal with their shadow; rings.png: all rings beside those around the cell with the largest line load. All but
        pictures appear together, and what they replace is gone (`rve.common.files`). InputError where they cannot be
        written or would overwrite one of `inputs`, or if what a picture needs is missing, or for too many rings to
        `render`; NotDrawn, when all else is in place, for pictures that fail.
        """
        Pictures(picture or render, html=html, stem="rings").check(in_space=True)
        if render and len(self) > MOST_RENDERED:
            raise InputError(f"--render: draws {MOST_RENDERED} rings at most, and here are {len(self)}: give --window")
        inputs = list(inputs)
        with job(folder, RECORD, self.summary, inputs) as staged:
            self.drawn.write_vtu(staged / "rings.vtu", self.data, tubes=tubes)
            write_text(staged / "worst_cell.csv", self.worst.table())
            if solids:
                write_solids(staged / f"rings.{solids}", self.drawn)
        drawings: Drawings = {"rings.html": self.write_html} if html else {}
        drawings |= {"rings.png": self._draw} if picture else {}
        drawings |= {"render.png": lambda path: save_view(path, self.drawn.render())} if render else {}
        draw_all(folder, RECORD, self.summary, drawings, inputs)
        return self.summary

    def _draw(self, path: Path) -> None:
        worst, reference = self.summary["worst_cell"], self.data["reference_mm"][:, :2]
        at = int(np.argmin(((reference - worst["reference_mm"]) ** 2).sum(axis=1)))
        save_picture(path, self.draw_close_up(at, np.array(worst["normal"])), self._title)

    @property
    def _title(self) -> str:
        apart = f"{self.fit.links - self.fit.linked} of {self.fit.links} links"
        return f"{len(self)} rings, {apart} drawn open, as cells are placed one by one"

    def write_html(self, path: str | Path) -> None:
        """Write the rings as one HTML file that turns in a browser without a network, coloured by contact force, tori
        where there are few of them, else their centre lines; InputError without plotly."""
        write_page(path, self.drawn.draw, self._title)

    def draw_close_up(self, at: int, sheet_normal: Array) -> Plotter:
        """A plotter with two panels: all rings, and those around ring number `at` from near, by their forces.

        sheet_normal (3,): of the sheet at that ring.
        """
        rings, centre, half, plotter = self.drawn, self.centre_mm, CLOSE * self.cell.r1, new_plotter(2)
        plotter.subplot(0, 0)
        rings.draw(plotter)
        window = replace(rings, centre=centre[at][None], normal=sheet_normal[None], r1=half)
        size = float(np.linalg.norm(np.ptp(centre, axis=0)))
        if 3.0 * half < size:
            add(plotter, "close-up at the largest line load", lines(window.closed_circles(96)), BLACK, line_width=6)
        axes = self._axes
        add_length(plotter, np.vstack([centre, centre - [0.0, 2.0 * self.cell.r1, 0.0]]), size, axes)
        is_plane = np.abs(centre[:, 2]).max() <= 1e-9 * np.abs(centre).max()
        tilt = [0.0, 0.0, -1.0] if is_plane else [0.3, -0.25, -1.0]
        look(plotter, THREE_QUARTERS if axes is None else np.array(tilt) @ axes)
        plotter.subplot(0, 1)
        near = np.linalg.norm(centre - centre[at], axis=1) < 1.3 * half
        force = self.contact_force_N[near]
        r1, r2 = (np.asarray(radii)[near] for radii in (rings.r1, rings.r2))
        part = DrawnRings(centre[near], self.normal[near], r1, r2, force)
        part.draw(plotter, (rings,))
        front = sheet_normal if sheet_normal[2] >= 0.0 else -sheet_normal
        up = np.array([0.0, 1.0, 0.0] if abs(front[1]) < 0.9 else [0.0, 0.0, -1.0])
        from_below = 2.2 * up - 0.6 * np.cross(up, front) - 4.2 * front  # and from the side: one sees how the rings lie
        look(plotter, from_below, up)
        return plotter

    @property
    def _axes(self) -> Array | None:
        """Right, up and front of the mesh where it is flat; None where it is bent."""
        away = self.centre_mm - self.centre_mm.mean(axis=0)
        size = np.linalg.svd(away, compute_uv=False)
        is_bent = len(size) < 3 or size[2] > FLAT_PART * size[1]
        return None if is_bent else sheet_axes(self.centre_mm)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Centre lines of all rings seen from the front, coloured by contact force, on `ax` or axes of their own."""
        return self.drawn.plot(ax)

    def __str__(self) -> str:
        counts = ", ".join(f"{count} {name}" for name, count in self.summary["cells_by_status"].items())
        force = digits(self.summary["largest_contact_force_N"], 4)
        return (
            f"RingField: {len(self)} rings in {len(self.states.E)} cells ({counts}), {self.fit.linked} of "
            f"{self.fit.links} links intact, contact forces up to {force} N"
        )

    __repr__ = __str__
