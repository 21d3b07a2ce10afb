"""Tables by the paper's scheme and with compliance columns."""

import numpy as np
import pytest

from rve.common.errors import InputError
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load
from rve.more_columns import with_compliance
from rve.paper.checkpoints import SweepOptions
from rve.paper.dynamics import StewartTrinkleOptions
from rve.paper.table import solve_table_stewart_trinkle
from rve.solve import solve_table
from rve.table import read_table, write_table

ALPHA, BETA = np.array([0.0, 20.0, 30.0, 10.0]), np.array([45.0, 30.0, 60.0, -20.0])


@pytest.fixture(scope="module")
def direct():
    return solve_table(Cell(), (ALPHA, BETA))


def test_both_methods_give_one_table(direct, tmp_path):
    found = solve_table_stewart_trinkle(Cell(), (ALPHA, BETA), how=SweepOptions(folder=tmp_path, block=3))
    assert list(found.status) == ["converged"] * 3 + ["compressive"]
    assert found.E[:3] == pytest.approx(direct.E[:3], abs=2e-6)
    assert found.S[:3] == pytest.approx(direct.S[:3], abs=2e-5)
    assert np.isnan(found.E[3]).all()
    assert np.all(found.R[:3] < 1e-9)
    assert np.all((found.min_gap_mm[:3] < 0.0) & (found.min_gap_mm[:3] > -1e-4))
    assert found.provenance["method"] == "stewart-trinkle"
    assert found.provenance["options"]["stiffness"] == 1e6
    assert len(list(tmp_path.iterdir())) == 2


def test_senseless_options_are_bad_input():
    with pytest.raises(InputError, match=r"damping = -1\.0: must be greater than 0"):
        StewartTrinkleOptions(damping=-1.0)


def test_compliance_predicts_the_strain_between_rows(direct, tmp_path):
    """At a stiffness so large that the rows are those of rigid contact, D is the slope of the table."""
    stiff = with_compliance(direct, 1e9)
    turn = 0.01
    near = solve_table(Cell(), (ALPHA[:3], BETA[:3] + turn))
    far = solve_table(Cell(), (ALPHA[:3], BETA[:3] - turn))
    predicted = np.einsum("nij,nj->ni", stiff.compliance[:3], near.S - far.S)
    assert predicted == pytest.approx(near.E - far.E, rel=1e-4, abs=1e-7)
    assert np.isnan(stiff.compliance[3]).all()
    write_table(stiff, tmp_path / "table.csv")
    again = read_table(tmp_path / "table.csv")
    assert np.array_equal(again.compliance, stiff.compliance, equal_nan=True)
    assert again.provenance["compliance_stiffness_N_per_mm"] == 1e9


def test_twice_the_load_on_twice_the_stiffness_is_half_as_compliant(direct):
    """D(k, s) = D(k/s, 1)/s: columns are for 1 N/mm, so the ratio is all that a unit load needs."""
    soft, stiff = (with_compliance(direct, k).compliance[:3] for k in (1e4, 1e6))
    S = direct.S[:3]
    weight = np.array([1.0, 2.0, 1.0])
    along = [np.einsum("ni,i,nij,nj->n", S, weight, D, S) for D in (soft, stiff)]
    assert along[0] / along[1] == pytest.approx(100.0, rel=0.02)


def test_grain_along_x_swaps_the_axes(direct):
    turned = with_compliance(solve_table(Cell(grain="x"), (90.0 - ALPHA[:3], BETA[:3])), 1e4)
    straight = with_compliance(direct, 1e4)
    s = cauchy_line_load(90.0 - ALPHA[:3], BETA[:3])
    assert s[:, ::-1] == pytest.approx(cauchy_line_load(ALPHA[:3], BETA[:3]), abs=1e-15)
    assert pytest.approx(straight.E[:3, ::-1], abs=1e-9) == turned.E
    assert turned.compliance == pytest.approx(straight.compliance[:3, ::-1, ::-1], rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("stiffness", [0.0, -3.0, np.nan])
def test_stiffness_must_be_positive(direct, stiffness):
    with pytest.raises(InputError, match="stiffness = "):
        with_compliance(direct, stiffness)
