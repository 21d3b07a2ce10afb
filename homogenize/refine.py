"""More half-spaces than rows: the support function predicted between the rows from their values and gradients.

A row gives h_i and E_i = dh/dS, so along the line from S_i to S_j the support function is known with its slope at both
ends: Hermite's cubic is wrong by the fourth power of the distance, while the rows' own bounds, inside and outside, are
wrong by the second. Predictions are clipped to these bounds, so the refined set contains every row's strain and obeys
every row's half-space, whatever the prediction. Rim loads, of rank one, are refined along the rim.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from homogenize.bounds import Bounds, bounds_of
from homogenize.protocol import Array
from homogenize.rows import ROUNDING, Rows, with_mirror
from homogenize.tensor import double_dot, mirror

Index = NDArray[np.int64]
RIM_TOLERANCE = 1e-7


def disc(S: Array) -> Array:
    """The load S (n, 3) of unit trace as a point of the unit disc, (n, 2): (S11 - S22, 2 S12); the rim is rank one."""
    return np.stack([S[:, 0] - S[:, 2], 2.0 * S[:, 1]], axis=1)


def from_disc(x: Array) -> Array:
    """Loads S (n, 3) of unit trace from points (n, 2) of the unit disc."""
    return np.stack([0.5 * (1.0 + x[:, 0]), 0.5 * x[:, 1], 0.5 * (1.0 - x[:, 0])], axis=1)


def refined_half_spaces(rows: Rows, rounds: int = 1) -> tuple[Array, Array]:
    """Half-spaces S (m, 3), h (m,): those of the rows, their mirror images, and predictions between neighbours."""
    bounds = bounds_of(rows)
    both = with_mirror(rows)
    S, E = both.S, both.E
    for _ in range(rounds):
        pairs = neighbours(S, double_dot(S, E))
        new_S, new_E = between(S, E, pairs, bounds)
        S, E = np.vstack([S, new_S, mirror(new_S)]), np.vstack([E, new_E, mirror(new_E)])
    return S, double_dot(S, E)


def neighbours(S: Array, h: Array) -> Index:
    """Pairs (k, 2) of loads that share an edge of the lower hull of h over the disc, and neighbours on the rim."""
    from scipy.spatial import ConvexHull

    x = disc(S)
    hull = ConvexHull(np.column_stack([x, h]), qhull_options="QJ Pp")
    lower = hull.simplices[hull.equations[:, 2] < -1e-9]
    edges = np.vstack([lower[:, [0, 1]], lower[:, [1, 2]], lower[:, [2, 0]]])
    rim = np.flatnonzero(1.0 - np.hypot(x[:, 0], x[:, 1]) < RIM_TOLERANCE)
    rim = rim[np.argsort(np.arctan2(x[rim, 1], x[rim, 0]))]
    edges = np.sort(np.vstack([edges, np.column_stack([rim, np.roll(rim, -1)])]), axis=1)
    edges = np.unique(edges, axis=0)
    length = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1)
    return edges[length > 10.0 * ROUNDING]


def between(S: Array, E: Array, pairs: Index, bounds: Bounds) -> tuple[Array, Array]:
    """Loads half-way between the pairs, (k, 3), and predicted strains (k, 3) whose S:E is the predicted support."""
    i, j = pairs.T
    x = disc(S)
    on_rim = (1.0 - np.hypot(x[:, 0], x[:, 1]) < RIM_TOLERANCE)[pairs].all(axis=1)
    middle = 0.5 * (x[i] + x[j])
    size = np.hypot(middle[:, 0], middle[:, 1])
    arc = on_rim & (size > 0.5)
    middle[arc] /= size[arc, None]
    new_S = from_disc(middle)
    slope_i, slope_j = _end_slopes(x, S, E, pairs, arc)
    h_i, h_j = double_dot(S[i], E[i]), double_dot(S[j], E[j])
    h = 0.5 * (h_i + h_j) + 0.125 * (slope_i - slope_j)
    h = np.clip(h, bounds.lower(new_S), bounds.upper(new_S))
    guess = 0.5 * (E[i] + E[j])
    shift = h - double_dot(new_S, guess)
    return new_S, guess + shift[:, None] * np.array([1.0, 0.0, 1.0])


def _end_slopes(x: Array, S: Array, E: Array, pairs: Index, arc: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Derivative of h along the way from i to j, per whole way, at both ends; along the arc where `arc`."""
    i, j = pairs.T
    turn = x[i, 0] * x[j, 1] - x[i, 1] * x[j, 0]
    angle = np.arctan2(turn, (x[i] * x[j]).sum(axis=1))
    straight = S[j] - S[i]
    slopes = []
    for k in (i, j):
        round_way = angle[:, None] * np.stack([-0.5 * x[k, 1], 0.5 * x[k, 0], 0.5 * x[k, 1]], axis=1)
        slopes.append(double_dot(np.where(arc[:, None], round_way, straight), E[k]))
    return slopes[0], slopes[1]
