"""More half-spaces than rows: the support function predicted between the rows from their values and gradients.

A row gives h_i and E_i = dh/dS, so along the way from S_i to S_j the support function is known with its slope at both
ends: a prediction from both is wrong by the fourth power of the distance, while the rows' own bounds, inside and
outside, are wrong by the second. Predictions are clipped to these bounds, so the refined set contains every row's
strain and obeys every row's half-space, whatever the prediction. Loads of rank one are refined along the rim of the
disc, closely, because a polyhedron carries no load outside the hull of its normals.
"""

from dataclasses import dataclass
from itertools import permutations
from typing import Annotated

import numpy as np
from msgspec import Meta

from homogenize.fitting.bounds import SupportBounds, bounds_of
from homogenize.laws.rows import ROUNDING, LockedRows, with_mirror
from rve.common import Array, Flags, Index
from rve.common.tensor import disc, double_dot, from_disc, mirror

RESOLUTION, FINEST = 3e-5, 1e-7
"""Default and least resolution; the least gives a hundred thousand half-spaces and more."""
Resolution = Annotated[float, Meta(ge=FINEST, le=1.0)]
FINE, MOST_PARTS = 1e-4, 10
"""Ways between rows are cut in sqrt(gap / FINE) parts, MOST_PARTS at most, where gap is the distance of the bounds; at
another resolution in the same measure."""
COARSE, SHARE = 2e-3, 0.2
"""Where the bounds are farther apart than COARSE the slope turns unevenly between the rows and cubics are not used; the
support is put this SHARE of the way from the inner to the outer bound. Largest error on the paper's grid and the 1000
directions that the share was chosen on: 5.2e-4 with 0.2, 6.9e-4 with 0.25, 1.6e-3 without."""


def parts_of(gap: Array, resolution: float, least: int) -> Index:
    """Parts of ways with these distances of the bounds, (k,)."""
    finer = resolution / RESOLUTION
    most = max(3, round(MOST_PARTS / np.sqrt(finer)))
    return np.clip(np.ceil(np.sqrt(gap / (FINE * finer))), least, most).astype(np.intp)


@dataclass(frozen=True, eq=False)
class Nodes:
    """Distinct loads x (k, 2) in the disc with h (k,); E (n, 3) of all rows and the node `of_row` (n,) of each.

    A load on a flat face of the set has several strains: the slope of h there depends on the way that is taken.
    """

    x: Array
    h: Array
    E: Array
    of_row: Index

    def on_rim(self) -> Flags:
        """Loads of rank one, (k,)."""
        return np.asarray(1.0 - np.hypot(self.x[:, 0], self.x[:, 1]) < 1e-7)

    def slope(self, node: Index, way: Array, last: bool) -> Array:
        """Slope of h at nodes (m,) along load changes `way` (m, 3): the largest on leaving, the least on arriving."""
        order = np.argsort(self.of_row, kind="stable")
        first = np.searchsorted(self.of_row[order], np.arange(len(self.x) + 1))
        rows = first[node + 1] - first[node]
        begin = np.cumsum(rows) - rows
        row = order[np.repeat(first[node] - begin, rows) + np.arange(rows.sum())]
        work = double_dot(np.repeat(way, rows, axis=0), self.E[row])
        return np.asarray((np.minimum if last else np.maximum).reduceat(work, begin))


def nodes_of(rows: LockedRows) -> Nodes:
    """The distinct loads of the rows and their mirror images."""
    both = with_mirror(rows)
    key = np.round(both.S / ROUNDING).astype(np.int64)
    _, first, of_row = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return Nodes(disc(both.S[first]), both.h[first], both.E, of_row.ravel())


def refined_half_spaces(rows: LockedRows, resolution: float = RESOLUTION) -> tuple[Array, Array]:
    """Half-spaces S (m, 3), h (m,): those of the rows, their mirror images, and predictions between neighbours.

    A prediction less than the strain `resolution` below the rows' outer bound is left out, except on the rim: the rows
    meet in a vertex there.
    """
    bounds, nodes = bounds_of(rows), nodes_of(rows)
    triangles = triangles_of(nodes)
    x_chord, h_chord = on_chords(nodes, chords_of(triangles, nodes), bounds, resolution)
    x_centre, h_centre = in_triangles(nodes, triangles)
    x_coarse = coarse_lattice(nodes, triangles, bounds, resolution)
    # Largest angle in the disc between rim loads; with this the hull of the normals misses the rim by 2.4e-4 of the
    # load.
    x_rim, h_rim = on_arcs(nodes, 2.5)
    S = from_disc(np.vstack([x_chord, x_centre, x_coarse, x_rim]))
    h = np.concatenate([h_chord, h_centre, np.full(len(x_coarse), np.inf), h_rim])
    lower, upper = bounds.lower(S), bounds.upper(S)
    top = np.where(upper - lower > COARSE, lower + SHARE * (upper - lower), upper)
    h = np.clip(h, lower, top)
    keep = (upper - h > resolution) | (np.arange(len(h)) >= len(h) - len(h_rim))
    S, h = S[keep], h[keep]
    if rows.is_mirrored:
        S, h = np.vstack([S, mirror(S)]), np.concatenate([h, h])
    return np.vstack([from_disc(nodes.x), S]), np.concatenate([nodes.h, h])


