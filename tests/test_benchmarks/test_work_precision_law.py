"""The laws of the report: errors against directions solved on their own, which fall with the rows of the table."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.problems import loads
from benchmarks.work_precision.law import (
    ABOVE,
    E_MEAN,
    E_MOST,
    GRADED_RESOLUTION,
    H_MEAN,
    H_MOST,
    errors_of,
    made,
    parameters,
    spacing_rows,
    spacing_table,
    unseen_directions,
)
from homogenize.fitting.bounds import bounds_of
from homogenize.fitting.rows import rows_from_table
from homogenize.laws.net import diagonal_net
from rve.geometry.cell import Cell
from rve.solve import solve_table


@pytest.fixture(scope="module")
def unseen():
    return unseen_directions(80)


@pytest.fixture(scope="module")
def coarse():
    return solve_table(Cell(), loads(15.0))


def test_errors_fall_with_the_rows_and_stay_inside_the_bounds(unseen, coarse):
    finer = solve_table(Cell(), loads(7.5))
    wide, close = spacing_rows([("15", coarse, 1.0, 3e-5), ("7.5", finer, 1.0, 3e-5)], unseen)
    assert close[H_MEAN] < 0.4 * wide[H_MEAN]
    assert close[E_MEAN] < 0.7 * wide[E_MEAN]
    for row in (wide, close):
        assert row[H_MOST] < row["outer less inner bound"]  # truth and law lie between the same two bounds
        assert 0.0 <= row[ABOVE] <= 1.0
    assert spacing_table([wide, close]).rows[1][1] == f"{len(finer):,}"


def test_a_law_is_right_where_it_was_fitted_and_a_wrong_one_is_seen(coarse):
    law, _ = made(coarse)
    at_home = errors_of(law, coarse)
    assert at_home[H_MOST] < 1e-10
    net = errors_of(diagonal_net(1.1), unseen_directions(5))
    assert net[H_MOST] > 0.1
    assert np.isnan(net[E_MOST]) or net[E_MOST] > 0.1


def test_errors_do_not_depend_on_the_size_of_the_load(coarse, unseen):
    law, _ = made(coarse)
    one, seven = errors_of(law, unseen), errors_of(law, replace(unseen, S=7.0 * unseen.S))
    assert seven[H_MOST] == pytest.approx(one[H_MOST], rel=1e-9)


def test_a_finer_resolution_has_more_half_spaces_within_the_bounds(coarse, unseen):
    plain, fine = made(coarse)[0], made(coarse, resolution=GRADED_RESOLUTION)[0]
    assert parameters(fine) > parameters(plain)
    bounds = bounds_of(rows_from_table(coarse))
    h = fine.support(unseen.S)
    assert (h >= bounds.lower(unseen.S) - 1e-12).all()
    assert (h <= bounds.upper(unseen.S) + 1e-12).all()
