"""The rigid solver against exact curtains, against clarabel and against its own certificate."""

from itertools import pairwise

import numpy as np
import pytest

from homogenize import diagonal_net, ring_net
from macro_fem import read_scene
from macro_fem.curtain import gathered_start
from macro_fem.solvers import all_cuts, green_strain, solve_path
from rve.geometry import CellInfo
from tests.test_macro_fem.clarabel_oracle import solve_clarabel
from tests.test_macro_fem.sheets import posed, sheet, solve_scene

RINGS = CellInfo(5.0, 0.5, 11.0, 12.646069623526, 2.785)
STRETCH_X, SHRINK_Y = 17.42005 / 11.0, 4.25798 / 12.646069623526


def solve(tables, law):
    return solve_scene(read_scene(tables), law)


def assert_certified(solution, law, size=100.0):
    """Admissible for the whole law, in equilibrium, and the gap closed: all recomputed from the record."""
    assert solution.status == "converged", solution.message
    assert all_cuts(solution.problem.law, green_strain(solution.F)).violation.max() < 1e-9
    fem, force = solution.problem.fem, solution.problem.force
    unbalanced = fem.gather(force) - fem.force(solution.P)
    spread = solution.problem.scene.solver.stabilising_tension
    assert np.abs(unbalanced).sum() < (1e-8 + 100.0 * spread) * np.abs(force).sum()
    assert (
        np.abs(solution.F @ solution.S[:, [0, 1, 1, 2]].reshape(-1, 2, 2) - solution.P).max()
        < 1e-3 * np.abs(solution.P).max()
    )
    S = solution.S
    assert np.all(S[:, 0] * S[:, 2] - S[:, 1] ** 2 > -1e-12 * S.max() ** 2)
    scale = np.abs(force).sum() * size
    gap = (solution.primal - solution.dual) / scale
    assert -1e-12 < gap < 2e-8 + 6.0 * spread


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_hung_along_x_from_a_rail_reaches_the_uniaxial_state(ring_like, scene_tables, element):
    tables = scene_tables(hang="x", mesh={"cells": 4, "element": element}, support={"kind": "rail"})
    solution = solve(tables, ring_like)
    assert_certified(solution, ring_like)
    X = solution.problem.disc.nodes
    assert solution.mean_height() == pytest.approx(100.0 - 50.0 * STRETCH_X, abs=1e-6)
    assert 100.0 - solution.x[:, 1] == pytest.approx((100.0 - X[:, 1]) * STRETCH_X, abs=1e-4)
    assert np.ptp(solution.x[:, 0]) == pytest.approx(100.0 * SHRINK_Y, rel=0.02)  # only `spread` decides the width


def test_net_square_with_gathered_top_is_exact_on_aligned_meshes():
    solution = solve(sheet(40.0, 40.0, 8, {"kind": "top", "gather": 0.7}, areal_mass=1.0), diagonal_net())
    assert_certified(solution, diagonal_net(), 40.0)
    assert solution.mean_height() == pytest.approx(14.187635, abs=5e-7)


def test_strip_carries_the_weight_below(ring_like, scene_tables):
    exact = {"stabilising_tension": 0.0}
    tables = scene_tables(hang="x", width=20.0, mesh={"cells": 2}, support={"kind": "rail"}, solver=exact)
    solution = solve(tables, ring_like)
    disc = solution.problem.disc
    weight = -solution.problem.force[:, 1].sum() / (20.0 * 100.0)
    corners = np.unique(np.round(disc.nodes[np.isclose(disc.nodes[:, 0], 0.0), 1], 9))
    for low, high in pairwise(corners):
        row = (disc.points[:, 1] > low) & (disc.points[:, 1] < high)
        mean = float((disc.weight * solution.P[:, 1, 1])[row].sum() / disc.weight[row].sum())
        assert mean == pytest.approx(weight * 0.5 * (low + high), rel=1e-5)
    top = float(solution.reactions[:, 1].sum())
    assert top == pytest.approx(weight * 20.0 * 100.0, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hang", "support"), [("y", {"kind": "corners"}), ("x", {"kind": "top", "gather": 0.9}), (30.0, {"kind": "top"})]
)
def test_clarabel_finds_the_same_potential(ring_like, scene_tables, hang, support):
    solution = solve(scene_tables(hang=hang, support=support), ring_like)
    assert_certified(solution, ring_like)
    problem = solution.problem
    oracle = solve_clarabel(problem.fem, problem.law, problem.fem.gather(problem.force), problem.mesh.size)
    assert oracle.status == "converged"
    z = problem.fem.unknowns(solution.x)
    ours = -float(problem.fem.gather(problem.force) @ z)
    scale = np.abs(problem.force).sum() * 100.0
    assert abs(ours - oracle.primal) < 2e-7 * scale
    assert oracle.dual <= ours + 1e-9 * scale
    load = problem.fem.gather(problem.force)
    assert np.abs(problem.fem.force(oracle.P) - load).max() < 1e-3 * np.abs(load).max()


