"""Time and memory of the rigid curtain over the size of the mesh: `python -m benchmarks.scaling [--largest 1e5]`.

A square metre of rings (default law, thousands of half-spaces) hung by its corners, solved to a relative gap of 1e-9
with CHOLMOD and with SuperLU; the sizes run from 1e3 unknowns upwards in half decades. The mesh has about as many
unknowns as triangles. Each run is a process of its own with its own peak memory; 1 BLAS thread. No larger size is tried
once a run took longer than `--patience` seconds.
"""

import json
import resource
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import click
import numpy as np

from benchmarks.problems import square
from benchmarks.report.files import write_page
from benchmarks.report.measure import Row, last_line
from benchmarks.report.records import Diagram, Section, curves, table
from homogenize.io import default_law
from macro_fem.curtain import solve_problem
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.schema import read_scene
from macro_fem.solution import make_problem

METHODS = ("cholmod", "superlu")
WALL, PEAK = "wall s", "peak MB"
TIMES = dict.fromkeys((WALL, "processor s"), ".2f timed")
FORMS = {PEAK: ".0f timed", "relative gap": ".1e", "mean height mm": ".4f"}


def peak_memory() -> float:
    """Of this process so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def row(unknowns: int, method: str) -> Row:
    """The rigid corner-hung square with about as many unknowns: seconds, peak memory, steps, relative gap."""
    start, base = time.perf_counter(), peak_memory()
    scene = read_scene(square(max(4, round(np.sqrt(unknowns / 3.5)))))
    problem = make_problem(scene, default_law(), build_mesh(scene, default_law().cell))
    found = solve_problem(replace(problem, fem=replace(problem.fem, method=method)))
    size = float(np.abs(found.problem.force).sum()) * found.problem.mesh.size
    return {
        "method": method,
        "triangles": found.problem.disc.n_cells,
        "unknowns": found.problem.fem.n,
        WALL: time.perf_counter() - start,
        "processor s": time.process_time(),
        "steps": found.iterations,
        PEAK: peak_memory() - base,
        "relative gap": (found.primal - found.dual) / size,
        "mean height mm": found.mean_height(),
        "status": found.status,
    }


def climb(method: str, largest: float, patience: float) -> list[Row]:
    """The ladder of a method, until a run fails or takes longer than `patience`, each run in a process of its own."""
    rows: list[Row] = []
    for unknowns in 10.0 ** np.arange(3.0, np.log10(largest) + 0.01, 0.5):
        command = [sys.executable, "-m", "benchmarks.scaling", "--one", str(round(unknowns)), method]
        answer = last_line(command, patience=3.0 * patience)
        rows.append({"method": method, "status": answer["absent"]} if "absent" in answer else answer)
        click.echo(str(rows[-1]))
        if not rows[-1].get(WALL, np.inf) <= patience:
            break
    return rows


def growth(rows: list[Row]) -> str:
    """Exponents of time and memory between the last three sizes of a method."""
    done = [row for row in rows if WALL in row]
    if len(done) < 3:
        return ""
    a, b = done[-3], done[-1]
    decades = np.log(b["unknowns"] / a["unknowns"])
    time_power, memory_power = (np.log(max(b[key], 1e-9) / max(a[key], 1e-9)) / decades for key in (WALL, PEAK))
    return f"{a['method']}: time n^{time_power:.2f}, memory n^{memory_power:.2f}. "


def measure(largest: float, patience: float) -> Section:
    """All ladders, in a table and diagrams."""
    ladders = [climb(method, largest, patience) for method in METHODS]
    rows = [row for ladder in ladders for row in ladder]
    forms = {name: form for name, form in (TIMES | FORMS).items() if any(name in row for row in rows)}
    note = "Memory is that above the imports."
    done = [row for row in rows if WALL in row]
    diagrams = tuple(
        Diagram(
            key, f"{label} over the number of unknowns", "unknowns", label, curves(done, "method", "unknowns", column)
        )
        for key, label, column in (("time", "time (s)", WALL), ("memory", "peak memory above the imports (MB)", PEAK))
    )
    powers = "".join(growth(ladder) for ladder in ladders)
    conclusion = powers and f"Growth between the last three sizes: {powers}"
    return Section("Runs", "", (table("", rows, forms, note),), diagrams, conclusion)


@click.command(help=__doc__)
@click.option("--largest", default=1e5, show_default=True, help="most unknowns")
@click.option(
    "--patience", default=60.0, show_default=True, help="seconds of a run after which no larger size is tried"
)
@click.option(
    "--out", default="docs/measured/scaling.md", show_default=True, help="Markdown file; the pictures lie beside it"
)
@click.option("--one", nargs=2, default=None, help="internal: run one size with one method and print it")
def main(largest: float, patience: float, out: str, one: tuple[str, str] | None) -> None:
    """Run the ladders and write tables and pictures."""
    if one:
        click.echo(json.dumps(row(int(one[0]), one[1])))
        return
    story = (__doc__ or "").split("\n", 2)[2].strip()
    command = f"python -m benchmarks.scaling --largest {largest:g}"
    write_page(Path(out), "Scaling of the rigid curtain", story, command, partial(measure, largest, patience))


if __name__ == "__main__":
    main()
