"""Which outlines are meshed, with which area."""

import numpy as np
import pytest

from macro_fem.scene.meshing.mesh import mesh_outline


def area(points, triangles):
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def star(radii):
    """Corners around the origin at even angles: no two sides cross, whatever the radii."""
    angle = 2.0 * np.pi * np.arange(len(radii)) / len(radii)
    return radii[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def shoelace(polygon):
    x, y = polygon.T
    return 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1))


@pytest.mark.parametrize("seed", range(8))
def test_jagged_outlines_that_do_not_cross_are_meshed_whole(seed):
    rng = np.random.default_rng(seed)
    outline, hole = star(rng.uniform(50.0, 100.0, 11)), star(rng.uniform(12.0, 25.0, 7))
    points, triangles = mesh_outline(outline, [hole], 40, 1.15, 0.3)
    assert area(points, triangles).min() > 0.0
    assert area(points, triangles).sum() == pytest.approx(shoelace(outline) - shoelace(hole), rel=1e-9)


def test_a_side_beyond_the_end_of_another_does_not_cross_it():
    """The tip of the notch is 0.7 mm from a side whose line it points across; their boxes overlap."""
    outline = np.array([[-5, -5], [12, -5], [12, 8], [9.5, 13], [-5, 13], [-5, 9], [10, 10], [0, 0]], float)
    points, triangles = mesh_outline(outline, [], 34, 1.15, 0.3)
    assert area(points, triangles).sum() == pytest.approx(shoelace(outline), rel=1e-9)
    longer = np.where(outline == 10.0, 10.8, outline)
    with pytest.raises(ValueError, match=r"bound no region: (Ring )?Self-intersection"):
        mesh_outline(longer, [], 34, 1.15, 0.3)


@pytest.mark.parametrize("seed", range(8))
def test_every_second_corner_of_the_same_outlines_makes_sides_that_cross(seed):
    outline = star(np.random.default_rng(seed).uniform(50.0, 100.0, 11))
    with pytest.raises(ValueError, match=r"bound no region: (Ring )?Self-intersection"):
        mesh_outline(outline[2 * np.arange(11) % 11], [], 40, 1.15, 0.3)
