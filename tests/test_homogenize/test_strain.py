"""The locked strain under a Cauchy load: right on known sets, at vertices, on flat faces, and honest otherwise."""

from pathlib import Path

import numpy as np
import pytest

from homogenize import default_law, diagonal_net, locked_strain, ring_net
from homogenize.fitting import outer_law, random_loads, refined_half_spaces, rows_from_table
from homogenize.laws import LockedRows, polyhedral_law, read_rows, ring_cell
from homogenize.query import StrainOptions, strain_bounds
from rve import Cell, DirectOptions, InputError, read_table, solve_table
from rve.common import double_dot, dyad, from_disc, trace
from rve.directions import product
from rve.geometry import cauchy_line_load, deformation_gradient, second_pk

from .conftest import disc_grid, rows_of


def load_at(E, alpha, beta):
    S = second_pk(deformation_gradient(E), cauchy_line_load(alpha, beta))
    return S / trace(S)[:, None]


def test_smooth_set_is_found_to_the_error_of_its_rows(ellipsoid):
    rng = np.random.default_rng(10)
    alpha, beta = rng.uniform(-90.0, 90.0, 200), rng.uniform(0.0, 90.0, 200)
    law = polyhedral_law(*refined_half_spaces(rows_of(ellipsoid, disc_grid(12, 48))))
    found = locked_strain(law, alpha, beta)
    assert np.all(found.status == "converged")
    assert np.allclose(found.S, load_at(found.E, alpha, beta), atol=2e-9)
    truth = ellipsoid.strain(found.S)
    assert np.abs(found.E - truth).max() < 0.02  # one facet of the polyhedron: spacing of the rows times curvature
    assert np.abs(found.E - truth).mean() < 0.004


def test_a_vertex_answers_itself():
    corner = np.array([0.1, 0.02, -0.1])
    S = np.vstack([np.eye(3)[[0, 2]], dyad(np.array([[1.0, 1.0], [1.0, -1.0], [1.0, 3.0], [3.0, 1.0]]))])
    law = polyhedral_law(S, S @ (corner * [1.0, 2.0, 1.0]))
    found = locked_strain(law, np.array([10.0, 40.0]), np.array([60.0, 50.0]))
    assert np.all(found.status == "converged")
    assert np.allclose(found.E, corner, atol=1e-12)


def test_a_fibre_under_its_own_load_is_not_unique():
    """The load along a taut fibre leaves the other one free: the answer is one of many, and says so."""
    net = diagonal_net(1.1)
    found = locked_strain(net, np.array([45.0]), np.array([0.0]))
    assert found.status[0] == "converged"
    assert not found.unique[0]
    assert found.E[0] @ (net.half_spaces().S[0] * [1.0, 2.0, 1.0]) == pytest.approx(0.105, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("law", "least"), [(default_law(), 1.0), (ring_net(ring_cell(5.0, 0.5, 11.0, 12.646)), 0.9)])
def test_a_law_carries_loads_at_strains_of_its_own(law, least):
    """Of a net all but those of rank one that draw it to a line."""
    beta = np.array([0.0, 3.0, 15.0, 45.0, 75.0, 87.0, 90.0])
    found = locked_strain(law, *product(np.arange(-90.0, 91.0, 15.0), beta))
    good = found.status == "converged"
    assert good.mean() >= least
    assert law.cut(found.E[good]).violation.max() < 1e-10


def test_a_strain_that_is_not_found_says_so(ellipsoid, monkeypatch):
    monkeypatch.setattr("homogenize.query.strain.OPTIONS", StrainOptions(newton_steps=1, path_steps=1))
    law = outer_law(rows_of(ellipsoid, disc_grid(4, 16)))
    tired = locked_strain(law, np.array([20.0]), np.array([30.0]))
    assert tired.status[0] == "no_convergence"
    assert tired.residual[0] > 1e-9
    assert np.isfinite(tired.E).all()


