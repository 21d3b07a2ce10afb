"""The example scenes are sound, and the default law of rings meets the exact curtains."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from homogenize import default_law
from macro_fem import load_scene, read_scene
from macro_fem.cli import main
from macro_fem.curtain import make_problem
from macro_fem.motion import scene_at
from macro_fem.scene import build_mesh
from tests.test_macro_fem.sheets import least_angle, sheet, solve_scene

EXAMPLES = sorted((Path(__file__).resolve().parents[2] / "examples").glob("*.toml"))
COARSER = ("facade_wind", "passage")
"""Examples that run on half the cells as well; tests/test_golden.py solves others on coarser meshes."""


@pytest.mark.parametrize("path", EXAMPLES, ids=[path.stem for path in EXAMPLES])
def test_example_makes_a_problem(path):
    scene, law = load_scene(path), default_law()
    scene = scene if scene.motion is None else scene_at(scene, 0.0)
    mesh = build_mesh(scene, law.cell)
    problem = make_problem(scene, law, mesh)
    assert problem.force[:, 1].sum() < 0.0
    assert problem.supports.mask.any()
    assert least_angle(mesh.mesh.p.T, mesh.mesh.t.T) > 15.0


@pytest.mark.parametrize(
    ("path", "coarser"),
    [
        *(pytest.param(path, 1, marks=pytest.mark.release) for path in EXAMPLES),
        *(pytest.param(path, 2, marks=pytest.mark.slow) for path in EXAMPLES if path.stem in COARSER),
    ],
    ids=lambda value: getattr(value, "stem", {1: "whole", 2: "half the cells"}.get(value)),
)
def test_example_runs(path, coarser, tmp_path):
    scene = tmp_path / path.name
    cells = re.compile(r"(?<=^cells = )\d+", re.MULTILINE)
    scene.write_text(cells.sub(lambda n: str(int(n[0]) // coarser), path.read_text("utf-8")))
    result = CliRunner().invoke(main, ["run", str(scene), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["status"] == "converged"
    if "reached_s" in summary:
        assert summary["reached_s"] == pytest.approx(summary["duration_s"])
        assert summary["account_error"] < 1e-8
        assert summary["relative_gap"] < 1e-6
        return
    assert summary["relative_gap"] < 1e-5
    total = np.array(summary["total_load_N"])
    held = sum(np.array(support["force_N"]) for support in summary["support_forces"])
    for obstacle in summary.get("obstacles", []):
        held = held + np.array(obstacle["reaction_N"])[: len(total)]
    assert np.abs(total + held).max() < 1e-3 * np.abs(total).max()
    if "bounds" in summary:
        assert 0.0 < summary["bounds"]["gap_over_load_times_height"] < 0.006


@pytest.mark.parametrize("support", [{"kind": "top"}, {"kind": "top", "gather": 0.8}], ids=["top", "gathered"])
@pytest.mark.parametrize("element", ["P1", "P2"])
def test_rings_hung_along_y_keep_their_height(element, support):
    solution = solve_scene(read_scene(sheet(1000.0, 1000.0, 6, support, {"element": element})), default_law())
    assert solution.status == "converged"
    assert solution.mean_height() == pytest.approx(500.0, abs=1e-5)
