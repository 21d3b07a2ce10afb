"""Curtains on tracks: places and lengths in closed form, what follows from what, and what is refused."""

import math
import re

import numpy as np
import pytest

from macro_fem.scene.tables import Track
from macro_fem.scene.tracks import track_curve, track_places
from rve.common.errors import InputError

WHERE = "scene: [support] (track)"


def curve_of(edge_length=3000.0, **keys):
    return track_curve(Track(**keys), edge_length, 500.0, 2000.0, WHERE)


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
    curve = track_curve(item, 3000.0, 500.0, 2000.0, WHERE)
    places = track_places(item, curve, np.array([0.0, 1500.0, 3000.0]), 3000.0)
    begin = 0.0 if side == "start" else 1200.0
    assert places[:, 0] == pytest.approx([begin, begin + 400.0, begin + 800.0])


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"fullness": 2.0, "path": ((0.0, 0.0), (2000.0, 0.0))}, "fullness = 2: contradicts a track of 2000 mm"),
        ({"fullness": 0.5, "radius": 500.0}, "radius = 500: a track of 6000 mm"),
    ],
)
def test_lengths_that_contradict_each_other_are_refused(keys, message):
    with pytest.raises(InputError, match=re.escape(message)):
        curve_of(**keys)
