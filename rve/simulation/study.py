"""The paper's study for our implementation: 190 load cases by its scheme, compared with its published figures."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rve.common import AnyPath, Array, check_out_job, csv_text, job, require, tell, write_text
from rve.common.drawing.plane import BLUE, new_axes, new_figure, save_figure, viridis
from rve.directions import grid
from rve.geometry.cell import Cell
from rve.plots import draw_case
from rve.simulation.dynamics import SimulationOptions
from rve.simulation.pictures import draw_run, side_contact_times
from rve.simulation.run import NAMES, STEPS, Simulation, simulate
from rve.solve import solve_table
from rve.table import StrainTable

RECORD = "study.json"
"""It lists the other files with their checksums."""
KINKED = ((0.0, 0.0), (45.0, 90.0))
"""Cases 1 and 190 of the paper, whose motion it shows in Fig. 17."""


@dataclass(frozen=True)
class Study:
    """Load cases solved by both methods; wall_s: seconds of the scheme and of the direct solver."""

    table: StrainTable
    run: Simulation
    wall_s: tuple[float, float]

    @property
    def kinked(self) -> list[tuple[tuple[float, float], int]]:
        """Which of `KINKED` the study has, and their rows."""
        directions = zip(self.table.alpha_deg.tolist(), self.table.beta_deg.tolist(), strict=True)
        return [(pair, i) for i, pair in enumerate(directions) if pair in KINKED]


def solve_study(alpha_deg: ArrayLike, beta_deg: ArrayLike, options: SimulationOptions | None = None) -> Study:
    """Solve the cases of the paper's cell by its scheme and by the direct solver."""
    began = time.perf_counter()
    run = simulate(Cell(), (alpha_deg, beta_deg), options)
    between = time.perf_counter()
    table = run.direct()
    return Study(table, run, (between - began, time.perf_counter() - between))


def comparison(study: Study) -> list[tuple[str, str, str, str]]:
    """The paper's published figures compared with ours: rows of quantity, paper, ours, reason for a difference."""
    rest, steps, sums = study.run.rest, study.run.rest.steps, study.run.rest.time
    order = np.argsort(steps)

    def name(i: int) -> str:
        return f"({study.table.alpha_deg[i]:g}, {study.table.beta_deg[i]:g})"

    def span(values: Any, low: float, high: float) -> str:
        return f"{((values >= low) & (values <= high)).sum()} of {len(values)}"

    def quartiles(values: Any) -> str:
        return " / ".join(f"{x:.0f}" for x in np.percentile(values, [25, 50, 75]))

    kinks, ends = (dict.fromkeys(KINKED, "not in this study") for _ in range(2))
    for pair, case in study.kinked:
        first, last = side_contact_times(study.run, case)
        kinks[pair], ends[pair] = f"first side contact {first:.0f} s, last {last:.0f} s", f"{sums[case]:.0f} s"
    clock = "the paper states neither s_hat nor a start; s_hat is calibrated, see docs/explanation/paper_scheme.md"
    free = "(15, 0) is at the edge of the loads that leave the strain free: almost no restoring force"
    return [
        ("converged cases", "190 of 190", f"{(rest.status == 'converged').sum()} of {len(sums)}", ""),
        ("steps, 150 to 300", "most cases", span(steps, 150, 300), "our steps see the contact curvature: fewer"),
        ("steps, quartiles", "-", quartiles(steps), ""),
        ("least steps", "80", f"{steps.min()} at {name(order[0])}", ""),
        ("most steps", "about 2800, two cases", ", ".join(f"{steps[i]} at {name(i)}" for i in order[:-4:-1]), free),
        ("least sum of h", "14.5 s", f"{sums.min():.1f} s at {name(int(np.argmin(sums)))}", clock),
        ("sum of h, 45 to 60 s", "accumulation of cases", span(sums, 45.0, 60.0), clock),
        ("sum of h, quartiles", "-", f"{quartiles(sums)} s", ""),
        ("largest sum of h", "1340 s", f"{sums.max():.0f} s at {name(int(np.argmax(sums)))}", free),
        ("sum of h, case 190 (45, 90)", "about 1340 s", ends[KINKED[1]], "same clock"),
        ("kink, case 1 (0, 0)", "about 30 s", kinks[KINKED[0]], clock),
        ("kink, case 190 (45, 90)", "about 1200 s", kinks[KINKED[1]], clock),
        ("tried with too large a step", "-", f"{rest.rejected.sum()} beside {steps.sum()} accepted steps", ""),
        ("largest rise of energy", "none", f"{study.run.history.rise.max():.1e} s_hat r1^2", "round-off of the gaps"),
        ("wall time", "-", f"{study.wall_s[0]:.1f} s, direct solver {study.wall_s[1]:.1f} s", ""),
    ]


def markdown(rows: list[tuple[str, str, str, str]]) -> str:
    """The comparison as a Markdown table."""
    head = ["| quantity | paper | ours | why they differ |", "|---|---|---|---|"]
    return "\n".join(head + [f"| {' | '.join(row)} |" for row in rows]) + "\n"


