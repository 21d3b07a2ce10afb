"""The two bounds: they contain exact answers, close with the mesh, and each part of the proof is checked alone."""

from dataclasses import replace

import numpy as np
import pytest

from homogenize import diagonal_net
from macro_fem import read_scene
from macro_fem.bounds import bound, dual_disc, mark
from macro_fem.fem import gradient, internal_force
from macro_fem.job import solve_membrane
from macro_fem.output import interval_line
from macro_fem.scene import build_mesh
from tests.test_macro_fem.sheets import sheet, solve_scene

NET_MEAN_HEIGHT = 14.187635  # 40 x 40 net square, top gathered to 70 %, DESIGN section 6


def net_scene(pattern="diagonal", cells=6, **solver):
    held, solver = {"kind": "top", "gather": 0.7}, {"stabilising_tension": 0.0, **solver}
    return read_scene(sheet(40.0, 40.0, cells, held, {"pattern": pattern}, solver=solver, areal_mass=1.0))


def mean_height_bounds(solution, bounds):
    """Under its own weight alone the potential is weight times (mean height - 20)."""
    weight = -solution.problem.force[:, 1].sum()
    start = 20.0
    return start + bounds.lower / weight, start + bounds.upper / weight


@pytest.mark.parametrize("pattern", ["aligned", pytest.param("diagonal", marks=pytest.mark.slow)])
def test_bounds_contain_the_exact_net_square_and_close(pattern):
    widths = []
    for cells in (4, 8, 16):
        solution = solve_scene(net_scene(pattern, cells), diagonal_net())
        low, high = mean_height_bounds(solution, bound(solution))
        assert low <= NET_MEAN_HEIGHT <= high + 1e-6
        widths.append(high - low)
    assert widths[0] > 1.2 * widths[1] > 1.44 * widths[2]


@pytest.mark.parametrize(("hang", "kind"), [("y", "top"), ("x", "rail")])
def test_linear_stress_makes_hanging_strips_exact(ring_like, scene_tables, hang, kind):
    tables = scene_tables(hang=hang, support={"kind": kind}, solver={"stabilising_tension": 0.0})
    solution = solve_scene(read_scene(tables), ring_like)
    bounds = bound(solution)
    scale = np.abs(solution.problem.force).sum() * 100.0
    assert -1e-9 * scale < bounds.gap < 5e-4 * scale


@pytest.mark.slow
def test_corner_supports_and_point_loads_are_bounded_too(ring_like, scene_tables):
    load = {"point": {"at": [50.0, 0.0], "force": [0.02, -0.02]}}
    fine_tables = scene_tables(mesh={"cells": 16}, support={"kind": "corners"}, load=load)
    fine = solve_scene(read_scene(fine_tables), ring_like)
    gaps = []
    for cells in (4, 8):
        tables = {**fine_tables, "mesh": {"cells": cells}}
        solution = solve_scene(read_scene(tables), ring_like)
        bounds = bound(solution)
        # P1 on finer meshes comes down towards the continuous curtain, which is above every lower bound
        assert bounds.lower < fine.primal
        assert bounds.points > 0.0
        gaps.append(bounds.gap)
    assert gaps[1] < 0.7 * gaps[0]


def test_a_wrong_load_breaks_the_bound():
    """The gate fails when it should: with a tenth more weight in the dual the bound passes the exact answer."""
    solution = solve_scene(net_scene("aligned", 8), diagonal_net())
    curtain = solution.problem.scene.curtain
    cheated = replace(solution.problem.scene, curtain=replace(curtain, areal_mass=1.1))
    wrong = replace(solution, problem=replace(solution.problem, scene=cheated))
    low, _ = mean_height_bounds(solution, bound(wrong))
    honest, _ = mean_height_bounds(solution, bound(solution))
    assert honest < NET_MEAN_HEIGHT < low


def test_the_error_map_sums_to_the_gap(ring_like, scene_tables):
    solution = solve_scene(read_scene(scene_tables(support={"kind": "corners"})), ring_like)
    bounds = bound(solution)
    assert bounds.error.sum() == pytest.approx(bounds.gap, rel=1e-9)
    assert bounds.error.min() > -1e-6 * bounds.gap


def test_the_hybrid_gradient_is_exact_for_affine_fields_and_dual_to_equilibrium():
    scene = net_scene("aligned", 3)
    mesh = build_mesh(scene, None)
    disc = dual_disc(mesh)
    A = np.array([[1.3, -0.2], [0.4, 0.7]])
    assert np.allclose(gradient(disc, disc.nodes @ A.T + 3.0), A, atol=1e-12)
    # A linear stress with continuous tractions: P = [[y, x], [x, 2 y]], -div P = (0, -3)
    corners = mesh.mesh.p[:, mesh.mesh.t]  # (2, 3, n_cells)
    x, y = corners[0].ravel(), corners[1].ravel()
    P = np.stack([np.stack([y, x], axis=-1), np.stack([x, 2.0 * y], axis=-1)], axis=1)
    force = internal_force(disc, P)
    n_facets = mesh.mesh.facets.shape[1]
    area = 3.0 * disc.weight[: disc.n_cells]
    assert np.allclose(force[2 * n_facets :], area[:, None] * np.array([0.0, -3.0]), atol=1e-9)
    inner = np.setdiff1d(np.arange(n_facets), mesh.mesh.boundary_facets())
    assert np.abs(force[np.concatenate([2 * inner, 2 * inner + 1])]).max() < 1e-9
    assert np.abs(force[2 * mesh.mesh.boundary_facets()]).max() > 1.0


@pytest.mark.slow
def test_refinement_follows_the_error(ring_like, scene_tables):
    scene = read_scene(scene_tables(mesh={"cells": 4}, support={"kind": "corners"}, solver={"adapt": 2}))
    answer = solve_membrane(scene, ring_like)
    found = answer.levels
    first, second, third = (level.gap for level in found)
    assert first > second > third
    assert max(level.lower for level in found) <= min(level.upper for level in found)
    assert found[2].solution.problem.disc.n_cells < 8 * found[0].solution.problem.disc.n_cells
    assert interval_line(answer.summary).startswith("mean height of the law in [")


def test_marking_takes_the_fewest_cells():
    rng = np.random.default_rng(4)
    error = rng.exponential(size=200)
    chosen = mark(error, 0.6)
    assert error[chosen].sum() - error[chosen].min() < 0.6 * error.sum() <= error[chosen].sum()
    assert set(chosen) == set(np.argsort(-error)[: len(chosen)])
    assert len(mark(np.zeros(3))) == 0
