"""Contacts of a pose: every contact of every pair of rings of a cell, batched over load cases."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rve.common.types import Array
from rve.geometry.circles import Minima, are_linked, dot, local_minima
from rve.geometry.pose import Pose, pair_geometry
from rve.geometry.weave import Weave

SLOTS = 2  # minima kept per pair of rings, the lowest two: linked rings have no more


@dataclass(frozen=True)
class Contacts:
    """Contacts of a batch, pair by pair and slot by slot: present (n, p, SLOTS) says which slots are filled.

    gap (n, p, SLOTS) in units of r1, inf where empty; rho (n, p, SLOTS, 3) the point on ring a; minima holds the filled
    slots in the order of np.nonzero(present); normal_a, normal_b (m, 3) the ring normals of each.
    """

    present: NDArray[np.bool_]
    gap: Array
    rho: Array
    minima: Minima
    normal_a: Array
    normal_b: Array
    links_intact: NDArray[np.bool_]

    def take(self, rows: NDArray[np.intp]) -> Contacts:
        """The contacts of these cases (rows in ascending order)."""
        n, p = self.gap.shape[:2]
        place = np.full(n, -1)
        place[rows] = np.arange(len(rows))
        case, pair = np.divmod(self.minima.pair, p)
        keep = place[case] >= 0
        minima = self.minima.take(keep)
        minima = replace(minima, pair=place[case[keep]] * p + pair[keep])
        return Contacts(
            self.present[rows],
            self.gap[rows],
            self.rho[rows],
            minima,
            self.normal_a[keep],
            self.normal_b[keep],
            self.links_intact[rows],
        )

    def put(self, rows: NDArray[np.intp], other: Contacts) -> Contacts:
        """A copy in which the cases `rows` (ascending) have the contacts of `other`."""
        n, p = self.gap.shape[:2]
        replaced = np.zeros(n, dtype=bool)
        replaced[rows] = True
        keep = ~replaced[self.minima.pair // p]
        case, pair = np.divmod(other.minima.pair, p)
        moved_minima = replace(other.minima, pair=np.asarray(rows)[case] * p + pair)
        minima = self.minima.take(keep).joined(moved_minima)
        order = np.argsort(minima.pair, kind="stable")
        normals = [
            np.concatenate([mine[keep], theirs])[order]
            for mine, theirs in ((self.normal_a, other.normal_a), (self.normal_b, other.normal_b))
        ]
        fields = []
        for name in ("present", "gap", "rho", "links_intact"):
            array = getattr(self, name).copy()
            array[rows] = getattr(other, name)
            fields.append(array)
        return Contacts(fields[0], fields[1], fields[2], minima.take(order), normals[0], normals[1], fields[3])

    @property
    def min_gap(self) -> Array:
        """Smallest gap of each case, (n,)."""
        return self.gap.reshape(len(self.gap), -1).min(axis=1)


def joined_contacts(parts: list[Contacts], order: NDArray[np.intp]) -> Contacts:
    """The cases of all parts, one after the other, then in this order: case i of the result is case order[i]."""
    offsets = np.cumsum([0, *(len(part.gap) for part in parts)])
    p = parts[0].gap.shape[1]
    place = np.argsort(order)
    minima, normal_a, normal_b = [], [], []
    for part, offset in zip(parts, offsets, strict=False):
        case, pair = np.divmod(part.minima.pair, p)
        minima.append(replace(part.minima, pair=place[case + offset] * p + pair))
        normal_a.append(part.normal_a)
        normal_b.append(part.normal_b)
    all_minima = minima[0].joined(*minima[1:])
    rows = np.argsort(all_minima.pair, kind="stable")
    fields = [np.concatenate([getattr(part, name) for part in parts])[order] for name in ("present", "gap", "rho")]
    return Contacts(
        fields[0],
        fields[1],
        fields[2],
        all_minima.take(rows),
        np.concatenate(normal_a)[rows],
        np.concatenate(normal_b)[rows],
        np.concatenate([part.links_intact for part in parts])[order],
    )


def find_contacts(pose: Pose, weave: Weave, wire: float, reach: float, *, far_pairs: bool = False) -> Contacts:
    """Every contact of every case whose gap is below `reach` (in r1), and whether all links are intact.

    wire = r2/r1. Pairs whose centres are farther apart than two circles can reach are not looked at, or with
    `far_pairs` for nothing.
    """
    d, na, nb = (x.reshape(-1, 3) for x in pair_geometry(pose, weave))
    limit = 2.0 * wire + reach
    near = np.arange(len(d)) if far_pairs else np.flatnonzero(can_touch(d, limit))
    found = local_minima(d[near], na[near], nb[near], 1.0, reach=limit)
    return contacts_of(replace(found, pair=near[found.pair]), (d, na, nb), weave, wire)


def can_touch(d: Array, limit: float) -> NDArray[np.bool_]:
    """Whether circles of radius 1 with offsets d (..., 3) can come as near as `limit`."""
    return np.asarray(dot(d, d) < (2.0 + limit) ** 2)


def contacts_of(found: Minima, geometry: tuple[Array, Array, Array], weave: Weave, wire: float) -> Contacts:
    """Minima put in their slots; `geometry` is offset and normals of every pair of every case, each (n * p, 3)."""
    d, na, nb = geometry
    p = len(weave.pairs)
    n = len(d) // p
    rank = np.zeros(len(found.pair), dtype=int)
    for back in range(1, SLOTS + 1):
        rank[back:] += found.pair[back:] == found.pair[:-back]
    found = found.take(rank < SLOTS)
    slot = found.pair * SLOTS + rank[rank < SLOTS]
    present = np.zeros(n * p * SLOTS, dtype=bool)
    present[slot] = True
    gap = np.full(n * p * SLOTS, np.inf)
    gap[slot] = found.distance - 2.0 * wire
    rho = np.zeros((n * p * SLOTS, 3))
    rho[slot] = found.rho_a
    linked = are_linked(d, na, nb, 1.0).reshape(n, p)
    shape = (n, p, SLOTS)
    return Contacts(
        present.reshape(shape),
        gap.reshape(shape),
        rho.reshape(*shape, 3),
        found,
        na[found.pair],
        nb[found.pair],
        (linked == weave.linked).all(axis=1),
    )


def parallel_clearance(before: Pose, after: Pose, weave: Weave, wire: float, samples: int = 12) -> Array:
    """Smallest gap (n,) of parallel rings, those of one class, on the straight way between two poses, ends left out.

    Rings of one class can pass through each other at two points at once, which no linking number tells. Their distance
    is closed form: with height h and in-plane offset rho it is |h| where the projections cross (rho <= 2), and
    hypot(rho - 2, h) outside.
    """
    same = weave.pairs[:, 0] == weave.pairs[:, 1]
    (d0, n0, _), (d1, n1, _) = pair_geometry(before, weave), pair_geometry(after, weave)
    lowest = np.full(len(d0), np.inf)
    for t in np.arange(1, samples) / samples:
        d = (1.0 - t) * d0[:, same] + t * d1[:, same]
        n = (1.0 - t) * n0[:, same] + t * n1[:, same]
        h = dot(d, n) / np.sqrt(dot(n, n))
        rho = np.sqrt(np.maximum(dot(d, d) - h**2, 0.0))
        distance = np.where(rho <= 2.0, np.abs(h), np.hypot(rho - 2.0, h))
        lowest = np.minimum(lowest, distance.min(axis=1, initial=np.inf))
    return lowest - 2.0 * wire
