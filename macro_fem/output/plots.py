"""Pictures of curtains with matplotlib, without a display; plot functions take a solution and return the axes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from macro_fem.output import strength
from macro_fem.output.files import corner_positions
from macro_fem.output.space_view import line_load_scale
from macro_fem.solution import CurtainSolution
from rve.common.cells import as_triangles
from rve.common.drawing.render import colour_map, pixels, write_gif
from rve.common.drawing.views import Scale, rounded_up
from rve.common.errors import InputError
from rve.common.storage.files import write_whole
from rve.common.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ARROWS = 700
"""Approximate number of principal directions in a picture. Larger: denser strokes."""
STATE_COLOURS = ("#dfe3e8", "#56b4e9", "#004c75")
HELD = "#111111"
STATE_NAMES = ("slack", "drawn in one direction", "taut in both")


def plot_field(solution: CurtainSolution, values: Array, scale: Scale, ax: Axes | None = None) -> Axes:
    """The deformed curtain coloured by a cell field (n_cells,), over the outline of its reference state."""
    ax = _axes(ax)
    triangles, cell = as_triangles(solution.problem.mesh.mesh.t.T)
    corners = corner_positions(solution)[:, :2]
    shown = np.maximum(values, scale.low)[cell]
    style: dict[str, Any] = {"cmap": colour_map(scale), "norm": _norm(scale)}
    colours = ax.tripcolor(corners[:, 0], corners[:, 1], triangles, facecolors=shown, **style)
    assert ax.figure is not None
    extend = "max" if scale.is_exceeded else "neither"
    bar = ax.figure.colorbar(colours, ax=ax, shrink=0.75, pad=0.02, extend=extend)
    bar.set_ticks(scale.ticks(), labels=scale.tick_labels())
    bar.ax.minorticks_off()
    above = f"; above: up to {scale.largest:.3g}" if scale.is_exceeded else ""
    bar.set_label(scale.label.replace(", ", ",\n", 1) + above)
    _frame(solution, ax)
    return ax


def _norm(scale: Scale) -> Any:
    """The spread of a scale for matplotlib."""
    from matplotlib.colors import LogNorm, Normalize, PowerNorm

    if scale.spread == "root":
        return PowerNorm(0.5, scale.low, scale.top)
    return (LogNorm if scale.spread == "log" else Normalize)(scale.low, scale.top)


def plot_line_loads(solution: CurtainSolution, ax: Axes | None = None, *, scale: Scale | None = None) -> Axes:
    """The deformed curtain coloured by its largest principal line load, with principal directions and supports.

    scale: the colours of a series of pictures; by default those of this solution.
    """
    from matplotlib.lines import Line2D

    values, direction = solution.principal()
    scale = line_load_scale([solution]) if scale is None else scale
    ax = plot_field(solution, values[:, 0], scale, ax)
    _directions(solution, (values, direction), scale, ax)
    _supports(solution, ax)
    _legend(ax, [Line2D([], [], color="black", lw=1.2, label="direction of this load")])
    ax.set_title(_title(solution), fontsize=11)
    return ax


def plot_utilisation(solution: CurtainSolution, ax: Axes | None = None) -> Axes:
    """The deformed curtain coloured by the utilisation of its rings, 1 where they yield; InputError if not known."""
    used = strength.utilisation(solution)
    if used is None:
        raise InputError(f"utilisation: {strength.reason(solution.problem.law)}")
    ax = plot_field(solution, used, Scale.of(used, "utilisation of the rings (1: first yield)"), ax)
    _supports(solution, ax)
    _legend(ax)
    return ax


def plot_states(solution: CurtainSolution, ax: Axes | None = None) -> Axes:
    """Where the curtain is slack, drawn in one direction (it would wrinkle) or taut in both."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    ax = _axes(ax)
    triangles, cell = as_triangles(solution.problem.mesh.mesh.t.T)
    corners = corner_positions(solution)[:, :2]
    ax.tripcolor(
        corners[:, 0],
        corners[:, 1],
        triangles,
        facecolors=solution.state()[cell].astype(float),
        cmap=ListedColormap(STATE_COLOURS),
        vmin=0.0,
        vmax=2.0,
    )
    patches = [Patch(color=c, label=name) for c, name in zip(STATE_COLOURS, STATE_NAMES, strict=True)]
    _frame(solution, ax)
    _supports(solution, ax)
    _legend(ax, patches)
    return ax


