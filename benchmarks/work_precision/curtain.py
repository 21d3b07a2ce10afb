"""Curtains: error of the mean height and certified gap against time, for every element and solver over the mesh.

Two problems, each with a reference. `net`: a net square of 40 mm (two families at 45 degrees, top gathered to 70 %)
with a known exact mean height. `corners`: a square metre of rings hung by its two top corners; its reference is the
P2 curtain extrapolated to zero cell size, which must lie in the certified interval.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.frame import Diagram, Section, Table, curves, table
from benchmarks.measure import Row, least_seconds
from benchmarks.problems import square
from homogenize import MembraneLaw, default_law, diagonal_net
from macro_fem import Scene, read_scene
from macro_fem.bounds import CurtainBounds
from macro_fem.bounds.interval import admissible_problem, levels
from macro_fem.curtain import solve_problem
from macro_fem.job import solve_membrane
from macro_fem.scene.meshing.mesh import build_mesh

NET_MEAN_HEIGHT = 14.187635
FLOOR = 1e-9
EXACT = 1e-7
"""Relative errors below are within the tolerance of the solvers."""
PATIENCE = 5.0
"""Processor seconds of a run after which no finer mesh is tried."""
ERROR = "error / height"


@dataclass(frozen=True)
class Way:
    """One element with one solver; `coarser`: cells of P1 per cell, for the same spacing of nodes."""

    element: str
    pattern: str = "aligned"
    solver: str = "rigid"
    coarser: int = 1

    @property
    def name(self) -> str:
        """As in tables."""
        shape = f"{self.element} {self.pattern}"
        return shape if self.solver == "rigid" else f"{shape}, {self.solver}"


@dataclass(frozen=True)
class Problem:
    """A scene without its mesh, its law, and the height that errors are divided by."""

    name: str
    tables: dict[str, Any]
    law: MembraneLaw
    height: float


WAYS = (
    *(Way("P1", pattern) for pattern in ("aligned", "crossed", "diagonal")),
    *(Way("P2", pattern, coarser=2) for pattern in ("aligned", "diagonal")),
    *(Way("P1", solver="elastic"), Way("P2", solver="elastic", coarser=2)),
)


def net_problem() -> Problem:
    """Exact on any mesh whose edges follow both families."""
    tables = square(1, {"kind": "top", "gather": 0.7}, 40.0)
    tables["curtain"]["areal_mass"] = 1.0
    return Problem("net", tables, diagonal_net(), 40.0)


def corner_problem() -> Problem:
    """A square metre of the shipped rings."""
    return Problem("corners", square(1), default_law(), 1000.0)


def scene_of(problem: Problem, way: Way, cells: int, **solver: Any) -> Scene:
    """The problem's scene on a mesh whose nodes are as far apart as with `cells` P1 cells along the width."""
    mesh = {"cells": max(1, cells // way.coarser), "element": way.element, "pattern": way.pattern}
    return read_scene({**problem.tables, "mesh": mesh, "solver": {"kind": way.solver, **solver}})


def run(problem: Problem, way: Way, cells: int, reference: float) -> Row:
    """One point of a ladder: the signed error, nan where there is no answer."""
    solve = partial(solve_membrane, scene_of(problem, way, cells), problem.law)
    answer, seconds = least_seconds(solve, repeats=2, long=0.5)
    solution = answer.solution
    error = (solution.mean_height() - reference) / problem.height if solution.status == "converged" else math.nan
    row: Row = {"element, solver": way.name, "cells": solution.problem.disc.n_cells, "unknowns": solution.problem.fem.n}
    return row | {ERROR: error, "steps": solution.iterations, "s": seconds, "order": "", "status": solution.status}


def climb(problem: Problem, way: Way, sizes: list[int], reference: float) -> list[Row]:
    """The ladder of a way, until a run fails or takes `PATIENCE`; the last row has the order of convergence."""
    rows: list[Row] = []
    for cells in sizes:
        rows.append(run(problem, way, cells, reference))
        if not rows[-1]["s"] < PATIENCE:
            break
    rows[-1]["order"] = "exact" if abs(rows[-1][ERROR]) < EXACT else order(rows)
    return rows


def order(rows: list[Row]) -> float:
    """Slope of log |error| over log of the spacing (unknowns to the power -1/2); nan for fewer than two points."""
    good = [row for row in rows if math.isfinite(row[ERROR])]
    if len(good) < 2:
        return math.nan
    h = np.log([row["unknowns"] ** -0.5 for row in good])
    return float(np.polyfit(h, np.log([max(abs(row[ERROR]), 1e-16) for row in good]), 1)[0])


def corner_height(law: MembraneLaw, cells: int) -> float:
    """Mean height in mm of the corner-hung square metre of this law, P2; RuntimeError if it does not converge."""
    solution = solve_membrane(scene_of(corner_problem(), Way("P2"), cells), law).solution
    if solution.status != "converged":
        raise RuntimeError(f"a reference did not converge: {solution.status}: {solution.message}")
    return solution.mean_height()


def reference_height(cells: int) -> tuple[float, float]:
    """Mean height at zero cell size, by P2 on `cells` and half of them, and its difference from the next coarser pair.

    The error of P2 is proportional to the cell size (see the measured order), so the height is extrapolated linearly.
    """
    law = corner_problem().law
    fine, middle, coarse = (corner_height(law, cells // part) for part in (1, 2, 4))
    return 2.0 * fine - middle, abs(2.0 * fine - middle - (2.0 * middle - coarse))


def certified(problem: Problem, cells: int, adapt: int) -> list[tuple[CurtainBounds, float]]:
    """Levels with bounds, and the seconds of all levels so far, upper and lower bound together; each runs once."""
    scene = scene_of(problem, Way("P1"), cells, bounds=True, adapt=adapt)
    start = admissible_problem(scene, problem.law, build_mesh(scene, problem.law.cell))
    first, spent = least_seconds(partial(solve_problem, start), long=0.0)
    steps, found = levels(first), list[tuple[CurtainBounds, float]]()
    while True:
        level, seconds = least_seconds(partial(next, steps, None), long=0.0)
        if level is None:
            return found
        spent += seconds
        found.append((level, spent))


def interval(level: CurtainBounds) -> tuple[float, float]:
    """Certified lower and upper bound of the mean height in mm."""
    total = float(np.abs(level.solution.problem.force).sum())
    high = level.solution.mean_height()
    return high - level.gap / total, high


def ladder_table(problem: Problem, sizes: list[int], reference: float, ways: tuple[Way, ...]) -> tuple[Table, Diagram]:
    """Error against time of every way."""
    rows = [row for way in ways for row in climb(problem, way, sizes, reference)]
    for row in rows:
        row["_drawn"] = max(abs(row[ERROR]), FLOOR) if math.isfinite(row[ERROR]) else math.nan
        row[ERROR] = "exact" if abs(row[ERROR]) < EXACT else row[ERROR]
    title = f"{problem.name}: reference {reference:.{6 if problem.height < 100 else 2}f} mm"
    picture = Diagram(
        f"curtain_{problem.name}",
        f"{problem.name}: error of the mean height against time",
        f"error of the mean height / height (what is below {FLOOR:.0e} is drawn there)",
        "processor time (s)",
        curves(rows, "element, solver", "_drawn", "s"),
    )
    return table(title, rows, {ERROR: "signed 0 2", "s": ".2f", "order": ".1f"}), picture


def certificates(problem: Problem, uniform: list[int], adapt: int, reference: float) -> tuple[Table, Diagram]:
    """Certified gap and true error against time, on uniform and on adapted meshes."""
    ladders: Mapping[str, list[tuple[CurtainBounds, float]]] = {
        "uniform": [certified(problem, cells, 0)[0] for cells in uniform],
        "adapted": certified(problem, uniform[0], adapt),
    }
    gap, error, time = "gap / height", "true error / height", "s, both bounds"
    rows: list[Row] = []
    for name, (level, seconds) in ((name, found) for name, ladder in ladders.items() for found in ladder):
        low, high = interval(level)
        row = {"mesh": name, "cells": level.solution.problem.disc.n_cells}
        row |= {"lower bound mm": f"{low:.2f}", "upper bound mm": f"{high:.2f}", gap: (high - low) / problem.height}
        row |= {error: (high - reference) / problem.height, "reference inside": low <= reference <= high, time: seconds}
        rows.append(row)
    kinds = ((gap, "certified gap"), (error, "true error of P1"))
    drawn = [
        replace(one, label=f"{one.label}: {what}") for key, what in kinds for one in curves(rows, "mesh", key, time)
    ]
    title = f"{problem.name}: certified interval of the mean height"
    labels = ("gap or error of the mean height / height", "processor time of both bounds (s)")
    forms = {gap: ".1e", error: ".1e", time: ".1f"}
    return table(title, rows, forms), Diagram("curtain_certified", title, *labels, tuple(drawn))


def measure(full: bool) -> Section:
    """The section; `full` goes one mesh further."""
    sizes = [8, 16, 32, 64] if full else [8, 16, 32]
    net, corners = net_problem(), corner_problem()
    reference, doubt = reference_height(64 if full else 32)
    found = [
        ladder_table(net, sizes, NET_MEAN_HEIGHT, WAYS),
        ladder_table(corners, sizes, reference, WAYS),
        certificates(corners, sizes if full else sizes[:2], 4 if full else 3, reference),
    ]
    tables, pictures = zip(*found, strict=True)
    text = (
        "Rigid rings unless a solver is named: `elastic` rings stretch. The height of *net* is known exactly; the "
        f"reference of *corners* is {reference:.2f} mm, P2 extrapolated to zero cell size (pairs of meshes agree to "
        f"{doubt:.2f} mm). A ladder ends where a run takes more than {PATIENCE:g} s. Errors are signed: P1 lies above, "
        "because it is admissible in every point."
    )
    return Section("Curtains: elements and solvers", text, tables, pictures, _conclusion(tables[1]))


def _conclusion(corners: Table) -> str:
    """What the corner-hung ladder says about the default."""
    finest = {row[0]: float(str(row[3])) for row in corners.rows if row[3] != "-"}
    return (
        f"With as many unknowns P2 is {abs(finest['P1 aligned'] / finest['P2 aligned']):.0f} times as accurate as P1: "
        'for one number, use `element = "P2"` with half the cells. The default is P1 with edges along both families '
        "(`aligned`): it alone is admissible in every point, so that its answer is an upper bound."
    )
