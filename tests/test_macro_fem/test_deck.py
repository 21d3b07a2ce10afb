"""A scene as a deck for CalculiX: what it holds and refuses, and the answer where CalculiX is built."""

import json
import os
import re

import numpy as np
import pytest

import homogenize
from macro_fem import read_scene
from macro_fem.deck import deck_lines, deck_problem, deck_text, run_deck
from rve.common import InputError

LAW = homogenize.default_law()
SQUARE = {"curtain": {"width": 1000.0, "height": 1000.0}, "mesh": {"cells": 16}, "support": {"kind": "corners"}}
SAIL = """\
[curtain]
shape = "outline"
outline = {outline}
holes = [[[500.0, 400.0], [800.0, 400.0], [800.0, 700.0], [500.0, 700.0]]]
[mesh]
cells = {cells}
[load]
gravity = {gravity}
"""
POINT = '[[support]]\nkind = "point"\nat = {at}\nmove = {move}\n'
PLANE = [[0.0, 0.0], [1400.0, 0.0], [1400.0, 1000.0], [700.0, 1300.0], [0.0, 1000.0]]
SPACE = [[0.0, 0.0], [1400.0, 0.0], [1400.0, 1000.0], [0.0, 1200.0]]
MOVES = [[0.0, 0.0, 0.0], [-100.0, 0.0, 300.0], [-100.0, -100.0, 0.0], [0.0, -100.0, 300.0]]


def sail(outline, held, moves, gravity, cells=20) -> str:
    """A scene file of a sail with a hole, held at corners `held` of its outline that move."""
    points = (POINT.format(at=outline[k], move=move) for k, move in zip(held, moves, strict=True))
    return SAIL.format(outline=outline, cells=cells, gravity=gravity) + "".join(points)


SCENES = {
    "plane": '[curtain]\nwidth = 1000.0\nheight = 1000.0\n[mesh]\ncells = 16\n[support]\nkind = "corners"\n',
    "plane sail": sail(PLANE, [2, 3, 4], [[0.0, 0.0]] * 3, 9.81),
    "space sail": sail(SPACE, range(4), MOVES, [0.0, 0.0, -9.81]),
}
SCENES["space"] = SCENES["plane"] + "[solver]\nspace = true\n"
HOOKS = """\
[curtain]
width = 1000.0
height = 800.0
[mesh]
cells = {cells}
[support]
kind = "hooks"
count = 5
sliding = {sliding}
[load.bar]
mass = 2.0
"""
SCENES["hooks that slide"] = HOOKS.format(cells=16, sliding="true")


def rows(text: str, keyword: str) -> np.ndarray:
    """The numbers after the first line that begins with a keyword."""
    body = text[re.search(rf"^\{keyword}.*\n", text, re.MULTILINE).end() :]
    return np.array([line.split(",") for line in body[: body.index("\n*")].splitlines()], float)


def test_a_deck_holds_the_mesh_the_loads_and_the_bar_of_its_scene():
    scene = SQUARE | {"load": {"bar": {"mass": 2.0}, "point": {"at": [500.0, 500.0], "force": [3.0, 0.0]}}}
    text = deck_text(deck_problem(read_scene(scene), LAW))
    X, cells = rows(text, "*NODE")[:, 1:3], rows(text, "*ELEMENT")[:, 1:].astype(int) - 1
    sides = X[cells[:, 1:]] - X[cells[:, :1]]
    assert 0.5 * np.linalg.det(sides).sum() == pytest.approx(1e6)
    assert (np.linalg.det(sides) > 0.0).all()
    loads = rows(text, "*CLOAD")
    weight = 9.81 * (LAW.cell.areal_mass_kg_per_m2 + 2.0)
    assert [loads[loads[:, 1] == axis, 2].sum() for axis in (1, 2)] == pytest.approx([3.0, -weight])
    ties = re.findall(r"\*EQUATION\n3\n(.*)\n", text)
    x = X @ [1.0, 0.3] + 7.0  # an affine field keeps a line straight
    for tie in ties:
        node, _, one, first, _, a, last, _, b = (float(part) for part in tie.split(","))
        assert one * x[int(node) - 1] + a * x[int(first) - 1] + b * x[int(last) - 1] == pytest.approx(0.0, abs=1e-9)
    assert len(ties) == 2 * (np.count_nonzero(X[:, 1] == 0.0) - 2)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"obstacle": {"kind": "floor", "height": 10.0}}, r"\[obstacle\]: a deck"),
        ({"combination": [{"name": "A", "weight": 1.35}]}, r"\[combination\]: a deck"),
        ({"mesh": {"cells": 8, "element": "P2"}}, r"\[mesh\] element = 'P2'"),
        ({"solver": {"bounds": True}}, "bounds and adapt"),
        ({"load": {"gravity": 0.0}}, "nothing pulls"),
        ({"load": {"wind": {"direction": [0.0, 0.0, 1.0], "pressure": 10.0, "follows": True}}}, "follows the shape"),
    ],
)
def test_what_a_deck_cannot_hold_is_refused(more, message):
    with pytest.raises(InputError, match=message):
        deck_problem(read_scene(SQUARE | more), LAW)


def test_a_deck_is_in_place_however_calculix_ends(tmp_path, monkeypatch):
    (tmp_path / "scene.toml").write_text(SCENES["plane"])
    monkeypatch.setenv("CALCULIX", str(tmp_path / "missing"))
    with pytest.raises(InputError, match="missing"):
        run_deck(tmp_path / "scene.toml", None, tmp_path / "out")
    assert json.loads((tmp_path / "out" / "deck.json").read_text())["status"] == "written"
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["deck.inp", "deck.json", "umat.f"]


@pytest.mark.skipif("CALCULIX" not in os.environ, reason="CALCULIX is not the folder made by .ci/calculix")
@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=pytest.mark.slow if "hooks" in k else pytest.mark.release) for k in SCENES]
)
def test_calculix_finds_our_curtain_from_a_flat_start(name, tmp_path):
    (tmp_path / "scene.toml").write_text(SCENES[name])
    found = run_deck(tmp_path / "scene.toml", None, tmp_path / "out")
    assert found["status"] == found["our_status"] == "converged"
    assert 500 < found["cells"] < 2000
    assert found["force_error"] < 0.01
    assert found["height_error"] < 0.005
    assert found["mean_height_mm"] == pytest.approx(found["our_mean_height_mm"], rel=0.005)


@pytest.mark.skipif("CALCULIX" not in os.environ, reason="CALCULIX is not the folder made by .ci/calculix")
@pytest.mark.slow
def test_hooks_that_are_held_sideways_share_the_load_in_another_way_and_it_is_said(tmp_path):
    """Balance leaves it open: what differs are forces that add up to nothing."""
    (tmp_path / "scene.toml").write_text(HOOKS.format(cells=8, sliding="false"))
    found = run_deck(tmp_path / "scene.toml", None, tmp_path / "out")
    assert found["status"] == "converged"
    assert found["height_error"] < 0.005
    assert found["force_error"] > 0.01
    sums = [np.sum([one[key] for one in found["supports"]], axis=0) for key in ("force_N", "our_force_N")]
    assert sums[0] == pytest.approx(sums[1], abs=1e-3)
    assert "hooks that slide agree" in deck_lines(found, tmp_path)[-1]
