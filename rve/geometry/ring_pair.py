"""Contact of two tori: every local minimum of the distance of their centre circles. Lengths are in r1.

Ring A has its centre at the origin and unit normal n_a, ring B its centre at d and unit normal n_b; a and b are their
radii, 1 unless said. Points on them are rho_a and d + rho_b, w = d + rho_b - rho_a joins them, D = |w|, u = w / D is
the contact normal, from A to B, the gap is D less both radii of wires. The distance of a point to a circle is closed
form, so one angle is left: sample it, take every local minimum, polish by a safeguarded Newton iteration.
"""

from dataclasses import dataclass

import numpy as np

from rve.common import Array, Flags, Index, Rows

Radii = tuple[Array | float, Array | float]
"""Radii of rings A and B of pairs, one number or (n,)."""
EQUAL: Radii = (1.0, 1.0)

# Two minima of linked rings merge in a pitchfork; below this share of the stiff curvature 1/D a minimum may have a
# twin between two samples, so its neighbourhood is sampled again.
_SOFT = 0.5
# Coaxial and coincident rings have curvature 0 to round-off, and a distance all the same.
_ROUND_OFF = 1e-9


@dataclass(frozen=True)
class Minima(Rows):
    """Local minima of the distance of two circles, one row per minimum.

    pair (m,) row of the input; normal (m, 3) unit vector from the point of A to the point of B; rho_a, rho_b (m, 3)
    points relative to their centres; distance (m,); curvature (m,) of the distance along ring a, times the distance:
    1 for a stiff minimum, 0 for one that is about to merge with another or to vanish.
    """

    pair: Index
    normal: Array
    rho_a: Array
    rho_b: Array
    distance: Array
    curvature: Array


def dot(a: Array, b: Array) -> Array:
    """Scalar product over the last axis of length 3, written out: ten times faster than einsum on short axes."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def norm(a: Array) -> Array:
    """Lengths of vectors along the last axis."""
    return np.asarray(np.sqrt(dot(a, a)))


def cross(a: Array, b: Array) -> Array:
    """Vector product over the last axis, written out: several times faster than np.cross on many short rows."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    out[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    out[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out


def tangent_frame(n: Array) -> tuple[Array, Array]:
    """Two unit vectors e1, e2 with e1 x e2 = n for unit normals n (..., 3), by Duff et al., JCGT 6 (2017)."""
    x, y, z = n[..., 0], n[..., 1], n[..., 2]
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    e1, e2 = np.empty((2, *n.shape))
    e1[..., 0], e2[..., 0] = 1.0 + sign * x**2 * a, x * y * a
    e1[..., 1], e2[..., 1] = sign * e2[..., 0], sign + y**2 * a
    e1[..., 2], e2[..., 2] = -sign * x, -y
    return e1, e2


def rotation(n: Array, tilt: Array) -> Array:
    """Rotation vectors (..., 3) of tilts (..., 2) about the axes of the tangent frames of n (..., 3)."""
    e1, e2 = tangent_frame(n)
    return np.asarray(tilt[..., :1] * e1 + tilt[..., 1:] * e2)


def turned(n: Array, tilt: Array) -> Array:
    """Unit normals n (..., 3) turned by tilts (..., 2), see `rotation`, by the exponential map."""
    omega = rotation(n, tilt)
    angle = norm(omega)[..., None]
    new = np.cos(angle) * n + np.sinc(angle / np.pi) * cross(omega, n)
    return np.asarray(new / norm(new)[..., None])


def foot_on_circle(p: Array, n: Array, radius: Array | float = 1.0) -> Array:
    """Point of the circle (centre 0, unit normal n) closest to p (..., 3), one of many for p on its axis."""
    q = p - dot(p, n)[..., None] * n
    length = norm(q)
    on_axis = length <= 1e-14
    if np.any(on_axis):
        q = np.where(on_axis[..., None], tangent_frame(n)[0], q)
        length = np.where(on_axis, 1.0, length)
    return q * (radius / length)[..., None]


