"""Half-spaces that rings stay out of, with the closed form of a torus over a plane.

The lowest point of a ring over the plane m.(x - p) = 0 has the height h - s, with h = m.(c - p) and s the sine of the
angle between its normal n and m. Lengths are in units of r1; p lies r2 off the half-space, so that wires are bare
lines. s has a kink where a ring lies flat on the plane. The constraint is g = h - s^2/h >= 0 for h > 0, which is the
same and smooth; (h - s) <= g <= 2 (h - s).

A half-space is kept as one more row of `Placed`: p and m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rve.common.errors import InputError
from rve.common.types import Array
from rve.geometry.circles import cross, dot, tangent_frame


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


def wall_gaps(x: Array, normal: Array, place: Array, m: Array) -> Array:
    """g (k,) of rings over planes; negative where a ring is partly below. Lengths in units of r1."""
    h, s2 = _height(x, normal, place, m)
    safe = np.where(h > 0.0, h, 1.0)
    return np.asarray(np.where(h > 0.0, h - s2 / safe, h - np.sqrt(s2)))


def _height(x: Array, normal: Array, place: Array, m: Array) -> tuple[Array, Array]:
    p = cross(normal, m)
    return dot(m, x - place), dot(p, p)


def wall_derivatives(x: Array, normal: Array, place: Array, m: Array) -> tuple[Array, Array]:
    """Gradient (k, 7) and second derivative (k, 7, 7) of g: way of the plane as seen from the ring, tilts of both."""
    h, s2 = _height(x, normal, place, m)
    c, p = dot(normal, m), cross(normal, m)
    frame = np.stack(tangent_frame(normal), axis=2)
    t = (p[:, :, None] * frame).sum(axis=1)
    G, H = np.zeros((len(h), 7)), np.zeros((len(h), 7, 7))
    G[:, :3] = -(1.0 + s2 / h**2)[:, None] * m
    G[:, 3:5] = (2.0 * c / h)[:, None] * t
    H[:, :3, :3] = (-2.0 * s2 / h**3)[:, None, None] * m[:, :, None] * m[:, None, :]
    H[:, :3, 3:5] = (2.0 * c / h**2)[:, None, None] * m[:, :, None] * t[:, None, :]
    H[:, 3:5, :3] = H[:, :3, 3:5].transpose(0, 2, 1)
    H[:, 3:5, 3:5] = (2.0 / h)[:, None, None] * (t[:, :, None] * t[:, None, :] - (c**2)[:, None, None] * np.eye(2))
    return G, H
