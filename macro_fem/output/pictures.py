"""Pictures of solved curtains; plot functions take a solution and axes, and return the axes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from macro_fem.curtain import CurtainSolution
from macro_fem.fem.cells import mean_at_corners
from macro_fem.judged import judged_by, rings_at_points, utilisation
from macro_fem.output import space_view
from macro_fem.output.arrows import FORCES
from macro_fem.output.html_page import check_page, write_page
from macro_fem.output.images import in_turn, save_animation, save_panels
from macro_fem.scene.scene import Scene
from rve.common import (
    AnyPath,
    Array,
    InputError,
    NotDrawn,
    check_out_file,
    digits,
    job,
    noted_if_stopped,
    require,
    tell,
)
from rve.common.drawing import space
from rve.common.drawing.plane import VERMILION, Scale, new_axes, new_figure, round_top, save_figure
from rve.common.files import UNREADABLE
from rve.common.optional import Axes, Figure

NO_GIF = "leave out --animation"
ARROWS, FOLDED = 700, 0.25
"""Approximate number of principal directions in a picture (larger: denser strokes), and the least part of its area with
which a cell is seen that has one: strokes of folded cells would lie beyond them."""
STATES = {"slack": "#dfe3e8", "drawn in one direction": "#56b4e9", "taut in both": "#004c75"}
HELD = "#111111"


@dataclass(frozen=True)
class Pictures:
    """Which pictures are wanted: STEM.png, STEM.gif of the load steps or moments, STEM.html; where a `report` as PDF
    and the outline of the flat sheet as `dxf` go."""

    picture: bool = True
    animation: bool = False
    html: bool = False
    report: Path | None = None
    dxf: Path | None = None
    stem: str = "curtain"

    def check(self, scene: Scene | None = None, inputs: Sequence[Path | None] = (), *, in_space: bool = False) -> None:
        """InputError, before anything is solved, for a package that is missing, a file that cannot be written or would
        overwrite one of `inputs`, and what makes no sense in this scene. in_space: also of a plane scene."""
        png, gif = (self.picture, "png", "ask for --no-picture"), (self.animation, "gif", NO_GIF)
        for is_asked, ending, instead in (png, gif):
            if is_asked:
                require("matplotlib", "plots", f"{self.stem}.{ending}", instead)
                if in_space or ending == "gif" or (scene is not None and scene.in_space):
                    space.check_render(f"{self.stem}.{ending}", instead)
        if self.html:
            check_page(f"{self.stem}.html", "leave out --html")
        if self.animation and scene is not None and scene.load.steps < 2 and scene.motion is None:
            scene.refuse(f"[load] steps = 1: there is nothing to animate; set steps = 10 or {NO_GIF}")
        report, dxf = ("report", ".pdf", "typst", "report"), ("dxf", ".dxf", "ezdxf", "cad")
        for name, ending, package, extra in (report, dxf):
            path: Path | None = vars(self)[name]
            if path is not None:
                require(package, extra, f"--{name}", "leave it out")
                check_out_file(path, f"--{name}", inputs, (ending,))
        if self.report is not None:
            require("matplotlib", "plots", "--report", "leave it out")
            if in_space or (scene is not None and scene.in_space):
                space.check_render("--report", "leave it out")


FAILURES = (*UNREADABLE, RuntimeError, ArithmeticError, AssertionError, ImportError, MemoryError)
"""What libraries that draw raise, in the data, the system or themselves."""
Drawings = dict[str, Callable[[Path], object]]
"""How to make each picture of a result: a function that writes it to a path, by the name of its file."""


def draw_all(
    folder: str | Path, record_name: str, record: Mapping[str, Any], drawings: Drawings,
    inputs: Sequence[AnyPath | None] = (),
) -> None:  # fmt: skip
    """Make pictures of a result whose data are in place in `folder`; files with a folder of their own go there.

    NotDrawn, after all others are made, for those that fail.
    """
    failed: dict[str, Exception] = {}
    for name, draw in drawings.items():
        tell(f"drawing {name}")
        try:
            with noted_if_stopped(f"all but pictures and reports is in place in {folder}"):
                if Path(name).name != name:
                    draw(Path(name))
                    continue
                with job(folder, record_name, record, inputs, adds=True) as staged:
                    draw(staged / name)
        except FAILURES as error:  # cost this picture alone
            failed[name] = error
    if failed:
        raise NotDrawn(failed, record) from next(iter(failed.values()))


def curtain_drawings(steps: Sequence[CurtainSolution], wanted: Pictures) -> Drawings:
    """How to draw the wanted pictures of the load steps."""
    last, drawings = steps[-1], Drawings()

    def draw_in_space(path: Path) -> None:
        both = [partial(space_view.draw_curtain, last, direction=way) for way in (space.FRONT, space.THREE_QUARTERS)]
        save_panels(path, both, space_view.title(last), ("from the front", "from the right, above"))

    def animate(path: Path) -> None:
        titles = [space_view.title(step).replace(" N, ", " N\n") for step in steps]
        shares = [f"{100.0 * step.problem.factor:.0f} % of live loads and moves, " for step in steps]
        titled = [share + words for share, words in zip(shares, titles, strict=True)]
        save_animation(path, in_turn(zip(titled, space_view.views(steps), strict=True)))

    if wanted.html:
        drawings[f"{wanted.stem}.html"] = lambda path: write_curtain_page(path, last)
    if wanted.picture and last.problem.scene.in_space:
        drawings[f"{wanted.stem}.png"] = draw_in_space
    elif wanted.picture:
        drawings[f"{wanted.stem}.png"] = lambda path: save_figure(path, panels(last))
    if wanted.picture and last.tau is not None:
        drawings[f"{wanted.stem}_flow.png"] = lambda path: save_figure(path, plot_flow(last).figure)
    if wanted.animation:
        drawings[f"{wanted.stem}.gif"] = animate
    return drawings


def write_curtain_page(path: str | Path, solution: CurtainSolution) -> None:
    """Write the curtain in space as one HTML file that turns in a browser; InputError if plotly is missing."""
    write_page(path, lambda: space_view.draw_curtain(solution), space_view.title(solution))


def plot_line_loads(solution: CurtainSolution, ax: Axes | None = None) -> Axes:
    """The deformed curtain coloured by its largest principal line load, with principal directions and supports."""
    values, direction = solution.principal()
    scale, disc = space_view.line_load_scale([solution]), solution.problem.disc
    P = mean_at_corners(solution.problem.mesh.mesh.t.T, disc.cell_mean(solution.P), disc.cell_area)
    loads = np.minimum(np.linalg.norm(P, 2, axis=(1, 2)), values.max())  # some corner has no less than any cell
    ax = _plot_field(solution, loads, scale, ax, shading="gouraud")
    _directions(solution, (values, direction), scale, ax)
    draw_loads(solution, ax)
    _legend(ax)
    ax.set_title(space_view.title(solution).replace(", ", ",\n", 1), fontsize=9)
    return ax


def plot_utilisation(solution: CurtainSolution, ax: Axes | None = None) -> Axes:
    """The deformed curtain coloured by the utilisation of its rings, 1 where they yield, with circles for the rings at
    hooks and other held and loaded points; InputError if not known."""
    used = utilisation(solution)
    if used is None:
        raise InputError(f"utilisation: {judged_by(solution.problem.law)}")
    at, borne = rings_at_points(solution)
    scale = Scale.of(used, "utilisation of the rings (1: first yield)")
    if (most := float(borne.max(initial=0.0))) > scale.top:
        scale = replace(scale, top=round_top(most, most), largest=max(scale.largest, most))
    ax = _plot_field(solution, used, scale, ax)
    if len(borne):
        label = f"ring at a hook or loaded point, up to {digits(most)}"
        style = {"cmap": scale.colour_map(), "norm": scale.norm(), "edgecolors": "white", "zorder": 7, "label": label}
        ax.scatter(at[:, 0], at[:, 1], c=borne, **style)
    _legend(ax)
    return ax


def plot_flow(solution: CurtainSolution, ax: Axes | None = None) -> Axes:
    """The deformed curtain coloured by how much rings that flow stretch beyond locking."""
    beyond = 100.0 * solution.problem.disc.cell_mean(solution.stretch_beyond_locking)
    ax = _plot_field(solution, beyond, Scale.of(beyond, "stretch beyond locking, %, where rings flow"), ax)
    _legend(ax)
    return ax


def panels(solution: CurtainSolution) -> Figure:
    """Line loads with directions, and the states: slack, drawn in one direction (it would wrinkle), taut in both; cells
    that lie with their back to the front, by a fold."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    extent = np.ptp(np.vstack([solution.x[:, :2], solution.problem.disc.nodes]), axis=0)
    figure = new_figure(6.4, float(np.clip(2.5 * extent[1] / extent[0], 2.0, 6.4)) + 1.4)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    plot_line_loads(solution, axes[0])
    state = solution.state()
    _colour(solution, state, axes[1], cmap=ListedColormap(list(STATES.values())), vmin=0.0, vmax=2.0)
    shown = (one for number, one in enumerate(STATES.items()) if (state == number).any())
    patches = [Patch(color=colour, label=name) for name, colour in shown]
    F = solution.problem.disc.cell_mean(solution.F)[:, :2]
    if (is_over := np.linalg.det(F) < 0.0).any():
        over: Any = {"facecolor": "none", "edgecolor": VERMILION, "hatch": "//////", "lw": 0.3}
        cells = solution.corners[:, :2][solution.problem.mesh.mesh.t.T[is_over]]
        axes[1].add_collection(PolyCollection(list(cells), **over))
        patches.append(Patch(**over, label="cell folded over"))
    axes[0].set_title("")
    figure.suptitle(space_view.title(solution), fontsize=9)
    axes[0].get_legend().remove()  # one for both panels
    handles = [*axes[0].get_legend_handles_labels()[0], *patches]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return figure