def are_linked(d: Array, n_a: Array, n_b: Array, radii: Radii = EQUAL) -> Flags:
    """Whether the circles are linked, (...): B meets the plane of A in two points, exactly one of them inside of A."""
    c = dot(n_a, n_b)
    in_plane = n_a - c[..., None] * n_b  # gradient in the plane of B of the height above plane A
    length = np.sqrt(np.maximum(dot(in_plane, in_plane), 1e-30))  # parallel planes: x stays a number
    e = in_plane / length[..., None]
    a, b = radii
    x = -dot(n_a, d) / length  # height above plane A is length * x in the frame (e, f) of circle B
    inside = b * b - x**2
    crosses = (inside > 0.0) & (length > 1e-12)
    y = np.sqrt(np.maximum(inside, 0.0))
    foot = d + x[..., None] * e
    middle, half = dot(foot, foot) + y * y, 2.0 * y * dot(foot, cross(n_b, e))  # squares of foot + y f and foot - y f
    return np.asarray(crosses & ((middle + half < a * a) != (middle - half < a * a)))


@dataclass(frozen=True)
class Circles:
    """Pairs of circles: d, n_b, tangent frame e1, e2 of n_a, each (n, 3); radii a, b (n,); lines (7, n): z0, h0, z1,
    h1, z2, h2, b, on which alone the distance of a point of A depends. Seen from the centre of B that point p at an
    angle has the height p.n_b = z0 + z1 cos + z2 sin and half the square p.p / 2 = h0 + h1 cos + h2 sin.
    """

    d: Array
    n_b: Array
    e1: Array
    e2: Array
    a: Array
    b: Array
    lines: Array

    @staticmethod
    def of(d: Array, n_a: Array, n_b: Array, radii: Radii) -> "Circles":
        """Circles as `local_minima` takes them."""
        a, b = (np.broadcast_to(np.asarray(radius, dtype=float), len(d)) for radius in radii)
        e1, e2 = tangent_frame(n_a)
        ways = (of for e in (e1, e2) for of in (a * dot(e, n_b), -a * dot(e, d)))
        return Circles(d, n_b, e1, e2, a, b, np.stack([-dot(d, n_b), 0.5 * (a * a + dot(d, d)), *ways, b]))


def _slope_and_curvature(angle: Array, lines: Array) -> tuple[Array, Array]:
    """First and second derivative of D(angle), the distance of the point of A to circle B: D^2 = 2 h + b^2 - 2 b q,
    where q^2 = 2 h - z^2 is the distance from B's axis. Numbers only, so that no vector is formed."""
    (z0, h0), cosine, sine, b = lines[:2], lines[2:4], lines[4:6], lines[6]
    c, s = np.cos(angle), np.sin(angle)
    (zc, hc), (dz, dh) = cosine * c + sine * s, sine * c - cosine * s
    z = z0 + zc
    zz = z * z
    q = np.sqrt(np.maximum(2.0 * (h0 + hc) - zz, 1e-28))
    dq = (dh - z * dz) / q
    bend = (z * zc - hc - dz * dz - dq * dq) / q
    # Centre circles that cross have no normal; the floor keeps the numbers finite, the gap is -2 r2 all the same.
    distance = np.maximum(np.sqrt(zz + (q - b) ** 2), 1e-12)
    slope = (dh - b * dq) / distance
    return slope, (-hc - b * bend - slope * slope) / distance


def _polish(
    pair: Index, angle: Array, width: float | Array, circles: Circles, shift: float | Array = 0.0
) -> tuple[Array, Minima]:
    """Newton on the slope from angle + shift, kept in the bracket angle +- width by bisection; angles and minima."""
    angle, low, high = angle + shift, angle - width, angle + width
    # Converged rows are dropped, so results do not depend on the batch; most need three rounds, a few thirty.
    go, at, bend, lines = np.arange(len(angle)), angle, np.zeros(len(angle)), circles.lines[:, pair]
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(40):
            slope, curvature = _slope_and_curvature(at, lines)
            low, high = np.where(slope < 0.0, at, low), np.where(slope > 0.0, at, high)
            newton = at - slope / curvature
            good = (curvature > 0.0) & (newton >= low) & (newton <= high)
            # A stationary point to round-off moves no further; slope is in r1 per radian.
            step = np.where(np.abs(slope) > 1e-15, np.where(good, newton, 0.5 * (low + high)) - at, 0.0)
            at = angle[go] = at + step
            bend[go] = curvature
            moves = np.abs(step) > 1e-9
            if not moves.all():
                go, at, low, high, lines = go[moves], at[moves], low[moves], high[moves], lines[:, moves]
            if not len(go):
                break
    d, a = circles.d[pair], circles.a[pair]
    rho_a = (a * np.cos(angle))[:, None] * circles.e1[pair] + (a * np.sin(angle))[:, None] * circles.e2[pair]
    rho_b = foot_on_circle(rho_a - d, circles.n_b[pair], circles.b[pair])
    w = d + rho_b - rho_a
    distance = np.maximum(norm(w), 1e-12)
    return angle, Minima(pair, w / distance[:, None], rho_a, rho_b, distance, bend * distance / (a * a))


