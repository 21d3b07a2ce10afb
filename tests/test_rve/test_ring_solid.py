"""Rings as curved beams against three-dimensional finite elements of the torus."""

import pytest

from tests.test_rve.ring_solid import compared


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [5.0, 10.0, 20.0])
def test_curved_beams_are_within_two_per_cent_of_a_solid_torus(ratio):
    rows, stress = compared(ratio)
    assert len(rows) == 3
    for row in rows:
        assert row.curved == pytest.approx(1.0, abs=0.02), row.case
        assert abs(row.thin - 1.0) > abs(row.curved - 1.0) or ratio == 20.0
    for solid, beam in stress.values():  # sections of thick wire do not stay plane on the inside: 2.1 % at r1/r2 = 5
        assert beam == pytest.approx(solid, rel=0.03 if ratio == 5.0 else 0.015)
