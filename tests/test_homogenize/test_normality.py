"""Normality of rows: two locked strains under one load, a little apart, on both sides of the tolerance."""

import numpy as np
import pytest

from homogenize.fitting.rows import LockedRows, normality
from rve.common.tensor import double_dot


def two_rows(apart):
    """The load (1/2, 0, 1/2) with two strains whose work S:E differs by `apart`."""
    S = np.array([[0.5, 0.0, 0.5], [0.5, 0.0, 0.5]])
    E = np.array([[0.1, 0.0, 0.1], [0.1, 0.0, 0.1]])
    E[1, [0, 2]] += apart
    return LockedRows(S, E, double_dot(S, E), np.ones(2, bool), np.arange(2))


@pytest.mark.parametrize("apart", [1e-12, 3e-9])
def test_what_solvers_leave_is_forgiven(apart):
    found = normality(two_rows(apart))
    assert found.holds
    assert found.slack == pytest.approx(-apart, rel=1e-3, abs=1e-16)


@pytest.mark.parametrize("apart", [3e-8, 1e-6, 1e-2])
def test_a_table_that_contradicts_itself_by_more_is_not_normal(apart):
    found = normality(two_rows(apart))
    assert not found.holds
    assert found.slack == pytest.approx(-apart, rel=1e-3)
    assert normality(two_rows(apart), 2.0 * apart).holds
    assert not normality(two_rows(apart), 0.5 * apart).holds
