"""Closed sums of the Fourier series that a circular beam under a point force leads to.

All run from n = 2: the orders 0 and 1 are rigid motions, or a separate few terms (`rve.ring.kernels`). Angles phi are
taken into [0, 2 pi); y = pi - phi.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rve.common.types import Array


class Sums(NamedTuple):
    """Sums over n >= 2 at angles of one shape, x = n^2 - 1.

    cos_x: cos(n phi)/x. sin_x: n sin(n phi)/x. sin_nx: sin(n phi)/(n x). sin_n: sin(n phi)/n; sin_x and sin_n jump at
    phi = 0, where the value from above is given.
    """

    cos_x: Array
    sin_x: Array
    sin_nx: Array
    sin_n: Array


class Squares(NamedTuple):
    """Sums over n >= 2 at angles of one shape, x = n^2 - 1: all continuous.

    cos: cos(n phi)/x^2. cos_up: n^2 cos(n phi)/x^2. cos_down: cos(n phi)/(n x)^2. sin_up: n sin(n phi)/x^2.
    sin_down: sin(n phi)/(n x^2). cos_n: cos(n phi)/n^2.
    """

    cos: Array
    cos_up: Array
    cos_down: Array
    sin_up: Array
    sin_down: Array
    cos_n: Array


def sums(phi: Array) -> Sums:
    """The sums behind section forces, at angles phi of any shape.

    >>> n = np.arange(2, 100_000)
    >>> bool(abs(sums(np.array(1.0)).cos_x - np.sum(np.cos(n) / (n**2 - 1.0))) < 1e-9)
    True
    """
    phi = np.mod(phi, 2.0 * np.pi)
    c, s, y = np.cos(phi), np.sin(phi), np.pi - phi
    sin_x, sin_n = 0.5 * y * c - 0.25 * s, 0.5 * y - s
    return Sums(0.5 + 0.25 * c - 0.5 * y * s, sin_x, sin_x - sin_n, sin_n)


def squares(phi: Array) -> Squares:
    """The sums behind the flexibility, at angles phi of any shape.

    >>> n = np.arange(2, 1000)
    >>> bool(abs(squares(np.array(0.0)).cos - np.sum(1.0 / (n**2 - 1.0) ** 2)) < 1e-9)
    True
    """
    phi = np.mod(phi, 2.0 * np.pi)
    c, s, y = np.cos(phi), np.sin(phi), np.pi - phi
    cos_x, sin_x, sin_n = 0.5 + 0.25 * c - 0.5 * y * s, 0.5 * y * c - 0.25 * s, 0.5 * y - s
    cos_n = 0.25 * y**2 - np.pi**2 / 12.0 - c
    cos = -0.5 - (3.0 / 16.0 + np.pi**2 / 24.0) * c + 0.25 * y * s + 0.125 * y**2 * c
    sin_up = (1.0 / 16.0 - np.pi**2 / 24.0) * s + 0.125 * y**2 * s
    return Squares(cos, cos_x + cos, cos_n - cos_x + cos, sin_up, sin_n - sin_x + sin_up, cos_n)
