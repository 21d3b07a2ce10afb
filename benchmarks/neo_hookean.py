"""The same hyperelastic sheet by macro_fem and by peers, side by side: `python -m benchmarks.neo_hookean [--n 200]`.

Problem: unit square, N x N Q1 with 2 x 2 points, incompressible neo-Hookean sheet in plane stress with mu = 1, left and
right edges clamped, stretched to 1.5 in ten equal steps, Newton to 1e-9 of the residual. Each code runs in a process of
its own, one after the other, with the same number of BLAS threads; the best of `--repeats` runs counts, because other
work on the machine only ever adds time. A peer that is not installed is named as absent.

Writes a Markdown table to `--out` (default docs/benchmark_neo_hookean.md).
"""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import click

from benchmarks.machine import ROOT, describe

REACTION = 1.1032477454  # at n = 200, found alike by dolfinx, felupe, scikit-fem, ngsolve and getfem


@dataclass(frozen=True)
class Entry:
    """A row of the table: what runs, with which Python, in which mode, on how many BLAS threads."""

    name: str
    module: str
    arguments: tuple[str, ...] = ()
    is_system_python: bool = False
    threads: int = 1


ENTRIES = (
    Entry("macro_fem, CHOLMOD", "ours", ("extrapolate", "cholmod")),
    Entry("macro_fem, CHOLMOD, tangent predictor only", "ours", ("tangent", "cholmod")),
    Entry("macro_fem, CHOLMOD, 2 threads", "ours", ("extrapolate", "cholmod"), threads=2),
    Entry("macro_fem, SuperLU (plain install)", "ours", ("extrapolate", "superlu")),
    Entry("dolfinx + MUMPS", "dolfinx_sheet", is_system_python=True),
    Entry("scikit-fem + CHOLMOD, plain", "plain_skfem", ("cholmod",)),
    Entry("scikit-fem + SuperLU, plain", "plain_skfem", ("superlu",)),
    Entry("felupe", "felupe_sheet"),
)


def run(entry: Entry, n: int) -> dict:
    """One run's JSON answer, or {"absent": why}."""
    python = shutil.which("python3", path=os.defpath) if entry.is_system_python else sys.executable
    if python is None:
        return {"absent": "no system Python"}
    file = ROOT / "benchmarks" / "sheet" / f"{entry.module}.py"
    count = str(entry.threads)
    env = os.environ | {"OMP_NUM_THREADS": count, "OPENBLAS_NUM_THREADS": count, "PYTHONPATH": str(ROOT)}
    command = [python, str(file), str(n), *entry.arguments]
    process = subprocess.run(command, capture_output=True, text=True, env=env, cwd=ROOT, check=False)
    lines = process.stdout.strip().splitlines()
    if process.returncode != 0 or not lines:
        return {"absent": (process.stderr.strip().splitlines() or ["it printed nothing"])[-1][:100]}
    return json.loads(lines[-1])


def best_of(entry: Entry, n: int, repeats: int) -> dict:
    """The quickest of the runs."""
    runs = [run(entry, n) for _ in range(repeats)]
    done = [r for r in runs if "absent" not in r]
    return min(done, key=lambda r: r["solve_s"]) if done else runs[0]


def table(answers: list[tuple[Entry, dict]], n: int) -> str:
    """The Markdown table; ratios compare setup + solve with the first row."""
    first = answers[0][1]
    ours = first.get("setup_s", 0.0) + first.get("solve_s", 0.0)
    rows = [
        "| code | solve s | setup s | ratio | Newton | factors | reaction | remark |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for entry, a in answers:
        if "absent" in a:
            rows.append(f"| {entry.name} | - | - | - | - | - | - | absent here: {a['absent']} |")
            continue
        ratio = (a["setup_s"] + a["solve_s"]) / ours if ours else float("nan")
        remark = a["note"] if a["ok"] else f"did not converge; {a['note']}"
        rows.append(
            f"| {entry.name} ({a['version']}) "
            f"| {a['solve_s']:.2f} | {a['setup_s']:.2f} | {ratio:.2f} "
            f"| {a['iterations']} | {a['factorizations']} | {a['reaction']:.10f} | {remark} |"
        )
    if n == 200:
        rows.append(f"\nReaction agreed on before by five codes: {REACTION}.")
    return "\n".join(rows)


@click.command()
@click.option("--n", default=200, show_default=True, help="cells along an edge")
@click.option("--repeats", default=2, show_default=True, help="runs of each code; the best counts")
@click.option("--out", default="docs/benchmark_neo_hookean.md", show_default=True, help="Markdown file to write")
def main(n: int, repeats: int, out: str) -> None:
    """Run all codes and write the table."""
    answers = []
    for entry in ENTRIES:
        answer = best_of(entry, n, repeats)
        print(entry.name, answer, flush=True)
        answers.append((entry, answer))
    story = (__doc__ or "").split("\n", 2)[2].strip()
    text = (
        f"# Neo-Hookean sheet, {n} x {n} Q1, ten steps to stretch 1.5\n\n{story}\n\n"
        f"{table(answers, n)}\n\nRatio: setup + solve against the first row. Newton: iterations over the ten steps. "
        "Times without the imports of the packages.\n\n"
        f"{describe()}\nRepeat: `python -m benchmarks.neo_hookean --n {n} --repeats {repeats}`.\n"
    )
    target = Path(out)
    part = target.with_suffix(".part")
    part.write_text(text)
    os.replace(part, target)


if __name__ == "__main__":
    main()
