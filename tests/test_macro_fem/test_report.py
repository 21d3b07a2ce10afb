"""The report that is handed in: every number of forces, factors and order is in it, words are as they are typed."""

import json
import math
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

import macro_fem
from homogenize import diagonal_net
from macro_fem import Bar, Combination, Hooks, Mesh, PointLoad, Project, Rectangle, Scene, Track, solve
from macro_fem.output import Chapter, Headline, PageTable, track_parts, write_pages
from macro_fem.output.plans import printed
from macro_fem.report import verdict_lines
from macro_fem.scene import Curve, Line
from rve import InputError
from rve.common import digits
from rve.common.drawing.space import FLAT, add, look, new_plotter, surface
from tests.commands import run

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]\d+)?")
needs_pdftotext = pytest.mark.skipif(shutil.which("pdftotext") is None, reason="pdftotext of poppler-utils is missing")


def words_of(path):
    """The text of a PDF, its lines as they are read; minus signs of pictures as those of tables."""
    done = subprocess.run(["pdftotext", "-layout", path, "-"], capture_output=True, text=True, check=True)
    return done.stdout.replace("\N{ZERO WIDTH SPACE}", "").replace("\N{MINUS SIGN}", "-")


def numbers_in(summary, key=""):
    """Keys and values of the numbers of a summary that are forces, factors or of the order sheet."""
    if isinstance(summary, dict):
        for name, value in summary.items():
            yield from numbers_in(value, f"{key}/{name}")
    elif isinstance(summary, list | tuple):
        for value in summary:
            yield from numbers_in(value, key)
    elif isinstance(summary, float | int) and not isinstance(summary, bool):
        last = key.rsplit("/", 1)[-1]
        if last.endswith("_N") or "factor" in key or "utilisation_" in last or key.startswith("/order"):
            yield key, float(summary)


def check_numbers(text, *summaries):
    """Every number is in the text to three digits; components that are rounding beside the largest force are 0."""
    shown = np.unique([float(one) for one in NUMBER.findall(text)])
    wanted = [pair for summary in summaries for pair in numbers_in(summary)]
    assert len(wanted) > 40
    largest = max(abs(value) for key, value in wanted if key.endswith("_N"))
    lost = [
        (key, value)
        for key, value in wanted
        if np.abs(shown - value).min() > max(5e-3 * abs(value), 1e-4 * largest * key.endswith("force_N"))
        and not key.endswith(("utilisation_pointwise_max", "/at_mm"))
    ]
    assert not lost


@pytest.fixture(scope="module")
def divider():
    """A divider on an S-shaped track with three combinations."""
    angle = np.radians(np.linspace(0.0, 100.0, 13))
    first = np.stack([300.0 * np.sin(angle), 300.0 * (1.0 - np.cos(angle))], axis=-1)
    path = np.concatenate([first, 2.0 * first[-1] - first[-2::-1]])
    cases = [Combination("ULS 1", weight=1.35, bar=1.5, point=0.0), Combination("ULS $2$ #push", point=1.5)]
    scene = Scene(
        Rectangle(1500.0, 600.0),
        [
            Track(path=path.tolist(), pitch=250.0, height=700.0, capacity=60.0),
            Bar(mass=3.0),
            PointLoad((750.0, 300.0), (0.0, 0.0, 5.0)),
        ],
        mesh=Mesh(cells=6),
        combination=[*cases, Combination("SLS")],
        project=Project(title="Foyer #1 *divider* $a_b$ @x <y>", client="A & B", date="2026-11-28"),
    )
    return solve(scene)


