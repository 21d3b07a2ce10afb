"""The whole chain, as the README runs it, on a coarse curtain."""

import json

import pandas as pd
import pytest

from examples.curtain import Setting, run
from examples.which_wire import run as run_wires
from macro_fem import read_scene
from rve import Cell, Material, solve_table, with_rings
from tests.test_macro_fem.sheets import sheet

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """Folder and answer of examples/curtain.py with 4 and 8 cells along the width."""
    out = tmp_path_factory.mktemp("chain")
    return out, run(out, Setting(5.0, (4, 8)))


def test_every_file_and_picture_is_there(chain):
    out, _ = chain
    assert len(pd.read_csv(out / "table.csv")) == 190
    assert json.loads((out / "law.json").read_text())
    for picture in ("cell.png", "law/surface.png", "curtain/curtain.png"):
        assert (out / picture).stat().st_size > 10_000
    assert (out / "curtain" / "curtain.vtu").exists()


def test_the_curtain_is_what_its_summary_says(chain):
    out, answer = chain
    summary = json.loads((out / "curtain" / "summary.json").read_text())
    assert summary["status"] == "converged"
    assert json.loads((out / "answer.json").read_text())["mean_height_mm"] == answer["mean_height_mm"]
    # Primal and dual value bracket the potential, -weight times mean height up to the reference level.
    assert summary["potential_dual_N_mm"] <= summary["potential_primal_N_mm"] + 1e-9
    assert 0 < summary["relative_gap"] < 1e-4
    # Bounds of the continuous problem by another element (examples/corner_hung.toml) hold the mean height.
    assert 415.35 < summary["mean_height_mm"] < 420.36
    assert 415.35 < answer["mean_height_mm"] < summary["mean_height_mm"]
    assert summary["total_load_N"][1] == pytest.approx(-27.32, abs=0.01)


def test_the_factor_of_a_wire_is_that_of_its_table_row(tmp_path):
    """A weightless strip bears a bar and is free to narrow, so that it is pulled along the grain alone, where the
    reference cell locks: 600 over the strength of the row times the load."""
    load, solver = {"bar": {"mass": 2.0}}, {"kind": "rigid", "stabilising_tension": 0.0}
    strip = read_scene(sheet(100.0, 150.0, 4, {"kind": "rail"}, (), load, solver, areal_mass=0.0))
    metal = Material(yield_N_per_mm2=600.0, ultimate_N_per_mm2=None)
    answer = run_wires(strip, 5.0, [1.0, 1.2], metal, 30.0, tmp_path / "wires")
    for one in answer["wires"]:
        assert one["too_low"] is None  # an even load is its own average on any mesh
        cell = Cell(5.0, 0.5 * one["diameter_mm"])
        row = with_rings(solve_table(cell, ([0.0], [90.0])), cell)
        assert one["safety_factor"] == pytest.approx(600.0 / (2.0 * 9.81 / 100.0 * row.strength[0, 0]), rel=1e-4)
        assert one["collapse_factor"] == pytest.approx(600.0 / (2.0 * 9.81 / 100.0 * row.strength[0, 1]), rel=1e-4)
    thin, thick = (one["safety_factor"] for one in answer["wires"])
    assert thin < 30.0 < thick
    assert 1.0 < answer["least_diameter_mm"] < 1.2
    written = json.loads((tmp_path / "wires" / "wires.json").read_text())
    assert {key: written[key] for key in answer} == answer
    assert len(pd.read_csv(tmp_path / "wires" / "wires.csv")) == 2
    assert (tmp_path / "wires" / "wires.png").stat().st_size > 10_000
