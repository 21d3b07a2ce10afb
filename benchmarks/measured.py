"""README's numbers and first picture: `python -m benchmarks.measured` writes them, and docs/curtain.png.

Rings, law and curtain in one run on one core, times as the least of several runs, machine and versions below.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import examples.curtain
from benchmarks.machine import describe
from homogenize.fit import fit_table
from homogenize.query import strain_answer
from macro_fem.job import run_scene
from rve.ranges import grid
from rve.sweep import Cell, solve_table
from rve.table import StrainTable, write_table

README = Path(__file__).resolve().parents[1] / "README.md"
PICTURE = README.parent / "docs" / "curtain.png"
BEGIN, END = "<!-- measured: python -m benchmarks.measured -->", "<!-- end of measured -->"
SCENE = """[curtain]
width = 1000.0
height = 1000.0
hang = "{hang}"
[mesh]
cells = {cells}
element = "P1"
[support]
{support}
[load]
gravity = 9.81
[solver]
kind = "rigid"
"""


def least(action: Callable[[], object], runs: int = 3) -> float:
    """Least wall time of some runs in seconds."""
    times = []
    for _ in range(runs):
        began = time.perf_counter()
        action()
        times.append(time.perf_counter() - began)
    return min(times)


def paper_table(cell: Cell) -> StrainTable:
    """The paper's 190 load cases."""
    return solve_table(*grid(np.arange(0.0, 46.0, 5.0), np.arange(0.0, 91.0, 5.0)), cell)


def normality(table: StrainTable) -> float:
    """Smallest S_i:(E_i - E_j) over all pairs of converged rows."""
    S, E = table.S[table.converged], table.E[table.converged]
    return float(np.einsum("ik,ijk->ij", S * [1, 2, 1], E[:, None] - E[None]).min())


def rings() -> list[tuple[str, str]]:
    """Rows about `rve`."""
    rows = []
    for ratio in (5.0, 10.0, 20.0, 50.0):
        cell = Cell(5.0, 5.0 / ratio)
        table = paper_table(cell)
        seconds = least(lambda cell=cell: paper_table(cell))
        rows.append(
            (
                f"190 load cases, r1/r2 = {ratio:g}",
                f"{table.converged.sum()} converged in {seconds:.2f} s; R <= {np.nanmax(table.R):.0e}, "
                f"gap >= {np.nanmin(table.min_gap_mm):.0e} mm, normality >= {normality(table):.0e}",
            )
        )
    return rows


def law(folder: Path) -> list[tuple[str, str]]:
    """Rows about `homogenize`; leaves table.csv and law.json in the folder."""
    table = paper_table(Cell())
    write_table(table, folder / "table.csv")
    seconds = least(lambda: fit_table(folder / "table.csv"))
    fit_table(folder / "table.csv").save(folder / "law.json")
    rng = np.random.default_rng(0)
    alpha, beta = rng.uniform(-90.0, 90.0, 300), rng.uniform(0.0, 90.0, 300)
    truth = solve_table(alpha, beta)
    strains = [strain_answer(folder / "law.json", a, b) for a, b in zip(alpha, beta, strict=True)]
    predicted = np.array([[answer[name] for name in ("E11", "E12", "E22")] for answer in strains], dtype=float)
    # The work conjugate of the locked strain is what the law is for; it is unique where the strain is not.
    known = truth.converged & truth.unique
    error = np.abs(predicted - truth.E)[known].max(axis=1)
    support = np.abs(((predicted - truth.E) * truth.S * [1, 2, 1]).sum(axis=1))[truth.converged]
    trace = (truth.S[:, 0] + truth.S[:, 2])[truth.converged]
    return [
        ("fit of the default law to the table", f"{seconds:.2f} s"),
        (
            "strain at 300 random loads off the grid, largest component error",
            f"median {np.median(error):.1e}, 95 % {np.quantile(error, 0.95):.1e}, max {error.max():.1e} "
            f"({known.sum()} unique)",
        ),
        ("work S:E there, unit trace of S", f"mean {np.mean(support / trace):.1e}, max {np.max(support / trace):.1e}"),
    ]


def curtains(folder: Path) -> list[tuple[str, str]]:
    """Rows about `macro_fem`, with the law of `law`."""
    rows = []
    stretch = paper_table(Cell()).x2_mm[0, 0] / 11.0
    exact = (
        ("hung along y from a fixed edge", "y", 'kind = "top"', 500.0),
        ("the same, gathered to 80 %", "y", 'kind = "top"\ngather = 0.8', 500.0),
        ("hung along x from a sliding rail", "x", 'kind = "rail"', 1000.0 - 500.0 * stretch),
    )
    for name, hang, support, height in exact:
        summary = _run(folder, SCENE.format(hang=hang, cells=16, support=support))
        rows.append(
            (
                f"{name}: mean height, exact {height:.4f} mm",
                f"{summary['mean_height_mm']:.4f} mm, off by {abs(summary['mean_height_mm'] - height):.0e} mm",
            )
        )
    for cells in (16, 32):
        summary = _run(folder, SCENE.format(hang="y", cells=cells, support='kind = "corners"'))
        rows.append(
            (
                f"square hung by two corners, {summary['cells']} cells",
                f"{summary['wall_s']:.1f} s, mean height {summary['mean_height_mm']:.2f} mm, "
                f"relative duality gap {summary['relative_gap']:.0e}",
            )
        )
    return rows


def main_job(folder: Path) -> list[tuple[str, str]]:
    """A row about `examples/curtain.py`, whose picture becomes the README's."""
    began = time.perf_counter()
    answer = examples.curtain.run(folder)
    seconds = time.perf_counter() - began
    shutil.copyfile(folder / "curtain" / "curtain.png", PICTURE)
    return [
        ("`examples/curtain.py`, pictures included", f"{seconds:.1f} s, mean height {answer['mean_height_mm']:.2f} mm")
    ]


def _run(folder: Path, scene: str) -> dict[str, float]:
    path = folder / "scene.toml"
    path.write_text(scene)
    return run_scene(path, folder / "law.json", folder / "out", picture=False)


def main() -> None:
    """Measure, print, and put the table between the marks of the README."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows = rings() + law(folder) + curtains(folder) + main_job(folder)
    table = "\n".join(["| what | measured |", "|---|---|", *(f"| {a} | {b} |" for a, b in rows)])
    text = f"{BEGIN}\n\n{table}\n\n{describe()}\n\n{END}"
    print(text)
    readme = README.read_text(encoding="utf-8")
    before, rest = readme.split(BEGIN)
    README.write_text(before + text + rest.split(END)[1], encoding="utf-8")


if __name__ == "__main__":
    main()
