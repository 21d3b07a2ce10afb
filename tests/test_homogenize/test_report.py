"""The error report: it finds the error that is there, and knows where no row has been."""

import numpy as np
import pytest

from homogenize.directions import hull_of
from homogenize.fitting.bounds import outer_law
from homogenize.fitting.report import error_report, held_out_misfit, is_sampled, misfit_of, random_loads
from homogenize.fitting.rows import normality
from rve.common.tensor import from_disc

from .conftest import disc_grid, rows_of


def corners(count):
    angle = 2.0 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize(("count", "covered"), [(4, False), (6, False), (12, True), (36, True)])
def test_the_rim_between_far_loads_is_not_sampled(count, covered):
    between = from_disc(np.array([[np.cos(np.pi / count), np.sin(np.pi / count)]]))
    assert bool(is_sampled(corners(count), between)[0]) is covered
    assert is_sampled(corners(count), from_disc(0.5 * corners(count))).all()


def test_a_small_polygon_ends_where_its_corners_are():
    polygon = 0.5 * corners(24)
    assert is_sampled(polygon, from_disc(0.49 * corners(24))).all()
    assert not is_sampled(polygon, from_disc(0.51 * corners(24))).any()
    assert np.array_equal(is_sampled(polygon, 7.0 * from_disc(0.49 * corners(5))), np.ones(5, bool))


def test_the_cone_of_rows_is_their_hull():
    polygon = hull_of(disc_grid(3, 16), True)
    assert len(polygon) == 16
    assert np.allclose(np.hypot(*polygon.T), 1.0)


def test_misfit_names_the_worst_load():
    S = random_loads(50)
    error = np.zeros(50)
    error[17] = -0.25
    found = misfit_of(S, error)
    assert (found.maximum, found.mean, found.count) == (0.25, 0.005, 50)
    assert found.worst_S == tuple(S[17])


def test_held_out_error_is_that_of_laws_that_have_not_seen_the_row(ellipsoid):
    """For the outer law a row left out is passed by the law: never below the truth, and by more than all rows give."""
    rows = rows_of(ellipsoid, disc_grid(5, 20))
    report = error_report(outer_law(rows), rows, normality(rows), outer_law)
    assert report.rows.maximum < 1e-12
    assert report.held_out is not None
    assert 1e-4 < report.held_out.maximum < 0.1
    assert report.held_out == held_out_misfit(rows, outer_law)
    finer = rows_of(ellipsoid, disc_grid(10, 40))
    assert held_out_misfit(finer, outer_law).mean < 0.4 * report.held_out.mean
    assert report.below == 0.0
    assert report.above < 1e-12
