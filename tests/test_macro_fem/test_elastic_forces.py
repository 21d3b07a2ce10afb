"""Forces that rigid rings leave open are those of elastic rings; unique ones are not touched."""

import numpy as np
import pytest

from homogenize import default_law, ring_net
from macro_fem import read_scene, solve
from macro_fem.curtain import NOT_UNIQUE, forces_note, self_balanced, solve_problem
from tests.test_macro_fem.sheets import solve_scene

WIDTH, HEIGHT = 80.0, 60.0


def scene(support, kind="auto", **tables):
    curtain = {"curtain": {"width": WIDTH, "height": HEIGHT}, "mesh": {"cells": 8}, "support": support}
    return read_scene(curtain | {"solver": {"kind": kind}} | tables)


BAR = {"bar": {"mass": 1.0}}
HOOKS = {"kind": "hooks", "pitch": 20.0}


def point(x, y, held):
    return {"kind": "point", "at": [x, y], "held": held}


@pytest.mark.parametrize(
    ("support", "count"),
    [
        ({"kind": "corners"}, 0),  # four components, three equations, but two points: their distance decides the pull
        ({"kind": "hooks", "pitch": 40.0}, 3),  # six components, three equations
        ({"kind": "hooks", "pitch": 40.0, "sliding": True}, 1),  # three upward forces, two equations
        ([point(0.0, HEIGHT, "y"), point(WIDTH, HEIGHT, "y"), point(40.0, 0.0, "x")], 0),  # three and three
        ({"kind": "rail"}, 7),  # nine nodes
    ],
)
def test_open_forces_are_counted_by_the_equations_of_balance(support, count):
    found = solve_scene(scene(support), default_law())
    assert self_balanced(found.problem, found.x) == count
    assert (forces_note(found) is None) == (count == 0)


def test_open_forces_in_space_are_counted_by_six_equations():
    found = solve_scene(scene(HOOKS | {"pitch": 40.0}, solver={"space": True}), default_law())
    assert self_balanced(found.problem, found.x) == 9 - 5  # points on one line: none resists turning about it


@pytest.mark.slow
def test_hooks_bear_what_elastic_rings_say_and_the_shape_stays_rigid():
    auto, rigid, elastic = (solve(scene(HOOKS, kind, load=BAR)) for kind in ("auto", "rigid", "elastic"))
    ours, theirs = (
        np.array([one["force_N"] for one in found.summary["support_forces"][0]["points"]]) for found in (auto, elastic)
    )
    one_of_many = np.array([one["force_N"] for one in rigid.summary["support_forces"][0]["points"]])
    load = (auto.summary["mass_kg"] + 1.0) * 9.81
    np.testing.assert_allclose(ours, theirs, atol=1e-4 * load)
    assert np.abs(one_of_many - theirs).max() > 0.02 * load
    np.testing.assert_allclose(ours.sum(axis=0), [0.0, load], atol=1e-6 * load)
    for key in ("mean_height_mm", "lowest_point_mm", "max_displacement_mm", "potential_primal_N_mm"):
        assert auto.summary[key] == rigid.summary[key]
    assert auto.summary["safety_factor"] == pytest.approx(elastic.summary["safety_factor"], rel=1e-3)
    told = [found.summary["forces_by"] for found in (auto, rigid, elastic)]
    assert told == ["elastic", "rigid", "elastic"]
    assert "statically indeterminate, to the degree 7" in auto.summary["support_forces_note"]
    assert rigid.summary["support_forces_note"] == NOT_UNIQUE
    assert elastic.summary["support_forces_note"] is None
    assert auto.summary["status"] == "converged"


@pytest.mark.slow
def test_elastic_rings_do_not_begin_with_half_spaces_that_do_not_widen():
    # Of rings that give by direction each half-space widens by its own part; those of a rigid answer do not know it.
    rigid, elastic = (solve_scene(scene(HOOKS, kind, load=BAR), default_law()) for kind in ("rigid", "elastic"))
    warm = solve_problem(elastic.problem, rigid)
    assert elastic.evidence.gap > -1e-10
    assert warm.evidence.gap > -1e-10
    assert warm.primal == pytest.approx(elastic.primal, rel=1e-9)


@pytest.mark.parametrize("bar", [{}, {"load": BAR}])
def test_unique_forces_take_no_second_step(bar):
    found = solve(scene({"kind": "corners"}, **bar))
    assert found.loaded.P is found.solution.P
    assert found.loaded.wall_s == found.solution.wall_s
    assert found.summary["forces_by"] == "rigid"
    assert found.summary["support_forces_note"] is None


def test_rings_without_stiffness_say_that_forces_are_one_choice():
    found = solve(scene(HOOKS), ring_net(default_law().cell))
    note = found.summary["support_forces_note"]
    assert ("one choice of many" in note) == (found.summary["forces_by"] == "rigid")


@pytest.mark.slow
def test_bounds_keep_their_shape_and_have_elastic_forces():
    bounded = solve(scene(HOOKS, solver={"bounds": True}))
    low, high = bounded.summary["mean_height_interval_mm"]
    assert low <= bounded.summary["mean_height_mm"] <= high
    assert bounded.summary["forces_by"] == "elastic"
    assert bounded.loaded.residual < 1e-5
