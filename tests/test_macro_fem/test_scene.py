"""Scenes are read as written and refused in one sentence that names file, key and value."""

import json

import meshio
import numpy as np
import pytest
from click.testing import CliRunner

from homogenize import diagonal_net, ring_net
from macro_fem import load_scene, read_scene
from macro_fem.cli import main
from macro_fem.fem import signed_areas
from macro_fem.scene import build_mesh
from rve import InputError
from rve.geometry import CellInfo
from tests.test_macro_fem.sheets import sheet, solve_scene

SCENE = """
[curtain]
width = 100.0
height = 80.0
weave_angle = "y"
areal_mass = 2.785
[mesh]
cells = 6
element = "P1"
[support]
kind = "corners"
[load]
gravity = 9.81
[solver]
kind = "rigid"
"""


def tables(**changes):
    return sheet(100.0, 80.0, 4, {"kind": "top"}, areal_mass=1.0) | changes


@pytest.fixture
def law_file(tmp_path):
    path = tmp_path / "law.json"
    diagonal_net(1.1).save(path)
    return path


def run(tmp_path, text, *options):
    scene = tmp_path / "scene.toml"
    scene.write_text(text, encoding="utf-8")
    out = tmp_path / "out"
    result = CliRunner().invoke(main, ["run", str(scene), "--out", str(out), "--no-picture", *options])
    return result, out


def test_a_scene_becomes_summary_and_vtu(tmp_path, law_file):
    """Points are the reference, which Warp By Vector takes to the curtain; the file is a mesh that hangs alike."""
    result, out = run(tmp_path, SCENE, "--law", str(law_file), "--explain")
    assert result.exit_code == 0, result.output
    summary = json.loads((out / "summary.json").read_text())
    assert all(one["feature"] in result.output for one in summary["features"])
    assert summary["status"] == "converged"
    assert summary["potential_dual_N_mm"] <= summary["potential_primal_N_mm"]
    weight = 2.785e-6 * 9.81 * 100.0 * 80.0
    assert summary["support_forces"][0]["force_N"] == pytest.approx([0.0, weight], abs=1e-4 * weight)
    assert {p.name for p in out.iterdir()} == {"summary.json", "support_forces.csv", "order.csv", "curtain.vtu"}
    picture = meshio.read(out / "curtain.vtu")
    assert len(picture.cells_dict["triangle"]) == summary["cells"]
    assert (picture.points.min(axis=0).tolist(), picture.points.max(axis=0).tolist()) == ([0, 0, 0], [100, 80, 0])
    moved = picture.point_data["displacement_mm"]
    assert np.linalg.norm(moved, axis=1).max() == pytest.approx(summary["max_displacement_mm"])
    assert (picture.points + moved)[:, 1].min() == pytest.approx(summary["lowest_point_mm"], abs=1e-9)
    curtain = {"shape": "file", "file": "out/curtain.vtu", "areal_mass": 2.785}
    again = read_scene({"curtain": curtain, "support": {"kind": "corners"}}, tmp_path / "scene.toml")
    assert solve_scene(again, diagonal_net(1.1)).mean_height() == pytest.approx(summary["mean_height_mm"], abs=1e-4)


def test_load_steps_make_a_series(tmp_path, law_file):
    text = SCENE.replace("gravity = 9.81", 'gravity = 9.81\nsteps = 3\nedge = {edge = "bottom", force = [0.001, 0.0]}')
    result, out = run(tmp_path, text, "--law", str(law_file))
    assert result.exit_code == 0, result.output
    series = [f"curtain_{k:04d}.vtu" for k in (1, 2, 3)]
    assert {p.name for p in out.glob("curtain*")} == {"curtain.vtu", "curtain.pvd", *series}
    steps = json.loads((out / "summary.json").read_text())["steps"]
    assert [step["factor"] for step in steps] == pytest.approx([1 / 3, 2 / 3, 1.0])
    pulls = [meshio.read(out / f"curtain_{k:04d}.vtu").point_data["displacement_mm"][:, 0].mean() for k in (1, 2, 3)]
    assert pulls[0] < pulls[1] < pulls[2]


def test_a_solver_that_gives_up_says_so(tmp_path, law_file):
    result, out = run(tmp_path, SCENE + "max_iterations = 2\n", "--law", str(law_file))
    assert result.exit_code == 1
    assert "raise solver.max_iterations" in result.output
    assert json.loads((out / "summary.json").read_text())["status"] == "iterations"


def test_supports_at_the_limit_end_in_an_answer_and_exit_code_1(tmp_path):
    ring_net(CellInfo(5.0, 0.5, 11.0, 12.646069623526, 2.785)).save(tmp_path / "net.json")
    toml = SCENE.replace("height = 80.0", "height = 100.0").replace('"corners"', '"top"\ngather = 1.6363636363636365')
    result, out = run(tmp_path, toml, "--law", str(tmp_path / "net.json"))
    assert result.exit_code == 1
    assert result.output.startswith("taut: the supports are as far apart as the mesh can stretch")
    assert json.loads((out / "summary.json").read_text())["status"] == "taut"
    assert (out / "curtain.vtu").is_file()


