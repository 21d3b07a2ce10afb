"""The solidity of the mesh: rings whose shadow is known in closed form, and a count by another way."""

import numpy as np
import pytest

import rve
from rve import DirectOptions
from rve.geometry import Pose
from rve.solve import reference_pose
from rve.wire import shadow


def one_ring(side, tilt):
    normal = [[[0.0, np.sin(tilt), np.cos(tilt)]]]
    return Pose(np.array([[side, side, 0.0]]), np.zeros((1, 1, 2)), np.array(normal))


@pytest.mark.parametrize(
    ("tilt", "wire", "exact", "rel"),
    [(0.0, 0.2, np.pi * (1.2**2 - 0.8**2), 5e-5), (np.pi / 2, 0.1, 2.0 * 0.2 + np.pi * 0.1**2, 1e-3)],
)
def test_a_ring_covers_an_annulus_and_on_edge_a_stadium(tilt, wire, exact, rel):
    """Seen on edge a ring is a rod of length 2 with round ends: its wire has two sides that cover each other."""
    assert shadow(one_ring(3.0, tilt), wire) == pytest.approx(exact / 9.0, rel=rel)


@pytest.mark.slow
@pytest.mark.parametrize("grain", ["x", "y"])
def test_the_solidity_of_the_reference_cell_is_that_of_random_sight_lines(grain):
    """2,000 random lines of sight, each against every ring nearby as a curve in space."""
    cell = rve.Cell(r1=5.0, r2=0.5, grain=grain)
    pose = reference_pose(cell, DirectOptions())
    rng = np.random.default_rng(3)
    axes = np.stack([pose.a1[0], pose.a2[0]])
    places = rng.random((2000, 2)) @ axes
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    is_hit = np.zeros(len(places), bool)
    for centre, normal in zip(pose.centres[0], pose.normals[0], strict=True):
        e1 = np.cross(normal, [1.0, 0.0, 0.0])
        e1 /= np.linalg.norm(e1)
        e2 = np.cross(normal, e1)
        circle = (np.cos(angle)[:, None] * e1 + np.sin(angle)[:, None] * e2)[:, :2] + centre
        for i in range(-2, 3):
            for j in range(-2, 3):
                away = places[:, None] - circle - np.array([i, j]) @ axes
                is_hit |= np.linalg.norm(away, axis=-1).min(axis=1) <= cell.r2 / cell.r1
    assert rve.solidity(cell) == pytest.approx(is_hit.mean(), abs=0.04)


def test_thicker_wire_is_more_solid_and_units_do_not_matter():
    thin, thick = rve.solidity(rve.Cell(5.0, 0.3)), rve.solidity(rve.Cell(5.0, 0.8))
    assert 0.0 < thin < thick < 1.0
    assert rve.solidity(rve.Cell(50.0, 3.0)) == pytest.approx(thin, abs=1e-4)
