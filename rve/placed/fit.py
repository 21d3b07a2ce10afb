"""Rings of a weave in space: the axes of the weave, where rings of a cell are, how they fit their neighbours."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rve.common import Array, ByValue, Flags, Index, checked
from rve.geometry.cell import Cell
from rve.geometry.pattern import padded
from rve.geometry.pose import Pose, start_pose
from rve.geometry.ring_pair import are_linked, dot, local_minima
from rve.geometry.weave import Weave

_CHUNK = 100_000
"""Pairs measured together: keeps the arrays of samples below 100 MB."""
NEAR = 0.5
"""Gaps between placed rings are searched up to this many r1."""


@checked
def axes_of_weave(cell: Cell, hang_deg: float) -> Array:
    """Matrix (2, 2) from the axes of the weave to those of the curtain; a reflection if the grain is x."""
    angle = np.radians(hang_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if hang_deg % 90.0 == 0.0:
        turn = np.round(turn)
    return turn @ np.eye(2)[::-1] if cell.grain == "x" else turn


def shares(pose: Pose) -> Array:
    """Centres of rings as shares (n, K, 2) of the two lattice vectors; zero for the first class."""
    A = np.stack([pose.a1, pose.a2], axis=2)
    return np.asarray(np.linalg.solve(A[:, None], pose.centres[..., :2, None])[..., 0])


@checked
def reference_shares(cell: Cell) -> Array:
    """Centres of the rings of the reference cell as shares (K, 2) of its sides."""
    return np.asarray(shares(start_pose(cell.weave, 1))[0])


@checked
def offsets(pose: Pose, cell: Cell) -> Array:
    """Ways (n, K, 3) in mm to the rings of poses from their reference lattice points, in weave axes."""
    off = shares(pose) - reference_shares(cell)
    flat = off[..., :1] * pose.a1[:, None] + off[..., 1:] * pose.a2[:, None]
    return cell.r1 * np.concatenate([flat, padded(pose.centres)[..., 2:]], axis=2)


@dataclass(frozen=True, eq=False)
class Fit(ByValue):
    """How placed rings fit.

    gap_mm (n,): smallest gap to any neighbour, negative where they overlap, inf where none is near; links,
    linked: number of pairs that the weave links, and of those that interlink; broken (n,): rings that lost a link.
    """

    gap_mm: Array
    links: int
    linked: int
    broken: Flags


def neighbours(weave: Weave, index: Index) -> Iterator[tuple[int, Index, Index]]:
    """For each pair of the weave its number, and the rings (k,) that are its first and its second.

    index (n, 3): class and lattice point i, j of each ring.
    """
    low = index[:, 1:].min(axis=0) - 1
    shape = (weave.classes, *(index[:, 1:].max(axis=0) - low + 2))
    table = np.full(shape, -1)
    table[index[:, 0], index[:, 1] - low[0], index[:, 2] - low[1]] = np.arange(len(index))
    for pair, (a, b, i, j) in enumerate(weave.pairs):
        first = np.flatnonzero(index[:, 0] == a)
        to = index[first, 1:] + (i, j) - low
        is_inside = ((to >= 0) & (to < shape[1:])).all(axis=1)
        second = table[b, to[is_inside, 0], to[is_inside, 1]]
        yield pair, first[is_inside][second >= 0], second[second >= 0]


@checked
def fit_rings(index: Index, centre: Array, normal: Array, cell: Cell) -> Fit:
    """Gaps between all rings that may touch, and whether the linked pairs of the weave interlink.

    index (n, 3): class and lattice point i, j of each ring; centre (n, 3) in mm; unit normal (n, 3).
    """
    gap, broken = np.full(len(index), np.inf), np.zeros(len(index), dtype=bool)
    links, linked, weave = 0, 0, cell.weave
    radii, wires = zip(*weave.pair_radii, strict=True), cell.wire * weave.pair_wires
    for (pair, first, second), both, wire in zip(neighbours(weave, index), radii, wires.tolist(), strict=True):
        for k in range(0, len(first), _CHUNK):
            a, b = first[k : k + _CHUNK], second[k : k + _CHUNK]
            d = (centre[b] - centre[a]) / cell.r1
            near = np.flatnonzero(dot(d, d) < (sum(both) + wire + NEAR) ** 2)
            minima = local_minima(d[near], normal[a[near]], normal[b[near]], both, reach=wire + NEAR)
            for rings in (a, b):
                np.minimum.at(gap, rings[near[minima.pair]], cell.r1 * (minima.distance - wire))
            if weave.linked[pair]:
                is_linked = are_linked(d, normal[a], normal[b], both)
                links, linked = links + len(is_linked), linked + int(is_linked.sum())
                broken[a[~is_linked]] = broken[b[~is_linked]] = True
    return Fit(gap, links, linked, broken)
