"""From ten rings to a curtain: the whole chain in one run.

1. ten rigid rings under 190 line loads lock          -> table.csv, table.json
2. a convex, tension-only membrane law is fitted      -> law.json
3. a curtain of 1 m x 1 m hangs by its two top corners -> curtain/summary.json, curtain.vtu, curtain.png

    python examples/curtain.py [--out DIR] [--cells N | --accuracy 1e-3]

With --accuracy the load directions and the mesh are those that `python -m benchmarks chain` recommends for a
mean height good to 1e-2, 1e-3 or 1e-4 of the curtain's height (docs/reports/work_precision.md, "The whole chain"); two
meshes are extrapolated. answer.json has the mean height.

The checked number (tests/test_examples.py): the curtain's mean height lies inside rigorous bounds from another element.
"""

import math
import time
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from rve.common.commands.command_line import Command, answer, say, say_next
from rve.common.errors import noted_if_stopped, require
from rve.common.files import job, write_text

ACCURACY = click.FloatRange(min=1e-4, max=1.0)
FOLDER = click.Path(path_type=Path, file_okay=False)


@dataclass(frozen=True)
class Setting:
    """Spacing of the load directions in degrees, and P2 cells along the width: one mesh, or two for extrapolation."""

    spacing: float
    cells: tuple[int, ...]


DEFAULT = Setting(5.0, (32,))
SETTINGS = {1e-2: Setting(15.0, (4,)), 1e-3: Setting(9.0, (16,)), 1e-4: Setting(5.0, (8, 16))}
"""What holds a relative accuracy of the mean height, by measurement."""
SCENE = """[curtain]
width = 1000.0      # mm, in the reference state
height = 1000.0     # mm
weave_angle = 0.0   # degrees from the vertical to the y axis of the weave
[mesh]
cells = {cells}          # cells along the width
element = "P2"
[support]
kind = "corners"
[load]
gravity = 9.81      # m/s2
[solver]
kind = "rigid"      # ideal locking
"""


def setting_for(accuracy: float) -> Setting:
    """The cheapest setting that holds this accuracy, between 1e-4 and 1."""
    return SETTINGS[max(held for held in SETTINGS if held <= accuracy)]


def grid_of(spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Load directions alpha of 0 to 45 and beta of 0 to 90 degrees, `spacing` apart."""
    from rve.directions import product

    return product(np.arange(0.0, 45.01, spacing), np.arange(0.0, 90.01, spacing))


def extrapolated(first: float, *finer: float) -> float:
    """Mean height at cells of no size from two meshes, each half as coarse as the one before; one stands for itself.

    The error of P2 falls in proportion to the cells, so that the finer one is half as far from the limit.
    """
    return 2.0 * finer[0] - first if finer else first


def scene_text(cells: int) -> str:
    """The scene file of the corner-hung curtain."""
    return SCENE.format(cells=cells)


def make_table(out: Path, spacing: float) -> Path:
    """Solve the load cases (the paper's 190 for 5 degrees), write and draw them."""
    from rve import Cell, solve_table, write_table
    from rve.common.drawing.plane import save_figure
    from rve.plots import draw_case

    alpha, beta = grid_of(spacing)
    say("1 rings")
    table = solve_table(Cell(r1=5.0, r2=0.5), (alpha, beta))
    write_table(table, out / "table.csv")
    save_figure(out / "cell.png", draw_case(solve_table(Cell(), ([45.0], [0.0]))).figure)
    say(f"  {table.converged.sum()} of {len(table)} load cases locked, largest residual {table.quality.R.max():.1e}")
    return out / "table.csv"


def fit_law(table: Path, out: Path) -> Path:
    """Fit the default law, say how wrong it can be, draw it."""
    from homogenize import fit_table
    from homogenize.plots import write_pictures
    from rve import read_table

    say("2 law")
    result = fit_table(table)
    result.save(out / "law.json")
    for line in result.report.text().splitlines():
        say(f"  {line}")
    write_pictures(result.law, read_table(table), out / "law")
    return out / "law.json"


def hang_curtain(law: Path, out: Path, cells: int) -> float:
    """Hang the corner-held curtain with this law; its mean height in mm."""
    from macro_fem import run_scene

    scene = out / "scene.toml"
    write_text(scene, scene_text(cells))
    summary = run_scene(scene, law, out / "curtain", picture=True)
    say(f"  {summary.status}: {summary.message}")
    say(f"  {cells} cells along the width: mean height {summary.mean_height_mm:.2f} mm")
    return summary.mean_height_mm


def run(out: Path, setting: Setting = DEFAULT) -> dict[str, object]:
    """The whole chain; returns what answer.json says. The files of the curtain are those of the finest mesh.

    All files appear in `out` together, at the end.
    """
    require("matplotlib", "plots", "examples/curtain.py")
    found: dict[str, object] = {"spacing_degrees": setting.spacing, "cells": setting.cells}
    with noted_if_stopped(f"what was in {out} before is unchanged"), job(out, "answer.json", found) as folder:
        law = fit_law(make_table(folder, setting.spacing), folder)
        say("3 curtain")
        heights = [hang_curtain(law, folder, cells) for cells in setting.cells]
        found["mean_height_mm"] = extrapolated(*heights)
    if heights[1:]:
        say(f"  mean height {found['mean_height_mm']:.2f} mm, extrapolated")
    return found


@click.command(cls=Command, epilog="Example: python examples/curtain.py --out out --accuracy 1e-3")
@click.option("--out", type=FOLDER, default=Path("out"), show_default=True, help="Folder to write into.")
@click.option("--cells", type=click.IntRange(1, 400), help="Cells along the width of the curtain.  [default: 32]")
@click.option("--accuracy", type=ACCURACY, help="Relative accuracy of the mean height: 1e-2, 1e-3, 1e-4.")
def main(out: Path, cells: int | None, accuracy: float | None) -> None:
    """From ten rings to a curtain, with files and pictures in one folder."""
    if cells and accuracy:
        raise click.UsageError("--accuracy chooses the mesh: give --cells or --accuracy, not both")
    if accuracy is not None and math.isnan(accuracy):  # FloatRange lets it through
        raise click.BadParameter("nan is not in the range 0.0001<=x<=1.0.", param_hint="--accuracy")
    setting = setting_for(accuracy) if accuracy else Setting(DEFAULT.spacing, (cells,) if cells else DEFAULT.cells)
    began = time.perf_counter()
    found = run(out, setting)
    say(f"done in {time.perf_counter() - began:.1f} s; see {out}/cell.png, {out}/law, {out}/curtain/curtain.png")
    answer(found)
    rings = out.parent / f"{out.resolve().name}_rings"
    say_next("macro_fem", "localize", out / "curtain", "--out", rings, why="every ring of the curtain")


if __name__ == "__main__":
    main()