def known_answers(truth, S):
    """Cauchy angles (n,) and strain (n, 3) at which the set locks under the loads S (n, 3): exact, no solver."""
    E = truth.strain(S)
    F = deformation_gradient(E)
    s = F @ np.stack([S[:, [0, 1]], S[:, [1, 2]]], axis=1) @ F.transpose(0, 2, 1)
    sizes, axes = np.linalg.eigh(s)
    alpha = np.degrees(np.arctan2(axes[:, 1, 1], axes[:, 0, 1]))
    return alpha, np.degrees(np.arctan2(np.maximum(sizes[:, 0], 0.0), sizes[:, 1])), E


@pytest.mark.slow
def test_bounds_hold_the_exact_strain_and_close_with_the_rows(ellipsoid):
    S = random_loads(20, 3)
    S = S[np.hypot(S[:, 0] - S[:, 2], 2.0 * S[:, 1]) < 0.97]
    alpha, beta, E = known_answers(ellipsoid, S)
    widths = []
    for grid in (disc_grid(3, 12), disc_grid(6, 24)):
        low, high = strain_bounds(rows_of(ellipsoid, grid), cauchy_line_load(alpha, beta))
        assert np.all((low <= E + 1e-12) & (high >= E - 1e-12))
        widths.append((high - low).max(axis=1))
    assert np.mean(widths[1]) < 0.7 * np.mean(widths[0])
    assert np.mean(widths[1]) < 0.15


def test_bounds_reach_what_the_rows_cannot_exclude(ellipsoid):
    """The other way round: rows of another convex set that agree with the table are not shut out."""
    few = rows_of(ellipsoid, disc_grid(3, 12))
    law = outer_law(few)  # contains every row and obeys every half-space: the table could be this set's
    alpha, beta = np.array([10.0, 25.0, -40.0, 70.0]), np.array([20.0, 50.0, 65.0, 35.0])
    found = locked_strain(law, alpha, beta, rows=few)
    assert np.all(found.status == "converged")
    assert np.all(found.E_min <= found.E + 1e-9)
    assert np.all(found.E_max >= found.E - 1e-9)


TABLE = Path(__file__).parent / "data" / "table190.csv"


@pytest.mark.slow
def test_a_row_is_answered_with_the_row():
    """45 degrees along one axis was 0.029 off; each row's load, its mirror image and its other names give the row."""
    table = read_table(TABLE)
    rows = rows_from_table(table)
    free = np.flatnonzero(~table.unique)[:2]
    some = np.union1d(np.flatnonzero(table.unique)[::60], np.flatnonzero(table.unique)[-1:])
    alpha, beta = table.alpha_deg[some], table.beta_deg[some]
    for a, b, sign in ((alpha, beta, 1), (-alpha, beta, -1), (alpha + 90.0, 90.0 - beta, 1), (alpha - 180.0, beta, 1)):
        found = locked_strain(default_law(), a, b, rows=rows)
        assert np.all(found.status == "converged")
        assert np.allclose(found.E, table.E[some] * [1, sign, 1], atol=1e-8)  # rows of one load agree to the solver's R
        assert found.unique.all()
        assert np.all((found.E_min <= found.E) & (found.E_max >= found.E))
        assert (found.E_max - found.E_min).max() < 1e-8
        assert np.allclose(found.S, load_at(found.E, a, b), atol=1e-8)
    found = locked_strain(default_law(), table.alpha_deg[free], table.beta_deg[free], rows=rows)
    assert np.allclose(found.E, table.E[free], atol=1e-12)
    assert not found.unique.any()
    assert (found.E_max - found.E_min).max(axis=1).min() > 0.1  # what the load leaves free