def plot_error(solution: CurtainSolution, density: Array, ax: Axes | None = None) -> Axes:
    """Where the gap between the bounds comes from: its density (n_cells,) over four decades."""

    largest = float(density.max(initial=0.0))
    top = rounded_up(largest)
    scale = Scale("gap between the bounds, N mm per mm2", 1e-4 * top, top, largest, spread="log")
    ax = plot_field(solution, density, scale, ax)
    ax.set_title("where the bounds differ", fontsize=11)
    return ax


def save_picture(path: Path, solution: CurtainSolution, error: Array | None = None) -> None:
    """curtain.png: line loads with directions beside the states, and the error map if there is one."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    extent = np.ptp(np.vstack([solution.x[:, :2], solution.problem.disc.nodes]), axis=0)
    panels = 2 if error is None else 3
    height = float(np.clip(4.2 * extent[1] / extent[0], 2.6, 8.0)) + 1.4
    figure = Figure(figsize=(5.2 * panels, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, panels)
    plot_line_loads(solution, axes[0])
    plot_states(solution, axes[1])
    if error is not None:
        plot_error(solution, error, axes[2])
    write_whole(path, lambda temporary: figure.savefig(temporary, dpi=150))


def save_animation(path: Path, steps: Sequence[CurtainSolution]) -> None:
    """curtain.gif of a plane curtain: line loads at each load step, with one scale of colours and one frame."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    scale = line_load_scale(steps)
    points = np.concatenate([*(step.x for step in steps), steps[0].problem.disc.nodes])
    low, high = points.min(axis=0), points.max(axis=0)
    room = 0.04 * float((high - low).max())
    frames = []
    for step in steps:
        figure = Figure(figsize=(7.0, 6.2), dpi=110, layout="constrained")
        FigureCanvasAgg(figure)
        ax = plot_line_loads(step, figure.subplots(), scale=scale)
        ax.set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))
        ax.set_title(f"{100.0 * step.problem.factor:.0f} % of live loads and moves\n{_title(step)}", fontsize=11)
        frames.append(pixels(figure))
    write_gif(path, frames)


def _axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained")
    FigureCanvasAgg(figure)
    return figure.subplots()


NARROW = 1.5
"""The title over a curtain that is this many times higher than wide has two lines."""


def _title(solution: CurtainSolution) -> str:
    load = float(np.linalg.norm(solution.problem.force.sum(axis=0)))
    height = f"mean height {solution.mean_height():.1f} mm, lowest point {solution.x[:, 1].min():.1f} mm"
    width, tall = np.ptp(solution.problem.disc.nodes[:, :2], axis=0)
    return f"total load {load:.4g} N,{chr(10) if tall > NARROW * width else ' '}{height}"


def _frame(solution: CurtainSolution, ax: Axes) -> None:
    """Reference outline, equal scales, units."""
    mesh = solution.problem.mesh.mesh
    ends = mesh.p[:, mesh.facets[:, mesh.boundary_facets()]]
    gap = np.full((1, ends.shape[2]), np.nan)
    ax.plot(
        np.concatenate([ends[0], gap]).T.ravel(),
        np.concatenate([ends[1], gap]).T.ravel(),
        color="0.45",
        lw=0.8,
        ls=(0, (4, 3)),
        label="before deformation",
    )
    ax.set_aspect("equal")
    ax.set_xlabel("x, mm")
    ax.set_ylabel("y, mm")
    ax.spines[["top", "right"]].set_visible(False)


