"""Pictures in space: scales of colours, solids, cameras, pictures and pages."""

import json
import re
import subprocess
import sys
from itertools import product

import numpy as np
import pytest

from rve.common.drawing import space
from rve.common.drawing.page import write_page
from rve.common.drawing.scale import Scale, rounded_up
from rve.common.drawing.space import (
    FRONT,
    THREE_QUARTERS,
    add,
    arrows,
    balls,
    lines,
    look,
    new_plotter,
    parts,
    save_picture,
)


def test_balls_and_arrows_are_where_they_are_asked():
    at = np.array([[3.0, -2.0, 5.0], [9.0, 1.0, 0.0]])
    ball = balls(at, 2.0, force=np.array([4.0, 7.0]))
    points, force = np.asarray(ball.points).reshape(2, -1, 3), ball["force"].reshape(2, -1)
    np.testing.assert_allclose(np.linalg.norm(points - at[:, None], axis=2), 2.0, atol=1e-5)
    assert (force == [[4.0], [7.0]]).all()
    arrow = arrows(at, np.array([[0.0, -50.0, 0.0], [0.01, 0.0, 0.0]]), 0.1)  # the second one is too short
    assert (arrow.bounds.y_min, arrow.bounds.y_max) == (pytest.approx(-52.0), pytest.approx(-2.0))
    assert arrow.center[0] == pytest.approx(3.0, abs=1e-4)


@pytest.mark.parametrize(("spread", "middle"), [("even", 4.25), ("root", 0.5 + 7.5 / 4.0), ("log", 2.0)])
def test_a_scale_goes_from_its_low_to_its_top_end(spread, middle):
    """The middle of the map viridis stands for the value half-way on the scale."""
    import matplotlib

    scale = Scale("force, N", 0.5, 8.0, 9.0, spread)
    shown = scale.colour_map()(scale.norm()([0.5, middle, 8.0]))
    np.testing.assert_allclose(shown, matplotlib.colormaps["viridis"]([0.0, 0.5, 1.0]), atol=0.01)
    assert scale.title == "force, N; arrow: up to 9"
    assert not Scale("force, N", 0.5, 8.0, 8.0).is_exceeded


def test_a_scale_of_values_is_round_and_leaves_out_peaks():
    values = np.append(np.full(2000, 0.21), 40.0)
    scale = Scale.of(values, "line load")
    assert (scale.low, scale.top, scale.largest) == (0.0, 0.25, 40.0)
    assert Scale.of(np.zeros(5), "line load").top == 1.0
    assert [rounded_up(x) for x in (1.0, 1.01, 9.9e-7, 3e5)] == [1.0, 1.5, 1e-6, 3e5]


@pytest.mark.parametrize(
    ("direction", "up"), [(FRONT, (0, 1, 0)), (THREE_QUARTERS, (0, 1, 0)), ((0, -1, 0), (0, 0, -1))]
)
def test_a_camera_sees_the_whole_box(direction, up):
    plotter, box = new_plotter(), np.array([[-50.0, 0.0, 20.0], [900.0, 300.0, 700.0]])
    look(plotter, direction, up, box)
    camera = plotter.camera
    forward = np.array(camera.focal_point) - np.array(camera.position)
    right = np.cross(forward / np.linalg.norm(forward), camera.up)
    away = np.array(list(product(*box.T))) - camera.focal_point
    high, wide = np.abs(away @ camera.up).max(), np.abs(away @ right).max() * space.PANEL[1] / space.PANEL[0]
    assert max(high, wide) < camera.parallel_scale == pytest.approx(max(high, wide), rel=0.05)


HEIGHT = Scale("height, mm", 0.0, 30.0, 40.0)


def wave(panels=2, flat=1.0):
    """A wavy sheet coloured by height over a scale that it exceeds, a red arrow, and blue lines."""
    import pyvista

    plotter = new_plotter(panels)
    sheet = pyvista.Plane(center=(50, 0, 40), direction=(0, 1, 0), i_size=80, j_size=100)
    sheet.points[:, 1] = flat * 20.0 * np.sin(sheet.points[:, 0] / 15.0)
    sheet[HEIGHT.label] = sheet.points[:, 1] + 20.0
    rails = np.array([[[0.0, 30.0, z], [100.0, 30.0, z]] for z in (0.0, 80.0)])
    for panel, direction in zip(range(panels), (FRONT, THREE_QUARTERS), strict=False):
        plotter.subplot(0, panel)
        add(plotter, "sheet", sheet, HEIGHT)
        add(plotter, "force", arrows(np.array([[50.0, 20.0, 40.0]]), np.array([[0.0, 40.0, 0.0]])), "#d7263d")
        add(plotter, "rail", lines(rails), "#1f4e79", line_width=9)
        look(plotter, direction)
    return plotter


