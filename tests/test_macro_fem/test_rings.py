"""A scene ring by ring, and beside its membrane."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import macro_fem
from homogenize import FitOptions, fit, fit_table
from macro_fem import read_scene
from macro_fem.cli import main
from macro_fem.rings import memory_GB, ring_cost, ring_scene
from macro_fem.scene import ring_solidity
from rve import Cell, DirectOptions, InputError, grid, reference_cell, solidity, solve_table
from rve.finite import FiniteOptions

B_X, B_Y = 11.0, 12.646069623526


def scene(columns=3, rows=2, sides=(B_X, B_Y), **tables):
    curtain = {"width": columns * sides[0], "height": rows * sides[1]}
    return read_scene({"curtain": curtain, "mesh": {"cells": 8}, "support": {"kind": "corners"}} | tables)


def toml(path, columns=3, rows=2, extra=""):
    text = f'[curtain]\nwidth = {columns * B_X}\nheight = {rows * B_Y}\n[mesh]\ncells = 8\n[[support]]\nkind = "top"\n'
    path.write_text(text + extra)
    return path


def test_corners_hold_the_corner_rings_and_the_weight_is_that_of_the_area():
    rings = ring_scene(scene(support={"kind": "corners", "gather": 0.9}, material={"material": "titanium grade 2"}))
    (name, held), *rest = [(name, held.all(axis=1)) for name, held in rings.groups]
    assert (name, rest) == ("corners", [])
    assert sorted(map(tuple, rings.mesh.X[held].round(6))) == [(x, round(2 * B_Y, 6)) for x in (0.0, 33.0)]
    assert sorted(rings.at[held, 0].round(6)) == [round(16.5 - 0.45 * 33, 6), round(16.5 + 0.45 * 33, 6)]
    assert rings.held.sum() == 6
    assert rings.force[:, 1].sum() == pytest.approx(-9.81 * rings.mesh.mass.sum(), rel=1e-9)


def test_rings_of_two_sizes_are_counted_and_each_has_its_own_weight():
    cell = Cell(5.0, 0.5, "japanese-4-in-1")
    rings = ring_scene(scene(12, 9, reference_cell(cell).sides_mm), cell)
    assert rings.force[:, 1] == pytest.approx(-9.81 * rings.mesh.mass, rel=1e-9)
    assert set(rings.mesh.sizes[0]) == {1.0, 0.5}
    assert ring_cost(rings.scene, rings.info).rings == pytest.approx(len(rings.mesh.X), rel=0.12)


def test_live_loads_and_edges_reach_the_rings():
    loads = {
        "gravity": 0.0,
        "edge": {"edge": "bottom", "force": [0.0, -0.01]},
        "point": {"at": [16.5, B_Y], "force": [0.3, -0.2]},
    }
    rings = ring_scene(scene(load=loads, support=[{"kind": "top"}, {"kind": "edge", "edge": "left", "held": "x"}]))
    assert rings.force.sum(axis=0) == pytest.approx([0.3, -0.2 - 0.33, 0.0])
    bottom, middle = (np.isclose(rings.mesh.X[:, 1], y) for y in (0.0, B_Y))
    assert rings.force[bottom, 1].sum() == pytest.approx(-0.33)
    assert rings.force[middle, 0] == pytest.approx([0.0, 0.15, 0.15, 0.0])  # the pull is half-way between two rings
    count = {name: held.sum(axis=0).tolist() for name, held in rings.groups}
    assert count == {"top": [4, 4, 4], "edge left": [3, 0, 3]}


@pytest.mark.slow
def test_a_law_of_the_locked_reference_answers_to_rings_wind_and_every_ring():
    """r1/r2 = 50, where the longest cell is 30 % narrower than that of rings side by side: each has its own scene of
    the same rings between the same places. The table was written by version 0.2."""
    data = Path(__file__).parents[1] / "test_homogenize" / "data" / "version_0_2"
    law = fit_table(data / "table.csv", FitOptions("inner")).law
    cell, locked = law.cell.cell(), DirectOptions(reference="locked")
    beside = reference_cell(cell)
    assert beside.b_y_mm > 1.4 * law.cell.b_y_mm

    def hung(info, gather, **load):
        return scene(4, 3, info.sides_mm, support={"kind": "top", "gather": gather}, **load)

    answer = macro_fem.solve(hung(law.cell, 0.9, load={"wind": {"direction": [0, 0, 1], "speed": 8.0}}), law)
    assert (answer.summary["order"]["weave"], answer.summary["reference_cell"]) == ("4-in-1", "locked")
    field = answer.rings()  # the strains of an inner law are those of rings
    assert field.summary["cells_by_status"] == {"met": len(field.states.E)}
    assert field.summary["largest_strain_short"] < 1e-5
    assert ring_solidity(law.cell) == pytest.approx(solidity(cell, locked), rel=1e-9)
    assert ring_solidity(law.cell) > 1.3 * ring_solidity(beside)
    scenes = (hung(law.cell, 0.9 * beside.b_x_mm / law.cell.b_x_mm), law), (hung(beside, 0.9), cell)
    one, other = (macro_fem.solve(scene, macro_fem.EveryRing(rings, space=False)).summary for scene, rings in scenes)
    assert one["largest_contact_force_N"] == pytest.approx(other["largest_contact_force_N"], rel=1e-6)
    drop = [found["lowest_point_mm"] - 3 * info.b_y_mm for found, info in ((one, law.cell), (other, beside))]
    assert drop[0] == pytest.approx(drop[1], abs=1e-6)


@pytest.mark.slow
def test_rings_writes_its_files_and_the_numbers_agree(tmp_path):
    path, out = toml(tmp_path / "scene.toml", 2, 1), tmp_path / "out"
    result = CliRunner().invoke(main, ["rings", str(path), "--out", str(out), "--plane", "--html"])
    assert result.exit_code == 0, result.output
    summary = json.loads((out / "summary.json").read_text())
    assert summary["status"] == "converged"
    assert summary["ring_count"] == 8
    assert summary["links_intact"] is True
    assert summary["min_gap_mm"] >= -1e-9
    assert summary["kkt_residual"] <= 1e-8
    assert summary["wall_s"] > 0.0
    assert summary["depth_mm"] == 0.0
    # potential = weight times the loss of height, for a load of weight alone
    weight = -summary["total_load_N"][1]
    assert summary["potential_N_mm"] == pytest.approx(weight * (summary["mean_height_mm"] - 0.5 * B_Y), rel=1e-6)
    assert summary["support_forces"][0]["force_N"][1] == pytest.approx(weight, rel=1e-6)
    written = {"rings.html", "rings.png", "rings.vtu", "summary.json", "support_forces.csv"}
    assert {file.name for file in out.iterdir()} == written


@pytest.mark.slow
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


@pytest.mark.slow
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
    assert summary["support_forces"][0]["force_N"] is None
    assert summary["way_left_mm"] > 1.0
    assert (out / "rings.png").exists()


def test_compare_puts_both_side_by_side(tmp_path):
    again = "[[support]]\nkind = 'edge'\nedge = 'top'\nheld = 'y'\n[solver]\nmax_iterations = 401\n"
    path, out = toml(tmp_path / "scene.toml", extra=again), tmp_path / "both.json"
    result = CliRunner().invoke(main, ["compare", str(path), "--plane", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "mean_height_mm" in result.output
    assert "[solver] max_iterations: has no effect on every ring" in result.output
    summary = json.loads(out.read_text())
    disk, rings = summary["disk"], summary["rings"]
    for one in (disk, rings):
        assert (one["status"], max(map(abs, one["support_forces_N"][1]))) == ("converged", 0.0)
    # hung along the grain: the membrane keeps its height, the rings nearly do
    assert disk["mean_height_mm"] == pytest.approx(B_Y, rel=1e-6)
    assert rings["mean_height_mm"] == pytest.approx(B_Y, rel=0.02)
    assert rings["mean_height_mm"] < disk["mean_height_mm"]
    assert rings["support_forces_N"][0][1] == pytest.approx(disk["support_forces_N"][0][1], rel=1e-4)
    assert 0.0 < summary["shape_distance_mm"] < 2.0
    assert summary["line_load_distance"] < 0.3


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
        ({"load": {"bar": {"edge": "left", "mass": 1.0}}}, "is held, or has a second bar"),
        ({"load": {"gravity": 0.0}}, "no load"),
        ({"obstacle": [{"kind": "sphere", "centre": [0.0, 0.0, -20.0], "radius": 9.0}]}, "floors and walls"),
        ({"curtain": {"width": 5.0, "height": 3.0}}, "did you mean 5000"),
        ({"curtain": {"width": 1e5, "height": 1e5}}, "make it smaller"),
    ],
)
def test_what_rings_cannot_do_is_refused_in_a_sentence(tables, says):
    with pytest.raises(InputError, match=says) as error:
        ring_scene(scene(**tables)).solve(space=False)
    assert "\n" not in str(error.value)


HOLE = [[[60, 60], [160, 60], [160, 160], [60, 160]]]
TILTED = {"shape": "outline", "outline": [[0, 0], [300, 20], [280, 260], [0, 240]], "holes": HOLE, "weave_angle": 30.0}


@pytest.mark.parametrize("curtain", [{"shape": "disk", "radius": 150.0}, TILTED, {"width": 330.0, "height": 252.9}])
def test_rings_are_counted_before_they_are_made(curtain):
    """By area: of the rings of the rim, whose cells are partly outside, some are too many or too few."""
    told = ring_scene(scene(curtain=curtain))
    cost = ring_cost(told.scene, told.info)
    assert cost.rings == pytest.approx(len(told.mesh.X), rel=0.06)
    assert str(cost).startswith(f"{cost.rings:,} rings, some ")


def test_rings_that_do_not_fit_into_memory_are_refused_before_any_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr("macro_fem.rings.cost.machine_GB", lambda: 16.0)
    monkeypatch.setattr("rve.FiniteMesh.inside", None)
    path = toml(tmp_path / "scene.toml", columns=484, rows=422)
    done = CliRunner().invoke(main, ["rings", str(path), "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert done.stderr.count("\n") == 1
    count, need = re.search(
        r"curtain\]: ([\d,]+) rings need some ([\d.]+) GB of memory, where there are 16", done.stderr
    ).groups()
    assert (int(count.replace(",", "")), float(need)) == (408_496, pytest.approx(memory_GB(408_496), rel=0.01))
    assert not (tmp_path / "out").exists()
    fits = int(re.search(r"of some (\d+) rings", done.stderr)[1])
    assert 0.9 * 16.0 < memory_GB(fits) < 1.1 * 16.0


@pytest.mark.slow
def test_the_memory_that_is_told_is_what_rings_take():
    """Of an interpreter of its own, in which some steps have factors as large as any.

    By /proc, since Linux hands the peak of this process on to `ru_maxrss` of those that it starts.
    """
    code = """if True:
        from pathlib import Path
        from macro_fem import Corners, Mesh, Rectangle, Scene
        from macro_fem.rings import ring_cost, ring_scene
        from rve.finite import FiniteOptions
        told = ring_scene(Scene(Rectangle(242, 278.2), [Corners()], Mesh(8)))
        told.solve(space=True, options=FiniteOptions(max_iterations=6, starts=1))
        peak = int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) * 1024e-9
        print(ring_cost(told.scene, told.info).memory_GB / peak)"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 0.9 < float(done.stdout) < 3.0


