"""Rings as they are looked at: a plane picture, a view in space, and rings.png, the whole beside a close-up."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rve.common.drawing.render import colour_map
from rve.common.drawing.solids import quads_cut
from rve.common.drawing.views import PLASMA, THREE_QUARTERS, Camera, Lines, Scale, Surface, View, rounded_up
from rve.common.types import Array
from rve.localization.files import LINE, circles, tubes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection

LEAST = 3e-3
"""Contact forces below this part of the greatest one are drawn as none."""
OVER = "#000000"
"""The colour of forces above the scale."""
FINE = (36, 12)
MOST_TUBES, MOST_POINTS = 1000, 300_000
"""In a page this number of rings have the thickness of the wire; more are lines with this many points together."""
MOST_DRAWN = 2_500_000
"""Points of all tori of a picture together; many rings have coarser ones."""
CLOSE = 8.0
"""Half of the side of the close-up, in r1."""


def plot_rings(
    centre: Array, normal: Array, r1: float, force: Array | None, ax: Axes | None = None, *, width: float = 0.7
) -> Axes:
    """Centre lines of rings at `centre` with unit `normal` (n, 3), mm, seen along z, coloured by force (n,) in N.

    Rings without a force are grey.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    if ax is None:
        ax = Figure(figsize=(7.0, 6.0), layout="constrained").subplots()
    lines = circles(centre, normal, r1, LINE[0])[0][:, :, :2]
    drawn = LineCollection(list(np.concatenate([lines, lines[:, :1]], axis=1)), linewidths=width)
    ax.add_collection(drawn)
    if force is not None:
        _colour(drawn, force, ax)
    else:
        drawn.set_color("0.5")
    ax.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", title=f"{len(centre)} rings")
    ax.autoscale_view()
    return ax


def _colour(drawn: LineCollection, force: Array, ax: Axes) -> None:
    """Colours of the forces, with their bar, on a logarithmic scale."""
    from matplotlib.colors import LogNorm

    scale = force_scale(force)
    drawn.set(array=np.maximum(force, scale.low), cmap=colour_map(scale), norm=LogNorm(scale.low, scale.top))
    extend = "both" if scale.is_exceeded else "min"
    bar = ax.figure.colorbar(drawn, ax=ax, shrink=0.75, pad=0.02, extend=extend)
    above = f"; black: up to {scale.largest:.3g}" if scale.is_exceeded else ""
    bar.set_label(scale.label + above)


def force_scale(force: Array) -> Scale:
    """Colours of contact forces (n,) in N by their logarithm."""
    top = top_force(force)
    largest = float(force.max(initial=0.0))
    return Scale("largest contact force on the ring, N", LEAST * top, top, largest, PLASMA, OVER, "log")


def ring_view(title: str, placed: tuple[Array, Array], radii: tuple[float, float], force: Array) -> View:
    """Rings with centres and unit normals (n, 3), radii (r1, r2) in mm, coloured by contact force (n,) in N."""
    scale = force_scale(force)
    part: Surface | Lines
    if len(force) <= MOST_TUBES:
        around = (20, 6)
        points, quads = tubes(*placed, radii, around)
        values = np.repeat(force, around[0] * around[1])
        part = Surface("rings", points, quads_cut(quads.reshape(-1, 4)), values=values)
    else:
        count = int(np.clip(MOST_POINTS // len(force), 8, LINE[0]))
        line = circles(*placed, radii[0], count)[0]
        part = Lines("rings", np.concatenate([line, line[:, :1]], axis=1), radii[1], values=force, width=2.0)
    return View(title, (part,), scale, (THREE_QUARTERS,))


def top_force(force: Array) -> float:
    """The round force, N, at which the scale of colours ends: all but the greatest 0.2 % of the rings are below it."""
    return rounded_up(max(float(np.quantile(force, 0.998)), 1e-12))


def close_view(
    view: View, placed: tuple[Array, Array], radii: tuple[float, float], force: Array, window: tuple[Array, Array]
) -> View:
    """The view's title over two panels: all rings, and those around a point from near; forces (n,) in N.

    window: the middle of the close-up (3,) in mm, and the axes (3, 3) of the sheet there.
    """
    (centre, normal), (r1, r2), (middle, axes) = placed, radii, window
    half = CLOSE * r1
    near = (np.abs(centre - middle) < 1.7 * half).all(axis=1)
    # Wire thinner than a pixel fades away: seen from afar it is drawn a pixel thick.
    thick = max(r2, 0.6e-3 * float(np.ptp(centre, axis=0).max()))
    around = (24, 6) if len(centre) < 6000 else (int(np.clip(MOST_DRAWN // (3 * len(centre)), 8, 14)), 3)
    corners = middle + half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0]]) @ axes.T
    parts = (
        _tori("all rings", (centre, normal), (r1, thick), force, around),
        _tori("rings near by", (centre[near], normal[near]), radii, force[near], FINE),
        Lines("window of the close-up", corners[None], 1.5 * thick, "#009e73"),
    )
    front = Camera("front", (0.0, 0.0, -1.0)) if is_plane(centre) else THREE_QUARTERS
    headroom = [0.0, 0.08 * float(np.ptp(centre[:, 1])), 0.0]  # for the name of the camera
    extent = np.concatenate([centre - r1, centre + r1 + headroom])
    whole = Camera(front.name, front.direction, front.up, extent, ("rings near by",))
    right, up, to_viewer = axes.T
    tilted = -(0.6 * right - 2.2 * up + 4.2 * to_viewer)  # from below and from the side: one sees how the rings lie
    near_by = 0.9 * corners + 0.1 * middle
    name = "close-up at the largest line load"
    close = Camera(name, tuple(tilted), tuple(up), near_by, ("all rings", "window of the close-up"))
    return View(view.title, parts, view.scale, (whole, close))


def _tori(
    name: str, placed: tuple[Array, Array], radii: tuple[float, float], force: Array, around: tuple[int, int]
) -> Surface:
    points, quads = tubes(*placed, radii, around)
    return Surface(name, points, quads_cut(quads.reshape(-1, 4)), values=np.repeat(force, around[0] * around[1]))


def is_plane(centre: Array) -> bool:
    """Whether rings at `centre` (n, 3) lie in the plane z = 0, but for what their centres leave it by in a cell."""
    return bool(np.abs(centre[:, 2]).max() <= 1e-9 * np.abs(centre).max())


def middle_of_close_up(centre: Array, reference: Array, at: int, half: float) -> Array:
    """The middle of the close-up. The worst ring `at` is often in a corner: the window stays inside the curtain."""
    places = centre if is_plane(centre) else reference
    low, high = places.min(axis=0), places.max(axis=0)
    edge = np.minimum(0.85 * half, 0.5 * (high - low))
    middle = np.clip(places[at], low + edge, high - edge)
    return middle if is_plane(centre) else centre[np.argmin(((reference - middle) ** 2).sum(axis=1))]


def axes_of_sheet(normal: Array) -> Array:
    """Columns (3, 3): to the right, up and towards the viewer, for a sheet with this normal seen from its front."""
    front = normal if normal[2] >= 0.0 else -normal
    upward = np.array([0.0, 1.0, 0.0]) if abs(front[1]) < 0.9 else np.array([0.0, 0.0, -1.0])
    up = upward - (upward @ front) * front
    up /= np.linalg.norm(up)
    return np.stack([np.cross(up, front), up, front], axis=1)
