"""The paper's study for our implementation: 190 load cases by its own scheme, and its published figures beside ours.

`run` writes tables (CSV, Markdown) and pictures into one folder; `rve.study.figures` draws them.
"""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from rve.common.errors import require
from rve.common.files import check_out_job, job, versions, write_text
from rve.common.texts import csv_text, json_text
from rve.common.types import Array
from rve.directions import grid
from rve.paper.dynamics import StewartTrinkleOptions
from rve.study.cases import Study, history_strain, side_contact_times, solve_study

RECORD = "study.json"
"""The record of a study in its folder; it lists the other files with their checksums."""


def _span(values: Array, low: float, high: float) -> str:
    inside = int(((values >= low) & (values <= high)).sum())
    return f"{inside} of {len(values)}"


def comparison(study: Study) -> list[tuple[str, str, str, str]]:
    """The paper's published figures beside ours: rows of quantity, paper, ours, reason for a difference."""
    rest, steps, sums = study.rest, study.rest.steps, study.rest.time
    order = np.argsort(steps)

    def name(i: int) -> str:
        return f"({study.alpha_deg[i]:g}, {study.beta_deg[i]:g})"

    def kink(alpha: float, beta: float) -> str:
        case = study.case(alpha, beta)
        if case is None:
            return "not in this study"
        first, last = side_contact_times(study, case)
        return f"first side contact {first:.0f} s, last {last:.0f} s"

    quarter, half, most = np.percentile(sums, [25, 50, 75])
    clock = "the paper states neither s_hat nor a start; s_hat is calibrated, see docs/explanation/paper_scheme.md"
    fewer = "our steps see the contact curvature: fewer"
    return [
        ("converged cases", "190 of 190", f"{(rest.status == 'converged').sum()} of {len(sums)}", ""),
        ("steps, 150 to 300", "most cases", _span(steps.astype(float), 150, 300), fewer),
        ("steps, quartiles", "-", " / ".join(f"{x:.0f}" for x in np.percentile(steps, [25, 50, 75])), ""),
        ("least steps", "80", f"{steps.min()} at {name(order[0])}", ""),
        ("most steps", "about 2800, two cases", ", ".join(f"{steps[i]} at {name(i)}" for i in order[:-4:-1]), _FREE),
        ("least sum of h", "14.5 s", f"{sums.min():.1f} s at {name(int(np.argmin(sums)))}", clock),
        ("sum of h, 45 to 60 s", "accumulation of cases", _span(sums, 45.0, 60.0), clock),
        ("sum of h, quartiles", "-", f"{quarter:.0f} / {half:.0f} / {most:.0f} s", ""),
        ("largest sum of h", "1340 s", f"{sums.max():.0f} s at {name(int(np.argmax(sums)))}", _FREE),
        ("sum of h, case 190 (45, 90)", "about 1340 s", _sum(study, 45.0, 90.0), "same clock"),
        ("kink, case 1 (0, 0)", "about 30 s", kink(0.0, 0.0), clock),
        ("kink, case 190 (45, 90)", "about 1200 s", kink(45.0, 90.0), clock),
        ("tried with too large a step", "-", f"{rest.rejected.sum()} beside {steps.sum()} accepted steps", ""),
        ("largest rise of energy", "none", f"{study.history.rise.max():.1e} s_hat r1^2", "round-off of the gaps"),
        ("wall time", "-", f"{study.wall_s[0]:.1f} s, direct solver {study.wall_s[1]:.1f} s", ""),
    ]


_FREE = "(15, 0) is at the edge of the loads that leave the strain free: almost no restoring force"


def _sum(study: Study, alpha: float, beta: float) -> str:
    case = study.case(alpha, beta)
    return "not in this study" if case is None else f"{study.rest.time[case]:.0f} s"


def markdown(rows: list[tuple[str, str, str, str]]) -> str:
    """The comparison as a Markdown table."""
    lines = ["| quantity | paper | ours | why they differ |", "|---|---|---|---|"]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows]) + "\n"


def cases_csv(study: Study) -> str:
    """One line per case: steps, times, residual, strains of both methods."""
    strains = "E11,E12,E22,E11_direct,E12_direct,E22_direct,unique"
    header = f"case,alpha_deg,beta_deg,steps,rejected,time_s,R,status,{strains}"
    rest, E = study.rest, study.table.E
    direct = np.where(np.isfinite(E), E.astype(object), "")
    columns = [study.alpha_deg, study.beta_deg, rest.steps, rest.rejected, rest.time, rest.R, rest.status]
    columns += [*study.E.T, *direct.T, study.table.unique.astype(int)]
    rows = zip(range(1, len(E) + 1), *(column.tolist() for column in columns), strict=True)
    return csv_text(header.split(","), rows)


def history_csv(study: Study, case: int) -> str:
    """One line per accepted step of a case: time, step, strain, R, kinetic energy."""
    h = study.history
    rows = np.flatnonzero(h.case == case)
    E = history_strain(study, rows)
    values = np.column_stack([h.time[rows], h.h[rows], E, h.R[rows], h.kinetic[rows], h.side[rows]])
    header = "time_s,h_s,E11,E12,E22,R,kinetic_kg_mm2_per_s2,side_contacts"
    return csv_text(header.split(","), values.tolist())


def run(
    out_dir: str | os.PathLike[str],
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
    require("matplotlib", "plots", "the study")
    check_out_job(out_dir, RECORD)
    alpha, beta = grid() if alpha_deg is None or beta_deg is None else (alpha_deg, beta_deg)
    study = solve_study(alpha, beta, None, options)
    with job(out_dir, RECORD) as folder:
        _write(study, folder)
    return study


def _write(study: Study, folder: Path) -> None:
    """Every table and picture of a study."""
    from rve.study.figures import draw_all

    write_text(folder / "cases.csv", cases_csv(study))
    for pair in ((0.0, 0.0), (45.0, 90.0)):
        case = study.case(*pair)
        if case is not None:
            write_text(folder / f"history_{pair[0]:g}_{pair[1]:g}.csv", history_csv(study, case))
    rows = comparison(study)
    write_text(folder / "comparison.md", markdown(rows))
    record = {"options": asdict(study.options), "comparison": [list(row) for row in rows], "versions": versions()}
    write_text(folder / RECORD, json_text(record))
    draw_all(study, folder)
