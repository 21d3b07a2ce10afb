"""The elastic curtain beside the rigid one: iterations over mesh and compliance, and how both answers come together.

python -m benchmarks.elastic [--cells 7,15,30,60] [--out DIR] writes elastic.md. The scene is a square metre of rings
r1/r2 = 10 hung by its top corners on crossed P1 triangles; times are wall times of one run each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.machine import describe
from homogenize.law import MembraneLaw, default_law
from macro_fem.newton_records import NewtonRecord
from macro_fem.scene import read_scene
from macro_fem.solution import CurtainSolution
from macro_fem.solvers import solve_scene

STIFFNESSES = (1e0, 1e1, 1e2, 1e3, 1e4, 1e5)
"""N/mm; 1000 is what the law states. Line loads are some 0.3 N/mm, so that rings give by 0.3 to 3e-6."""
SUPPORTS: dict[str, dict[str, Any]] = {
    "two corners": {"kind": "corners"},
    "top, gathered to 80 %": {"kind": "top", "gather": 0.8},
}


@dataclass(frozen=True)
class Run:
    """One solved curtain: what it was, and what it took."""

    support: str
    stiffness: float
    solution: CurtainSolution

    @property
    def newton(self) -> int:
        """Steps of Newton's method among all iterations."""
        return sum(isinstance(line, NewtonRecord) for line in self.solution.history)


def law_of(stiffness: float) -> MembraneLaw:
    """The shipped ring law with another stiffness, N/mm."""
    law = default_law()
    return replace(law, stiffness=stiffness * np.eye(3))  # type: ignore[type-var]


def run(support: str, cells: int, stiffness: float, kind: str = "newton") -> Run:
    """One curtain by one solver."""
    tables = {
        "curtain": {"width": 1000.0, "height": 1000.0},
        "mesh": {"cells": cells, "pattern": "crossed"},
        "support": SUPPORTS[support],
        "solver": {"kind": kind, "max_iterations": 1000},
    }
    return Run(support, stiffness, solve_scene(read_scene(tables), law_of(stiffness)))


def table(runs: list[Run]) -> str:
    """Iterations and times, one line per run."""
    lines = [
        "| support | cells | k, N/mm | status | interior points | Newton steps | residual | potential, N mm | s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for one in runs:
        s = one.solution
        lines.append(
            f"| {one.support} | {s.problem.disc.n_cells} | {one.stiffness:g} | {s.status} | "
            f"{s.iterations - one.newton} | {one.newton} | {s.residual:.0e} | {s.primal:.6f} | {s.wall_s:.1f} |"
        )
    return "\n".join(lines)


def difference_table(cells: int) -> str:
    """What compliance is worth: k times the fall of the potential tends to a constant."""
    lines = ["| support | k, N/mm | rigid minus elastic, N mm | times k | farthest node, mm |", "|---|---|---|---|---|"]
    for support in SUPPORTS:
        rigid = run(support, cells, 1e3, "rigid").solution
        for stiffness in STIFFNESSES[1:]:
            elastic = run(support, cells, stiffness).solution
            fall = rigid.primal - elastic.primal
            moved = float(np.linalg.norm(elastic.x - rigid.x, axis=1).max())
            lines.append(f"| {support} | {stiffness:g} | {fall:.6g} | {fall * stiffness:.4g} | {moved:.3g} |")
    return "\n".join(lines)


@click.command()
@click.option("--cells", default="7,15,30,60", help="Cells along the width, from coarse to fine.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("."), help="Folder for elastic.md.")
def main(cells: str, out: Path) -> None:
    """Run all and write elastic.md."""
    sizes = [int(item) for item in cells.split(",")]
    over_mesh = table([run("two corners", n, 1e3) for n in sizes])
    over_compliance = table([run("two corners", sizes[min(1, len(sizes) - 1)], k) for k in STIFFNESSES])
    parts = [
        "# The elastic curtain beside the rigid one",
        describe(),
        "Command: python -m benchmarks.elastic.",
        "## Over the mesh",
        over_mesh,
        "## Over the compliance",
        over_compliance,
        "## Towards the rigid curtain",
        difference_table(sizes[0]),
    ]
    out.mkdir(parents=True, exist_ok=True)
    (out / "elastic.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    print((out / "elastic.md").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
