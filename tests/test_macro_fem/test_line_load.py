"""Line loads at points grow with the mesh; averaged over one cell of the weave they converge."""

import numpy as np
import pytest

from homogenize import default_law, diagonal_net
from macro_fem import read_scene
from macro_fem.curtain import solve_problem
from macro_fem.fem import recovered
from macro_fem.judged import Disks, Nearby, judge_line_loads, largest, largest_mean
from tests.test_macro_fem.sheets import mesh_of, posed, sheet, solve_scene

AREA = 11.0 * 12.646069623526


def solve(cells, support, law=None, side=100.0, **load):
    return solve_scene(read_scene(sheet(side, side, cells, support, load=load, areal_mass=2.785)), law or default_law())


def nearby(n, load, area):
    """Averages of the P that `load` gives at the middles of a square's triangles, n along a side of 10 mm."""
    mesh = mesh_of(10.0, 10.0, n, n)
    P = load(mesh.p.T[mesh.t.T].mean(axis=1))
    return Nearby(Disks(mesh.p.T, mesh.t.T, area), P, np.linalg.norm(P, 2, axis=(1, 2)))


@pytest.mark.parametrize("n", [2, 7, 40])
@pytest.mark.parametrize("x", [[0.0, 0.0], [5.0, 5.0], [10.0, 3.0]])
def test_an_even_load_is_its_own_average(n, x):
    P = np.array([[0.3, 0.1], [-0.2, 0.5]])
    near = nearby(n, lambda X: np.tile(P, (len(X), 1, 1)), 4.0)
    np.testing.assert_allclose(near.mean(np.array(x)), P, rtol=1e-12)
    np.testing.assert_allclose(near.bound, np.linalg.norm(P, 2), rtol=1e-12)


@pytest.mark.parametrize("away", [0.0, 0.3, 0.9])
def test_an_average_has_the_share_of_a_disk_that_a_triangle_cuts_off(away):
    """Two triangles, one with a load of 1 and one without: the segment of a disk beyond the diagonal, and no more."""
    radius = np.sqrt(4.0 / np.pi)
    near = nearby(1, lambda X: (X[:, 0] > X[:, 1])[:, None, None] * np.eye(2), 4.0)
    share = (np.arccos(away) - away * np.sqrt(1.0 - away**2)) / np.pi
    x = 5.0 + away * radius / np.sqrt(2.0) * np.array([-1.0, 1.0])
    assert near.mean(x)[0, 0] == pytest.approx(share, rel=1e-9)


@pytest.mark.parametrize(("x", "share"), [([0.0, 0.0], 0.25), ([5.0, 0.0], 0.5), ([5.0, 5.0], 1.0)])
def test_the_average_of_a_point_load_has_its_closed_form(x, share):
    """P = 1 / r over a part of a disk of radius R: 2 / R, where share pi R^2 is the area; P = y: as at its middle."""
    radius = np.sqrt(4.0 / (share * np.pi))
    point = nearby(80, lambda X: (1.0 / np.linalg.norm(X - x, axis=1))[:, None, None] * np.eye(2), 4.0)
    assert point.mean(np.array(x))[0, 0] == pytest.approx(2.0 / radius, rel=0.03)
    slope = nearby(40, lambda X: X[:, 1][:, None, None] * np.eye(2), 4.0)
    depth = {0.25: 4.0 / (3.0 * np.pi), 0.5: 4.0 / (3.0 * np.pi), 1.0: 0.0}[share] * radius
    assert slope.mean(np.array(x))[0, 0] == pytest.approx(x[1] + depth, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("support", "load"),
    [
        ({"kind": "corners"}, {}),
        ({"kind": "hooks", "pitch": 20.0}, {}),
        ({"kind": "top"}, {"point": {"at": [20.0, 20.0], "force": [0.0, -1.0]}}),
    ],
)
def test_it_converges_where_the_pointwise_value_does_not(support, load):
    coarse, fine = (solve(cells, support, side=40.0, **load) for cells in (6, 12))
    assert fine.status == "converged"
    assert largest(fine).value > 1.8 * largest(coarse).value
    means = [largest_mean(one, AREA).value for one in (coarse, fine)]
    assert means[1] == pytest.approx(means[0], rel=0.2)
    assert means[1] < 0.6 * largest(fine).value
    told = judge_line_loads(fine)
    assert told.max_line_load_over_a_cell_N_per_mm == pytest.approx(means[1], rel=1e-9)
    assert told.line_load_averaged_over_mm2 == pytest.approx(AREA)