def test_an_areal_mass_must_come_from_somewhere():
    with pytest.raises(InputError, match="areal_mass"):
        solve_scene(read_scene(tables(curtain={"width": 10.0, "height": 10.0})), diagonal_net())


def test_outline_with_a_hole_has_its_area_and_edges(tmp_path):
    text = """
[curtain]
shape = "outline"
outline = [[0, 0], [100, 0], [100, 60], [50, 100], [0, 60]]
holes = [[[40, 30], [60, 30], [60, 50], [40, 50]]]
areal_mass = 1.0
[mesh]
cells = 14
[support]
kind = "edge"
edge = "hole 1"
"""
    path = tmp_path / "scene.toml"
    path.write_text(text)
    mesh = build_mesh(load_scene(path), None)
    p, t = mesh.mesh.p, mesh.mesh.t
    area = np.abs(signed_areas(p.T[t.T]))
    assert area.min() > 0.0
    assert area.sum() == pytest.approx(6000.0 + 2000.0 - 400.0)
    lengths = {
        name: np.hypot(*(p[:, mesh.mesh.facets[1, f]] - p[:, mesh.mesh.facets[0, f]])).sum()
        for name, f in mesh.edges.items()
    }
    assert lengths["hole 1"] == pytest.approx(80.0)
    assert lengths["bottom"] == pytest.approx(100.0)
    assert lengths["top"] == pytest.approx(2.0 * np.hypot(50.0, 40.0))  # both slopes of the gable
    assert solve_scene(load_scene(path), diagonal_net(1.1)).status == "converged"


def write_mesh(tmp_path, points, cells):
    flat = np.column_stack([points, np.zeros(len(points))])
    kind = "quad" if len(cells[0]) == 4 else "triangle"
    meshio.Mesh(flat, [(kind, np.array(cells))]).write(tmp_path / "mesh.vtu")
    curtain = {"shape": "file", "file": "mesh.vtu", "areal_mass": 1.0}
    return read_scene({"curtain": curtain, "support": {"kind": "top"}}, tmp_path / "scene.toml")


SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
BAD_HOLES = (
    ([[[40, 30], [160, 30], [60, 50]]], "Self-intersection.100 42"),
    ([[[140, 30], [160, 30], [160, 50]]], "Hole lies outside"),
    ([[[40, 30], [60, 50], [60, 30], [40, 50]]], "Self-intersection.50 40., mm"),
    ([[[40, 30], [50, 30], [60, 30]]], "Self-intersection"),
    ([[[40, 30], [60, 30], [50, 50]], [[45, 32], [70, 32], [50, 60]]], "Self-intersection"),
    ([[[40, 30], [60, 30], [60, 30], [50, 50]]], "two equal corners in a row"),
    ([[[0, 30], [60, 30], [50, 50]]], "closer to each other"),
)


@pytest.mark.parametrize(("holes", "words"), BAD_HOLES)
def test_bad_outlines_are_explained(holes, words):
    outline = {"shape": "outline", "outline": [[0, 0], [100, 0], [100, 100], [0, 100]], "areal_mass": 1.0}
    with pytest.raises(InputError, match=words):
        build_mesh(read_scene(tables(curtain=outline | {"holes": holes}, mesh={"cells": 12})), None)


def test_a_piece_that_hangs_on_nothing_is_found(tmp_path):
    points = np.concatenate([SQUARE, SQUARE - [0.0, 3.0]])
    scene = write_mesh(tmp_path, points, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    with pytest.raises(InputError, match=r"nothing holds the piece around \(0.5, -2.5\)"):
        solve_scene(scene, diagonal_net())


def test_a_mesh_file_gives_what_its_rectangle_gives(tmp_path):
    rectangle = build_mesh(read_scene(tables()), None)
    points, cells = rectangle.mesh.p.T, rectangle.mesh.t.T.copy()
    clockwise = signed_areas(points[cells]) < 0.0
    cells[clockwise] = cells[clockwise, ::-1]
    scene = write_mesh(tmp_path, points, cells)
    from_file = solve_scene(scene, diagonal_net(1.1))
    assert from_file.mean_height() == pytest.approx(solve_scene(read_scene(tables()), diagonal_net(1.1)).mean_height())


def test_a_run_does_not_overwrite_its_law_or_mesh_file(tmp_path, law_file):
    result, out = run(tmp_path, SCENE, "--law", str(law_file))
    assert result.exit_code == 0, result.output
    before = {p.name: p.read_bytes() for p in out.iterdir()}
    shape = SCENE.replace("width = 100.0", 'shape = "file"\nfile = "out/curtain.vtu"').replace("height = 80.0\n", "")
    shape = shape.replace("cells = 6\n", "")
    again, _ = run(tmp_path, shape, "--law", str(law_file))
    assert again.exit_code == 2
    assert "curtain.vtu: would overwrite" in again.stderr
    law = run(tmp_path, SCENE, "--law", str(out / "summary.json"))[0]
    assert law.exit_code == 2
    assert "would overwrite" in law.stderr
    assert {p.name: p.read_bytes() for p in out.iterdir()} == before
