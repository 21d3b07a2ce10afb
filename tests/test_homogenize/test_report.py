"""The error report: it finds the error that is there, and knows where no row has been."""

from dataclasses import replace

import numpy as np
import pytest

from homogenize import default_law, fit
from homogenize.directions import beyond, limits_of
from homogenize.fitting import error_report, held_out_misfit, normality, outer_law
from homogenize.query import extrapolates
from rve.common import from_disc, trace
from rve.geometry import deformation_gradient, second_pk

from .conftest import disc_grid, rows_of, table_of


def corners(count):
    angle = 2.0 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize(("count", "covered"), [(4, False), (6, False), (12, True), (36, True)])
def test_the_rim_between_far_loads_is_not_sampled(count, covered, ellipsoid):
    S, between = from_disc(corners(count)), from_disc(corners(2 * count)[1::2])
    assert beyond(limits_of(S, S), between).tolist() == [not covered] * count
    assert not beyond(limits_of(S, S), from_disc(0.5 * corners(count))).any()
    E = np.tile([0.0, 0.0, 0.5 * (0.3**2 - 1.0)], (count, 1))  # of thin wire, whose loads S crowd
    thin, asked = (second_pk(deformation_gradient(E), one) for one in (S, between))
    rows = replace(rows_of(ellipsoid, S), S=thin / trace(thin)[:, None], E=E)
    assert [extrapolates(rows, one) for one in asked / trace(asked)[:, None]] == [not covered] * count


def test_one_chain_that_bears_the_loads_of_several_rows_is_near_all_their_neighbours():
    strength = default_law().strength
    assert strength is not None
    assert not strength.extrapolates(from_disc(corners(360))).any()


def test_a_small_polygon_ends_where_its_corners_are():
    S = from_disc(0.5 * corners(24))
    assert not beyond(limits_of(S, S), from_disc(0.49 * corners(24))).any()
    assert beyond(limits_of(S, S), from_disc(0.51 * corners(24))).all()


def test_held_out_error_is_that_of_laws_that_have_not_seen_the_row(ellipsoid):
    """For the outer law a row left out is passed by the law: never below the truth, and by more than all rows give."""
    rows = rows_of(ellipsoid, disc_grid(5, 20))
    report = error_report(outer_law(rows), rows, normality(rows), outer_law)
    assert report.rows.maximum < 1e-12
    assert report.held_out is not None
    assert 1e-4 < report.held_out.maximum < 0.1
    assert report.held_out == held_out_misfit(rows, outer_law)
    assert held_out_misfit(rows_of(ellipsoid, disc_grid(10, 40)), outer_law).mean < 0.4 * report.held_out.mean
    assert report.below == 0.0
    assert report.above < 1e-12
    mixed = rows.S[np.random.default_rng(1).permutation(len(rows))]
    one, other = (fit(table_of(S, ellipsoid.strain(S))).report for S in (rows.S, mixed))
    assert one.held_out == other.held_out  # whatever the order of the rows
