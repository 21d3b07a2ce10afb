"""Pictures in space: scales of colours, solids, cameras, pictures and pages."""

import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.text import Text

from macro_fem.output import compose, save_picture, write_page
from rve import InputError
from rve.common.drawing.plane import Scale
from rve.common.drawing.space import (
    FRONT,
    PANEL,
    THREE_QUARTERS,
    add,
    arrows,
    lines,
    look,
    new_plotter,
    sheet_axes,
    surface,
)

HEIGHT = Scale("height, mm", 0.0, 30.0, 40.0)


def wave(panels=2, flat=1.0):
    """A wavy sheet coloured by height over a scale that it exceeds, a red arrow, and blue lines."""
    import pyvista

    plotter = new_plotter(panels)
    sheet = pyvista.Plane(center=(50, 0, 40), direction=(0, 1, 0), i_size=80, j_size=100)
    sheet.points[:, 1] = flat * 20.0 * np.sin(sheet.points[:, 0] / 15.0)
    sheet[HEIGHT.label] = sheet.points[:, 1] + 20.0
    rails = np.array([[[0.0, 30.0, z], [100.0, 30.0, z]] for z in (0.0, 80.0)])
    for panel, direction in zip(range(panels), (FRONT, THREE_QUARTERS) * panels, strict=False):
        plotter.subplot(0, panel)
        add(plotter, "sheet", sheet, HEIGHT)
        add(plotter, "force", arrows(np.array([[50.0, 20.0, 40.0]]), np.array([[0.0, 40.0, 0.0]])), "#d7263d")
        add(plotter, "rail", lines(rails), "#1f4e79", line_width=9)
        look(plotter, direction)
    return plotter


@pytest.mark.slow
def test_a_picture_is_made_and_is_not_empty(tmp_path):
    from PIL import Image

    save_picture(tmp_path / "wave.png", wave(), "a wave")
    assert [file.name for file in tmp_path.iterdir()] == ["wave.png"]
    image = np.asarray(Image.open(tmp_path / "wave.png").convert("RGB")).astype(int)
    for panel in np.array_split(image[:700], 2, axis=1):
        assert (panel.min(axis=-1) > 252).mean() > 0.2
        assert (np.ptp(panel, axis=-1) > 60).mean() > 0.02


@pytest.mark.parametrize("in_front", [True, False])
def test_forces_are_seen_through_the_sheet(in_front):
    plotter = new_plotter()
    sheet = surface(np.array([[0.0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0]]), np.array([[0, 1, 2, 3]]))
    add(plotter, "sheet", sheet, "#2277cc")
    add(
        plotter,
        "wind",
        arrows(np.array([[50.0, 20.0, -40.0]]), np.array([[0.0, 60.0, 0.0]])),
        "#d7263d",
        in_front=in_front,
    )
    look(plotter, FRONT)
    plotter.render()
    red = np.asarray(plotter.screenshot(return_img=True)).astype(int) @ [1, -1, -1] > 60
    assert (red.sum() > 1000) == in_front


def test_panels_stand_in_rows_with_their_captions_legible_on_a_page():
    captions = [f"{k} Hz" for k in range(1, 7)]
    figure = compose(wave(6), "six shapes", captions)
    images = [ax for ax in figure.axes if ax.images]
    figure.canvas.draw()
    assert [ax.get_title() for ax in images] == captions
    assert len({round(ax.get_position().y0, 3) for ax in images}) == 2
    assert figure.get_figwidth() * 25.4 == pytest.approx(160.0, abs=0.1)
    shown = [text for text in figure.findobj(Text) if text.get_text() and text.get_visible()]
    assert min(text.get_fontsize() for text in shown) >= 8.0
    assert images[0].images[0].get_array().shape[1] < 0.97 * PANEL[0]  # what is white around all is cut off


def test_a_mesh_is_looked_at_from_its_front():
    points = np.array([[0.0, y, z] for y in (0.0, 1.0, 2.0) for z in (0.0, 3.0)])
    right, up, front = sheet_axes(points)
    np.testing.assert_allclose([right, up, front], [[0, 0, -1], [0, 1, 0], [1, 0, 0]], atol=1e-12)


@pytest.mark.slow
def test_a_missing_library_of_opengl_is_told_in_one_sentence():
    """VTK tries X, EGL and OSMesa in turn, and would end the interpreter without the last one."""
    code = "import rve.common.drawing.space as space; space.find_library = lambda name: 'libnothing.so'\n"
    code += "from rve.common.errors import InputError\n"
    code += "try:\n    space.check_render('curtain.png')\nexcept InputError as error:\n    print(error)"
    hidden = {"VTK_DEFAULT_OPENGL_WINDOW": "vtkOSOpenGLRenderWindow"}
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=os.environ | hidden)
    assert run.returncode == 0
    assert run.stdout.startswith("curtain.png needs OpenGL (libnothing.so")
    assert run.stdout.strip().endswith("install libosmesa6, or ask for --no-picture")


def test_a_page_holds_the_numbers_and_loads_nothing(tmp_path, monkeypatch):
    write_page(tmp_path / "wave.html", lambda: wave(1), "a wave <b>")
    text = (tmp_path / "wave.html").read_text(encoding="utf-8")
    assert not re.search(r"<(script|img|iframe|link)[^>]*\b(src|href)=\"(?!data:)", text)
    assert "<title>a wave &lt;b&gt;</title>" in text
    data = json.JSONDecoder().raw_decode(text[re.search(r'Plotly\.newPlot\(\s*"[^"]+",\s*', text).end() :])[0]
    assert [trace["name"] for trace in data] == ["sheet", "force", "rail"]
    monkeypatch.setattr("rve.common.errors.find_spec", lambda name: None)
    with pytest.raises(InputError, match="needs plotly"):
        write_page(tmp_path / "wave.html", lambda: pytest.fail("is drawn"), "never")
