"""Table files: what is written is read, and what is wrong is named."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from rve import Cell, InputError, graded_grid, read_table, solve_table, write_table
from rve.common import sidecar_path
from rve.directions import parse_angles, product, read_loads
from rve.table import COLUMNS


@pytest.fixture(scope="module")
def small():
    return solve_table(Cell(), ([0.0, 20.0, 10.0, 30.0], [90.0, 30.0, 95.0, 0.0]))


def same(first, second):
    for name, value in (vars(first) | vars(first.quality)).items():
        if name in ("states", "quality"):  # not in files
            continue
        other = (vars(second) | vars(second.quality))[name]
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(value, other, err_msg=name)
        else:
            assert value == other


def test_round_trip_to_the_last_digit(small, tmp_path):
    path = tmp_path / "table.csv"
    write_table(small, path)
    same(small, read_table(path))
    frame = pd.read_csv(path)
    assert list(frame.columns) == [*COLUMNS, "branch"]
    assert frame["status"].tolist() == ["converged", "converged", "compressive", "converged"]
    assert frame["E11"].isna().tolist() == [False, False, True, False]
    assert frame["unique"].tolist() == [1, 1, 1, 0]
    assert json.loads(sidecar_path(path).read_text())["b_x_mm"] == pytest.approx(11.0, abs=1e-9)


def test_a_table_that_does_not_say_whether_strains_are_unique_counts_as_unique(small, tmp_path):
    """As documented in `read_table`: tables from elsewhere give strains that were measured or computed as they are."""
    path = tmp_path / "table.csv"
    write_table(small, path)
    frame = pd.read_csv(path)
    assert read_table(path).unique.tolist() == [True, True, True, False]
    path.with_suffix(".json").unlink()  # it holds the checksum of the table as it was
    frame.drop(columns="unique").to_csv(path, index=False)
    assert read_table(path).unique.tolist() == [True] * 4
    frame["unique"] = ["1", "", "0", "0"]
    frame.to_csv(path, index=False)
    assert read_table(path).unique.tolist() == [True, True, False, False]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.splitlines()[0] + "\n", "has no rows"),
        (lambda t: t.replace("E11", "e11"), "column E11 is missing"),
        (lambda t: t.replace("0.0,90.0,", "0.0,,"), "not a finite number"),
        (lambda t: "\x00\xff", "column E11 is missing"),
    ],
)
def test_bad_tables_are_named(small, tmp_path, change, words):
    path = tmp_path / "table.csv"
    write_table(small, path)
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=r"table\.csv") as error:
        read_table(path)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_and_truncated_files(small, tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_table(tmp_path / "no.csv")
    path = tmp_path / "table.csv"
    write_table(small, path)
    for text, words in {
        "": "it is empty",
        '{"r1_mm": ': "line 1, column 11: the text ends too early: the file was cut off",
        '{"r1_mm": "1': "line 1, column 11: the text ends too early",
        '{"r1_mm": 1,\n "r2_mm" 2}': "line 2, column 10: look for a comma, quote, or bracket",
    }.items():
        sidecar_path(path).write_text(text)
        with pytest.raises(InputError, match=re.escape(f"is not JSON: {words}")):
            read_table(path)


def test_ranges_that_are_none():
    assert parse_angles("7.5,12.5", "--beta").tolist() == [7.5, 12.5]
    assert parse_angles("45:0:-15", "--beta").tolist() == [45, 30, 15, 0]
    for text in ("", "a", "1:2", "0:10:0", "0:10:-1", "nan", "0:inf:1", "1:2:3:4", "0:1e9:1e-3"):
        with pytest.raises(InputError, match="--alpha"):
            parse_angles(text, "--alpha")
    a, b = product(np.array([1.0, 2.0]), np.array([3.0, 4.0]))
    assert a.tolist() == [1, 1, 2, 2]
    assert b.tolist() == [3, 4, 3, 4]


def test_load_files(tmp_path):
    path = tmp_path / "loads.csv"
    path.write_text("beta_deg,alpha_deg,note\n30,20,x\n60,-5,y\n")
    alpha, beta = read_loads(path)
    assert alpha.tolist() == [20, -5]
    assert beta.tolist() == [30, 60]
    path.write_text("alpha_deg,beta_deg\n1,nan\n")
    with pytest.raises(InputError, match=r"line 2, column beta_deg"):
        read_loads(path)


def test_loads_that_are_no_loads():
    with pytest.raises(InputError, match="as many"):
        solve_table(Cell(), ([1.0, 2.0], [3.0]))
    with pytest.raises(InputError, match="finite"):
        solve_table(Cell(), ([np.nan], [3.0]))
    with pytest.raises(InputError, match="at least one"):
        solve_table(Cell(), ([], []))


def test_the_graded_grid_is_close_where_strains_change_fast():
    """403 directions, each once; steps of 5 degrees in the middle, of half a degree beside the ends of beta."""
    alpha, beta = graded_grid()
    assert len(set(zip(alpha, beta, strict=True))) == len(alpha) == 403
    steps = np.diff(np.unique(beta))
    assert steps[0] == steps[-3] == 0.5
    assert steps.max() == 5.0
    assert np.diff(np.unique(alpha)).tolist() == [5.0] * 6 + [2.5] * 6


@pytest.mark.slow
def test_nearly_uniaxial_loads_of_thin_rings_take_further_attempts():
    found = solve_table(Cell(5.0, 0.1), ([30.0, 0.0, 20.0], [0.001, 0.005, 0.002]))
    assert found.converged.all()
    assert (found.states.found.attempts > 1).any()
