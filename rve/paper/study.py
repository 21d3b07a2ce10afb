"""The paper's study for our implementation: 190 load cases by its own scheme, and its published figures beside ours."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from rve.common import AnyPath, Array, Index, check_out_job, csv_text, job, json_text, require, versions, write_text
from rve.directions import grid
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load, lattice_strain
from rve.geometry.pose import strain_of
from rve.paper.dynamics import StewartTrinkleOptions
from rve.paper.stewart_trinkle import CellMotion, History, solve
from rve.solve import solve_table
from rve.table import StrainTable

RECORD = "study.json"
"""The record of a study in its folder; it lists the other files with their checksums."""
KINKED = ((0.0, 0.0), (45.0, 90.0))
"""Cases 1 and 190 of the paper, whose motion it shows in Fig. 17."""


@dataclass(frozen=True)
class Study:
    """Load cases solved by both methods: rows of the direct solver, and rings that came to rest by the paper's scheme.

    sides: of the rigid reference cell in r1, to which strains of both refer; wall_s: seconds of the scheme and of the
    direct solver.
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

    def case(self, alpha_deg: float, beta_deg: float) -> int | None:
        """Row of a load direction, None where the study has none."""
        rows = np.flatnonzero((self.table.alpha_deg == alpha_deg) & (self.table.beta_deg == beta_deg))
        return int(rows[0]) if len(rows) else None

    def path(self, case: int) -> tuple[Index, Array]:
        """Rows of the history that belong to a case, (m,), and its strains there, (m, 3)."""
        rows = np.flatnonzero(self.history.case == case)
        return rows, lattice_strain(self.history.lattice[rows], self.sides)[0]

    def side_contact_times(self, case: int) -> tuple[float, float]:
        """Times in s from which, for good, one and all of the final contacts between rings that do not interlink press.

        nan where the locked state has no such contact.
        """
        rows = self.history.case == case
        side, times = self.history.side[rows], self.history.time[rows]
        if not side[-1]:
            return float("nan"), float("nan")
        # from the step after the last one in which they did not press
        one, all_ = (np.append(0, np.flatnonzero(~pressed) + 1)[-1] for pressed in (side > 0, side == side[-1]))
        return float(times[one]), float(times[all_])


def solve_study(alpha_deg: ArrayLike, beta_deg: ArrayLike, options: StewartTrinkleOptions | None = None) -> Study:
    """Solve the cases of the paper's cell by its scheme, with history, and by the direct solver."""
    cell, options = Cell(), options or StewartTrinkleOptions()
    began = time.perf_counter()
    table = solve_table(cell, (alpha_deg, beta_deg))
    between = time.perf_counter()
    s = cauchy_line_load(table.alpha_deg, table.beta_deg)
    rest = solve(s, Equations.of(cell.weave, cell.wire), options, history=True)
    ended = time.perf_counter()
    assert rest.history is not None
    sides = table.provenance["b_x_mm"] / cell.r1, table.provenance["b_y_mm"] / cell.r1
    return Study(table, options, rest, rest.history, sides, (ended - between, between - began))


