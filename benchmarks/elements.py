"""Which element for a rigid curtain? Error against unknowns and time, on exact nets and on hanging squares of rings.

python -m benchmarks.elements [--quick] [--out DIR] writes elements.md. Two problems:

net      a net square (two families at 45 degrees, top gathered to 70 %): its mean height is known exactly;
corners  a square metre of rings hung by its top corners: the reference is the middle of the bounds on an adapted mesh.
"""

from __future__ import annotations

import argparse
import platform
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from homogenize.law import MembraneLaw, default_law, diagonal_net
from macro_fem.adapt import levels
from macro_fem.output import versions
from macro_fem.scene import read_scene
from macro_fem.solvers import solve_scene

NET_MEAN_HEIGHT = 14.187635
KINDS = (
    ("P1 diagonal", "P1", "diagonal", 1),
    ("P1 crossed", "P1", "crossed", 1),
    ("P1 aligned", "P1", "aligned", 1),
    ("P2 diagonal", "P2", "diagonal", 2),
    ("P2 aligned", "P2", "aligned", 2),
    ("CR aligned", "CR", "aligned", 1),
    ("Q1", "Q1", "crossed", 1),
    ("Q2", "Q2", "crossed", 2),
)
"""Name, element, pattern, and by how much coarser the mesh is taken for the same spacing of nodes."""


@dataclass(frozen=True)
class Problem:
    """A scene without its mesh, its law, the height that errors are divided by, and the reference mean height."""

    name: str
    tables: dict[str, Any]
    law: MembraneLaw
    height: float
    reference: float


@dataclass(frozen=True)
class Row:
    """One run: relative error of the mean height (signed: above the reference is positive), unknowns, time, status."""

    kind: str
    cells: int
    unknowns: int
    error: float
    seconds: float
    status: str


def net_problem() -> Problem:
    """Exact on any mesh whose edges follow both families."""
    tables = {"curtain": {"width": 40.0, "height": 40.0, "areal_mass": 1.0}, "support": {"kind": "top", "gather": 0.7}}
    return Problem("net", tables, diagonal_net(), 40.0, NET_MEAN_HEIGHT)


def corner_problem(adapt: int) -> Problem:
    """The reference is the middle of the certified interval; half its width is its error."""
    tables = {"curtain": {"width": 1000.0, "height": 1000.0}, "support": {"kind": "corners"}}
    law = default_law()
    scene = read_scene({**tables, "mesh": {"cells": 16}, "solver": {"adapt": adapt}})
    *_, finest = levels(scene, law)
    total = float(np.abs(finest.solution.problem.force).sum())
    high = finest.solution.mean_height()
    low = high - finest.bounds.gap / total
    return Problem(
        f"corners, reference {0.5 * (low + high):.2f} +- {0.5 * (high - low):.2f} mm",
        tables,
        law,
        1000.0,
        0.5 * (low + high),
    )


def run(problem: Problem, kind: tuple[str, str, str, int], cells: int) -> Row:
    """One element on one mesh."""
    name, element, pattern, coarser = kind
    mesh = {"cells": cells // coarser, "element": element, "pattern": pattern}
    begin = time.perf_counter()
    solution = solve_scene(read_scene({**problem.tables, "mesh": mesh}), problem.law)
    seconds = time.perf_counter() - begin
    error = (solution.mean_height() - problem.reference) / problem.height
    return Row(name, solution.problem.disc.n_cells, solution.problem.fem.n, error, seconds, solution.status)


def order(rows: list[Row]) -> float:
    """Slope of log |error| over log of the spacing (unknowns to the power -1/2)."""
    h = np.log([row.unknowns**-0.5 for row in rows])
    return float(np.polyfit(h, np.log([max(abs(row.error), 1e-16) for row in rows]), 1)[0])


def report(problem: Problem, sizes: list[int]) -> list[str]:
    """A Markdown table: one line per run, the fitted order after the finest mesh of each element."""
    lines = [
        f"### {problem.name}",
        "",
        "| element | cells | unknowns | error / height | s | order |",
        "|---|---|---|---|---|---|",
    ]
    for kind in KINDS:
        if kind[1] == "CR" and problem.tables["support"]["kind"] == "corners":
            continue  # has no nodes at corners
        rows = [run(problem, kind, cells) for cells in sizes]
        for row in rows:
            slope = ("exact" if abs(row.error) < 1e-7 else f"{order(rows):.2f}") if row is rows[-1] else ""
            error = f"{row.error:+.2e}" if row.status == "converged" else row.status
            lines.append(f"| {row.kind} | {row.cells} | {row.unknowns} | {error} | {row.seconds:.2f} | {slope} |")
    return [*lines, ""]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="coarse meshes only")
    parser.add_argument("--out", type=Path, default=Path("out"))
    options = parser.parse_args()
    sizes = [8, 16] if options.quick else [8, 16, 32]
    lines = report(net_problem(), sizes) + report(corner_problem(1 if options.quick else 4), sizes)
    used = ", ".join(f"{name} {version}" for name, version in versions().items())
    lines += [f"{platform.processor() or platform.machine()}, {used}", ""]
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "elements.md").write_text("\n".join(lines), encoding="utf-8")
    sys.stdout.write("\n".join(lines))


if __name__ == "__main__":
    main()
