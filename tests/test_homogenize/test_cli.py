"""The command line: answers on real input, and one sentence with exit code 2 on bad input."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from homogenize import FitOptions, default_law, fit_table, load_law
from homogenize.cli import main
from homogenize.io import DEFAULT_LAW
from homogenize.query import support_answer
from rve import Cell, InputError

TABLE = Path(__file__).parent / "data" / "table190.csv"


def run(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


def refused(result, *words):
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith(("Error: ", "Usage: "))
    assert "Traceback" not in result.output
    for word in words:
        assert str(word) in result.stderr
    if result.stderr.startswith("Error: "):
        assert result.stderr.count("\n") == 1
    return True


def test_fit_writes_a_law_and_prints_its_error(tmp_path):
    result = run("fit", TABLE, "--out", tmp_path / "law.json")
    assert result.exit_code == 0, result.output
    for words in ("normality holds", "rows left out", "outer minus inner bound", "no unique strain"):
        assert words in result.output
    S = np.array([[0.6, 0.1, 0.4]])
    assert load_law(tmp_path / "law.json").support(S) == pytest.approx(default_law().support(S), abs=1e-12)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["law.json"]
    record = json.loads((tmp_path / "law.json").read_text())
    assert len(record["provenance"]["table"]["sha256"]) == 64


@pytest.mark.slow
def test_support_of_strings_and_a_law_that_keeps_those_of_its_rows(tmp_path):
    told = json.loads(run("support", DEFAULT_LAW, "--S", "0,0,2", "--strings").output)
    pitch = np.pi * 5.0 - 2.0 * (np.pi - 1.0) * 0.5  # of a ring along the grain
    exact = (2.0 * pitch / default_law().cell.b_y_mm) ** 2 - 1.0
    assert told["h_strings"] == pytest.approx(exact, rel=1e-8)
    assert told["h_strings"] > told["h"]
    assert all(loop["is_tight"] and len(loop["links"]) == 4 for loop in told["strings"]["loops"])
    info, strands = default_law().cell, 2.0 * np.pi * 0.5**2 * 360.0
    force = info.b_x_mm * 2.0 * pitch / info.b_y_mm  # of a ring for S22 = 1 N/mm
    broken = json.loads(run("strength", DEFAULT_LAW, "--S", "0,0,1").output)["strings_break_N_per_mm"]
    assert broken == pytest.approx([0.30 * strands / force, 0.56 * strands / force], rel=1e-4)
    rows = TABLE.read_text().splitlines()[:30]
    table, law = tmp_path / "table.csv", tmp_path / "law.json"
    values = ["h_strings", *(f"{1.0 + 0.01 * n}" if n else "" for n in range(len(rows) - 1))]
    table.write_text("\n".join(f"{row},{value}" for row, value in zip(rows, values, strict=True)))
    assert run("fit", table, "--out", law, "--cell", "5,0.5").exit_code == 0
    kept = load_law(law).rows.h_strings
    source = fit_table(table, FitOptions(cell=Cell(5.0, 0.5))).law.rows.source
    assert kept == pytest.approx(np.where(source > 0, 1.0 + 0.01 * source, np.nan), nan_ok=True)
    table.write_text(table.read_text().replace(",1.04", ",-1.04"))
    refused(run("fit", table, "--out", tmp_path / "none.json", "--cell", "5,0.5"), "h_strings: is below 0")
    text = law.read_text()
    law.write_text(re.sub(r'("h_strings": \[\D*)', r"\1-", text))
    refused(run("strain", law, "--alpha", "20", "--beta", "30"), "h_strings[")
    law.write_text(text.replace('"h_strings": [', '"h_strings": [1.0, '))
    refused(run("strain", law, "--alpha", "20", "--beta", "30"), "h_strings: has")
    cloth = tmp_path / "cloth.csv"
    cloth.write_text("E11,E12,E22,S11,S12,S22\n0.1,0,0,1,0,0\n0,0,0.1,0,0,1\n0.05,0,0.05,1,0,1\n0.04,0.01,0.04,1,1,1\n")
    assert run("fit", cloth, "--out", law, "--kind", "outer", "--noise", "1").exit_code == 0
    refused(run("support", law, "--S", "0,0,1", "--strings"), "--strings", "does not tell its rings")


def test_strain_prints_one_object():
    result = run("strain", DEFAULT_LAW, "--alpha", "20", "--beta", "30")
    answer = json.loads(result.output)
    expected = {"E11": 0.33028, "E12": 0.00624, "E22": -0.17511}  # rve, 20 degrees, 30 degrees
    assert result.exit_code == 0
    assert {key: answer[key] for key in expected} == pytest.approx(expected, abs=5e-3)
    assert answer["unique"] is True
    assert answer["extrapolated"] is False
    mirrored = json.loads(run("strain", DEFAULT_LAW, "--alpha", "-20", "--beta", "30").output)
    assert mirrored["E12"] == pytest.approx(-answer["E12"], abs=1e-6)


def test_loads_outside_the_sampled_cone_are_marked(tmp_path):
    lines = [line.rsplit(",", 11)[0] for line in TABLE.read_text().splitlines()]  # too few loads for a strength
    kept = [line for line in lines[1:] if 15.0 <= float(line.split(",")[1]) <= 75.0]
    (tmp_path / "part.csv").write_text("\n".join([lines[0], *kept]) + "\n")
    (tmp_path / "part.json").write_text(TABLE.with_suffix(".json").read_text())
    assert run("fit", tmp_path / "part.csv", "--out", tmp_path / "law.json").exit_code == 0
    assert json.loads(run("support", tmp_path / "law.json", "--S", "1,0,0").output)["extrapolated"] is True
    assert json.loads(run("support", tmp_path / "law.json", "--S", "0.36,0,0.64").output)["extrapolated"] is False


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda record: record | {"kind": "magic"}, ("kind = 'magic'", "net, polyhedral")),
        (lambda record: record | {"kind": "smooth"}, ("kind = 'smooth'", "homogenize fit TABLE")),
        (lambda record: record | {"parameters": {"S": [[1, 0, 0]], "h": [1]}}, ("stiffness_N_per_mm",)),
        (
            lambda record: record | {"parameters": record["parameters"] | {"h": [float("nan")] * 3}},
            ("parameters h[0] = nan", "expected a number"),
        ),
    ],
)
def test_a_law_file_that_is_not_understood_is_refused(change, words, tmp_path):
    path = tmp_path / "law.json"
    path.write_text(json.dumps(change(json.loads(DEFAULT_LAW.read_text()))))
    assert refused(run("support", path, "--S", "1,0,0"), path, *words)
    path.write_text("{")
    assert refused(run("support", path, "--S", "1,0,0"), path, "not JSON")


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2])
def test_a_load_of_one_direction_is_tensile_and_one_that_pushes_by_a_little_is_not(size, angle):
    """Rounding of the components is forgiven, whatever the units; a compression of 1e-10 of the load is not."""
    c, s = np.cos(angle), np.sin(angle)
    along, across = np.array([c * c, c * s, s * s]), np.array([s * s, -c * s, c * c])
    answer = support_answer(DEFAULT_LAW, size * along)
    assert answer["h"] == pytest.approx(size * default_law().support(along[None])[0], rel=1e-12)
    assert support_answer(DEFAULT_LAW, size * (along - 1e-14 * across))["h"] == pytest.approx(answer["h"], rel=1e-9)
    with pytest.raises(InputError, match="not tensile"):
        support_answer(DEFAULT_LAW, size * (along - 1e-10 * across))


def test_no_load_is_not_tensile():
    for S in (np.zeros(3), np.array([-1.0, 0.0, -1.0]), np.array([1.0, 0.0, -1.0])):
        with pytest.raises(InputError, match="not tensile"):
            support_answer(DEFAULT_LAW, S)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_law_file_with_too_few_rows_is_refused(count, tmp_path):
    record, path = json.loads(DEFAULT_LAW.read_text(encoding="utf-8")), tmp_path / "law.json"
    rows = record["provenance"]["table_rows"]
    for key in ("S", "E", "unique"):
        rows[key] = rows[key][:count]
    path.write_text(json.dumps(record), encoding="utf-8")
    for asked in (("support", path, "--S", "1,0,0"), ("strain", path, "--alpha", "10", "--beta", "40")):
        refused(run(*asked), "the rows' loads")