@pytest.mark.release
def test_it_converges_at_the_corners_to_a_few_per_cent():
    """Measured: 0.0147, 0.0151, 0.0151 N/mm, where the pointwise value is 0.046, 0.069, 0.092."""
    means = [largest_mean(solve(cells, {"kind": "corners"}), AREA).value for cells in (24, 36, 48)]
    assert means[1] == pytest.approx(means[0], rel=0.05)
    assert means[2] == pytest.approx(means[1], rel=0.02)


def test_of_an_even_curtain_it_is_that_below_the_top_edge():
    """Its largest line load is the weight below the top edge, and so is the average, less half a cell of it."""
    told = judge_line_loads(solve(8, {"kind": "top"}))
    weight = 2.785e-6 * 9.81
    assert told.max_line_load_over_a_cell_N_per_mm == pytest.approx(weight * 95.0, rel=0.06)
    assert told.max_principal_line_load_at_mm[1] > 90.0


def test_a_law_without_a_cell_has_none():
    told = judge_line_loads(solve(6, {"kind": "corners", "gather": 0.9}, diagonal_net(1.1)))
    assert told.max_line_load_over_a_cell_N_per_mm is None
    assert told.line_load_averaged_over_mm2 is None


def four_in_a_rectangle(mesh):
    """The four triangles (n, 4) of each rectangle of a crossed mesh, around its middle."""
    t = mesh.mesh.t
    middles = np.flatnonzero(np.bincount(t.ravel()) == 4)
    inner = np.setdiff1d(middles, mesh.mesh.boundary_nodes())
    cells = np.array([np.flatnonzero((t == k).any(axis=0)) for k in inner])
    away = mesh.mesh.p[:, t[:, cells]].mean(axis=1) - mesh.mesh.p[:, inner][:, :, None]
    return np.take_along_axis(cells, np.argsort(np.arctan2(away[1], away[0]), axis=1), axis=1)


CHECKERBOARD = np.array([1.0, -1.0, 1.0, -1.0]) / 4.0


def crossed(cells):
    return posed(sheet(400.0, 400.0, cells, {"kind": "corners"}, {"pattern": "crossed"}, solver={"kind": "rigid"}))


def test_an_average_over_neighbours_has_no_checkerboard_and_keeps_what_is_linear():
    """Any sum of a linear field and of checkerboards, one of its own strength in each rectangle."""
    problem = crossed(6)
    mesh, rng = problem.mesh.mesh, np.random.default_rng(2)
    four = four_in_a_rectangle(problem.mesh)
    assert len(four) * 4 == mesh.t.shape[1]
    linear = mesh.p[:, mesh.t].mean(axis=1).T @ [0.3, -0.7] + 2.0
    board = np.zeros(len(linear))
    board[four] = 4.0 * CHECKERBOARD
    is_inner = ~np.isin(mesh.t, mesh.boundary_nodes()).any(axis=0)
    found = recovered(mesh.t.T, linear + board, problem.disc.cell_area)
    assert found[is_inner] == pytest.approx(linear[is_inner], rel=1e-12)
    assert np.abs(recovered(mesh.t.T, board, problem.disc.cell_area)).max() < 1e-12
    board[four] *= rng.uniform(0.5, 1.5, (len(four), 1))
    assert np.abs(recovered(mesh.t.T, board, problem.disc.cell_area)[four] @ CHECKERBOARD).max() < 0.05


def test_line_loads_of_a_crossed_mesh_have_no_checkerboard():
    """Its part of the line load, away from the hooks: a third and more in cells, below 0.5 % in what is drawn."""
    solution = solve_problem(crossed(12))
    four = four_in_a_rectangle(solution.problem.mesh)
    middle = solution.problem.mesh.mesh.p[:, solution.problem.mesh.mesh.t[:, four]].mean(axis=(1, 3))
    four = four[np.hypot(np.minimum(middle[0], 400.0 - middle[0]), 400.0 - middle[1]) > 100.0]
    cells = np.linalg.svd(solution.problem.disc.cell_mean(solution.P))[1][:, 0]
    drawn = solution.principal()[0][:, 0]

    def part(values):
        return np.linalg.norm(values[four] @ CHECKERBOARD) / np.linalg.norm(values[four].mean(axis=1))

    assert part(cells) > 0.33
    assert part(drawn) < 0.005