@needs_pdftotext
@pytest.mark.slow
def test_a_divider_is_handed_in_with_every_force_its_plan_and_its_order(divider, tmp_path):
    divider.write_report(tmp_path / "r.pdf")
    text = words_of(tmp_path / "r.pdf")
    others = [found.summary.to_dict() | {"order": {}} for _, found in divider.combinations]  # ordered is what is given
    check_numbers(text, divider.summary.to_dict(), *others)
    lines = [line.split() for line in text.splitlines()]
    most = {one.point: one for one in divider.summary.envelope.support_forces}
    assert len(most) == 7
    for name, one in most.items():  # a design force beside its name and its combination
        assert [row for row in lines if row[:2] == name.split() and digits(one.force_N, 4) in row]
    for words in ("Foyer #1 *divider* $a_b$ @x <y>", "ULS $2$ #push", "A & B", "R 300 mm", "7 runners", "Plan, seen"):
        assert words.replace(" ", "") in re.sub(r"\s", "", text), words
    assert "1.35" in text
    again = tmp_path / "again.pdf"
    divider.write_report(again)
    assert again.read_bytes() == (tmp_path / "r.pdf").read_bytes()


def test_arcs_straights_and_corners_of_a_track_are_told():
    """An S of two arcs, a straight part and a corner: lengths, radii and turns are those that it was drawn with."""
    angle = np.radians(np.linspace(0.0, 90.0, 19))
    arc = np.stack([400.0 * np.sin(angle), -400.0 * (1.0 - np.cos(angle))], axis=-1)
    points = np.concatenate([[[-500.0, 0.0]], arc, [[400.0, -900.0], [1000.0, -900.0]]])
    line = Line(points)
    parts = track_parts(Curve(line.arc[-1], 0.0, line))
    assert [round(one.radius) for one in parts] == [0, 400, 0, 0]
    assert [round(one.length) for one in parts] == [500, round(400.0 * math.pi / 2.0), 500, 600]
    assert [round(one.turn) for one in parts] == [0, 90, 0, 0]
    assert [round(one.corner) for one in parts] == [0, 0, 0, -90]
    half = np.linspace(0.0, math.pi, 37)
    rounded = Line(np.round(np.stack([1200.0 * np.cos(half), -1200.0 * np.sin(half)], axis=-1), 1))
    (one,) = track_parts(Curve(rounded.arc[-1], 0.0, rounded))
    assert one.radius == pytest.approx(1200.0, abs=0.05)  # points rounded to 0.1 mm; by their turns 1201 mm
    round_track = Curve(1000.0, 0.0, None, 500.0, 2.0)
    middle, end = round_track.at(np.array([500.0, 1000.0]))
    assert middle[2] > end[2]  # bulges towards the viewer: seen from above it turns to the left
    assert track_parts(round_track)[0].turn == pytest.approx(math.degrees(2.0))


HOOKS = """
curtain = {width = 330.0, height = 252.9}
mesh = {cells = 6}
support = {kind = "hooks", pitch = 110.0}
load = {bar = {mass = 2.0}}
project = {date = 2026-11-28, client = "\N{CJK UNIFIED IDEOGRAPH-6F22} & <b>"}
combination = [{name = "more", bar = 1.5}]
"""


@needs_pdftotext
def test_pages_claim_their_standards_and_show_words_as_they_are_typed(tmp_path, monkeypatch):
    """Nothing of what a user types is markup; the same input gives the same bytes; rows of a long table are all there.
    With a date it is PDF/A too, and a letter that no font has costs the claim, not the report."""
    typed = '#let x = 1 $a_b$ *bold* @ref <label> \\ "quoted" `raw` // no comment /* = - + ~ [x]'
    scene, made = Scene(Rectangle(1.0, 1.0), project=Project(title=typed, date="2026-11-28")), tmp_path / "r.pdf"
    table = PageTable("T", ("name", "N"), [[f"row {k} of #{typed[:9]}", f"{k}"] for k in range(150)])
    sections = [Chapter(typed, [typed], tables=[table])]
    private, contents = "\U0010fffd", []
    projects = (scene.project, scene.project, Project(title=typed), Project(title=typed, client=private))
    for project in projects:
        of = replace(scene, project=project)
        if project.client:  # without the font of last resort that matplotlib has
            monkeypatch.setattr("matplotlib.get_data_path", lambda: str(tmp_path))
        write_pages(made, of, Headline([typed], None), [], sections, {"ring-mesh": "0"}, [])
        contents.append(made.read_bytes())
        text = re.sub(r"\s", "", words_of(made))
        assert text.count(re.sub(r"\s", "", typed)) >= 3
        assert re.findall(r"row(\d+)of", text) == [f"{k}" for k in range(150)]
    assert contents[0] == contents[1]
    claims = [(b"pdfaid:part" in content, b"pdfuaid:part" in content) for content in contents]
    assert claims == [(True, True), (True, True), (False, True), (False, False)]


