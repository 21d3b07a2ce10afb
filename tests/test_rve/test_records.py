"""Records are never written in place."""

from dataclasses import replace

import numpy as np

from rve import Cell, StrainTable, solve_table, with_rings
from rve.common import Rows
from rve.geometry import FOUR_IN_ONE, cauchy_line_load, start_pose
from rve.locking import Equations, solve_equilibrium


def frozen(record):
    """The record, all of its arrays write-protected."""
    for value in vars(record).values():
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
        elif isinstance(value, Rows | StrainTable):
            frozen(value)
    return record


def test_records_are_not_written_in_place():
    start = frozen(start_pose(FOUR_IN_ONE, 2))
    found = solve_equilibrium(cauchy_line_load([20.0, 0.0], [30.0, 45.0]), Equations.of(FOUR_IN_ONE, 0.1), start=start)
    assert (found.status == "converged").all()
    table = solve_table(Cell(), ([20.0, 25.0], [30.0, 0.0]))
    table = frozen(replace(table, states=frozen(table.states)))
    assert np.isfinite(with_rings(table, Cell()).compliance[0]).all()
    put = table.states.put(np.array([1]), table.states.take(np.array([0])))
    np.testing.assert_array_equal(put.pose.lattice[1], table.states.pose.lattice[0])
    assert not np.array_equal(table.states.pose.lattice[1], table.states.pose.lattice[0])
