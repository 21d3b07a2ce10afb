"""A law in space: its locking surface over strains, and first yield and collapse over line loads."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from homogenize.fitting.bounds import bounds_of
from homogenize.fitting.rows import Rows, with_mirror
from homogenize.laws.picture import VERMILION, strength_loads, surface_height
from homogenize.laws.protocol import MembraneLaw
from homogenize.strength import Strength
from rve.common.drawing.page import write_page
from rve.common.drawing.solids import quads_cut, sphere
from rve.common.drawing.views import Camera, Lines, Scale, Surface, View, merged, rounded_up
from rve.common.errors import InputError
from rve.common.types import Array

NET, ROW = "#3f4650", "#000000"
POINTS, EVERY = 81, 8
"""Points of the locking surface along each side, and how many lie between drawn lines."""
DECADES = 3.0
"""The scale of gaps goes over this many powers of ten."""
FROM_OUTSIDE = Camera("outside", (1.0, -0.9, -1.3))
"""Onto the side of the surfaces that loads press against."""


def locking_view(law: MembraneLaw, rows: Rows) -> View:
    """The locking surface in strain space over the range of the rows, and the rows with their mirror images on it.

    The surface is coloured by how far the bounds of h from these rows are apart at the load normal to it.
    """
    both = with_mirror(rows)
    E, gap = surface_with_gap(law, rows, POINTS)
    points, balls = _in_space(E), _in_space(both.E)
    size = float(np.linalg.norm(np.ptp(balls, axis=0)))
    surface, lines = _grid(points, gap, size)
    rows_on_it = merged("rows of the table", [sphere(point, 0.005 * size, 8) for point in balls], ROW)
    title = f"Locking surface of the {law.name} law and {len(rows)} rows"
    notes = ("strains that the mesh can reach lie behind the surface: lower E11 and E22",)
    shown = (surface, lines, rows_on_it)
    return View(title, shown, gap_scale(gap), (FROM_OUTSIDE,), notes, axes=("E12", "E22", "E11"), unit="")


def gap_scale(gap: Array) -> Scale:
    """Colours of gaps between bounds of h, nan where there is none, by their logarithm."""
    largest = float(np.nanmax(gap, initial=0.0))
    top = rounded_up(largest)
    return Scale("outer - inner bound of h (S of unit trace)", top * 10.0**-DECADES, top, largest, spread="log")


def _in_space(values: Array) -> Array:
    """Components 11, 12, 22 as coordinates: 22 points up, 11 towards the viewer."""
    return values[..., [1, 2, 0]]


def surface_with_gap(law: MembraneLaw, rows: Rows, count: int) -> tuple[Array, Array]:
    """Strains (count, count, 3) on the locking surface over the range of the rows, and how far the bounds of h there
    are apart (count, count): outer less inner bound at the load of unit trace normal to the surface.

    nan where the surface lies below all rows.
    """
    both, bounds = with_mirror(rows), bounds_of(rows)
    D, G = 0.5 * (both.E[:, 0] - both.E[:, 2]), both.E[:, 1]
    grid = np.meshgrid(np.linspace(D.min() - 0.02, D.max() + 0.02, count), np.linspace(G.min(), G.max(), count))
    T = surface_height(law, *grid)
    T = np.where(both.E[:, [0, 2]].mean(axis=1).min() - 0.02 < T, T, np.nan)
    E = np.stack([T + grid[0], grid[1], T - grid[0]], axis=-1)
    gap = np.full(T.shape, np.nan)
    is_there = np.isfinite(T)
    S = law.cut(E[is_there]).S
    gap[is_there] = np.maximum(bounds.upper(S) - bounds.lower(S), 0.0)
    return E, gap


def _grid(points: Array, values: Array, size: float) -> tuple[Surface, Lines]:
    """The surface through a grid of points (n, m, 3), and lines on it; both have gaps where points are nan."""
    n, m = points.shape[:2]
    flat, number = points.reshape(-1, 3), np.arange(n * m).reshape(n, m)
    is_there = np.asarray(np.isfinite(flat).all(axis=1))
    corners = _quads(number)
    triangles = quads_cut(corners[is_there[corners].all(axis=1)])
    lines = [number[::EVERY], number[:, ::EVERY].T]
    steps = np.concatenate([np.stack([line[:, :-1], line[:, 1:]], axis=-1).reshape(-1, 2) for line in lines])
    steps = steps[is_there[steps].all(axis=1)]
    used, place = np.unique(triangles, return_inverse=True)
    surface = Surface("locking surface", flat[used], place.reshape(-1, 3), values=values.ravel()[used])
    return surface, Lines("lines of even E12 and E11 - E22", flat[steps], 0.001 * size, NET, width=1.5)


def _quads(number: NDArray[np.intp]) -> NDArray[np.intp]:
    """Corners (q, 4) of the quadrilaterals of a grid of numbered points."""
    return np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)


def strength_view(known: Strength, yield_N_per_mm2: float | None = None) -> View:
    """First yield as a surface, coloured by S11 + S22, and collapse as a net, over all tensile line loads.

    InputError if neither the strength nor the caller has a yield stress.
    """
    stress = known.yield_stress(yield_N_per_mm2)
    first, last = (_in_space(loads) for loads in strength_loads(known, stress))
    n, m = first.shape[:2]
    corners = _quads(np.arange(n * m).reshape(n, m))
    trace = (first[..., 1] + first[..., 2]).ravel()
    scale = Scale("S11 + S22 at first yield, N/mm", float(trace.min()), rounded_up(float(trace.max())), trace.max())
    surface = Surface("first yield", first.reshape(-1, 3), quads_cut(corners), values=trace)
    size = float(np.linalg.norm(np.ptp(last.reshape(-1, 3), axis=0)))
    thin = 0.001 * size
    lines = (
        Lines("plastic collapse", last[::6], thin, VERMILION, width=2.0),
        Lines("plastic collapse", last[:, ::4].swapaxes(0, 1), thin, VERMILION, width=2.0, in_legend=False),
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
