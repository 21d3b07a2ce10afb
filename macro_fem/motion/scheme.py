"""Implicit steps in time: Euler's, and BDF2 with steps of any ratio.

Velocities are differences of positions and accelerations the same differences of velocities. With steps h and before it
h / w,

    beta h v+ = x+ - X,   beta h a+ = v+ - V,   beta = (1 + w) / (1 + 2 w),
    X = beta ((1 + w) x_n - w^2 / (1 + w) x_(n-1)),   V the same of velocities,

and beta = 1, X = x_n, V = v_n for Euler's. The equation of motion M a+ = f is where
|x+ - X - beta h V|^2_M / (2 (beta h)^2) - f.x+ is stationary: a convex program for every step size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rve.common import Array


@dataclass(frozen=True, eq=False)
class Moment:
    """Positions x (n, d) in mm and velocities v (n, d) in mm/s at the time t in s."""

    t: float
    x: Array
    v: Array


@dataclass(frozen=True, eq=False)
class Difference:
    """The differences of one step: h and beta h in s, X (n, d) in mm and V (n, d) in mm/s of the module header."""

    h: float
    beta_h: float
    X: Array
    V: Array

    @property
    def x_hat(self) -> Array:
        """X + beta h V (n, d): where nodes would go without forces, mm."""
        return self.X + self.beta_h * self.V

    def velocity(self, x: Array) -> Array:
        """v+ (n, d) of positions x (n, d), mm/s."""
        return (x - self.X) / self.beta_h

    def acceleration(self, x: Array) -> Array:
        """a+ (n, d) of positions x (n, d), mm/s2."""
        return (x - self.x_hat) / self.beta_h**2


def difference(now: Moment, before: Moment | None, h: float) -> Difference:
    """The differences of a step h from `now`: Euler's without a moment before, else BDF2's.

    >>> start = Moment(0.0, np.zeros((1, 2)), np.ones((1, 2)))
    >>> difference(start, None, 0.5).x_hat.tolist()
    [[0.5, 0.5]]
    """
    if before is None:
        return Difference(h, h, now.x, now.v)
    w = h / (now.t - before.t)
    beta = (1.0 + w) / (1.0 + 2.0 * w)
    own, old = beta * (1.0 + w), beta * w * w / (1.0 + w)
    return Difference(h, beta * h, own * now.x - old * before.x, own * now.v - old * before.v)


def predicted(now: Moment, before: Moment | None, h: float) -> Array:
    """Positions (n, d) after a step h at the last acceleration, mm: x+ differs from them by a third power of h."""
    a = np.zeros_like(now.v) if before is None else (now.v - before.v) / (now.t - before.t)
    return now.x + h * now.v + 0.5 * h * h * a
