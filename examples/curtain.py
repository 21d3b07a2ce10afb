"""From ten rings to a curtain: the whole chain in one run.

1. ten rigid rings under 190 line loads lock          -> table.csv, table.json
2. a convex, tension-only membrane law is fitted      -> law.json
3. a curtain of 1 m x 1 m hangs by its two top corners -> curtain/summary.json, curtain.vtu, curtain.png

    python examples/curtain.py [--out DIR] [--cells N]

The checked number (tests/test_examples.py): the curtain's mean height lies inside rigorous bounds from another element.
"""

from __future__ import annotations

import time
from pathlib import Path

import click
import numpy as np

SCENE = """[curtain]
width = 1000.0      # mm, in the reference state
height = 1000.0     # mm
hang = "y"          # weave axis that points down
[mesh]
cells = {cells}          # cells along the width
element = "P1"
[support]
kind = "corners"
[load]
gravity = 9.81      # m/s2
[solver]
kind = "rigid"      # ideal locking
"""


def make_table(out: Path) -> Path:
    """Solve the paper's 190 load cases, write and draw them."""
    from rve.plots import draw_case, save
    from rve.ranges import grid
    from rve.sweep import Cell, solve_table
    from rve.table import write_table

    alpha, beta = grid(np.arange(0.0, 46.0, 5.0), np.arange(0.0, 91.0, 5.0))
    with click.progressbar(length=len(alpha), label="1 rings   ") as bar:
        table = solve_table(alpha, beta, Cell(r1=5.0, r2=0.5), progress=bar.update)
    write_table(table, out / "table.csv")
    save(draw_case(45.0, 0.0, Cell()), out / "cell.png")
    click.echo(f"  {table.converged.sum()} of {len(table)} load cases locked, largest residual {table.R.max():.1e}")
    return out / "table.csv"


def fit_law(table: Path, out: Path) -> Path:
    """Fit the default law, say how wrong it can be, draw it."""
    from homogenize.fit import fit_table
    from homogenize.plots import write_pictures
    from rve.table import read_table

    click.echo("2 law")
    result = fit_table(table)
    result.save(out / "law.json")
    for line in result.report.text().splitlines():
        click.echo(f"  {line}")
    write_pictures(result.law, read_table(table), out / "law")
    return out / "law.json"


def hang_curtain(law: Path, out: Path, cells: int) -> dict[str, object]:
    """Hang the corner-held curtain with this law."""
    from macro_fem.job import run_scene

    click.echo("3 curtain")
    scene = out / "scene.toml"
    scene.write_text(SCENE.format(cells=cells))
    summary = run_scene(scene, law, out / "curtain", picture=True)
    click.echo(f"  {summary['status']}: {summary['message']}")
    click.echo(f"  mean height {summary['mean_height_mm']:.2f} mm, lowest point {summary['lowest_point_mm']:.2f} mm")
    return summary


def run(out: Path, cells: int = 32) -> dict[str, object]:
    """The whole chain; returns the summary of the curtain."""
    out.mkdir(parents=True, exist_ok=True)
    law = fit_law(make_table(out), out)
    return hang_curtain(law, out, cells)


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out"), show_default=True, help="Folder for files."
)
@click.option("--cells", default=32, show_default=True, help="Cells along the width of the curtain.")
def main(out: Path, cells: int) -> None:
    """From ten rings to a curtain, with files and pictures in one folder."""
    began = time.perf_counter()
    run(out, cells)
    click.echo(f"done in {time.perf_counter() - began:.1f} s; see {out}/cell.png, {out}/law, {out}/curtain/curtain.png")


if __name__ == "__main__":
    main()