@needs_pdftotext
@pytest.mark.slow
def test_the_command_writes_it_with_checksums(tmp_path):
    """A letter that no font has costs the claim of a standard, not the report; long names of files are broken."""
    scene = tmp_path / f"{'long_name_without_a_blank_' * 7}.toml"
    scene.write_text(HOOKS, encoding="utf-8")
    out = tmp_path / "o"
    run("macro_fem", "run", scene, "--out", out, "--no-picture", "--report", tmp_path / "r.pdf")
    text = words_of(tmp_path / "r.pdf")
    summary = json.loads((out / "summary.json").read_text())
    order = {key: value for key, value in summary["order"].items() if value is not None}
    assert pd.read_csv(out / "order.csv").dropna(axis=1).to_dict("records") == [pytest.approx(order)]
    check_numbers(text, summary)
    squeezed = re.sub(r"\s", "", text)
    assert subprocess.run(["sha256sum", scene], capture_output=True, text=True, check=True).stdout[:64] in squeezed
    assert not re.search(r"_N_|_mm\b|solver_", text)  # no keys
    assert "2026-11-28" in text


@pytest.mark.slow
def test_a_project_heads_reports_and_changes_no_answer():
    scene = Scene(Rectangle(100.0, 80.0), [Hooks(count=3)], mesh=Mesh(cells=3))
    named = replace(scene, project=Project(title="T"))
    assert repr(named) == repr(scene)  # by which answers are kept
    assert solve(named).summary.mean_height_mm == solve(scene).summary.mean_height_mm
    with pytest.raises(InputError, match=r"tittle.*did you mean title"):
        macro_fem.read_scene({"curtain": {"width": 1.0, "height": 1.0}, "project": {"tittle": "T"}})
    with pytest.raises(InputError, match=r"\[project\] title = 3: expected a text"):
        macro_fem.read_scene({"curtain": {"width": 1.0, "height": 1.0}, "project": {"title": 3}})


@pytest.mark.slow
def test_the_verdict_is_three_lines_that_say_what_the_summary_says():
    summary = solve(Scene(Rectangle(100.0, 80.0), [Hooks(count=3, capacity=1.0)], mesh=Mesh(cells=3))).summary
    first, second, third = verdict_lines(summary)
    assert first == f"The curtain holds with a factor {digits(summary.governing_factor, 4)}"
    assert summary.governing_link in second
    assert f"{digits(summary.governing_force_N, 4)} N at hook 2" in third
    failed = replace(summary, holds=False, governing_factor=0.5, governing_combination="C")
    assert verdict_lines(failed)[0] == "The curtain does NOT hold: factor 0.5 under C"
    unknown = replace(summary, holds=None, governing_factor=None)
    assert verdict_lines(unknown)[0].startswith("Only forces")
    taut = replace(summary, status="taut", message="too far")
    assert verdict_lines(taut)[0] == "No verdict, taut: too far"


