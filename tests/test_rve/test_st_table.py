"""Tables by the paper's scheme."""

import numpy as np
import pytest

from rve.common.errors import InputError
from rve.geometry.cell import Cell
from rve.paper.dynamics import StewartTrinkleOptions
from rve.paper.table import solve_table_stewart_trinkle
from rve.solve import solve_table

ALPHA, BETA = np.array([0.0, 20.0, 30.0, 10.0]), np.array([45.0, 30.0, 60.0, -20.0])


@pytest.fixture(scope="module")
def direct():
    return solve_table(Cell(), (ALPHA, BETA))


def test_both_methods_give_one_table(direct):
    found = solve_table_stewart_trinkle(Cell(), (ALPHA, BETA))
    assert list(found.status) == ["converged"] * 3 + ["compressive"]
    assert found.E[:3] == pytest.approx(direct.E[:3], abs=2e-6)
    assert found.S[:3] == pytest.approx(direct.S[:3], abs=2e-5)
    assert np.isnan(found.E[3]).all()
    assert np.all(found.quality.R[:3] < 1e-9)
    assert np.all((found.quality.min_gap_mm[:3] < 0.0) & (found.quality.min_gap_mm[:3] > -1e-4))
    assert found.provenance["method"] == "stewart-trinkle"
    assert found.provenance["options"]["stiffness"] == 1e6


def test_senseless_options_are_bad_input():
    with pytest.raises(InputError, match=r"damping = -1\.0: must be greater than 0"):
        StewartTrinkleOptions(damping=-1.0)
