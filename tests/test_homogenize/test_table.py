"""The real table of the paper's grid: normality, the shipped law, its accuracy off the grid, spoilt copies."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.shipped_law import shipped_record
from homogenize import FitOptions, default_law, fit, locked_strain
from homogenize.fitting import bounds_of, random_loads, rows_from_table
from homogenize.io import DEFAULT_LAW
from rve import DirectOptions, InputError, read_table
from rve.common import double_dot, eigenvalues, trace
from rve.table import Origin

DATA = Path(__file__).parent / "data"


@pytest.fixture(scope="module")
def table():
    """Its locked states alone: some copies below have too few directions for a strength."""
    return replace(read_table(DATA / "table190.csv"), compliance=None, strength=None)


@pytest.fixture(scope="module")
def directions():
    """1000 random directions, solved by `rve table --loads`: never part of a fit."""
    found = read_table(DATA / "directions.csv")
    keep = np.flatnonzero(found.converged & found.unique)
    assert len(keep) > 980
    return found.alpha_deg[keep], found.beta_deg[keep], found.S[keep] / trace(found.S[keep])[:, None], found.E[keep]


def spoilt(table, rows, **columns):
    """The table with only these rows, or with other columns."""
    kept = {name: value[rows] for name, value in vars(table).items() if isinstance(value, np.ndarray) and len(value)}
    kept["quality"] = table.quality.take(rows)
    return replace(table, **{**kept, **columns})


def test_the_shipped_law_is_what_the_script_makes():
    made = json.loads(json.dumps(shipped_record(DATA / "table190.csv")))
    shipped = json.loads(DEFAULT_LAW.read_text())
    assert made["provenance"]["table"] == shipped["provenance"]["table"]
    for key in ("S", "h"):
        assert np.allclose(made["parameters"][key], shipped["parameters"][key], atol=1e-10)
    for key in ("S", "first_yield_1_per_mm", "collapse_1_per_mm"):
        assert np.allclose(made["strength"][key], shipped["strength"][key], rtol=1e-9, atol=1e-12)
    assert made["strength"]["material"] == shipped["strength"]["material"]
    left = {"parameters": 0, "provenance": 0, "strength": 0}
    assert {**made, **left} == {**shipped, **left}


def test_support_off_the_grid(directions):
    """The figures of docs/explanation/laws.md; the aim was 5e-4 and 1e-4 (missed by 1 direction in 1000, met)."""
    _, _, S, E = directions
    error = np.abs(default_law().support(S) - double_dot(S, E))
    assert error.mean() < 3e-5
    assert np.quantile(error, 0.995) < 5e-4
    assert error.max() < 7e-4


def test_the_shipped_law_lies_between_the_bounds(table):
    bounds, law, S = bounds_of(rows_from_table(table)), default_law(), random_loads()
    h = law.support(S)
    assert np.all(h >= bounds.lower(S) - 1e-12)
    assert np.all(h <= bounds.upper(S) + 1e-12)


def test_strains_off_the_grid(directions):
    """98 of 100 directions within 5e-3; the others lie within 5 degrees of beta = 0 or 90 with alpha above 35."""
    alpha, beta, _, E = (one[::3] for one in directions)
    found = locked_strain(default_law(), alpha, beta)
    assert np.all(found.status == "converged")
    error = np.abs(found.E - E).max(axis=1)
    assert error.mean() < 1.5e-3
    assert np.quantile(error, 0.97) < 5e-3
    assert error.max() < 2.5e-2


def test_one_angle_is_refused_or_marked(table):
    for rows, what in ((table.alpha_deg == 0.0, "on one line"), (np.arange(len(table)) == 30, "fewer than four")):
        with pytest.raises(InputError, match=what):
            fit(spoilt(table, np.flatnonzero(rows)))
    assert fit(spoilt(table, np.flatnonzero(table.alpha_deg == 20.0))).report.gap.maximum > 0.1


def test_outlier_is_refused_by_row_number(table):
    E = table.E.copy()
    E[47] += [0.02, 0.0, 0.02]
    with pytest.raises(InputError, match=r"without rows 47 the others agree"):
        fit(spoilt(table, np.arange(len(table)), E=E))
    first = replace(table.origin, options=DirectOptions(branches="first"))
    with pytest.raises(InputError, match="solve the table with --branches largest; the rows do not lie"):
        fit(replace(spoilt(table, np.arange(len(table)), E=E), origin=first))


def test_noise_is_refused_or_taken_with_its_level(table):
    noise = np.random.default_rng(14).uniform(-1e-3, 1e-3, table.E.shape)
    noisy = spoilt(table, np.arange(len(table)), E=table.E + noise)
    with pytest.raises(InputError, match="do not lie on one convex set"):
        fit(noisy)
    law = fit(noisy, FitOptions(normality=5e-3)).law
    assert np.abs(law.support(random_loads()) - default_law().support(random_loads())).max() < 6e-3
    E = np.random.default_rng(15).normal(scale=0.5, size=(200, 3))
    assert eigenvalues(law.response(E).S)[0].min() > -1e-9


def test_every_kind_is_fitted_and_reports(table):
    worst = {}
    for kind in ("refined", "outer", "inner", "net"):
        result = fit(table, FitOptions(kind))
        assert kind == "net" or result.law.name == "polyhedral"
        assert "outer minus inner" in result.report.text()
        assert result.report.text().startswith(f"{kind} law: normality holds")
        worst[kind] = result.report.rows.maximum
    assert max(worst["refined"], worst["outer"]) < 1e-10
    assert worst["net"] > 0.01
    with pytest.raises(InputError, match="law of 4-in-1"):
        fit(replace(table, origin=Origin(replace(table.cell, weave="6-in-1"))), FitOptions("net"))


@pytest.mark.slow
def test_the_table_behind_the_shipped_law_is_what_rve_makes(table, tmp_path):
    command = [sys.executable, "-m", "rve", "table", "--out", str(tmp_path / "table.csv")]
    subprocess.run(command, cwd=Path(__file__).parents[2], check=True, capture_output=True)
    made = read_table(tmp_path / "table.csv")
    assert np.array_equal(made.unique, table.unique)
    assert np.allclose(made.S, table.S, atol=1e-8)
    assert np.allclose(made.E[made.unique], table.E[table.unique], atol=1e-8)
