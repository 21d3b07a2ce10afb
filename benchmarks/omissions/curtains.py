"""The third coordinate, half-spaces that never act, second-order corrections, ties, coarse starts and slack cells."""

from __future__ import annotations

import cProfile
import pstats
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.omissions.compare import LEFT_OUT, USED, Trial, bars, table, verdict
from benchmarks.pages.measuring import least_seconds
from benchmarks.pages.model import Column, Section, Table
from homogenize.law import MembraneLaw, default_law
from macro_fem.mesh import build_mesh
from macro_fem.rigid import RigidOptions, RigidResult, solve_rigid
from macro_fem.scene import read_scene
from macro_fem.solution import CurtainSolution, Problem, gathered_start, make_problem, spread_tension, unit_tensors
from macro_fem.solvers import COARSE_FROM, solve_problem, starts_coarse

TOLERANCE = 1e-9
"""Of the solver: potentials relative to load times size. The mean height is as good, times the size."""
BAR = {"bar": {"mass": 1.0}}


def measure(full: bool) -> Section:
    """The section."""
    law = default_law()
    cells = 24 if full else 16
    trials = [
        forced(law, "third-coordinate", "corners", cells),
        forced(law, "third-coordinate", "top", cells, BAR),
        forced(law, "all-half-spaces", "corners", 6 if full else 4),
        forced(law, "ties", "corners", cells),
        forced(law, "coarse-start", "corners", cells),
        coarse_start(law, 64 if full else 40),
        by_option(law, "idle half-spaces", cells, RigidOptions(), RigidOptions(drop_idle=False)),
        by_option(law, "corrector", cells, RigidOptions(corrector=False), RigidOptions()),
    ]
    steps = correction(law, (8, 16, 32) if full else (8, 16))
    slack, most = slack_cells(law, 24 if full else 16)
    text = (
        "A square metre of ring mesh, r1/r2 = 10, by `macro-fem run --force FEATURE`: hung by its corners, or from "
        "its top edge with a straight bar. `third-coordinate`: nodes may leave the plane. `all-half-spaces`: every "
        "point has all half-spaces of the law from the start, instead of those that are met. `idle half-spaces`: "
        "none is dropped on the way. `corrector`: the second derivatives in the cone solver, Mehrotra's correction "
        "of each step; the cones themselves are linear in the unknowns and have none. `ties`: a matrix between nodes "
        f"and unknowns, which only straight bars need. `coarse-start`: a coarser curtain first, from {COARSE_FROM} "
        "points on."
    )
    pays = trials[-1].ratio < 1.0
    conclusion = (
        f"{verdict(trials)} The corrector {'pays' if pays else 'costs as much as it saves'} and is always used. Slack "
        f"cells are not left out: which ones hang slack is part of the answer, and no more than {most:.0f} % of the "
        "time could be saved here, by leaving them out of law and assembly."
    )
    tables = (table("Features forced into curtains", trials), steps, slack)
    return Section(
        "curtains",
        "Curtains",
        text,
        tables,
        (bars("curtains", "Features that curtains do without", trials),),
        conclusion,
    )


def problem_of(law: MembraneLaw, hung: str, cells: int, load: dict[str, Any] | None = None, **solver: Any) -> Problem:
    """A square metre of ring mesh; `hung` by which support, live `load`, keys of [solver]."""
    data = {
        "curtain": {"width": 1000.0, "height": 1000.0},
        "mesh": {"cells": cells},
        "support": {"kind": hung} if hung != "gathered" else {"kind": "corners", "gather": 0.5},
        "load": load or {},
        "solver": solver,
    }
    scene = read_scene(data)
    return make_problem(scene, law, build_mesh(scene, law.cell))


def forced(law: MembraneLaw, feature: str, kind: str, cells: int, load: dict[str, Any] | None = None) -> Trial:
    """A feature of the scene file, by the mean height."""
    plain, without = least_seconds(lambda: solve_problem(problem_of(law, kind, cells, load)), long=3.0)
    found, with_it = least_seconds(lambda: solve_problem(problem_of(law, kind, cells, load, force=[feature])), long=3.0)
    scene = f"{'bar' if load else kind}, {plain.problem.disc.n_points} points"
    return _trial(feature, scene, LEFT_OUT, (without, with_it), (plain, found))


def _trial(
    feature: str,
    scene: str,
    by_itself: str,
    seconds: tuple[float, float],
    both: tuple[CurtainSolution, CurtainSolution],
) -> Trial:
    change = abs(both[0].mean_height() - both[1].mean_height())
    ok = all(solution.status == "converged" for solution in both)
    tolerance = TOLERANCE * both[0].problem.mesh.size
    return Trial(feature, scene, by_itself, *seconds, change, tolerance, "mm", ok)


