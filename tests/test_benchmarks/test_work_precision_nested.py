"""The nested scheme of the report: its answer is that of the rings on its mesh, between the laws of any table."""

import numpy as np
import pytest

from benchmarks.work_precision.nested import answered
from homogenize import read_law_interval
from rve import Cell


@pytest.mark.slow
def test_rows_are_joined_with_the_largest_work_that_is_known():
    first = answered(Cell(), np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]]), None)
    both = answered(Cell(), np.array([[0.5, 0.5]]), first)
    assert len(both) == 5
    np.testing.assert_array_equal(both.E[:4], first.E)
    known = read_law_interval()
    assert (both.h <= known.outer.support(both.S) + 1e-9).all()
    assert (both.h >= known.inner.support(both.S) - 2e-5).all()