def _samples(start: Array, offset: Array, lines: Array) -> Array:
    """D^2 - b^2 (n, k) at the angles start (n,) + offset (k,), see `_slope_and_curvature`."""
    c, s = np.cos(start), np.sin(start)
    waves = np.stack([np.cos(offset), np.sin(offset), np.ones(len(offset))])

    def over_samples(constant: Array, cosine: Array, sine: Array) -> Array:
        # Not a matrix product, which rounds by the number of its rows: no pair may depend on the others.
        rows = np.stack([c * cosine + s * sine, c * sine - s * cosine, constant])
        return np.asarray(np.einsum("in,ik->nk", rows, waves))

    z = over_samples(*lines[[0, 2, 4]])
    pp = over_samples(*(2.0 * lines[[1, 3, 5]]))
    np.multiply(z, z, out=z)
    np.subtract(pp, z, out=z)
    np.sqrt(np.maximum(z, 0.0, out=z), out=z)
    z *= 2.0 * lines[6][:, None]
    pp -= z
    return pp


def local_minima(
    d: Array, n_a: Array, n_b: Array, radii: Radii = EQUAL, *, reach: Array | float = np.inf, samples: int = 48
) -> Minima:
    """Every local minimum of the distance of two circles, for all pairs at once.

    d, n_a, n_b (n, 3): centre of B seen from A, unit normals. Minima farther than `reach`, one number or (n,), are left
    out. Returns `Minima` sorted by pair and distance. Minima less than about 0.02 rad apart count as one: their
    distances then differ by less than 1e-9.

    >>> import numpy as np
    >>> two = local_minima(np.array([[1.8, 0, 0]]), np.array([[0, 0, 1.0]]), np.array([[0, 1.0, 0]]))
    >>> two.distance.round(12)
    array([0.2])
    """
    step, circles, reach = 2.0 * np.pi / samples, Circles.of(d, n_a, n_b, radii), np.broadcast_to(reach, len(d))
    f = _samples(np.zeros(len(d)), step * np.arange(samples, dtype=np.float64), circles.lines)
    # Changes (n, samples + 2) to every sample from the one before, the first one twice more at the end.
    rises = np.diff(np.concatenate([f[:, -1:], f, f[:, :2]], axis=1))
    is_min = (rises[:, :-2] <= 0.0) & (rises[:, 1:-1] > 0.0)
    lonely = ~is_min.any(axis=1)
    is_min[lonely, np.argmin(f[lonely], axis=1)] = True
    pair, column = np.divmod(np.flatnonzero(is_min), samples)
    # Two circles have at most two local minima (none of 300,000 random pairs has three): where the samples show both,
    # none is hidden.
    single = np.bincount(pair, minlength=len(d)) < 2
    # The distance falls by no more than a per radian: minima that cannot come within reach are not polished.
    most = (reach + step * circles.a) ** 2 - circles.b**2
    near = f[pair, column] <= most[pair]
    pair, column = pair[near], column[near]
    fall, rise = rises[pair, column], rises[pair, column + 1]
    # The vertex of the parabola through three samples; a lonely sample may be no minimum and keeps its angle.
    vertex = np.where(rise > fall, -0.5 * (rise + fall) / np.maximum(rise - fall, 1e-300), 0.0)
    angle, found = _polish(pair, step * column, step, circles, step * np.clip(vertex, -0.5, 0.5))
    near = found.distance <= reach[pair]
    found, angle = found.take(near), angle[near]
    soft = single[found.pair] & (found.curvature < _SOFT)
    pair, column = _shoulders(rises)
    hidden = single[pair] & (f[pair, column] <= most[pair])
    around = np.concatenate([found.pair[soft], pair[hidden]])
    if len(around):
        angles = np.concatenate([angle[soft], step * (column[hidden] + 0.5)])
        known = np.pad(found.curvature[soft] > -_ROUND_OFF, (0, hidden.sum()))
        return _with_twins(found, around, angles, known, reach, circles)
    return found.take(np.lexsort((found.distance, found.pair)))  # in the order that they have with twins