def _plot_field(solution: CurtainSolution, values: Array, scale: Scale, ax: Axes | None, **style: Any) -> Axes:
    """The deformed curtain coloured by values of cells or, with shading, corners, over its reference outline."""
    ax = new_axes() if ax is None else ax
    _colour(solution, np.maximum(values, scale.low), ax, cmap=scale.colour_map(), norm=scale.norm(), **style)
    scale.add_bar(ax, shrink=0.75, pad=0.02)
    return ax


def _colour(solution: CurtainSolution, values: Array, ax: Any, **style: Any) -> None:
    """Triangles in the colours of `values`, outline of the reference, what is held."""
    from matplotlib.collections import LineCollection

    mesh, supports, corners = solution.problem.mesh.mesh, solution.problem.supports, solution.corners[:, :2]
    at = [values] if "shading" in style else []
    flat = {} if at else {"facecolors": values, "edgecolors": "face", "lw": 0.3}
    ax.tripcolor(*corners.T, mesh.t.T, *at, **flat, **style)
    outline = mesh.p.T[mesh.facets[:, mesh.boundary_facets()].T]
    ax.add_collection(LineCollection(list(outline), colors="0.45", lw=0.8, ls=(0, (4, 3)), label="before deformation"))
    if facets := [facet for held in supports.held for facet in held.facets]:
        lines = list(corners[mesh.facets[:, facets].T])
        ax.add_collection(LineCollection(lines, colors=HELD, linewidths=2.5, label="held edge"))
    count = supports.mask.sum(axis=1)
    both = count == supports.mask.shape[1]
    size = 45.0 if np.count_nonzero(count) < 40 else 14.0
    fixed, sliding = (both, "v", HELD, "held in x and y"), ((count > 0) & ~both, "o", "white", "held in x or y")
    for nodes, marker, face, label in (fixed, sliding):
        if nodes.any():
            x, y = solution.x[nodes, :2].T
            ax.scatter(x, y, marker=marker, s=size, color=face, edgecolors=HELD, zorder=5, label=label)
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel="x, mm", ylabel="y, mm")
    ax.tick_params(labelsize=8)
    ax.spines[["top", "right"]].set_visible(False)


