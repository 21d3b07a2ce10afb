"""What the two bounds of a curtain promise, at loose tolerances, early stops, load factors and point loads."""

from dataclasses import replace

import numpy as np
import pytest

from macro_fem import read_scene
from macro_fem.bounds import at_dual_nodes, bound, dual_problem
from macro_fem.bounds import interval as bounds
from macro_fem.curtain import gathered_start, solve_problem
from macro_fem.solvers import PathOptions, all_cuts, green_strain, solve_path
from tests.test_macro_fem.sheets import posed, solve_scene


def solve(problem, **options):
    """The rigid solver's own record, and total load times size: what its tolerances are relative to."""
    load, z = problem.fem.gather(problem.force), problem.fem.unknowns(gathered_start(problem))
    result = solve_path(problem.fem, problem.law, load, z, problem.mesh.size, PathOptions(**options))
    return result, float(np.abs(load).sum()) * problem.mesh.size


LEFT = {"kind": "edge", "edge": "left", "gather": 0.95}
PULLED = {"point": {"at": [50.0, 0.0], "force": [-0.138, 0.004]}}


@pytest.mark.parametrize(
    ("hang", "height", "support", "load", "mesh"),
    [
        ("x", 95.0, LEFT, {}, {"cells": 5}),
        pytest.param("y", 95.9, LEFT, {}, {"cells": 6, "pattern": "diagonal"}, marks=pytest.mark.slow),
        pytest.param(83.0, 79.0, {"kind": "corners"}, PULLED, {"cells": 3, "element": "P2"}, marks=pytest.mark.slow),
    ],
)
def test_a_loose_answer_is_admissible_and_above_the_least_potential(
    ring_like, scene_tables, hang, height, support, load, mesh
):
    """The last iterate may leave the law, by 1e-6 to 1e-4 at some of these tolerances; the answer does not."""
    problem = posed(scene_tables(hang=hang, height=height, support=support, load=load, mesh=mesh), ring_like)
    fine, scale = solve(problem)
    for gap in 10.0 ** np.arange(-2.0, -5.0, -0.25):
        loose, _ = solve(problem, gap=gap, violation=10.0 * gap)
        assert loose.status == "converged"
        assert all_cuts(problem.law, green_strain(problem.fem.gradient(loose.z))).violation.max() < 1e-12
        assert loose.primal >= fine.dual - 1e-12 * scale


def test_the_lower_bound_holds_wherever_the_iteration_is_stopped(ring_like, scene_tables):
    """Forces are not balanced before the end. Without what they could do, steps 6 to 9 are above the answer."""
    problem = posed(scene_tables(hang="x", support={"kind": "rail"}), ring_like)
    fine, scale = solve(problem)
    for steps in range(1, fine.iterations):
        early, _ = solve(problem, max_iterations=steps)
        assert early.status == "iterations"
        assert early.dual <= fine.primal + 1e-10 * scale


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("support", [{"kind": "corners"}, {"kind": "top", "gather": 0.9}])
def test_the_gap_is_as_small_as_the_tolerance_says(ring_like, scene_tables, tolerance, support):
    """Gap and unbalanced forces are each below `tolerance`; the latter count REACH = 4 times in the lower bound."""
    solver = {"tolerance": tolerance, "stabilising_tension": 0.0}
    solution = solve_scene(read_scene(scene_tables(support=support, solver=solver)), ring_like)
    assert solution.status == "converged"
    scale = np.abs(solution.problem.force).sum() * solution.problem.mesh.size
    assert solution.residual < tolerance
    assert -1e-12 < (solution.primal - solution.dual) / scale < 6.0 * tolerance


def corner_load(scene_tables):
    """A top edge held, and a force at the lower left corner."""
    return scene_tables(
        mesh={"cells": 4, "pattern": "diagonal"},
        support={"kind": "top", "gather": 0.9},
        load={"point": {"at": [0.0, 0.0], "force": [0.03, -0.04]}},
        solver={"stabilising_tension": 0.0},
    )


