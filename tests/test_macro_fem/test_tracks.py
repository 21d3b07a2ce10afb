"""Curtains on tracks: places and lengths in closed form, what follows from what, and what is refused."""

import math

import numpy as np
import pytest

from homogenize import default_law
from macro_fem import Track, read_scene
from macro_fem.bounds import bound
from macro_fem.curtain import make_problem
from macro_fem.scene import Line, build_mesh
from tests.test_macro_fem.sheets import solve_scene

from .conftest import STRETCH_X

WHERE = "scene: [support] (track)"


def curve_of(edge_length=3000.0, **keys):
    return Track(**keys).curve(top_edge(edge_length), WHERE)


def top_edge(length=3000.0):
    return Line(np.array([[500.0 - 0.5 * length, 2000.0], [500.0 + 0.5 * length, 2000.0]]))


@pytest.mark.parametrize("angle", [90.0, -150.0, 300.0])
def test_an_arc_has_its_radius_length_and_ends(angle):
    curve = curve_of(radius=800.0, angle=angle)
    turn = math.radians(abs(angle))
    assert curve.length == pytest.approx(800.0 * turn, rel=1e-14)
    places = curve.at(np.linspace(0.0, curve.length, 4001))
    centre = np.array([500.0, 2000.0, -math.copysign(800.0, angle) * math.cos(turn / 2.0)])
    assert np.linalg.norm(places - centre, axis=1) == pytest.approx(800.0, rel=1e-12)
    assert places[[0, -1], 2] == pytest.approx(0.0, abs=1e-9)
    half = 800.0 * math.sin(turn / 2.0)
    assert places[[0, -1], 0] == pytest.approx([500.0 - half, 500.0 + half], abs=1e-9)
    assert places[2000, 2] == pytest.approx(math.copysign(800.0 * (1.0 - math.cos(turn / 2.0)), angle), abs=1e-9)
    chords = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert chords == pytest.approx(2.0 * 800.0 * math.sin(turn / 8000.0), rel=1e-9)


def test_a_path_is_walked_at_even_speed():
    curve = curve_of(path=((0.0, 0.0), (300.0, 400.0), (300.0, 1000.0)), height=1500.0)
    assert curve.length == 1100.0
    places = curve.at(np.array([0.0, 250.0, 500.0, 800.0, 1100.0]))
    exact = [[0, 1500, 0], [150, 1500, 200], [300, 1500, 400], [300, 1500, 700], [300, 1500, 1000]]
    assert places == pytest.approx(np.array(exact, float), abs=1e-12)


def test_what_is_open_follows_from_the_fullness():
    assert curve_of(fullness=1.5).length == pytest.approx(2000.0)
    assert curve_of(fullness=1.5).at(np.array([0.0, 2000.0]))[:, 0].tolist() == [-500.0, 1500.0]
    assert curve_of(fullness=1.5, radius=1000.0).angle == pytest.approx(2.0)
    assert curve_of(fullness=1.5, angle=-90.0).radius == pytest.approx(4000.0 / math.pi)
    assert curve_of(fullness=1.5, angle=-90.0).at(np.array([1000.0]))[0, 2] < 0.0
    assert curve_of(fullness=1.505, path=((0.0, 0.0), (2000.0, 0.0))).length == 2000.0


@pytest.mark.parametrize("side", ["start", "end"])
def test_a_drawn_curtain_covers_its_part_of_the_track(side):
    item = Track(path=((0.0, 0.0), (2000.0, 0.0)), drawn=0.4, side=side)
    curve = item.curve(top_edge(), WHERE)
    places = item.on_track(curve, np.array([0.0, 1500.0, 3000.0]), 3000.0)
    begin = 0.0 if side == "start" else 1200.0
    assert places[:, 0] == pytest.approx([begin, begin + 400.0, begin + 800.0])


def solved(scene_tables, law, support, **keys):
    scene = read_scene({**scene_tables(solver={"stabilising_tension": 0.0}, **keys), "support": support})
    return solve_scene(scene, law)


WIND = {"wind": {"pressure": 20.0, "direction": [0.0, 0.0, 1.0]}}


@pytest.mark.parametrize("element", ["P1", "P2"])
@pytest.mark.parametrize("pitch", [None, 25.0])
def test_a_straight_track_is_the_gathered_top_edge(ring_like, scene_tables, element, pitch):
    """Fullness 1.25 is gather = 0.8, runners are hooks that do not slide."""
    runners = {} if pitch is None else {"pitch": pitch}
    known = {"kind": "top" if pitch is None else "hooks", "gather": 0.8, **runners}
    supports = known, {"kind": "track", "fullness": 1.25, **runners}
    keys = {"mesh": {"cells": 4, "element": element}, "load": WIND}
    hung, track = (solved(scene_tables, ring_like, support, **keys) for support in supports)
    assert track.status == "converged"
    assert track.x == pytest.approx(hung.x, abs=1e-9)
    assert track.problem.supports.positions == pytest.approx(hung.problem.supports.positions, abs=1e-10)


