"""Predictions between rows: exact for the polynomials they promise, fourth order on a smooth set, convex on the rim."""

from pathlib import Path

import numpy as np
import pytest

from homogenize import default_law, locked_strain
from homogenize.fitting import FINEST, Nodes, bounds_of, on_arcs, random_loads, refined_half_spaces, rows_from_table
from homogenize.laws import polyhedral_law
from rve import Cell, graded_grid, read_table, solve_table
from rve.common import disc, double_dot, from_disc

from .conftest import disc_grid, rows_of

DATA = Path(__file__).parent / "data"


def test_the_rim_is_closely_sampled_and_right_to_fourth_order(ellipsoid):
    error = []
    for spokes in (36, 72):
        rows = rows_of(ellipsoid, disc_grid(3, spokes))
        nodes = Nodes(disc(rows.S), rows.h, rows.E, np.arange(len(rows)))
        x, h = on_arcs(nodes, 2.5)
        assert np.allclose(np.hypot(*x.T), 1.0)
        rim = np.vstack([x, nodes.x[nodes.on_rim()]])
        assert np.diff(np.sort(np.arctan2(rim[:, 1], rim[:, 0]))).max() <= np.radians(2.5) + 1e-12
        error.append(np.abs(h - ellipsoid.support(from_disc(x))).max())
    assert np.log2(error[0] / error[1]) > 3.7
    assert error[1] < 2e-6


@pytest.mark.slow
def test_refined_rows_predict_to_fourth_order(ellipsoid):
    """Half the distance of the rows, a sixteenth of the error; the outer bound only falls to a quarter."""
    error, outer = [], []
    S0 = random_loads()
    S0 = S0[np.hypot(*disc(S0).T) < 0.7]
    for spokes in (32, 64):
        rows = rows_of(ellipsoid, disc_grid(spokes // 4, spokes))
        S, h = refined_half_spaces(rows, FINEST)
        inside = np.hypot(*disc(S).T) < 0.7
        error.append(np.median(np.abs(h - ellipsoid.support(S))[inside]))
        outer.append(np.abs(bounds_of(rows).upper(S0) - ellipsoid.support(S0)).mean())
    assert np.log2(error[0] / error[1]) > 3.7
    assert 1.7 < np.log2(outer[0] / outer[1]) < 2.3
    assert error[1] < 0.01 * outer[1]


def test_predictions_keep_every_row(ellipsoid):
    rows = rows_of(ellipsoid, disc_grid(4, 16))
    S, h = refined_half_spaces(rows)
    assert np.all(h - double_dot(S[:, None], rows.E[None]).max(axis=1) > -1e-12)


def strain_misses(law, unseen):
    """Largest component error of E at every third direction with a unique strain, in the law's eyes too."""
    few = slice(None, None, 3)
    found = locked_strain(law, unseen.alpha_deg[few], unseen.beta_deg[few])
    good = unseen.unique[few] & found.unique & (found.status == "converged")
    assert good.mean() > 0.98
    return np.abs(found.E - unseen.E[few]).max(axis=1)[good]


@pytest.mark.release
def test_a_graded_table_resolves_the_kinks():
    """Strains within 5e-3 of unseen directions: missed by 2 % from 5 degrees, met by all from the graded table."""
    unseen = read_table(DATA / "directions.csv")
    uniform = strain_misses(default_law(), unseen)
    rows = rows_from_table(solve_table(Cell(), graded_grid()))
    graded = strain_misses(polyhedral_law(*refined_half_spaces(rows, 1e-5)), unseen)
    assert (uniform > 5e-3).mean() > 0.01
    assert graded.max() < 5e-3
    assert graded.mean() < 0.7 * uniform.mean()
