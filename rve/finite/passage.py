"""Steps in which no wire can pass through another: bounds on the way of points of one ring as seen from another."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from rve.common.types import Array
from rve.finite.touching import Index, Placed, Touching, of_pairs
from rve.geometry.circles import cross, dot, tangent_frame


def ways(placed: Placed, touching: Touching, q: Array) -> Array:
    """A bound (p,) on the way of any point of ring b as seen from ring a in the step q (n, 5), for every near pair.

    Two rings that turn together have no way. Seen from ring a, which turns with W_a, a point r of ring b moves with
    v - W_a x d + (W_b - W_a) x r, where d goes from a to b and v is its rate. W may have any part along the ring's own
    normal n, since a spin moves no circle; the spins are those of least squares of both terms. While the step lasts, n
    turns and d changes, each in proportion to the time.
    """
    a, b = touching.a, touching.b
    e1, e2 = tangent_frame(placed.normal)
    tilt = q[:, 3:4] * e1 + q[:, 4:] * e2
    wa, wb, na, nb = tilt[a], tilt[b], placed.normal[a], placed.normal[b]
    d, v = placed.x[b] - placed.x[a], q[b, :3] - q[a, :3]
    turn, shift, arm = wb - wa, v - cross(wa, d), cross(na, d)
    aa, bb, ab = dot(arm, arm) + 1.001, 1.001, -dot(na, nb)
    ra, rb = dot(na, turn) + dot(arm, shift), -dot(nb, turn)
    det = aa * bb - ab * ab
    sa, sb = (bb * ra - ab * rb) / det, (aa * rb - ab * ra) / det

    def size(u: Array) -> Array:
        return np.asarray(np.sqrt(dot(u, u)))

    turn, shift = turn + sb[:, None] * nb - sa[:, None] * na, shift - sa[:, None] * arm
    changing_a, changing_b = np.abs(sa) * size(wa), np.abs(sb) * size(wb)
    late = (1.0 + size(d) + size(v)) * changing_a + changing_b + (size(wa) + np.abs(sa)) * size(v)
    plain = size(v) + size(wa) + size(wb)
    return np.asarray(np.minimum(plain, size(shift) + size(turn) + 0.5 * late))


def safe_parts(placed: Placed, touching: Touching, q: Array, wire: float, reach: float, share: float = 0.9) -> Array:
    """The part (p,) of a step within which no wire of a pair can pass through the other.

    Circles that cross on the way have D(0) + D(1) <= L, where D is their distance and L the longest way of a point of
    one as seen from the other. D(1) >= 2 wire, so less than D(0) + 2 wire is safe; `share` of it is allowed.
    """
    distance = np.minimum(touching.deepest, reach) + 2.0 * wire
    part = share * (distance + 2.0 * wire) / np.maximum(ways(placed, touching, q), 1e-300)
    return np.asarray(np.where(touching.b < touching.rings, np.minimum(1.0, part), 1.0))


def is_passage_safe(
    before: Placed, old: Touching, after: Placed, new: Touching, q: Array, wire: float, reach: float
) -> bool:
    """Whether no ring can have passed through another on the straight way of the step q (n, 5); see `safe_parts`.

    Pairs that were not near: circles that cross on the way have centres that come within 2, so that their way relative
    to each other is at least what both ends are beyond 2.
    """
    limit = 2.0 * wire + reach
    start = np.minimum(old.deepest + 2.0 * wire, limit)
    rows = of_pairs(new.key, old.key)
    end = np.where(rows >= 0, np.minimum(new.deepest[rows] + 2.0 * wire, limit), limit)
    if ((ways(before, old, q) >= start + np.maximum(end, 2.0 * wire)) & (old.b < old.rings)).any():
        return False
    return not _far_pairs_meet(before, after, old.key)


def _far_pairs_meet(before: Placed, after: Placed, near: Index) -> bool:
    n, rings = len(before.x), before.rings
    x0, x1 = before.x[:rings], after.x[:rings]
    step = x1 - x0
    step = step - 0.5 * (step.max(axis=0) + step.min(axis=0))
    longest = float(np.sqrt(dot(step, step)).max())
    pairs = cKDTree(0.5 * (x0 + x1)).query_pairs(2.0 + longest, output_type="ndarray").astype(np.int64)
    a, b = pairs.min(axis=1), pairs.max(axis=1)
    far = of_pairs(near, a * n + b) < 0
    a, b = a[far], b[far]
    way, d0, d1 = (u[b] - u[a] for u in (step, x0, x1))
    beyond = np.maximum(np.sqrt(dot(d0, d0)) - 2.0, 0.0) + np.maximum(np.sqrt(dot(d1, d1)) - 2.0, 0.0)
    return bool((dot(way, way) >= beyond**2).any())
