"""Named edges of a plane mesh: chains of its boundary by their direction, holes, and named lines of a mesh file.

Outer loops of the boundary, with the mesh on their left, are cut into chains at corners, where they turn by more than
40 degrees. A chain whose normal departs from that of its chord by more than 45 degrees, such as a semicircle, is cut
further where it changes between facing up, facing down and upright. "top" is made of the chains that lie at the
greatest height, or, if there are none, of those that reach it and face up more than sideways, or of all that reach it
and face up: an arch, both slopes of a gable. The other sides are found in the same way; a chain has one name.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from scipy.spatial import cKDTree

from macro_fem.fem.cells import cross, signed_areas
from rve.common import Array, InputError

CORNER = math.radians(40.0)
"""The boundary turns by more than this at a corner. Larger: obtuse corners of a polygon join their sides to one chain.
Smaller: a coarsely divided arch falls into pieces."""
BENT = math.cos(math.radians(45.0))
"""Least cosine between the normals of a chain and of its chord; a chain that is bent further is cut again."""
UPRIGHT = 1e-3
"""A boundary facet whose normal has a smaller vertical component is upright: neither top nor bottom."""
DIRECTIONS = {"top": (0.0, 1.0), "bottom": (0.0, -1.0), "left": (-1.0, 0.0), "right": (1.0, 0.0)}


def named_edges(mesh: Any, holes: list[Array], lines: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Facet numbers by name: "outline", top, bottom, left, right, "hole 1", ..., and `lines` of node pairs (k, 2).

    The order of the polygons `holes`, without them that of centres from left to right, numbers the holes; a single one
    is also called "hole". A line named in the file comes before an edge of the same name.
    """
    loops = boundary_loops(mesh)
    outer = [loop for loop in loops if signed_areas(mesh.p[:, loop].T) > 0.0]
    inner = _in_order(mesh, [loop for loop in loops if signed_areas(mesh.p[:, loop].T) <= 0.0], holes)
    edges = {"outline": np.concatenate([facets_along(mesh, loop) for loop in outer])}
    edges |= _sides(mesh, [chain for loop in outer for chain in _chains(mesh, loop)])
    edges |= {f"hole {number}": facets_along(mesh, loop) for number, loop in enumerate(inner, start=1)}
    if len(inner) == 1:
        edges["hole"] = edges["hole 1"]
    edges |= {name: facets_between(mesh, pairs) for name, pairs in lines.items()}
    return {name: np.sort(facets) for name, facets in edges.items() if len(facets)}


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


def boundary_loops(mesh: Any) -> list[np.ndarray]:
    """The nodes (k + 1,) of each closed loop of the boundary, the first one again at the end, mesh on the left. Where
    two meet at a node each keeps to its own cells.

    InputError where cells overlap, so that the boundary is not made of closed lines.
    """
    rim, tree, loops = mesh.boundary_facets(), cKDTree(mesh.p.T), []
    for region in shapely.get_parts(shapely.polygonize(shapely.linestrings(mesh.p.T[mesh.facets[:, rim].T]))):
        for number, ring in enumerate(shapely.get_rings(region)):
            nodes = tree.query(shapely.get_coordinates(ring))[1]
            is_clockwise, is_hole = signed_areas(mesh.p[:, nodes].T) < 0.0, number > 0
            nodes = nodes if is_clockwise == is_hole else nodes[::-1]
            cell = mesh.f2t[0, facets_along(mesh, nodes[:2])[0]]
            if not shapely.contains_xy(region, *mesh.p[:, mesh.t[:, cell]].mean(axis=1)):
                break  # a hole
            loops.append(nodes)
    if len(lost := np.setdiff1d(rim, np.concatenate([facets_along(mesh, loop) for loop in loops]))):
        x, y = mesh.p[:, mesh.facets[0, lost[0]]]
        raise InputError(f"cells overlap at ({x:g}, {y:g}): the boundary there is no closed line")
    return loops


def facets_along(mesh: Any, nodes: np.ndarray) -> np.ndarray:
    """The facets (k - 1,) of a mesh between each of the nodes (k,) of a line and the next one."""
    return np.ravel(mesh.p2f[:, nodes[:-1]].multiply(mesh.p2f[:, nodes[1:]]).argmax(axis=0))


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