@pytest.mark.slow
@pytest.mark.parametrize("space", [False, True])
def test_a_wall_that_pushes_rings_along_their_rail_is_refused(space):
    """On a rail one ring is held along it, so that the mesh stays somewhere; it must not carry anything."""
    hung = ring_scene(scene(support={"kind": "rail"}))
    assert hung.pins.direction.tolist() == [[1.0, 0.0, 0.0]]
    free = hung.solve(space=space)
    assert free.status == "converged"
    assert not free.reaction[:, 0].any()
    wall = {"kind": "wall", "facing": [1.0, 1.0], "point": [10.0, 0.0]}
    with pytest.raises(InputError, match=r"\[obstacle\]: nothing carries the force of 0.00\d* N along x"):
        ring_scene(scene(support={"kind": "rail"}, obstacle=[wall])).solve(space=space)


@pytest.mark.slow
@pytest.mark.parametrize("space", [False, True])
def test_rings_of_a_straight_bar_stay_on_a_line(space):
    """In proportion to the reference, as in the disk; what carries the load is that of a loose bar, the potential no
    lower."""
    answers = []
    for straight in (True, False):
        load = {"bar": {"mass": 0.01, "straight": straight}}
        rings = ring_scene(scene(4, 3, support={"kind": "corners", "gather": 0.9}, load=load))
        found = rings.solve(space=space)
        assert found.status == "converged"
        assert found.kkt_residual < 1e-8
        assert found.reaction.sum(axis=0) == pytest.approx(-rings.force.sum(axis=0), abs=1e-7)
        answers.append((rings, found))
    (rings, tied), (_, loose) = answers
    (bar,) = rings.mesh.bars
    assert np.array_equal(np.sort(bar), np.flatnonzero(np.isclose(rings.mesh.X[:, 1], 0.0)))
    x, s = tied.centre[bar], np.linspace(0.0, 1.0, len(bar))[:, None]
    assert np.abs(x - (1.0 - s) * x[0] - s * x[-1]).max() < 1e-9
    assert np.abs(np.diff(loose.centre[bar, 1], 2)).max() > 1e-2
    assert space or tied.potential >= loose.potential
    assert tied.potential == pytest.approx(loose.potential, rel=0.2)


