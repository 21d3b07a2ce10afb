"""What a user meets in a notebook: the public roots from rings to a curtain, and what they return and refuse."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import homogenize
import macro_fem
import rve

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def table():
    return rve.solve_table(rve.Cell(r1=5, r2=0.5), rve.grid(15.0))


@pytest.fixture(scope="module")
def answer(table):
    scene = macro_fem.Scene.rectangle(200, 150, cells=8).hung_by("corners", gather=0.9)
    return macro_fem.solve(scene, homogenize.fit(table).law)


def test_the_table_is_that_of_the_command_line(table, tmp_path):
    frame = table.to_pandas()
    table.save(tmp_path / "table.csv")
    pd.testing.assert_frame_equal(frame, pd.read_csv(tmp_path / "table.csv"), check_dtype=False, rtol=0.0, atol=0.0)
    assert len(frame) == 28
    assert frame.attrs["r2_mm"] == 0.5
    equibiaxial = frame[(frame.alpha_deg == 15) & (frame.beta_deg == 45)].iloc[0]
    assert equibiaxial.x2_x_mm == pytest.approx(13.1163049, abs=2e-7)
    assert equibiaxial.x3_y_mm == pytest.approx(11.2301635, abs=2e-7)


def test_the_answer_balances_its_weight(answer, tmp_path):
    """Two corners carry the weight of the mesh, half each; the files say what the summary says."""
    assert answer.status == "converged"
    summary = answer.summary
    weight = summary["mass_kg"] * 9.81
    assert summary["mass_kg"] == pytest.approx(summary["areal_mass_kg_per_m2"] * 0.2 * 0.15, rel=1e-9)
    points = [point for support in summary["support_forces"] for point in support["points"]]
    assert [point["at_mm"] for point in points] == [[0.0, 150.0], [200.0, 150.0]]
    assert [point["force_N"][1] for point in points] == pytest.approx([0.5 * weight] * 2, rel=1e-6)
    answer.save(tmp_path / "out", picture=False)
    saved = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert saved["mean_height_mm"] == summary["mean_height_mm"]
    assert saved["files"].keys() == {"curtain.vtu", "support_forces.csv"}


def test_a_scene_from_python_is_that_of_a_file(answer, table, tmp_path):
    (tmp_path / "scene.toml").write_text(
        "[curtain]\nwidth = 200\nheight = 150\n[mesh]\ncells = 8\n[support]\nkind = 'corners'\ngather = 0.9\n"
    )
    again = macro_fem.solve(macro_fem.load_scene(tmp_path / "scene.toml"), homogenize.fit(table).law)
    assert again.summary["mean_height_mm"] == pytest.approx(answer.summary["mean_height_mm"], rel=1e-12)


def test_results_show_themselves_in_a_notebook(table, answer):
    assert "28 of 28 rows converged" in table._repr_html_()
    assert "mean_height_mm" in answer._repr_html_()
    assert "converged" in str(answer)


def test_a_curtain_draws_itself_on_given_axes(answer):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots()
    assert answer.plot(ax) is ax
    assert len(ax.collections) > 0
    plt.close(figure)


@pytest.mark.parametrize("step", [0.0, -5.0, 7.0, np.nan, 90.0])
def test_a_grid_that_misses_its_ends_is_refused(step):
    with pytest.raises(rve.InputError, match="must divide 45 degrees"):
        rve.grid(step)


def test_a_table_needs_a_cell_and_a_pair_of_angles():
    for arguments in (([0.0], [45.0]), (rve.Cell(), 45.0), (rve.Cell(), [0.0, 15.0, 30.0])):
        with pytest.raises(rve.InputError, match="a Cell and a pair of angles"):
            rve.solve_table(*arguments)


def test_what_a_scene_does_not_know_is_refused():
    with pytest.raises(rve.InputError, match="unknown"):
        macro_fem.Scene.rectangle(100, 100, colour="red")
    with pytest.raises(rve.InputError, match="corner"):
        macro_fem.Scene.rectangle(100, 100).hung_by("corner")
    with pytest.raises(rve.InputError, match="gather"):
        macro_fem.Scene.rectangle(100, 100).hung_by("corners", gather=-1.0)


def test_the_lines_of_the_readme_run():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    run = subprocess.run([sys.executable, "-c", block], cwd=ROOT, capture_output=True, text=True, check=True)
    assert float(run.stdout) == pytest.approx(420.26, abs=0.05)  # 3,584 cells: README's table of measured numbers
