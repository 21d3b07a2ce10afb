"""Points inside polygons and near their sides. Polygons are corners (k, 2) in order."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rve.common.records import Flags
from rve.common.types import Array


def inside(points: Array, outline: Array, holes: Sequence[Array] = ()) -> Flags:
    """Which points (n, 2) lie inside the outline and outside every hole, (n,), by the even-odd rule.

    >>> inside(np.array([[0.5, 0.5], [1.5, 0.5]]), np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]))
    array([ True, False])
    """
    order = np.argsort(points[:, 1])  # so that each side looks only at the points of its heights
    x, y = points[order].T
    result = np.zeros(len(points), bool)
    for polygon in (outline, *holes):
        crossed = np.zeros(len(points), bool)
        for (ax, ay), (bx, by) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            if ay != by:
                part = slice(*np.searchsorted(y, (min(ay, by), max(ay, by))))
                crossed[part] ^= x[part] < ax + (y[part] - ay) * (bx - ax) / (by - ay)
        result = crossed if polygon is outline else result & ~crossed
    back = np.empty_like(result)
    back[order] = result
    return back


def distance_to_polygon(points: Array, polygon: Array, reach: float = math.inf) -> Array:
    """Distance (n,) to the nearest side, or `reach` where that is farther; each side looks only at points in reach."""
    order = np.argsort(points[:, 1])
    lifted = points[order]
    best = np.full(len(points), reach)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        low, high = min(a[1], b[1]) - reach, max(a[1], b[1]) + reach
        part = slice(*np.searchsorted(lifted[:, 1], (low, high)))
        along = b - a
        s = np.clip((lifted[part] - a) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
        best[part] = np.minimum(best[part], np.linalg.norm(lifted[part] - a - s[:, None] * along, axis=1))
    back = np.empty_like(best)
    back[order] = best
    return back


def polygon_area(polygon: Array) -> float:
    """Area of a polygon that does not cross itself."""
    x, y = (polygon - polygon[0]).T
    return 0.5 * abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()))