def test_a_bar_on_rings_of_no_line_is_refused():
    outline = {"shape": "outline", "outline": [[0, 0], [40, 8], [40, 60], [0, 60]]}
    tables = {"curtain": outline, "support": {"kind": "top"}, "load": {"bar": {"mass": 0.01}}}
    with pytest.raises(InputError, match="the rings of a bar lie on no line"):
        ring_scene(read_scene(tables)).solve(space=False)


def test_both_answers_of_a_scene_tell_the_same_things_by_the_same_names(tmp_path):
    """A law and every ring: status, load, forces of supports with the same keys, columns and sums."""
    scene = macro_fem.Scene(macro_fem.Rectangle(22.0, B_Y), [macro_fem.Top()], macro_fem.Mesh(cells=2))
    both = macro_fem.solve(scene), macro_fem.solve(scene, macro_fem.EveryRing(Cell(), space=False))
    assert all(isinstance(one, macro_fem.Solution) for one in both)
    assert [one.status for one in both] == ["converged"] * 2
    disk, rings = (one.summary for one in both)
    shared = {"status", "message", "mean_height_mm", "lowest_point_mm", "total_load_N", "support_forces", "rings"}
    assert shared | {"hang_deg", "safety_factor", "iterations", "wall_s", "versions"} <= disk.keys() & rings.keys()
    assert rings["rings"] == pytest.approx(disk["rings"], rel=1e-6)
    for one, other in zip(disk["support_forces"], rings["support_forces"], strict=True):
        assert other.keys() <= one.keys()
        assert other["force_N"][:2] == pytest.approx(one["force_N"], rel=1e-6, abs=1e-9)
    for one in both:
        assert one.support_forces().force_y_N.sum() == pytest.approx(-one.summary["total_load_N"][1], rel=1e-6)
    both[1].save(tmp_path, picture=False)
    assert {path.name for path in tmp_path.iterdir()} == {"summary.json", "support_forces.csv", "rings.vtu"}
    assert both[1].rings().largest_force.max() == rings["largest_contact_force_N"]
    assert both[1].safety_factor is None


