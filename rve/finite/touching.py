"""Contacts of a finite mesh: every local minimum of the distance of the centre circles of every near pair of rings.

Lengths are in units of r1. Pairs are told by the key a n + b with a < b, so that what belongs to a pair is found again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rve.common.types import Array
from rve.finite.walls import wall_gaps
from rve.geometry.circles import (
    Minima,
    are_linked,
    cross,
    dot,
    followed_minima,
    foot_on_circle,
    local_minima,
    tangent_frame,
)

Index = NDArray[np.intp]

_CHUNK = 4096
"""Pairs sampled together: their samples stay in the cache of a processor."""


@dataclass(frozen=True, eq=False)
class Placed:
    """Rings in space in units of r1: centres x (n, 3) and unit normals (n, 3).

    The last `walls` rows are half-spaces instead: a point of the plane and the unit normal, towards the rings.
    """

    x: Array
    normal: Array
    walls: int = 0

    @property
    def rings(self) -> int:
        """How many rows are rings."""
        return len(self.x) - self.walls

    def moved(self, q: Array) -> Placed:
        """Rings after the step q (n, 5): centres move by the first three, normals turn by the exponential map of the
        last two in their tangent frames."""
        e1, e2 = tangent_frame(self.normal)
        omega = q[:, 3:4] * e1 + q[:, 4:] * e2
        angle = np.sqrt(dot(omega, omega))[:, None]
        normal = np.cos(angle) * self.normal + np.sinc(angle / np.pi) * cross(omega, self.normal)
        return Placed(self.x + q[:, :3], normal / np.sqrt(dot(normal, normal))[:, None], self.walls)


@dataclass(frozen=True, eq=False)
class Touching:
    """Contacts of a placement.

    a, b (p,): near pairs, sorted by key; key (p,); minima: their local minima, sorted by pair, `minima.pair` a row of a
    and b; fixed (m,): contacts that keep their point of ring a, and those with half-spaces; gap (m,); deepest (p,):
    smallest gap of each pair, inf where it has none within reach. A pair with b >= rings is one with a half-space.
    """

    a: Index
    b: Index
    key: Index
    minima: Minima
    fixed: NDArray[np.bool_]
    gap: Array
    deepest: Array
    rings: int

    @property
    def at_wall(self) -> NDArray[np.bool_]:
        """Contacts (m,) with half-spaces."""
        return np.asarray(self.b[self.minima.pair] >= self.rings)

    @property
    def count(self) -> Index:
        """Minima of each pair (p,)."""
        return np.bincount(self.minima.pair, minlength=len(self.a))


def near_pairs(placed: Placed, limit: float, linked: Index) -> tuple[Index, Index, Index]:
    """a, b, key (p,) of all pairs of rings with centres nearer than 2 + limit, and of the linked pairs (m, 2)."""
    n = len(placed.x)
    pairs = cKDTree(placed.x[: placed.rings]).query_pairs(2.0 + limit, output_type="ndarray").astype(np.int64)
    key = np.unique(np.concatenate([pairs.min(axis=1) * n + pairs.max(axis=1), linked[:, 0] * n + linked[:, 1]]))
    return key // n, key % n, key


def find_touching(placed: Placed, linked: Index, wire: float, reach: float, *, beside: bool = True) -> Touching:
    """All contacts whose gap is below `reach` (r1), and points beside soft ones; wire = r2/r1."""
    limit = 2.0 * wire + reach
    a, b, key = near_pairs(placed, limit, linked)
    d, na, nb = placed.x[b] - placed.x[a], placed.normal[a], placed.normal[b]
    parts = []
    for first in range(0, max(len(a), 1), _CHUNK):
        rows = slice(first, first + _CHUNK)
        found = local_minima(d[rows], na[rows], nb[rows], 1.0, reach=limit)
        parts.append(replace(found, pair=found.pair + first))
    real = parts[0].join(parts[1:])
    minima, fixed = real, np.zeros(len(real.pair), dtype=bool)
    if beside:
        minima, fixed = with_neighbours(real, d, na, nb, wire, limit)
    if placed.walls:
        a, b, key, minima, fixed = _with_walls(placed, (a, b, key), minima, fixed, wire, reach)
    gap = minima.distance - 2.0 * wire
    deepest = np.full(len(a), np.inf)
    np.minimum.at(deepest, minima.pair, gap)
    return Touching(a, b, key, minima, fixed, gap, deepest, placed.rings)


def _with_walls(
    placed: Placed,
    pairs: tuple[Index, Index, Index],
    minima: Minima,
    fixed: NDArray[np.bool_],
    wire: float,
    reach: float,
) -> tuple[Index, Index, Index, Minima, NDArray[np.bool_]]:
    """The pairs a, b, key and contacts with those of rings and half-spaces within reach, sorted again."""
    n, x, normal = placed.rings, placed.x, placed.normal
    ring, wall = np.repeat(np.arange(n), placed.walls), np.tile(np.arange(n, len(x)), n)
    g = wall_gaps(x[ring], normal[ring], x[wall], normal[wall])
    near = g < reach
    ring, wall, g = ring[near], wall[near], g[near]
    rows, zero = len(pairs[0]) + np.arange(len(ring)), np.zeros((len(ring), 3))
    more = Minima(rows, -normal[wall], zero, zero, g + 2.0 * wire, np.ones(len(ring)))
    key = np.concatenate([pairs[2], ring * len(x) + wall])
    order = np.argsort(key)
    place = np.argsort(order)
    both = minima.join([more])
    both = replace(both, pair=place[both.pair])
    fixed = np.concatenate([fixed, np.ones(len(ring), dtype=bool)])
    sort = np.argsort(both.pair, kind="stable")
    a, b = (np.concatenate(column)[order] for column in zip(pairs[:2], (ring, wall), strict=True))
    return a, b, key[order], both.take(sort), fixed[sort]


def followed_gaps(old: Touching, placed: Placed, wire: float) -> Array:
    """Gaps (m,) beside the contacts of `old` after a step, inf at fixed points; none is less than the gap of its pair.

    Cheaper than `find_touching` by far, and enough to refuse a step.
    """
    out = np.full(len(old.gap), np.inf)
    real = np.flatnonzero(~old.fixed)
    a, b = old.a, old.b
    near = old.minima.take(real)
    found = followed_minima(near, placed.x[b] - placed.x[a], placed.normal[a], placed.normal[b], 1.0)
    out[real] = found.distance - 2.0 * wire
    return out


SOFT = 0.3
FLAT = 100.0
NEXT = 3.0


def with_neighbours(
    minima: Minima, d: Array, na: Array, nb: Array, wire: float, limit: float
) -> tuple[Minima, NDArray[np.bool_]]:
    """The minima and, beside each soft one, points of ring a at fixed angles to both sides; which are such points.

    A soft minimum is about to split or has just merged; what is beside it will be the next one.
    """
    gap = np.maximum(minima.distance - 2.0 * wire, 1e-13)
    stiff = np.maximum(minima.curvature, 0.0) / minima.distance
    soft = (minima.curvature < SOFT) & (stiff**2 < FLAT * gap)
    rows = minima.take(soft)
    t, g = stiff[soft], gap[soft]
    aside = np.minimum(np.sqrt(np.sqrt(t * t + 4.0 * NEXT * g) - t), 0.4)
    tau = cross(na[rows.pair], rows.rho_a)
    parts = [minima]
    for sign in (1.0, -1.0):
        c, s = np.cos(aside)[:, None], sign * np.sin(aside)[:, None]
        rho_a = c * rows.rho_a + s * tau
        rho_b = foot_on_circle(rho_a - d[rows.pair], nb[rows.pair], 1.0)
        w = d[rows.pair] + rho_b - rho_a
        distance = np.sqrt(dot(w, w))
        parts.append(Minima(rows.pair, w / distance[:, None], rho_a, rho_b, distance, np.ones(len(distance))))
    both = parts[0].join(parts[1:])
    fixed = np.arange(len(both.pair)) >= len(minima.pair)
    near = both.distance <= limit
    both, fixed = both.take(near), fixed[near]
    order = np.argsort(both.pair, kind="stable")
    return both.take(order), fixed[order]


def nearest(old: Touching, new: Touching) -> tuple[Index, Array]:
    """For each contact of `old` (m,) the nearest one of the same pair in `new`, -1 where there is none; how far."""
    place = np.minimum(np.searchsorted(new.key, old.key), len(new.key) - 1)
    count = np.where(new.key[place] == old.key, new.count[place], 0)
    first = np.concatenate([[0], np.cumsum(new.count)])[place]
    pair = old.minima.pair
    repeat = count[pair]
    mine = np.repeat(np.arange(len(pair)), repeat)
    rank = np.arange(len(mine)) - np.repeat(np.cumsum(repeat) - repeat, repeat)
    other = first[pair[mine]] + rank
    between = new.minima.rho_a[other] - old.minima.rho_a[mine]
    distance = dot(between, between)
    order = np.lexsort((distance, mine))
    best = order[np.concatenate([[True], np.diff(mine[order]) > 0])] if len(order) else order
    out, far = np.full(len(pair), -1), np.full(len(pair), np.inf)
    out[mine[best]], far[mine[best]] = other[best], distance[best]
    return out, far


def links_intact(placed: Placed, touching: Touching, linked_keys: Index) -> bool:
    """Whether exactly the linked pairs interlink among all near pairs; far pairs cannot."""
    rings = touching.b < touching.rings
    a, b = touching.a[rings], touching.b[rings]
    found = are_linked(placed.x[b] - placed.x[a], placed.normal[a], placed.normal[b], 1.0)
    return bool((found == np.isin(touching.key[rings], linked_keys)).all())


def of_pairs(keys: Index, asked: Index) -> Index:
    """Rows (k,) of the pairs `asked` (k,) among sorted keys, -1 where a pair is not among them."""
    if not len(keys):
        return np.full(len(asked), -1)
    place = np.minimum(np.searchsorted(keys, asked), len(keys) - 1)
    return np.where(keys[place] == asked, place, -1)


def handed_on(old: Touching, force: Array, new: Touching, fresh: Array) -> Array:
    """Forces (m,) for new contacts: a pair's contacts keep theirs where their number stays.

    Where it does not, the pair's total is shared out like `fresh` (m,), the forces of the central path; pairs that are
    new take these.
    """
    place = np.minimum(np.searchsorted(old.key, new.key), len(old.key) - 1)
    known = old.key[place] == new.key
    total = np.where(known, np.bincount(old.minima.pair, force, minlength=len(old.key))[place], 0.0)
    weight = np.bincount(new.minima.pair, fresh, minlength=len(new.key))
    pair = new.minima.pair
    shared = np.where(total[pair] > 0.0, total[pair] * fresh / np.maximum(weight[pair], 1e-300), fresh)
    same = known & (np.where(known, old.count[place], 0) == new.count)
    found, _ = nearest(new, old)
    rows = np.flatnonzero(same[pair])
    heir = found[rows]
    used = np.bincount(heir, minlength=len(force))
    once = np.bincount(pair[rows], used[heir] == 1, minlength=len(new.key)) == new.count
    good = once[pair[rows]]
    out = np.where(known[pair], shared, fresh)
    out[rows[good]] = force[heir[good]]
    return np.asarray(out)
