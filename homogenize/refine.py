"""More half-spaces than rows: the support function predicted between the rows from their values and gradients.

A row gives h_i and E_i = dh/dS, so along the way from S_i to S_j the support function is known with its slope at both
ends: Hermite's cubic is wrong by the fourth power of the distance, while the rows' own bounds, inside and outside, are
wrong by the second. Predictions are clipped to these bounds, so the refined set contains every row's strain and obeys
every row's half-space, whatever the prediction. Loads of rank one are refined along the rim of the disc, closely,
because a polyhedron carries no load outside the hull of its normals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from homogenize.bounds import bounds_of
from homogenize.protocol import Array
from homogenize.rows import ROUNDING, Rows, with_mirror
from homogenize.tensor import disc, double_dot, from_disc, mirror

Index = NDArray[np.intp]
RIM_TOLERANCE = 1e-7
RIM_STEP = np.radians(2.5)
"""Largest angle in the disc between rim loads: the hull of the normals then misses the rim by 2.4e-4 of the load."""
NEWS = 3e-5
"""A prediction less than this strain below the rows' outer bound tells nothing new: the rows meet in a vertex there."""


@dataclass(frozen=True, eq=False)
class Nodes:
    """Distinct loads x (k, 2) in the disc with h (k,); E (n, 3) of all rows and the node `of_row` (n,) of each.

    A load on a flat face of the set has several strains: the slope of h there depends on the way that is taken.
    """

    x: Array
    h: Array
    E: Array
    of_row: Index

    def on_rim(self) -> NDArray[np.bool_]:
        """Loads of rank one, (k,)."""
        return np.asarray(1.0 - np.hypot(self.x[:, 0], self.x[:, 1]) < RIM_TOLERANCE)

    def slope(self, node: Index, way: Array, last: bool) -> Array:
        """Slope of h at nodes (m,) along load changes `way` (m, 3): the largest on leaving, the least on arriving."""
        sign = -1.0 if last else 1.0
        order = np.argsort(self.of_row, kind="stable")
        first = np.searchsorted(self.of_row[order], np.arange(len(self.x) + 1))
        best = double_dot(way, self.E[order[first[node]]])
        for extra in range(1, int(np.diff(first).max())):
            more = first[node] + extra < first[node + 1]
            other = double_dot(way[more], self.E[order[first[node[more]] + extra]])
            best[more] = sign * np.maximum(sign * best[more], sign * other)
        return best


def nodes_of(rows: Rows) -> Nodes:
    """The distinct loads of the rows and their mirror images."""
    both = with_mirror(rows)
    key = np.round(both.S / ROUNDING).astype(np.int64)
    _, first, of_row = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return Nodes(disc(both.S[first]), both.h[first], both.E, of_row.ravel())


def refined_half_spaces(rows: Rows, news: float = NEWS) -> tuple[Array, Array]:
    """Half-spaces S (m, 3), h (m,): those of the rows, their mirror images, and predictions between neighbours.

    Predictions that are not `news` below the outer bound of the rows are left out, except on the rim.
    """
    bounds, nodes = bounds_of(rows), nodes_of(rows)
    x_inner, h_inner = on_chords(nodes, neighbours(nodes))
    x_rim, h_rim = on_arcs(nodes)
    S = from_disc(np.vstack([x_inner, x_rim]))
    upper = bounds.upper(S)
    h = np.clip(np.concatenate([h_inner, h_rim]), bounds.lower(S), upper)
    keep = (upper - h > news) | (np.arange(len(h)) >= len(h_inner))
    S, h = S[keep], h[keep]
    return np.vstack([from_disc(nodes.x), S, mirror(S)]), np.concatenate([nodes.h, h, h])


def neighbours(nodes: Nodes) -> Index:
    """Pairs (k, 2) of loads that share an edge of the lower hull of h over the disc, not both on the rim."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(np.column_stack([nodes.x, nodes.h]), qhull_options="QJ Pp")
    lower = hull.simplices[hull.equations[:, 2] < -1e-9]
    edges = np.vstack([lower[:, [0, 1]], lower[:, [1, 2]], lower[:, [2, 0]]])
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    return np.asarray(edges[~nodes.on_rim()[edges].all(axis=1)], np.intp)


def on_chords(nodes: Nodes, pairs: Index) -> tuple[Array, Array]:
    """Loads half-way between the pairs as points of the disc (k, 2), and their predicted support (k,)."""
    i, j = pairs.T
    way = from_disc(nodes.x[j]) - from_disc(nodes.x[i])
    ends = nodes.slope(i, way, last=False), nodes.slope(j, way, last=True)
    return 0.5 * (nodes.x[i] + nodes.x[j]), hermite(0.5, nodes.h[i], nodes.h[j], *ends)


def on_arcs(nodes: Nodes) -> tuple[Array, Array]:
    """Loads between neighbours on the rim, at most `RIM_STEP` apart, (k, 2), and their predicted support (k,)."""
    rim = np.flatnonzero(nodes.on_rim())
    if len(rim) < 3:
        return np.zeros((0, 2)), np.zeros(0)
    angle = np.arctan2(nodes.x[rim, 1], nodes.x[rim, 0])
    rim, angle = rim[np.argsort(angle)], np.sort(angle)
    step = np.mod(np.roll(angle, -1) - angle, 2.0 * np.pi)
    parts = np.ceil(step / RIM_STEP).astype(int)
    arc = np.repeat(np.arange(len(rim)), parts - 1)
    part = np.concatenate([np.arange(1, n) for n in parts]) / parts[arc]
    i, j = rim[arc], np.roll(rim, -1)[arc]

    def along(node: Index) -> Array:
        x = nodes.x[node]
        return 0.5 * step[arc, None] * np.stack([-x[:, 1], x[:, 0], x[:, 1]], axis=1)

    h = hermite(part, nodes.h[i], nodes.h[j], nodes.slope(i, along(i), last=False), nodes.slope(j, along(j), last=True))
    theta = angle[arc] + part * step[arc]
    return np.stack([np.cos(theta), np.sin(theta)], axis=1), h


def hermite(t: float | Array, first: Array, last: Array, slope_first: Array, slope_last: Array) -> Array:
    """The cubic with these values and slopes (per whole way) at t = 0 and t = 1."""
    bend = (1.0 - t) * (slope_first - (last - first)) + t * ((last - first) - slope_last)
    return np.asarray((1.0 - t) * first + t * last + t * (1.0 - t) * bend)