def _directions(solution: CurtainSolution, principal: tuple[Array, Array], scale: Scale, ax: Axes) -> None:
    """Short strokes along the larger principal line load in the deformed state, longer where it is larger."""
    from matplotlib.collections import LineCollection

    values, direction = principal
    mesh = solution.problem.mesh.mesh
    middle = mesh.p.T[mesh.t.T].mean(axis=1)
    cells = one_per_square(middle, np.flatnonzero(values[:, 0] > 0.02 * scale.top), ARROWS)
    if not len(cells):
        return
    F = solution.problem.disc.cell_mean(solution.F)[cells]
    along = np.einsum("cij,cj->ci", F, direction[cells])[:, :2]
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    centre = corner_positions(solution)[:, :2][mesh.t.T[cells]].mean(axis=1)
    share = np.minimum(scale.share(values[cells, 0]), 1.0)
    half = 0.01 * solution.problem.mesh.size * along * share[:, None]
    strokes = list(np.stack([centre - half, centre + half], axis=1))
    # black on the bright colours of the scale, white on the dark ones
    tones = np.where(share > 0.55, "black", "white").tolist()
    ax.add_collection(LineCollection(strokes, colors=tones, linewidths=0.8))


def one_per_square(points: Array, chosen: np.ndarray, number: int) -> np.ndarray:
    """Of the chosen points (n, 2), the one next to the middle of each of about `number` squares around all points.

    >>> one_per_square(np.array([[0.0, 0.0], [0.9, 0.9], [3.1, 3.0], [4.0, 4.0]]), np.array([0, 1, 2]), 4).tolist()
    [1, 2]
    """
    low = points.min(axis=0)
    side = np.sqrt(max(float(np.prod(np.ptp(points, axis=0))), 1e-300) / number)
    place = (points[chosen] - low) / side
    square = np.floor(place).astype(np.int64)
    away = ((place - square - 0.5) ** 2).sum(axis=1)
    order = np.lexsort((away, square[:, 1], square[:, 0]))
    first = np.unique(square[order], axis=0, return_index=True)[1]
    return np.sort(chosen[order][first])


def _supports(solution: CurtainSolution, ax: Axes) -> None:
    """What is held: lines along edges, triangles at nodes held in both components, circles where one slides."""
    from matplotlib.collections import LineCollection

    mask = solution.problem.supports.mask
    mesh, corners = solution.problem.mesh.mesh, corner_positions(solution)[:, :2]
    facets = np.unique(np.concatenate([held.facets for held in solution.problem.supports.held]))
    if len(facets):
        lines = list(corners[mesh.facets[:, facets].T])
        ax.add_collection(LineCollection(lines, colors=HELD, linewidths=2.5, label="held edge"))
    both, one = mask.all(axis=1), mask.any(axis=1) & ~mask.all(axis=1)
    size = 45.0 if both.sum() + one.sum() < 40 else 14.0
    for nodes, marker, face, label in ((both, "v", HELD, "held in x and y"), (one, "o", "white", "held in x or y")):
        if nodes.any():
            at = solution.x[nodes]
            ax.scatter(at[:, 0], at[:, 1], marker=marker, s=size, color=face, edgecolors=HELD, zorder=5, label=label)


def _legend(ax: Axes, more: Sequence[Any] = ()) -> None:
    """What lines and markers mean, and the handles `more`, below the axes."""
    from matplotlib.transforms import ScaledTranslation

    assert ax.figure is not None
    handles = [*more, *ax.get_legend_handles_labels()[0]]
    below = ax.transAxes + ScaledTranslation(0.0, -0.5, ax.figure.dpi_scale_trans)  # inches: under the label of x
    ax.legend(
        handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), bbox_transform=below, borderaxespad=0.0,
        ncols=2, frameon=False, fontsize=9,
    )  # fmt: skip
