"""Regions of the plane and points in them, by shapely. Polygons are corners (k, 2) in order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rve.common.records import Array, Flags


def region(outline: Array, holes: Sequence[Array] = ()) -> Any:
    """The `shapely.Polygon` inside the outline and outside of every hole, prepared for many points."""
    import shapely

    polygon = shapely.Polygon(outline, holes)
    shapely.prepare(polygon)
    return polygon


def inside(points: Array, outline: Array, holes: Sequence[Array] = ()) -> Flags:
    """Which points (n, 2) lie inside the outline and outside of every hole, (n,); those on a side do not.

    >>> import numpy as np
    >>> inside(np.array([[0.5, 0.5], [1.5, 0.5]]), np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]))
    array([ True, False])
    """
    import shapely

    found: Flags = shapely.contains_xy(region(outline, holes), points)
    return found


def near_sides(points: Array, polygon: Array, distance: float) -> Flags:
    """Which points (n, 2) are no farther than a distance from the sides of a polygon, (n,)."""
    import shapely

    sides = shapely.LinearRing(polygon)
    shapely.prepare(sides)
    found: Flags = shapely.dwithin(sides, shapely.points(points), distance)
    return found
