"""Optional files and fields: their cost, and that they change no other number."""

import json
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.omissions.compare import bars, trial, trial_table, verdict
from benchmarks.problems import loads, scene_file, square
from benchmarks.report.measure import Row, least_seconds
from benchmarks.report.records import Section
from macro_fem.job import run_scene
from rve.geometry.cell import Cell
from rve.more_columns import with_compliance, with_span
from rve.plots import draw_case, save
from rve.solve import solve_table
from rve.table import StrainTable


def measure(full: bool) -> Section:
    """The section."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        trials = [*tables(), *case_picture(folder), *curtain(folder, 24 if full else 16)]
    text = (
        "Strain tables with `--span` (range of free strains) and `--compliance` (compliant contacts), one load with "
        "`--plot`, and a corner-hung curtain with its picture. Summary and VTU are always written. An optional output "
        "must not change any other number."
    )
    title = "Optional outputs"
    return Section(title, text, (trial_table(title, trials),), (bars("outputs", title, trials),), verdict(trials))


def unchanged(
    scene: str,
    plain: Callable[[], Any],
    others: Mapping[str, Callable[[], Any]],
    unit: str = "strain",
    long: float = 1.0,
) -> list[Row]:
    """Each call against the plain one, by the numbers that both return: equal to round-off."""
    numbers, without = least_seconds(plain, long=long)
    rows = []
    for feature, call in others.items():
        found, with_it = least_seconds(call, long=long)
        rows.append(trial(feature, scene, (without, with_it), float(np.abs(found - numbers).max()), 1e-12, unit))
    return rows


def tables() -> list[Row]:
    """Span and compliance of a table with free strains."""
    cell = Cell()

    def E(add: Callable[[StrainTable], StrainTable] = lambda table: table) -> Any:
        return add(solve_table(cell, loads(15.0))).E

    others = {
        "--span": lambda table: with_span(table, cell),
        "--compliance": partial(with_compliance, stiffness_N_per_mm=1e3),
    }
    return unchanged("rve table", E, {feature: partial(E, add) for feature, add in others.items()})


def case_picture(folder: Path) -> list[Row]:
    """The picture of one load."""

    def drawn() -> Any:
        found = solve_table(Cell(), ([20.0], [30.0]))
        save(draw_case(found), folder / "case.png")
        return found.E

    return unchanged("rve case", lambda: solve_table(Cell(), ([20.0], [30.0])).E, {"--plot": drawn})


def curtain(folder: Path, cells: int) -> list[Row]:
    """Picture of a curtain. Bounds are no mere output: with them the curtain is the admissible quadratic one."""
    scene = scene_file(folder / "scene.toml", square(cells))

    def run(picture: bool = False) -> Any:
        run_scene(scene, None, folder, picture=picture)
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        return np.array([summary[key] for key in ("mean_height_mm", "lowest_point_mm", "potential_dual_N_mm")])

    return unchanged("macro-fem run", run, {"picture": partial(run, picture=True)}, "mm", long=3.0)
