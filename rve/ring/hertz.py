"""Local flexibility of two wires pressed together at a point: Hertz's contact of elastic bodies.

Bodies with the relative curvatures A <= B touch in an ellipse with semi-axes a >= b, m = 1 - (b/a)^2. With the complete
elliptic integrals K(m), E(m) and 1/E* = 2 (1 - nu^2)/E for bodies of one material, a force F gives

    A/B = [(K - E)/m] / [(E/(1 - m) - K)/m],    a^3 = 3 F/(2 pi E* A) (K - E)/m,    delta = 3 F K/(2 pi E* a)

(K. L. Johnson, Contact Mechanics, Cambridge 1985, 4.2). Equal cylinders that cross at right angles touch as a sphere of
their radius touches a plane: a^3 = 3 F R/(4 E*), delta = a^2/R.
"""

from __future__ import annotations

import numpy as np
from scipy.special import elliprd, elliprf

from rve.common.types import Array

_NARROWEST = 1e-10
"""Least (b/a)^2: A/B of 1e-9. Bodies that fit each other more closely count as touching in an ellipse this narrow."""
_HALVINGS = 60


def relative_curvatures(first: Array, second: Array, cosine: Array) -> Array:
    """A and B (..., 2) of two surfaces with principal curvatures first, second (..., 2): along and across a direction.

    cosine (...): of the angle between the directions of the two. Curvatures are positive where a body is convex.

    >>> cylinder = np.array([0.0, 2.0])
    >>> relative_curvatures(cylinder, cylinder, np.array(0.0))
    array([1., 1.])
    """
    d, e = first[..., 1] - first[..., 0], second[..., 1] - second[..., 0]
    mean = 0.25 * (first.sum(axis=-1) + second.sum(axis=-1))
    half = 0.25 * np.sqrt(np.maximum(d**2 + e**2 + 2.0 * d * e * (2.0 * cosine**2 - 1.0), 0.0))
    return np.stack([mean - half, mean + half], axis=-1)


def squared_axis_ratio(curvature: Array) -> Array:
    """(b/a)^2 (...) of the ellipse of contact for relative curvatures A, B (..., 2), by bisection of its logarithm."""
    ratio = curvature[..., 0] / curvature[..., 1]
    low, high = np.full(ratio.shape, np.log(_NARROWEST)), np.zeros(ratio.shape)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        k = np.exp(middle)
        small = elliprd(0.0, k, 1.0) < ratio * elliprd(0.0, 1.0, k)
        low, high = np.where(small, middle, low), np.where(small, high, middle)
    return np.asarray(np.exp(0.5 * (low + high)))


def approach_per_force(curvature: Array, young: float, poisson: float) -> Array:
    """The factor (...) of F^(2/3) in the approach delta of two bodies with relative curvatures A, B (..., 2).

    >>> steel = approach_per_force(np.array([1.0, 1.0]), 210e3, 0.3)  # wires of 0.5 mm radius at right angles
    >>> float((1e3 * steel * 10.0 ** (2 / 3)).round(3))  # micrometres at 10 N
    2.037
    """
    k = squared_axis_ratio(curvature)
    effective = 0.5 * young / (1.0 - poisson**2)
    A = np.maximum(curvature[..., 0], _NARROWEST * curvature[..., 1])
    cube = elliprd(0.0, k, 1.0) / (2.0 * np.pi * effective * A)  # a^3/F, where (K - E)/m = R_D(0, 1 - m, 1)/3
    return np.asarray(1.5 * elliprf(0.0, k, 1.0) / (np.pi * effective * np.cbrt(cube)))
