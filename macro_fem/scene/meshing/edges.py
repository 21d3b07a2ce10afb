"""Named edges of a plane sheet: chains of its boundary by their direction, holes, and named lines of a mesh file.

Outer loops of the boundary, with the mesh on their left, are cut into chains at corners, where they turn by more than
40 degrees. A chain whose normal departs from that of its chord by more than 45 degrees, such as a semicircle, and a
loop of one corner or none are cut further where they change between facing up, facing down and upright. "top" is made
of the chains that lie at the greatest height, or, if there are none, of those that reach it and face up more than
sideways, or of all that reach it and face up: an arch, both slopes of a gable. Where none does, as at a tip that leans,
the boundary is cut at corners and where it ceases to face up, and the parts that face up and reach the greatest height
are taken. So every outline has a top. The other sides are found in the same way. A facet has one name; left and right
get what top and bottom leave, which of a disk or a drop is nothing or little.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, repeat
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import shapely
from scipy.spatial import cKDTree

from macro_fem.fem.cells import cross, signed_areas
from rve.common import Array, InputError
from rve.common.records import Index
from rve.common.typed import not_one_of

Chain: TypeAlias = tuple[np.ndarray, Array]
"""A part of the boundary: its facets (k,) and their mean normal (2,)."""
CORNER = math.radians(40.0 + 1e-9)
"""The boundary turns by more than this at a corner. Larger: obtuse corners of a polygon join their sides to one chain.
Smaller: a coarsely divided arch falls into pieces."""
BENT = math.cos(math.radians(45.0 + 1e-9))
"""Least cosine between the normals of a chain and of its chord; a chain that is bent further is cut again."""
UPRIGHT = 1e-3
"""A boundary facet whose normal has a smaller vertical component is upright: neither top nor bottom."""
DIRECTIONS = {"top": (0.0, 1.0), "bottom": (0.0, -1.0), "left": (-1.0, 0.0), "right": (1.0, 0.0)}


@dataclass(frozen=True, eq=False)
class Line:
    """A line through `points` (k, 2), those of neighbouring `nodes` (k,) of a mesh."""

    points: Array
    nodes: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    @cached_property
    def arc(self) -> Array:
        """Distances (k,) of the points from the first, along the line."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])

    @property
    def is_closed(self) -> bool:
        """Whether it ends where it begins."""
        return bool(self.nodes[0] == self.nodes[-1])

    def at(self, s: Array) -> Array:
        """Places (n, 2) at the distances s (n,) from the first node."""
        return np.stack([np.interp(s, self.arc, column) for column in self.points.T], axis=-1)


@dataclass(frozen=True, eq=False)
class Border:
    """The boundary of a sheet: `points` (n, 2), and the pairs (k, 2) of neighbours among them on each named edge.

    Before the mesh the points are those that divide the outline, of a mesh they are all of its nodes.
    """

    points: Array
    edges: dict[str, Index]

    @property
    def size(self) -> float:
        """Diagonal of the bounding box, mm."""
        return float(np.hypot(*np.ptp(self.points, axis=0)))

    def nodes(self, name: str) -> Index:
        """The points (k,) on a named edge, ordered along it for straight ones."""
        nodes = np.unique(self.edges[name])
        return nodes[in_order(self.points[nodes])]

    def lines(self, name: str) -> list[Line]:
        """The lines that a named edge is made of, each from its left end; closed ones repeat their first point.
        InputError for an edge that the sheet does not have."""
        if name not in self.edges:
            raise InputError(f"{name!r} {not_one_of(name, self.edges)}")
        points, pairs, found = self.points, self.edges[name], []
        nodes = np.unique(pairs)
        tree = cKDTree(points[nodes])
        for part in shapely.get_parts(shapely.line_merge(shapely.multilinestrings(points[pairs]))):
            path, ends = nodes[tree.query(shapely.get_coordinates(part))[1]], [0, -1]
            if path[0] == path[-1]:
                path = np.roll(path[:-1], -np.lexsort(points[path[:-1]].T[::-1])[0])
                path, ends = np.append(path, path[0]), [1, -2]
            first, last = points[path[ends]].tolist()
            path = path[::-1] if last < first else path
            found.append(Line(points[path], path))
        return sorted(found, key=lambda line: (line.is_closed, *line.points[0]))

    def line(self, name: str, where: str) -> Line:
        """A named edge from its left or lower end; InputError, which begins with `where`, if it is no open line."""
        lines = self.lines(name)
        if len(lines) != 1 or lines[0].is_closed:
            what = "closed" if len(lines) == 1 else f"made of {len(lines)} pieces"
            raise InputError(f"{where} = {name!r}: is {what}, but a track or line needs an edge that is one open line")
        return lines[0]


