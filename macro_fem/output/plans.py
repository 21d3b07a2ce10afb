"""Drawings with dimensions for a report: the flat sheet and its loads, tracks in plan, a curtain from the side.

Figures have the size in mm at which they are printed; each is drawn with words of 7 points.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely

from macro_fem.curtain import CurtainSolution, placed_obstacles
from macro_fem.judged import spot_loads
from macro_fem.output import space_view
from macro_fem.output.images import Draw, compose
from macro_fem.output.pictures import draw_loads, plot_line_loads, plot_utilisation
from macro_fem.scene.loads import PER_MM2, areal_mass, loads_of_plugins, own_forces
from macro_fem.scene.obstacles import unit
from macro_fem.scene.support_kinds import Curve, Hanging, Track
from macro_fem.scene.tables import Bar, EdgeLoad, PatchLoad, Wind, in_3d
from rve.common import Array, digits
from rve.common.drawing.plane import VERMILION, as_typed, new_figure
from rve.common.drawing.space import THREE_QUARTERS, new_plotter
from rve.common.optional import Axes, Figure, Plotter
from rve.geometry import padded

INCH, WORDS, DPI = 25.4, 7.0, 250
"""mm; the size of words in points; of what is an image."""
INK, GREY, SHEET = "#111111", "#555555", "#c9d6e2"
CORNER, STRAIGHT, SAME, KINK = math.radians(45.0), math.radians(0.05), 0.05, 15.0
"""A path has a corner where it turns by more, is straight where by less; radii that differ by less are one arc's; where
an arc ends it turns by less than so many degrees."""
NAMED = 5
"""Every so many points of a row are numbered, and the first and last one."""


class TrackPart(NamedTuple):
    """A part of a track in plan, mm and degrees, turns positive to the left as seen from above: its length; its radius
    and turn, 0 where it is straight; how much the track turns at the corner where it begins."""

    length: float
    radius: float = 0.0
    turn: float = 0.0
    corner: float = 0.0


def track_parts(curve: Curve) -> list[TrackPart]:
    """Arcs and straight parts of a track in order; arcs of a path are circles through three or more neighbours.

    >>> from macro_fem.scene.meshing.edges import Line
    >>> path = Line(np.array([[0.0, 0.0], [2000.0, 0.0], [2000.0, 1000.0]]))
    >>> [tuple(map(round, part)) for part in track_parts(Curve(3000.0, 0.0, path))]
    [(2000, 0, 0, 0), (1000, 0, 0, -90)]
    """
    if curve.plan is None:
        return [TrackPart(curve.length, curve.radius, math.degrees(curve.angle))]
    way = np.diff(curve.plan.points, axis=0) * [1.0, -1.0]  # seen from above
    length = np.linalg.norm(way, axis=1)
    area = way[:-1, 0] * way[1:, 1] - way[:-1, 1] * way[1:, 0]
    turn = np.arctan2(area, (way[:-1] * way[1:]).sum(axis=1))
    bend = 2.0 * area / (length[:-1] * length[1:] * np.linalg.norm(way[:-1] + way[1:], axis=1))  # 1 / radius
    is_bent = (np.abs(turn) > STRAIGHT) & (np.abs(turn) < CORNER)
    is_alike = is_bent[:-1] & is_bent[1:] & (np.abs(np.diff(bend)) < SAME * np.abs(bend[:-1]))
    parts, k = list[TrackPart](), 0
    while k < len(length):
        end = k + 1
        while end - 1 < len(is_alike) and is_alike[end - 1]:
            end += 1
        if is_arc := end > k + 1:
            end += 1  # of the last circle through three
        else:
            while end - 1 < len(turn) and abs(turn[end - 1]) <= STRAIGHT:
                end += 1
        before = math.degrees(turn[k - 1]) if k else 0.0
        is_corner = k > 0 and (abs(before) > KINK or not (is_arc or parts[-1].radius))
        own = float(length[k:end].sum())
        radius = float(np.sign(bend[k])) * _radius(curve.plan.points[k : end + 1]) if is_arc else 0.0
        turned = math.degrees(own / radius) if is_arc else 0.0
        parts.append(TrackPart(own, abs(radius), turned, before if is_corner else 0.0))
        k = end
    return parts


def _radius(points: Array) -> float:
    """Of the circle that lies nearest to points (n, 2), in the mean of the squares; rounding of theirs cancels."""
    away = points - points.mean(axis=0)
    square = (away**2).sum(axis=1)
    *twice, rest = np.linalg.lstsq(np.column_stack([away, np.ones(len(away))]), square, rcond=None)[0]
    return float(np.sqrt(rest + 0.25 * np.square(twice).sum()))


def draw_sheet(solution: CurtainSolution, width: float, most: float) -> Figure:
    """The flat sheet with its size, what holds it, and its loads where they act with their sizes."""
    scene, mesh = solution.problem.scene, solution.problem.mesh.mesh
    (x0, y0), (x1, y1) = mesh.p.min(axis=1), mesh.p.max(axis=1)
    size = max(x1 - x0, y1 - y0)
    off = 0.07 * size
    figure, ax = _figure(width, most, (y1 - y0 + 4.2 * off) / (x1 - x0 + 3.6 * off))
    _surface(solution, ax, mesh.p.T)
    across, high = scene.curtain.extent(mesh.p.T).tolist()
    _span(ax, (x0, y0 - 2.6 * off), (x1, y0 - 2.6 * off), f"{across:g} mm")
    _span(ax, (x1 + 1.5 * off, y0), (x1 + 1.5 * off, y1), f"{high:g} mm", rotation=90)
    for item, held in zip(scene.support, solution.problem.supports.held, strict=True):
        X = solution.problem.disc.nodes[held.nodes]
        if len(held.facets):
            ax.plot(*mesh.p[:, mesh.facets[:, held.facets]], color=INK, lw=2.0)
        else:
            ax.plot(*X.T, "v", color=INK, ms=3, clip_on=False)
            _number(ax, X, 0.45 * off * np.array([0.0, 1.0]))
        if isinstance(item, Hanging) and item.has_hooks and len(X) > 1:
            apart = float(np.linalg.norm(X[1] - X[0]))
            _write(ax, 0.5 * (X[0] + X[-1]) + [0.0, 1.5 * off], f"{len(X)} {item.one}s, {digits(apart, 5)} mm apart")
    _loads_on_sheet(solution, ax, off)
    ax.set(xlim=(x0 - 1.2 * off, x1 + 2.2 * off), ylim=(y0 - 3.2 * off, y1 + 2.2 * off))
    return figure


def _loads_on_sheet(solution: CurtainSolution, ax: Axes, off: float) -> None:
    """Loads of a scene where they act, with their sizes; those that leave the plane as arrows seen from their ends."""
    from matplotlib.patches import Circle

    scene, problem = solution.problem.scene, solution.problem
    mesh, gravity = problem.mesh, np.array(scene.load.acceleration)
    middle = mesh.mesh.p.T[mesh.mesh.t.T].mean(axis=1)
    centre = np.average(middle, axis=0, weights=problem.disc.cell_area)
    edges: list[tuple[str, Array, str]] = [
        (bar.edge, bar.mass * gravity, f"bar {bar.mass:g} kg, {_size(bar.mass * gravity)} N") for bar in scene.of(Bar)
    ]
    edges += [(one.edge, np.array(in_3d(one.force)), f"{_size(one.force)} N/mm") for one in scene.of(EdgeLoad)]
    if gravity.any():
        weight = areal_mass(scene, problem.law.cell) * PER_MM2 * float(problem.disc.cell_area.sum()) * gravity
        spot = centre + [-0.38, 0.42] * np.ptp(mesh.mesh.p, axis=1)
        _arrow(ax, spot, weight, 1.5 * off, f"weight {_size(weight)} N")
    for name, force, words in edges:
        facets = mesh.mesh.facets[:, mesh.edges[name]]
        ax.plot(*mesh.mesh.p[:, facets], color=VERMILION, lw=1.6, alpha=0.6)
        nodes = np.unique(facets)
        at = mesh.mesh.p.T[nodes[np.argsort(mesh.mesh.p[:, nodes].sum(axis=0))]]
        for part in at[np.linspace(0, len(at) - 1, min(len(at), 5)).astype(int)]:
            _arrow(ax, part, force, 0.9 * off)
        _arrow(ax, at[len(at) // 2], force, 0.9 * off, words)
    for _, load in spot_loads(scene):
        if isinstance(load, PatchLoad):
            ax.add_patch(Circle(load.at, load.radius, fc="none", ec=VERMILION, lw=0.8))
        _arrow(ax, np.array(load.at), np.array(in_3d(load.force)), 1.2 * off, f"{_size(load.force)} N")
    for wind in scene.of(Wind):
        strength = f"{wind.pressure:g} N/m2" if wind.speed is None else f"{wind.speed:g} m/s"
        spots = centre + off * np.array([[-2.5, 1.5], [2.5, 1.5], [0.0, 3.0], [-2.5, -1.5]])  # not below words
        for spot in spots:
            _arrow(ax, spot, np.array(in_3d(wind.direction)), 1.2 * off)
        _arrow(ax, centre, np.array(in_3d(wind.direction)), 1.2 * off, f"wind {strength}")
    for own in loads_of_plugins(scene):
        forces = padded(own_forces(own, scene, mesh, problem.disc))
        size = np.linalg.norm(forces, axis=1)
        if size.any():
            at, total = np.average(problem.disc.nodes, axis=0, weights=size), forces.sum(axis=0)
            _arrow(ax, at, total, 1.5 * off, f"{own.kind} {_size(total)} N")


def _size(force: Any) -> str:
    return digits(float(np.linalg.norm(force)), 4)


def _arrow(ax: Axes, at: Any, force: Array, length: float, words: str = "") -> None:
    """A load at a place: an arrow in the plane, a dot in a circle towards the viewer, a cross away from it."""
    way = unit(force) if force.any() else np.zeros(3)
    tip: Any = at + length * way[:2]
    if np.hypot(*way[:2]) > 0.3:
        style = {"arrowstyle": "-|>", "color": VERMILION, "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", tip, at, arrowprops=style, zorder=6)
    else:
        ax.plot(*at, "o", color=VERMILION, mfc="white", ms=5, zorder=6)
        ax.plot(*at, "." if way[2] >= 0.0 else "x", color=VERMILION, ms=3, zorder=7)
        words += ("\ntowards the viewer" if way[2] >= 0.0 else "\naway from the viewer") * bool(words)
    if words:
        beside: Any = {"textcoords": "offset points", "va": "top", "color": VERMILION, "zorder": 8, "bbox": PAPER}
        ax.annotate(words, tip, (4, -1), **beside)


def draw_plan(solution: CurtainSolution, width: float, most: float) -> Figure:
    """The curtain from above, its tracks with lengths, radii and the distance of runners along them."""
    x = padded(solution.x)[:, [0, 2]]
    border = solution.problem.mesh.border
    tracks = [(one, held, one.along(border)[1]) for one, held in _each(solution) if isinstance(one, Track)]
    shown = np.concatenate([x, *(held.track[:, [0, 2]] for _, held, _ in tracks)])
    extent = np.maximum(np.ptp(shown, axis=0), 0.05 * solution.problem.mesh.size)
    figure, ax = _figure(width, most, extent[1] / extent[0] + 0.32)
    _surface(solution, ax, padded(solution.corners), (0, 2))
    for item, held, curve in tracks:
        line = held.track[:, [0, 2]]
        ax.plot(*line.T, color=INK, lw=2.0, alpha=0.5, solid_capstyle="butt")
        middle, away = line.mean(axis=0), 0.06 * float(extent.max())
        parts, begin = track_parts(curve), 0.0
        for part in parts if len(parts) <= MOST_PARTS else []:
            at, ahead = curve.at(np.array([begin + 0.5 * part.length, begin + 0.51 * part.length]))[:, [0, 2]]
            side = unit(np.array([(ahead - at)[1], -(ahead - at)[0], 0.0]))[:2]
            side *= -1.0 if side @ (at - middle) < 0.0 else 1.0
            told = f"R {digits(part.radius, 4)} mm\n" if part.radius else ""
            ax.update_datalim([at + 2.5 * away * side])
            words = f"{told}{digits(part.length, 5)} mm"
            apart = 30.0 * float(side[0]), -16.0 * float(side[1])  # points; z goes down
            ax.annotate(words, at, apart, textcoords="offset points", ha="center", va="center", zorder=9, bbox=PAPER)
            begin += part.length
        places = padded(solution.x)[held.nodes][:, [0, 2]]
        if item.has_hooks:
            ax.plot(*places.T, "o", color=INK, ms=3)
            _number(ax, places, np.array([0.0, -0.6 * away]))
    draw_loads(solution, ax, (0, 2))
    if ax.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower right", frameon=False)
    ax.invert_yaxis()
    _finish(ax, "x, mm", "z, mm, towards the viewer")
    return figure


PAPER = {"fc": "white", "ec": "none", "alpha": 0.8, "pad": 0.8}
"""What words stand on, where arrows may be below."""
MOST_PARTS = 12
"""Parts of a track up to which each is written beside it."""


def draw_side(solution: CurtainSolution, width: float, most: float) -> Figure:
    """The curtain from its left side, with the bodies that it meets."""
    x = padded(solution.x)[:, [2, 1]]
    extent = np.maximum(np.ptp(x, axis=0), 0.05 * solution.problem.mesh.size)
    figure, ax = _figure(width, most, extent[1] / extent[0] + 0.2)
    _surface(solution, ax, padded(solution.corners), (2, 1))
    for held in solution.problem.supports.held:
        if held.track is not None:
            ax.plot(*held.track[:, [2, 1]].T, color=INK, lw=2.0, alpha=0.5)
        if not len(held.facets):
            ax.plot(*x[held.nodes].T, "o", color=INK, ms=2)
    draw_loads(solution, ax, (2, 1))
    _finish(ax, "z, mm", "y, mm", is_slim=extent[0] < extent[1])
    return figure


def side_is_slim(solution: CurtainSolution) -> bool:
    """Whether the curtain seen from the side is narrow and high."""
    return bool(np.ptp(padded(solution.x)[:, 2]) < 0.6 * np.ptp(solution.x[:, 1]))


def draw_view(solution: CurtainSolution, width: float, most: float) -> Figure:
    """The curtain in space, coloured by its line loads, with all forces on it, from the right or, where much more of it
    is seen from there, from the left."""
    at = padded(solution.corners)[solution.problem.mesh.mesh.t.T]
    normals = np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0])
    left = (-THREE_QUARTERS[0], *THREE_QUARTERS[1:])
    seen = [np.abs(normals @ way).sum() for way in (THREE_QUARTERS, left)]
    way = left if seen[1] > 1.2 * seen[0] else THREE_QUARTERS
    return draw_views([partial(space_view.draw_curtain, solution, direction=way)], width, most)


def draw_views(views: Sequence[Draw], width: float, most: float, captions: Sequence[str] = ()) -> Figure:
    """Views in space side by side with their captions, the bar of colours and the legend below."""
    plotter = new_plotter(len(views))
    for panel, draw in enumerate(views):
        plotter.subplot(0, panel)
        draw(plotter)
    return printed(plotter, width, most, captions)


def printed(plotter: Plotter, width: float, most: float, captions: Sequence[str] = ()) -> Figure:
    """The panels of a plotter, which is closed, as a figure that is at most so high."""
    figure = compose(plotter, "", captions, width / INCH)
    plotter.close()
    figure.set_figheight(min(figure.get_figheight(), most / INCH))
    return figure


def draw_axes(width: float, height: float, plot: Callable[[Axes], Axes]) -> Figure:
    """What a function plots on axes."""
    figure = new_figure(width / INCH, height / INCH)
    plot(figure.subplots())
    return figure


def draw_hung(solution: CurtainSolution, width: float, most: float, *, used: bool = False) -> Figure:
    """The curtain as it hangs, seen from the front: its line loads, or how much its rings are used."""
    extent = np.ptp(np.vstack([solution.x[:, :2], solution.problem.disc.nodes]), axis=0)
    figure, ax = _figure(width, most, max(0.8 * extent[1] / extent[0] + 0.3, 0.62))
    (plot_utilisation if used else plot_line_loads)(solution, ax).legend().remove()
    ax.set_title("")
    ax.axis("on")
    return figure


def _each(solution: CurtainSolution) -> list[tuple[Any, Any]]:
    return list(zip(solution.problem.scene.support, solution.problem.supports.held, strict=True))


def _figure(width: float, most: float, aspect: float) -> tuple[Figure, Axes]:
    """Empty axes of equal scales on a figure of a width in mm, and as high as the aspect says, at most `most`."""
    figure = new_figure(width / INCH, min(max(width * aspect, 0.2 * width), most) / INCH)
    ax = figure.subplots()
    ax.set_aspect("equal")
    ax.axis("off")
    return figure, ax


def save_drawing(path: Path, figure: Figure) -> None:
    """Write a drawing as SVG with its words as text, the same bytes for the same drawing; triangles are an image."""
    from matplotlib import rc_context
    from matplotlib.collections import PolyCollection, TriMesh
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        text.set_fontsize(WORDS)
    for ax in figure.axes:
        ax.tick_params(labelsize=WORDS)
    for many in [*figure.findobj(TriMesh), *figure.findobj(PolyCollection)]:
        many.set_rasterized(True)
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "drawing"}):
        as_typed(figure).savefig(path, dpi=DPI, format="svg", metadata={"Date": None})


def _finish(ax: Axes, across: str, up: str, *, is_slim: bool = False) -> None:
    ax.axis("on")
    ax.set(xlabel=across, ylabel=up)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(width=0.5, length=2)
    ax.locator_params(axis="x", nbins=2 if is_slim else 6)
    ax.locator_params(axis="y", nbins=5)
    ax.autoscale_view()


def _surface(solution: CurtainSolution, ax: Axes, corners: Array, axes: tuple[int, int] = (0, 1)) -> None:
    """Two coordinates of the mesh at `corners` (n, 2 or 3) with its border, and in space what it meets."""
    from matplotlib.collections import PolyCollection

    mesh, flat = solution.problem.mesh.mesh, corners[:, axes]
    if corners.shape[1] == 3:
        for outline in _bodies(solution, axes):
            ax.fill(*outline.T, fc="#e9dfcf", ec="#9a8866", lw=0.6, zorder=0.5)
    ax.add_collection(PolyCollection(list(flat[mesh.t.T]), facecolors=SHEET, edgecolors="none", antialiaseds=False))
    ax.plot(*np.moveaxis(flat[mesh.facets[:, mesh.boundary_facets()]], -1, 0), color=GREY, lw=0.7)


def _bodies(solution: CurtainSolution, axes: tuple[int, int]) -> Iterator[Array]:
    """Outlines (n, 2) of the convex bodies that the curtain meets, in two coordinates."""
    frame = space_view.PictureFrame.of([solution])
    for placed in placed_obstacles(solution.problem):
        body = space_view.obstacle_mesh(placed, frame, frame.lowest)
        if body is not None:
            hull = shapely.convex_hull(shapely.multipoints(np.asarray(body.points)[:, axes]))
            yield shapely.get_coordinates(hull)


def _number(ax: Axes, places: Array, off: Array) -> None:
    """Numbers of the first, the last and every so many of the points of a row."""
    last = len(places)
    for number, at in enumerate(places, 1):
        if number in (1, last) or (number % NAMED == 0 and last - number >= NAMED // 2):
            _write(ax, at + off, f"{number}", color=GREY, bbox=PAPER)


def _write(ax: Axes, at: Any, words: str, **style: Any) -> None:
    ax.text(float(at[0]), float(at[1]), words, ha="center", va="center", **({"zorder": 9} | style))


def _span(ax: Axes, start: Any, end: Any, words: str, **style: Any) -> None:
    """A length with arrows at both ends, in mm."""
    ax.annotate("", start, end, arrowprops={"arrowstyle": "<->", "lw": 0.6, "shrinkA": 0, "shrinkB": 0})
    at = 0.5 * (np.array(start) + end)
    _write(ax, at, words, backgroundcolor="white", **style)
