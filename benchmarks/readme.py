"""README's numbers: rings, law and curtain in one run on one core.

Times are processor times, the least of several runs; for curtains they are wall times of one run.
"""

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import examples.curtain
from benchmarks.frame import Section, table
from benchmarks.measure import least_seconds
from benchmarks.problems import loads, normality, square
from homogenize import fit_table, load_law
from macro_fem import read_scene, solve
from rve import Cell, DirectOptions, solve_table, write_table

Said = list[tuple[str, str]]


def rings() -> Said:
    """Rows about `rve`."""
    rows = []
    for ratio in (5.0, 10.0, 20.0, 50.0):
        for branches, told in (("first", "the state next to the slack pose"), ("largest", "the state of largest work")):
            ask = partial(solve_table, Cell(5.0, 5.0 / ratio), loads(), DirectOptions(branches=branches))
            found, seconds = least_seconds(ask, long=np.inf if branches == "first" else 0.0)
            numbers = (
                f"{found.converged.sum()} converged in {seconds:.2f} s; R <= {np.nanmax(found.quality.R):.0e}, gap >= "
                f"{np.nanmin(found.quality.min_gap_mm):.0e} mm, normality >= {normality(found).min():.0e}"
            )
            rows.append((f"190 load cases, r1/r2 = {ratio:g}, {told}", numbers))
    return rows


def law(folder: Path) -> Said:
    """Rows about `homogenize`; leaves table.csv and law.json in the folder."""
    write_table(solve_table(Cell(), loads()), folder / "table.csv")
    fitted, seconds = least_seconds(lambda: fit_table(folder / "table.csv"))
    fitted.save(folder / "law.json")
    return [("fit of the default law to the table", f"{seconds:.2f} s")]


def curtains(folder: Path) -> Said:
    """Rows about `macro_fem`, with the law of `law`."""
    law = load_law(folder / "law.json")

    def run(hang: str, cells: int, support: str | dict[str, Any]) -> dict[str, Any]:
        tables = square(cells, support)
        tables["curtain"]["weave_angle"] = hang
        return solve(read_scene(tables), law).summary

    rows = []
    stretch = solve_table(Cell(), ([0.0], [0.0])).x2_mm[0, 0] / 11.0
    for name, hang, support, height in (
        ("hung along y from a fixed edge", "y", "top", 500.0),
        ("the same, gathered to 80 %", "y", {"kind": "top", "gather": 0.8}, 500.0),
        ("hung along x from a sliding rail", "x", "rail", 1000.0 - 500.0 * stretch),
    ):
        mean = run(hang, 16, support)["mean_height_mm"]
        rows.append(
            (f"{name}: mean height, exact {height:.4f} mm", f"{mean:.4f} mm, off by {abs(mean - height):.0e} mm")
        )
    for cells in (16, 32):
        got = run("y", cells, "corners")
        numbers = f"mean height {got['mean_height_mm']:.2f} mm, relative duality gap {got['relative_gap']:.0e}"
        rows.append((f"square hung by two corners, {got['cells']} cells", f"{got['wall_s']:.1f} s, {numbers}"))
    return rows


def whole_chain(folder: Path) -> Said:
    """A row about `examples/curtain.py`."""
    answer, seconds = least_seconds(lambda: examples.curtain.run(folder), long=0.0)
    mean = answer["mean_height_mm"]
    return [("`examples/curtain.py`, pictures included", f"{seconds:.1f} s, mean height {mean:.2f} mm")]


def measure(full: bool) -> Section:
    """The table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows = rings() + law(folder) + curtains(folder) + whole_chain(folder)
    return Section("", "", (table("", [{"what": what, "measured": said} for what, said in rows]),))
