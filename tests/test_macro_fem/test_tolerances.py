"""Tolerances and limits of the curtain's solvers, through the solver: what is asked for is what is met, and no more."""

import numpy as np
import pytest

from homogenize.laws.net import diagonal_net
from macro_fem.fem.membrane import evaluate
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.schema import read_scene
from macro_fem.solution import make_problem
from macro_fem.solvers.clarabel import ClarabelOptions, solve_clarabel
from macro_fem.solvers.cones import green_strain, law_cut
from macro_fem.solvers.newton import NewtonOptions
from macro_fem.solvers.newton import solve as solve_newton


def corners(law, scene_tables, **mesh):
    scene = read_scene(scene_tables(mesh={"cells": 4, **mesh}, support={"kind": "corners"}))
    return make_problem(scene, law, build_mesh(scene, law.cell))


def clarabel(problem, **options):
    """clarabel's record, and total load times size: what its gap is relative to."""
    load = problem.fem.gather(problem.force)
    result = solve_clarabel(problem.fem, problem.law, load, problem.mesh.size, ClarabelOptions(**options))
    return result, float(np.abs(load).sum()) * problem.mesh.size


def test_clarabel_closes_the_gap_that_is_asked_for(ring_like, scene_tables):
    pytest.importorskip("clarabel")
    problem = corners(ring_like, scene_tables)
    iterations = []
    for gap in (1e-5, 1e-7, 1e-9):
        result, scale = clarabel(problem, gap=gap)
        assert result.converged
        assert abs(result.primal - result.dual) < 10.0 * gap * scale
        iterations.append(result.iterations)
    assert iterations[0] < iterations[-1]


def test_clarabel_cuts_until_the_violation_that_is_asked_for(ring_like, scene_tables):
    pytest.importorskip("clarabel")
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


def net_newton(scene_tables, rtol):
    """A net hung from its gathered top edge, by Newton's method from the held top alone; the problem and the answer."""
    tables = scene_tables(
        width=40.0, height=40.0, areal_mass=1.0, mesh={"cells": 8}, support={"kind": "top", "gather": 0.7}
    )
    scene = read_scene(tables)
    law = diagonal_net(1.0, 20.0)
    problem = make_problem(scene, law, build_mesh(scene, law.cell))
    start = problem.supports.positions - problem.disc.nodes
    return problem, solve_newton(problem.fem, problem.law, problem.force, start, NewtonOptions(rtol=rtol))


@pytest.mark.parametrize("rtol", [1e-2, 1e-4, 1e-6, 1e-8])
def test_forces_balance_to_rtol(scene_tables, rtol):
    """Recomputed from the answer: what is out of balance at free nodes over the larger of applied and inner forces."""
    problem, answer = net_newton(scene_tables, rtol)
    assert answer.stop == "closed"
    internal = evaluate(problem.disc, problem.law, answer.u).internal
    out = np.where(problem.supports.mask, 0.0, internal - problem.force)
    residual = np.linalg.norm(out) / max(np.linalg.norm(internal), np.linalg.norm(problem.force))
    assert residual < rtol + 1e-9
    assert answer.residual == pytest.approx(residual, rel=0.5, abs=1e-12)
    assert answer.tolerance == pytest.approx(rtol, abs=1e-9)


def test_a_looser_rtol_is_not_met_better_than_needed(scene_tables):
    steps = [len(net_newton(scene_tables, rtol)[1].history) for rtol in (1e-1, 1e-3, 1e-9)]
    assert steps == sorted(set(steps))
