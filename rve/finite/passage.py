"""No wire passes through another in a step within bounds on the way of points of one ring as seen from another."""

import numpy as np
from scipy.spatial import cKDTree

from rve.common import Array
from rve.finite.touching import Touching, of_pairs
from rve.geometry.ring_pair import cross, dot, norm, rotation


def ways(con: Touching, q: Array) -> Array:
    """A bound (p,) on the way of any point of ring b as seen from ring a in the step q (n, 5), for every near pair.

    Two rings that turn together have no way. Seen from ring a, which turns with W_a, a point r of ring b moves with
    v - W_a x d + (W_b - W_a) x r, where d goes from a to b and v is its rate. W may have any part along the ring's own
    normal n, since a spin moves no circle; the spins are those of least squares of both terms. While the step lasts, n
    turns and d changes, each in proportion to the time.
    """
    a, b, placed = con.a, con.b, con.placed
    tilt = rotation(placed.normal, q[:, 3:])
    wa, wb, na, nb = tilt[a], tilt[b], placed.normal[a], placed.normal[b]
    d, v = placed.x[b] - placed.x[a], q[b, :3] - q[a, :3]
    turn, shift, arm = wb - wa, v - cross(wa, d), cross(na, d)
    aa, bb, ab = dot(arm, arm) + 1.001, 1.001, -dot(na, nb)
    ra, rb = dot(na, turn) + dot(arm, shift), -dot(nb, turn)
    det = aa * bb - ab * ab
    sa, sb = (bb * ra - ab * rb) / det, (aa * rb - ab * ra) / det
    turn, shift = turn + sb[:, None] * nb - sa[:, None] * na, shift - sa[:, None] * arm
    changing_a, changing_b = np.abs(sa) * norm(wa), np.abs(sb) * norm(wb)
    late = (1.0 + norm(d) + norm(v)) * changing_a + changing_b + (norm(wa) + np.abs(sa)) * norm(v)
    plain = norm(v) + norm(wa) + norm(wb)
    return np.asarray(np.minimum(plain, norm(shift) + norm(turn) + 0.5 * late))


def safe_parts(con: Touching, q: Array) -> Array:
    """The part (p,) of a step within which no wire of a pair can pass through the other.

    Circles that cross on the way have D(0) + D(1) <= L, where D is their distance and L the longest way of a point of
    one as seen from the other. D(1) >= 2 wire, so less than D(0) + 2 wire is safe; nine tenths of it are allowed.
    """
    return np.asarray(np.minimum(1.0, 0.9 * con.clear / np.maximum(ways(con, q), 1e-300)))


def is_passage_safe(old: Touching, new: Touching, q: Array) -> bool:
    """Whether no ring can have passed through another on the straight way of the step q (n, 5); see `safe_parts`.

    Pairs that were not near: circles that cross on the way have centres that come within 2, so that their way relative
    to each other is at least what both ends are beyond 2.
    """
    limit = 2.0 * old.wire + old.reach
    rows = of_pairs(new.key, old.key)
    end = np.where(rows >= 0, np.minimum(new.deepest[rows] + 2.0 * old.wire, limit), limit)
    if (ways(old, q) >= old.clear + np.where(old.is_wall, 0.0, np.maximum(end - 2.0 * old.wire, 0.0))).any():
        return False
    x0, x1 = (con.placed.x[: con.placed.rings] for con in (old, new))
    step = x1 - x0
    step = step - 0.5 * (step.max(axis=0) + step.min(axis=0))
    pairs = cKDTree(0.5 * (x0 + x1)).query_pairs(2.0 + float(norm(step).max()), output_type="ndarray")
    a, b = pairs.astype(np.int64).min(axis=1), pairs.astype(np.int64).max(axis=1)
    far = of_pairs(old.key, a * len(old.placed.x) + b) < 0
    way, d0, d1 = (u[b[far]] - u[a[far]] for u in (step, x0, x1))
    beyond = np.maximum(norm(d0) - 2.0, 0.0) + np.maximum(norm(d1) - 2.0, 0.0)
    return not (dot(way, way) >= beyond**2).any()
