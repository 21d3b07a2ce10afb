"""Half-spaces taken in on the way: they land at their points, keep the state inside, and spare most of the steps."""

from dataclasses import replace

import numpy as np
import pytest

from homogenize import default_law
from homogenize.laws import Cut
from macro_fem.curtain import gathered_start
from macro_fem.solvers import (
    Cones,
    PathOptions,
    Program,
    WallRows,
    Walls,
    all_cuts,
    compliance_root,
    first_cones,
    green_strain,
    solve_path,
    with_cuts,
)
from macro_fem.solvers.cone_program import find_first_state, measure
from macro_fem.solvers.cone_step import find_nearest, find_step
from rve.common import double_dot, trace
from tests.test_macro_fem.sheets import posed


@pytest.fixture(scope="module")
def rings():
    return default_law()


@pytest.fixture
def problem(rings, scene_tables):
    return posed(scene_tables(support={"kind": "corners"}), rings)


def begun(problem):
    """The program of a problem with the law's first half-spaces, its slack start, and the load."""
    fem = problem.fem
    load, z = fem.gather(problem.force), fem.unknowns(gathered_start(problem))
    total = np.abs(load).sum()
    cones = first_cones(problem.law.half_spaces(), len(fem.disc.weight))
    R, rows = compliance_root(np.zeros((3, 3))), WallRows(fem, Walls.none(fem.x_held.shape), 140.0)
    program = Program(fem, problem.law, load, cones, R, 140.0 * total, total, rows)
    return program, find_first_state(program, z, PathOptions.first_gap)


def on_the_way(problem, rings):
    """A state some steps down the path, the next step from it and what the law misses at its end."""
    program, state = begun(problem)
    for _ in range(60):
        now = measure(program, state)
        step = find_step(program, state, now, 1e-10)
        E = green_strain(problem.fem.gradient(state.z + step.primal * step.dz))
        found = find_nearest(program, now, E, now.wanted + step.d_wanted * step.primal)
        if len(found[1]) > 3:
            return program, state, step, *found
        part = 0.5 * step.primal
        s, y = state.s + step.ds * part, state.y + step.dy * (0.5 * step.dual)
        state = replace(state, z=state.z + part * step.dz, s=s, y=y)
    raise AssertionError("the law was never left")


def test_cuts_are_sorted_in_behind_the_others_of_their_points():
    rng = np.random.default_rng(2)
    count = rng.integers(1, 5, size=12)
    point = np.repeat(np.arange(12), count)
    cones = Cones(point, rng.normal(size=(len(point), 3)), rng.normal(size=len(point)), np.cumsum(count) - count)
    new = np.array([0, 3, 4, 11])
    S, h = rng.normal(size=(4, 3)), rng.normal(size=4)
    wider, order = with_cuts(cones, new, Cut(S, h, 0.0 * h))
    slow = sorted([(p, i) for i, p in enumerate(point)] + [(p, len(point) + k) for k, p in enumerate(new)])
    assert order.tolist() == [i for _, i in slow]
    assert wider.point.tolist() == [p for p, _ in slow]
    assert wider.first.tolist() == [int(np.flatnonzero(wider.point == p)[0]) for p in range(12)]
    assert np.array_equal(wider.S, np.concatenate([cones.S, S])[order])
    assert np.array_equal(wider.h, np.concatenate([cones.h, h])[order])


def test_what_is_missing_is_what_no_known_half_space_says(problem, rings):
    program, state, step, violation, missing, _ = on_the_way(problem, rings)
    F = problem.fem.gradient(state.z + step.primal * step.dz)
    cut = all_cuts(rings, green_strain(F))
    cones, E = program.cones, green_strain(F)[program.cones.point]
    known = (cones.h - double_dot(cones.S, E)) / trace(cones.S)
    least = np.array([known[program.cones.point == p].min() for p in range(len(F))])
    violated = -cut.violation / trace(cut.S) < np.minimum(least, 0.0) - 1e-9
    assert violated.any()
    assert np.isin(np.flatnonzero(violated), missing).all()
    assert np.allclose(violation, cut.violation / (cut.h + 0.5 * trace(cut.S)))


def test_the_path_takes_few_steps_though_the_law_has_thousands_of_half_spaces(problem, rings):
    """Solving in rounds, a new start for each, took 150 steps at 3,600 cells and grew with the mesh."""
    program, state = begun(problem)
    result = solve_path(problem.fem, rings, program.load, state.z, 140.0)
    assert result.status == "converged"
    assert result.iterations <= 60
    assert len(result.cones) < 14 * len(result.cones.first)
    assert all_cuts(rings, green_strain(problem.fem.gradient(result.z))).violation.max() < 1e-9
    assert result.evidence.unbalanced < PathOptions.gap
