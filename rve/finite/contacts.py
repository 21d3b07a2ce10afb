"""Contacts of a finite mesh: every local minimum of the distance of the centre circles of every near pair of rings.

Lengths are in units of r1. Each pair has the key a n + b with a < b, by which its data are matched between poses.

Half-spaces and balls (`walls`) are further rows of `MeshPose`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from rve.common import Array, Flags, Index, Rows
from rve.finite.walls import wall_gaps
from rve.finite.wide import NO_WIDE, WideContacts, point_contacts, soft_pairs, widened
from rve.geometry.ring_pair import (
    Minima,
    are_linked,
    cross,
    dot,
    followed_minima,
    foot_on_circle,
    local_minima,
    norm,
    rotation,
    turned,
)

_CHUNK = 4096
"""Pairs sampled together: their samples stay in the cache of a processor."""


@dataclass(frozen=True)
class SoftMinima:
    """Which minima of distances are soft, so that they may split or merge in a step, and points beside them.

    curvature, flatness: soft are minima of less curvature whose stiffness^2 is less than `flatness` times their gap.
    growth: guard points are where the gap has grown by this multiple of itself. outer, count: fixed points reach to
    where it has grown by `outer` times itself; so many leave it at most 5 % less halfway between two of them.
    """

    curvature: float = 0.3
    flatness: float = 100.0
    growth: float = 3.0
    outer: float = 30.0
    count: int = 26

    def angles(self, minima: Minima, wires: Array, growth: float) -> tuple[Flags, Array]:
        """Which minima (m,) are soft, and the angles (m,) from them at which the gap has grown by `growth` times; wires
        (m,): radii of both wires together."""
        gap = np.maximum(minima.distance - wires, 1e-13)
        stiff = np.maximum(minima.curvature, 0.0) / minima.distance
        soft = (minima.curvature < self.curvature) & (stiff**2 < self.flatness * gap)
        return soft, np.sqrt(np.sqrt(stiff * stiff + 4.0 * growth * gap) - stiff) / np.maximum(norm(minima.rho_a), 1e-9)


SOFT = SoftMinima()


@dataclass(frozen=True, eq=False)
class MeshPose:
    """Positions of rings in units of r1: centres x (n, 3) and unit normals (n, 3).

    The last `walls` rows are half-spaces: a point of the plane and the unit normal, towards the rings; or balls: their
    centres. radius (walls,): that of balls, inf for half-spaces. radii, wires (rows,) or (1,): of the centre circles in
    r1 and of the wires in r2; one number is that of all rings. Rows of walls count as wires of one r2.
    """

    x: Array
    normal: Array
    radius: Array = field(default_factory=lambda: np.zeros(0))
    radii: Array = field(default_factory=lambda: np.ones(1))
    wires: Array = field(default_factory=lambda: np.ones(1))

    @property
    def walls(self) -> int:
        """How many rows are half-spaces and balls."""
        return len(self.radius)

    @property
    def rings(self) -> int:
        """How many rows are rings."""
        return len(self.x) - self.walls

    def moved(self, q: Array) -> MeshPose:
        """Rings after the step q (n, 5): centres move by the first three, normals turn by the last two."""
        return replace(self, x=self.x + q[:, :3], normal=turned(self.normal, q[:, 3:]))

    def radii_of(self, rows: Index) -> Array:
        """Radii (k,) of the rings `rows` (k,)."""
        return np.broadcast_to(self.radii, len(self.x))[rows]

    def wires_of(self, a: Index, b: Index, wire: float) -> Array:
        """Radii (k,) of both wires of the pairs a, b (k,) together in r1; wire = r2/r1."""
        wires = np.broadcast_to(self.wires, len(self.x))
        return wire * (wires[a] + wires[b])

    def at_walls(self, ring: Index, wall: Index, wire: float) -> tuple[Array, ...]:
        """What `wall_gaps` and `wall_derivatives` take for the pairs (k,) of a ring and a wall."""
        sizes = self.radii_of(ring), self.wires_of(ring, ring, 0.5 * wire) - wire
        places = self.x[ring], self.normal[ring], self.x[wall], self.normal[wall], self.radius[wall - self.rings]
        return *places, *sizes


@dataclass(frozen=True, eq=False)
class MeshContacts:
    """Contacts of a pose; wire = r2/r1; reach: the gap up to which contacts count.

    a, b (p,): near pairs, sorted by key; key (p,); minima: their local minima, sorted by pair, `minima.pair` a row of a
    and b; fixed (m,): contacts at a fixed point of ring a, and those with walls; gap (m,); deepest (p,): smallest gap
    of each pair, inf beyond the reach; wide: points of wide contacts, whose gap is a mean and whose minimum is the
    deepest. Pairs whose b is not a ring are those with half-spaces and balls.
    """

    pose: MeshPose
    wire: float
    reach: float
    key: Index
    minima: Minima
    fixed: Flags
    gap: Array
    deepest: Array
    a: Index
    b: Index
    wide: WideContacts = NO_WIDE

    @property
    def wires(self) -> Array:
        """Radii (p,) of both wires of the pairs together."""
        return self.pose.wires_of(self.a, self.b, self.wire)

    @property
    def is_wall(self) -> Flags:
        """Pairs (p,) with half-spaces and balls."""
        return np.asarray(self.b >= self.pose.rings)

    @property
    def at_wall(self) -> Flags:
        """Contacts (m,) with half-spaces and balls."""
        return np.asarray(self.is_wall[self.minima.pair])

    @property
    def clearance(self) -> Array:
        """Relative travel (p,) of a pair beyond which a step is not safe; inf for half-spaces.

        Wires come no nearer than the radius of their ring to the centre of a ball that does not fit through it.
        """
        distance, wall = np.minimum(self.deepest, self.reach) + 2.0 * self.wires, self.is_wall
        R, a = self.pose.radius[self.b[wall] - self.pose.rings], self.pose.radii_of(self.a[wall])
        distance[wall] = 2.0 * R - np.where(a < R, 2.0 * a, 0.0)
        return distance

    @property
    def count(self) -> Index:
        """Minima of each pair (p,)."""
        return np.bincount(self.minima.pair, minlength=len(self.a))

    @property
    def wide_keys(self) -> Index:
        """Keys of the pairs with wide contacts."""
        return self.key[np.unique(self.wide.points.pair)]

    @property
    def is_wide(self) -> Flags:
        """Which contacts (m,) are wide."""
        out = np.zeros(len(self.gap), dtype=bool)
        out[self.wide.contact] = True
        return out

    @property
    def whole(self) -> Array:
        """Sum (m,) of the forces at the points of each contact over the force of its gap, 1 for others than wide."""
        out = np.ones(len(self.gap))
        out[self.wide.rows] = self.wide.sums(self.wide.shares(self.gap))
        return out

    def pair_max(self, values: Array) -> Array:
        """The greater of the values (n,) of both rings of each pair, (p,)."""
        return np.maximum(values[self.a], values[self.b])

    def barrier(self, gap: Array) -> Array:
        """x - 1 - log x (k,), x = gap / reach for gaps (k,) within reach, 0 beyond."""
        x = np.minimum(gap / self.reach, 1.0)
        return np.asarray(x - 1.0 - np.log(x))

    def central_forces(self, mu: Array | float) -> Array:
        """Forces (m,) on the central path, mu () or (m,); positive also where a gap is at the reach."""
        return np.asarray(mu * np.maximum(1.0 / self.gap - 1.0 / self.reach, 1e-8))

    def share_forces(self, total: Array, mu: Array | float) -> Array:
        """Forces (m,): the total force (p,) of each pair in the proportions of the central path; its forces if none."""
        central, pair = self.central_forces(mu), self.minima.pair
        per_pair = np.bincount(pair, central, minlength=len(self.key))
        return np.where(total[pair] > 0.0, total[pair] * central / np.maximum(per_pair[pair], 1e-300), central)


@dataclass(frozen=True, eq=False)
class FixedPoints(Rows):
    """Contact points that are fixed on ring a, in place of minima of the distance that are about to merge.

    key (k,): the pair of each point; rho (k, 3): the point relative to the centre of ring a; spacing (k,): distance of
    the next point, within which minima are replaced.

    Where two minima merge, they move with the cube root of the tilt of the rings, which no Newton step predicts. Gaps
    at fixed points are smooth, and forces at neighbouring points add up to a force at any place between them.
    """

    key: Index
    rho: Array
    spacing: Array

    def minima(self, pose: MeshPose, key: Index) -> Minima:
        """The points as contacts of the pairs that are among the sorted keys (p,)."""
        row = find_rows(key, self.key)
        row, rho = row[row >= 0], self.rho[row >= 0]
        a, b = np.divmod(key[row], len(pose.x))
        d, na, nb = pose.x[b] - pose.x[a], pose.normal[a], pose.normal[b]
        return point_contacts(row, foot_on_circle(rho, na, pose.radii_of(a)), d, nb, pose.radii_of(b))


def make_fixed_points(con: MeshContacts, pairs: Index, soft: SoftMinima = SOFT) -> FixedPoints:
    """Points around the soft minima of these pairs."""
    is_soft, outer = soft.angles(con.minima, con.wires[con.minima.pair], soft.outer)
    rows = np.flatnonzero(is_soft & ~con.fixed & np.isin(con.minima.pair, pairs))
    minima, angle = con.minima.take(rows), outer[rows] * np.linspace(-1.0, 1.0, soft.count)[:, None]
    rho = _points_beside(minima, con.pose.normal[con.a], angle)
    return FixedPoints(np.tile(con.key[minima.pair], soft.count), rho, np.tile(angle[1] - angle[0], soft.count))


NO_POINTS = FixedPoints(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0))


def find_mesh_contacts(
    pose: MeshPose,
    linked: Index,
    wire: float,
    reach: float,
    *,
    guard_points: bool = True,
    fixed_points: FixedPoints = NO_POINTS,
    soft: SoftMinima = SOFT,
    wide: Index | None = None,
) -> MeshContacts:
    """All contacts whose gap is below `reach` (r1); wire = r2/r1.

    Pairs are those of rings whose centres are near enough for that, the linked ones (m, 2), and rings near walls.
    guard_points: whether points beside soft minima are contacts as well. `fixed_points` replace the minima near them.
    wide (k,): keys of pairs that have wide contacts so far, which soft ones then get; None if none may.
    """
    n, rings, most = len(pose.x), pose.rings, 2.0 * float(pose.radii.max() + wire * pose.wires.max()) + reach
    near = cKDTree(pose.x[:rings]).query_pairs(most, output_type="ndarray").astype(np.int64)
    if len(pose.radii) > 1:
        a, b = near.T
        most_here = pose.radii_of(a) + pose.radii_of(b) + pose.wires_of(a, b, wire) + reach
        near = near[norm(pose.x[b] - pose.x[a]) < most_here]
    ring, wall = np.repeat(np.arange(rings), pose.walls), np.tile(np.arange(rings, n), rings)
    g = wall_gaps(*pose.at_walls(ring, wall, wire))
    is_near = (g < reach) | np.isfinite(pose.radius[wall - rings])  # balls may come from afar in one step
    keys = near.min(axis=1) * n + near.max(axis=1), linked[:, 0] * n + linked[:, 1], (ring * n + wall)[is_near]
    key = np.unique(np.concatenate(keys))
    a, b = np.divmod(key, n)
    d, na, nb = pose.x[b] - pose.x[a], pose.normal[a], pose.normal[b]
    ra, rb, wires = pose.radii_of(a), pose.radii_of(b), pose.wires_of(a, b, wire)
    two, at_wall = np.flatnonzero(b < rings), np.flatnonzero(b >= rings)
    parts = []
    for first in range(0, max(len(two), 1), _CHUNK):
        rows = two[first : first + _CHUNK]
        minima = local_minima(d[rows], na[rows], nb[rows], (ra[rows], rb[rows]), reach=wires[rows] + reach)
        parts.append(replace(minima, pair=rows[minima.pair]))
    minima = parts[0].join(parts[1:])
    deepest = np.full(len(key), np.inf)
    np.minimum.at(deepest, minima.pair, minima.distance - wires[minima.pair])
    points = NO_WIDE
    if wide is not None:
        minima, points = widened(minima, soft_pairs(minima, wires, np.isin(key, wide)), (d, na, nb, rb), wires)
    at_points = fixed_points.minima(pose, key)
    if len(fixed_points.key):
        tree = cKDTree(_located(fixed_points.key, fixed_points.rho))
        distance, point = tree.query(_located(key[minima.pair], minima.rho_a))
        minima = minima.take(distance >= fixed_points.spacing[point])
    free, zero, g = len(minima.pair), np.zeros((len(at_wall), 3)), g[is_near]
    others = [at_points, *([_guard_points(minima, d, na, nb, rb, wires, reach, soft)] if guard_points else ())]
    others.append(Minima(at_wall, -nb[at_wall], zero, zero, g + wires[at_wall], np.ones(len(g))).take(g < reach))
    minima = minima.join(others)
    order = np.argsort(minima.pair, kind="stable")
    minima, fixed = minima.take(order), order >= free
    gap = minima.distance - wires[minima.pair]
    np.minimum.at(deepest, minima.pair, gap)
    points = replace(points, contact=np.argsort(order)[points.contact])
    # Beyond the reach a force would be negative, and no force could change in a step.
    gap[points.rows] = np.minimum(points.mean(points.gap), reach)
    return MeshContacts(pose, wire, reach, key, minima, fixed, gap, deepest, a, b, points)


def _guard_points(
    minima: Minima, d: Array, na: Array, nb: Array, rb: Array, wires: Array, reach: float, soft: SoftMinima
) -> Minima:
    """Points of ring a to both sides of each soft minimum, which is about to split or has just merged."""
    is_soft, angle = soft.angles(minima, wires[minima.pair], soft.growth)
    rows, angle = minima.take(is_soft), np.minimum(angle[is_soft], 0.4)
    pair = np.tile(rows.pair, 2)
    points = point_contacts(pair, _points_beside(rows, na, np.stack([angle, -angle])), d[pair], nb[pair], rb[pair])
    return points.take(points.distance <= wires[pair] + reach)


def _points_beside(minima: Minima, na: Array, angle: Array) -> Array:
    """Points (k m, 3) of rings a at angles (k, m) from minima (m,); na (p, 3): normals of ring a of the pairs."""
    tau = cross(na[minima.pair], minima.rho_a)
    return np.asarray(np.cos(angle)[..., None] * minima.rho_a + np.sin(angle)[..., None] * tau).reshape(-1, 3)


def track_gaps(old: MeshContacts, pose: MeshPose) -> Array:
    """Gaps (m,) at the minima near the contacts of `old` in another pose, of wide ones at their points; inf for fixed
    points.

    Much cheaper than `find_mesh_contacts`. None is less than the least gap of its pair, so a closed one rejects a step.
    """
    gap = np.full(len(old.gap), np.inf)
    free = np.flatnonzero(~old.fixed)
    d, na, nb = pose.x[old.b] - pose.x[old.a], pose.normal[old.a], pose.normal[old.b]
    near, radii = old.minima.take(free), (pose.radii_of(old.a), pose.radii_of(old.b))
    gap[free] = followed_minima(near, d, na, nb, radii).distance - old.wires[near.pair]
    pair, rows = old.wide.points.pair, old.wide.rows
    before, rho = old.pose.normal[old.a[pair]], old.wide.points.rho_a
    turn = cross(before, na[pair])
    rho = rho + cross(turn, rho) + cross(turn, cross(turn, rho)) / (1.0 + dot(before, na[pair]))[:, None]
    points = point_contacts(pair, rho, d[pair], nb[pair], radii[1][pair])
    gap[rows] = np.where(gap[rows] > 0.0, old.wide.mean(points.distance - old.wires[pair]), gap[rows])
    return gap


def nearest_contacts(old: MeshContacts, new: MeshContacts) -> Index:
    """For each contact of `old` (m,) the nearest contact of the same pair in `new`, -1 if there is none."""
    old_at, new_at = (_located(con.key[con.minima.pair], con.minima.rho_a) for con in (old, new))
    distance, row = cKDTree(new_at).query(old_at, distance_upper_bound=3.0)
    return np.where(np.isfinite(distance), row, -1)


def _located(key: Index, rho: Array) -> Array:
    """Points (k, 4) of the scaled key and the direction of rho (k, 3): distances are angles, those of points of a pair
    within 2 and of other pairs farther."""
    return np.column_stack([9.0 * key, rho / np.maximum(norm(rho), 1e-9)[:, None]])


def links_intact(con: MeshContacts, linked_keys: Index) -> bool:
    """Whether exactly the linked pairs interlink among all near pairs; far pairs cannot."""
    x, normal, rings = con.pose.x, con.pose.normal, ~con.is_wall
    a, b = con.a[rings], con.b[rings]
    linked = are_linked(x[b] - x[a], normal[a], normal[b], (con.pose.radii_of(a), con.pose.radii_of(b)))
    return bool((linked == np.isin(con.key[rings], linked_keys)).all())


def find_rows(keys: Index, queries: Index) -> Index:
    """Rows (k,) of `queries` (k,) in the sorted `keys`, -1 for those that are not among them."""
    if not len(keys):
        return np.full(len(queries), -1)
    row = np.minimum(np.searchsorted(keys, queries), len(keys) - 1)
    return np.where(keys[row] == queries, row, -1)


def transfer_forces(old: MeshContacts, force: Array, new: MeshContacts, mu: Array) -> Array:
    """Forces (m,) of new contacts from those of old ones.

    Each old force is divided among the new contacts of its pair that are nearest to it, in the proportions of the
    central path; if there are none, the new contact nearest to it takes it. The others get the forces of the path.
    """
    central, parent, heir = new.central_forces(mu), nearest_contacts(new, old), nearest_contacts(old, new)
    rows, out = np.flatnonzero(parent >= 0), np.zeros(len(new.gap))
    central, force = central * new.whole, force * old.whole
    total = np.bincount(parent[rows], central[rows], minlength=len(force))
    out[rows] = force[parent[rows]] * central[rows] / total[parent[rows]]
    orphans = np.flatnonzero((total == 0.0) & (heir >= 0))
    np.add.at(out, heir[orphans], force[orphans])
    return np.where(out > 0.0, out, central) / new.whole


def travel_bounds(con: MeshContacts, q: Array) -> Array:
    """Bounds (p,) on the travel of any point of ring b relative to ring a in the step q (n, 5), for every near pair.

    Two rings that turn together do not move relative to each other. Seen from ring a, which turns with W_a, a point r
    of ring b moves with v - W_a x d + (W_b - W_a) x r, where d goes from a to b and v is its rate. W may have any part
    along the ring's normal n, since a spin moves no circle; the spins are those of least squares of both terms. In the
    course of the step n turns and d changes, each in proportion to the time.
    """
    a, b, pose = con.a, con.b, con.pose
    tilt = rotation(pose.normal, q[:, 3:])
    wa, wb, na, nb = tilt[a], tilt[b], pose.normal[a], pose.normal[b]
    d, v = pose.x[b] - pose.x[a], q[b, :3] - q[a, :3]
    turn, shift, arm = wb - wa, v - cross(wa, d), cross(na, d)
    r, s = pose.radii_of(a), pose.radii_of(b)
    aa, bb, ab = dot(arm, arm) + 1.001 * s * s, 1.001 * s * s, -dot(na, nb) * s * s
    ra, rb = dot(na, turn) * s * s + dot(arm, shift), -dot(nb, turn) * s * s
    det = aa * bb - ab * ab
    sa, sb = (bb * ra - ab * rb) / det, (aa * rb - ab * ra) / det
    turn, shift = turn + sb[:, None] * nb - sa[:, None] * na, shift - sa[:, None] * arm
    changing_a, changing_b = np.abs(sa) * norm(wa), np.abs(sb) * norm(wb)
    late = (s + norm(d) + norm(v)) * changing_a + s * changing_b + (norm(wa) + np.abs(sa)) * norm(v)
    plain = norm(v) + r * norm(wa) + s * norm(wb)
    return np.asarray(np.minimum(plain, norm(shift) + s * norm(turn) + 0.5 * late))


def safe_fractions(con: MeshContacts, q: Array) -> Array:
    """The fraction (p,) of a step within which no wire of a pair can pass through the other.

    Circles that cross during the step have D(0) + D(1) <= L, where D is their distance and L the longest relative
    travel of a point. D(1) >= both radii of wires, so L < D(0) + these is safe; nine tenths of it are allowed.
    """
    return np.asarray(np.minimum(1.0, 0.9 * con.clearance / np.maximum(travel_bounds(con, q), 1e-300)))


def is_passage_safe(old: MeshContacts, new: MeshContacts, q: Array) -> bool:
    """Whether no ring can have passed through another during the step q (n, 5), by `travel_bounds` for near pairs.

    Circles of other pairs can cross only if their centres come within the sum of their radii: their relative travel is
    then at least the sum of what both ends are beyond it.
    """
    limit = old.wires + old.reach
    rows = find_rows(new.key, old.key)
    end = np.where(rows >= 0, np.minimum(new.deepest[rows] + old.wires, limit), limit)
    room = old.clearance + np.where(old.is_wall, 0.0, np.maximum(end - old.wires, 0.0))
    if (travel_bounds(old, q) >= room).any():
        return False
    x0, x1 = (con.pose.x[: con.pose.rings] for con in (old, new))
    step = x1 - x0
    step = step - 0.5 * (step.max(axis=0) + step.min(axis=0))
    most = 2.0 * float(old.pose.radii.max()) + float(norm(step).max())
    pairs = cKDTree(0.5 * (x0 + x1)).query_pairs(most, output_type="ndarray")
    a, b = pairs.astype(np.int64).min(axis=1), pairs.astype(np.int64).max(axis=1)
    far = find_rows(old.key, a * len(old.pose.x) + b) < 0
    travel, d0, d1 = (u[b[far]] - u[a[far]] for u in (step, x0, x1))
    both = old.pose.radii_of(a[far]) + old.pose.radii_of(b[far])
    beyond = np.maximum(norm(d0) - both, 0.0) + np.maximum(norm(d1) - both, 0.0)
    return not (dot(travel, travel) >= beyond**2).any()
