"""The parts behind the report of every ring: geometry, edge loads, cells in space, starts; and its quick form."""

import json
from functools import partial

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.every_ring import growth
from benchmarks.every_ring.__main__ import NAMES, main
from benchmarks.every_ring.brute import least_gap, linked_pairs, minima
from benchmarks.every_ring.cases import SHEETS, Case, Store, kept, those_there
from benchmarks.every_ring.cell import cell_strains, depths, edge_forces
from benchmarks.every_ring.disk import HEIGHT, fitted, rule_table, worst_from
from benchmarks.every_ring.edges import distances
from benchmarks.every_ring.leaving import locked_cell, slack_cell
from benchmarks.every_ring.space_cell import climb
from benchmarks.every_ring.starts import random_start
from macro_fem.every_ring import ring_scene
from rve import Cell, FiniteMesh, support
from rve.geometry.weave import FOUR_IN_ONE


def test_brute_force_knows_two_circles():
    centre = np.array([[0.0, 0.0, 0.0], [1.8, 0.0, 0.0], [4.2, 0.0, 0.0]])
    normal = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    first, far = minima(centre, normal, np.array([[0, 1], [1, 2]]), 1.0)
    assert first[:, 1].min() == pytest.approx(0.2)
    assert far[:, 1].min() == pytest.approx(0.4)
    assert linked_pairs(centre, normal, 1.0) == {(0, 1)}
    assert least_gap(centre, normal, 1.0, 0.05) == pytest.approx(0.1)


def test_brute_force_finds_the_links_of_the_weave():
    mesh = FiniteMesh.rectangle(Cell(), 2, 2)
    centre, normal = mesh.slack()
    assert linked_pairs(centre, normal, 5.0) == {(int(a), int(b)) for a, b in mesh.linked}


def test_edge_forces_are_those_of_the_line_load():
    mesh = FiniteMesh.rectangle(Cell(), 4, 3)
    P = np.array([[1.0, 0.3], [-0.2, 2.0]])
    force = edge_forces(mesh, P)
    area = np.ptp(mesh.X, axis=0).prod()
    assert np.abs(force.sum(axis=0)).max() < 1e-9
    assert pytest.approx(force.T @ mesh.X / area) == P


def test_strains_of_cells_are_those_of_an_even_deformation():
    mesh = FiniteMesh.rectangle(Cell(), 4, 3)
    F = np.array([[1.1, 0.2], [-0.1, 0.9]])
    E = cell_strains(mesh, mesh.X @ F.T)
    exact = 0.5 * (F.T @ F - np.eye(2))
    assert E.shape == (4, 3, 3)
    assert np.allclose(E, exact[[0, 0, 1], [0, 1, 1]])
    assert depths((4, 3)).tolist() == [[0, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, 0]]


@pytest.fixture(scope="module")
def planar():
    return support(Cell(), [[0.5, 0.0, 0.5]])


def test_a_cell_in_space_has_the_derivatives_of_differences():
    cell = slack_cell(FOUR_IN_ONE, 10.0, 1)
    rng = np.random.default_rng(1)
    cell = cell.moved(0.05 * rng.standard_normal(13))
    way, step, sides, S = rng.standard_normal(13), 1e-6, np.array([2.2, 2.5]), np.array([0.6, 0.2, 0.4])
    fore, aft = (cell.moved(sign * step * way) for sign in (1.0, -1.0))
    now, one, other = (part.minima() for part in (cell, fore, aft))
    rate = (one.distance - other.distance) / (2.0 * step)
    assert len(rate) > 3
    assert np.allclose(cell.gradient(now) @ way, rate, atol=1e-6)
    slope = cell.work(S, sides)[1]
    assert (fore.work(S, sides)[0] - aft.work(S, sides)[0]) / (2.0 * step) == pytest.approx(slope @ way[:3], abs=1e-7)


def test_a_cell_in_space_climbs_to_the_planar_state(planar):
    sides = np.array([planar.b_x_mm, planar.b_y_mm]) / 5.0
    start = slack_cell(FOUR_IN_ONE, 10.0, 1)
    start.centres[1, 2] = 0.05
    found = climb(start, np.array([0.5, 0.0, 0.5]), sides)
    assert found.work == pytest.approx(float(planar.h[0]), abs=1e-6)
    assert found.overlap < 1e-9
    assert found.depth < 1e-3


def test_copies_of_the_locked_cell_do_its_work(planar):
    sides = 2.0 * np.array([planar.b_x_mm, planar.b_y_mm]) / 5.0
    cell = locked_cell(FOUR_IN_ONE, 10.0, 2, planar, 0)
    assert cell.links_intact()
    assert cell.minima().distance.min() > 0.2 - 1e-8
    assert cell.work(np.array([0.5, 0.0, 0.5]), sides)[0] == pytest.approx(float(planar.h[0]))


def test_random_starts_are_admissible_and_differ():
    rings = ring_scene(SHEETS[0].scene(1, 4))
    woven = {(int(a), int(b)) for a, b in rings.mesh.linked}
    first, second = (random_start(rings, True, seed) for seed in (1, 2))
    for placed in (first, second):
        assert least_gap(placed.x, placed.normal, 1.0, 0.1) > 0.0
        assert linked_pairs(placed.x, placed.normal, 1.0) == woven
    assert np.abs(first.x - second.x).max() > 0.1