def test_who_answers_is_a_law_or_says_how():
    scene = macro_fem.Scene(macro_fem.Rectangle(22.0, B_Y), [macro_fem.Top()], macro_fem.Mesh(cells=2))
    with pytest.raises(InputError, match=r"OnDemand\(cell\) or EveryRing\(cell\), not a Cell"):
        macro_fem.solve(scene, Cell())
    with pytest.raises(InputError, match="needs the law that guides"):
        macro_fem.solve(scene, macro_fem.EveryRing(Cell(), start="disk"))


def test_the_rings_of_a_cell_are_those_of_the_law_of_its_table():
    """`EveryRing(cell)` takes the reference cell and mass that the shipped law has for the same rings."""
    scene = macro_fem.Scene(macro_fem.Rectangle(22.0, B_Y), [macro_fem.Top()], macro_fem.Mesh(cells=2))
    one, other = ring_scene(scene, Cell()), ring_scene(scene)
    np.testing.assert_allclose(one.mesh.X, other.mesh.X, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(one.force, other.force, rtol=1e-6)


@pytest.mark.parametrize(
    ("columns", "rows", "kind", "gather", "height"),
    [
        pytest.param(5, 3, "top", 0.3, 16.2, marks=pytest.mark.slow),
        pytest.param(5, 5, "corners", 0.17, 1.7, marks=pytest.mark.slow),
        pytest.param(6, 3, "top", 0.3, 20.0, marks=pytest.mark.release),
        pytest.param(5, 6, "corners", 0.1, 3.3, marks=pytest.mark.release),
    ],
)
def test_rings_drawn_far_together_over_a_floor_get_there_in_parts_or_from_another_start(
    columns, rows, kind, gather, height
):
    over = scene(columns, rows, support={"kind": kind, "gather": gather}, obstacle={"kind": "floor", "height": height})
    found = ring_scene(over).solve(space=True)
    assert found.status == "converged"
    assert found.contacts.links_intact
    assert found.contacts.min_gap_mm > -1e-9
    assert found.wall_force[0, 1] == pytest.approx(-found.load[:, 1].sum() - found.reaction[:, 1].sum(), rel=1e-6)


@pytest.mark.parametrize(
    ("weave", "ratio", "columns", "rows"),
    [
        pytest.param("4-in-1", 10, 8, 7, marks=pytest.mark.slow),
        pytest.param("6-in-1", 10, 9, 5, marks=pytest.mark.slow),
        pytest.param("8-in-1", 12, 11, 4, marks=pytest.mark.slow),
        pytest.param("japanese-4-in-1", 10, 6, 6, marks=pytest.mark.release),
    ],
)
def test_a_hundred_rings_of_a_weave_come_to_the_disk(weave, ratio, columns, rows):
    """Weight, and mean height within 3.9 % of the sheet's, as from 8 cells across on."""
    cell = Cell(5.0, 5.0 / ratio, weave)
    law = fit(solve_table(cell, grid(15.0, cell.weave), DirectOptions(branches="first"))).law
    hung = scene(columns, rows, law.cell.sides_mm, support={"kind": "corners", "gather": 0.9}, mesh={"cells": 16})
    disk, options = macro_fem.solve(hung, law).summary, FiniteOptions(max_iterations=300, starts=1)
    rings = ring_scene(hung, law).solve(space=True, options=options)
    assert rings.status == "converged"
    assert rings.kkt_residual < 1e-8
    assert len(rings.mesh.X) > 100
    assert abs(rings.mean_height - disk["mean_height_mm"]) < 0.039 * rows * law.cell.b_y_mm
    weight = disk["support_forces"][0]["force_N"][1]
    assert rings.reaction[:, 1].sum() == pytest.approx(weight, rel=1e-7)