@pytest.mark.parametrize("gather", [1.65, 2.0])
def test_supports_too_far_apart_are_proved_impossible(gather, scene_tables):
    law = ring_net(RINGS)  # its chains stretch to 18/11 = 1.6364 along x
    problem = posed(scene_tables(support={"kind": "top", "gather": gather}), law)
    load = problem.fem.gather(problem.force)
    result = solve_path(problem.fem, problem.law, load, problem.fem.unknowns(gathered_start(problem)), 140.0)
    assert result.status == "infeasible"
    # Farkas: P does no work on free unknowns, so the work P:F is that of the supports, whatever the curtain does; and
    # it is more than the cones allow, sum w c |y1|.
    y1L, w = result.P, problem.disc.weight
    work = (w[:, None, None] * y1L * problem.fem.gradient(np.zeros_like(result.z))).sum()
    allowed = w @ result.psi
    assert work > allowed
    assert np.abs(problem.fem.force(y1L)).sum() * 300.0 < work - allowed
    assert "%" in result.message


LIMIT = 18.0 / 11.0
"""The gather at which the chains of the net are straight along the whole top edge."""


def test_supports_at_the_very_limit_are_named_and_bounded(scene_tables):
    """No state has room there, and the pull is unlimited: answer and bounds are those of rings which give."""
    law = ring_net(RINGS)
    solution = solve(scene_tables(support={"kind": "top", "gather": LIMIT}), law)
    assert solution.status == "taut"
    assert "as far apart as the mesh can stretch" in solution.message
    top = np.isclose(solution.problem.disc.nodes[:, 1], 100.0)
    assert solution.x[top, 1] == pytest.approx(100.0, abs=1e-9)
    assert np.ptp(solution.x[top, 0]) == pytest.approx(100.0 * LIMIT, rel=1e-9)
    # it leaves the law by what it says, and would not reach without
    assert solution.relaxation == pytest.approx(1e-4, rel=1e-3)
    assert 0.5 * solution.relaxation < solution.stretch_excess < 1.01 * solution.relaxation
    assert -1e-9 < solution.relative_gap < 2e-5
    # the answers for less gather come up to it from below as the square root of what is missing
    below = [solve(scene_tables(support={"kind": "top", "gather": LIMIT * (1.0 - e)}), law) for e in (4e-3, 1e-3)]
    assert [b.status for b in below] == ["converged"] * 2
    limit = 2.0 * below[1].primal - below[0].primal
    missing = (limit - solution.primal) / (limit - below[1].primal)
    assert missing == pytest.approx(np.sqrt(solution.relaxation / 1e-3), rel=0.02)


@pytest.mark.parametrize(
    ("gather", "status"), [(LIMIT * (1.0 - 2e-4), "converged"), (LIMIT * (1.0 + 2e-4), "infeasible")]
)
def test_a_little_less_is_solved_and_a_little_more_refuted(scene_tables, gather, status):
    assert solve(scene_tables(support={"kind": "top", "gather": gather}), ring_net(RINGS)).status == status


@pytest.mark.parametrize("state", [0, 1, 2])
@pytest.mark.parametrize("element", ["P1", "P2"])
def test_patch_in_every_locked_state(ring_like, state, element):
    """Tractions of a uniform stress inside the normal cone of a vertex hold every point there, however turned."""
    values = (ring_like.S * np.array([1.0, 2.0, 1.0])) @ ring_like.vertices.T
    ordered = np.sort(values, axis=1)
    is_sure = (values.argmax(axis=1) == state) & (ordered[:, 2] - ordered[:, 1] > 0.002)
    S = ring_like.S[is_sure].mean(axis=0)
    stretch = np.sqrt(1.0 + 2.0 * ring_like.vertices[state, [0, 2]])
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    F = turn @ np.diag(stretch)
    P = F @ np.array([[S[0], S[1]], [S[1], S[2]]])
    pull = {"right": P[:, 0], "left": -P[:, 0], "top": P[:, 1], "bottom": -P[:, 1]}
    load = {"edge": [{"edge": name, "force": force.tolist()} for name, force in pull.items()]}
    mesh, at = {"element": element, "pattern": "crossed"}, {"kind": "point", "at": [0.0, 0.0]}
    solution = solve(sheet(60.0, 60.0, 4, at, mesh, load, {"stabilising_tension": 0.0}, areal_mass=0.0), ring_like)
    assert solution.status == "converged"
    exact = -(solution.problem.force * (solution.problem.disc.nodes @ (F - np.eye(2)).T)).sum()
    scale = np.abs(solution.problem.force).sum() * 60.0
    assert abs(solution.primal - exact) < 1e-8 * scale
    assert np.abs(solution.F - F).max() < 1e-4