def coarse_lattice(nodes: Nodes, triangles: Index, bounds: SupportBounds, resolution: float) -> Array:
    """Loads (k, 2) on a lattice in every triangle in which the bounds are far apart; finer, the farther."""
    centre_gap = bounds.gap(from_disc(nodes.x[triangles].mean(axis=1)))
    found = [np.zeros((0, 2))]
    wide = np.flatnonzero(centre_gap > 0.5 * COARSE)
    for k, n in zip(wide, parts_of(centre_gap[wide], resolution, 3), strict=True):
        i, j = np.nonzero(np.add.outer(np.arange(n + 1), np.arange(n + 1)) <= n)
        found.append(np.stack([i, j, n - i - j], axis=1) / n @ nodes.x[triangles[k]])
    x = np.vstack(found)
    return x[bounds.gap(from_disc(x)) > COARSE]


def triangles_of(nodes: Nodes) -> Index:
    """Triangles (k, 3) of the lower hull of h over the disc."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(np.column_stack([nodes.x, nodes.h]), qhull_options="QJ Pp")
    return np.asarray(hull.simplices[hull.equations[:, 2] < -1e-9], np.intp)


def chords_of(triangles: Index, nodes: Nodes) -> Index:
    """Sides (k, 2) of the triangles, each once, without those between two loads of rank one."""
    sides = np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    sides = np.unique(np.sort(sides, axis=1), axis=0)
    return np.asarray(sides[~nodes.on_rim()[sides].all(axis=1)], np.intp)


def in_triangles(nodes: Nodes, triangles: Index) -> tuple[Array, Array]:
    """Centres (k, 2) of the triangles and their predicted support (k,), right for every quadratic.

    The cubic Bezier triangle with the values and slopes of the corners; its middle control value is a quarter of the
    sum of those beside the corners less a sixth of the sum of the corners.
    """
    corners = nodes.h[triangles].sum(axis=1)
    beside = 2.0 * corners
    for a, b in permutations(range(3), 2):
        i, j = triangles[:, a], triangles[:, b]
        way = from_disc(nodes.x[j]) - from_disc(nodes.x[i])
        beside = beside + nodes.slope(i, way, last=False) / 3.0
    middle = beside / 4.0 - corners / 6.0
    return nodes.x[triangles].mean(axis=1), (corners + 3.0 * beside + 6.0 * middle) / 27.0


def on_chords(nodes: Nodes, pairs: Index, bounds: SupportBounds, resolution: float) -> tuple[Array, Array]:
    """Loads between the pairs as points of the disc (k, 2), and their predicted support (k,).

    The farther the bounds are apart half-way, the more loads: the error of the polyhedron between two of them falls
    with the square of their number.
    """
    middle = from_disc(0.5 * (nodes.x[pairs[:, 0]] + nodes.x[pairs[:, 1]]))
    chord, t = subdivision(parts_of(bounds.gap(middle), resolution, 2))
    i, j = pairs[chord].T
    way = from_disc(nodes.x[j]) - from_disc(nodes.x[i])
    ends = nodes.slope(i, way, last=False), nodes.slope(j, way, last=True)
    return nodes.x[i] + t[:, None] * (nodes.x[j] - nodes.x[i]), hermite(t, nodes.h[i], nodes.h[j], *ends)


def subdivision(parts: Index) -> tuple[Index, Array]:
    """Number of the way and place 0 < t < 1 on it of the points that cut each way in `parts` (k,) equal parts."""
    way = np.repeat(np.arange(len(parts)), parts - 1)
    part = np.concatenate([np.arange(1, n) for n in parts]) if len(way) else np.zeros(0)
    return way, part / parts[way]


def on_arcs(nodes: Nodes, step_deg: float) -> tuple[Array, Array]:
    """Loads (k, 2) between rim neighbours, at most `step_deg` apart in the disc, and their predicted support (k,)."""
    rim = np.flatnonzero(nodes.on_rim())
    if len(rim) < 3:
        return np.zeros((0, 2)), np.zeros(0)
    angle = np.arctan2(nodes.x[rim, 1], nodes.x[rim, 0])
    rim, angle = rim[np.argsort(angle)], np.sort(angle)
    step = np.mod(np.roll(angle, -1) - angle, 2.0 * np.pi)
    arc, part = subdivision(np.ceil(step / np.radians(step_deg)).astype(int))
    i, j = rim[arc], np.roll(rim, -1)[arc]

    def along(node: Index) -> Array:
        x = nodes.x[node]
        return np.asarray(0.5 * step[arc, None] * np.stack([-x[:, 1], x[:, 0], x[:, 1]], axis=1))

    h = hermite(part, nodes.h[i], nodes.h[j], nodes.slope(i, along(i), last=False), nodes.slope(j, along(j), last=True))
    theta = angle[arc] + part * step[arc]
    return np.stack([np.cos(theta), np.sin(theta)], axis=1), h


def hermite(t: Array, first: Array, last: Array, slope_first: Array, slope_last: Array) -> Array:
    """The cubic with these values and slopes (per whole way) at t = 0 and t = 1."""
    rise = last - first
    bend = (1.0 - t) * (slope_first - rise) + t * (rise - slope_last)
    return np.asarray((1.0 - t) * first + t * last + t * (1.0 - t) * bend)