def share_near(image, colour, reach):
    """Share of the pixels of an image (h, w, 3), 0 to 255, within `reach` of a colour."""
    return float((np.abs(image[..., :3].astype(int) - colour).max(axis=-1) <= reach).mean())


def test_a_picture_shows_colours_arrows_and_what_is_above_the_scale(tmp_path):
    from PIL import Image

    save_picture(tmp_path / "wave.png", wave(), "a wave", "a note")
    assert [file.name for file in tmp_path.iterdir()] == ["wave.png"]
    image = np.asarray(Image.open(tmp_path / "wave.png").convert("RGB"))
    half = image.shape[1] // 2
    for panel in (image[:700, :half], image[:700, half:]):
        assert share_near(panel, [255, 255, 255], 2) > 0.2
        assert (np.ptp(panel.astype(int), axis=-1) > 60).mean() > 0.02
        red, green, blue = panel.astype(int).transpose(2, 0, 1)
        assert ((red > 1.6 * green) & (red > 1.2 * blue) & (red > 120)).mean() > 2e-3  # arrow, above the scale
        assert ((blue > 1.3 * red) & (blue > 1.05 * green)).mean() > 2e-3  # rails, low values


def test_a_missing_library_of_opengl_is_told_in_one_sentence():
    """VTK tries X, EGL and OSMesa in turn, and would end the interpreter without the last one."""
    code = "import rve.common.drawing.space as space; space.find_library = lambda name: 'libnothing.so'\n"
    code += "from rve.common.errors import InputError\n"
    code += "try:\n    space.check_render('curtain.png')\nexcept InputError as error:\n    print(error)"
    hidden = {"VTK_DEFAULT_OPENGL_WINDOW": "vtkOSOpenGLRenderWindow"}
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=space.os.environ | hidden)
    assert run.returncode == 0
    assert run.stdout.startswith("curtain.png needs OpenGL (libnothing.so")
    assert run.stdout.strip().endswith("install libosmesa6, or ask for --no-picture")


def test_a_page_holds_the_numbers_and_loads_nothing(tmp_path):
    write_page(tmp_path / "wave.html", wave(1), "a wave <b>")
    text = (tmp_path / "wave.html").read_text(encoding="utf-8")
    assert not re.search(r"<(script|img|iframe|link)[^>]*\b(src|href)=\"(?!data:)", text)
    assert "<title>a wave &lt;b&gt;</title>" in text
    data = json.JSONDecoder().raw_decode(text[re.search(r'Plotly\.newPlot\(\s*"[^"]+",\s*', text).end() :])[0]
    assert [trace["name"] for trace in data] == ["sheet", "force", "rail"]
    sheet = np.stack([decoded(data[0][axis]) for axis in "yzx"], axis=1)  # plotly's third axis points up
    mesh = parts(wave(1))["sheet"][0]
    np.testing.assert_allclose(sheet, mesh.points, atol=1e-4)
    np.testing.assert_allclose(decoded(data[0]["customdata"]), mesh[HEIGHT.label], atol=1e-5)
    assert (data[0]["cmin"], data[0]["cmax"]) == (0.0, pytest.approx(30.9))
    assert data[0]["colorscale"][-1] == [1.0, HEIGHT.over]
    rail = np.stack([decoded(data[2][axis]) for axis in "yzx"], axis=1).reshape(2, 3, 3)
    np.testing.assert_allclose(rail[:, :2, 1:], [[[30, 0], [30, 0]], [[30, 80], [30, 80]]])
    assert np.isnan(rail[:, 2]).all()


def decoded(packed):
    """The numbers that plotly packs into JSON."""
    import base64

    return np.frombuffer(base64.b64decode(packed["bdata"]), packed["dtype"])
