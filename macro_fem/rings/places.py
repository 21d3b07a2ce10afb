"""Every ring of a curtain: which lattice points lie in it, where its rings go, and how they fit their neighbours.

The weave's lattice has its origin at the middle of the curtain, so that a symmetric curtain gets symmetric rings. A
ring goes to the deformed place x(X) of its lattice point, so that neighbouring cells meet, and tilts as in the
localized pose of the cell that it lies in, turned with the curtain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from macro_fem.rings.curtain import Curtain
from macro_fem.rings.frames import turns
from rve import Cell, NearestPoses, offsets, reference_shares
from rve.common.records import Rows as Records
from rve.common.types import Array

Index = NDArray[np.intp]


@dataclass(frozen=True)
class Sites(Records):
    """Where rings belong: index (n, 3) = class, i, j; X (n, 2) in mm before; triangle (n,), cell (n,) around them."""

    index: Index
    X: Array
    triangle: Index
    cell: Index


@dataclass(frozen=True)
class Rings:
    """Rings in space: centre (n, 3) in mm and unit normal (n, 3), in the axes of the curtain."""

    sites: Sites
    centre: Array
    normal: Array


def find_sites(
    curtain: Curtain, cell: Cell, sides: tuple[float, float], axes: Array, window: tuple[float, ...] | None = None
) -> Sites:
    """Lattice points of all classes inside the undeformed curtain, or inside a window x0, y0, x1, y1 of it.

    sides: b_x, b_y in r1 in the weave's own axes. A point on the edge of two triangles belongs to one of them.
    """
    low, high = curtain.X.min(axis=0), curtain.X.max(axis=0)
    middle = 0.5 * (low + high)
    # axes is orthogonal, so that it is its own inverse from the right
    lattice = (curtain.X - middle) @ axes / (cell.r1 * np.array(sides))
    corners = lattice[curtain.triangles]
    parts = []
    for ring, share in enumerate(reference_shares(cell)):
        triangle, ij = _inside(corners - share)
        index = np.column_stack([np.full(len(ij), ring), ij])
        X = ((ij + share) * cell.r1 * np.array(sides)) @ axes.T + middle
        parts.append((index, X, triangle))
    index, X, triangle = (np.concatenate(column) for column in zip(*parts, strict=True))
    sites = Sites(index, X, triangle, curtain.cell[triangle])
    if window is None:
        return sites
    x0, y0, x1, y1 = window
    keep = (X[:, 0] >= x0) & (X[:, 0] <= x1) & (X[:, 1] >= y0) & (X[:, 1] <= y1)
    return sites.take(keep)


def _inside(corners: Array) -> tuple[Index, Index]:
    """Triangle (n,) and whole-number point (n, 2) for all whole-number points in triangles with corners (t, 3, 2)."""
    low = np.ceil(corners.min(axis=1) - 1e-9).astype(int)
    count = np.maximum(np.floor(corners.max(axis=1) + 1e-9).astype(int) - low + 1, 0)
    total = count.prod(axis=1)
    triangle = np.repeat(np.arange(len(corners)), total)
    rank = np.arange(len(triangle)) - np.repeat(np.cumsum(total) - total, total)
    width = count[triangle, 0]
    ij = low[triangle] + np.column_stack([rank % np.maximum(width, 1), rank // np.maximum(width, 1)])
    inside = (_barycentric(corners[triangle], ij) >= -1e-9).all(axis=1)
    triangle, ij = triangle[inside], ij[inside]
    _, first = np.unique(ij, axis=0, return_index=True)
    return triangle[first], ij[first]


def _barycentric(corners: Array, point: Array) -> Array:
    """Barycentric coordinates (n, 3) of points (n, 2) in triangles (n, 3, 2)."""
    e1, e2, d = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], point - corners[:, 0]
    det = e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]
    b = (d[:, 0] * e2[:, 1] - d[:, 1] * e2[:, 0]) / det
    c = (e1[:, 0] * d[:, 1] - e1[:, 1] * d[:, 0]) / det
    return np.stack([1.0 - b - c, b, c], axis=1)


def place_rings(curtain: Curtain, sites: Sites, states: NearestPoses, row: Index, cell: Cell, axes: Array) -> Rings:
    """The rings of the sites; row (n,) is the pose of each in `states`, in weave axes."""
    turn = turns(curtain, sites.triangle, states.E[row], axes)
    weights = _barycentric(curtain.X[curtain.triangles[sites.triangle]], sites.X)
    centre = np.einsum("nk,nkx->nx", weights, curtain.x_in_space[curtain.triangles[sites.triangle]])
    ring = sites.index[:, 0]
    shift = offsets(states.pose, cell)[row, ring]
    centre = centre + np.einsum("nxy,ny->nx", turn[:, :, :2], shift)
    return Rings(sites, centre, np.einsum("nxy,ny->nx", turn, states.pose.normals[row, ring]))
