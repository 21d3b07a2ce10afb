"""Every weave that the command line offers goes the whole way: table, law, curtain, rings."""

import json

import numpy as np
import pandas as pd
import pytest

from rve import WEAVES
from tests.commands import run

SCENE = """
curtain = {width = 200.0, height = 150.0}
mesh = {cells = 6}
support = {kind = "corners", gather = 0.9}
"""


SLOW = ("4-in-1", "6-in-1", "8-in-1")


# The others take 3 to 20 minutes of processor time each.
@pytest.mark.parametrize(
    "weave", [pytest.param(name, marks=pytest.mark.slow if name in SLOW else pytest.mark.release) for name in WEAVES]
)
def test_every_weave_goes_from_its_table_to_the_rings(weave, tmp_path):
    rings = ["--r1", 5, "--r2", 0.5, "--weave", weave]
    (tmp_path / "scene.toml").write_text(SCENE)
    table, law, out = tmp_path / "table.csv", tmp_path / "law.json", tmp_path / "out"
    said = run("rve", "table", *rings, "--beta", "0:90:15", "--out", table)
    assert "Warning" not in said.stderr
    rows = pd.read_csv(table)
    assert set(rows.status) <= {"converged", "below"}
    assert (rows.status == "converged").mean() > 0.98
    rows = rows[rows.status == "converged"]
    turn = rows.alpha_deg.min() < 0.0
    assert turn != WEAVES[weave].is_mirrored  # a chiral weave is loaded to both sides
    run("homogenize", "fit", table, "--out", law)
    provenance = json.loads(law.read_text())["provenance"]
    assert provenance["table_rows"]["is_mirrored"] == WEAVES[weave].is_mirrored
    # Of a row and its mirror image, the law of a chiral weave holds the row alone.
    worst = rows[rows.unique == 1].iloc[rows[rows.unique == 1].E12.abs().argmax()]
    load = np.array([worst.S11, worst.S12, worst.S22])
    h = [
        json.loads(run("homogenize", "support", law, "--S", ",".join(map(str, S))).stdout)["h"]
        for S in (load, load * [1, -1, 1])
    ]
    assert h[0] == pytest.approx(load @ np.array([worst.E11, 2.0 * worst.E12, worst.E22]), abs=1e-6)
    assert (abs(h[0] - h[1]) < 1e-9) == WEAVES[weave].is_mirrored
    run("macro_fem", "run", tmp_path / "scene.toml", "--law", law, "--out", out, "--no-picture")
    summary = json.loads((out / "summary.json").read_text())
    assert summary["status"] == "converged"
    run("macro_fem", "localize", out, "--out", tmp_path / "rings", "--no-picture")
    found = json.loads((tmp_path / "rings" / "localize.json").read_text())
    assert found["links_intact"] > 0.95 * found["links"] > 0  # where the curtain folds, flat rings are drawn as a pile
    assert "stalled" not in found["cells_by_status"]
