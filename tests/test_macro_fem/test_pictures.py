"""What a curtain is looked at by: views in space against the solution, and which files are written."""

import json
from html import escape

import numpy as np
import pytest

import macro_fem
from macro_fem.output import STATES, compose, in_turn, panels, parts, pulls, views, winds
from macro_fem.output.arrows import halved
from rve import InputError
from rve.common.drawing.space import new_plotter
from tests.commands import run
from tests.films import film_of
from tests.test_macro_fem.sheets import sheet

ENDS = [{"kind": "edge", "edge": "top"}, {"kind": "edge", "edge": "bottom", "move": [0, 260, 150]}]
POINT, WIND = {"at": [120, 100], "force": [0, 0, 9]}, {"pressure": 600, "direction": [0, 0, 1]}
HAMMOCK = sheet(240, 300, 6, ENDS, load={"steps": 2, "point": POINT, "wind": WIND})
TIP = {"at": [50, 0], "force": [1, -1]}
PLANE = sheet(100, 80, 3, {"kind": "corners", "move": [0, 7]}, load={"steps": 2, "point": TIP})


@pytest.fixture(scope="module")
def hammock():
    return macro_fem.solve(macro_fem.read_scene(HAMMOCK))


@pytest.fixture(scope="module")
def plane():
    return macro_fem.solve(macro_fem.read_scene(PLANE))


def test_arrows_of_supports_add_up_to_the_load(hammock):
    at, force = pulls(hammock.solution)
    assert len(at) > 8
    np.testing.assert_allclose(force.sum(axis=0), -hammock.solution.problem.force.sum(axis=0), atol=1e-6)
    assert np.abs(at[:, None, 1] - [300.0, 260.0]).min(axis=1).max() < 1e-9  # on the edges
    np.testing.assert_allclose(winds(hammock.solution)[1].sum(axis=0), [0.0, 0.0, 6e-4 * 240.0 * 300.0])


def test_pictures_of_a_series_share_the_ground_and_the_names_of_forces(hammock, plane):
    steps = in_turn((str(k), draw) for k, draw in enumerate(views(hammock.steps)))
    first, last = [{name: part[0].bounds for name, part in parts(one).items()} for _, one in steps]
    assert (list(first), first["_ground"]) == (list(last), last["_ground"])
    half, whole = (list(parts(one)) for _, one in in_turn(zip("ab", views(plane.steps), strict=True)))
    assert half == whole
    assert "load at a point, longest 1.41 N" in whole
    assert panels(plane.solution).axes[0].get_legend_handles_labels()[1][-1] == "load at a point, up to 1.41 N"
    told = {text.get_text() for text in panels(plane.solution).legends[0].get_texts()}
    assert told & STATES.keys() == {name for k, name in enumerate(STATES) if k in plane.solution.state()} < {*STATES}


