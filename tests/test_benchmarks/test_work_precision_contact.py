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


def test_degenerate_pairs_have_the_minima_that_are_claimed():
    for name, (pair, count) in degenerate_pairs().items():
        found = newton(pair)
        assert len(found.distance) == count, name
        lowest = golden_section(pair, samples=20001).distance.min()
        assert found.distance.min() == pytest.approx(lowest, abs=1e-10), name  # golden section ends at 1e-12
