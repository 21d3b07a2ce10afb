"""The third coordinate, half-spaces that never act, ties."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.frame import Section
from benchmarks.measure import Row, least_seconds
from benchmarks.omissions.compare import LEFT_OUT, USED, trial, trial_table, verdict
from benchmarks.problems import square
from homogenize import MembraneLaw, default_law
from homogenize.laws import HalfSpaces, PolyhedralLaw
from macro_fem import read_scene
from macro_fem.curtain import CurtainProblem, gathered_start, make_problem, solve_problem, stabilising_tension
from macro_fem.fem import load_vector
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.solvers import PathOptions, PathResult, first_cones, solve_path
from macro_fem.solvers.path import PATH

TOLERANCE = 1e-9
"""Of the solver: potentials relative to load times size, and the mean height relative to the size."""
Answer = Callable[[], tuple[bool, float]]
KEEP_IDLE = PathOptions(pruned_at=())


def measure(full: bool) -> Section:
    """The section."""
    law = default_law()
    cells = 24 if full else 16
    trials = [
        third_coordinate(law, "corners", cells),
        third_coordinate(law, "top", cells, {"bar": {"mass": 1.0}}),
        all_half_spaces(law, 6 if full else 4),
        ties(law, cells),
        by_option(law, "idle half-spaces", cells, PathOptions(), KEEP_IDLE),
        *(flow(law, cells // 2, strings) for strings in (False, True)),
    ]
    text = (
        "A square metre of ring mesh, r1/r2 = 10, hung by its corners, or from its top edge with a straight bar. "
        "`third-coordinate`: nodes may leave the plane. `all-half-spaces`: every point begins with all half-spaces of "
        "the law, instead of adding those that are violated. `idle half-spaces`: none is dropped on the way. `ties`: a "
        "matrix between nodes and unknowns, needed only for straight bars. `flow`, `strings`: rings may flow, and "
        "become strings, under loads at which none does."
    )
    tables = (trial_table("Features switched on in curtains", trials),)
    return Section("Curtains", text, tables, (), verdict(trials))


def problem_of(
    law: MembraneLaw, hung: str, cells: int, load: dict[str, Any] | None = None, **solver: Any
) -> CurtainProblem:
    """A square metre of ring mesh; `hung` by which support, live `load`, keys of [solver]."""
    scene = read_scene(square(cells, hung, load=load or {}, solver=solver))
    return make_problem(scene, law, build_mesh(scene, law.cell))


def compared(
    feature: str, hung: str, calls: Sequence[Answer], problem: CurtainProblem, unit: str = "mm", default: str = LEFT_OUT
) -> Row:
    """The calls without and with a feature, by the numbers they return: mean heights in mm, or relative potentials."""
    (plain, found), seconds = zip(*(least_seconds(call, long=3.0) for call in calls), strict=True)
    tolerance = TOLERANCE * problem.mesh.size if unit == "mm" else 3.0 * TOLERANCE
    change, scene = abs(found[1] - plain[1]), f"{hung}, {problem.disc.n_points} points"
    return trial(feature, scene, seconds, change, tolerance, unit, default, ok=plain[0] and found[0])


def height(problem: CurtainProblem) -> tuple[bool, float]:
    """Whether the curtain converges, and its mean height."""
    found = solve_problem(problem)
    return found.status == "converged", found.mean_height()


def rigid(problem: CurtainProblem, options: PathOptions = PATH) -> PathResult:
    """Ideal locking with these options, in the plane or in space."""
    fem, start = problem.fem, gathered_start(problem)
    load = fem.gather(problem.force) + fem.force(stabilising_tension(problem) * problem.frame)
    return solve_path(fem, problem.law, load, fem.unknowns(start), problem.mesh.size, options)


def rigid_height(problem: CurtainProblem) -> tuple[bool, float]:
    """Whether the rigid curtain converges, and its mean height."""
    area = load_vector(problem.disc, np.array([1.0]))[:, 0]
    found = rigid(problem)
    return found.status == "converged", float(area @ problem.fem.positions(found.z)[:, 1] / area.sum())


def third_coordinate(law: MembraneLaw, hung: str, cells: int, load: dict[str, Any] | None = None) -> Row:
    """Nodes that may leave the plane, against nodes that may not, by the mean height."""
    plane = problem_of(law, hung, cells, load)
    space = problem_of(law, hung, cells, load, space=True)
    calls = (partial(rigid_height, plane), partial(rigid_height, space))
    return compared("third-coordinate", "bar" if load else hung, calls, plane)


def all_half_spaces(law: MembraneLaw, cells: int) -> Row:
    """All half-spaces of the law from the start, by the potential."""
    assert isinstance(law, PolyhedralLaw)
    points = problem_of(law, "corners", cells).disc.n_points
    every = replace(KEEP_IDLE, cones=first_cones(HalfSpaces(law.S, law.h), points))
    return by_option(law, "all-half-spaces", cells, PATH, every)


def ties(law: MembraneLaw, cells: int) -> Row:
    """A matrix between nodes and unknowns though no bar needs one."""
    plain = problem_of(law, "corners", cells)
    tied = replace(plain, fem=replace(plain.fem, tie=plain.fem.T))
    return compared("ties", "corners", (partial(height, plain), partial(height, tied)), plain)


def flow(law: MembraneLaw, cells: int, strings: bool) -> Row:
    """Rings that may flow, or flow until they are strings, under loads at which none does."""
    plain, flowing = (problem_of(law, "corners", cells, **one) for one in ({}, {"kind": "plastic", "strings": strings}))
    calls = partial(height, plain), partial(height, flowing)
    return compared("strings" if strings else "flow", "corners", calls, plain)


def by_option(law: MembraneLaw, feature: str, cells: int, without: PathOptions, with_it: PathOptions) -> Row:
    """An option of the cone solver, by the potential over load times size."""
    problem = problem_of(law, "corners", cells)
    scale = float(np.abs(problem.force).sum()) * problem.mesh.size

    def potential(options: PathOptions) -> tuple[bool, float]:
        found = rigid(problem, options)
        return found.status == "converged", found.primal / scale

    calls = partial(potential, without), partial(potential, with_it)
    default = USED if with_it == PathOptions() else LEFT_OUT
    return compared(feature, "corners", calls, problem, "of the potential", default)
