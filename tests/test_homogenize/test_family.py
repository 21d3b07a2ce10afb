"""Laws across radius ratios: exact where the support is quadratic in r2/r1, refused outside, error checked inside."""

import numpy as np
import pytest
from click.testing import CliRunner

from homogenize.cli import main
from homogenize.family import family_of, load_family, save_family
from homogenize.fitting.report import random_loads
from homogenize.laws.net import ring_cell
from homogenize.laws.polyhedral import polyhedral_law
from rve.common.errors import InputError
from rve.common.tensor import double_dot

from .conftest import Ellipsoid, disc_grid

LOADS = disc_grid(6, 24)
SHIFT = np.array([0.3, 0.0, -0.2])


def truth(x, S=LOADS):
    """A set that grows and moves with x: its support is quadratic in x for every load."""
    return (1.0 + 2.0 * x**2) * Ellipsoid().support(S) + x * double_dot(S, SHIFT)


def member(r1, r2, b_x=2.2):
    return polyhedral_law(LOADS, truth(r2 / r1), None, ring_cell(r1, r2, b_x * r1, (2.0 + r2 / r1) * r1))


@pytest.fixture
def family():
    return family_of([member(5.0, 0.5), member(5.0, 1.0), member(10.0, 0.5), member(10.0, 0.25)])


def test_a_quadratic_family_is_interpolated_exactly(family):
    law = family.at(8.0, 0.6)
    assert np.allclose(law.support(LOADS), truth(0.075), atol=1e-10)
    assert law.cell.b_x_mm == pytest.approx(17.6)
    assert law.cell.b_y_mm == pytest.approx((2.0 + 0.075) * 8.0)
    assert all(check.maximum < 1e-9 for _, check in family.checks)
    assert [round(ratio, 6) for ratio, _ in family.checks] == [0.05, 0.1]


def test_members_are_themselves(family):
    S = random_loads(100)
    assert np.allclose(family.at(5.0, 0.5).support(S), member(5.0, 0.5).support(S), atol=1e-10)


def test_the_check_sees_a_member_that_does_not_belong():
    odd = polyhedral_law(LOADS, truth(0.1) + 0.02, None, ring_cell(5.0, 0.5, 11.0, 10.5))
    checks = dict(family_of([member(5.0, 1.0), odd, member(10.0, 0.5), member(10.0, 0.25)]).checks)
    assert checks[0.1].maximum == pytest.approx(0.02, rel=0.02)


def test_ratios_outside_are_refused(family):
    with pytest.raises(InputError, match="r1/r2 = 4 is outside the family, which reaches from 5 to 40"):
        family.at(4.0, 1.0)
    with pytest.raises(InputError, match="positive"):
        family.at(-1.0, 1.0)
    with pytest.raises(InputError, match="at least 3"):
        family_of([member(5.0, 0.5), member(5.0, 1.0)])
    with pytest.raises(InputError, match="same r1/r2 = 10"):
        family_of([member(5.0, 0.5), member(10.0, 1.0), member(5.0, 1.0)])


def test_file_and_command_line(family, tmp_path):
    path = tmp_path / "family.json"
    save_family(family, path)
    S = random_loads(50)
    assert np.array_equal(load_family(path).at(7.0, 0.5).support(S), family.at(7.0, 0.5).support(S))
    runner = CliRunner()
    made = runner.invoke(main, ["member", str(path), "--r1", "7", "--r2", "0.5", "--out", str(tmp_path / "law.json")])
    assert made.exit_code == 0
    outside = runner.invoke(main, ["member", str(path), "--r1", "7", "--r2", "3", "--out", str(tmp_path / "no.json")])
    assert outside.exit_code == 2
    assert "outside the family" in outside.stderr
    assert not (tmp_path / "no.json").exists()
    path.write_text("[]")
    assert runner.invoke(main, ["member", str(path), "--r1", "7", "--r2", "1", "--out", "x.json"]).exit_code == 2


def test_half_spaces_are_those_of_the_nearest_member():
    """Each member has its own normals: a law between members takes those of the nearest one, not of the first."""
    members = []
    for count, (r1, r2) in ((16, (10.0, 0.25)), (20, (10.0, 0.5)), (24, (5.0, 0.5))):
        S = disc_grid(6, count)
        members.append(polyhedral_law(S, truth(r2 / r1, S), None, ring_cell(r1, r2, 2.2 * r1, (2.0 + r2 / r1) * r1)))
    family = family_of(members)
    for ratio, nearest in ((0.03, 0), (0.06, 1), (0.09, 2)):
        assert np.allclose(family.at(10.0, 10.0 * ratio).S, members[nearest].S)
