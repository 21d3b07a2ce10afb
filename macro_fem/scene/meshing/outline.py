"""Triangles inside any outline with holes: a lattice of the weave inside, the outline's own points around it."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial import Delaunay

from macro_fem.fem.cells import counterclockwise, signed_areas, triangle_areas
from rve.common import Array
from rve.common.numeric.polygons import inside, near_sides, region

MAX_LATTICE = 8_000_000
"""Lattice points in the box, turned with the weave, around the outline: 0.5 GB while they are chosen from."""
CLEARANCE = 0.55
"""Least distance of a lattice point to the boundary in units of the spacing: keeps boundary triangles from slivers."""


def regular_polygon(radius: float, sides: int) -> Array:
    """Corners (sides, 2) of the polygon with the area of the disk of `radius` around the origin, one at the top."""
    angle = 0.5 * math.pi + 2.0 * math.pi * np.arange(sides) / sides
    same_area = radius * math.sqrt(2.0 * math.pi / (sides * math.sin(2.0 * math.pi / sides)))
    return same_area * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def mesh_outline(
    outline: Array, holes: list[Array], cells: int, aspect: float, angle: float
) -> tuple[Array, np.ndarray]:
    """Points (n, 2) and counterclockwise triangles (m, 3) of the region inside `outline` and outside `holes`.

    The width is divided into `cells`; inner edges follow both diagonal families of a weave with cell sides in the ratio
    `aspect` whose y axis is turned by `angle` (radians). ValueError if the polygons touch, cross or leave no region,
    or are finer than the cells.
    """
    _check_polygons(outline, holes)
    spacing = float(np.ptp(outline[:, 0])) / cells
    border = [_subdivided(polygon, spacing) for polygon in (outline, *holes)]
    on_border = np.concatenate(border)
    inner = _lattice(outline, spacing, aspect, angle)
    inner = inner[inside(inner, outline, holes)]
    for polygon in (outline, *holes):
        inner = inner[~near_sides(inner, polygon, CLEARANCE * spacing)]
    points = np.concatenate([on_border, inner])
    triangles = Delaunay(points).simplices
    triangles = triangles[inside(points[triangles].mean(axis=1), outline, holes)]
    triangles = counterclockwise(points, triangles)
    triangles = triangles[triangle_areas(points[triangles]) > 0.5e-6 * spacing**2]
    _check_border(triangles, [len(part) for part in border])
    used, triangles = np.unique(triangles, return_inverse=True)
    return points[used], triangles.reshape(-1, 3)


def _subdivided(polygon: Array, spacing: float) -> Array:
    """The polygon's corners and points between them at most `spacing` apart."""
    parts = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        n = max(1, math.ceil(float(np.linalg.norm(b - a)) / spacing - 1e-9))
        parts.append(a + (b - a) * (np.arange(n) / n)[:, None])
    return np.concatenate(parts)


def _lattice(outline: Array, spacing: float, aspect: float, angle: float) -> Array:
    """Corners and centres of rectangles spacing x aspect spacing, turned by `angle`, that cover the outline."""
    centre = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    reach = np.abs((outline - centre) @ turn).max(axis=0) + spacing * (1.0 + aspect)
    n, m = math.ceil(reach[0] / spacing), math.ceil(reach[1] / (spacing * aspect))
    if 8 * n * m > MAX_LATTICE:
        raise ValueError(
            f"outline: the lattice of the weave around it has {8 * n * m:.3g} points, at most {MAX_LATTICE:.3g} are "
            "allowed; use fewer cells, or a shape that is less slender across the weave"
        )
    i, j = np.meshgrid(np.arange(-n, n + 1.0), np.arange(-m, m + 1.0), indexing="ij")
    corners = np.stack([i.ravel(), j.ravel()], axis=-1)
    local = np.concatenate([corners, corners + 0.5]) * spacing * np.array([1.0, aspect])
    return centre + local @ turn.T


def _check_polygons(outline: Array, holes: list[Array]) -> None:
    import shapely

    gaps: list[Any] = []
    for number, polygon in enumerate((outline, *holes)):
        name = f"hole {number}" if number else "outline"
        if np.any(np.linalg.norm(polygon - np.roll(polygon, -1, axis=0), axis=1) == 0.0):
            raise ValueError(f"{name}: has two equal corners in a row")
        flat, sides = 1e-9 * float(np.ptp(polygon, axis=0).max()) ** 2, shapely.LinearRing(polygon)
        if not sides.is_simple and sides.convex_hull.area > flat:
            raise ValueError(f"{name}: crosses itself")
        if abs(signed_areas(polygon)) <= flat:
            raise ValueError(f"{name}: has no area, its corners lie on a line")
    whole = region(outline)
    for k, gap in enumerate(map(region, holes), start=1):
        if not whole.contains_properly(gap):
            raise ValueError(f"holes: hole {k} is not inside the outline")
        for j, other in enumerate(gaps, start=1):
            if gap.intersects(other):
                raise ValueError(f"holes: hole {k} and hole {j} overlap")
        gaps.append(gap)


def _check_border(triangles: np.ndarray, lengths: list[int]) -> None:
    """Every piece of the border is an edge of the mesh: else corners are closer together than the cells."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).tolist()
    edges, ends = set(map(frozenset, pairs)), np.cumsum([0, *lengths])
    for first, end in pairwise(ends):
        number = np.arange(first, end)
        if not edges.issuperset(map(frozenset, zip(number.tolist(), np.roll(number, -1).tolist(), strict=True))):
            raise ValueError("outline and holes: come closer to each other than the cells are wide; use more cells")
