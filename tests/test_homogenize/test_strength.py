"""The strength surface: exact at its rows, homogeneous, symmetric, and the same after a law file."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from homogenize import FitOptions, fit, load_law, with_material
from homogenize.cli import main
from homogenize.directions import Directions, tensile_part
from homogenize.fitting import interval_of_table
from homogenize.laws import Strength, read_strength, strength_of_table, work_along
from homogenize.laws.strength import off_grid
from rve import InputError, Material
from rve.common import WEIGHT, double_dot, mirror, trace

from .conftest import Ellipsoid, disc_grid, table_of

S = disc_grid(5, 24)
D = np.array([[3e-3, 0.0, -1e-3], [0.0, 4e-3, 0.0], [-1e-3, 0.0, 2e-3]])
STEEL = Material(yield_N_per_mm2=400.0, ultimate_N_per_mm2=500.0)


def asked(S):
    """A made-up yield stress: a norm of S, so convex and homogeneous of degree one; and half of it."""
    first = 100.0 * np.sqrt(S[:, 0] ** 2 + 3.0 * S[:, 1] ** 2 + 0.5 * S[:, 2] ** 2)
    return np.stack([first, 0.5 * first], axis=1)


@pytest.fixture(scope="module")
def table():
    """Every row twice, as in two tables joined."""
    both = np.concatenate([S[::-1], S])
    found = table_of(2.0 * both, Ellipsoid().strain(both))
    cell = replace(found.cell, material=STEEL)
    compliance = np.tile(D / WEIGHT[:, None], (len(both), 1, 1))
    return replace(found, compliance=compliance, strength=asked(both), origin=replace(found.origin, cell=cell))


@pytest.fixture(scope="module")
def strength(table):
    return strength_of_table(table)


@pytest.fixture(scope="module")
def law(table):
    return fit(table).law


def test_rows_are_exact_and_size_counts_once(strength):
    assert strength.utilisation(S) == pytest.approx(asked(S)[:, 0] / 400.0, rel=1e-9)
    assert strength.collapse_utilisation(3.0 * S) == pytest.approx(3.0 * asked(S)[:, 1] / 400.0, rel=1e-9)
    assert strength.utilisation(S, 200.0) == pytest.approx(2.0 * strength.utilisation(S), rel=1e-12)
    assert strength.compliance_along(7.0 * S) == pytest.approx(np.einsum("ni,ij,nj->n", S, D, S), rel=1e-9)


def test_a_record_that_was_used_is_joined_taken_and_put_as_one_that_was_not(strength):
    """What a record has worked out of its rows, and keeps, is of these rows alone: no other has it."""
    n, loads = len(strength.S), np.array([[2.0, 0.3, 1.0], [1.0, 0.0, 0.1]])

    def answers(rows):
        values = rows.utilisation(loads), rows.collapse_utilisation(loads), rows.compliance_along(loads)
        return [*values, rows.extrapolates(loads), rows.stretched.S]

    def changed(half, other):
        yield half.join([other])
        yield half.take(np.arange(len(half.S)) % 5 > 0)
        yield half.put(np.arange(len(other.S)), replace(other, first_yield=3.0 * other.first_yield))

    def halves():
        parts = [strength.take(np.arange(n) % 2 == k) for k in (0, 1)]
        return replace(parts[0]), replace(parts[1])

    used, fresh = halves(), halves()
    before = answers(used[0]), answers(used[1])
    for mine, theirs in zip(changed(*used), changed(*fresh), strict=True):
        for value, expected in zip(answers(mine), answers(theirs), strict=True):
            np.testing.assert_array_equal(value, expected)
    np.testing.assert_array_equal(used[0].utilisation(loads), before[0][0])
    whole = used[0].join([used[1]]).utilisation(loads)
    np.testing.assert_allclose(whole, strength.utilisation(loads), rtol=1e-12)
    assert not np.array_equal(whole, before[0][0])


def test_between_rows_it_is_symmetric_homogeneous_and_as_wrong_as_reported(strength):
    v = np.random.default_rng(3).normal(size=(200, 2, 2))
    loads = np.einsum("nki,nkj->nij", v, v)
    loads = np.stack([loads[:, 0, 0], loads[:, 0, 1], loads[:, 1, 1]], axis=1)
    found = strength.utilisation(loads)
    assert strength.utilisation(mirror(loads)) == pytest.approx(found, rel=1e-12)
    assert strength.utilisation(10.0 * loads) == pytest.approx(10.0 * found, rel=1e-12)
    error = found / (asked(loads)[:, 0] / 400.0) - 1.0
    assert 1e-4 < np.abs(error).max() < strength.error.first_yield_max < 0.1
    inside = np.hypot(loads[:, 0] - loads[:, 2], 2.0 * loads[:, 1]) < 0.95 * trace(loads)
    assert error[inside].min() > -1e-9  # linear between the rows of a convex function: never below it
    assert strength.error.first_yield_mean < 0.5 * strength.error.first_yield_max
    assert strength.error.rows == 53  # 97 but for the rim's 24, and of mirror images one


def test_a_chiral_weave_has_its_own_strength_on_either_side(table):
    """Rows at S and at its mirror image differ: neither stands for the other."""
    cell = replace(table.cell, weave="6-in-1")
    chiral = replace(
        table, strength=table.strength * (1.0 + 0.25 * table.S[:, 1:2]), origin=replace(table.origin, cell=cell)
    )
    found = strength_of_table(chiral)
    assert found.utilisation(S) == pytest.approx(chiral.strength[-len(S) :, 0] / 400.0, rel=1e-9)
    assert found.error.first_yield_max < 0.1
    again = read_strength(json.loads(json.dumps(found.to_dict())), "law.json: strength")
    assert again.utilisation(mirror(S)) == pytest.approx(found.utilisation(mirror(S)), rel=1e-12)
    assert np.abs(found.utilisation(mirror(S)) / found.utilisation(S) - 1.0).max() > 0.5


def test_compression_counts_as_no_load(strength):
    v = np.array([[0.6, 0.8]])
    pull = np.stack([v[:, 0] ** 2, v[:, 0] * v[:, 1], v[:, 1] ** 2], axis=1)
    push = np.stack([v[:, 1] ** 2, -v[:, 0] * v[:, 1], v[:, 0] ** 2], axis=1)
    assert tensile_part(pull - 0.7 * push) == pytest.approx(pull, abs=1e-12)
    assert tensile_part(-push) == pytest.approx(np.zeros((1, 3)), abs=1e-12)
    assert strength.utilisation(pull - 0.7 * push) == pytest.approx(strength.utilisation(pull), rel=1e-9)
    assert strength.utilisation(-pull)[0] == pytest.approx(0.0, abs=1e-9)


def test_loads_of_rank_one_between_neighbours_are_in_the_table():
    """Loads S of thin wire turn by up to 60 degrees from one row to the next, whose Cauchy loads are 5 apart; where
    these are 60 apart the loads between them are not known."""

    def pulls(angle):
        return np.stack([np.cos(angle) ** 2, np.sin(angle) * np.cos(angle), np.sin(angle) ** 2], axis=1)

    alpha, asked = np.radians(np.arange(0.0, 180.0, 5.0)), np.radians(np.arange(2.0, 180.0, 7.0))
    thick, thin = (np.arctan2(share * np.sin(alpha), np.cos(alpha)) for share in (3.0, 20.0))
    for turned in (thick, thin):
        assert not Directions.of(pulls(turned), pulls(alpha), False).extrapolates(pulls(asked)).any()
    kept = np.abs(np.tan(alpha)) < np.tan(np.radians(61.0))
    off = Directions.of(pulls(thick[kept]), pulls(alpha[kept]), False).extrapolates(pulls(asked))
    assert off.tolist() == (np.abs(np.tan(asked)) > 3.0 * np.tan(np.radians(60.0))).tolist()
    assert 0 < off.sum() < 5


def test_the_error_falls_with_the_square_of_the_distance():
    errors = []
    for rings, spokes in ((4, 16), (8, 32)):
        loads = disc_grid(rings, spokes)
        k = asked(loads)
        errors.append(off_grid(Strength(loads, loads, k[:, 0], k[:, 1], k[:, 0], Material())).first_yield_mean)
    assert errors[0] / errors[1] > 3.0


def test_a_law_file_keeps_it(table, law, strength, tmp_path):
    law.save(tmp_path / "law.json")
    again = load_law(tmp_path / "law.json").strength
    one_side = replace(table, status=np.where(table.S[:, 0] > table.S[:, 2], "converged", "stalled"))
    one = fit(one_side).law
    assert one.strength.error is None  # a law, though its strength is not known
    one.save(tmp_path / "one.json")
    for what in ("--S=1,0,1", f"--plot={tmp_path / 'strength.png'}"):
        ended = CliRunner().invoke(main, ["strength", str(tmp_path / "one.json"), what])
        assert "one.json: strengths need loads on all sides" in ended.output
    assert again.utilisation(S) == pytest.approx(strength.utilisation(S), rel=1e-14)
    assert again.error == strength.error
    assert again.material == Material(yield_N_per_mm2=400.0, ultimate_N_per_mm2=500.0)
    butted = replace(table, origin=replace(table.origin, joint="butted:30"))
    assert read_strength(strength_of_table(butted).to_dict(), "law.json").joint == "butted:30"
    assert "butted:30 rings of steel" in strength_of_table(butted).text()
    fit(table, FitOptions(kind="net")).save(tmp_path / "net.json")  # its strength is that of the table as well
    assert load_law(tmp_path / "net.json").strength.to_dict() == strength.to_dict()
    # the law's own stiffness is that of the rings, too
    assert strength.compliance_along(S) == pytest.approx(double_dot(S, (law.compliance @ S.T).T), rel=1e-6)
    table.save(tmp_path / "table.csv")
    found = interval_of_table(tmp_path / "table.csv")
    assert found.law.compliance == pytest.approx(law.compliance, rel=1e-9)
    assert with_material(found, {"young": 105e3}).outer.compliance == pytest.approx(2.0 * law.compliance, rel=1e-9)


def test_the_command_prints_both_loads(law, tmp_path):
    law.save(tmp_path / "law.json")

    def run(*words):
        return CliRunner().invoke(main, ["strength", str(tmp_path / "law.json"), *words])

    found = json.loads(run("--S", "0,0,5", "--yield", "800").stdout)
    assert found["S22"] == 1.0
    assert found["first_yield_N_per_mm"] == pytest.approx(800.0 / (100.0 * np.sqrt(0.5)), rel=1e-9)
    assert found["collapse_N_per_mm"] == pytest.approx(2.0 * found["first_yield_N_per_mm"], rel=1e-9)
    assert found["extrapolated"] is False
    assert json.loads(run("--S", "0,0,5").stdout)["yield_N_per_mm2"] == 400.0


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("S", [[1.0, 0.9, 0.0]], "differ in length"),
        ("compliance_mm_per_N", [-1.0] * 121, r"compliance_mm_per_N\[0\] = -1.0: expected a number >= 0"),
        ("material", {"ultimate_N_per_mm2": 1.0}, "^law.json: strength material .* is less than yield"),
    ],
)
def test_damaged_strengths_are_refused(strength, key, value, message):
    with pytest.raises(InputError, match=message):
        read_strength(json.loads(json.dumps(strength.to_dict())) | {key: value}, "law.json: strength")


def test_a_material_without_yield_needs_one(strength):
    nameless = replace(strength, material=Material(name="wire", yield_N_per_mm2=None, ultimate_N_per_mm2=None))
    with pytest.raises(InputError, match="no yield stress"):
        nameless.utilisation(S)
    assert nameless.utilisation(S, 400.0) == pytest.approx(strength.utilisation(S), rel=1e-12)


@pytest.mark.slow
def test_loads_off_the_grid_are_as_wrong_as_the_law_reports():
    from rve import Cell, grid, solve_table, with_rings

    cell, rng = Cell(), np.random.default_rng(8)
    found = strength_of_table(with_rings(solve_table(cell, grid(5.0)), cell))
    beta = np.concatenate([rng.uniform(0.0, 90.0, 30), rng.uniform(0.0, 8.0, 30)])  # below lie loads without one strain
    off = with_rings(solve_table(cell, (rng.uniform(0.0, 45.0, 60), beta)), cell)
    good = off.converged
    asked = found.utilisation(off.S[good], 1.0) / trace(off.S[good])
    error = np.abs(asked / off.strength[good, 0] - 1.0)
    assert found.error.first_yield_max < 0.15
    assert error.max() < 1.5 * found.error.first_yield_max
    assert error.mean() < 2.0 * found.error.first_yield_mean
    along = work_along(off.S[good], off.compliance[good]) / trace(off.S[good]) ** 2
    error = np.abs(found.compliance_along(off.S[good]) / along - 1.0)
    assert found.error.compliance_max < 0.1
    assert error.max() < 0.2
    assert (error < found.error.compliance_max).mean() > 0.95
    assert error.mean() < 2.0 * found.error.compliance_mean
