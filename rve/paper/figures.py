"""Pictures of the study: Figs. 9 to 17 of the paper for our implementation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rve.common import Array, tell
from rve.common.drawing.plane import BLUE, GREEN, VERMILION, new_axes, new_figure, save_figure, shade, viridis
from rve.geometry.cell import Cell
from rve.paper.study import KINKED, Study
from rve.plots import draw_case
from rve.solve import solve_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = ("E11", "E12", "E22")
COLOURS = (BLUE, VERMILION, GREEN)


def in_space(study: Study, values: Array, names: tuple[str, ...], sheet: Array | None = None) -> Figure:
    """Figs. 9 and 14: line loads, or locked strains, (n, 3) in space; `sheet` (n, 3): the surface through a grid of
    cases, and its mirror image, since the weave is symmetric: alpha -> -alpha mirrors the shear."""
    fig, alphas, betas = new_figure(6.4, 5.0), np.unique(study.table.alpha_deg), np.unique(study.table.beta_deg)
    ax = fig.add_subplot(projection="3d")
    if sheet is not None and len(sheet) == len(alphas) * len(betas):
        E11, E12, E22 = np.moveaxis(sheet.reshape(len(alphas), len(betas), 3), 2, 0)
        for sign in (1.0, -1.0):
            ax.plot_surface(E11, sign * E12, E22, color=BLUE, alpha=0.35, lw=0.3)
    marks = ax.scatter(*values.T, c=study.table.beta_deg, cmap=viridis(), s=12, depthshade=False)
    ax.set(**dict(zip(("xlabel", "ylabel", "zlabel"), names, strict=True)))
    ax.set_box_aspect(None, zoom=0.82)
    ax.locator_params(nbins=5)
    ax.xaxis.labelpad = ax.yaxis.labelpad = ax.zaxis.labelpad = 8.0
    fig.colorbar(marks, ax=ax, shrink=0.6, pad=0.12, label="beta, degrees")
    return fig


def locked_cell(alpha_deg: float, beta_deg: float) -> Any:
    """Figs. 10 to 12: the locked cell under a load."""
    return draw_case(solve_table(Cell(), ([alpha_deg], [beta_deg]))).figure


def strains(study: Study) -> Figure:
    """Fig. 13: strain components against beta for each alpha; lines the direct solver, marks the paper's scheme."""
    fig, table = new_figure(12.0, 4.6), study.table
    axes = fig.subplots(1, 3)
    values = np.unique(table.alpha_deg)
    for k, ax in enumerate(axes):
        for alpha in values:
            rows = np.flatnonzero(table.alpha_deg == alpha)
            colour = shade(alpha / max(values.max(), 1.0))
            ax.plot(table.beta_deg[rows], table.E[rows, k], "-", color=colour, lw=1.0, label=f"{alpha:g}")
            ax.plot(table.beta_deg[rows], study.E[rows, k], "o", color=colour, ms=3, mfc="none")
        free = ~table.unique
        ax.plot(table.beta_deg[free], table.E[free, k], "x", color="black", ms=7)
        ax.set(xlabel="ratio angle beta, degrees", ylabel=NAMES[k])
    axes[-1].legend(title="alpha,\ndegrees", fontsize=10, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    told = "lines: direct solver; circles: paper's scheme; crosses: strain not unique (limit from inside)"
    fig.suptitle(told, fontsize=11)
    return fig


def steps(study: Study) -> Figure:
    """Fig. 15: accepted steps of each case."""
    ax, number = new_axes(8.0, 4.2), np.arange(1, len(study.table) + 1)
    good = study.rest.status == "converged"
    for rows, mark, colour, label in ((good, "o", BLUE, "converged"), (~good, "x", "black", "not converged")):
        if rows.any():
            ax.semilogy(number[rows], study.rest.steps[rows], mark, ms=4, color=colour, label=label)
    ax.axhspan(150, 300, color="0.88", zorder=0, label="most cases of the paper")
    ax.set(xlabel="load case (beta runs fastest)", ylabel="accepted steps n")
    ax.legend(fontsize=10)
    return ax.figure


def clock(study: Study) -> Figure:
    """Fig. 16: cumulated time against steps."""
    ax = new_axes(6.4, 4.6)
    marks = ax.scatter(study.rest.steps, study.rest.time, c=study.table.beta_deg, cmap=viridis(), s=22)
    ax.axhspan(45.0, 60.0, color="0.88", zorder=0)
    ax.set(xscale="log", yscale="log", xlabel="accepted steps n", ylabel="cumulated time, s")
    ax.set_title("grey: accumulation of cases in the paper, 45 to 60 s", fontsize=11)
    ax.figure.colorbar(marks, ax=ax, label="beta, degrees")
    return ax.figure


def progress_of_two(study: Study) -> Figure | None:
    """Fig. 17: strain, R and kinetic energy against time for cases 1 and 190; None if the study has neither."""
    known = [(pair, case) for pair in KINKED if (case := study.case(*pair)) is not None]
    if not known:
        return None
    fig, h = new_figure(5.2 * len(known), 6.4), study.history
    axes = fig.subplots(2, len(known), squeeze=False, sharex="col")
    for (upper, lower), (pair, case) in zip(axes.T, known, strict=True):
        rows, E = study.path(case)
        for k, values in enumerate(E.T):
            upper.plot(h.time[rows], values, color=COLOURS[k], label=NAMES[k])
        lower.semilogy(h.time[rows], h.R[rows], color=BLUE, label="R")
        kinetic = np.maximum(h.kinetic[rows], 1e-300)
        lower.semilogy(h.time[rows], kinetic, color=VERMILION, label="kinetic energy, 1e-6 J")
        lower.set_ylim(1e-24, 10.0)
        for ax in (upper, lower):
            for kink in filter(np.isfinite, study.side_contact_times(case)):
                ax.axvline(kink, color="0.6", lw=0.8)
            ax.legend(fontsize=10)
        upper.set(ylabel="strain", title=f"alpha = {pair[0]:g} deg, beta = {pair[1]:g} deg")
        lower.set(xlabel="time, s", ylabel="R, kinetic energy")
    told = "from here on one, and all, of the final contacts\nbetween rings that do not interlink press"
    fig.suptitle(f"grey lines: {told}", fontsize=11)
    return fig


def draw_all(study: Study, folder: Path) -> None:
    """Draw every picture of the study into a folder."""
    pictures: dict[str, Callable[[], Figure | None]] = {
        "fig_09": lambda: in_space(study, study.rest.s, ("s_xx / s_hat", "s_xy / s_hat", "s_yy / s_hat")),
        "fig_10": lambda: locked_cell(0.0, 90.0),
        "fig_11": lambda: locked_cell(0.0, 0.0),
        "fig_12": lambda: locked_cell(45.0, 0.0),
        "fig_13": lambda: strains(study),
        "fig_14": lambda: in_space(study, study.E, NAMES, study.table.E),
        "fig_15": lambda: steps(study),
        "fig_16": lambda: clock(study),
        "fig_17": lambda: progress_of_two(study),
    }
    for number, (name, draw) in enumerate(pictures.items()):
        tell(f"drawing, {name}.png", number / len(pictures))
        fig = draw()
        if fig is not None:
            save_figure(folder / f"{name}.png", fig)