def sheared(law):
    """The law with its vertices turned by 25 degrees, so that locked strains have a shear."""
    c, s = np.cos(np.radians(25.0)), np.sin(np.radians(25.0))
    turn = np.array([[c, -s], [s, c]])
    tensors = np.array([turn @ [[a, g], [g, b]] @ turn.T for a, g, b in law.vertices])
    return replace(law, vertices=np.stack([tensors[:, 0, 0], tensors[:, 0, 1], tensors[:, 1, 1]], axis=-1))


def spread_cost(solution, force):
    """|f| times the mean of kappa s over the edges at the lower left corner, s the distance from it: by hand."""
    sk = solution.problem.mesh.mesh
    corner = int(np.argmin(np.abs(sk.p).sum(axis=0)))
    edges = [sk.p[:, pair[pair != corner][0]] for pair in sk.facets.T if corner in pair]
    vertices = solution.problem.law.own.vertices
    green = np.array([[[a, c], [c, b]] for a, c, b in vertices])
    lengths = np.array([np.hypot(*e) for e in edges])
    kappa = [np.sqrt(1.0 + 2.0 * max(e @ E @ e for E in green) / (e @ e)) for e in edges]
    return np.hypot(*force) * np.sum(kappa * lengths**2 / 2.0) / lengths.sum()


def test_a_point_load_costs_what_its_spreading_may_move(ring_like, scene_tables, monkeypatch):
    """The force acts along the edges at its corner instead of at it: what that may change is left out of the bound."""
    solution = solve_scene(read_scene(corner_load(scene_tables)), sheared(ring_like))
    cost = spread_cost(solution, (0.03, -0.04))
    x = at_dual_nodes(solution.x, solution.problem.mesh)
    stepped = replace(solution, problem=replace(solution.problem, factor=0.5))
    loaded, half = (dual_problem(one.problem, x).load_cost for one in (solution, stepped))
    assert (loaded.sum(), half.sum()) == pytest.approx((cost, 0.5 * cost), rel=1e-9)
    with_cost = bound(solution)
    assert with_cost.error.sum() == pytest.approx(with_cost.gap, rel=1e-9)  # also beside the point, to be refined there
    monkeypatch.setattr(bounds, "dual_problem", lambda *given: replace(dual_problem(*given), load_cost=0.0 * loaded))
    assert bound(solution).lower - with_cost.lower == pytest.approx(cost, rel=1e-9)


LIVE = {
    "edge": {"edge": "bottom", "force": [0.01, -0.03]},
    "point": {"at": [0.0, 0.0], "force": [0.3, -0.4]},
    "patch": {"at": [50.0, 40.0], "radius": 30.0, "force": [0.2, -1.0]},
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(LIVE))
def test_half_the_step_is_half_the_live_load(ring_like, scene_tables, kind):
    """Bounds at the factor 0.5 are those of half the load; the weight is not live."""
    half = {**LIVE[kind], "force": [0.5 * f for f in LIVE[kind]["force"]]}
    answers = []
    for load, factor in (({kind: LIVE[kind]}, 0.5), ({kind: half}, 1.0), ({kind: LIVE[kind]}, 1.0)):
        more = {"support": {"kind": "top", "gather": 0.9}, "solver": {"stabilising_tension": 0.0}}
        solution = solve_problem(posed(scene_tables(mesh={"cells": 4}, load=load, **more), ring_like, factor))
        answers.append(bound(solution))
        scale = np.abs(solution.problem.force).sum() * 100.0
    stepped, halved, full = answers
    assert stepped.upper == pytest.approx(halved.upper, abs=1e-7 * scale)
    assert stepped.lower == pytest.approx(halved.lower, abs=1e-6 * scale)
    assert abs(full.lower - halved.lower) > 1e-4 * scale


def test_a_bound_that_was_not_found_is_no_number(ring_like, scene_tables):
    """A dual solver stopped early says so, and its value is not offered as a bound."""
    solution = solve_scene(read_scene(scene_tables(support={"kind": "top", "gather": 0.9})), ring_like)
    scene = solution.problem.scene
    hurried = replace(scene, solver=replace(scene.solver, max_iterations=2))
    stopped = bound(replace(solution, problem=replace(solution.problem, scene=hurried)))
    assert stopped.status == "iterations"
    assert np.isnan(stopped.lower)
    assert np.isfinite(bound(solution).lower)
