"""Locked states that come with a table: what they hold, and that nothing which needs them solves again."""

from dataclasses import replace

import numpy as np
import pytest

from rve import (
    WEAVES,
    Cell,
    DirectOptions,
    InputError,
    NotConverged,
    grid,
    read_table,
    solve_table,
    support,
    with_rings,
)
from rve.geometry import FOUR_IN_ONE, cauchy_line_load, supercell, tiled, unlisted_gap
from rve.locking import Equations
from rve.locking.dead_load import ways_down
from rve.placed import central_forces, largest_forces
from rve.solve import locked_states

LOADS = np.array([20.0, 45.0, 10.0, 25.0]), np.array([30.0, 60.0, 95.0, 0.0])


@pytest.fixture(scope="module")
def table():
    return solve_table(Cell(), LOADS)


def test_states_are_those_of_the_rows(table):
    """The forces of every state balance its load, and their virial is the line load: two ways to one number."""
    states, good = table.states, np.flatnonzero(table.converged)
    assert states.unique.tolist() == table.unique.tolist() == [True, True, True, False]
    part, s = states.found.take(good), states.s[good]
    system = Equations.of(states.cell.weave, states.cell.wire).assemble(part.pose, part.contacts, part.lam, s)
    assert system.weighted_residual.max() < 1e-9
    np.testing.assert_allclose(part.pose.a1 * 5.0, table.x2_mm[good], atol=1e-12)
    np.testing.assert_allclose(part.contacts.min_gap * 5.0, table.quality.min_gap_mm[good], atol=1e-15)
    assert part.lam[~part.contacts.present].max() == 0.0


@pytest.mark.slow
def test_rings_are_those_of_a_table_from_a_file(table, tmp_path):
    rings = with_rings(table, Cell())
    assert np.isfinite(rings.strength).all(axis=1).tolist() == [True, True, False, True]
    table.save(tmp_path / "t.csv")
    again = with_rings(read_table(tmp_path / "t.csv"), Cell())
    assert again.strength == pytest.approx(rings.strength, rel=1e-3, nan_ok=True)
    assert again.compliance == pytest.approx(rings.compliance, rel=1e-6, abs=1e-9, nan_ok=True)
    rings.save(tmp_path / "rings.csv")
    read = read_table(tmp_path / "rings.csv")
    assert np.array_equal(read.strength, rings.strength, equal_nan=True)


@pytest.mark.parametrize("cell", [Cell(10.0, 1.0), Cell(grain="x"), Cell(material="titanium grade 2")])
def test_rings_of_another_cell_are_refused(table, cell):
    with pytest.raises(InputError, match="give the table's cell"):
        with_rings(table, cell)


def test_rings_that_overlap_and_are_not_listed_as_a_pair_have_no_answer():
    """A weave that forgets its side neighbours needs them under the second load, and in its reference cell."""
    kept = np.array([a != b or (i, j) not in ((1, 0), (1, 1), (1, -1)) for a, b, i, j in FOUR_IN_ONE.pairs.tolist()])
    forgetful = Cell(weave=replace(FOUR_IN_ONE, pairs=FOUR_IN_ONE.pairs[kept], linked=FOUR_IN_ONE.linked[kept]))
    states = locked_states(np.array([0.0, 10.0]), np.array([45.0, 80.0]), forgetful, DirectOptions())
    assert states.found.status.tolist() == ["converged", "unlisted"]
    with pytest.raises(NotConverged, match="list more pairs"):
        support(forgetful, [1.0, 0.0, 0.0])


QUICK = ("4-in-1", "6-in-1")
"""Weaves of two rings in near reach."""


# The others take up to 120 s of processor time each, cells of eight rings and thin wire most.
@pytest.mark.parametrize(
    ("name", "thinner"),
    [
        pytest.param(name, thinner, marks=[] if name in QUICK and thinner < 16.0 else pytest.mark.release)
        for name in WEAVES
        for thinner in (1.03, 3.0, 16.0)
    ],
)
def test_weaves_list_all_pairs_of_rings_that_touch(name, thinner):
    ratio = thinner * WEAVES[name].jamming_ratio
    states = solve_table(Cell(5.0, 5.0 / ratio, name), grid(15.0, WEAVES[name]), DirectOptions(branches="first")).states
    assert unlisted_gap(states.pose, states.cell.weave, 1.0 / ratio).min() > 0.01


@pytest.mark.slow
def test_a_load_goes_on_beside_a_balance_that_gives_way():
    """Small rings of a Japanese weave that is pulled askew buckle to either side: the path from the slack pose ends
    between both, where Newton's method hardly gets on."""
    cell = Cell(5.0, 5.0 / 6.18, "japanese-4-in-1")
    table = solve_table(cell, ([45.0, 45.0, 30.0], [0.0, 90.0, 0.0]), DirectOptions(branches="first"))
    assert table.converged.all()
    assert table.quality.iterations.max() < 400
    np.testing.assert_allclose(table.E[1], table.E[0] * [1, -1, 1], atol=1e-9)
    assert table.E[0, 1] > 0.4  # 0.256 where small rings stay upright
    found, equations = table.states.found, Equations.of(cell.weave, cell.wire)
    assert not len(ways_down(found, table.states.s, equations, 1)[0])


ANGLES = np.array([0.0, 0.0, 20.0, 45.0, 70.0]), np.array([45.0, 20.0, 30.0, 10.0, 35.0])


@pytest.mark.parametrize(("weave", "ratio"), [("4-in-1", 10.0), ("6-in-1", 8.0)])
def test_forces_that_are_shown_balance_every_ring_across_the_plane_too(weave, ratio):
    cell = Cell(ratio, 1.0, weave=WEAVES[weave])
    states = locked_states([20.0, 45.0, 35.0], [30.0, 60.0, 70.0], cell, DirectOptions())
    space = supercell(cell.weave, 1, 1, "space")
    equations, pose = Equations.of(space, cell.wire), tiled(states.pose, space)
    system = equations.assemble(pose, states.found.contacts, central_forces(states), states.s)
    assert np.abs(system.r).max() < 1e-9


def test_forces_in_blocks_are_those_of_each_load(monkeypatch):
    """Loads twice as large give twice the force; what hangs slack carries none."""
    cell = Cell()
    size = np.array([1.0, 0.0, 0.3, 2.0, 5.0])
    s = size[:, None] * cauchy_line_load(ANGLES[0], ANGLES[1])
    alone = np.vstack([largest_forces(one[None], cell) for one in s])
    monkeypatch.setattr("rve.solve.BLOCK", 2)
    together = largest_forces(s, cell)
    np.testing.assert_allclose(together, alone, rtol=1e-6)
    assert (together[1] == 0.0).all()
    assert (together[[0, 2, 3, 4]] > 0.0).all()
    np.testing.assert_allclose(largest_forces(2.0 * s, cell), 2.0 * together, rtol=1e-6)
    # rings twice as large carry the same line loads over twice the length
    np.testing.assert_allclose(largest_forces(s, Cell(2.0 * cell.r1, 2.0 * cell.r2)), 2.0 * together, rtol=1e-6)
    assert largest_forces(np.zeros((2, 3)), cell) == pytest.approx(np.zeros((2, cell.weave.classes)))
