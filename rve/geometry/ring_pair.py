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
    """Whether the circles are linked, (n,): B meets the plane of A in two points, exactly one of them inside of A."""
    c = dot(n_a, n_b)
    in_plane = n_a - c[:, None] * n_b  # gradient in the plane of B of the height above plane A
    length = np.sqrt(np.maximum(dot(in_plane, in_plane), 1e-30))  # parallel planes: x stays a number
    e = in_plane / length[:, None]
    a, b = radii
    x = -dot(n_a, d) / length  # height above plane A is length * x in the frame (e, f) of circle B
    inside = b * b - x**2
    crosses = (inside > 0.0) & (length > 1e-12)
    y = np.sqrt(np.maximum(inside, 0.0))[:, None]
    f = cross(n_b, e)
    foot = d + x[:, None] * e
    first = dot(foot + y * f, foot + y * f) < a * a
    second = dot(foot - y * f, foot - y * f) < a * a
    return np.asarray(crosses & (first != second))


Circles = tuple[Array, Array, Array, Array, Array]
"""d, n_a, n_b (n, 3) and the radii a, b (n,) of pairs."""


def _circles(d: Array, n_a: Array, n_b: Array, radii: Radii) -> Circles:
    a, b = (np.broadcast_to(np.asarray(radius, dtype=float), len(d)) for radius in radii)
    return d, n_a, n_b, a, b


def _lines(d: Array, n_a: Array, n_b: Array, a: Array, b: Array) -> Array:
    """Height z over B's plane and half the square h of rho_a - d, linear in the cosine and sine of the angle of rho_a:
    constant, cosine's and sine's part of z, then of h, and b, (7, n)."""
    e1, e2 = tangent_frame(n_a)
    h0, h1, h2 = 0.5 * (a * a + dot(d, d)), -a * dot(e1, d), -a * dot(e2, d)
    return np.stack([-dot(d, n_b), a * dot(e1, n_b), a * dot(e2, n_b), h0, h1, h2, b])


def _slope_and_curvature(angle: Array, lines: Array) -> tuple[Array, Array]:
    """First and second derivative of D(angle), the distance of the point of A to circle B: D^2 = 2 h + b^2 - 2 b q,
    where q^2 = 2 h - z^2 is the distance from B's axis. Numbers only, so that no vector is formed."""
    z0, z1, z2, h0, h1, h2, b = lines
    c, s = np.cos(angle), np.sin(angle)
    zc, hc = z1 * c + z2 * s, h1 * c + h2 * s
    z, dz, dh = z0 + zc, z2 * c - z1 * s, h2 * c - h1 * s
    q = np.sqrt(np.maximum(2.0 * (h0 + hc) - z * z, 1e-28))
    dq = (dh - z * dz) / q
    bend = (z * zc - hc - dz * dz - dq * dq) / q
    # Centre circles that cross have no normal; the floor keeps the numbers finite, the gap is -2 r2 all the same.
    distance = np.maximum(np.sqrt(z * z + (q - b) ** 2), 1e-12)
    slope = (dh - b * dq) / distance
    return slope, (-hc - b * bend - slope * slope) / distance


def _polish(
    pair: Index, angle: Array, width: float | Array, circles: Circles, shift: float | Array = 0.0
) -> tuple[Array, Minima]:
    """Newton on the slope from angle + shift, kept in the bracket angle +- width by bisection; angles and minima."""
    d, n_a, n_b, a, b = of_pairs = tuple(of[pair] for of in circles)
    lines, angle, low, high = _lines(*of_pairs), angle + shift, angle - width, angle + width
    # Converged rows are dropped, so results do not depend on the batch; most need five rounds, a few thirty.
    go = np.arange(len(angle))
    for _ in range(40):
        at = angle[go]
        slope, curvature = _slope_and_curvature(at, lines[:, go])
        left = low[go] = np.where(slope < 0.0, at, low[go])
        right = high[go] = np.where(slope > 0.0, at, high[go])
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = at - slope / curvature
        good = (curvature > 0.0) & (newton >= left) & (newton <= right)
        trial = np.where(good, newton, 0.5 * (left + right))
        # A stationary point to round-off moves no further; slope is in r1 per radian.
        step = np.where(np.abs(slope) > 1e-15, trial - at, 0.0)
        angle[go] = at + step
        go = go[np.abs(step) > 1e-9]
        if not len(go):
            break
    e1, e2 = tangent_frame(n_a)
    rho_a = (a * np.cos(angle))[:, None] * e1 + (a * np.sin(angle))[:, None] * e2
    rho_b = foot_on_circle(rho_a - d, n_b, b)
    w = d + rho_b - rho_a
    distance = np.maximum(norm(w), 1e-12)
    curvature = _slope_and_curvature(angle, lines)[1] * distance / (a * a)
    return angle, Minima(pair, w / distance[:, None], rho_a, rho_b, distance, curvature)


