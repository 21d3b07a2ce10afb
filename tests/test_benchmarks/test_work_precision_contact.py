"""The contact search of the report: a reference that shares nothing with ours, scores that see what is missed."""

import pytest

from benchmarks.work_precision.contact import (
    brute_force,
    degenerate_pairs,
    golden_section,
    newton,
    projection,
    random_pairs,
    score,
)


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


def test_brute_force_is_of_second_order(pairs, reference):
    errors = [score(brute_force(pairs, n), reference).error for n in (256, 1024, 4096)]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.6)
    assert errors[1] / errors[2] == pytest.approx(16.0, rel=0.6)


def test_projection_converges_but_misses(pairs, reference):
    few, many = (score(projection(pairs, n), reference) for n in (5, 400))
    assert many.error < 1e-3 * few.error
    assert many.missed > 2
    assert many.missed <= few.missed


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
