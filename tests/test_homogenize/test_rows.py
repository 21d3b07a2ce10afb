"""Rows of sound, spoilt, noisy and doubled tables: what is kept, what is dropped, and who is blamed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from homogenize.fitting import inner_law, normality, outer_law, random_loads, rows_from_table
from homogenize.laws import LockedRows, with_mirror
from rve import InputError
from rve.common import double_dot, mirror

from .conftest import Ellipsoid, disc_grid, rows_of, table_of


@pytest.fixture
def rows(ellipsoid):
    return rows_of(ellipsoid, disc_grid(4, 12))


def test_a_convex_set_passes(rows):
    found = normality(rows)
    assert found.holds
    assert found.slack > -1e-13  # round-off of S:E
    assert found.blamed == ()
    assert "holds" in found.sentence()


@pytest.mark.parametrize("apart", [1e-12, 3e-9, 3e-8, 1e-6, 1e-2])
def test_two_strains_of_one_load_may_differ_by_what_solvers_leave(apart):
    """Twice the load (1/2, 0, 1/2) with strains whose work S:E differs by `apart`."""
    S, E = np.tile([0.5, 0.0, 0.5], (2, 1)), np.array([[0.1, 0.0, 0.1], [0.1 + apart, 0.0, 0.1 + apart]])
    rows = LockedRows(S, E, double_dot(S, E), np.ones(2, bool), np.arange(2))
    assert normality(rows).holds == (apart < 1e-8)
    assert normality(rows).slack == pytest.approx(-apart, rel=1e-3, abs=1e-16)
    assert normality(rows, 2.0 * apart).holds
    assert not normality(rows, 0.5 * apart).holds


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 27), st.floats(0.05, 0.3))
def test_one_outlier_is_named(row, size):
    S = disc_grid(4, 12)
    rows = rows_of(Ellipsoid(), S[S[:, 1] >= -1e-12])  # one half: a row and its twin contradict each other equally
    E = rows.E.copy()
    E[row] += size * np.array([1.0, 0.0, 1.0])  # beyond the surface along every tensile load
    found = normality(LockedRows(rows.S, E, double_dot(rows.S, E), rows.unique, rows.source))
    assert not found.holds
    assert found.blamed == (row,)
    assert f"without rows {row} " in found.sentence()
    assert row in found.pairs[0]
    assert f"row {row} contradicts " in found.sentence()


def test_the_slack_is_the_plain_double_loop(rows):
    E = rows.E + np.random.default_rng(5).normal(scale=0.01, size=rows.E.shape)
    noisy = LockedRows(rows.S, E, double_dot(rows.S, E), rows.unique, rows.source)
    S2, E2 = np.vstack([rows.S, mirror(rows.S)]), np.vstack([E, mirror(E)])
    worst = min(double_dot(S2[i], E2[i] - E2[j]) for i in range(len(S2)) for j in range(len(S2)))
    assert normality(noisy).slack == pytest.approx(worst, abs=1e-15)


def test_failed_doubled_and_compressive_rows_are_dropped_by_name(ellipsoid):
    S = disc_grid(2, 6)
    E = ellipsoid.strain(S)
    S, E = np.vstack([S, S[3:4], [[1.0, 0.0, -0.1]]]), np.vstack([E, E[3:4], [[0.1, 0.0, 0.0]]])
    status = np.full(len(S), "converged", dtype=object)
    status[1] = "stalled"
    E[1] = np.nan
    rows = rows_from_table(table_of(S, E, status=status.astype(str)))
    assert len(rows) == len(S) - 3
    assert set(rows.source) == set(range(len(S))) - {1, 13, 14}
    assert [text.split(":")[0] for text in rows.dropped] == ["row 1", "row 14", "row 13"]
    assert np.allclose(rows.S[:, 0] + rows.S[:, 2], 1.0)
    with pytest.raises(InputError, match="no converged tensile row"):
        rows_from_table(table_of(S, E, status=np.full(len(S), "stalled")))


def test_a_row_with_shear_in_load_or_strain_alone_has_its_mirror_image():
    """On a flat face a load without shear may lock at a sheared strain; its image is another strain of that face."""
    S = np.array([[0.5, 0.0, 0.5], [0.6, 0.2, 0.4], [0.7, 0.0, 0.3]])
    E = np.array([[0.1, 0.05, 0.1], [0.1, 0.0, 0.2], [0.3, 0.0, 0.0]])
    rows = LockedRows(S, E, double_dot(S, E), np.array([True, False, True]), np.array([4, 7, 9]))
    both = with_mirror(rows)
    pairs = {(*s, *e) for s, e in zip(both.S.tolist(), both.E.tolist(), strict=True)}
    image = [1.0, -1.0, 1.0]
    assert pairs == {(*s, *e) for s, e in zip((*S, *(S * image)), (*E, *(E * image)), strict=True)}
    assert len(both) == 5
    assert both.source.tolist() == [4, 7, 9, 4, 7]
    assert both.unique.tolist() == [True, False, True, True, False]


@pytest.mark.parametrize("law_of", [outer_law, inner_law])
def test_half_a_table_gives_the_law_of_the_whole(ellipsoid, law_of):
    """Loads with S12 >= 0 and with S12 <= 0 tell the same by weave symmetry; a user makes one half only."""
    S = disc_grid(4, 16)
    whole, upper, lower = (law_of(rows_of(ellipsoid, part)) for part in (S, S[S[:, 1] > -1e-9], S[S[:, 1] < 1e-9]))
    loads = random_loads(200)
    for half in (upper, lower):
        assert np.allclose(half.support(loads), whole.support(loads), atol=1e-9)
        assert np.allclose(half.support(loads), half.support(mirror(loads)), atol=1e-9)
