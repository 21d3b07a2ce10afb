"""What a curtain is looked at by: views in space against the solution, and which files are written."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from click.testing import CliRunner

import macro_fem
import rve
from macro_fem.cli import main
from macro_fem.output import looks
from macro_fem.output.looks import frames
from macro_fem.output.space_bodies import SHRUNK, ground_level, obstacles
from macro_fem.output.space_forces import patches, pulls, pushes, summed_up
from macro_fem.output.space_view import PUSH, Frame, curtain_view
from macro_fem.scene.obstacles import Box, Cylinder, Floor, Sphere, Wall
from macro_fem.solvers.walls import Walls
from rve.common.errors import InputError, NotConverged

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


def part(view, name):
    """The part of a view whose name begins with `name`."""
    return next(one for one in view.parts if one.name.startswith(name))


def test_the_sheet_is_where_the_nodes_are_and_has_their_line_loads(hammock):
    solution = hammock.solution
    view = curtain_view(solution)
    sheet = part(view, "curtain")
    assert np.array_equal(sheet.points, solution.x[: len(sheet.points)])
    values = solution.principal()[0][:, 0]
    assert values.min() <= sheet.values.min() < sheet.values.max() <= values.max()
    area = solution.problem.disc.cell_area
    assert sheet.values.mean() == pytest.approx(values @ area / area.sum(), rel=0.1)
    assert view.scale.top <= 1.5 * values.max()
    a, b, c = sheet.points[sheet.triangles].transpose(1, 0, 2)
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
    scene = replace(solution.problem.scene, obstacle=obstacles)
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
    drawn = obstacles(among(hammock.solution, *bodies, factor=0.5), room, ground)
    assert [one.name for one in drawn] == ["ball", "rod", "house", "back"]
    ball, rod, house, back = (one.points for one in drawn)
    np.testing.assert_allclose(np.linalg.norm(ball - [50.0, 60.0, 70.0] - shift, axis=1), 25.0 - less, atol=1e-9)
    away = np.linalg.norm((rod - [1.0, 2.0, 3.0] - shift)[:, :2], axis=1)
    np.testing.assert_allclose(away[away > 1.0], 15.0 - min(less, 1.5), atol=1e-9)
    assert rod[:, 2].min() < 0.0 < 150.0 < rod[:, 2].max() < 200.0
    low, high = house.min(axis=0), house.max(axis=0)
    np.testing.assert_allclose(high, np.array([100.0, 100.0, 50.0]) + shift - less, atol=1e-9)
    assert low[0] > -240.0
    assert low[1:].tolist() == pytest.approx([ground, 20.0 + shift[2] + less])
    np.testing.assert_allclose(back[:, 2], -5.0 + shift[2] - less, atol=1e-9)
    assert ground_level(among(hammock.solution, Floor(height=-3.0, move=(0.0, 8.0)), factor=0.5), room) == 1.0
    assert "ground is drawn" not in " ".join(curtain_view(among(hammock.solution, Floor(height=-40.0))).notes)


def test_a_rounded_box_is_round_where_it_ends_and_flat_where_it_is_cut_off(hammock):
    room, ground = np.array([[0.0, 0.0, 0.0], [240.0, 300.0, 150.0]]), -40.0
    house = Box(corner=(0.0, -500.0, 20.0), size=(100.0, 600.0, 90.0), rounding=12.0)
    points = obstacles(among(hammock.solution, house), room, ground)[0].points
    ends = [points[np.isclose(points[:, 1], y)] for y in (points[:, 1].min(), points[:, 1].max())]
    assert points[:, 1].min() == ground
    assert np.ptp(ends[0][:, [0, 2]], axis=0) == pytest.approx(np.ptp(points[:, [0, 2]], axis=0))
    assert np.ptp(ends[1][:, [0, 2]], axis=0) == pytest.approx(np.ptp(points[:, [0, 2]], axis=0) - 24.0)


def test_the_ground_is_below_all_arrows():
    """Wind against a sheet held above and below: both edges pull hard."""
    sheet = macro_fem.Scene.rectangle(100.0, 100.0, cells=3)
    scene = sheet.hung_by("top").hung_by("edge", edge="bottom", move=(0.0, 10.0))
    view = curtain_view(macro_fem.solve(scene.loaded_by("wind", pressure=200.0, direction=(0.0, 0.0, 1.0))).solution)
    ground = part(view, "ground").points[:, 1].max()
    assert part(view, "force of supports").points[:, 1].min() > ground - 0.5
    assert part(view, "curtain").points[:, 1].min() > ground + 10.0


@dataclass(frozen=True)
class Cone:
    """An obstacle of a kind that has no drawing."""

    name: str = "cone"
    move: tuple[float, ...] = (0.0, 0.0)


def test_an_unknown_obstacle_is_shown_where_it_pushes_and_arrows_add_up(hammock):
    solution = among(hammock.solution, Cone())
    nodes = np.arange(5, 25)
    normal = np.tile([0.6, 0.8, 0.0], (20, 1))
    walls = Walls(nodes, normal, np.zeros(20))
    force = np.linspace(0.0, 3.0, 20)
    pushed = replace(solution, problem=replace(solution.problem, walls=walls), wall_forces=force)
    assert np.linalg.norm(pushes(pushed)[1].sum(axis=0)) == pytest.approx(30.0)
    plates = part(curtain_view(pushed), "cone").points.reshape(19, -1, 3)  # the first node is not pushed
    np.testing.assert_allclose(np.linalg.norm(plates.mean(axis=1) - pushed.x[nodes[1:]], axis=1), 0.0, atol=2.0)
    assert part(curtain_view(pushed), "force of obstacles").colour == PUSH
    assert pushes(solution)[0].shape == (0, 3)


def test_the_shadow_lies_on_the_ground_below_everything(hammock):
    view = curtain_view(hammock.solution)
    shadow, ground = part(view, "shadow").points, part(view, "ground").points
    assert np.ptp(shadow[:, 1]) < 1e-9
    assert shadow[0, 1] < hammock.solution.x[:, 1].min()
    assert (shadow[:, [0, 2]] >= ground[:, [0, 2]].min(axis=0)).all()
    assert (shadow[:, [0, 2]] <= ground[:, [0, 2]].max(axis=0)).all()


@pytest.mark.parametrize(("size", "name"), [(2.0, "person, 1.75 m"), (0.1, "bar of ")])
def test_large_curtains_stand_beside_a_person_and_small_ones_above_a_bar(size, name):
    scene = {"curtain": {"width": 600 * size, "height": 500 * size}, "mesh": {"cells": 2}, "solver": {"space": True}}
    view = curtain_view(macro_fem.solve(macro_fem.read_scene(scene | {"support": {"kind": "top"}})).solution)
    shown = part(view, name)
    if name.startswith("bar"):
        assert np.ptp(shown.points[..., 0]) == pytest.approx(float(shown.name.split()[2]))
    else:
        assert np.ptp(shown.points[:, 1]) == pytest.approx(1750.0, rel=0.01)


def test_a_track_is_drawn_as_a_whole_with_its_runners():
    support = {"kind": "track", "radius": 90, "angle": 180, "pitch": 60, "drawn": 0.5}
    scene = {"curtain": {"width": 300, "height": 100}, "mesh": {"cells": 5}, "support": support}
    result = macro_fem.solve(macro_fem.read_scene(scene))
    view = curtain_view(result.solution)
    line = part(view, "track").points[0]
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(90.0 * np.pi, rel=1e-3)
    held = result.solution.problem.supports.held[0]
    balls = part(view, "runners").points.reshape(len(held.nodes), -1, 3).mean(axis=1)
    np.testing.assert_allclose(balls[:, [0, 2]], result.solution.x[held.nodes][:, [0, 2]], atol=0.5)


def test_frames_of_an_animation_share_colours_camera_and_the_longest_arrow(hammock):
    first, last = frames(hammock.steps)
    frame = Frame.of(hammock.steps)
    assert first.scale == last.scale == frame.scale
    assert len(first.cameras) == len(last.cameras) == 1
    assert np.array_equal(part(first, "ground").points[:, 1], part(last, "ground").points[:, 1])
    both = [np.linalg.norm(pulls(step)[1], axis=1).max() for step in hammock.steps]
    assert frame.force == pytest.approx(max(both))
    assert "50 % of live loads" in first.title


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

    monkeypatch.setattr(looks, "render", never)
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


def test_a_renderer_that_fails_leaves_the_other_files(hammock, tmp_path, monkeypatch):
    (tmp_path / "pyvista.py").write_text("raise RuntimeError('no screen')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(NotConverged, match=r"curtain.png: the renderer ended .* the other files are written"):
        hammock.save(tmp_path / "out")
    names = {file.name for file in (tmp_path / "out").iterdir()}
    assert {"summary.json", "curtain.vtu"} <= names
    assert "curtain.png" not in names


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
    window = rve.LocalizeOptions(window=(60.0, 40.0, 130.0, 110.0))
    rings, read = rve.localize(hammock, window), rve.localize(tmp_path / "curtain", window)
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
