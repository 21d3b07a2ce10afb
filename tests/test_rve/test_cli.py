"""The command line as a user types it: exit codes, one sentence, nothing half-written."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from homogenize import fit_table
from homogenize.fitting import normality, rows_from_table
from rve import read_table
from rve.cli import main


def run(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


def test_table_and_loads(tmp_path):
    out = tmp_path / "t.csv"
    result = run("table", "--out", out, "--alpha", "-10:10:10", "--beta", "30,60")
    assert result.exit_code == 0, result.output
    frame = pd.read_csv(out)
    angles = frame[["alpha_deg", "beta_deg"]].to_numpy().tolist()
    assert angles == [[a, b] for a in (-10.0, 0.0, 10.0) for b in (30.0, 60.0)]
    assert "6 of 6 rows converged" in result.output
    loads = tmp_path / "loads.csv"
    loads.write_text("alpha_deg,beta_deg\n10,60\n")
    assert run("table", "--out", tmp_path / "u.csv", "--loads", loads).exit_code == 0
    one = pd.read_csv(tmp_path / "u.csv")
    assert one.loc[0, "E11"] == pytest.approx(frame.loc[5, "E11"], abs=1e-10)
    provenance = json.loads((tmp_path / "u.json").read_text())
    assert {"r1_mm", "r2_mm", "method", "options", "versions", "wall_s"} <= provenance.keys()


@pytest.mark.slow
def test_a_chiral_weave_is_loaded_to_both_sides_and_its_rows_have_no_images(tmp_path):
    """The default grid covers all loads: (alpha, beta) is (alpha + 90, 90 - beta), so alpha runs from -40 to 45."""
    out = tmp_path / "six.csv"
    result = run("table", "--weave", "6-in-1", "--beta", "0,50", "--out", out)
    assert result.exit_code == 0, result.output
    rows = pd.read_csv(out)
    assert sorted(set(rows.alpha_deg)) == list(range(-40, 46, 5))
    assert set(rows.branch) <= {"slack", "restart", "coexisting"}
    record = json.loads(out.with_suffix(".json").read_text())
    assert record["weave"] == "6-in-1"
    assert record["branches"].keys() == {"maximum_by", "several_states", "wall_s"}
    assert len(record["branches"]["several_states"]) == (rows.branch != "slack").sum()
    law = fit_table(out).law
    image = law.support(rows[["S11", "S12", "S22"]].to_numpy() * [1.0, -1.0, 1.0])
    h = (rows.S11 * rows.E11 + 2.0 * rows.S12 * rows.E12 + rows.S22 * rows.E22).to_numpy()
    assert law.support(rows[["S11", "S12", "S22"]].to_numpy()) == pytest.approx(h, abs=1e-9)
    assert np.abs(image - h).max() > 0.1
    with_images = replace(rows_from_table(read_table(out)), is_mirrored=True)
    assert normality(with_images).slack < -0.1  # what the images of a chiral weave would contradict


def test_case_prints_json_and_draws(tmp_path):
    picture = tmp_path / "case.png"
    result = run("case", "--alpha", "0", "--beta", "45", "--plot", picture)
    assert result.exit_code == 0, result.output
    found = json.loads(result.output)
    assert found["x2_x_mm"] == pytest.approx(13.1163049, abs=1e-6)
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert run("case", "--alpha", "0", "--beta", "45", "--plot", tmp_path / "bare").exit_code == 0
    assert (tmp_path / "bare").read_bytes()[:4] == b"\x89PNG"
    assert {path.name for path in tmp_path.iterdir()} == {"case.png", "bare"}
