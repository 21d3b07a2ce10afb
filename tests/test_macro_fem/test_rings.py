"""A scene ring by ring, and beside its membrane."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from macro_fem import read_scene
from macro_fem.cli import main
from macro_fem.compare import side_by_side
from macro_fem.every_ring import ring_scene
from rve import InputError

B_X, B_Y = 11.0, 12.646069623526


def scene(columns=3, rows=2, **tables):
    curtain = {"width": columns * B_X, "height": rows * B_Y}
    return read_scene({"curtain": curtain, "mesh": {"cells": 8}, "support": {"kind": "corners"}} | tables)


def toml(path, columns=3, rows=2, extra=""):
    text = f'[curtain]\nwidth = {columns * B_X}\nheight = {rows * B_Y}\n[mesh]\ncells = 8\n[support]\nkind = "top"\n'
    path.write_text(text + extra)
    return path


def test_corners_hold_the_corner_rings_and_the_weight_is_that_of_the_area():
    rings = ring_scene(scene(support={"kind": "corners", "gather": 0.9}))
    (name, held), *rest = rings.groups
    assert (name, rest) == ("corners", [])
    assert sorted(map(tuple, rings.mesh.X[held].round(6))) == [(0.0, round(2 * B_Y, 6)), (33.0, round(2 * B_Y, 6))]
    assert sorted(rings.at[held, 0].round(6)) == [round(16.5 - 0.45 * 33, 6), round(16.5 + 0.45 * 33, 6)]
    assert rings.held.sum() == 6
    assert rings.force[:, 1].sum() == pytest.approx(-9.81 * rings.mesh.mass.sum(), rel=1e-4)


def test_live_loads_and_edges_reach_the_rings():
    loads = {
        "gravity": 0.0,
        "edge": {"edge": "bottom", "force": [0.0, -0.01]},
        "point": {"at": [16.5, B_Y], "force": [0.3, -0.2]},
    }
    rings = ring_scene(scene(load=loads, support=[{"kind": "top"}, {"kind": "edge", "edge": "left", "held": "x"}]))
    assert rings.force.sum(axis=0) == pytest.approx([0.3, -0.2 - 0.33, 0.0])
    bottom = np.isclose(rings.mesh.X[:, 1], 0.0)
    assert rings.force[bottom, 1].sum() == pytest.approx(-0.33)
    names = [name for name, _ in rings.groups]
    assert names == ["top", "edge left"]
    assert [len(held) for _, held in rings.groups] == [4, 2]


def test_rings_writes_its_files_and_the_numbers_agree(tmp_path):
    path, out = toml(tmp_path / "scene.toml", 2, 1), tmp_path / "out"
    result = CliRunner().invoke(main, ["rings", str(path), "--out", str(out), "--plane", "--html"])
    assert result.exit_code == 0, result.output
    summary = json.loads((out / "summary.json").read_text())
    assert summary["status"] == "converged"
    assert summary["rings"] == 8
    assert summary["links_intact"] is True
    assert summary["min_gap_mm"] >= -1e-9
    assert summary["kkt_residual"] <= 1e-8
    assert summary["wall_s"] > 0.0
    assert summary["depth_mm"] == 0.0
    # potential = weight times the loss of height, for a load of weight alone
    weight = -summary["total_load_N"][1]
    assert summary["potential_N_mm"] == pytest.approx(weight * (summary["mean_height_mm"] - 0.5 * B_Y), rel=1e-6)
    assert summary["support_forces"][0]["sum_N"][1] == pytest.approx(weight, rel=1e-6)
    assert sorted(file.name for file in out.iterdir()) == ["rings.html", "rings.png", "rings.vtu", "summary.json"]


def test_the_disk_guides_the_rings_to_an_equilibrium_of_the_same_scene(tmp_path):
    path = toml(tmp_path / "scene.toml", 3, 2)
    answers = {}
    for start in ("slack", "disk"):
        out = tmp_path / start
        words = ["rings", str(path), "--out", str(out), "--plane", "--start", start, "--no-picture"]
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 0, result.output
        answers[start] = json.loads((out / "summary.json").read_text())
        assert answers[start]["start"] == start
    slack, disk = answers["slack"], answers["disk"]
    assert disk["kkt_residual"] < 1e-8
    assert disk["links_intact"]
    assert disk["mean_height_mm"] == pytest.approx(slack["mean_height_mm"], rel=5e-3)
    assert disk["total_load_N"] == slack["total_load_N"]


def test_places_of_the_disk_are_those_of_its_nodes():
    from macro_fem.job import solve

    solution = solve(scene()).solution
    nodes = solution.problem.disc.nodes
    assert solution.places(nodes)[:, :2] == pytest.approx(solution.x, abs=1e-9)
    beside = solution.places(nodes[:1] - 1e-3)
    assert beside.shape == (1, 3)
    assert np.isfinite(beside).all()


def test_supports_out_of_reach_are_said_to_be_so(tmp_path):
    path, out = tmp_path / "scene.toml", tmp_path / "out"
    size = f"[curtain]\nwidth = {B_X}\nheight = {B_Y}\n[mesh]\ncells = 8\n"
    path.write_text(size + '[[support]]\nkind = "corners"\ngather = 3.0\n')
    result = CliRunner().invoke(main, ["rings", str(path), "--out", str(out), "--plane"])
    assert result.exit_code == 1, result.output
    assert "mm from their places" in result.output
    assert "nan" not in result.output
    summary = json.loads((out / "summary.json").read_text())
    assert summary["status"] == "out-of-reach"
    assert summary["kkt_residual"] is None
    assert summary["largest_contact_force_N"] is None
    assert summary["support_forces"][0]["sum_N"] is None
    assert summary["way_left_mm"] > 1.0
    assert (out / "rings.png").exists()


def test_compare_puts_both_side_by_side(tmp_path):
    path, out = toml(tmp_path / "scene.toml"), tmp_path / "both.json"
    result = CliRunner().invoke(main, ["compare", str(path), "--plane", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "mean_height_mm" in result.output
    summary = json.loads(out.read_text())
    disk, rings = summary["disk"], summary["rings"]
    for one in (disk, rings):
        assert one["status"] == "converged"
    # hung along the grain: the membrane keeps its height, the rings nearly do
    assert disk["mean_height_mm"] == pytest.approx(B_Y, rel=1e-6)
    assert rings["mean_height_mm"] == pytest.approx(B_Y, rel=0.02)
    assert rings["mean_height_mm"] < disk["mean_height_mm"]
    assert rings["support_forces_N"][0][1] == pytest.approx(disk["support_forces_N"][0][1], rel=1e-4)
    assert 0.0 < summary["shape_distance_mm"] < 2.0
    assert summary["line_load_distance"] < 0.3


def test_forces_out_of_the_plane_are_shown():
    keys = ("status", "unknowns", "potential_N_mm", "mean_height_mm", "lowest_point_mm")
    disk = dict.fromkeys(keys, 1.0) | {"support_forces_N": [[1.0, 2.0], [0.5, 0.25, -3.0]], "wall_s": 0.1}
    rings = disk | {"support_forces_N": [[1.0, 2.0, 1e-12], None]}
    lines = side_by_side({"disk": disk, "rings": rings, "apart": 0.25})
    forces = next(line for line in lines if line.startswith("support_forces_N"))
    assert forces.split() == ["support_forces_N", *["1", "2;", "0.5", "0.25", "-3"], *["1", "2;", "-"]]
    assert lines[-1] == "apart: 0.25"


def test_rings_lie_on_the_floor_and_against_the_wall_of_a_scene():
    floor = {"kind": "floor", "height": -8.0, "move": [0.0, 4.0]}
    wall = {"kind": "wall", "facing": [3.0, 0.0], "point": [-7.0, 0.0]}
    rings = ring_scene(scene(2, 1, support={"kind": "top"}, obstacle=[floor, wall]))
    found = rings.solve(space=False)
    assert found.status == "converged"
    for m, offset in (([0.0, 1.0, 0.0], -4.0), ([1.0, 0.0, 0.0], -7.0)):
        lowest = found.centre @ m - 5.0 * np.sqrt(1.0 - (found.normal @ m) ** 2) - 0.5
        assert lowest.min() > offset - 1e-6
    # the floor carries a part of the weight, the top the rest
    weight = 9.81 * rings.mesh.mass.sum()
    assert 0.01 * weight < found.wall_force[0, 1] < weight
    total = found.load.sum(axis=0) + found.reaction.sum(axis=0) + found.wall_force.sum(axis=0)
    assert total == pytest.approx(np.zeros(3), abs=1e-6 * weight)


@pytest.mark.parametrize(
    ("tables", "says"),
    [
        ({"load": {"bar": {"mass": 1.0}}}, "straight = false"),
        ({"load": {"gravity": 0.0}}, "no load"),
        ({"obstacle": [{"kind": "sphere", "centre": [0.0, 0.0, -20.0], "radius": 9.0}]}, "floors and walls"),
        ({"curtain": {"width": 5.0, "height": 3.0}}, "rings"),
        ({"curtain": {"width": 1e5, "height": 1e5}}, "make it smaller"),
    ],
)
def test_what_rings_cannot_do_is_refused_in_a_sentence(tables, says):
    with pytest.raises(InputError, match=says) as error:
        ring_scene(scene(**tables)).solve(space=False)
    assert "\n" not in str(error.value)