def comparison(study: Study) -> list[tuple[str, str, str, str]]:
    """The paper's published figures beside ours: rows of quantity, paper, ours, reason for a difference."""
    rest, steps, sums = study.rest, study.rest.steps, study.rest.time
    order = np.argsort(steps)

    def name(i: int) -> str:
        return f"({study.table.alpha_deg[i]:g}, {study.table.beta_deg[i]:g})"

    def span(values: Array, low: float, high: float) -> str:
        return f"{((values >= low) & (values <= high)).sum()} of {len(values)}"

    def kink(alpha: float, beta: float) -> str:
        case = study.case(alpha, beta)
        if case is None:
            return "not in this study"
        first, last = study.side_contact_times(case)
        return f"first side contact {first:.0f} s, last {last:.0f} s"

    (one, other), last_case = KINKED, study.case(*KINKED[1])
    quarter, half, most = np.percentile(sums, [25, 50, 75])
    clock = "the paper states neither s_hat nor a start; s_hat is calibrated, see docs/explanation/paper_scheme.md"
    free = "(15, 0) is at the edge of the loads that leave the strain free: almost no restoring force"
    fewer = "our steps see the contact curvature: fewer"
    own_sum = "not in this study" if last_case is None else f"{sums[last_case]:.0f} s"
    return [
        ("converged cases", "190 of 190", f"{(rest.status == 'converged').sum()} of {len(sums)}", ""),
        ("steps, 150 to 300", "most cases", span(steps.astype(float), 150, 300), fewer),
        ("steps, quartiles", "-", " / ".join(f"{x:.0f}" for x in np.percentile(steps, [25, 50, 75])), ""),
        ("least steps", "80", f"{steps.min()} at {name(order[0])}", ""),
        ("most steps", "about 2800, two cases", ", ".join(f"{steps[i]} at {name(i)}" for i in order[:-4:-1]), free),
        ("least sum of h", "14.5 s", f"{sums.min():.1f} s at {name(int(np.argmin(sums)))}", clock),
        ("sum of h, 45 to 60 s", "accumulation of cases", span(sums, 45.0, 60.0), clock),
        ("sum of h, quartiles", "-", f"{quarter:.0f} / {half:.0f} / {most:.0f} s", ""),
        ("largest sum of h", "1340 s", f"{sums.max():.0f} s at {name(int(np.argmax(sums)))}", free),
        ("sum of h, case 190 (45, 90)", "about 1340 s", own_sum, "same clock"),
        ("kink, case 1 (0, 0)", "about 30 s", kink(*one), clock),
        ("kink, case 190 (45, 90)", "about 1200 s", kink(*other), clock),
        ("tried with too large a step", "-", f"{rest.rejected.sum()} beside {steps.sum()} accepted steps", ""),
        ("largest rise of energy", "none", f"{study.history.rise.max():.1e} s_hat r1^2", "round-off of the gaps"),
        ("wall time", "-", f"{study.wall_s[0]:.1f} s, direct solver {study.wall_s[1]:.1f} s", ""),
    ]


def markdown(rows: list[tuple[str, str, str, str]]) -> str:
    """The comparison as a Markdown table."""
    lines = ["| quantity | paper | ours | why they differ |", "|---|---|---|---|"]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows]) + "\n"


def run(
    out_dir: AnyPath,
    alpha_deg: ArrayLike | None = None,
    beta_deg: ArrayLike | None = None,
    options: StewartTrinkleOptions | None = None,
) -> Study:
    """Solve the study and write it into `out_dir`, which is made if need be: cases.csv, history_*.csv, comparison.md,
    study.json and the pictures fig_09.png to fig_17.png. Returns what was solved.

    Without angles these are the paper's 190 cases: about two minutes on one core.
    All files appear together, and what they replace is gone (`rve.common.files`). InputError when matplotlib is
    missing or the folder cannot be made or written, before anything is solved.
    """
    from rve.paper.figures import draw_all

    require("matplotlib", "plots", "the study")
    check_out_job(out_dir, RECORD)
    alpha, beta = grid() if alpha_deg is None or beta_deg is None else (alpha_deg, beta_deg)
    study = solve_study(alpha, beta, options)
    rows = comparison(study)
    record = {"options": asdict(study.options), "comparison": [list(row) for row in rows], "versions": versions()}
    with job(out_dir, RECORD) as folder:
        write_text(folder / "cases.csv", _cases_csv(study))
        for pair in KINKED:
            case = study.case(*pair)
            if case is not None:
                write_text(folder / f"history_{pair[0]:g}_{pair[1]:g}.csv", _history_csv(study, case))
        write_text(folder / "comparison.md", markdown(rows))
        write_text(folder / RECORD, json_text(record))
        draw_all(study, Path(folder))
    return study


def _cases_csv(study: Study) -> str:
    """One line per case: steps, times, residual, strains of both methods."""
    header = "case,alpha_deg,beta_deg,steps,rejected,time_s,R,status,E11,E12,E22"
    header += ",E11_direct,E12_direct,E22_direct,unique"
    rest, table = study.rest, study.table
    direct = np.where(np.isfinite(table.E), table.E.astype(object), "")
    columns = [table.alpha_deg, table.beta_deg, rest.steps, rest.rejected, rest.time, rest.R, rest.status]
    columns += [*study.E.T, *direct.T, table.unique.astype(int)]
    rows = zip(range(1, len(table) + 1), *(column.tolist() for column in columns), strict=True)
    return csv_text(header.split(","), rows)


def _history_csv(study: Study, case: int) -> str:
    """One line per accepted step of a case: time, step, strain, R, kinetic energy."""
    h, (rows, E) = study.history, study.path(case)
    values = np.column_stack([h.time[rows], h.h[rows], E, h.R[rows], h.kinetic[rows], h.side[rows]])
    header = "time_s,h_s,E11,E12,E22,R,kinetic_kg_mm2_per_s2,side_contacts"
    return csv_text(header.split(","), values.tolist())
