"""The elastic curtain beside the rigid one: iterations over mesh and compliance, and the difference of their answers.

`python -m benchmarks.elastic [--cells 7,15,30,60] [--out DIR]` writes elastic.md. Times are wall times of one run each.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.problems import square
from benchmarks.report.files import write_page
from benchmarks.report.measure import Row
from benchmarks.report.records import Section, table
from homogenize.io import default_law
from homogenize.laws.protocol import MembraneLaw
from macro_fem.curtain import solve_scene
from macro_fem.scene.schema import read_scene
from macro_fem.solution import CurtainSolution

STIFFNESSES = (1e0, 1e1, 1e2, 1e3, 1e4, 1e5)
"""N/mm; the law states 1000. With line loads of some 0.3 N/mm the rings stretch by 0.3 to 3e-6."""
SUPPORTS: dict[str, dict[str, Any]] = {
    "two corners": {"kind": "corners"},
    "top, gathered to 80 %": {"kind": "top", "gather": 0.8},
}
TEXT = "A square metre of rings, r1/r2 = 10, hung by its top corners or its top edge; crossed P1 triangles."


def law_of(stiffness: float) -> MembraneLaw:
    """The shipped ring law with one stiffness for all directions, N/mm."""
    law = default_law()
    return replace(law, stiffness=stiffness * np.eye(3), strength=None)  # type: ignore[type-var]


def solved(support: str, cells: int, stiffness: float, kind: str = "elastic") -> CurtainSolution:
    """One curtain by one solver."""
    mesh, solver = {"cells": cells, "pattern": "crossed"}, {"kind": kind, "max_iterations": 1000}
    scene = read_scene(square(cells, SUPPORTS[support], mesh=mesh, solver=solver))
    return solve_scene(scene, law_of(stiffness))


def row(support: str, cells: int, stiffness: float) -> Row:
    """Iterations and times of one run."""
    found = solved(support, cells, stiffness)
    return {
        "support": support,
        "cells": found.problem.disc.n_cells,
        "k, N/mm": stiffness,
        "status": found.status,
        "steps": found.iterations,
        "residual": found.residual,
        "potential, N mm": found.primal,
        "s": found.wall_s,
    }


def difference_row(support: str, stiffness: float, rigid: CurtainSolution, cells: int) -> Row:
    """The change of the potential by compliance: multiplied by k it tends to a constant."""
    elastic = solved(support, cells, stiffness)
    fall, moved = rigid.primal - elastic.primal, float(np.linalg.norm(elastic.x - rigid.x, axis=1).max())
    row = {"support": support, "k, N/mm": stiffness, "rigid minus elastic, N mm": fall}
    return row | {"times k": fall * stiffness, "farthest node, mm": moved}


@click.command(help=__doc__)
@click.option("--cells", default="7,15,30,60", help="Cells along the width, from coarse to fine.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("."), help="Folder for elastic.md.")
def main(cells: str, out: Path) -> None:
    """Run all and write elastic.md."""
    sizes = [int(item) for item in cells.split(",")]
    forms = {"k, N/mm": "g", "residual": ".0e", "potential, N mm": ".6f", "s": ".1f timed"}

    def measure() -> Section:
        over_mesh = [row("two corners", n, 1e3) for n in sizes]
        over_compliance = [row("two corners", sizes[min(1, len(sizes) - 1)], k) for k in STIFFNESSES]
        rigid = {support: solved(support, sizes[0], 1e3, "rigid") for support in SUPPORTS}
        apart = [difference_row(name, k, one, sizes[0]) for name, one in rigid.items() for k in STIFFNESSES[1:]]
        tables = (
            table("Over the mesh", over_mesh, forms),
            table("Over the compliance", over_compliance, forms),
            table(
                "Towards the rigid curtain",
                apart,
                {"k, N/mm": "g", "rigid minus elastic, N mm": ".6g", "times k": ".4g"},
            ),
        )
        return Section("Iterations and differences", "", tables)

    title, command = "The elastic curtain beside the rigid one", f"python -m benchmarks.elastic --cells {cells}"
    write_page(out / "elastic.md", title, TEXT, command, measure)


if __name__ == "__main__":
    main()
