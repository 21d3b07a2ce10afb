"""The oracle itself: clarabel meets what it is asked for, and no more."""

import numpy as np

from macro_fem.solvers.cones import green_strain, law_cut
from tests.test_macro_fem.clarabel_oracle import ClarabelOptions, solve_clarabel
from tests.test_macro_fem.sheets import posed


def corners(law, scene_tables, **mesh):
    return posed(scene_tables(mesh={"cells": 4, **mesh}, support={"kind": "corners"}), law)


def clarabel(problem, **options):
    """clarabel's record, and total load times size: what its gap is relative to."""
    load = problem.fem.gather(problem.force)
    result = solve_clarabel(problem.fem, problem.law, load, problem.mesh.size, ClarabelOptions(**options))
    return result, float(np.abs(load).sum()) * problem.mesh.size


def test_clarabel_closes_the_gap_that_is_asked_for(ring_like, scene_tables):
    problem = corners(ring_like, scene_tables)
    for gap in (1e-5, 1e-7, 1e-9):
        result, scale = clarabel(problem, gap=gap)
        assert result.converged
        assert abs(result.primal - result.dual) < 10.0 * gap * scale


def test_clarabel_cuts_until_the_violation_that_is_asked_for(ring_like, scene_tables):
    problem = corners(ring_like, scene_tables)
    rounds = []
    for violation in (1e-1, 1e-3, 1e-8):
        result, _ = clarabel(problem, violation=violation)
        outside = -law_cut(problem.law, green_strain(problem.fem.gradient(result.z)))[2].min()
        assert outside < violation
        rounds.append(len(result.history))
    assert rounds == sorted(set(rounds))
    first, _ = clarabel(problem, max_rounds=1)
    assert first.status == "iterations"
    assert "max_iterations" in first.message
