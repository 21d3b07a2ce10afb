"""The parts behind the report of every ring: geometry, edge loads, cells in space, starts; and its quick form."""

import numpy as np
import pytest

from benchmarks.every_ring import growth, starts
from benchmarks.every_ring.brute import least_gap, linked_pairs, minima
from benchmarks.every_ring.cases import SHEETS, Case, kept
from benchmarks.every_ring.cell import cell_strains, depths, edge_forces
from benchmarks.every_ring.disk import HEIGHT, fitted, rule_table, worst_from
from benchmarks.every_ring.starts import random_start
from macro_fem.rings.ring_scene import ring_scene
from rve import Cell, FiniteMesh


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
        case = kept(tmp_path, "one", asked, make)
        assert case.numbers == {"n": count}
        assert case.arrays["x"].tolist() == [0.0, 1.0, 2.0]
    assert len(made) == 2


def test_the_rule_is_the_worst_of_the_rows():
    row = {"scene": "corners", "status": "converged", "centres": "space", "cells across": 8, HEIGHT: -3.0}
    more = [row | {"cells across": 16, HEIGHT: 1.0}, row | {"status": "stalled", HEIGHT: 90.0}]
    rows = [row, *more, row | {"scene": "pull", HEIGHT: 5.0}, row | {"centres": "plane", HEIGHT: 70.0}]
    assert worst_from(rows, 9, False) == 1.0
    assert rule_table(rows).rows == (("8", "3.00", "5.00"), ("16", "1.00", "-"))


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


@pytest.mark.slow
def test_generic_solver_finds_our_potential():
    pytest.importorskip("casadi")
    from benchmarks.every_ring.generic import DIFFERENCE, compared

    row = compared("top", False)
    assert row["links of IPOPT intact"]
    assert abs(row[DIFFERENCE]) < 1e-6
    assert row["least gap of IPOPT, r1"] > -1e-6


@pytest.mark.slow
def test_a_section_goes_on_where_it_was(tmp_path):
    first = starts.measure(False, tmp_path)
    assert "3 of 3 runs" in first.conclusion
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert starts.measure(False, tmp_path) == first
    assert before == {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
