"""What a curtain is looked at by: views in space against the solution, and which files are written."""

import numpy as np
import pytest

import macro_fem
from macro_fem.output.forces import pulls, winds
from macro_fem.output.images import in_turn, parts
from macro_fem.output.pictures import STATES, panels
from macro_fem.output.space_view import views
from rve.common import InputError
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
    told = {text.get_text() for text in panels(plane.solution).axes[1].get_legend().get_texts()}
    assert told & STATES.keys() == {name for k, name in enumerate(STATES) if k in plane.solution.state()} < {*STATES}


def test_a_page_of_a_curtain(hammock, plane, tmp_path):
    for result, name in ((hammock, "space.html"), (plane, "plane.html")):
        result.write_html(tmp_path / name)
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert '"name":"held' in text.replace('": "', '":"')
        assert ("load at a point, longest 9 N" in text) == (result is hammock)
    with pytest.raises(InputError, match="is a folder"):
        plane.write_html(tmp_path)


@pytest.mark.parametrize("kind", ["plane", "hammock"])
def test_a_picture_and_a_film_with_a_frame_per_load_step(kind, request, tmp_path):
    request.getfixturevalue(kind).save(tmp_path, animation=True)
    assert {"curtain.png", "curtain.gif", "summary.json"} <= {file.name for file in tmp_path.iterdir()}
    frames, changed = film_of(tmp_path / "curtain.gif")
    assert (frames, 1e-3 < changed < 0.5) == (2, True)


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
