"""The same hyperelastic sheet by macro_fem and by other codes: `python -m benchmarks.neo_hookean [--n 200]`.

Unit square, N x N Q1 with 2 x 2 points, incompressible neo-Hookean sheet in plane stress with mu = 1, left and right
edges clamped, stretched to 1.5 in ten equal steps, Newton to 1e-9 of the residual. Each code runs in a process of its
own, one after the other. The best of `--repeats` runs counts, because other work on the machine only adds time. A code
that is not installed is named as absent. The codes are in `benchmarks.sheet`.
"""

import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from benchmarks.report.files import write_page
from benchmarks.report.measure import Row, last_line
from benchmarks.report.records import Section, table

REACTION = 1.1032477454  # at n = 200: dolfinx, felupe, scikit-fem, ngsolve and getfem agree


@dataclass(frozen=True)
class Entry:
    """A row of the table: which code runs, with which Python, in which mode, on how many BLAS threads."""

    name: str
    module: str
    arguments: tuple[str, ...] = ()
    is_system_python: bool = False
    threads: int = 1


ENTRIES = (
    Entry("macro_fem, CHOLMOD", "ours", ("cholmod",)),
    Entry("macro_fem, CHOLMOD, 2 threads", "ours", ("cholmod",), threads=2),
    Entry("macro_fem, SuperLU (plain install)", "ours", ("superlu",)),
    Entry("dolfinx + MUMPS", "dolfinx_sheet", is_system_python=True),
    Entry("scikit-fem + CHOLMOD, plain", "plain_skfem", ("cholmod",)),
    Entry("scikit-fem + SuperLU, plain", "plain_skfem", ("superlu",)),
    Entry("felupe", "felupe_sheet"),
)


def run(entry: Entry, n: int) -> dict[str, Any]:
    """One run's answer, or {"absent": why}."""
    python = shutil.which("python3", path=os.defpath) if entry.is_system_python else sys.executable
    if python is None:
        return {"absent": "no system Python"}
    command = [python, "-m", "benchmarks.sheet", entry.module, str(n), *entry.arguments]
    answer: dict[str, Any] = last_line(command, entry.threads)
    return answer


def best_of(entry: Entry, n: int, repeats: int) -> dict[str, Any]:
    """The quickest of the runs."""
    return min((run(entry, n) for _ in range(repeats)), key=lambda answer: answer.get("solve_s", float("inf")))


def row(entry: Entry, found: dict[str, Any], ours: float) -> Row:
    """One code; the ratio compares setup + solve with `ours` seconds."""
    if "absent" in found:
        return {"code": entry.name, "remark": f"absent here: {found['absent']}"}
    return {
        "code": f"{entry.name} ({found['version']})",
        "solve s": found["solve_s"],
        "setup s": found["setup_s"],
        "ratio": (found["setup_s"] + found["solve_s"]) / ours,
        "Newton": found["iterations"],
        "factors": found["factorizations"],
        "reaction": found["reaction"],
        "remark": found["note"] if found["ok"] else f"did not converge; {found['note']}",
    }


@click.command(help=__doc__)
@click.option("--n", default=200, show_default=True, help="cells along an edge")
@click.option("--repeats", default=2, show_default=True, help="runs of each code; the best counts")
@click.option("--out", default="docs/measured/neo_hookean.md", show_default=True, help="Markdown file to write")
def main(n: int, repeats: int, out: str) -> None:
    """Run all codes and write the table."""

    def measure() -> Section:
        answers = [(entry, best_of(entry, n, repeats)) for entry in ENTRIES]
        ours = sum(answers[0][1].get(key, float("nan")) for key in ("setup_s", "solve_s"))
        rows = [row(*one, ours) for one in answers]
        forms = dict.fromkeys(("solve s", "setup s", "ratio"), ".2f timed") | {"reaction": ".10f"}
        note = (
            "Ratio: setup + solve against the first row. Newton: iterations over the ten steps. Times without the "
            "imports of the packages."
        ) + f" Reaction found by five codes before: {REACTION}." * (n == 200)
        return Section(f"{n} x {n} Q1, ten steps to stretch 1.5", "", (table("", rows, forms, note),))

    story = (__doc__ or "").split("\n", 2)[2].strip()
    command = f"python -m benchmarks.neo_hookean --n {n} --repeats {repeats}"
    write_page(Path(out), "Neo-Hookean sheet", story, command, measure)


if __name__ == "__main__":
    main()
