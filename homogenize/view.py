"""A law in space: its locking surface over strains, and first yield and collapse over line loads."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from homogenize.fitting.rows import Rows, with_mirror
from homogenize.laws.picture import VERMILION, strength_loads, surface_height
from homogenize.laws.protocol import MembraneLaw
from homogenize.strength import Strength
from rve.common.errors import InputError
from rve.common.page import write_page
from rve.common.solids import Solid, quads_cut, sphere
from rve.common.types import Array
from rve.common.views import Camera, Lines, Scale, Surface, View, merged, rounded_up

SURFACE, NET = "#b8bec6", "#6b7280"
POINTS, EVERY = 81, 8
"""Points of the locking surface along each side, and how many lie between drawn lines."""
DECADES = 4.0
"""The scale of errors goes over this many powers of ten."""
FROM_OUTSIDE = Camera("outside", (1.0, -0.9, -1.3))
"""Onto the side of the surfaces that loads press against."""


def locking_view(law: MembraneLaw, rows: Rows) -> View:
    """The locking surface in strain space over the range of the rows, and the rows with their mirror images on it.

    Rows are coloured by the error of h at an S of unit trace.
    """
    both = with_mirror(rows)
    points = _in_space(both.E)
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    error = np.abs(law.support(both.S) - both.h)
    top = rounded_up(float(error.max(initial=0.0)))
    label = "error of h at the row (S of unit trace)"
    scale = Scale(label, top * 10.0**-DECADES, top, float(error.max(initial=0.0)), spread="log")
    surface, lines = _grid(_surface_points(law, both), size)
    shown = (surface, lines, _balls("rows of the table", points, error, 0.006 * size))
    title = f"Locking surface of the {law.name} law and {len(rows)} rows"
    notes = ("strains that the mesh can reach lie behind the surface: lower E11 and E22",)
    return View(title, shown, scale, (FROM_OUTSIDE,), notes, axes=("E12", "E22", "E11"), unit="")


def _in_space(values: Array) -> Array:
    """Components 11, 12, 22 as coordinates: 22 points up, 11 towards the viewer."""
    return values[..., [1, 2, 0]]


def _surface_points(law: MembraneLaw, both: Rows) -> Array:
    """Points (POINTS, POINTS, 3) of the surface over the range of the rows, nan where it lies below all of them."""
    D, G = 0.5 * (both.E[:, 0] - both.E[:, 2]), both.E[:, 1]
    grid = np.meshgrid(np.linspace(D.min() - 0.02, D.max() + 0.02, POINTS), np.linspace(G.min(), G.max(), POINTS))
    T = surface_height(law, *grid)
    T = np.where(both.E[:, [0, 2]].mean(axis=1).min() - 0.02 < T, T, np.nan)
    return _in_space(np.stack([T + grid[0], grid[1], T - grid[0]], axis=-1))


def _grid(points: Array, size: float) -> tuple[Surface, Lines]:
    """The surface through a grid of points (n, m, 3), and lines on it; both have gaps where points are nan."""
    n, m = points.shape[:2]
    flat, number = points.reshape(-1, 3), np.arange(n * m).reshape(n, m)
    is_there = np.isfinite(flat).all(axis=1)
    corners = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    triangles = quads_cut(corners[is_there[corners].all(axis=1)])
    lines = [number[::EVERY], number[:, ::EVERY].T]
    steps = np.concatenate([np.stack([line[:, :-1], line[:, 1:]], axis=-1).reshape(-1, 2) for line in lines])
    steps = steps[is_there[steps].all(axis=1)]
    used, place = np.unique(triangles, return_inverse=True)
    surface = Surface("locking surface", flat[used], place.reshape(-1, 3), SURFACE)
    name = "lines of even E12 and even E11 - E22"
    return surface, Lines(name, flat[steps], 0.001 * size, NET, width=1.5)


def _balls(name: str, points: Array, values: Array, radius: float) -> Surface:
    solids: list[Solid] = [sphere(point, radius, 8) for point in points]
    return replace(merged(name, solids, SURFACE), values=np.repeat(values, len(solids[0][0])), is_smooth=False)


def strength_view(known: Strength, yield_N_per_mm2: float | None = None) -> View:
    """First yield as a surface, coloured by S11 + S22, and collapse as a net, over all tensile line loads.

    InputError if neither the strength nor the caller has a yield stress.
    """
    stress = known.yield_stress(yield_N_per_mm2)
    first, last = (_in_space(loads) for loads in strength_loads(known, stress))
    n, m = first.shape[:2]
    number = np.arange(n * m).reshape(n, m)
    corners = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    trace = (first[..., 1] + first[..., 2]).ravel()
    scale = Scale("S11 + S22 at first yield, N/mm", float(trace.min()), rounded_up(float(trace.max())), trace.max())
    surface = Surface("first yield", first.reshape(-1, 3), quads_cut(corners), SURFACE, trace)
    size = float(np.linalg.norm(np.ptp(last.reshape(-1, 3), axis=0)))
    style = {"radius": 0.001 * size, "width": 2.0}
    lines = (
        Lines("plastic collapse", last[::6], colour=VERMILION, **style),
        Lines("plastic collapse", last[:, ::4].swapaxes(0, 1), colour=VERMILION, in_legend=False, **style),
    )
    title = f"Strength: {known.joint} rings of {known.material.name}, yield stress {stress:g} N/mm2"
    axes = ("S12", "S22", "S11")
    return View(title, (surface, *lines), scale, (FROM_OUTSIDE,), ("line loads per reference length",), axes, "N/mm")


def write_law_page(law: MembraneLaw, rows: Rows, path: str | Path, known: Strength | None = None) -> None:
    """Write the locking surface, and the strength beside it where it is `known` with a yield stress, as one HTML file.

    InputError without plotly.
    """
    views = [locking_view(law, rows)]
    try:
        views += [] if known is None else [strength_view(known)]
    except InputError as failure:
        views = [replace(views[0], notes=(*views[0].notes, str(failure)))]
    write_page(path, *views)
