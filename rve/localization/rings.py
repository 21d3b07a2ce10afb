"""Every ring of a curtain: which lattice points lie in it, where its rings go, and how they fit their neighbours.

The weave's lattice has its origin at the middle of the curtain, so that a symmetric curtain gets symmetric rings. A
ring goes to the deformed place x(X) of its lattice point, so that neighbouring cells meet, and tilts as in the
localized pose of the cell that it lies in, turned with the curtain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rve.common.records import Rows as Records
from rve.common.types import Array
from rve.geometry.cell import Cell
from rve.geometry.circles import are_linked, dot, local_minima
from rve.geometry.pose import Pose
from rve.localization.curtain import Curtain
from rve.localization.frames import turns
from rve.localization.poses import RingStates, shares

Index = NDArray[np.intp]

_CHUNK = 100_000
"""Pairs measured together: keeps the arrays of samples below 100 MB."""
NEAR = 0.5
"""Gaps between the rings of a curtain are searched up to this many r1."""


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


def axes_of_weave(cell: Cell, hang_deg: float) -> Array:
    """Matrix (2, 2) from the weave's own axes to those of the curtain; a reflection if the grain is x."""
    angle = np.radians(hang_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if hang_deg % 90.0 == 0.0:
        turn = np.round(turn)
    return turn @ np.eye(2)[::-1] if cell.grain == "x" else turn


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
    for ring, share in enumerate(_reference_shares(cell)):
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


def _reference_shares(cell: Cell) -> Array:
    """Shares (K, 2) of the lattice vectors in the centres of the weave's rings."""
    weave = cell.weave
    pose = Pose(weave.start_lattice[None], weave.start_centres[None], weave.start_normals[None])
    return np.concatenate([np.zeros((1, 2)), shares(pose)[0]])


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


def place_rings(curtain: Curtain, sites: Sites, states: RingStates, row: Index, cell: Cell, axes: Array) -> Rings:
    """The rings of the sites; row (n,) is the pose of each in `states`, in weave axes."""
    turn = turns(curtain, sites.triangle, states.E[row], axes)
    weights = _barycentric(curtain.X[curtain.triangles[sites.triangle]], sites.X)
    centre = np.einsum("nk,nkx->nx", weights, curtain.x_in_space[curtain.triangles[sites.triangle]])
    ring = sites.index[:, 0]
    share = _reference_shares(cell)
    found = np.concatenate([np.zeros((len(states.E), 1, 2)), shares(states.pose)], axis=1)
    off = (found - share)[row, ring]
    shift = cell.r1 * (off[:, :1] * states.pose.a1[row] + off[:, 1:] * states.pose.a2[row])
    centre = centre + np.einsum("nxy,ny->nx", turn[:, :, :2], shift)
    return Rings(sites, centre, np.einsum("nxy,ny->nx", turn, states.pose.normals[row, ring]))


@dataclass(frozen=True)
class Fit:
    """How the rings of a curtain fit.

    gap_mm (n,): smallest gap to any neighbour, negative where they overlap, inf where none is near; links,
    linked: number of pairs that the weave links, and of those that interlink; broken (n,): rings that lost a link.
    """

    gap_mm: Array
    links: int
    linked: int
    broken: NDArray[np.bool_]


def fit_of(rings: Rings, cell: Cell) -> Fit:
    """Gaps between all rings that may touch, and whether the pairs that the weave links interlink, as placed."""
    index = rings.sites.index
    low = index[:, 1:].min(axis=0) - 1
    shape = (cell.weave.classes, *(index[:, 1:].max(axis=0) - low + 2))
    table = np.full(shape, -1)
    table[index[:, 0], index[:, 1] - low[0], index[:, 2] - low[1]] = np.arange(len(index))
    gap, broken = np.full(len(index), np.inf), np.zeros(len(index), dtype=bool)
    links = linked = 0
    for (a, b, i, j), is_link in zip(cell.weave.pairs, cell.weave.linked, strict=True):
        first = np.flatnonzero(index[:, 0] == a)
        to = index[first, 1:] + (i, j) - low
        there = ((to >= 0) & (to < shape[1:])).all(axis=1)
        first, to = first[there], to[there]
        second = table[b, to[:, 0], to[:, 1]]
        first, second = first[second >= 0], second[second >= 0]
        for k in range(0, len(first), _CHUNK):
            one, two = first[k : k + _CHUNK], second[k : k + _CHUNK]
            d = (rings.centre[two] - rings.centre[one]) / cell.r1
            _lower(gap, one, two, d, rings.normal, cell)
            if is_link:
                holds = are_linked(d, rings.normal[one], rings.normal[two], 1.0)
                links, linked = links + len(holds), linked + int(holds.sum())
                broken[one[~holds]] = broken[two[~holds]] = True
    return Fit(gap, links, linked, broken)


def _lower(gap: Array, one: Index, two: Index, d: Array, normal: Array, cell: Cell) -> None:
    """Lowers the gaps (n,) of rings `one` and `two` to those between them; d (m, 3) from centre to centre in r1."""
    reach = 2.0 * cell.wire + NEAR
    near = np.flatnonzero(dot(d, d) < (2.0 + reach) ** 2)
    found = local_minima(d[near], normal[one[near]], normal[two[near]], 1.0, reach=reach)
    size = cell.r1 * found.distance - 2.0 * cell.r2
    for rings in (one, two):
        np.minimum.at(gap, rings[near[found.pair]], size)
