"""One material from the command line to the weight of the curtain: table, law, scene, summary."""

import json
import math

import pytest

from homogenize import load_law
from tests.commands import run

TITANIUM = 4506.0  # kg/m3
B_X, B_Y = 11.0, 12.646069623526  # mm, r1 = 5, r2 = 0.5, DESIGN section 2
AREAL_MASS = TITANIUM * 2.0 * (2.0 * math.pi**2 * 5.0 * 0.5**2) / (B_X * B_Y) * 1e-3  # kg/m2: two tori in a cell
SCENE = 'curtain = {width = 300.0, height = 200.0}\nmesh = {cells = 4}\nsupport = {kind = "top"}\n'


@pytest.mark.slow
def test_one_density_from_the_command_line_to_the_weight_of_the_curtain(tmp_path):
    table, law, scene, out = (tmp_path / name for name in ("table.csv", "law.json", "scene.toml", "out"))
    run("rve", "table", "--out", table, "--density", TITANIUM, "--alpha", "0:45:15", "--beta", "0:90:15")
    sidecar = json.loads(table.with_suffix(".json").read_text())
    assert sidecar["density_kg_per_mm3"] == pytest.approx(4.506e-6, rel=1e-12)
    assert sidecar["areal_mass_kg_per_m2"] == pytest.approx(AREAL_MASS, rel=1e-6)
    run("homogenize", "fit", table, "--out", law)
    assert load_law(law).cell.areal_mass_kg_per_m2 == pytest.approx(AREAL_MASS, rel=1e-6)
    scene.write_text(SCENE)
    run("macro_fem", "run", scene, "--law", law, "--out", out, "--no-picture")
    summary = json.loads((out / "summary.json").read_text())
    assert summary["areal_mass_kg_per_m2"] == pytest.approx(AREAL_MASS, rel=1e-6)
    assert summary["mass_kg"] == pytest.approx(AREAL_MASS * 0.3 * 0.2, rel=1e-6)
    assert summary["total_load_N"] == pytest.approx([0.0, -9.81 * AREAL_MASS * 0.06], rel=1e-6)
    assert "areal_mass_kg_per_m2" not in summary["rings"]