def test_a_page_of_a_curtain(hammock, plane, tmp_path):
    for result, name in ((hammock, "space.html"), (plane, "plane.html")):
        result.write_html(tmp_path / name)
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert '"name":"held' in text.replace('": "', '":"')
        assert ("load at a point, longest 9 N" in text) == (result is hammock)
    with pytest.raises(InputError, match="is a folder"):
        plane.write_html(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plane", "hammock"])
def test_a_picture_and_a_film_with_a_frame_per_load_step(kind, request, tmp_path):
    request.getfixturevalue(kind).save(tmp_path, animation=True)
    assert {"curtain.png", "curtain.gif", "summary.json"} <= {file.name for file in tmp_path.iterdir()}
    frames, changed = film_of(tmp_path / "curtain.gif")
    assert (frames, 1e-3 < changed < 0.5) == (2, True)


NAMES = "a $x_$ b", "_left ^ \\frac", "$\\alpha$ & <b>"
NAMED = """
curtain = {width = 100.0, height = 80.0}
mesh = {cells = 3}
support = {kind = "hooks", count = 3, gather = 0.9}
"""
BALL = "[[obstacle]]\nkind = 'sphere'\ncentre = [50.0, 40.0, {}]\nradius = 20.0\nname = '{}'\n"


@pytest.mark.slow
def test_names_are_printed_as_they_are_typed(tmp_path):
    """In legends and reports: no formulae, and none left out."""
    balls = "".join(BALL.format(-60.0 * k - 60.0, name) for k, name in enumerate(NAMES))
    (tmp_path / "space.toml").write_text(NAMED + balls)
    (tmp_path / "plane.toml").write_text(NAMED + "".join(f"[[combination]]\nname = '{name}'\n" for name in NAMES))
    solved = macro_fem.solve(macro_fem.load_scene(tmp_path / "space.toml"))
    figure = compose(views(solved.steps)[0](new_plotter()), NAMES[0])
    figure.canvas.draw()
    words = [*figure.legends[0].get_texts(), figure._suptitle]  # type: ignore[attr-defined]
    assert {text.get_text() for text in words} >= {*NAMES}
    assert not any(text.get_parse_math() for text in words)
    solved.write_html(tmp_path / "space.html")
    text = (tmp_path / "space.html").read_text(encoding="utf-8")
    assert all(json.dumps(escape(name, quote=False)) in text for name in NAMES)
    run("macro_fem", "run", tmp_path / "plane.toml", "--out", tmp_path / "out", "--report", tmp_path / "report.pdf")
    assert (tmp_path / "out" / "curtain.png").exists()


MOVE = "[motion]\nduration = 0.02\nstep = 0.01\n"
DRAWN = {
    "run": ("", "macro_fem.output.pictures.panels", "curtain.png", ("summary.json", "curtain.vtu", "curtain.html")),
    "run --report": ("", "macro_fem.output.plans.draw_hung", "report.pdf", ("summary.json", "curtain.vtu")),
    "run moving": (MOVE, "macro_fem.motion.solution.save_panels", "motion.png", ("motion.csv", "motion_0002.vtu")),
    "rings": ("", "macro_fem.rings.every_ring.new_axes", "rings.png", ("rings.vtu", "rings.html")),
    "modes": ("", "macro_fem.modes.save_picture", "modes.png", ("modes.json", "modes.vtu")),
}


@pytest.mark.parametrize("command", DRAWN)
def test_a_picture_that_fails_loses_nothing_else(command, tmp_path, monkeypatch):
    """Its failure is one sentence and exit code 3; numbers, data and other pictures are in place and listed."""
    more, drawn_by, name, others = DRAWN[command]
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(NAMED.replace("hooks", "top").replace("count = 3, ", "") + more)

    def fail(*args, **kwargs):
        raise ValueError("no such colour")

    monkeypatch.setattr(drawn_by, fail)
    words = {
        "run": ("--html",),
        "rings": ("--html", "--plane"),
        "run --report": ("--no-picture", "--report", tmp_path / name),
    }
    done = run("macro_fem", command.split()[0], scene, "--out", out, *words.get(command, ()), codes=(3,))
    last = done.output.splitlines()[-1]
    assert f"{name} could not be made: unforeseen ValueError: no such colour" in last
    assert last.endswith("; all else is in place")
    assert not (out / name).exists()
    record = "modes.json" if command == "modes" else "summary.json"
    files = {path.name for path in out.iterdir()}
    assert {*others} <= files == {record, *json.loads((out / record).read_text())["files"]}


@pytest.mark.slow
def test_rings_of_a_curtain_in_space_are_those_of_its_files_and_lie_on_it(hammock, tmp_path):
    hammock.save(tmp_path / "curtain", picture=False)
    window = (60.0, 40.0, 130.0, 110.0)
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


def test_parts_of_a_sheet_that_are_alike_have_their_arrows_in_the_same_rows():
    """Rounding of nearly square halves does not decide whether they are cut upright or across."""
    x = np.array([[i, j, 0.0] for j in range(16) for i in range(8)])
    x[-1, 1] += 1e-6
    x[0, 0] -= 2e-6
    parts_of = halved(x, np.arange(len(x)), 16)
    assert {len(one) for one in parts_of} == {8}
    assert np.array([np.ptp(x[one], axis=0) for one in parts_of]) == pytest.approx(
        np.tile([1.0, 3.0, 0.0], (16, 1)), abs=1e-5
    )


def test_a_long_title_breaks_after_a_comma():
    title = "total load 122.9 N, mean height -682.8 mm, lowest point -2025.9 mm, |z| up to 1000.0 mm"
    first, second = compose(new_plotter(), title).get_suptitle().replace("\N{NO-BREAK SPACE}", " ").split("\n")
    assert (first, second) == (title[:42], title[43:])
    assert compose(new_plotter(), title[:42]).get_suptitle() == title[:42]
