"""A law in space: its locking surface over strains, and first yield and collapse over line loads."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from homogenize.fitting.bounds import bounds_of
from homogenize.fitting.rows import LockedRows, with_mirror
from homogenize.laws.pictures import strength_loads, surface_height
from homogenize.laws.protocol import MembraneLaw
from homogenize.strength import Strength
from rve.common.drawing.page import check_page, write_page
from rve.common.drawing.plane import VERMILION
from rve.common.drawing.scale import Scale, rounded_up
from rve.common.drawing.space import add, balls, lines, look, new_plotter, surface
from rve.common.types import Array

if TYPE_CHECKING:
    from pyvista import Plotter

POINTS, EVERY = 81, 8
"""Points of the locking surface along each side, and how many lie between drawn lines."""
DECADES = 3.0
"""The scale of gaps goes over this many powers of ten."""
FROM_OUTSIDE = (1.0, -0.9, -1.3)
"""Onto the side of the surfaces that loads press against."""


def draw_locking(law: MembraneLaw, rows: LockedRows, plotter: Plotter | None = None) -> Plotter:
    """The locking surface in strain space over the range of the rows, and the rows with their mirror images on it.

    The surface is coloured by how far the bounds of h from these rows are apart at the load normal to it. Coordinates
    are E12, E22, E11. Returns the plotter, by default a new one.
    """
    plotter = new_plotter() if plotter is None else plotter
    E, gap = surface_with_gap(law, rows, POINTS)
    at, points = _in_space(with_mirror(rows).E), _in_space(E)
    size, scale = float(np.linalg.norm(np.ptp(at, axis=0))), gap_scale(gap)
    _add_grid(plotter, "locking surface", points, scale, gap)
    nets = points[::EVERY], points[:, ::EVERY].swapaxes(0, 1)
    pieces = np.concatenate([np.stack([net[:, :-1], net[:, 1:]], axis=-2).reshape(-1, 2, 3) for net in nets])
    pieces = pieces[np.isfinite(pieces).all(axis=(1, 2))]
    add(plotter, "lines of even E12 and E11 - E22", lines(pieces), "#3f4650", line_width=1.5)
    add(plotter, "rows of the table", balls(at, 0.005 * size), "#000000")
    look(plotter, FROM_OUTSIDE)
    return plotter


def gap_scale(gap: Array) -> Scale:
    """Colours of gaps between bounds of h, nan where there is none, by their logarithm."""
    largest = float(np.nanmax(gap, initial=0.0))
    top = rounded_up(largest)
    return Scale("outer - inner bound of h (S of unit trace)", top * 10.0**-DECADES, top, largest, "log")


def _in_space(values: Array) -> Array:
    """Components 11, 12, 22 as coordinates: 22 points up, 11 towards the viewer."""
    return values[..., [1, 2, 0]]


def surface_with_gap(law: MembraneLaw, rows: LockedRows, count: int) -> tuple[Array, Array]:
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


def _add_grid(plotter: Plotter, name: str, points: Array, scale: Scale, values: Array) -> None:
    """The surface through a grid of points (n, m, 3), coloured by values (n, m), with gaps where points are nan."""
    number = np.arange(points[..., 0].size).reshape(points.shape[:2])
    quads = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    flat = points.reshape(-1, 3)
    is_whole = np.isfinite(flat[quads]).all(axis=(1, 2))
    used, place = np.unique(quads[is_whole], return_inverse=True)
    mesh = surface(flat[used], place.reshape(-1, 4))
    mesh[scale.label] = values.ravel()[used]
    add(plotter, name, mesh, scale)


def draw_strength(known: Strength, yield_N_per_mm2: float | None = None, plotter: Plotter | None = None) -> Plotter:
    """First yield as a surface, coloured by S11 + S22, and collapse as a net, over all tensile line loads.

    Coordinates are S12, S22, S11 in N/mm. Returns the plotter, by default a new one; InputError if neither the strength
    nor the caller has a yield stress.
    """
    first, last = (_in_space(loads) for loads in strength_loads(known, known.yield_stress(yield_N_per_mm2)))
    plotter = new_plotter() if plotter is None else plotter
    trace = first[..., 1] + first[..., 2]
    top = float(trace.max())
    _add_grid(plotter, "first yield", first, Scale("S11 + S22, N/mm", float(trace.min()), rounded_up(top), top), trace)
    add(plotter, "plastic collapse", lines(last[::6]), VERMILION, line_width=2)
    add(plotter, "_plastic collapse", lines(last[:, ::4].swapaxes(0, 1)), VERMILION, line_width=2)
    look(plotter, FROM_OUTSIDE)
    return plotter


def write_law_page(law: MembraneLaw, rows: LockedRows, path: str | Path, known: Strength | None = None) -> None:
    """Write the locking surface, and the strength beside it where it is `known` with a yield stress, as one HTML file.

    InputError without plotly.
    """
    check_page(str(path))
    told = [f"Locking surface of the {law.name} law, {len(rows)} rows\nstrains that the mesh can reach lie behind it"]
    stress = None if known is None else known.material.yield_N_per_mm2
    plotter = new_plotter(1 if stress is None else 2)
    draw_locking(law, rows, plotter)
    if known is not None and stress is not None:
        told.append(f"Strength: {known.joint} rings of {known.material.name}\nyield stress {stress:g} N/mm2")
        plotter.subplot(0, 1)
        draw_strength(known, stress, plotter)
    elif known is not None:
        told[0] += f"\n{known.material.name} has no yield stress, so no strength is drawn"
    write_page(path, plotter, *told, axes=(("E12", "E22", "E11"), ("S12, N/mm", "S22, N/mm", "S11, N/mm")))
