"""Files and fields that nobody asked for: what they would cost, and that asking changes no number."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.omissions.compare import LEFT_OUT, Trial, bars, table, verdict
from benchmarks.pages.measuring import least_seconds
from benchmarks.pages.model import Section
from macro_fem.job import run_scene
from rve.plots import draw_case, save
from rve.ranges import grid
from rve.span import with_span
from rve.st_table import with_compliance
from rve.sweep import Cell, solve_table
from rve.table import StrainTable

SCENE = """[curtain]
width = 1000.0
height = 1000.0
[mesh]
cells = {cells}
[support]
kind = "corners"
"""


def measure(full: bool) -> Section:
    """The section."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        trials = [*tables(), case_picture(folder), *curtain(folder, 24 if full else 16)]
    text = (
        "Strain tables with `--span` (how far free strains may move) and `--compliance` (what softens the locked "
        "state), one load with `--plot`, and a corner-hung curtain with its picture and with bounds and error map. "
        "Summary and VTU are always written. Asking must not move a number that was there before."
    )
    title = "Outputs that are made when asked for"
    return Section(
        "outputs",
        "Outputs nobody asked for",
        text,
        (table(title, trials),),
        (bars("outputs", title, trials),),
        verdict(trials),
    )


def tables() -> list[Trial]:
    """Span and compliance of a table with free strains."""
    loads, cell = grid(np.arange(0.0, 46.0, 15.0), np.arange(0.0, 91.0, 15.0)), Cell()
    plain, without = least_seconds(lambda: solve_table(*loads, cell))
    more: dict[str, Callable[[], StrainTable]] = {
        "--span": lambda: with_span(solve_table(*loads, cell), cell),
        "--compliance": lambda: with_compliance(solve_table(*loads, cell), 1e3, cell),
    }
    trials = []
    for feature, call in more.items():
        found, with_it = least_seconds(call)
        trials.append(_same_numbers(feature, "rve table", (without, with_it), plain.E, found.E))
    return trials


def case_picture(folder: Path) -> Trial:
    """The picture of one load."""
    cell = Cell()

    def drawn() -> StrainTable:
        found = solve_table([20.0], [30.0], cell)
        save(draw_case(20.0, 30.0, cell), folder / "case.png")
        return found

    plain, without = least_seconds(lambda: solve_table([20.0], [30.0], cell))
    found, with_it = least_seconds(drawn)
    return _same_numbers("--plot", "rve case", (without, with_it), plain.E, found.E)


def curtain(folder: Path, cells: int) -> list[Trial]:
    """Picture and bounds of a curtain."""
    scene = folder / "scene.toml"
    scene.write_text(SCENE.format(cells=cells), encoding="utf-8")

    def run(*force: str, picture: bool = False) -> np.ndarray:
        run_scene(scene, None, folder, picture=picture, force=force)
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        return np.array([summary[key] for key in ("mean_height_mm", "lowest_point_mm", "potential_dual_N_mm")])

    plain, without = least_seconds(run, long=3.0)
    trials = []
    for feature, call in (("picture", lambda: run(picture=True)), ("bounds", lambda: run("bounds"))):
        found, with_it = least_seconds(call, long=3.0)
        trials.append(_same_numbers(feature, "macro-fem run", (without, with_it), plain, found, "mm"))
    return trials


def _same_numbers(
    feature: str, scene: str, seconds: tuple[float, float], plain: np.ndarray, found: np.ndarray, unit: str = "strain"
) -> Trial:
    """The numbers with and without an output are equal to round-off, or its making has disturbed them."""
    return Trial(feature, scene, LEFT_OUT, *seconds, float(np.abs(found - plain).max()), 1e-12, unit)