def border_of(points: Array, loops: list[Index], lines: Mapping[str, Index] | None = None) -> Border:
    """The border of closed `loops` of points, with "outline", top, bottom, left, right, "hole 1", ..., and `lines`.

    loops (k + 1,) each: their first point again at the end, the sheet on the left. Their order numbers the holes; a
    single one is also called "hole". A line of pairs (k, 2) comes before an edge of the same name.
    """
    outer, inner = list[Index](), list[Index]()
    for loop in loops:
        (outer if signed_areas(points[loop]) > 0.0 else inner).append(loop)
    sides = np.concatenate([_pairs(loop) for loop in outer])
    edges = {"outline": sides} | {name: sides[numbers] for name, numbers in _sides(points, outer).items()}
    edges |= {f"hole {number}": _pairs(loop) for number, loop in enumerate(inner, start=1)}
    if len(inner) == 1:
        edges["hole"] = edges["hole 1"]
    return Border(points, {name: pairs for name, pairs in (edges | dict(lines or {})).items() if len(pairs)})


def _pairs(loop: Index) -> Index:
    """Each of the points (k,) of a line with the next one (k - 1, 2)."""
    return np.stack([loop[:-1], loop[1:]], axis=-1)


def in_order(X: Array) -> Index:
    """The order (k,) of points X (k, 2) on a straight line, from its left end, or of an upright one from the lower.

    >>> in_order(np.array([[1e-10, 0.0], [0.0, 1.0], [-2e-10, 2.0]])).tolist()
    [0, 1, 2]
    """
    width, height = np.ptp(X, axis=0)
    return np.lexsort(X.T if width < UPRIGHT * height else X.T[::-1])


def facets_between(mesh: Any, pairs: np.ndarray) -> np.ndarray:
    """The facets (k,) of a mesh between pairs of nodes (k, 2); pairs that are no facet of it are left out."""
    a, b = pairs[pairs[:, 0] != pairs[:, 1]].T
    return np.unique(mesh.p2f[:, a].multiply(mesh.p2f[:, b]).nonzero()[0])


