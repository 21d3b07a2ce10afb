"""Contacts of a finite mesh: every local minimum of the distance of the centre circles of every near pair of rings.

Lengths are in units of r1. Pairs are told by the key a n + b with a < b, so that what belongs to a pair is found again.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from rve.common import Array, Flags, Index, Rows
from rve.finite.walls import wall_gaps
from rve.geometry.ring_pair import (
    Minima,
    are_linked,
    cross,
    followed_minima,
    foot_on_circle,
    local_minima,
    norm,
    turned,
)

SOFT, FLAT, NEXT = 0.3, 100.0, 3.0
"""Minima with less than the first curvature, and stiffness^2 less than the second times the gap, are soft; points
beside them are where the gap has grown by the third times itself."""
_OUTER, _POINTS = 30.0, 26
"""Fixed points beside a soft minimum reach to where its gap has grown by the first times itself; so many leave the gap
at most 5 % less half-way between two of them."""
_CHUNK = 4096
"""Pairs sampled together: their samples stay in the cache of a processor."""


@dataclass(frozen=True, eq=False)
class Placed:
    """Rings in space in units of r1: centres x (n, 3) and unit normals (n, 3).

    The last `walls` rows are half-spaces instead: a point of the plane and the unit normal, towards the rings; or
    balls: their centres. `radius` (walls,): that of balls, inf of half-spaces.
    """

    x: Array
    normal: Array
    radius: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def walls(self) -> int:
        """How many rows are half-spaces and balls."""
        return len(self.radius)

    @property
    def rings(self) -> int:
        """How many rows are rings."""
        return len(self.x) - self.walls

    def moved(self, q: Array) -> Placed:
        """Rings after the step q (n, 5): centres move by the first three, normals turn by the last two."""
        return Placed(self.x + q[:, :3], turned(self.normal, q[:, 3:]), self.radius)


@dataclass(frozen=True, eq=False)
class Touching:
    """Placed rings and their contacts; wire = r2/r1, and the gap `reach` up to which contacts count.

    a, b (p,): near pairs, sorted by key; key (p,); minima: their local minima, sorted by pair, `minima.pair` a row of a
    and b; fixed (m,): contacts that keep their point of ring a, and those with walls; gap (m,); deepest (p,): smallest
    gap of each pair, inf where it has none within reach. A pair whose b is no ring is one with a half-space or ball.
    """

    placed: Placed
    wire: float
    reach: float
    key: Index
    minima: Minima
    fixed: Flags
    gap: Array
    deepest: Array
    a: Index
    b: Index

    @property
    def is_wall(self) -> Flags:
        """Pairs (p,) with half-spaces and balls."""
        return np.asarray(self.b >= self.placed.rings)

    @property
    def at_wall(self) -> Flags:
        """Contacts (m,) with half-spaces and balls."""
        return np.asarray(self.is_wall[self.minima.pair])

    @property
    def clear(self) -> Array:
        """The way (p,) of one of a pair as seen from the other beyond which a step is not safe; inf for half-spaces.

        Wires come no nearer than r1 to the centre of a ball that goes through no ring: it cannot slip through the mesh.
        """
        distance = np.minimum(self.deepest, self.reach) + 4.0 * self.wire
        R, wall = self.placed.radius, self.is_wall
        distance[wall] = (2.0 * R - np.where(R > 1.0, 2.0, 0.0))[self.b[wall] - self.placed.rings]
        return distance

    @property
    def count(self) -> Index:
        """Minima of each pair (p,)."""
        return np.bincount(self.minima.pair, minlength=len(self.a))

    def greater(self, of: Array) -> Array:
        """The greater value (p,) of the rings (n,) of each pair."""
        return np.maximum(of[self.a], of[self.b])

    def barrier(self, gap: Array) -> Array:
        """x - 1 - log x (k,) of gaps x (k,) over the reach, 0 from there on: rises without bound where they close."""
        x = np.minimum(gap / self.reach, 1.0)
        return np.asarray(x - 1.0 - np.log(x))

    def central(self, mu: Array | float) -> Array:
        """Forces (m,) on the central path, mu () or (m,), a little more than none where a gap is at the reach."""
        return np.asarray(mu * np.maximum(1.0 / self.gap - 1.0 / self.reach, 1e-8))

    def shared(self, total: Array, mu: Array | float) -> Array:
        """Forces (m,): the total force (p,) of each pair shared out as on the central path, or that of the path."""
        fresh, pair = self.central(mu), self.minima.pair
        whole = np.bincount(pair, fresh, minlength=len(self.key))
        return np.where(total[pair] > 0.0, total[pair] * fresh / np.maximum(whole[pair], 1e-300), fresh)


@dataclass(frozen=True, eq=False)
class FixedPoints(Rows):
    """Pairs that touch at points which keep their place on ring a: key (k,) of the pair of each point, the point
    relative to the centre of ring a (k, 3), and the way to the next one (k,), up to which it stands for minima.

    Where two minima merge the least one moves by the cube root of what rings turn: no step of Newton's method can tell
    where it will be, nor how many there will be. Points so close that the gap between them is hardly less have smooth
    gaps, and their forces add up to one anywhere between them.
    """

    key: Index
    rho: Array
    way: Array

    def minima(self, placed: Placed, key: Index) -> Minima:
        """The points as contacts of those pairs that are among the sorted keys (p,)."""
        row = of_pairs(key, self.key)
        row, rho = row[row >= 0], self.rho[row >= 0]
        a, b = np.divmod(key[row], len(placed.x))
        d, na, nb = placed.x[b] - placed.x[a], placed.normal[a], placed.normal[b]
        return _touch_at(row, foot_on_circle(rho, na), d, nb)


def fixed_points(con: Touching, pairs: Index) -> FixedPoints:
    """Points around the soft minima of these pairs, where they have some."""
    soft, outer = _softness(con.minima, con.wire, _OUTER)
    rows = np.flatnonzero(soft & ~con.fixed & np.isin(con.minima.pair, pairs))
    minima, angle = con.minima.take(rows), outer[rows] * np.linspace(-1.0, 1.0, _POINTS)[:, None]
    rho = _aside(minima, con.placed.normal[con.a], angle)
    return FixedPoints(np.tile(con.key[minima.pair], _POINTS), rho, np.tile(angle[1] - angle[0], _POINTS))


NOWHERE = FixedPoints(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0))


def find_touching(
    placed: Placed, linked: Index, wire: float, reach: float, *, beside: bool = True, points: FixedPoints = NOWHERE
) -> Touching:
    """All contacts whose gap is below `reach` (r1), and points beside soft ones; wire = r2/r1.

    Looked at are the pairs of rings with centres nearer than 2 + 2 wire + reach, and the linked ones (m, 2). Pairs that
    have fixed `points` touch there in place of the minima beside them.
    """
    n, rings, limit = len(placed.x), placed.rings, 2.0 * wire + reach
    near = cKDTree(placed.x[:rings]).query_pairs(2.0 + limit, output_type="ndarray").astype(np.int64)
    ring, wall = np.repeat(np.arange(rings), placed.walls), np.tile(np.arange(rings, n), rings)
    radius = placed.radius[wall - rings]
    g = wall_gaps(placed.x[ring], placed.normal[ring], placed.x[wall], placed.normal[wall], radius)
    kept = (g < reach) | np.isfinite(radius)  # balls may come from afar in one step
    keys = near.min(axis=1) * n + near.max(axis=1), linked[:, 0] * n + linked[:, 1], (ring * n + wall)[kept]
    key = np.unique(np.concatenate(keys))
    a, b = np.divmod(key, n)
    d, na, nb = placed.x[b] - placed.x[a], placed.normal[a], placed.normal[b]
    two, at_wall = np.flatnonzero(b < rings), np.flatnonzero(b >= rings)
    parts = []
    for first in range(0, max(len(two), 1), _CHUNK):
        rows = two[first : first + _CHUNK]
        found = local_minima(d[rows], na[rows], nb[rows], reach=limit)
        parts.append(replace(found, pair=rows[found.pair]))
    minima = parts[0].join(parts[1:])
    deepest = np.full(len(key), np.inf)
    np.minimum.at(deepest, minima.pair, minima.distance - 2.0 * wire)
    at_points = points.minima(placed, key)
    if len(points.key):
        away, point = cKDTree(_located(points.key, points.rho)).query(_located(key[minima.pair], minima.rho_a))
        minima = minima.take(away >= points.way[point])
    free, zero, g = len(minima.pair), np.zeros((len(at_wall), 3)), g[kept]
    others = [at_points, *([_beside_soft(minima, d, na, nb, wire, limit)] if beside else ())]
    others.append(Minima(at_wall, -nb[at_wall], zero, zero, g + 2.0 * wire, np.ones(len(g))).take(g < reach))
    minima = minima.join(others)
    order = np.argsort(minima.pair, kind="stable")
    minima, fixed = minima.take(order), order >= free
    gap = minima.distance - 2.0 * wire
    np.minimum.at(deepest, minima.pair, gap)
    return Touching(placed, wire, reach, key, minima, fixed, gap, deepest, a, b)


def _beside_soft(minima: Minima, d: Array, na: Array, nb: Array, wire: float, limit: float) -> Minima:
    """Points of ring a at fixed angles to both sides of each soft minimum.

    A soft minimum is about to split or has just merged; what is beside it will be the next one.
    """
    soft, angle = _softness(minima, wire, NEXT)
    rows, angle = minima.take(soft), np.minimum(angle[soft], 0.4)
    pair = np.tile(rows.pair, 2)
    found = _touch_at(pair, _aside(rows, na, np.stack([angle, -angle])), d[pair], nb[pair])
    return found.take(found.distance <= limit)


def _aside(minima: Minima, na: Array, angle: Array) -> Array:
    """Points (k m, 3) of rings a at angles (k, m) beside minima (m,); na (p, 3): the normals of their pairs."""
    tau = cross(na[minima.pair], minima.rho_a)
    return np.asarray(np.cos(angle)[..., None] * minima.rho_a + np.sin(angle)[..., None] * tau).reshape(-1, 3)


def _softness(minima: Minima, wire: float, times: float = NEXT) -> tuple[Flags, Array]:
    """Which minima (m,) are soft, and the angles (m,) beside them where the gap has grown by so many times itself."""
    gap = np.maximum(minima.distance - 2.0 * wire, 1e-13)
    stiff = np.maximum(minima.curvature, 0.0) / minima.distance
    soft = (minima.curvature < SOFT) & (stiff**2 < FLAT * gap)
    return soft, np.sqrt(np.sqrt(stiff * stiff + 4.0 * times * gap) - stiff)


def _touch_at(pair: Index, rho_a: Array, d: Array, nb: Array) -> Minima:
    """Points (m, 3) of ring a, and of ring b those nearest to them, as contacts of the pairs (m,)."""
    rho_b = foot_on_circle(rho_a - d, nb)
    w = d + rho_b - rho_a
    distance = norm(w)
    return Minima(pair, w / distance[:, None], rho_a, rho_b, distance, np.ones(len(pair)))


def followed_gaps(old: Touching, placed: Placed) -> Array:
    """Gaps (m,) beside the contacts of `old` after a step, inf at fixed points; none is less than the gap of its pair.

    Cheaper than `find_touching` by far, and enough to refuse a step.
    """
    out = np.full(len(old.gap), np.inf)
    real = np.flatnonzero(~old.fixed)
    d, na, nb = placed.x[old.b] - placed.x[old.a], placed.normal[old.a], placed.normal[old.b]
    out[real] = followed_minima(old.minima.take(real), d, na, nb).distance - 2.0 * old.wire
    return out


def nearest(old: Touching, new: Touching) -> Index:
    """For each contact of `old` (m,) the nearest one of the same pair in `new`, -1 where there is none."""
    old_at, new_at = (_located(con.key[con.minima.pair], con.minima.rho_a) for con in (old, new))
    distance, row = cKDTree(new_at).query(old_at, distance_upper_bound=3.0)
    return np.where(np.isfinite(distance), row, -1)


def _located(key: Index, rho: Array) -> Array:
    """Points rho (k, 3) in space with the key as a coordinate: those of one pair are within 2, of others far away."""
    return np.column_stack([9.0 * key, rho])


def links_intact(con: Touching, linked_keys: Index) -> bool:
    """Whether exactly the linked pairs interlink among all near pairs; far pairs cannot."""
    x, normal, rings = con.placed.x, con.placed.normal, ~con.is_wall
    a, b = con.a[rings], con.b[rings]
    found = are_linked(x[b] - x[a], normal[a], normal[b])
    return bool((found == np.isin(con.key[rings], linked_keys)).all())


def of_pairs(keys: Index, asked: Index) -> Index:
    """Rows (k,) of the pairs `asked` (k,) among sorted keys, -1 where a pair is not among them."""
    if not len(keys):
        return np.full(len(asked), -1)
    place = np.minimum(np.searchsorted(keys, asked), len(keys) - 1)
    return np.where(keys[place] == asked, place, -1)


def handed_on(old: Touching, force: Array, new: Touching, mu: Array) -> Array:
    """Forces (m,) for new contacts: those of a pair that are nearest to an old one share its force out as on the
    central path; where none is, the nearest one takes it. Pairs that are new, or had no force, take those of the path.
    """
    fresh, parent, heir = new.central(mu), nearest(new, old), nearest(old, new)
    rows, out = np.flatnonzero(parent >= 0), np.zeros(len(new.gap))
    whole = np.bincount(parent[rows], fresh[rows], minlength=len(force))
    out[rows] = force[parent[rows]] * fresh[rows] / whole[parent[rows]]
    lone = np.flatnonzero((whole == 0.0) & (heir >= 0))
    np.add.at(out, heir[lone], force[lone])
    return np.where(out > 0.0, out, fresh)