@pytest.mark.slow
def test_a_factor_of_hooks_alone_is_one_of_at_most_and_told_as_such():
    """A net without rings: its own strength is not known; forces of its hooks are those of its assumed stiffness."""
    hooks = [Hooks(count=4, capacity=50.0, gather=0.95)]
    summary = solve(Scene(Rectangle(300.0, 200.0, areal_mass=1.0), hooks, mesh=Mesh(cells=6)), diagonal_net()).summary
    assert summary.holds
    assert summary.governing_note.startswith("the strength of the mesh is not known: ")
    assert verdict_lines(summary)[0].startswith("The curtain holds with a factor of at most ")
    assert "ring" not in (summary.support_forces_note or "")


def panels(size, count):
    """A plotter of panels with a black sheet of this width and height in each."""
    plotter, corners = (
        new_plotter(count),
        np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]),
    )
    for panel in range(count):
        plotter.subplot(0, panel)
        add(plotter, "_ground", surface(corners * [*size, 0.0], np.array([[0, 1, 2, 3]])), "black", **FLAT)
        look(plotter, (0.0, 0.0, -1.0))
    return plotter


@pytest.mark.slow
def test_a_picture_of_a_page_is_as_high_as_what_is_seen_on_it():
    """One panel and six in rows: nearly all of width and height is used; never more than a page."""
    for size, count in (((1.0, 1.3), 1), ((1.0, 1.5), 6)):
        figure = printed(panels(size, count), 87.0, 500.0)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        is_dark = np.asarray(canvas.buffer_rgba())[..., :3].max(axis=2) < 90
        assert np.ptp(np.flatnonzero(is_dark.any(axis=0))) > 0.85 * is_dark.shape[1]
        assert np.ptp(np.flatnonzero(is_dark.any(axis=1))) > 0.85 * is_dark.shape[0]
        assert figure.get_figwidth() * 25.4 == pytest.approx(87.0)
    assert printed(panels((1.0, 9.0), 1), 87.0, 100.0).get_figheight() * 25.4 == pytest.approx(100.0)


def test_a_missing_typesetter_is_one_sentence_that_names_the_extra(monkeypatch, tmp_path):
    monkeypatch.setattr("rve.common.errors.find_spec", lambda name: None if name == "typst" else name)
    answer = solve(Scene(Rectangle(100.0, 80.0), [Hooks(count=3)], mesh=Mesh(cells=3)))
    with pytest.raises(InputError, match=r"--report needs typst: run pip install typst \(extra report\)"):
        answer.write_report(tmp_path / "r.pdf")


MOVING = """
curtain = {width = 100.0, height = 80.0}
mesh = {cells = 3}
support = {kind = "hooks", count = 3}
[[load.wind]]
direction = [0.0, 0.0, -1.0]
pressure = 40.0
history = [[0.0, 0.0], [0.04, 1.0]]
"""


@needs_pdftotext
@pytest.mark.slow
def test_a_motion_and_its_modes_are_handed_in_too(tmp_path: Path) -> None:
    """Verdict, when the peak is, every force at the weakest moment; every frequency."""
    scene, out, made = tmp_path / "gust.toml", tmp_path / "out", tmp_path / "r.pdf"
    scene.write_text(MOVING + "[motion]\nduration = 0.04\nstep = 0.02\n")
    run("macro_fem", "run", scene, "--out", out, "--no-picture", "--report", made)
    summary = json.loads((out / "summary.json").read_text())
    text = words_of(made)
    shown = np.array([float(one) for one in NUMBER.findall(text)])
    wanted = [value for key, value in numbers_in(summary) if key.endswith(("_N", "factor"))]
    wanted += [summary["peak_support_force_at_s"], summary["at_s"]]
    least = 1e-4 * max(map(abs, wanted))
    assert all(np.abs(shown - value).min() <= max(5e-3 * abs(value), least) for value in wanted)
    assert "hook 3" in text
    assert "over time" in text
    run("macro_fem", "modes", scene, "--number", 1, "--out", tmp_path / "m", "--no-picture", "--report", made)
    found = json.loads((tmp_path / "m" / "modes.json").read_text())
    assert f"Lowest natural frequency: {digits(found['frequencies_Hz'][0], 4)} Hz" in words_of(made)
