"""Pictures of a run: strains, residual and energy in time, and the loop of a load that goes and comes back."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from rve.common.drawing.plane import BLUE, GREEN, VERMILION, new_axes, new_figure
from rve.simulation.run import NAMES, FrictionLoop, Simulation

COLOURS = (BLUE, VERMILION, GREEN)


def draw_run(run: Simulation, cases: Iterable[int]) -> Any:
    """Strain, R and kinetic energy against time for some cases, the paper's Fig. 17; grey lines: from there on one, and
    all, of the final contacts between rings that do not interlink press."""
    cases = list(cases)
    fig, h = new_figure(5.2 * len(cases), 6.4), run.history
    axes = fig.subplots(2, len(cases), squeeze=False, sharex="col")
    for (upper, lower), case in zip(axes.T, cases, strict=True):
        rows, E = run.path(case)
        for name, values, colour in zip(NAMES, E.T, COLOURS, strict=True):
            upper.plot(h.time[rows], values, color=colour, label=name)
        lower.semilogy(h.time[rows], h.R[rows], color=BLUE, label="R")
        kinetic = np.maximum(h.kinetic[rows], 1e-300)
        lower.semilogy(h.time[rows], kinetic, color=VERMILION, label="kinetic energy, N mm")
        lower.set_ylim(1e-24, 10.0)
        for ax in (upper, lower):
            for kink in filter(np.isfinite, side_contact_times(run, case)):
                ax.axvline(kink, color="0.6", lw=0.8)
            ax.legend(fontsize=10)
        title = f"alpha = {run.alpha_deg[case, -1]:g} deg, beta = {run.beta_deg[case, -1]:g} deg"
        upper.set(ylabel="strain", title=title)
        lower.set(xlabel="time, s", ylabel="R, kinetic energy")
    key = "from here on one, and all, of the final contacts\nbetween rings that do not interlink press"
    fig.suptitle(f"grey lines: {key}", size=11)
    return fig


def side_contact_times(run: Simulation, case: int) -> tuple[float, float]:
    """Times in s from which the first, and all, of the final contacts between rings that do not interlink press to
    the end; nan without such a contact."""
    rows = run.history.case == case
    side, times = run.history.side[rows], run.history.time[rows]
    if not len(side) or not side[-1]:
        return float("nan"), float("nan")
    # from the step after the last one in which they did not press
    first, last = (np.append(0, np.flatnonzero(~pressed) + 1)[-1] for pressed in (side > 0, side == side[-1]))
    return float(times[first]), float(times[last])


def draw_loop(loop: FrictionLoop) -> Any:
    """Strains against the place of the load between its two directions, there and back."""
    ax, half = new_axes(6.4, 4.8), len(loop.E) // 2
    place = np.abs(np.linspace(-1.0, 1.0, len(loop.E)))
    for name, values, colour in zip(NAMES, loop.E.T, COLOURS, strict=True):
        ax.plot(place[: half + 1], values[: half + 1], "-o", color=colour, ms=3, label=f"{name}, on the way back")
        ax.plot(place[half:], values[half:], "--o", color=colour, ms=3, mfc="white", label=f"{name}, on the way there")
    run = loop.run
    ends = [f"({run.alpha_deg[0, i]:g}, {run.beta_deg[0, i]:g})" for i in (0, half)]
    ax.set(xlabel=f"load from {ends[0]} to {ends[1]} deg", ylabel="strain at rest")
    ax.set_title(f"friction {run.options.friction:g}: {str(loop).partition(': ')[2]}", fontsize=12)
    ax.legend(fontsize=10, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False)
    return ax.figure
