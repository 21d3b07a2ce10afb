"""Views in space: scales of colours, solids, cameras, pictures and pages, down to the pixels of a real browser."""

import base64
import io
import json
import re
import shutil
import subprocess
import sys
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from homogenize import default_law
from rve.common.drawing.page import STRIP, write_page
from rve.common.drawing.render import aim, render
from rve.common.drawing.solids import PERSON_MM, arrow, box, capsule, cylinder, person, rounded_box, sphere
from rve.common.drawing.views import (
    FRONT,
    THREE_QUARTERS,
    Camera,
    Lines,
    Scale,
    Surface,
    View,
    merged,
    packed,
    rounded_up,
    unpacked,
)
from rve.common.errors import NotConverged
from rve.geometry.cell import Cell
from rve.solve import solve_table
from rve.table import read_table


def volume(points, triangles):
    """Volume inside a closed surface whose triangles are oriented alike, mm3."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    return float(np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6.0)


def test_solids_have_their_volumes():
    centre = np.array([3.0, -2.0, 5.0])
    assert abs(volume(*sphere(centre, 2.0, 96))) == pytest.approx(4.0 / 3.0 * np.pi * 8.0, rel=5e-3)
    assert abs(volume(*cylinder(centre, centre + np.array([3.0, 4.0, 0.0]), 2.0, 96))) == pytest.approx(
        20.0 * np.pi, rel=5e-3
    )
    ball_ended = np.pi * 4.0 * 5.0 + 4.0 / 3.0 * np.pi * 8.0
    assert abs(volume(*capsule(centre, centre + np.array([0.0, 0.0, 5.0]), (2.0, 2.0), 96))) == pytest.approx(
        ball_ended, rel=1e-2
    )
    size = np.array([4.0, 6.0, 9.0])
    assert volume(*box(centre, centre + size)) == pytest.approx(4.0 * 6.0 * 9.0, rel=1e-12)
    # an inner box, its faces and edges thickened by the radius 1, and a ball: Steiner's formula
    a, b, c = size - 2.0
    steiner = a * b * c + 2.0 * (a * b + b * c + c * a) + np.pi * (a + b + c) + 4.0 / 3.0 * np.pi
    points, triangles = rounded_box(centre, centre + size, 1.0)
    assert abs(volume(points, triangles)) == pytest.approx(steiner, rel=1e-2)
    np.testing.assert_allclose(np.ptp(points, axis=0), size, rtol=1e-3)


def test_an_arrow_reaches_from_its_tail_to_its_tip():
    points, _ = arrow(np.array([1.0, 2.0, 3.0]), np.array([0.0, -50.0, 0.0]), 2.0)
    assert (points[:, 1].max(), points[:, 1].min()) == (2.0, -48.0)
    np.testing.assert_allclose(points[np.argmin(points[:, 1])], [1.0, -48.0, 3.0], atol=1e-12)


def test_a_person_stands_on_the_ground_and_has_a_height():
    points = np.concatenate([points for points, _ in person(np.array([100.0, -7.0, 20.0]))])
    assert points[:, 1].min() == pytest.approx(-7.0, abs=0.01 * PERSON_MM)
    assert np.ptp(points[:, 1]) == pytest.approx(PERSON_MM, rel=0.01)
    assert points[:, 0].mean() == pytest.approx(100.0, abs=5.0)


@pytest.mark.parametrize("spread", ["even", "root", "log"])
def test_a_scale_goes_from_its_low_to_its_top_end(spread):
    scale = Scale("force, N", 0.5, 8.0, 9.0, spread=spread)
    assert scale.share(np.array([0.5, 8.0])).tolist() == [0.0, 1.0]
    shares = scale.share(np.array(scale.ticks()))
    assert (np.diff(shares) > 0.0).all()
    assert (scale.ticks()[0], scale.ticks()[-1]) == (0.5, 8.0)
    middle = {"even": 4.25, "root": 0.5 + 7.5 / 4.0, "log": 2.0}[spread]
    assert scale.share(np.array([middle]))[0] == pytest.approx(0.5, abs=1e-12)
    assert scale.is_exceeded
    assert not Scale("force, N", 0.5, 8.0, 8.0).is_exceeded


def test_a_scale_of_values_is_round_and_leaves_out_peaks():
    values = np.append(np.full(2000, 0.21), 40.0)
    scale = Scale.of(values, "line load")
    assert (scale.low, scale.top, scale.largest) == (0.0, 0.25, 40.0)
    assert Scale.of(np.zeros(5), "line load").top == 1.0
    assert [rounded_up(x) for x in (1.0, 1.01, 9.9e-7, 3e5)] == [1.0, 1.5, 1e-6, 3e5]


@pytest.mark.parametrize("camera", [FRONT, THREE_QUARTERS, Camera("top", (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))])
def test_a_camera_sees_the_whole_box(camera):
    corners = np.array([[-50.0, 0.0, 20.0], [900.0, 300.0, 700.0]])
    seen = aim(camera, corners)
    right = np.cross(seen.direction, seen.up)
    every = np.array([[corners[i, 0], corners[j, 1], corners[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    away = every - seen.middle
    assert np.abs(away @ seen.up).max() < seen.half_height
    assert np.abs(away @ right).max() < seen.half_height * 7.0 / 6.2
    tight = max(np.abs(away @ seen.up).max(), np.abs(away @ right).max() * 6.2 / 7.0)
    assert tight == pytest.approx(seen.half_height, rel=0.05)


def wave():
    """A wavy sheet coloured by height over a scale that it exceeds, a red arrow, and blue lines."""
    x, z = np.meshgrid(np.linspace(0.0, 100.0, 21), np.linspace(0.0, 80.0, 21))
    y = 20.0 * np.sin(x / 15.0)
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    a = (np.arange(20)[:, None] * 21 + np.arange(20)).ravel()
    triangles = np.concatenate([np.stack([a, a + 1, a + 22], 1), np.stack([a, a + 22, a + 21], 1)])
    values = y.ravel() + 20.0
    scale = Scale("height, mm", 0.0, 30.0, 40.0)
    lines = np.stack([np.array([[0.0, 30.0, z], [100.0, 30.0, z]]) for z in (0.0, 80.0)])
    parts = (
        Surface("sheet", points, triangles, values=values),
        merged("force", [arrow(np.array([50.0, 20.0, 40.0]), np.array([0.0, 40.0, 0.0]), 4.0)], "#d7263d"),
        Lines("rail", lines, 2.0, "#1f4e79", width=6.0),
    )
    return View("a wave <b>", parts, scale, notes=("a note",))


def same(one, other):
    """Whether two views, or parts of views, hold the same, array by array."""
    if is_dataclass(one):
        return type(one) is type(other) and all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other)
    return one == other


def test_packed_views_come_back_whole():
    focused = Camera("close", (0.0, -1.0, 0.0), (0.0, 0.0, -1.0), np.arange(6.0).reshape(2, 3), ("rail",))
    views = (wave(), replace(wave(), scale=None, cameras=(focused,), title="two\nlines Σ", notes=("a", "b")))
    again = unpacked(packed(views))
    assert same(views, again)
    assert not same(views[0], again[1])


def test_a_pickle_is_not_taken_for_views():
    """Neither one that would call a function, nor one inside the archive."""
    with pytest.raises(ValueError, match="pickle"):
        unpacked(b"cos\ngetcwd\n(tR.")
    stream = io.BytesIO()
    np.savez(stream, tree=np.array([Path()], dtype=object))
    with pytest.raises(ValueError, match="pickle"):
        unpacked(stream.getvalue())


def share_near(image, colour, reach):
    """Share of the pixels of an image (h, w, 3), 0 to 255, within `reach` of a colour."""
    return float((np.abs(image[..., :3].astype(int) - colour).max(axis=-1) <= reach).mean())


def test_a_picture_shows_colours_arrows_and_what_is_above_the_scale(tmp_path):
    from PIL import Image

    render(tmp_path / "wave.png", [wave()])
    assert [file.name for file in tmp_path.iterdir()] == ["wave.png"]
    image = np.asarray(Image.open(tmp_path / "wave.png").convert("RGB"))
    half = image.shape[1] // 2
    for panel in (image[:800, :half], image[:800, half:]):
        assert share_near(panel, [255, 255, 255], 2) > 0.2
        saturated = np.ptp(panel.astype(int), axis=-1) > 60
        assert saturated.mean() > 0.02
        red, green, blue = panel.astype(int).transpose(2, 0, 1)
        assert ((red > 1.6 * green) & (red > 1.2 * blue) & (red > 120)).mean() > 2e-3  # arrow, above the scale
        assert ((blue > 1.3 * red) & (blue > 1.05 * green)).mean() > 2e-3  # rails, low values


@pytest.mark.slow
def test_an_animation_has_a_frame_per_view_and_one_size(tmp_path):
    from PIL import Image

    views = [replace(wave(), cameras=(THREE_QUARTERS,), title=f"step {i}") for i in range(2)]
    low = replace(views[1].parts[0], points=views[1].parts[0].points * [1.0, 0.2, 1.0])
    render(tmp_path / "wave.gif", [views[0], replace(views[1], parts=(low, *views[1].parts[1:]))])
    with Image.open(tmp_path / "wave.gif") as film:
        assert film.format == "GIF"
        assert film.n_frames == 2
        frames = []
        for number in range(2):
            film.seek(number)
            frames.append(np.asarray(film.convert("RGB")).astype(int))
    changed = np.abs(frames[0] - frames[1]).max(axis=-1) > 40
    assert 0.005 < changed.mean() < 0.5


def test_a_renderer_that_fails_leaves_no_file(tmp_path, monkeypatch):
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "pyvista.py").write_text("raise RuntimeError('no screen')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "broken"))
    with pytest.raises(NotConverged, match=r"renderer ended with code 1 \(RuntimeError: no screen\)"):
        render(tmp_path / "wave.png", [wave()])
    assert not (tmp_path / "wave.png").exists()


def test_a_page_holds_the_numbers_and_loads_nothing(tmp_path):
    write_page(tmp_path / "wave.html", wave())
    text = (tmp_path / "wave.html").read_text(encoding="utf-8")
    assert not re.search(r"<(script|img|iframe|link)[^>]*\b(src|href)=\"(?!data:)", text)
    assert "<title>a wave &lt;b&gt;</title>" in text
    packed = [json.loads(one) for one in re.findall(r'"dtype": ?"f4", ?"bdata": ?("[^"]+")', text)]
    x, y, z, share, value = (np.frombuffer(base64.b64decode(one), "<f4") for one in packed[:5])
    points, values = wave().parts[0].points, wave().parts[0].values
    np.testing.assert_allclose(np.stack([y, z, x], axis=1), points, atol=1e-4)  # plotly's third axis points up
    np.testing.assert_allclose(value, values, atol=1e-5)
    assert share.max() == pytest.approx(1.0 + STRIP)
    inside = values < 30.0
    np.testing.assert_allclose(share[inside], values[inside] / 30.0, atol=1e-6)


PROBE = """<script>
addEventListener("load", () => {
  const box = document.querySelector(".js-plotly-plot");
  const turn = location.hash === "#turned" ? Plotly.relayout(box, {"scene.camera.eye": {x: -2, y: 0.5, z: 0.3}}) : null;
  Promise.resolve(turn).then(() => setTimeout(() => {
    document.body.dataset.seen = JSON.stringify({
      fetched: performance.getEntriesByType("resource").map((one) => one.name),
      parts: box.data.map((one) => one.name),
      scenes: box._fullLayout._subplots.gl3d.length,
      canvas: document.querySelectorAll("canvas").length,
    });
  }, 1500));
});
</script></body>"""


def seen_in_browser(page, shot, side=""):
    """What Chromium without any host tells of a page, and the picture (h, w, 3) of its scenes, values from 0 to 255."""
    from PIL import Image

    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    assert browser, "this test needs a browser: apt-get install chromium"
    text = page.read_text(encoding="utf-8")
    if PROBE not in text:
        page.write_text(text.replace("</body>", PROBE), encoding="utf-8")
    flags = "--headless --no-sandbox --no-first-run --disable-background-networking --disable-sync --disable-quic"
    flags += " --disable-component-update --use-angle=swiftshader --enable-unsafe-swiftshader --window-size=1000,800"
    flags += f" --virtual-time-budget=6000 --user-data-dir={shot.parent / 'profile'}"
    rules = "--host-resolver-rules=MAP * ~NOTFOUND"
    run = [browser, *flags.split(), rules, f"--screenshot={shot}", "--dump-dom", page.as_uri() + side]
    done = subprocess.run(run, capture_output=True, text=True, timeout=180, check=True)
    seen = json.loads(re.search(r'data-seen="([^"]+)"', done.stdout)[1].replace("&quot;", '"'))
    return seen, np.asarray(Image.open(shot).convert("RGB")).astype(int)[80:620, 150:800]


@pytest.mark.slow
def test_a_page_turns_in_a_browser_without_a_network(tmp_path):
    """The sheet's colours are on the screen, another side after turning, nothing is fetched."""
    page = tmp_path / "wave.html"
    write_page(page, wave())
    pictures = []
    for side in ("", "#turned"):
        seen, picture = seen_in_browser(page, tmp_path / f"shot{len(pictures)}.png", side)
        assert seen["fetched"] == []
        assert seen["parts"] == ["sheet", "force", "rail"]
        assert seen["canvas"] >= 1
        pictures.append(picture)
    for image in pictures:
        red, green, blue = image.transpose(2, 0, 1)
        assert ((green > 1.3 * red) & (green > 1.05 * blue)).mean() > 0.01  # the middle of the scale
        assert ((red > 2.0 * green) & (red > 1.5 * blue)).mean() > 0.002  # the arrow, and above the scale
    assert (np.abs(pictures[0] - pictures[1]).max(axis=-1) > 60).mean() > 0.03


