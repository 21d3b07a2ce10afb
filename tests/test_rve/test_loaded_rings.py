"""Elastic locked states under a load of stated size: the first order, an independent solver, complementarity."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from rve.cli import main
from rve.equilibrium.compliance import soften
from rve.equilibrium.elastic_rings import ring_states
from rve.equilibrium.interior_point import DirectOptions, solve_equilibrium
from rve.equilibrium.loaded_rings import complementary, loaded_states
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load, green_lagrange, second_pk
from rve.geometry.pose import deformation
from rve.geometry.weave import FOUR_IN_ONE
from rve.more_columns import RingOptions, with_rings
from rve.ring.section import Ring
from rve.solve import reference_sides, solve_table
from rve.table import read_table

EQUATIONS, RING = Equations.of(FOUR_IN_ONE, 0.1), Ring(1.0, 0.1, 1.0, 0.3)
SIDES = tuple(x / 5.0 for x in reference_sides(Cell(), DirectOptions()))
WEIGHT = np.array([1.0, 2.0, 1.0])
LOADS = ([0.0, 20.0, 40.0, 10.0], [90.0, 30.0, 60.0, 15.0])


@pytest.fixture(scope="module")
def rigid():
    s = cauchy_line_load(*LOADS)
    found = solve_equilibrium(s, EQUATIONS, DirectOptions())
    F = deformation(found.pose, SIDES)
    return found, s, second_pk(F, s), green_lagrange(F), ring_states(EQUATIONS, found, s, SIDES, 0.3)


def test_halving_the_load_quarters_the_distance_from_the_first_order(rigid):
    found, _, S, E, first = rigid
    predicted = np.einsum("ni,nij,nj->n", S * WEIGHT, first.elastic, S)
    away = []
    for size in (2e-6, 1e-6, 5e-7):
        loaded = loaded_states(EQUATIONS, found, first, S, SIDES, RING, np.full(len(S), size))
        assert list(loaded.status) == ["converged"] * len(S)
        along = ((loaded.E - E) * S * WEIGHT).sum(axis=1)
        assert along == pytest.approx(size * predicted, rel=0.06)
        away.append(along - size * predicted)
    assert away[0] / away[1] == pytest.approx(np.full(len(S), 4.0), rel=0.05)
    assert away[1] / away[2] == pytest.approx(np.full(len(S), 4.0), rel=0.025)


def test_contacts_of_equal_springs_give_what_the_spring_solver_finds(rigid, monkeypatch):
    """C = 1/kappa: `soften` under a Cauchy load, and the dead load that this is in its pose."""
    found, s, _, _, first = rigid

    def springs(ends, ring, joint=None):
        return np.tile(np.eye(ends.slot.shape[1]), (len(ends.slot), 1, 1))

    monkeypatch.setattr("rve.equilibrium.loaded_rings.contact_flexibility", springs)
    for kappa in (1e4, 100.0):
        soft = soften(found, s, EQUATIONS, kappa, SIDES)
        F = deformation(soft.pose, SIDES)
        S = second_pk(F, s)
        loaded = loaded_states(EQUATIONS, found, first, S, SIDES, RING, np.full(len(s), 1.0 / kappa))
        assert (soft.status == "converged").all()
        assert pytest.approx(green_lagrange(F), abs=1e-8) == loaded.E
        assert loaded.overlap.min() > 0.1 / kappa


def test_large_loads_are_called_so(rigid):
    found, _, S, _, first = rigid
    loaded = loaded_states(EQUATIONS, found, first, S, SIDES, RING, np.array([3.2e-5, 4e-6, 4e-5, 1e-2]))
    assert list(loaded.status) == ["large", "converged", "converged", "stalled"]
    solved = loaded.status != "stalled"
    assert ((loaded.overlap[solved] > 0.1) == (loaded.status[solved] == "large")).all()
    assert np.isnan(loaded.E[~solved]).all()


def test_complementary_steps_meet_their_conditions():
    """Random convex problems: balance, no tension, no overlap, and nothing that is both open and pressed."""
    rng = np.random.default_rng(5)
    idle = 0
    for _ in range(30):
        A, B = rng.normal(size=(6, 6)), rng.normal(size=(9, 9))
        H, C = A @ A.T + 0.1 * np.eye(6), 0.1 * B @ B.T + 0.01 * np.eye(9)
        G, f, gap = rng.normal(size=(9, 6)), 3.0 * rng.normal(size=6), rng.uniform(-0.2, 0.5, 9)
        dq, lam = complementary(H, f, G, gap, C, rng.uniform(size=9) < 0.5)
        assert H @ dq == pytest.approx(f + G.T @ lam, abs=1e-9)
        open_by = gap + G @ dq + C @ lam
        assert lam.min() >= 0.0
        assert open_by.min() > -1e-9
        assert np.abs(lam * open_by).max() < 1e-9
        idle += np.count_nonzero(lam == 0.0)
    assert 0 < idle < 270


def test_table_columns_follow_load_material_and_grain():
    cell = Cell()
    table = solve_table(cell, LOADS)
    one = with_rings(table, cell, RingOptions(load_N_per_mm=1.0))
    S = one.S / (one.S[:, 0] + one.S[:, 2])[:, None]
    first = np.einsum("ni,nij,nj->n", S * WEIGHT, one.compliance, S)
    assert ((one.loaded - one.E) * S * WEIGHT).sum(axis=1) == pytest.approx(first, rel=0.03)
    softer = with_rings(table, cell, RingOptions(load_N_per_mm=1.0, hertz=True))
    assert (((softer.loaded - one.loaded) * S * WEIGHT).sum(axis=1) > 0.0).all()
    butted = with_rings(table, cell, RingOptions(load_N_per_mm=0.1, joint="butted:90"))
    along = np.einsum("ni,nij,nj->n", S * WEIGHT, butted.compliance, S)
    assert 10.0 * ((butted.loaded - one.E) * S * WEIGHT).sum(axis=1) == pytest.approx(along, rel=0.05)
    turned = Cell(grain="x")
    swapped = with_rings(solve_table(turned, ([70.0], [30.0])), turned, RingOptions(load_N_per_mm=1.0))
    assert swapped.loaded[0] == pytest.approx(one.loaded[1, ::-1], abs=1e-7)


def test_the_command_writes_and_says_what_the_load_does(tmp_path):
    words = ["table", "--out", str(tmp_path / "t.csv"), "--alpha", "0,15", "--beta", "0,90", "--rings"]
    result = CliRunner().invoke(main, [*words, "--load", "2.5"])
    assert result.exit_code == 0, result.output
    assert "strains at 2.5 N/mm are those of 3 rows" in result.output
    assert "would have yielded before: choose a smaller load" in result.output
    table = read_table(tmp_path / "t.csv")
    assert np.isnan(table.loaded[~table.unique]).all()
    assert np.isfinite(table.loaded[table.unique]).all()
    known = json.loads((tmp_path / "t.json").read_text())["loaded"]
    assert (known["S11_plus_S22_N_per_mm"], known["rows"], known["hertz"]) == (2.5, {"converged": 3}, False)
    refused = CliRunner().invoke(main, [*words, "--load", "0"])
    assert (refused.exit_code, "--load = 0.0: must be at least" in refused.stderr) == (2, True)
    alone = CliRunner().invoke(main, [*words, "--hertz"])
    assert (alone.exit_code, "give --load" in alone.stderr) == (2, True)