def coarse_start(law: MembraneLaw, cells: int) -> Trial:
    """A mesh that starts coarse by itself, against the same without."""
    problem = problem_of(law, "corners", cells)
    plain, without = least_seconds(lambda: rigid(problem, RigidOptions()), long=3.0)
    found, with_it = least_seconds(lambda: solve_problem(problem), long=3.0)
    x = problem.fem.positions(plain.z)
    height = replace(found, x=x).mean_height()
    change = abs(found.mean_height() - height)
    ok = plain.converged and found.status == "converged"
    scene = f"corners, {problem.disc.n_points} points"
    tolerance = TOLERANCE * problem.mesh.size
    return Trial(
        "coarse-start",
        scene,
        USED if starts_coarse(problem) else LEFT_OUT,
        without,
        with_it,
        change,
        tolerance,
        "mm",
        ok,
    )


def rigid(problem: Problem, options: RigidOptions) -> RigidResult:
    """Ideal locking with these options."""
    fem = problem.fem
    load = fem.gather(problem.force) + fem.force(spread_tension(problem) * unit_tensors(problem))
    return solve_rigid(fem, problem.law, load, fem.unknowns(gathered_start(problem)), problem.mesh.size, options)


def by_option(law: MembraneLaw, feature: str, cells: int, without: RigidOptions, with_it: RigidOptions) -> Trial:
    """An option of the cone solver, by the potential over load times size."""
    problem = problem_of(law, "corners", cells)
    plain, first = least_seconds(lambda: rigid(problem, without), long=3.0)
    found, second = least_seconds(lambda: rigid(problem, with_it), long=3.0)
    change = abs(found.primal - plain.primal) / (float(np.abs(problem.force).sum()) * problem.mesh.size)
    scene = f"corners, {problem.disc.n_points} points"
    ok = plain.converged and found.converged
    alone = USED if with_it == RigidOptions() else LEFT_OUT
    return Trial(feature, scene, alone, first, second, change, 3.0 * TOLERANCE, "of the potential", ok)


def correction(law: MembraneLaw, sizes: tuple[int, ...]) -> Table:
    """Steps and time of the cone solver with and without the correction to second order."""
    rows = []
    for cells in sizes:
        problem = problem_of(law, "corners", cells)
        for name, options in (("yes", RigidOptions()), ("no", RigidOptions(corrector=False))):
            found, seconds = least_seconds(partial(rigid, problem, options))
            rows.append((problem.disc.n_points, name, found.status, found.iterations, seconds))
    columns = (Column("points"), Column("corrector"), Column("status"), Column("steps"), Column("s", ".3f", timed=True))
    return Table("Second derivatives in the cone solver", columns, tuple(rows))


def slack_cells(law: MembraneLaw, cells: int) -> tuple[Table, float]:
    """What slack cells cost an elastic curtain: their share of the area, of the law's and the assembly's time; the most
    that leaving them out could save, in per cent of the time.
    """
    rows, most = [], 0.0
    for kind in ("corners", "gathered"):
        problem = problem_of(law, kind, cells, kind="newton")
        profile = cProfile.Profile()
        profile.enable()
        found = solve_problem(problem)
        profile.disable()
        share = float(np.mean(problem.law.response(found.E).energy == 0.0))
        time = _share_of_time(profile, ("tangent", "stiffness", "response"))
        most = max(most, 100.0 * share * time)
        per_point = _law_time(problem, found)
        rows.append((kind, found.status, 100.0 * share, 100.0 * time, 100.0 * share * time, *per_point))
    columns = (
        Column("supports"),
        Column("status"),
        Column("slack points, %", ".0f"),
        Column("law and assembly, % of the time", ".0f", timed=True),
        Column("could be saved at most, %", ".1f", timed=True),
        Column("law at a slack point, us", ".2f", timed=True),
        Column("law at a taut point, us", ".2f", timed=True),
    )
    note = (
        "Elastic curtains, under the profiler. The law itself leaves slack points out: inside the locking surface it "
        "looks for no closest point, as the last two columns show."
    )
    return Table("Slack cells", columns, tuple(rows), note), most


def _share_of_time(profile: cProfile.Profile, names: tuple[str, ...]) -> float:
    """Cumulated time of these functions over all time."""
    stats = pstats.Stats(profile)
    entries: dict[Any, Any] = stats.stats  # type: ignore[attr-defined]
    spent = sum(entry[3] for key, entry in entries.items() if key[2] in names and "macro_fem" in key[0])
    spent += sum(entry[3] for key, entry in entries.items() if key[2] == "respond")
    return float(spent / stats.total_tt)  # type: ignore[attr-defined]


def _law_time(problem: Problem, found: CurtainSolution, count: int = 20_000) -> tuple[float, float]:
    """Microseconds of the law per point where it is slack and where it is taut: the answer, moved in, out."""
    E = np.resize(found.E, (count, 3))
    inside, outside = E - np.array([0.5, 0.0, 0.5]), E + np.array([1e-3, 0.0, 1e-3])
    problem.law.response(E)
    spent = [least_seconds(partial(problem.law.response, E))[1] for E in (inside, outside)]
    return 1e6 * spent[0] / count, 1e6 * spent[1] / count