def cell_page(path):
    """The page of a locked cell, and its parts."""
    from rve.cell_view import write_case_page

    write_case_page(solve_table(Cell(), ([20.0], [45.0])), path)
    return ["rings of class 1", "rings of class 2", "periodic cell", "contacts", "force between rings"]


def law_page(path):
    """The page of the law of the package with two scenes, and its parts."""
    from homogenize.fitting.rows import rows_from_table
    from homogenize.view import write_law_page

    law = default_law()
    table = Path(__file__).parents[1] / "test_homogenize" / "data" / "table190.csv"
    write_law_page(law, rows_from_table(read_table(table)), path, law.strength)
    surface = ["locking surface", "lines of even E12 and E11 - E22", "rows of the table"]
    return [*surface, "first yield", "plastic collapse", "plastic collapse"]


def rings_page(path):
    """The page of a finite mesh that hangs by a ring in the plane, and its parts."""
    from macro_fem.every_ring import ring_scene
    from macro_fem.scene.schema import Scene

    ring_scene(Scene.rectangle(22.0, 12.646069623526).hung_by("top")).solve(space=False).write_html(path)
    return ["rings", "held rings"]


@pytest.mark.slow
@pytest.mark.parametrize(("write", "scenes"), [(cell_page, 1), (law_page, 2), (rings_page, 1)])
def test_pages_of_cell_law_and_rings_are_drawn_in_a_browser(tmp_path, write, scenes):
    parts = write(tmp_path / "page.html")
    seen, picture = seen_in_browser(tmp_path / "page.html", tmp_path / "shot.png")
    assert seen["fetched"] == []
    assert seen["parts"][: len(parts)] == parts
    assert seen["scenes"] == scenes
    drawn = np.ptp(picture, axis=-1) > 40
    assert drawn.mean() > 0.01


def test_views_stand_side_by_side_with_their_own_axes(tmp_path):
    other = replace(wave(), axes=("E12", "E22", "E11"), unit="", title="strain")
    write_page(tmp_path / "two.html", wave(), other)
    text = (tmp_path / "two.html").read_text(encoding="utf-8")
    assert {scene: text.count(f'"scene":"{scene}"') for scene in ("scene", "scene2")} == {"scene": 3, "scene2": 3}
    assert "E11 %{x:.4g}, E12 %{y:.4g}, E22 %{z:.4g}\\u003cextra" in text  # in the order of their names
    assert "x %{y:.4g}, y %{z:.4g}, z %{x:.4g} mm" in text
    assert '"title":{"text":"E11"}' in text
    assert '"title":{"text":"z, mm"}' in text


def test_the_modules_of_views_import_nothing_heavy():
    code = "import sys; from rve.common.drawing import views, solids, page, render; "
    code += "print([m for m in ('matplotlib', 'pyvista', 'plotly', 'PIL') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"