def test_sheets_are_similar_and_their_loads_grow_with_the_weight():
    for sheet in SHEETS[2:]:
        small, large = (ring_scene(sheet.scene(k, 4)) for k in (1, 2))
        assert large.mesh.area.sum() == pytest.approx(4.0 * small.mesh.area.sum(), rel=1e-6)
        assert large.force.sum(axis=0) == pytest.approx(4.0 * small.force.sum(axis=0), rel=1e-6)
        assert -small.force[:, 1].sum() == pytest.approx(sheet.weight(1), rel=1e-6)


def test_a_case_is_made_once_and_again_when_asked_otherwise(tmp_path):
    made = []

    def make():
        made.append(1)
        return Case({"n": len(made)}, {"x": np.arange(3.0)})

    for asked, count in (({"k": 1}, 1), ({"k": 1}, 1), ({"k": (2,)}, 2), ({"k": [2]}, 2)):
        case = kept(Store(tmp_path), "one", asked, make)
        assert case.numbers == {"n": count}
        assert case.arrays["x"].tolist() == [0.0, 1.0, 2.0]
    closed = Store(tmp_path, is_closed=True)
    calls = [partial(kept, closed, name, {"k": [2]}, make) for name in ("one", "other")]
    assert [case.numbers["n"] for case in those_there(calls)] == [2]
    assert len(made) == 2


def test_the_rule_is_the_worst_of_the_rows():
    row = {"scene": "corners", "status": "converged", "centres": "space", "cells across": 8, HEIGHT: -3.0}
    more = [row | {"cells across": 16, HEIGHT: 1.0}, row | {"status": "stalled", HEIGHT: 90.0}]
    rows = [row, *more, row | {"scene": "pull", HEIGHT: 5.0}, row | {"centres": "plane", HEIGHT: 70.0}]
    assert worst_from(rows, 9, False) == 1.0
    assert rule_table(rows).rows == ((8, 3.0, 5.0), (16, 1.0, None))


def test_the_limit_of_many_rings():
    N = np.array([8.0, 12.0, 16.0, 24.0])
    limit, error = fitted(N, 1.0 - 3.0 / N + 0.01 * np.array([1.0, -1.0, 1.0, -1.0]))
    assert abs(limit - 1.0) < 3.0 * error < 0.1


def test_growth_reports_work_and_memory_of_a_process_of_its_own():
    row = growth._alone(1, False, "slack")
    assert (row["rings"], row["centres"], row["status"], row["links intact"]) == (5, "plane", "converged", True)
    assert row["factors"] >= row["iterations"] > 10
    assert row["KKT residual"] < 1e-8
    assert 20.0 < row["MB"] < 1000.0


def test_distances_count_rings():
    mesh = FiniteMesh.rectangle(Cell(), 8, 6)
    zero = np.zeros((len(mesh.X), 3))
    held = zero.copy()
    held[mesh.X.argmax(axis=0)] = 1.0
    load = zero - mesh.area[:, None] * [0.0, 1.0, 0.0]
    case = Case({}, {"X": mesh.X, "area": mesh.area, "load": load, "reaction": held})
    points, edges = distances(case)
    step = np.sqrt(np.prod(mesh.sides) / 2.0)
    middle = np.linalg.norm(mesh.X - mesh.X.mean(axis=0), axis=1).argmin()
    assert edges[middle] == pytest.approx(3 * mesh.sides[1] / step)
    assert points.min() == 0.0


@pytest.mark.slow
def test_generic_solver_finds_our_potential():
    pytest.importorskip("casadi")
    from benchmarks.every_ring.generic import DIFFERENCE, compared

    row = compared("top", False)
    assert row["links of IPOPT intact"]
    assert abs(row[DIFFERENCE]) < 1e-6
    assert row["least gap of IPOPT, r1"] > -1e-6


@pytest.mark.slow
def test_quick_report_goes_on_where_it_was(tmp_path):
    arguments = ["--quick", "--only", "loose", "--only", "starts", "--out", str(tmp_path / "out"), "--cases"]
    done = CliRunner().invoke(main, [*arguments, str(tmp_path / "cases")])
    assert done.exit_code == 0, done.output
    report = json.loads((tmp_path / "out" / "every_ring.json").read_text())
    assert {section["key"] for section in report["sections"]} == {"loose", "starts"}
    assert {"loose", "starts", "disk", "edges", "cell", "generic", "engine", "leaving", "growth"} == set(NAMES)
    starts = next(section for section in report["sections"] if section["key"] == "starts")
    assert "3 of 3 runs" in starts["conclusion"]
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "cases").iterdir()}
    assert CliRunner().invoke(main, [*arguments, str(tmp_path / "cases")]).exit_code == 0
    assert before == {path: path.stat().st_mtime_ns for path in (tmp_path / "cases").iterdir()}


@pytest.mark.slow
def test_a_physics_engine_hangs_the_same_sheet():
    pytest.importorskip("mujoco")
    from benchmarks.every_ring.engine import DIFFERENCE, compared

    row = compared(0, 1, False, 24)
    assert row["MuJoCo"] == "at rest"
    assert row["links of MuJoCo intact"]
    assert abs(row[DIFFERENCE]) < 0.3
    assert row["least gap of MuJoCo, r1"] > -0.02
