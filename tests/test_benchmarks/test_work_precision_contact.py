"""The contact search of the report: a reference that shares nothing with ours, scores that see what is missed."""

import pytest

from benchmarks.work_precision.contact import degenerate_pairs, golden_section, newton, random_pairs, score


@pytest.fixture(scope="module")
def pairs():
    return random_pairs(150)


@pytest.fixture(scope="module")
def reference(pairs):
    return golden_section(pairs)


def test_newton_and_golden_sections_agree(pairs, reference):
    got = score(newton(pairs), reference)
    assert got.all > 200
    assert got.missed <= 1
    assert got.wrong == got.deepest == 0
    assert got.error < 1e-12


DISTANCE = {
    "coaxial": 0.7,
    "identical": 0.0,
    "coplanar, apart": 0.5,
    "parallel planes, crossing projections": 0.3,
    "perpendicular through the centre": 0.0,
    "perpendicular and taut": 0.2,
    "just before two minima part": 0.2,
    "about to slip out": 1e-6,
}


@pytest.mark.parametrize("name", degenerate_pairs())
def test_degenerate_pairs_have_the_minima_that_are_claimed(name):
    pair, count = degenerate_pairs()[name]
    found = newton(pair)
    assert len(found.distance) == count
    lowest = golden_section(pair, 20001).distance.min()
    assert found.distance.min() == pytest.approx(lowest, abs=1e-10)  # golden section ends at 1e-12
    if name in DISTANCE:
        assert lowest == pytest.approx(DISTANCE[name], abs=1e-9)
