"""The paper's study for our implementation: 190 load cases by its scheme, compared with its published figures."""

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rve.common import AnyPath, Array, Index, check_out_job, csv_text, job, require, tell, versions, write_text
from rve.common.drawing.plane import BLUE, GREEN, VERMILION, new_axes, new_figure, save_figure, viridis
from rve.directions import grid
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load, lattice_strain
from rve.geometry.pose import strain_of
from rve.locking.system import Equations
from rve.plots import draw_case
from rve.simulation.dynamics import StewartTrinkleOptions
from rve.simulation.stewart_trinkle import CellMotion, History, simulate
from rve.solve import solve_table
from rve.table import StrainTable

RECORD = "study.json"
"""It lists the other files with their checksums."""
NAMES, COLOURS = ("E11", "E12", "E22"), (BLUE, VERMILION, GREEN)
KINKED = ((0.0, 0.0), (45.0, 90.0))
"""Cases 1 and 190 of the paper, whose motion it shows in Fig. 17."""


@dataclass(frozen=True)
class Study:
    """Load cases solved by both methods. sides: of the rigid reference cell in r1, to which strains of both refer;
    wall_s: seconds of the scheme and of the direct solver.
    """

    table: StrainTable
    options: StewartTrinkleOptions
    rest: CellMotion
    history: History
    sides: tuple[float, float]
    wall_s: tuple[float, float]

    @property
    def E(self) -> Array:
        """Strains (n, 3) of the paper's scheme."""
        return strain_of(self.rest.pose, self.sides)

    @property
    def kinked(self) -> list[tuple[tuple[float, float], int]]:
        """Which of `KINKED` the study has, and their rows."""
        directions = zip(self.table.alpha_deg.tolist(), self.table.beta_deg.tolist(), strict=True)
        return [(pair, i) for i, pair in enumerate(directions) if pair in KINKED]

    def path(self, case: int) -> tuple[Index, Array]:
        """Rows of the history that belong to a case, (m,), and its strains there, (m, 3)."""
        rows = np.flatnonzero(self.history.case == case)
        return rows, lattice_strain(self.history.lattice[rows], self.sides)[0]

    def side_contact_times(self, case: int) -> tuple[float, float]:
        """Times in s from which the first, and all, of the final contacts between rings that do not interlink press to
        the end; nan without such a contact.
        """
        rows = self.history.case == case
        side, times = self.history.side[rows], self.history.time[rows]
        if not side[-1]:
            return float("nan"), float("nan")
        # from the step after the last one in which they did not press
        first, last = (np.append(0, np.flatnonzero(~pressed) + 1)[-1] for pressed in (side > 0, side == side[-1]))
        return float(times[first]), float(times[last])


def solve_study(alpha_deg: ArrayLike, beta_deg: ArrayLike, options: StewartTrinkleOptions | None = None) -> Study:
    """Solve the cases of the paper's cell by its scheme, with history, and by the direct solver."""
    cell, options = Cell(), options or StewartTrinkleOptions()
    began = time.perf_counter()
    table = solve_table(cell, (alpha_deg, beta_deg))
    between = time.perf_counter()
    s = cauchy_line_load(table.alpha_deg, table.beta_deg)
    rest = simulate(s, Equations.of(cell.weave, cell.wire), options, history=True)
    ended = time.perf_counter()
    assert rest.history is not None
    assert table.cell is not None
    sides = table.cell.b_x_mm / cell.r1, table.cell.b_y_mm / cell.r1
    return Study(table, options, rest, rest.history, sides, (ended - between, between - began))


def comparison(study: Study) -> list[tuple[str, str, str, str]]:
    """The paper's published figures compared with ours: rows of quantity, paper, ours, reason for a difference."""
    rest, steps, sums = study.rest, study.rest.steps, study.rest.time
    order = np.argsort(steps)

    def name(i: int) -> str:
        return f"({study.table.alpha_deg[i]:g}, {study.table.beta_deg[i]:g})"

    def span(values: Any, low: float, high: float) -> str:
        return f"{((values >= low) & (values <= high)).sum()} of {len(values)}"

    def quartiles(values: Any) -> str:
        return " / ".join(f"{x:.0f}" for x in np.percentile(values, [25, 50, 75]))

    kinks, ends = (dict.fromkeys(KINKED, "not in this study") for _ in range(2))
    for pair, case in study.kinked:
        first, last = study.side_contact_times(case)
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
        ("largest rise of energy", "none", f"{study.history.rise.max():.1e} s_hat r1^2", "round-off of the gaps"),
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
    options: StewartTrinkleOptions | None = None,
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
    record = {"options": asdict(study.options), "comparison": [list(row) for row in rows], "versions": versions()}
    with job(out_dir, RECORD, record) as folder:
        write_text(folder / "cases.csv", _cases_csv(study))
        for (alpha_deg, beta_deg), case in study.kinked:
            write_text(folder / f"history_{alpha_deg:g}_{beta_deg:g}.csv", _history_csv(study, case))
        write_text(folder / "comparison.md", markdown(rows))
        for number, fig in enumerate(figures(study), 9):
            tell(f"drawing fig_{number:02d}.png")
            if fig is not None:
                save_figure(folder / f"fig_{number:02d}.png", fig)
    return study


