"""Which outlines are meshed, with which area."""

import numpy as np
import pytest
import shapely
from scipy.spatial import cKDTree

from macro_fem.fem import signed_areas
from macro_fem.scene import mesh_outline


def star(radii):
    """Corners around the origin at even angles: no two sides cross, whatever the radii."""
    angle = 2.0 * np.pi * np.arange(len(radii)) / len(radii)
    return radii[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


@pytest.mark.parametrize("seed", range(8))
def test_jagged_outlines_are_meshed_whole_and_those_whose_sides_cross_refused(seed):
    rng = np.random.default_rng(seed)
    outline, hole = star(rng.uniform(50.0, 100.0, 11)), star(rng.uniform(12.0, 25.0, 7))
    points, triangles = mesh_outline(outline, [hole], 40, 1.15, 0.3)
    area = signed_areas(points[triangles])
    assert area.min() > 0.0
    assert area.sum() == pytest.approx(shapely.Polygon(outline, [hole]).area, rel=1e-9)
    with pytest.raises(ValueError, match=r"bound no region: (Ring )?Self-intersection"):
        mesh_outline(outline[2 * np.arange(11) % 11], [], 40, 1.15, 0.3)


def test_a_side_beyond_the_end_of_another_does_not_cross_it():
    """The tip of the notch is 0.7 mm from a side whose line it points across; their boxes overlap."""
    outline = np.array([[-5, -5], [12, -5], [12, 8], [9.5, 13], [-5, 13], [-5, 9], [10, 10], [0, 0]], float)
    points, triangles = mesh_outline(outline, [], 34, 1.15, 0.3)
    assert signed_areas(points[triangles]).sum() == pytest.approx(shapely.Polygon(outline).area, rel=1e-9)
    with pytest.raises(ValueError, match=r"bound no region: (Ring )?Self-intersection"):
        mesh_outline(np.where(outline == 10.0, 10.8, outline), [], 34, 1.15, 0.3)


@pytest.mark.parametrize("angle", [0.0, np.pi / 4.0])
def test_square_cells_of_a_symmetric_outline_are_symmetric(angle):
    outline = np.array([[0, 0], [9, 0], [9, 7], [4.5, 11], [0, 7]], float)
    points, triangles = mesh_outline(outline, [], 12, 1.0, angle)
    middle = points[triangles].mean(axis=1)
    assert cKDTree(middle).query([9.0, 0.0] + [-1.0, 1.0] * middle)[0].max() < 1e-9
