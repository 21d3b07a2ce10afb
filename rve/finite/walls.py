"""Half-spaces and balls that rings stay out of, with the closed form of a torus over a plane or a ball.

The lowest point of a ring over the plane m.(x - p) = 0 has the height h - s, with h = m.(c - p) and s the sine of the
angle between its normal n and m. Lengths are in units of r1; p lies r2 off the half-space, so that wires are bare
lines. s has a kink where a ring lies flat on the plane. The constraint is g = h - s^2/h >= 0 for h > 0, which is the
same and smooth; (h - s) <= g <= 2 (h - s).

The point of a ring nearest to a ball of radius R, r2 included, whose centre is at d from that of the ring, has the
distance D with D^2 - R^2 = A - 2 s, A = d.d + 1 - R^2 and s = |d x n|. The constraint g = (A - 4 s^2/A) / (2 R) >= 0
for A > 0 is the same as D >= R and smooth also where a ring lies around the top of a ball. Both are

    g = h - b/h,  b = y.y - (n.y)^2,  y = -m and h = y.d of planes, y = d/R and h = A/(2 R) of balls,

and a half-space is a ball of infinite radius. Either is kept as one more row of `Placed`: p and m, or the centre.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from rve.common import Array, InputError
from rve.geometry.ring_pair import cross, dot, tangent_frame

Row = tuple[Array, Array, float]
"""Point (3,) in mm, unit normal (3,) and radius in mm of a row of `Placed`."""


@dataclass(frozen=True)
class HalfSpace:
    """The rings stay where normal . x >= offset, mm; the normal has any length but 0, the offset is along its unit
    vector.

    >>> HalfSpace((0.0, 2.0, 0.0), -50.0).unit
    array([0., 1., 0.])
    """

    normal: tuple[float, float, float]
    offset: float
    name: str = "wall"
    load: ClassVar[tuple[float, float, float]] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """InputError for a normal that is not a direction, or numbers that are not finite."""
        m = np.asarray(self.normal, dtype=float)
        if m.shape != (3,) or not np.isfinite([*m, self.offset]).all() or not np.linalg.norm(m) > 0.0:
            raise InputError(f"{self.name}: normal {self.normal} and offset {self.offset} are not a half-space")

    @property
    def unit(self) -> Array:
        """Unit normal (3,), towards the rings."""
        m = np.asarray(self.normal, dtype=float)
        return np.asarray(m / np.linalg.norm(m))

    def row(self, wire: float) -> Row:
        """A point of the plane, `wire` mm off it."""
        return (self.offset + wire) * self.unit, self.unit, np.inf


@dataclass(frozen=True)
class RoundBody:
    """A ball of `radius` mm whose centre is at `place`, mm; time steps move it, under the force `load` in N."""

    place: tuple[float, float, float]
    radius: float
    load: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = "ball"

    def row(self, wire: float) -> Row:
        """The centre, and the radius of the ball and the wire."""
        return np.array(self.place), np.array([0.0, 0.0, 1.0]), self.radius + wire

    def moved(self, place: Array) -> RoundBody:
        """The ball at another place (3,)."""
        return replace(self, place=(float(place[0]), float(place[1]), float(place[2])))


Obstacle = HalfSpace | RoundBody


def wall_gaps(x: Array, normal: Array, place: Array, m: Array, radius: Array) -> Array:
    """g (k,) of rings over planes, or balls of finite radius; negative where a ring is partly inside."""
    h, y, _ = _height(x, place, m, radius)
    b = dot(y, y) - dot(normal, y) ** 2
    safe = np.where(h > 0.0, h, 1.0)
    return np.asarray(np.where(h > 0.0, h - b / safe, h - np.sqrt(np.maximum(b, 0.0))))


def _height(x: Array, place: Array, m: Array, radius: Array) -> tuple[Array, Array, Array]:
    """h (k,), y (k, 3), and the derivative of y by d, 1/R (k,)."""
    d, curved = place - x, 1.0 / radius
    flat = np.isinf(radius)
    y = np.where(flat[:, None], -m, curved[:, None] * d)
    R = np.where(flat, 1.0, radius)
    return np.where(flat, dot(y, d), 0.5 * (dot(d, d) + 1.0 - R * R) / R), y, curved


def wall_derivatives(x: Array, normal: Array, place: Array, m: Array, radius: Array) -> tuple[Array, Array]:
    """Gradient (k, 7) and second derivative (k, 7, 7) of g: way of the body as seen from the ring, tilts of both."""
    h, y, k = _height(x, place, m, radius)
    c, p = dot(normal, y), cross(normal, y)
    b = dot(p, p)
    frame = np.stack(tangent_frame(normal), axis=2)
    t = (p[:, :, None] * frame).sum(axis=1)
    across = y - c[:, None] * normal
    by_d, by_tilt = (2.0 * k)[:, None] * across, (-2.0 * c)[:, None] * t
    G, H = np.zeros((len(h), 7)), np.zeros((len(h), 7, 7))
    part = 1.0 + b / h**2
    G[:, :3] = part[:, None] * y - by_d / h[:, None]
    G[:, 3:5] = -by_tilt / h[:, None]
    one, two = np.eye(3), np.eye(2)
    both = y[:, :, None] * by_d[:, None, :]
    H[:, :3, :3] = (k * part)[:, None, None] * one - (2.0 * b / h**3)[:, None, None] * y[:, :, None] * y[:, None, :]
    H[:, :3, :3] += (both + both.transpose(0, 2, 1)) / (h**2)[:, None, None]
    H[:, :3, :3] -= (2.0 * k**2 / h)[:, None, None] * (one - normal[:, :, None] * normal[:, None, :])
    turn = cross(frame.transpose(0, 2, 1), normal[:, None, :]).transpose(0, 2, 1)
    mixed = normal[:, :, None] * t[:, None, :] + c[:, None, None] * turn
    H[:, :3, 3:5] = y[:, :, None] * by_tilt[:, None, :] / (h**2)[:, None, None] + (2.0 * k / h)[:, None, None] * mixed
    H[:, 3:5, :3] = H[:, :3, 3:5].transpose(0, 2, 1)
    H[:, 3:5, 3:5] = (2.0 / h)[:, None, None] * (t[:, :, None] * t[:, None, :] - (c**2)[:, None, None] * two)
    return G, H