def run_study(
    out_dir: AnyPath,
    alpha_deg: ArrayLike | None = None,
    beta_deg: ArrayLike | None = None,
    options: SimulationOptions | None = None,
) -> Study:
    """Solve the study, by default the paper's 190 cases, and write it into `out_dir`, all files together: cases.csv,
    history_*.csv, comparison.md, study.json and the pictures fig_09.png to fig_17.png. InputError when matplotlib is
    missing or the folder cannot be made or written, before anything is solved.
    """
    require("matplotlib", "plots", "the study")
    check_out_job(out_dir, RECORD)
    alpha, beta = grid() if alpha_deg is None or beta_deg is None else (alpha_deg, beta_deg)
    study = solve_study(alpha, beta, options)
    rows = comparison(study)
    record = study.run.record(study.table) | {"comparison": [list(row) for row in rows]}
    with job(out_dir, RECORD, record) as folder:
        ends = record["ends"]
        cases = ([i, *end.values()] for i, end in enumerate(ends, 1))
        write_text(folder / "cases.csv", csv_text(["case", *ends[0]], cases))
        for (alpha_deg, beta_deg), case in study.kinked:
            name = f"history_{alpha_deg:g}_{beta_deg:g}.csv"
            write_text(folder / name, csv_text(STEPS, study.run.steps(case)))
        write_text(folder / "comparison.md", markdown(rows))
        for number, fig in enumerate(figures(study), 9):
            tell(f"drawing fig_{number:02d}.png")
            if fig is not None:
                save_figure(folder / f"fig_{number:02d}.png", fig)
    return study


def in_space(study: Study, values: Array, names: tuple[str, ...], sheet: Array | None = None) -> Any:
    """Figs. 9 and 14: line loads, or locked strains, (n, 3) in space; `sheet` (n, 3): the surface through a grid of
    cases, and its mirror image, alpha -> -alpha."""
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


def strains(study: Study) -> Any:
    """Fig. 13: strain components against beta for each alpha; lines the direct solver, marks the paper's scheme."""
    fig, table = new_figure(12.0, 4.6), study.table
    axes = fig.subplots(1, 3)
    for k, ax in enumerate(axes):
        for alpha in np.unique(table.alpha_deg):
            rows = np.flatnonzero(table.alpha_deg == alpha)
            colour = viridis()(alpha / max(table.alpha_deg.max(), 1.0))
            ax.plot(table.beta_deg[rows], table.E[rows, k], "-", color=colour, lw=1.0, label=f"{alpha:g}")
            ax.plot(table.beta_deg[rows], study.run.E[rows, k], "o", color=colour, ms=3, mfc="none")
        free = ~table.unique
        ax.plot(table.beta_deg[free], table.E[free, k], "x", color="black", ms=7)
        ax.set(xlabel="ratio angle beta, degrees", ylabel=NAMES[k])
    axes[-1].legend(title="alpha,\ndegrees", fontsize=10, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    key = "lines: direct solver; circles: paper's scheme; crosses: strain not unique (limit from inside)"
    fig.suptitle(key, size=11)
    return fig


def steps(study: Study) -> Any:
    """Fig. 15: accepted steps of each case."""
    ax, number, good = new_axes(8.0, 4.2), np.arange(1, len(study.table) + 1), study.run.status == "converged"
    for rows, mark, colour, label in ((good, "o", BLUE, "converged"), (~good, "x", "black", "not converged")):
        if rows.any():
            ax.semilogy(number[rows], study.run.rest.steps[rows], mark, ms=4, color=colour, label=label)
    ax.axhspan(150, 300, color="0.88", zorder=0, label="most cases of the paper")
    ax.set(xlabel="load case (beta runs fastest)", ylabel="accepted steps n")
    ax.legend(fontsize=10)
    return ax.figure


def clock(study: Study) -> Any:
    """Fig. 16: cumulated time against steps."""
    ax = new_axes(6.4, 4.6)
    marks = ax.scatter(study.run.rest.steps, study.run.rest.time, c=study.table.beta_deg, cmap=viridis(), s=22)
    ax.axhspan(45.0, 60.0, color="0.88", zorder=0)
    ax.set(xscale="log", yscale="log", xlabel="accepted steps n", ylabel="cumulated time, s")
    ax.set_title("grey: accumulation of cases in the paper, 45 to 60 s", fontsize=11)
    ax.figure.colorbar(marks, ax=ax, label="beta, degrees")
    return ax.figure


def figures(study: Study) -> Iterator[Any]:
    """Figs. 9 to 17 in their order, 10 to 12 locked cells; None for one that the study has not."""
    yield in_space(study, study.run.rest.s, ("s_xx / s_hat", "s_xy / s_hat", "s_yy / s_hat"))
    for alpha, beta in ((0.0, 90.0), (0.0, 0.0), (45.0, 0.0)):
        yield draw_case(solve_table(Cell(), ([alpha], [beta]))).figure
    yield strains(study)
    yield in_space(study, study.run.E, NAMES, study.table.E)
    yield from (steps(study), clock(study))
    yield draw_run(study.run, [case for _, case in study.kinked]) if study.kinked else None
