"""The compliance beyond locking is found in rows whose compliance also holds the bend of the surface."""

from dataclasses import replace

import numpy as np
import pytest

from homogenize import fit
from homogenize.laws import constant_compliance, work_along
from rve import InputError
from rve.common import WEIGHT

from .conftest import disc_grid, table_of

HESSIAN = np.array([[3e-3, 0.0, -1e-3], [0.0, 8e-3, 0.0], [-1e-3, 0.0, 2e-3]])
A = HESSIAN / WEIGHT[:, None]


def row_compliance(truth, S, step=1e-6):
    """dE/dS of E = dh/dS + A S by central differences, (n, 3, 3)."""
    columns = []
    for e in np.eye(3):
        up, down = S + step * e, S - step * e
        columns.append((truth.strain(up) - truth.strain(down)) / (2.0 * step) + A @ e)
    return np.stack(columns, axis=2)


def test_compliance_is_found_under_the_bend_of_the_surface(ellipsoid):
    S = disc_grid(4, 12) * np.linspace(0.5, 2.0, 49)[:, None]
    D = row_compliance(ellipsoid, S)
    assert np.abs(D).max() > 10.0 * np.abs(A).max()  # the bend dominates
    assert np.allclose(constant_compliance(S, work_along(S, D), True), A, atol=1e-8)


def test_a_chiral_weave_couples_shear_and_stretch():
    S = disc_grid(4, 12)
    A = np.array([[3e-3, 1e-3, -1e-3], [1e-3, 8e-3, -2e-3], [-1e-3, -2e-3, 2e-3]]) / WEIGHT[:, None]
    D = np.tile(A, (len(S), 1, 1))
    assert np.allclose(constant_compliance(S, work_along(S, D), False), A, atol=1e-12)
    assert np.abs(constant_compliance(S, work_along(S, D), True) - A).max() > 1e-4


def test_a_table_with_compliance_gives_its_stiffness_to_the_law(ellipsoid):
    S = disc_grid(4, 12)
    table = table_of(S, ellipsoid.strain(S))
    with_compliance = fit(replace(table, compliance=row_compliance(ellipsoid, S)))
    assert np.allclose(with_compliance.law.compliance, A, atol=1e-7)
    assert "compliance" in with_compliance.law.provenance["stiffness"]
    assert np.allclose(fit(table).law.compliance, np.eye(3) / 1000.0)
    assert "stated" in fit(table).law.provenance["stiffness"]
    D = row_compliance(ellipsoid, S) * np.linspace(1.0, 2.0, len(S))[:, None, None]
    rows = ([*range(len(S))], [*range(len(S)), 7, 8])  # some of them twice
    once, twice = (fit(replace(table_of(S[i], ellipsoid.strain(S[i])), compliance=D[i])).law for i in rows)
    assert np.array_equal(vars(once)["stiffness"], vars(twice)["stiffness"])


def test_useless_compliance_is_refused(ellipsoid):
    S = disc_grid(4, 12)
    table = replace(table_of(S, ellipsoid.strain(S)), compliance=np.full((len(S), 3, 3), np.nan))
    with pytest.raises(InputError, match="S:D S > 0"):
        fit(table)