def followed_minima(
    near: Minima, d: Array, n_a: Array, n_b: Array, radii: Radii = EQUAL, *, width: float = 0.2
) -> Minima:
    """The minima (m,) that rings which have moved a little have beside those of before; a fraction of a search's work.

    near: minima of before; d, n_a, n_b (n, 3) of the moved pairs as in `local_minima`. Each row is a pair of points
    within `width` radians of the old point of ring a, and a local minimum if there is one: its distance is never less
    than the distance of the circles.

    >>> import numpy as np
    >>> d, n_a, n_b = np.array([[1.8, 0, 0]]), np.array([[0, 0, 1.0]]), np.array([[0, 1.0, 0]])
    >>> followed_minima(local_minima(d, n_a, n_b), d + [0.05, 0, 0], n_a, n_b).distance.round(12)
    array([0.15])
    """
    circles = Circles.of(d, n_a, n_b, radii)
    e1, e2 = circles.e1[near.pair], circles.e2[near.pair]
    return _polish(near.pair, np.arctan2(dot(near.rho_a, e2), dot(near.rho_a, e1)), width, circles)[1]


def _shoulders(rises: Array) -> tuple[Index, Index]:
    """Pairs (k,) and samples (k,) after which the slope keeps its sign but has its least size, as at a minimum in a
    basin narrower than two samples. rises (n, m + 2): changes from sample to sample, as in `local_minima`."""
    size = np.abs(rises)
    least = (size[:, 1:-1] <= size[:, :-2]) & (size[:, 1:-1] <= size[:, 2:])
    pair, column = np.divmod(np.flatnonzero(least), least.shape[1])
    left, slope, right = (rises[pair, column + k] for k in range(3))
    flat = (slope * left > 0.0) & (slope * right > 0.0)
    return pair[flat], column[flat]


def _with_twins(found: Minima, pair: Index, angle: Array, known: Flags, reach: Array, circles: Circles) -> Minima:
    """The minima found and those that sampling has missed around the angles (k,) of the pairs (k,), each once; known
    (k,): angles of minima found."""
    # Twins may be 0.001 rad apart or 0.1: the samples crowd towards the minimum.
    offset = 0.8 / np.sinh(6.0) * np.sinh(np.linspace(-6.0, 6.0, 97))
    width = np.diff(offset)
    slope = np.diff(_samples(angle, offset, circles.lines[:, pair])) / width
    row, column = np.divmod(np.flatnonzero((slope[:, :-1] <= 0.0) & (slope[:, 1:] > 0.0)), len(width) - 1)
    # A minimum in the middle that has no other beside it is the known one.
    alone = known & (np.bincount(row, minlength=len(pair)) == 1)
    new = ~(alone[row] & (np.abs(offset[column + 1]) < 1e-3))
    row, column = row[new], column[new]
    # A symmetric start may sit on the saddle between two twins: stationary, but no minimum.
    both = found.take(found.curvature > -_ROUND_OFF)
    if len(row):
        bracket = np.maximum(width[column], width[column + 1])
        _, twins = _polish(pair[row], angle[row] + offset[column + 1], bracket, circles)
        both = both.join([twins.take((twins.curvature > -_ROUND_OFF) & (twins.distance <= reach[twins.pair]))])
    order = np.lexsort((both.distance, both.pair))
    pair, rho_a, first = both.pair[order], both.rho_a[order], np.ones(len(order), dtype=bool)
    # Two soft minima are found three times each and their order by distance is round-off: look back past all of them.
    for back in range(1, 8):
        row = np.flatnonzero(pair[back:] == pair[:-back])
        if not len(row):
            break
        apart = rho_a[row + back] - rho_a[row]
        first[row + back] &= dot(apart, apart) >= (1e-4 * circles.a[pair[row]]) ** 2
    return both.take(order[first])