def paths(pairs: np.ndarray, points: Array) -> list[Line]:
    """Lines of nodes, each from its left end, made of pairs (m, 2) of neighbours; closed ones repeat their first."""
    tree, found = cKDTree(points), []
    for part in shapely.get_parts(shapely.line_merge(shapely.multilinestrings(points[pairs]))):
        path = tree.query(shapely.get_coordinates(part))[1]
        ends = [0, -1]
        if path[0] == path[-1]:
            path = np.roll(path[:-1], -np.lexsort(points[path[:-1]].T[::-1])[0])
            path, ends = np.append(path, path[0]), [1, -2]
        first, last = points[path[ends]].tolist()
        path = path[::-1] if last < first else path
        found.append(Line(points[path], path))
    return sorted(found, key=lambda line: (line.is_closed, *line.points[0]))


def _in_order(mesh: Any, loops: list[np.ndarray], holes: list[Array]) -> list[np.ndarray]:
    """Hole loops in the order of the polygons `holes`, or of their centres."""
    if holes and len(loops) == len(holes):
        away = [[np.linalg.norm(mesh.p[:, loop].T - hole[0], axis=1).min() for loop in loops] for hole in holes]
        return [loops[k] for k in np.argmin(away, axis=1)]
    digits = 1e-6 * float(np.ptp(mesh.p, axis=1).max())
    centres = [tuple(np.round(mesh.p[:, loop[1:]].mean(axis=1) / digits)) for loop in loops]
    return [loops[k] for k in sorted(range(len(loops)), key=centres.__getitem__)]


def _chains(mesh: Any, loop: np.ndarray) -> list[tuple[np.ndarray, Array]]:
    """The chains of an outer loop, facets (k,) and mean normal (2,) of each; see the module header."""
    facets, step = facets_along(mesh, loop), np.diff(mesh.p[:, loop].T, axis=0)
    length = np.linalg.norm(step, axis=1)
    normal = np.stack([step[:, 1], -step[:, 0]], axis=-1) / length[:, None]
    before = np.roll(normal, 1, axis=0)
    turn = np.arctan2(cross(before, normal), (before * normal).sum(axis=1))
    kind = np.where(np.abs(normal[:, 1]) < UPRIGHT, 0.0, np.sign(normal[:, 1]))
    is_corner = np.abs(turn) > CORNER
    parts: list[np.ndarray] = []
    for part in _cut(is_corner):
        chord = (normal[part] * length[part, None]).sum(axis=0)
        is_bent = (normal[part] @ chord).min() < BENT * np.linalg.norm(chord) or not is_corner.any()
        changes = kind[part] != kind[np.roll(part, 1)]
        changes[0] |= bool(is_corner.any())
        parts += [part[piece] for piece in _cut(changes)] if is_bent else [part]
    return [(facets[part], np.average(normal[part], axis=0, weights=length[part])) for part in parts]


def _cut(before: np.ndarray) -> list[np.ndarray]:
    """The places of a closed row in pieces that begin where `before` is true; the whole row if it is nowhere."""
    first = np.flatnonzero(before)
    start = first[0] if len(first) else 0
    return list(np.split(np.roll(np.arange(len(before)), -start), (first - start)[1:]))


def _sides(mesh: Any, chains: list[tuple[np.ndarray, Array]]) -> dict[str, np.ndarray]:
    """Facets of top, bottom, left and right; see the module header."""
    tiny = 1e-6 * float(np.hypot(*np.ptp(mesh.p, axis=1)))
    found: dict[str, np.ndarray] = {}
    for name, direction in DIRECTIONS.items():
        d = np.array(direction)
        extreme = (d @ mesh.p).max() - tiny
        reach = [d @ mesh.p[:, mesh.facets[:, facets].ravel()] for facets, _ in chains]
        normals = [normal for _, normal in chains]
        facing = [k for k, n in enumerate(normals) if n @ d > UPRIGHT and reach[k].max() > extreme]
        level = [k for k in facing if reach[k].min() > extreme]
        flat = [k for k in facing if normals[k] @ d > (1.0 + 1e-9) * abs(normals[k] @ d[::-1])]
        if chosen := level or flat or facing:
            found[name] = np.concatenate([chains[k][0] for k in chosen])
            chains = [chain for k, chain in enumerate(chains) if k not in chosen]
    return found