def test_a_track_turned_in_plan_turns_the_curtain(ring_like, scene_tables):
    """A straight path at 37 degrees to the x axis, and the wind turned with it: the same potential and heights."""
    c, s = math.cos(math.radians(37.0)), math.sin(math.radians(37.0))
    found = []
    for way in ((1.0, 0.0), (c, s)):
        path = [[10.0 * way[0], 10.0 * way[1]], [90.0 * way[0], 90.0 * way[1]]]
        wind = {"wind": {"pressure": 20.0, "direction": [-way[1], 0.0, way[0]]}}
        solution = solved(scene_tables, ring_like, {"kind": "track", "path": path, "pitch": 25.0}, load=wind)
        force = solution.problem.force
        balance = (solution.reactions + force).sum(axis=0)
        assert np.abs(balance).max() < 1e-8 * np.abs(force.sum(axis=0)).max()
        found.append((force * solution.x).sum() / (np.linalg.norm(force, axis=1).sum() * 100.0))
    assert found[1] == pytest.approx(found[0], abs=1e-8)


@pytest.mark.parametrize("drawn", [1.0, 0.4])
def test_runners_hold_what_their_pitch_says_at_even_places(ring_like, scene_tables, drawn):
    """100 mm of mesh at a pitch of 12 mm have 8 spaces; between runners the way along the arc is the same."""
    support = {"kind": "track", "radius": 40.0, "angle": 90.0, "pitch": 12.0, "drawn": drawn, "height": 80.0}
    solution = solved(scene_tables, ring_like, support, mesh={"cells": 8})
    (held,) = solution.problem.supports.held
    assert len(held.nodes) == 9
    assert held.mask.all()
    X = solution.problem.disc.nodes[held.nodes]
    assert X[:, 0] == pytest.approx(np.linspace(0.0, 100.0, 9))
    assert held.positions[:, 1] == pytest.approx(80.0)
    middle = np.array([50.0, -40.0 * math.cos(math.pi / 4.0)])
    arms = held.positions[:, [0, 2]] - middle
    assert np.hypot(*arms.T) == pytest.approx(40.0, rel=1e-12)
    turns = np.degrees(np.arctan2(arms[:, 0], arms[:, 1]))
    assert turns == pytest.approx(np.linspace(-45.0, -45.0 + 90.0 * drawn, 9), abs=1e-9)
    assert solution.x[held.nodes] == pytest.approx(held.positions, abs=1e-9)


@pytest.mark.slow
def test_bounds_of_a_curtain_on_an_arc_close(ring_like, scene_tables):
    gaps = []
    for cells in (4, 8):
        support = {"kind": "track", "radius": 40.0, "angle": 120.0}
        solution = solved(scene_tables, ring_like, support, mesh={"cells": cells}, load=WIND)
        bounds = bound(solution)
        assert bounds.status == "converged"
        gaps.append(bounds.gap / np.linalg.norm(solution.problem.force, axis=1).sum() / 100.0)
    assert 0.0 < gaps[1] < 0.8 * gaps[0]


@pytest.mark.parametrize("pitch", [None, 25.0])
def test_a_track_too_long_for_the_mesh_is_refused(ring_like, scene_tables, pitch):
    """Just within what the rings let the edge be, and just beyond."""
    runners = {} if pitch is None else {"pitch": pitch}
    limit = 100.0 * STRETCH_X
    short = {"kind": "track", "path": [[0.0, 0.0], [0.999 * limit, 0.0]], **runners}
    assert solved(scene_tables, ring_like, short).status == "converged"
    beyond = {"kind": "track", "path": [[0.0, 0.0], [1.001 * limit, 0.0]], **runners}
    assert solved(scene_tables, ring_like, beyond).status == "infeasible"


BULGE = 400.0 * (1.0 - math.cos(math.pi / 6.0))


@pytest.mark.parametrize(("track", "straight", "told"), [
    ({"radius": 400.0, "angle": 60.0}, True, f"{BULGE:.1f} mm wide: straight = false"),
    ({"radius": 400.0, "angle": 60.0}, False, None),
    ({"path": [[0.0, 0.0], [400.0, 400.0]]}, True, None),
    ({"path": [[0.0, 0.0], [640.0, 0.0]]}, True, "fullness 0.938"),
])  # fmt: skip
def test_a_straight_bar_below_a_bent_track_and_a_track_longer_than_the_edge_are_told(track, straight, told):
    """An arc of 60 degrees bends within r (1 - cos 30)."""
    scene = {
        "curtain": {"width": 600.0, "height": 300.0},
        "mesh": {"cells": 4},
        "support": {"kind": "track", **track},
        "load": {"bar": {"mass": 1.0, "straight": straight}},
    }
    notes = make_problem(read_scene(scene), default_law(), build_mesh(read_scene(scene), None)).notes
    assert len(notes) == (told is not None)
    assert all(told in note for note in notes)