def inherited_edges(coarse: Any, fine: Any, edges: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The edges of a mesh on a refinement of it that keeps its nodes, and halves facets or keeps them."""
    tree, tiny = cKDTree(fine.p.T), 1e-9 * float(np.ptp(fine.p, axis=1).max())
    found = {}
    for name, facets in edges.items():
        ends = coarse.facets[:, facets].T
        distance, middle = tree.query(coarse.p[:, ends].mean(axis=2).T)
        halves = [np.column_stack([end, middle])[distance < tiny] for end in ends.T]
        found[name] = facets_between(fine, np.concatenate([ends, *halves]))
    return found


def boundary_loops(mesh: Any) -> list[Index]:
    """The nodes (k + 1,) of each closed loop of the boundary, the first one again at the end, mesh on the left. Where
    two meet at a node each keeps to its own cells. Holes come last, from left to right by their centres.
    """
    tree, outer, holes = cKDTree(mesh.p.T), list[Index](), list[Index]()
    sides = shapely.multilinestrings(mesh.p.T[mesh.facets[:, mesh.boundary_facets()].T])
    for region in shapely.get_parts(shapely.build_area(sides)):
        for loops, ring in zip(chain([outer], repeat(holes)), shapely.get_rings(region), strict=False):
            nodes = tree.query(shapely.get_coordinates(ring))[1]
            loops.append(nodes if (signed_areas(mesh.p[:, nodes].T) > 0.0) == (loops is outer) else nodes[::-1])
    digits = 1e-6 * float(np.ptp(mesh.p, axis=1).max())
    return outer + sorted(holes, key=lambda loop: tuple(np.round(mesh.p[:, loop[1:]].mean(axis=1) / digits)))


class Rim(NamedTuple):
    """An outer loop: its facets (k,) by number, their normals (k, 2) and lengths (k,), which begin at a corner (k,)."""

    facets: np.ndarray
    normals: Array
    lengths: Array
    is_corner: np.ndarray

    def cut(self, values: np.ndarray, where: np.ndarray | bool = True) -> list[np.ndarray]:
        """The places of its facets in chains that end at corners and, `where` so, at changes of `values` (k,)."""
        first = np.flatnonzero(self.is_corner | (where & (values != np.roll(values, 1))))
        start = first[0] if len(first) else 0
        return list(np.split(np.roll(np.arange(len(values)), -start), (first - start)[1:]))

    def chains(self, parts: list[np.ndarray]) -> list[Chain]:
        """Facets and mean normal of each of its parts."""
        return [(self.facets[one], np.average(self.normals[one], axis=0, weights=self.lengths[one])) for one in parts]


def _rim(points: Array, loop: Index, first: int) -> Rim:
    """An outer loop with its corners, facets numbered from the `first` on."""
    step = np.diff(points[loop], axis=0)
    length = np.linalg.norm(step, axis=1)
    normal = np.stack([step[:, 1], -step[:, 0]], axis=-1) / length[:, None]
    before = np.roll(normal, 1, axis=0)
    turn = np.arctan2(cross(before, normal), (before * normal).sum(axis=1))
    return Rim(first + np.arange(len(step)), normal, length, np.abs(turn) > CORNER)


def _chains(rim: Rim) -> list[Chain]:
    """The chains of an outer loop: those between its corners, bent ones cut; see the module header."""
    is_bent = np.full(len(rim.facets), rim.is_corner.sum() < 2)
    for part in rim.cut(is_bent):
        chord = rim.lengths[part] @ rim.normals[part]
        is_bent[part] |= (rim.normals[part] @ chord).min() < BENT * np.linalg.norm(chord)
    kind = np.where(np.abs(rim.normals[:, 1]) < UPRIGHT, 0.0, np.sign(rim.normals[:, 1]))
    return rim.chains(rim.cut(kind, is_bent))


def _sides(points: Array, loops: list[Index]) -> dict[str, Index]:
    """Facets of top, bottom, left and right, numbered along the loops in turn; see the module header."""
    ends = np.concatenate([_pairs(loop) for loop in loops]).T
    first = np.cumsum([0, *(len(loop) - 1 for loop in loops)])
    rims = [_rim(points, loop, number) for loop, number in zip(loops, first.tolist(), strict=False)]
    chains, sides = [chain for rim in rims for chain in _chains(rim)], dict[str, np.ndarray]()
    tiny = 1e-6 * float(np.hypot(*np.ptp(points, axis=0)))
    for name, direction in DIRECTIONS.items():
        d = np.array(direction)
        height = (points @ d)[ends]
        is_highest = height > height.max() - tiny
        chosen = _facing(chains, d, UPRIGHT, is_highest.any(axis=0))
        if not chosen:  # a tip that leans or is a cusp
            named = [side for other, side in sides.items() if d @ DIRECTIONS[other] > -1.0]
            halves = [one for rim in rims for one in rim.chains(rim.cut(np.sign(np.round(rim.normals @ d, 9))))]
            halves = [(np.setdiff1d(facets, np.concatenate([*named, facets[:0]])), normal) for facets, normal in halves]
            chosen = _facing(halves, d, 0.0, is_highest.any(axis=0))
        level = [chain for chain in chosen if is_highest[:, chain[0]].all()]
        flat = [chain for chain in chosen if chain[1] @ d > (1.0 + 1e-9) * abs(chain[1] @ d[::-1])]
        if best := level or flat or chosen:
            side = np.concatenate([facets for facets, _ in best])
            chains = [(np.setdiff1d(facets, side), normal) for facets, normal in chains]
            sides = {other: np.setdiff1d(facets, side) for other, facets in sides.items()} | {name: side}
    return sides


def _facing(chains: list[Chain], d: Array, least: float, is_highest: np.ndarray) -> list[Chain]:
    """The chains that face along d (2,), by more than `least`, and have one of the highest facets (n_facets,)."""
    return [(facets, normal) for facets, normal in chains if normal @ d > least and is_highest[facets].any()]
