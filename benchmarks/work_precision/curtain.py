"""Curtains: error of the mean height and certified gap against time, for every element and solver over the mesh.

Two problems with a reference each. `net`: a net square of 40 mm (two families at 45 degrees, top gathered to 70 %),
whose mean height is known exactly. `corners`: a square metre of rings hung by its two top corners; its reference is
the P2 curtain extrapolated to cells of no size, and must lie in the certified interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np

from benchmarks.pages.measuring import least_seconds
from benchmarks.pages.model import Column, Curve, Diagram, Section, Table
from homogenize.law import InputError, MembraneLaw, default_law, diagonal_net
from macro_fem.adapt import Level, levels
from macro_fem.scene import Scene, read_scene
from macro_fem.solution import CurtainSolution
from macro_fem.solvers import solve_scene

NET_MEAN_HEIGHT = 14.187635
FLOOR = 1e-9
PATIENCE = 5.0
"""Processor seconds after which a way is not asked for a finer mesh."""


@dataclass(frozen=True)
class Way:
    """One element with one solver; `coarser`: how much coarser the mesh is taken for the same spacing of nodes."""

    element: str
    pattern: str = "aligned"
    solver: str = "rigid"
    coarser: int = 1

    @property
    def name(self) -> str:
        """As in tables."""
        shape = self.element if self.element.startswith("Q") else f"{self.element} {self.pattern}"
        return shape if self.solver == "rigid" else f"{shape}, {self.solver}"


@dataclass(frozen=True)
class Problem:
    """A scene without its mesh, its law, and the height that errors are divided by."""

    name: str
    tables: dict[str, Any]
    law: MembraneLaw
    height: float


@dataclass(frozen=True)
class Run:
    """One way on one mesh: signed relative error of the mean height, nan where it did not converge."""

    way: str
    cells: int
    unknowns: int
    error: float
    steps: int
    seconds: float
    status: str


WAYS = (
    Way("P1"),
    Way("P1", "crossed"),
    Way("P1", "diagonal"),
    Way("P2", coarser=2),
    Way("P2", "diagonal", coarser=2),
    Way("CR"),
    Way("Q1"),
    Way("Q2", coarser=2),
    Way("P1", solver="conic"),
    Way("P1", solver="newton"),
    Way("P2", solver="newton", coarser=2),
)


def net_problem() -> Problem:
    """Exact on any mesh whose edges follow both families."""
    tables = {"curtain": {"width": 40.0, "height": 40.0, "areal_mass": 1.0}, "support": {"kind": "top", "gather": 0.7}}
    return Problem("net", tables, diagonal_net(), 40.0)


def corner_problem() -> Problem:
    """A square metre of the shipped rings."""
    tables = {"curtain": {"width": 1000.0, "height": 1000.0}, "support": {"kind": "corners"}}
    return Problem("corners", tables, default_law(), 1000.0)


def scene_of(problem: Problem, way: Way, cells: int, **solver: Any) -> Scene:
    """The problem's scene on a mesh whose nodes are as far apart as with `cells` P1 cells along the width."""
    mesh = {"cells": max(1, cells // way.coarser), "element": way.element, "pattern": way.pattern}
    return read_scene({**problem.tables, "mesh": mesh, "solver": {"kind": way.solver, **solver}})


def run(problem: Problem, way: Way, cells: int, reference: float) -> Run:
    """One point of a ladder; a scene that the element or the solver refuses says so in its status."""
    try:
        scene = scene_of(problem, way, cells)
        solution, seconds = least_seconds(partial(solve_scene, scene, problem.law), repeats=2, long=0.5)
    except InputError as refusal:
        return Run(way.name, cells, 0, math.nan, 0, math.nan, str(refusal).split(":")[-1].strip())
    good = solution.status == "converged"
    error = (solution.mean_height() - reference) / problem.height if good else math.nan
    n, steps = solution.problem.fem.n, solution.iterations
    return Run(way.name, solution.problem.disc.n_cells, n, error, steps, seconds, solution.status)


def climb(problem: Problem, way: Way, sizes: list[int], reference: float) -> list[Run]:
    """The way's ladder, as far as it is accepted and quicker than `PATIENCE`."""
    runs: list[Run] = []
    for cells in sizes:
        runs.append(run(problem, way, cells, reference))
        if not runs[-1].seconds < PATIENCE:
            break
    return runs


def order(runs: list[Run]) -> float:
    """Slope of log |error| over log of the spacing (unknowns to the power -1/2); nan for fewer than two points."""
    good = [one for one in runs if math.isfinite(one.error)]
    if len(good) < 2:
        return math.nan
    h = np.log([one.unknowns**-0.5 for one in good])
    return float(np.polyfit(h, np.log([max(abs(one.error), 1e-16) for one in good]), 1)[0])


@cache
def corner_height(element: str, cells: int) -> float:
    """Mean height in mm of the corner-hung square of rings."""
    problem = corner_problem()
    scene = read_scene({**problem.tables, "mesh": {"cells": cells, "element": element}})
    return converged(solve_scene(scene, problem.law)).mean_height()


def converged(solution: CurtainSolution) -> CurtainSolution:
    """The same; RuntimeError with the solver's sentence if it did not converge."""
    if solution.status != "converged":
        raise RuntimeError(f"a reference did not converge: {solution.status}: {solution.message}")
    return solution


def reference_height(cells: int) -> tuple[float, float]:
    """Mean height at cells of no size, by P2 on `cells` and half of them, and how far the pair below disagrees, mm.

    The error of P2 halves with the cells (measured below): the height is linear in their size.
    """
    fine, middle, coarse = (corner_height("P2", cells // part) for part in (1, 2, 4))
    return 2.0 * fine - middle, abs(2.0 * fine - middle - (2.0 * middle - coarse))


def certified(problem: Problem, cells: int, adapt: int) -> list[tuple[Level, float]]:
    """Levels with bounds and the seconds each took, upper and lower bound together; all of the ladder runs once."""
    scene = scene_of(problem, Way("P1"), cells, bounds=True, adapt=adapt)
    found: list[tuple[Level, float]] = []
    spent = 0.0
    steps = levels(scene, problem.law)
    while True:
        level, seconds = least_seconds(partial(next, steps, None), long=0.0)
        if level is None:
            return found
        spent += seconds
        found.append((level, spent))


def interval(level: Level) -> tuple[float, float]:
    """Between which mean heights in mm the curtain certainly hangs."""
    total = float(np.abs(level.solution.problem.force).sum())
    high = level.solution.mean_height()
    return high - level.bounds.gap / total, high


def ladder_table(problem: Problem, sizes: list[int], reference: float, ways: tuple[Way, ...]) -> tuple[Table, Diagram]:
    """Error against time of every way."""
    rows, curves = [], []
    for way in ways:
        runs = climb(problem, way, sizes, reference)
        for one in runs:
            last = one is runs[-1]
            slope = ("exact" if abs(one.error) < 1e-7 else f"{order(runs):.1f}") if last else ""
            rows.append(
                (one.way, one.cells, one.unknowns, _signed(one.error), one.steps, one.seconds, slope, one.status)
            )
        times, errors = (tuple(getattr(one, name) for one in runs) for name in ("seconds", "error"))
        curves.append(Curve(way.name, tuple(max(abs(e), FLOOR) if math.isfinite(e) else e for e in errors), times))
    columns = (
        Column("element, solver"),
        Column("cells"),
        Column("unknowns"),
        Column("error / height"),
        Column("steps"),
        Column("s", ".2f", timed=True),
        Column("order"),
        Column("status"),
    )
    title = f"{problem.name}: reference {reference:.{6 if problem.height < 100 else 2}f} mm"
    picture = Diagram(
        f"curtain_{problem.name}",
        f"{problem.name}: error of the mean height against time",
        f"error of the mean height / height (what is below {FLOOR:.0e} is drawn there)",
        "processor time (s)",
        tuple(curves),
    )
    return Table(title, columns, tuple(rows)), picture


def certificates(problem: Problem, uniform: list[int], adapt: int, reference: float) -> tuple[Table, Diagram]:
    """Certified gap and true error against time, on uniform and on adapted meshes."""
    ladders = {
        "uniform": [certified(problem, cells, 0)[0] for cells in uniform],
        "adapted": certified(problem, uniform[0], adapt),
    }
    rows, curves = [], []
    for name, found in ladders.items():
        for level, seconds in found:
            low, high = interval(level)
            inside = "yes" if low <= reference <= high else "NO"
            error = (high - reference) / problem.height
            cells = level.solution.problem.disc.n_cells
            rows.append(
                (name, cells, f"{low:.2f}", f"{high:.2f}", (high - low) / problem.height, error, inside, seconds)
            )
        gaps = tuple((high - low) / problem.height for low, high in (interval(level) for level, _ in found))
        errors = tuple((interval(level)[1] - reference) / problem.height for level, _ in found)
        times = tuple(seconds for _, seconds in found)
        curves += [Curve(f"{name}: certified gap", gaps, times), Curve(f"{name}: true error of P1", errors, times)]
    columns = (
        Column("mesh"),
        Column("cells"),
        Column("lower bound mm"),
        Column("upper bound mm"),
        Column("gap / height", ".1e"),
        Column("true error / height", ".1e"),
        Column("reference inside"),
        Column("s, both bounds", ".1f", timed=True),
    )
    title = f"{problem.name}: certified interval of the mean height"
    labels = ("gap or error of the mean height / height", "processor time of both bounds (s)")
    return Table(title, columns, tuple(rows)), Diagram("curtain_certified", title, *labels, tuple(curves))


def measure(full: bool) -> Section:
    """The section; `full` goes one mesh further."""
    sizes = [8, 16, 32, 64] if full else [8, 16, 32]
    net, corners = net_problem(), corner_problem()
    reference, doubt = reference_height(64 if full else 32)
    net_table, net_picture = ladder_table(net, sizes, NET_MEAN_HEIGHT, WAYS)
    corner_table, corner_picture = ladder_table(corners, sizes, reference, WAYS)
    gap_table, gap_picture = certificates(corners, sizes if full else sizes[:2], 4 if full else 3, reference)
    return Section(
        "curtain",
        "Curtains: elements and solvers",
        (
            "Rigid rings unless a solver is named: `rigid` is our interior-point method, `conic` clarabel on the same "
            "cone program, `newton` the elastic law. *net* is known exactly; the reference of *corners* is "
            f"{reference:.2f} mm, P2 extrapolated to cells of no size (pairs of meshes agree to {doubt:.2f} mm). A "
            f"ladder ends where a run takes more than {PATIENCE:g} s. Errors are signed: P1 lies above, as it is "
            "admissible everywhere."
        ),
        (net_table, corner_table, gap_table),
        (net_picture, corner_picture, gap_picture),
        _conclusion(corner_table),
    )


def _conclusion(table: Table) -> str:
    """What the corner-hung ladder says about the default."""
    finest = {row[0]: row for row in table.rows}
    p1, p2 = finest["P1 aligned"], finest["P2 aligned"]
    ratio = abs(float(str(p1[3]))) / abs(float(str(p2[3])))
    return (
        f"With as many unknowns P2 is {ratio:.0f} times as accurate as P1: where one number matters, ask for "
        '`element = "P2"` and half the cells, as `examples/curtain.py` does. The default stays P1 with edges along '
        "both families (`aligned`): it alone is admissible in every point, so that its answer is a bound, and it is "
        "what `bounds` and `adapt` work with."
    )


def _signed(error: float) -> str:
    """Two digits; errors below a part in ten million are the solver's tolerance and shown as such."""
    if not math.isfinite(error):
        return "-"
    return "exact" if abs(error) < 1e-7 else f"{error:+.1e}"
