"""Pictures of curtains in the plane with matplotlib; plot functions take a solution and axes, and return the axes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from macro_fem.output import strength
from macro_fem.output.files import corner_positions
from macro_fem.output.forces import LOAD, point_loads
from macro_fem.output.space_view import LONGEST, Titled, line_load_scale, title
from macro_fem.solution import CurtainSolution
from rve.common import Array, InputError
from rve.common.drawing.plane import new_axes, new_figure
from rve.common.drawing.scale import Scale

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ARROWS = 700
"""Approximate number of principal directions in a picture. Larger: denser strokes."""
STATE_COLOURS = ("#dfe3e8", "#56b4e9", "#004c75")
STATE_NAMES = ("slack", "drawn in one direction", "taut in both")
HELD = "#111111"
NARROW = 1.5
"""The title over a curtain that is this many times higher than wide has two lines."""


def plot_line_loads(solution: CurtainSolution, ax: Axes | None = None, *, scale: Scale | None = None) -> Axes:
    """The deformed curtain coloured by its largest principal line load, with principal directions and supports.

    scale: the colours of a series of pictures; by default those of this solution.
    """
    values, direction = solution.principal()
    scale = line_load_scale([solution]) if scale is None else scale
    ax = _plot_field(solution, values[:, 0], scale, ax)
    _directions(solution, (values, direction), scale, ax)
    _loads(solution, ax)
    _legend(ax)
    width, tall = np.ptp(solution.problem.disc.nodes[:, :2], axis=0)
    told = title(solution)
    ax.set_title(told.replace(", ", ",\n", 1) if tall > NARROW * width else told, fontsize=11)
    return ax


def plot_utilisation(solution: CurtainSolution, ax: Axes | None = None) -> Axes:
    """The deformed curtain coloured by the utilisation of its rings, 1 where they yield; InputError if not known."""
    used = strength.utilisation(solution)
    if used is None:
        raise InputError(f"utilisation: {strength.reason(solution.problem.law)}")
    ax = _plot_field(solution, used, Scale.of(used, "utilisation of the rings (1: first yield)"), ax)
    _legend(ax)
    return ax


def panels(solution: CurtainSolution) -> Figure:
    """Line loads with directions, and the states: slack, drawn in one direction (it would wrinkle), taut in both."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    extent = np.ptp(np.vstack([solution.x[:, :2], solution.problem.disc.nodes]), axis=0)
    figure = new_figure(10.4, float(np.clip(4.2 * extent[1] / extent[0], 2.6, 8.0)) + 1.4)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    plot_line_loads(solution, axes[0])
    _colour(solution, solution.state(), axes[1], cmap=ListedColormap(STATE_COLOURS), vmin=0.0, vmax=2.0)
    _legend(axes[1], [Patch(color=c, label=name) for c, name in zip(STATE_COLOURS, STATE_NAMES, strict=True)])
    return figure


def side_by_side(steps: Titled) -> Figure:
    """Line loads of several solutions on one scale."""
    scale, figure = line_load_scale([one for _, one in steps]), new_figure(5.2 * len(steps), 6.0)
    for ax, (words, solution) in zip(figure.subplots(1, len(steps), squeeze=False)[0], steps, strict=True):
        plot_line_loads(solution, ax, scale=scale).set_title(words, fontsize=11)
    return figure


def frames(steps: Titled) -> Iterator[Figure]:
    """Figures of the line loads at each step, with one scale of colours and one frame."""
    solutions = [one for _, one in steps]
    scale = line_load_scale(solutions)
    points = np.concatenate([*(one.x for one in solutions), solutions[0].problem.disc.nodes])
    low, high = points.min(axis=0), points.max(axis=0)
    room = 0.04 * float((high - low).max())
    for words, solution in steps:
        figure = new_figure(7.0, 6.2)
        ax = plot_line_loads(solution, figure.subplots(), scale=scale)
        ax.set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))
        ax.set_title(words, fontsize=11)
        yield figure


def _plot_field(solution: CurtainSolution, values: Array, scale: Scale, ax: Axes | None) -> Axes:
    """The deformed curtain coloured by a cell field (n_cells,), over the outline of its reference state."""
    ax = new_axes() if ax is None else ax
    _colour(solution, np.maximum(values, scale.low), ax, cmap=scale.colour_map(), norm=scale.norm())
    scale.add_bar(ax, shrink=0.75, pad=0.02)
    return ax


