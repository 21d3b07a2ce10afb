"""Published chains beside strings: elongation within 5 %, the pitch and the circles around wires in closed form."""

import numpy as np
import pytest

from benchmarks.chains import BUNDLE, CHAINS, WIRE, chain_row
from rve import Material, pulled_ring


def test_circles_around_equal_circles_have_their_closed_forms():
    exact = {3: 1.0 + 2.0 / 3.0**0.5, 4: 1.0 + 2.0**0.5, 5: 1.0 + 1.0 / np.sin(np.pi / 5.0), 7: 3.0}
    exact |= {9: 1.0 + 1.0 / np.sin(np.pi / 8.0), 19: 1.0 + 2.0**0.5 + 6.0**0.5}
    assert all(BUNDLE[n] == pytest.approx(radius, abs=1e-4) for n, radius in exact.items())
    assert {windings for _, windings, *_ in CHAINS} == set(BUNDLE)


@pytest.mark.slow
@pytest.mark.parametrize("chain", CHAINS)
def test_chains_lengthen_as_in_the_tests(chain):
    wire, windings, _, elongation = chain
    row, r2 = chain_row(*chain), BUNDLE[windings] * 0.5 * wire
    assert row["strings, mm"] == pytest.approx(3.0 * (np.pi - 2.0) * (150.0 - r2), rel=1e-7)
    assert abs(row["strings, mm"] / elongation - 1.0) < 0.05
    assert row["without thickness"] == pytest.approx(3.0 * (np.pi / 2.0 - 1.0) * 300.0 / elongation - 1.0)
    assert row["in the band"] == (0.30 <= row["over 2 A sigma"] <= 0.56)


def test_rupture_is_a_band_of_twice_the_wire_and_none_where_nothing_is_known():
    low, high = pulled_ring(150.0, 1.5, WIRE).rupture_N
    assert (low, high) == pytest.approx([share * 2.0 * np.pi * 1.5**2 * 1770.0 for share in (0.30, 0.56)])
    soft = Material(yield_N_per_mm2=235.0, ultimate_N_per_mm2=None)
    assert pulled_ring(5.0, 0.5, soft).rupture_N is None
    assert pulled_ring(5.0, 0.5, joint="butted").rupture_N is None
    ring = pulled_ring(5.0, 0.5)
    assert ring.rupture_N[0] > ring.collapse_N
