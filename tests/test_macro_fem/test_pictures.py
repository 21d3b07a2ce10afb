"""What a curtain is looked at by: views in space against the solution, and which files are written."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import macro_fem
from macro_fem.cli import main
from macro_fem.output import pictures, plots
from macro_fem.output.obstacle_meshes import SHRUNK, ground_level, obstacle_mesh
from macro_fem.output.space_forces import patches, pulls, pushes, summed_up
from macro_fem.output.space_view import Frame, draw_curtain, note
from macro_fem.scene.obstacles import Box, Cylinder, Floor, Sphere, Wall
from macro_fem.solvers.walls import Walls
from rve.common.drawing.space import parts
from rve.common.errors import InputError

HAMMOCK = {
    "curtain": {"width": 240, "height": 300},
    "mesh": {"cells": 6},
    "support": [
        {"kind": "edge", "edge": "top"},
        {"kind": "edge", "edge": "bottom", "move": [0, 260, 150]},
    ],
    "load": {"steps": 2},
}
PLANE = {
    "curtain": {"width": 100, "height": 80},
    "mesh": {"cells": 3},
    "support": {"kind": "corners", "move": [0, 7]},
    "load": {"steps": 2},
}


@pytest.fixture(scope="module")
def hammock():
    return macro_fem.solve(macro_fem.read_scene(HAMMOCK))


@pytest.fixture(scope="module")
def plane():
    return macro_fem.solve(macro_fem.read_scene(PLANE))


def part(plotter, name):
    """The mesh whose name begins with `name`."""
    return next(mesh for one, (mesh, *_) in parts(plotter).items() if one.startswith(name))


def test_the_sheet_is_where_the_nodes_are_and_has_their_line_loads(hammock):
    solution = hammock.solution
    sheet, _, scale = parts(draw_curtain(solution))["curtain"]
    np.testing.assert_allclose(sheet.points, solution.x[: sheet.n_points], atol=1e-3)
    shown = sheet[scale.label]
    values = solution.principal()[0][:, 0]
    assert values.min() <= shown.min() < shown.max() <= values.max()
    area = solution.problem.disc.cell_area
    assert shown.mean() == pytest.approx(values @ area / area.sum(), rel=0.1)
    assert scale.top <= 1.5 * values.max()
    a, b, c = sheet.points[sheet.regular_faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    assert (normals[:, 1] > 0.0).mean() > 0.9  # the front of a sheet whose bottom is moved up and forwards looks up


def test_arrows_of_supports_add_up_to_the_load(hammock):
    at, force = pulls(hammock.solution)
    assert len(at) > 8
    np.testing.assert_allclose(force.sum(axis=0), -hammock.solution.problem.force.sum(axis=0), atol=1e-6)
    on_edges = np.abs(at[:, None, 1] - [300.0, 260.0]).min(axis=1)
    assert on_edges.max() < 1e-9


def test_an_even_line_load_has_even_arrows_whatever_the_mesh():
    s = np.array([0.0, 1.0, 2.5, 3.0, 7.0, 8.0])
    at = np.column_stack([s, 0.0 * s, 0.0 * s])
    ends = np.concatenate([[0.0], 0.5 * (s[1:] + s[:-1]), [8.0]])
    force = np.diff(ends)[:, None] * [0.0, 2.0, 0.5]
    places, sums = summed_up(at, force, 4)
    np.testing.assert_allclose(sums, [[0.0, 4.0, 1.0]] * 4, atol=1e-12)
    np.testing.assert_allclose(places[:, 0], [1.0, 3.0, 5.0, 7.0], atol=1e-12)


def test_patches_hold_every_point_once():
    points = np.random.default_rng(1).normal(size=(57, 3))
    found = patches(points, 14)
    assert len(found) == 14
    assert sorted(np.concatenate(found).tolist()) == list(range(57))


def among(solution, *obstacles, factor=1.0):
    """The solution as if these obstacles were in its scene, after `factor` of their moves."""
    scene = solution.problem.scene
    scene = replace(scene, items=(*scene.items, *obstacles))
    return replace(solution, problem=replace(solution.problem, scene=scene, factor=factor))


def test_obstacles_are_drawn_where_they_are_at_this_load_step(hammock):
    """A little smaller than they are, moved by their share, and cut off at the ground and far from the curtain."""
    move, room, ground = (10.0, -20.0, 30.0), np.array([[0.0, 0.0, 0.0], [240.0, 300.0, 150.0]]), -40.0
    less = SHRUNK * float(np.linalg.norm(room[1]))
    shift = 0.5 * np.array(move)
    bodies = (
        Sphere(centre=(50.0, 60.0, 70.0), radius=25.0, move=move, name="ball"),
        Cylinder(axis=(0.0, 0.0, 2.0), radius=15.0, point=(1.0, 2.0, 3.0), move=move, name="rod"),
        Box(corner=(-9000.0, -500.0, 20.0), size=(9100.0, 600.0, 30.0), move=move, name="house"),
        Wall(facing=(0.0, 0.0, 3.0), point=(0.0, 0.0, -5.0), move=move, name="back"),
        Floor(height=-40.0),
    )
    meshes = [obstacle_mesh(body, shift, room, ground) for body in bodies]
    assert meshes.pop() is None  # the floor is the ground
    ball, rod, house, back = (mesh.points.astype(float) for mesh in meshes)
    shown = parts(draw_curtain(among(hammock.solution, *bodies, factor=0.5)))
    assert {"ball", "rod", "house", "back"} <= set(shown)
    np.testing.assert_allclose(shown["rod"][0].center[:2], np.array([1.0, 2.0]) + shift[:2], atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(ball - [50.0, 60.0, 70.0] - shift, axis=1), 25.0 - less, atol=1e-4)
    away = np.linalg.norm((rod - [1.0, 2.0, 3.0] - shift)[:, :2], axis=1)
    np.testing.assert_allclose(away[away > 1.0], 15.0 - min(less, 1.5), atol=1e-4)
    assert rod[:, 2].min() < 0.0 < 150.0 < rod[:, 2].max() < 200.0
    low, high = house.min(axis=0), house.max(axis=0)
    np.testing.assert_allclose(high, np.array([100.0, 100.0, 50.0]) + shift - less, atol=1e-4)
    assert low[0] > -240.0
    assert low[1:].tolist() == pytest.approx([ground, 20.0 + shift[2] + less])
    np.testing.assert_allclose(back[:, 2], -5.0 + shift[2] - less, atol=1e-4)
    assert ground_level(among(hammock.solution, Floor(height=-3.0, move=(0.0, 8.0)), factor=0.5), room) == 1.0
    assert "ground is drawn" not in note(among(hammock.solution, Floor(height=-40.0)))


def test_pushes_add_up(hammock):
    nodes, force = np.arange(5, 25), np.linspace(0.0, 3.0, 20)
    walls = Walls(nodes, np.tile([0.6, 0.8, 0.0], (20, 1)), np.zeros(20))
    solution = hammock.solution
    inner = replace(solution.inner, wall_forces=force)
    pushed = replace(solution, problem=replace(solution.problem, walls=walls), inner=inner)
    assert np.linalg.norm(pushes(pushed)[1].sum(axis=0)) == pytest.approx(30.0)
    assert part(draw_curtain(pushed), "force of obstacles").n_points
    assert pushes(solution)[0].shape == (0, 3)


def test_frames_of_an_animation_share_the_longest_arrow(hammock):
    frame = Frame.of(hammock.steps)
    both = [np.linalg.norm(pulls(step)[1], axis=1).max() for step in hammock.steps]
    assert frame.force == pytest.approx(max(both))
    grounds = [part(draw_curtain(step, frame=frame), "_ground").points[:, 1] for step in hammock.steps]
    assert np.array_equal(*grounds)
    assert plots.progress(hammock.steps[0]) == "50 % of live loads and moves"


def test_a_page_of_a_curtain(hammock, plane, tmp_path):
    for result, name in ((hammock, "space.html"), (plane, "plane.html")):
        result.write_html(tmp_path / name)
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert '"name":"held' in text.replace('": "', '":"')
        assert "longest" in text
    with pytest.raises(InputError, match="is a folder"):
        plane.write_html(tmp_path)


def test_a_plane_scene_keeps_its_plane_picture(plane, tmp_path, monkeypatch):
    """Nothing of it is drawn in space, and its animation has a frame per load step."""
    from PIL import Image

    def never(*_):
        raise AssertionError("drawn in space")

    monkeypatch.setattr(pictures, "draw_curtain", never)
    plane.save(tmp_path, animation=True)
    assert {"curtain.png", "curtain.gif", "summary.json"} <= {file.name for file in tmp_path.iterdir()}
    with Image.open(tmp_path / "curtain.gif") as film:
        assert (film.format, film.n_frames) == ("GIF", 2)
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(1)
        last = np.asarray(film.convert("RGB")).astype(int)
    assert first.shape == last.shape
    assert 1e-3 < (np.abs(first - last).max(axis=-1) > 40).mean() < 0.5


@pytest.mark.slow
def test_the_command_writes_picture_animation_and_page_in_space(tmp_path):
    from PIL import Image

    scene = '[curtain]\nwidth = 240\nheight = 300\n[mesh]\ncells = 6\n[load]\nsteps = 2\n[[support]]\nkind = "top"\n'
    scene += '[[support]]\nkind = "edge"\nedge = "bottom"\nmove = [0, 260, 150]\n'
    (tmp_path / "scene.toml").write_text(scene)
    out = tmp_path / "out"
    arguments = ["run", str(tmp_path / "scene.toml"), "--out", str(out), "--animation", "--html"]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 0, done.output
    assert {"curtain.png", "curtain.gif", "curtain.html", "curtain.vtu"} <= {file.name for file in out.iterdir()}
    image = np.asarray(Image.open(out / "curtain.png").convert("RGB")).astype(int)
    for half in np.array_split(image[100:800], 2, axis=1):
        red, green, blue = half.transpose(2, 0, 1)
        assert ((green > 1.15 * red) & (green > 1.15 * blue)).mean() > 0.02  # line loads in the middle of the scale
        assert ((red > 2.0 * green) & (red > 1.5 * blue)).mean() > 1e-3  # forces of the supports
    with Image.open(out / "curtain.gif") as film:
        assert film.n_frames == 2


def test_without_a_renderer_nothing_is_written(hammock, tmp_path, monkeypatch):
    (tmp_path / "pyvista.py").write_text("raise RuntimeError('no screen')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "pyvista", raising=False)
    with pytest.raises(InputError, match=r"curtain.png needs OpenGL \(no screen\).* ask for --no-picture"):
        hammock.save(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_one_load_step_cannot_be_animated(tmp_path):
    (tmp_path / "scene.toml").write_text('[curtain]\nwidth = 50\nheight = 50\n[support]\nkind = "top"\n')
    done = CliRunner().invoke(
        main, ["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "out"), "--animation"]
    )
    assert done.exit_code == 2
    assert "[load] steps = 1: there is nothing to animate" in done.stderr
    assert not (tmp_path / "out").exists()


def test_rings_of_a_curtain_in_space_are_those_of_its_files_and_lie_on_it(hammock, tmp_path):
    hammock.save(tmp_path / "curtain", picture=False)
    window = macro_fem.LocalizeOptions(window=(60.0, 40.0, 130.0, 110.0))
    rings, read = hammock.rings(window), macro_fem.localize(tmp_path / "curtain", window)
    np.testing.assert_allclose(read.centre_mm, rings.centre_mm, atol=1e-6)
    np.testing.assert_allclose(read.normal, rings.normal, atol=1e-6)
    x = hammock.solution.x
    away = np.linalg.norm(rings.centre_mm[:, None] - x[None], axis=2).min(axis=1)
    assert away.max() < 40.0 / np.sqrt(2.0) + 5.0  # within a cell of the mesh
    assert np.ptp(rings.centre_mm[:, 2]) > 20.0
    assert rings.fit.links > 40
    np.testing.assert_allclose(np.linalg.norm(rings.normal, axis=1), 1.0, atol=1e-12)
    rings.write_html(tmp_path / "rings.html")
    assert f"{len(rings)} rings" in (tmp_path / "rings.html").read_text(encoding="utf-8")