@pytest.mark.slow
def test_strains_solved_off_the_grid_lie_within_the_bounds():
    rng = np.random.default_rng(21)
    alpha, beta = (np.append(rng.uniform(low, 90.0, 25), one) for low, one in ((-90.0, 8.98), (0.0, 4.333)))
    unseen = solve_table(Cell(), (alpha, beta))  # the last one is where strains change fast, and is unique
    assert unseen.converged.all()
    found = locked_strain(default_law(), unseen.alpha_deg, unseen.beta_deg, rows=rows_from_table(read_table(TABLE)))
    width = (found.E_max - found.E_min).max(axis=1)
    assert np.all(found.E_min <= unseen.E)
    assert np.all(found.E_max >= unseen.E)
    assert np.median(width) < 0.015
    assert np.all(found.E_min <= found.E)
    assert np.all(found.E_max >= found.E)
    assert np.array_equal(found.unique, width < 0.05)


@pytest.mark.parametrize(
    "count", [pytest.param(150, marks=pytest.mark.slow), pytest.param(600, marks=pytest.mark.release)]
)
def test_all_of_many_directions_and_the_dent_lie_within_the_bounds(count):
    """Also between (38, 85) and (47, 90), where locked strains lie up to 6.5e-4 inside their convex hull."""
    rng = np.random.default_rng(2027)
    alpha = np.concatenate([rng.uniform(-90.0, 90.0, count), rng.uniform(38.0, 47.0, 60), np.linspace(40.0, 45.0, 21)])
    beta = np.concatenate([rng.uniform(0.0, 90.0, count), rng.uniform(85.0, 90.0, 60), np.full(21, 90.0)])
    # A row in balance holds the strain of one of its two states, which need not be that of the load alone.
    unseen = solve_table(Cell(), (alpha, beta), DirectOptions(branches="first"))
    assert unseen.converged.all()
    low, high = strain_bounds(rows_from_table(read_table(TABLE)), cauchy_line_load(alpha, beta))
    assert np.all((low - 1e-8 <= unseen.E) & (high + 1e-8 >= unseen.E))
    width = (high - low).max(axis=1)[:count]
    assert np.median(width) < 0.012
    assert np.mean(width > 0.05) < 0.04


@pytest.mark.slow
def test_rows_with_an_error_widen_the_bounds(ellipsoid):
    """Bounds of rows that contradict each other by 5e-3 hold the exact strain; taken at their word they would not."""
    exact = rows_of(ellipsoid, disc_grid(12, 48))  # close enough for bounds as narrow as the error
    noise = np.random.default_rng(8).uniform(-2e-3, 2e-3, exact.E.shape)
    noisy = LockedRows(exact.S, exact.E + noise, double_dot(exact.S, exact.E + noise), exact.unique, exact.source)
    x = np.array([[0.1, 0.2], [-0.4, 0.3], [0.5, -0.5], [0.0, 0.7], [0.33, 0.11]])
    alpha, beta, E = known_answers(ellipsoid, from_disc(x))
    s = cauchy_line_load(alpha, beta)
    low, high = strain_bounds(noisy, s)
    assert np.all((low <= E) & (high >= E))
    least, most = strain_bounds(exact, s)
    assert np.all((high - low).max(axis=1) > (most - least).max(axis=1))


def test_rows_survive_a_file_and_false_ones_are_refused(ellipsoid):
    rows = rows_of(ellipsoid, disc_grid(2, 6))
    data = rows.to_dict()
    again = read_rows(data, "law.json: rows")
    assert np.array_equal(again.S, rows.S)
    assert np.array_equal(again.h, rows.h)
    for key, value in (("S", 2.0), ("E", float("nan")), ("E", -0.7)):
        bad = {**data, key: [[value, 0.0, value], *data[key][1:]]}
        with pytest.raises(InputError, match=r"row 0|E\[0\]\[0\] = nan"):
            read_rows(bad, "law.json: rows")
    for bad in ([], {**data, "unique": [1]}, {**data, "S": [[1.0, 2.0]]}, {"S": [], "E": [], "unique": []}):
        with pytest.raises(InputError, match=r"^law\.json: rows"):
            read_rows(bad, "law.json: rows")