def _directions(solution: CurtainSolution, principal: tuple[Array, Array], scale: Scale, ax: Axes) -> None:
    """Short strokes along the larger principal line load in the deformed state, longer where it is larger."""
    from matplotlib.collections import LineCollection

    values, direction = principal
    mesh = solution.problem.mesh.mesh
    middle = mesh.p.T[mesh.t.T].mean(axis=1)
    F = solution.problem.disc.cell_mean(solution.F)[:, :2]
    is_flat = np.abs(np.linalg.det(F)) > FOLDED
    cells = one_per_square(middle, np.flatnonzero(is_flat & (values[:, 0] > 0.02 * scale.top)), ARROWS)
    along = np.einsum("cij,cj->ci", F[cells], direction[cells])
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    share = np.sqrt(np.minimum(values[cells, 0] / scale.top, 1.0))
    centre = solution.corners[:, :2][mesh.t.T[cells]].mean(axis=1)
    half = 0.006 * solution.problem.mesh.size * along * (1.0 + share)[:, None]
    tones = np.where(share > 0.55, "black", "white").tolist()  # black on bright colours, white on dark ones
    ax.add_collection(LineCollection(list(np.stack([centre - half, centre + half], axis=1)), colors=tones, lw=0.8))
    ax.plot([], [], color="black", lw=1.2, label="direction of the largest line load")


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


def draw_loads(solution: CurtainSolution, ax: Axes, axes: tuple[int, int] = (0, 1)) -> None:
    """Loads at points and wind as arrows in two coordinates, as long as a part of the size of the mesh for the largest
    of each seen from its side; many arrows are thin."""
    size = space_view.LONGEST * solution.problem.mesh.size
    for name, colour, forces, way in FORCES[2:]:
        longest = float(np.linalg.norm(forces(solution)[1], axis=1).max(initial=0.0))
        at, force = (part[:, axes] for part in forces(solution))
        if np.abs(force).max(initial=0.0) > 1e-6 * longest:
            ax.update_datalim(at + way * size * force / longest)
            ends: Any = {"angles": "xy", "scale_units": "xy", "scale": longest / size}
            ends |= {"units": "inches", "width": 0.04 if len(at) < 8 else 0.02}
            ends |= {"pivot": "tail" if way > 0 else "tip", "label": f"{name}, up to {digits(longest)} N"}
            ax.quiver(*at.T, *force.T, color=colour, ec="white", lw=0.5, zorder=6, **ends)
            ax.autoscale_view()


def _legend(ax: Axes) -> None:
    """What lines and markers mean, below the axes."""
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=1, frameon=False, fontsize=8)