def _samples(start: Array, offset: Array, circles: Circles) -> Array:
    """D^2 - b^2 (n, k) at the angles start (n,) + offset (k,), see `_slope_and_curvature`."""
    lines = _lines(*circles)
    c, s = np.cos(start), np.sin(start)
    cos, sin = np.cos(offset), np.sin(offset)

    def over_samples(cosine: Array, sine: Array, constant: Array) -> Array:
        # Written out: a matrix product rounds by the number of its rows, and no pair may depend on the others.
        out = np.multiply.outer(c * cosine + s * sine, cos)
        out += np.multiply.outer(c * sine - s * cosine, sin)
        out += constant[:, None]
        return out

    z = over_samples(lines[1], lines[2], lines[0])
    pp = over_samples(*(2.0 * lines[[4, 5, 3]]))
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
    step, circles, reach = 2.0 * np.pi / samples, _circles(d, n_a, n_b, radii), np.broadcast_to(reach, len(d))
    f = _samples(np.zeros(len(d)), step * np.arange(samples, dtype=np.float64), circles)
    rise = np.roll(f, -1, axis=1) - f
    fall = np.roll(rise, 1, axis=1)
    is_min = (fall <= 0.0) & (rise > 0.0)
    lonely = ~is_min.any(axis=1)
    is_min[lonely, np.argmin(f[lonely], axis=1)] = True
    # The distance falls by no more than a per radian: minima that cannot come within reach are not polished.
    can_reach = f <= ((reach + step * circles[3]) ** 2 - circles[4] ** 2)[:, None]
    pair, column = np.nonzero(is_min & can_reach)
    bend = rise[pair, column] - fall[pair, column]
    # The vertex of the parabola through three samples; a lonely sample may be no minimum and keeps its angle.
    vertex = np.where(bend > 0.0, -0.5 * (rise[pair, column] + fall[pair, column]) / np.maximum(bend, 1e-300), 0.0)
    centre, shift = step * column.astype(np.float64), step * np.clip(vertex, -0.5, 0.5)
    angle, found = _polish(pair, centre, step, circles, shift)
    near = found.distance <= reach[pair]
    found, angle = found.take(near), angle[near]
    # Two circles have at most two local minima (none of 300,000 random pairs has three): where the samples show both,
    # none is hidden.
    single = is_min.sum(axis=1) < 2
    soft = single[found.pair] & (found.curvature < _SOFT)
    hidden, place = _shoulders(rise, fall, can_reach & single[:, None], step)
    around, angles = np.concatenate([found.pair[soft], hidden]), np.concatenate([angle[soft], place])
    if len(around):
        return _with_twins(found, around, angles, reach, circles)
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
    e1, e2 = tangent_frame(n_a[near.pair])
    angle = np.arctan2(dot(near.rho_a, e2), dot(near.rho_a, e1))
    return _polish(near.pair, angle, width, _circles(d, n_a, n_b, radii))[1]


def _shoulders(rise: Array, fall: Array, can_reach: Flags, step: float) -> tuple[Index, Array]:
    """Pairs (k,) and angles (k,) between samples where the slope keeps its sign but has its least size, as at a minimum
    in a basin narrower than two samples. rise, fall (n, m): differences to the next sample and from the one before.
    """
    size = np.abs(rise)
    least = (size <= np.roll(size, 1, axis=1)) & (size <= np.roll(size, -1, axis=1))
    pair, column = np.nonzero(least & can_reach)
    slope, left, right = rise[pair, column], fall[pair, column], rise[pair, (column + 1) % rise.shape[1]]
    flat = (slope * left > 0.0) & (slope * right > 0.0)
    return pair[flat], step * (column[flat] + 0.5)


def _with_twins(found: Minima, pair: Index, angle: Array, reach: Array, circles: Circles) -> Minima:
    """The minima found and those that sampling has missed around the angles (k,) of the pairs (k,), each once."""
    d, n_a, n_b, a, b = (of[pair] for of in circles)
    # Twins may be 0.001 rad apart or 0.1: the samples crowd towards the minimum.
    offset = 0.8 / np.sinh(6.0) * np.sinh(np.linspace(-6.0, 6.0, 97))
    width = np.diff(offset)
    f = _samples(angle, offset, (d, n_a, n_b, a, b))
    slope = np.diff(f, axis=1) / width
    row, column = np.nonzero((slope[:, :-1] <= 0.0) & (slope[:, 1:] > 0.0))
    bracket = np.maximum(width[column], width[column + 1])
    _, twins = _polish(pair[row], angle[row] + offset[column + 1], bracket, circles)
    # A symmetric start may sit on the saddle between two twins: stationary, but no minimum.
    soft, stable = found.curvature < _SOFT, found.curvature > -_ROUND_OFF
    twins = twins.take((twins.curvature > -_ROUND_OFF) & (twins.distance <= reach[twins.pair]))
    both = found.take(~soft | stable).join([twins])
    order = np.lexsort((both.distance, both.pair))
    pair, rho_a, first = both.pair[order], both.rho_a[order], np.ones(len(order), dtype=bool)
    # Two soft minima are found three times each and their order by distance is round-off: look back past all of them.
    for back in range(1, 8):
        row = np.flatnonzero(pair[back:] == pair[:-back])
        if not len(row):
            break
        apart = rho_a[row + back] - rho_a[row]
        first[row + back] &= dot(apart, apart) >= (1e-4 * circles[3][pair[row]]) ** 2
    return both.take(order[first])