def _colour(solution: CurtainSolution, values: Array, ax: Axes, **style: Any) -> None:
    """Triangles in the colours of cell values (n_cells,), outline of the reference, what is held, equal scales, units.

    Held are lines along edges, triangles at nodes held in both components, circles where one slides.
    """
    from matplotlib.collections import LineCollection

    mesh, supports, corners = solution.problem.mesh.mesh, solution.problem.supports, corner_positions(solution)[:, :2]
    ax.tripcolor(corners[:, 0], corners[:, 1], mesh.t.T, facecolors=values, edgecolors="face", lw=0.3, **style)
    outline = mesh.p.T[mesh.facets[:, mesh.boundary_facets()].T]
    dashes: Any = (0, (4, 3))
    ax.add_collection(LineCollection(list(outline), colors="0.45", lw=0.8, ls=dashes, label="before deformation"))
    facets = np.unique(np.concatenate([held.facets for held in supports.held]))
    if len(facets):
        lines = list(corners[mesh.facets[:, facets].T])
        ax.add_collection(LineCollection(lines, colors=HELD, linewidths=2.5, label="held edge"))
    count = supports.mask.sum(axis=1)
    both = count == supports.mask.shape[1]
    size = 45.0 if np.count_nonzero(count) < 40 else 14.0
    for nodes, marker, face, label in (
        (both, "v", HELD, "held in x and y"),
        ((count > 0) & ~both, "o", "white", "held in x or y"),
    ):
        if nodes.any():
            x, y = solution.x[nodes, :2].T
            ax.scatter(x, y, marker=marker, s=size, color=face, edgecolors=HELD, zorder=5, label=label)
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel="x, mm", ylabel="y, mm")
    ax.spines[["top", "right"]].set_visible(False)


def _directions(solution: CurtainSolution, principal: tuple[Array, Array], scale: Scale, ax: Axes) -> None:
    """Short strokes along the larger principal line load in the deformed state, longer where it is larger."""
    from matplotlib.collections import LineCollection

    values, direction = principal
    mesh = solution.problem.mesh.mesh
    middle = mesh.p.T[mesh.t.T].mean(axis=1)
    cells = one_per_square(middle, np.flatnonzero(values[:, 0] > 0.02 * scale.top), ARROWS)
    F = solution.problem.disc.cell_mean(solution.F)[cells]
    along = np.einsum("cij,cj->ci", F, direction[cells])[:, :2]
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    share = np.sqrt(np.minimum(values[cells, 0] / scale.top, 1.0))
    centre = corner_positions(solution)[:, :2][mesh.t.T[cells]].mean(axis=1)
    half = 0.01 * solution.problem.mesh.size * along * share[:, None]
    tones = np.where(share > 0.55, "black", "white").tolist()  # black on bright colours, white on dark ones
    ax.add_collection(LineCollection(list(np.stack([centre - half, centre + half], axis=1)), colors=tones, lw=0.8))
    ax.plot([], [], color="black", lw=1.2, label="direction of this load")


def _loads(solution: CurtainSolution, ax: Axes) -> None:
    """Loads at points as arrows, the longest a part of the size of the mesh."""
    at, force = (part[:, :2] for part in point_loads(solution))
    longest = float(np.linalg.norm(force, axis=1).max(initial=0.0))
    if longest > 0.0:
        size = LONGEST * solution.problem.mesh.size
        ax.update_datalim(at + size * force / longest)
        ends: Any = {"angles": "xy", "scale_units": "xy", "scale": longest / size, "width": 0.009}
        told = f"load at a point, up to {longest:.3g} N"
        ax.quiver(*at.T, *force.T, color=LOAD, ec="white", lw=0.5, zorder=6, label=told, **ends)
        ax.autoscale_view()


def one_per_square(points: Array, chosen: np.ndarray, number: int) -> np.ndarray:
    """Of the chosen points (n, 2), the one in the middle of each of about `number` squares around all points.

    >>> one_per_square(np.array([[0.0, 0.0], [0.9, 0.9], [3.1, 3.0], [4.0, 4.0]]), np.array([0, 1, 2]), 4).tolist()
    [1, 2]
    """
    low = points.min(axis=0)
    side = np.sqrt(max(float(np.prod(np.ptp(points, axis=0))), 1e-300) / number)
    place = (points[chosen] - low) / side
    order = np.linalg.norm(place % 1.0 - 0.5, axis=1).argsort(kind="stable")
    return np.sort(chosen[order[np.unique(np.floor(place[order]), axis=0, return_index=True)[1]]])


def _legend(ax: Axes, more: Sequence[Any] = ()) -> None:
    """What lines and markers mean, and the handles `more`, below the axes."""
    handles = [*more, *ax.get_legend_handles_labels()[0]]
    ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, frameon=False, fontsize=9)
