"""Pictures of the study: Figs. 9 to 17 of the paper for our implementation, and where alternating projection fails."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rve.common.drawing.plane import BLUE, GREEN, VERMILION, new_axes, new_figure, save_figure, shade, viridis
from rve.common.progress import tell
from rve.plots import draw_case
from rve.solve import solve_table
from rve.study.cases import Study, history_strain, side_contact_times

if TYPE_CHECKING:
    from matplotlib.figure import Figure


NAMES = ("E11", "E12", "E22")
COLOURS = (BLUE, VERMILION, GREEN)


def load_cases(study: Study) -> Figure:
    """Fig. 9: angles of the cases, and their line loads in space."""
    fig = new_figure(9.5, 4.5)
    plane, space = fig.add_subplot(1, 2, 1), fig.add_subplot(1, 2, 2, projection="3d")
    plane.plot(study.beta_deg, study.alpha_deg, "o", ms=4, color=COLOURS[0])
    plane.set(xlabel="ratio angle beta, degrees", ylabel="principal angle alpha, degrees")
    _loads_in_space(space, study)
    fig.suptitle(f"{len(study.s)} load cases")
    return fig


def _loads_in_space(ax: Any, study: Study) -> None:
    marks = ax.scatter(*study.s[:, [0, 1, 2]].T, c=study.beta_deg, cmap=viridis(), s=14, depthshade=False)
    _in_space(ax, ("s_xx / s_hat", "s_xy / s_hat", "s_yy / s_hat"))
    ax.figure.colorbar(marks, ax=ax, shrink=0.6, pad=0.12, label="beta, degrees")


def _in_space(ax: Any, names: tuple[str, str, str]) -> None:
    """Names of the axes that do not run into their numbers."""
    ax.set(xlabel=names[0], ylabel=names[1], zlabel=names[2])
    ax.set_box_aspect(None, zoom=0.82)
    ax.locator_params(nbins=5)
    ax.xaxis.labelpad = ax.yaxis.labelpad = ax.zaxis.labelpad = 8.0


def locked_cell(study: Study, alpha_deg: float, beta_deg: float) -> Any:
    """Figs. 10 to 12: the locked cell under a load, which is solved if the study does not have it."""
    case = study.case(alpha_deg, beta_deg)
    if case is not None:
        return draw_case(study.table, case).figure
    return draw_case(solve_table(study.cell, ([alpha_deg], [beta_deg]))).figure


def strains(study: Study) -> Figure:
    """Fig. 13: strain components against beta for each alpha; lines the direct solver, marks the paper's scheme."""
    fig = new_figure(12.0, 4.6)
    axes = fig.subplots(1, 3)
    values = np.unique(study.alpha_deg)
    for k, ax in enumerate(axes):
        for alpha in values:
            rows = np.flatnonzero(study.alpha_deg == alpha)
            colour = shade(alpha / max(values.max(), 1.0))
            ax.plot(study.beta_deg[rows], study.table.E[rows, k], "-", color=colour, lw=1.0, label=f"{alpha:g}")
            ax.plot(study.beta_deg[rows], study.E[rows, k], "o", color=colour, ms=3, mfc="none")
        free = ~study.table.unique
        ax.plot(study.beta_deg[free], study.table.E[free, k], "x", color="black", ms=7)
        ax.set(xlabel="ratio angle beta, degrees", ylabel=NAMES[k])
    axes[-1].legend(title="alpha,\ndegrees", fontsize=10, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    fig.suptitle(
        "lines: direct solver; circles: paper's scheme; crosses: strain not unique (limit from inside)", fontsize=11
    )
    return fig


def surface(study: Study) -> Figure:
    """Fig. 14: line loads, and the convex surface of locked strains."""
    fig = new_figure(10.5, 5.0)
    left, right = (fig.add_subplot(1, 2, k, projection="3d") for k in (1, 2))
    _loads_in_space(left, study)
    E = study.table.E
    alphas, betas = np.unique(study.alpha_deg), np.unique(study.beta_deg)
    if len(E) == len(alphas) * len(betas) and len(alphas) > 1 and len(betas) > 1:
        sheet = E.reshape(len(alphas), len(betas), 3)
        for sign in (1.0, -1.0):  # the weave is symmetric: alpha -> -alpha mirrors the shear
            right.plot_surface(sheet[..., 0], sign * sheet[..., 1], sheet[..., 2], color=COLOURS[0], alpha=0.35, lw=0.3)
    right.scatter(*study.E.T, c=study.beta_deg, cmap=viridis(), s=10, depthshade=False)
    _in_space(right, ("E11", "E12", "E22"))
    fig.suptitle("line loads and locked strains; the mirrored half (-alpha) is drawn as a surface only", fontsize=11)
    return fig


def steps(study: Study) -> Figure:
    """Fig. 15: accepted steps of each case."""
    ax = new_axes(8.0, 4.2)
    number = np.arange(1, len(study.s) + 1)
    for name, mark, colour in (("converged", "o", COLOURS[0]), ("", "x", "black")):
        rows = (study.rest.status == "converged") == bool(name)
        if rows.any():
            label = name or "not converged"
            ax.semilogy(number[rows], study.rest.steps[rows], mark, ms=4, color=colour, label=label)
    ax.axhspan(150, 300, color="0.88", zorder=0, label="most cases of the paper")
    ax.set(xlabel="load case (beta runs fastest)", ylabel="accepted steps n")
    ax.legend(fontsize=10)
    return ax.figure


def clock(study: Study) -> Figure:
    """Fig. 16: cumulated time against steps."""
    ax = new_axes(6.4, 4.6)
    marks = ax.scatter(study.rest.steps, study.rest.time, c=study.beta_deg, cmap=viridis(), s=22)
    ax.axhspan(45.0, 60.0, color="0.88", zorder=0)
    ax.set(xscale="log", yscale="log", xlabel="accepted steps n", ylabel="cumulated time, s")
    ax.set_title("grey: accumulation of cases in the paper, 45 to 60 s", fontsize=11)
    ax.figure.colorbar(marks, ax=ax, label="beta, degrees")
    return ax.figure


def progress_of_two(study: Study) -> Figure | None:
    """Fig. 17: strain, R and kinetic energy against time for cases 1 and 190; None if the study has neither."""
    cases = [(pair, study.case(*pair)) for pair in ((0.0, 0.0), (45.0, 90.0))]
    known = [(pair, case) for pair, case in cases if case is not None]
    if not known:
        return None
    fig = new_figure(5.2 * len(known), 6.4)
    axes = fig.subplots(2, len(known), squeeze=False, sharex="col")
    for column, (pair, case) in enumerate(known):
        h = study.history
        rows = np.flatnonzero(h.case == case)
        upper, lower = axes[:, column]
        for k, values in enumerate(history_strain(study, rows).T):
            upper.plot(h.time[rows], values, color=COLOURS[k], label=NAMES[k])
        lower.semilogy(h.time[rows], h.R[rows], color=COLOURS[0], label="R")
        lower.semilogy(
            h.time[rows], np.maximum(h.kinetic[rows], 1e-300), color=COLOURS[1], label="kinetic energy, 1e-6 J"
        )
        lower.set_ylim(1e-24, 10.0)
        kinks = side_contact_times(study, case)
        for ax in (upper, lower):
            for kink in filter(np.isfinite, kinks):
                ax.axvline(kink, color="0.6", lw=0.8)
            ax.legend(fontsize=10)
        upper.set(ylabel="strain", title=f"alpha = {pair[0]:g} deg, beta = {pair[1]:g} deg")
        lower.set(xlabel="time, s", ylabel="R, kinetic energy")
    fig.suptitle(
        "grey lines: from here on one, and all, of the final contacts\nbetween rings that do not interlink press",
        fontsize=11,
    )
    return fig


def draw_all(study: Study, folder: Path) -> None:
    """Draw every picture of the study into a folder."""
    pictures: dict[str, Callable[[], Figure | None]] = {
        "fig_09": lambda: load_cases(study),
        "fig_10": lambda: locked_cell(study, 0.0, 90.0),
        "fig_11": lambda: locked_cell(study, 0.0, 0.0),
        "fig_12": lambda: locked_cell(study, 45.0, 0.0),
        "fig_13": lambda: strains(study),
        "fig_14": lambda: surface(study),
        "fig_15": lambda: steps(study),
        "fig_16": lambda: clock(study),
        "fig_17": lambda: progress_of_two(study),
    }
    for number, (name, draw) in enumerate(pictures.items()):
        tell(f"drawing, {name}.png", number / len(pictures))
        fig = draw()
        if fig is not None:
            save_figure(folder / f"{name}.png", fig)
