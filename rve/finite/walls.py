"""Gaps of rings over half-spaces and balls, with derivatives.

The lowest point of a ring over the plane m.(x - p) = 0 has the height h - s, with h = m.(c - p) and s the sine of the
angle between its normal n and m. p lies r2 off the half-space, so that wires are bare lines. s has a kink where a ring
lies flat on the plane. The constraint is g = h - s^2/h >= 0 for h > 0, which is equivalent and smooth;
(h - s) <= g <= 2 (h - s). Rings of another radius a have a s in place of s.

The point of a ring nearest to a ball of radius R, r2 included, whose centre is at d from that of the ring, has the
distance D with D^2 - R^2 = A - 2 s, A = d.d + 1 - R^2 and s = |d x n|. The constraint g = (A - 4 s^2/A) / (2 R) >= 0
for A > 0 is equivalent to D >= R and smooth also where a ring lies around the top of a ball. Both are

    g = h - b/h,  b = y.y - (n.y)^2,  y = -m and h = y.d of planes, y = d/R and h = A/(2 R) of balls,

and a half-space is a ball of infinite radius.
"""

import numpy as np

from rve.common import Array
from rve.geometry.ring_pair import cross, dot, tangent_frame


def wall_gaps(
    x: Array,
    normal: Array,
    place: Array,
    m: Array,
    radius: Array,
    a: Array | float = 1.0,
    thicker: Array | float = 0.0,
) -> Array:
    """g (k,) of rings of radius a over planes, or balls of finite radius; negative where a ring is partly inside;
    thicker: what the wire's radius is more than that of which places and radii of walls know."""
    h, y, _ = _height(x, place, m, radius, a, thicker)
    b = a * a * (dot(y, y) - dot(normal, y) ** 2)
    safe = np.where(h > 0.0, h, 1.0)
    return np.asarray(np.where(h > 0.0, h - b / safe, h - np.sqrt(np.maximum(b, 0.0))))


def _height(
    x: Array, place: Array, m: Array, radius: Array, a: Array | float, thicker: Array | float
) -> tuple[Array, Array, Array]:
    """h (k,), y (k, 3), and the derivative of y by d, 1/R (k,)."""
    d, flat = place - x, np.isinf(radius)
    R = np.where(flat, 1.0, radius + thicker)
    curved = np.where(flat, 0.0, 1.0 / R)
    y = np.where(flat[:, None], -m, curved[:, None] * d)
    return np.where(flat, dot(y, d) - thicker, 0.5 * (dot(d, d) + a * a - R * R) / R), y, curved


def wall_derivatives(
    x: Array,
    normal: Array,
    place: Array,
    m: Array,
    radius: Array,
    a: Array | float = 1.0,
    thicker: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Gradient (k, 7) and second derivative (k, 7, 7) of g: way of the body as seen from the ring, tilts of both."""
    h, y, k = _height(x, place, m, radius, a, thicker)
    a2 = np.broadcast_to(np.asarray(a * a), h.shape)
    c, p = dot(normal, y), cross(normal, y)
    b = a2 * dot(p, p)
    frame = np.stack(tangent_frame(normal), axis=2)
    t = (p[:, :, None] * frame).sum(axis=1)
    across = y - c[:, None] * normal
    by_d, by_tilt = (2.0 * a2 * k)[:, None] * across, (-2.0 * a2 * c)[:, None] * t
    G, H = np.zeros((len(h), 7)), np.zeros((len(h), 7, 7))
    part = 1.0 + b / h**2
    G[:, :3] = part[:, None] * y - by_d / h[:, None]
    G[:, 3:5] = -by_tilt / h[:, None]
    one, two = np.eye(3), np.eye(2)
    both = y[:, :, None] * by_d[:, None, :]
    H[:, :3, :3] = (k * part)[:, None, None] * one - (2.0 * b / h**3)[:, None, None] * y[:, :, None] * y[:, None, :]
    H[:, :3, :3] += (both + both.transpose(0, 2, 1)) / (h**2)[:, None, None]
    H[:, :3, :3] -= (2.0 * a2 * k**2 / h)[:, None, None] * (one - normal[:, :, None] * normal[:, None, :])
    turn = cross(frame.transpose(0, 2, 1), normal[:, None, :]).transpose(0, 2, 1)
    mixed = normal[:, :, None] * t[:, None, :] + c[:, None, None] * turn
    H[:, :3, 3:5] = (
        y[:, :, None] * by_tilt[:, None, :] / (h**2)[:, None, None] + (2.0 * a2 * k / h)[:, None, None] * mixed
    )
    H[:, 3:5, :3] = H[:, :3, 3:5].transpose(0, 2, 1)
    H[:, 3:5, 3:5] = (2.0 * a2 / h)[:, None, None] * (t[:, :, None] * t[:, None, :] - (c**2)[:, None, None] * two)
    return G, H
