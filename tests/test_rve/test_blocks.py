"""Long jobs are solved in blocks: the answers are those of each case alone, in the order that was asked for."""

import numpy as np
import pytest

from rve import solve as sweep
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load
from rve.solve import solve_table
from rve.strained.forces import largest_forces

ALPHA, BETA = np.array([0.0, 0.0, 20.0, 45.0, 70.0]), np.array([45.0, 20.0, 30.0, 10.0, 35.0])


def test_a_table_in_blocks_is_that_of_its_rows(monkeypatch):
    alone = [solve_table(Cell(), ([a], [b])) for a, b in zip(ALPHA, BETA, strict=True)]
    monkeypatch.setattr(sweep, "BLOCK", 2)
    table = solve_table(Cell(), (ALPHA, BETA))
    assert len(table.E) == 5
    np.testing.assert_allclose(table.E, np.vstack([one.E for one in alone]), atol=1e-9)
    np.testing.assert_allclose(table.alpha_deg, ALPHA)
    assert (table.status == "converged").all()


def test_forces_in_blocks_are_those_of_each_load(monkeypatch):
    """Loads twice as large give twice the force; what hangs slack carries none."""
    cell = Cell()
    size = np.array([1.0, 0.0, 0.3, 2.0, 5.0])
    s = size[:, None] * cauchy_line_load(ALPHA, BETA)
    alone = np.vstack([largest_forces(one[None], cell) for one in s])
    monkeypatch.setattr(sweep, "BLOCK", 2)
    together = largest_forces(s, cell)
    np.testing.assert_allclose(together, alone, rtol=1e-6)
    assert (together[1] == 0.0).all()
    assert (together[[0, 2, 3, 4]] > 0.0).all()
    np.testing.assert_allclose(largest_forces(2.0 * s, cell), 2.0 * together, rtol=1e-6)
    # rings twice as large carry the same line loads over twice the length
    np.testing.assert_allclose(largest_forces(s, Cell(2.0 * cell.r1, 2.0 * cell.r2)), 2.0 * together, rtol=1e-6)
    assert largest_forces(np.zeros((2, 3)), cell) == pytest.approx(np.zeros((2, cell.weave.classes)))
