"""The rings of the report: one problem for all methods, a reference that two agree on, ladders that fall."""

import numpy as np
import pytest

from benchmarks.work_precision.generic import Programme, slsqp
from benchmarks.work_precision.rve import ERROR, extrapolated, problem, runs
from rve.geometry import deformation, second_pk

LOADS = ((0.0, 45.0), (20.0, 30.0))


@pytest.fixture(scope="module")
def given():
    return problem(LOADS)


def programme(given, case):
    F = deformation(given.found.pose, given.sides)
    S = second_pk(F, given.s) * given.sides[0] * given.sides[1]
    return Programme(S[case], given.equations, given.sides)


@pytest.mark.slow
def test_the_reference_is_agreed_by_the_scheme(given):
    """The scheme extrapolated to rigid contact shares only the contact search with the direct solver."""
    assert (given.found.status == "converged").all()
    soft, stiff = runs(given, "", "steps", extrapolated, {"soft": 1e4, "stiff": 1e5})
    assert soft["solved"] == stiff["solved"] == f"{len(LOADS)} of {len(LOADS)}"
    assert stiff[ERROR] < 5e-9
    assert stiff[ERROR] < 0.05 * soft[ERROR]  # second order in 1/k


@pytest.mark.parametrize("case", range(len(LOADS)))
def test_the_programme_is_the_same_cell_and_load(given, case):
    """In its chart: the answer's strain, gaps that are closed or open, derivatives, and a loss that nothing beats."""
    other = programme(given, case)
    q = other.coordinates(given.found.pose, case)
    np.testing.assert_allclose(other.strain(q)[0], given.E[case], atol=1e-12)
    gap, slope = other.gaps(q)
    assert abs(gap.min()) < 1e-10
    assert (gap < 1e-8).sum() >= 4
    step = 1e-6 * np.random.default_rng(case).normal(size=9)
    smooth = gap < 0.5  # far pairs may have no isolated minimum
    ahead, behind = other.gaps(q + step)[0], other.gaps(q - step)[0]
    np.testing.assert_allclose((ahead - behind)[smooth], 2.0 * (slope @ step)[smooth], atol=2e-10)
    assert other.loss(q + step) - other.loss(q - step) == pytest.approx(2.0 * other.slope(q) @ step, abs=1e-11)
    found = slsqp(other, q + 1e-3, 1e-14)
    assert other.loss(found) == pytest.approx(other.loss(q), abs=1e-7)