def _cases_csv(study: Study) -> str:
    """One line per case: steps, times, residual, strains of both methods."""
    header = "case,alpha_deg,beta_deg,steps,rejected,time_s,R,status,E11,E12,E22"
    header += ",E11_direct,E12_direct,E22_direct,unique"
    rest, table = study.rest, study.table
    direct = np.where(np.isfinite(table.E), table.E.astype(object), "")
    columns: list[Any] = [table.alpha_deg, table.beta_deg, rest.steps, rest.rejected, rest.time, rest.R, rest.status]
    columns += [*study.E.T, *direct.T, table.unique.astype(int)]
    rows = zip(range(1, len(table) + 1), *(column.tolist() for column in columns), strict=True)
    return csv_text(header.split(","), rows)


def _history_csv(study: Study, case: int) -> str:
    """One line per accepted step of a case."""
    h, (rows, E) = study.history, study.path(case)
    values = np.column_stack([h.time[rows], h.h[rows], E, h.R[rows], h.kinetic[rows], h.side[rows]])
    header = ["time_s", "h_s", *NAMES, "R", "kinetic_kg_mm2_per_s2", "side_contacts"]
    return csv_text(header, values.tolist())


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
            ax.plot(table.beta_deg[rows], study.E[rows, k], "o", color=colour, ms=3, mfc="none")
        free = ~table.unique
        ax.plot(table.beta_deg[free], table.E[free, k], "x", color="black", ms=7)
        ax.set(xlabel="ratio angle beta, degrees", ylabel=NAMES[k])
    axes[-1].legend(title="alpha,\ndegrees", fontsize=10, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    key = "lines: direct solver; circles: paper's scheme; crosses: strain not unique (limit from inside)"
    fig.suptitle(key, size=11)
    return fig


def steps(study: Study) -> Any:
    """Fig. 15: accepted steps of each case."""
    ax, number, good = new_axes(8.0, 4.2), np.arange(1, len(study.table) + 1), study.rest.status == "converged"
    for rows, mark, colour, label in ((good, "o", BLUE, "converged"), (~good, "x", "black", "not converged")):
        if rows.any():
            ax.semilogy(number[rows], study.rest.steps[rows], mark, ms=4, color=colour, label=label)
    ax.axhspan(150, 300, color="0.88", zorder=0, label="most cases of the paper")
    ax.set(xlabel="load case (beta runs fastest)", ylabel="accepted steps n")
    ax.legend(fontsize=10)
    return ax.figure


def clock(study: Study) -> Any:
    """Fig. 16: cumulated time against steps."""
    ax = new_axes(6.4, 4.6)
    marks = ax.scatter(study.rest.steps, study.rest.time, c=study.table.beta_deg, cmap=viridis(), s=22)
    ax.axhspan(45.0, 60.0, color="0.88", zorder=0)
    ax.set(xscale="log", yscale="log", xlabel="accepted steps n", ylabel="cumulated time, s")
    ax.set_title("grey: accumulation of cases in the paper, 45 to 60 s", fontsize=11)
    ax.figure.colorbar(marks, ax=ax, label="beta, degrees")
    return ax.figure


def progress_of_two(study: Study) -> Any:
    """Fig. 17: strain, R and kinetic energy against time for cases 1 and 190; None if the study has neither."""
    cases = study.kinked
    if not cases:
        return None
    fig, h = new_figure(5.2 * len(cases), 6.4), study.history
    axes = fig.subplots(2, len(cases), squeeze=False, sharex="col")
    for (upper, lower), (pair, case) in zip(axes.T, cases, strict=True):
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
    key = "from here on one, and all, of the final contacts\nbetween rings that do not interlink press"
    fig.suptitle(f"grey lines: {key}", size=11)
    return fig


def figures(study: Study) -> Iterator[Any]:
    """Figs. 9 to 17 in their order, 10 to 12 locked cells; None for one that the study has not."""
    yield in_space(study, study.rest.s, ("s_xx / s_hat", "s_xy / s_hat", "s_yy / s_hat"))
    for alpha, beta in ((0.0, 90.0), (0.0, 0.0), (45.0, 0.0)):
        yield draw_case(solve_table(Cell(), ([alpha], [beta]))).figure
    yield strains(study)
    yield in_space(study, study.E, NAMES, study.table.E)
    yield from (draw(study) for draw in (steps, clock, progress_of_two))
