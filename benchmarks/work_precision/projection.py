"""Contact points by alternating projection, as in the paper (Fig. 7), to compare with.

A point of circle A is projected on circle B, that one back on A, and so on until both rest. The pair converges
linearly to *one* local minimum of the distance; the contraction factor tends to 1 where two minima merge.
"""

from __future__ import annotations

import numpy as np

from rve.common.types import Array
from rve.geometry.circles import Minima, cross, dot, foot_on_circle


def alternating_projection(
    d: Array, n_a: Array, n_b: Array, start: Array, *, tolerance: float = 1e-12, max_iterations: int = 400
) -> Minima:
    """The minimum that alternating projection ends in, one row per pair; circles of radius 1.

    d, n_a, n_b (n, 3): centre of B seen from A, unit normals; start (n, 3): any points near ring A. Iterates until the
    point on A moves by less than `tolerance`, at most `max_iterations` times: where minima merge it stops short.
    """
    rho_a = foot_on_circle(start, n_a, 1.0)
    todo = np.arange(len(d))
    for _ in range(max_iterations):
        on_b = d[todo] + foot_on_circle(rho_a[todo] - d[todo], n_b[todo], 1.0)
        new = foot_on_circle(on_b, n_a[todo], 1.0)
        way = new - rho_a[todo]
        rho_a[todo] = new
        todo = todo[dot(way, way) > tolerance**2]
        if not len(todo):
            break
    rho_b = foot_on_circle(rho_a - d, n_b, 1.0)
    w = d + rho_b - rho_a
    distance = np.maximum(np.sqrt(dot(w, w)), 1e-12)
    u = w / distance[:, None]
    f_aa, f_bb = 1.0 / distance + dot(u, rho_a), 1.0 / distance - dot(u, rho_b)
    f_ab = -dot(cross(n_a, rho_a), cross(n_b, rho_b)) / distance
    curvature = (f_aa - f_ab**2 / np.maximum(f_bb, 1e-300)) * distance
    return Minima(np.arange(len(d)), u, rho_a, rho_b, distance, curvature)
