"""Nodes where a scene needs them: at hooks, at held and loaded points, at the centres of patches smaller than cells.

The cell or side around a place without a node is cut there, so that every other side stays as it is, along the weave
where it was. Where that would make a sliver a side is bent through the place, or a node next to it is moved, inside the
mesh or along the boundary.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from scipy.spatial import cKDTree

from macro_fem.fem.cells import counterclockwise, cross
from macro_fem.scene.meshing.edges import CORNER
from rve.common import Array, InputError
from rve.common.records import Index


@dataclass(frozen=True)
class NodeOptions:
    """Numbers of nodes at places."""

    same: float = 1e-6
    """Places nearer to a node than this part of the size of the mesh have a node."""
    least_sine: float = 0.05
    """Least sine of a corner of a cell around a new or moved node, 3 degrees. Larger: more nodes are moved, which turns
    sides away from the weave, and more places refused. Smaller: cells that are too thin for the solvers' rounding."""
    touch: float = 1e-3
    """Places within this part of a boundary facet's length of it are on it, whether just inside or just outside."""
    near_bend: float = 0.25
    """Nodes of a bent boundary move along it by at most this part of a facet, which changes the shape a little."""


NODES = NodeOptions()

RIM = ""
"""The name of the line of all boundary facets; edges have longer ones."""


@dataclass(frozen=True, eq=False)
class _Sheet:
    """Points (n, 2), cells (m, 3) counterclockwise, and named `lines` of facets (k, 2), with that of the boundary.

    `node`: the one that was added or moved last; `turns`: whether this gave old sides another direction.
    """

    points: Array
    cells: np.ndarray
    lines: dict[str, np.ndarray]
    node: int = -1
    turns: bool = False

    @property
    def rim(self) -> np.ndarray:
        """The boundary facets (k, 2)."""
        return self.lines[RIM]

    @cached_property
    def sine(self) -> float:
        """The least sine of the corners of the cells around the node."""
        return float(least_sine(self.points[self.cells[np.nonzero(self.cells == self.node)[0]]]).min())

    def moved(self, node: int, place: Array) -> _Sheet:
        """The sheet with a node moved to a place."""
        points = self.points.copy()
        points[node] = place
        return replace(self, points=points, node=node, turns=True)

    def cut(self, ends: list[int], place: Array, turns: bool = False) -> _Sheet:
        """The sheet with a new node at a place of the side or cell with these ends; what has all of them is cut."""
        new = len(self.points)

        def parts(cells: np.ndarray) -> np.ndarray:
            which, count = np.unique(np.nonzero(np.isin(cells, ends))[0], return_counts=True)
            which = which[count == len(ends)]
            pieces = (np.where(cells[which] == end, new, cells[which]) for end in ends)
            return np.concatenate([np.delete(cells, which, axis=0), *pieces])

        lines = {name: parts(pairs) for name, pairs in self.lines.items()}
        return _Sheet(np.vstack([self.points, place]), parts(self.cells), lines, new, turns)


def with_nodes_at(
    mesh: Any, lines: dict[str, Index], places: Array, wheres: list[str]
) -> tuple[Any, dict[str, Index], Index]:
    """The scikit-fem mesh with a node at each of the places (k, 2), its named lines of pairs (m, 2), and these nodes
    (k,); InputError, which begins with `wheres`, if it cannot.
    """
    tiny = NODES.same * float(np.hypot(*np.ptp(mesh.p, axis=1)))
    distance, node = cKDTree(mesh.p.T).query(places)
    if distance.max(initial=0.0) < tiny:
        return mesh, lines, node
    rim = {RIM: mesh.facets[:, mesh.boundary_facets()].T}
    sheet = _Sheet(mesh.p.T, counterclockwise(mesh.p.T, mesh.t.T), lines | rim)
    kept = set(node[distance < tiny].tolist()) | _ends_of_lines(sheet)
    for k in np.flatnonzero(distance >= tiny):
        away = np.linalg.norm(sheet.points - places[k], axis=1)
        node[k] = np.argmin(away)
        if away[node[k]] >= tiny:
            sheet = _with_node(sheet, places[k], kept, f"{wheres[k]}: ", tiny)
            node[k] = sheet.node
        kept.add(int(node[k]))
    cut = type(mesh)(sheet.points.T.copy(), sheet.cells.T.copy())
    return cut, {name: sheet.lines[name] for name in lines}, node


def _ends_of_lines(sheet: _Sheet) -> set[int]:
    """Nodes of named lines that must not move: their ends, and all that lie inside the mesh."""
    kept: set[int] = set()
    for pairs in sheet.lines.values():
        nodes, counts = np.unique(pairs, return_counts=True)
        kept |= set(nodes[(counts != 2) | ~np.isin(nodes, sheet.rim)].tolist())
    return kept


def _with_node(sheet: _Sheet, place: Array, kept: set[int], where: str, tiny: float) -> _Sheet:
    """The sheet with a node at the place, and the best cells around it; InputError if there is none.

    On the boundary facets are cut, or their ends moved along it; inside corners are moved, cells and their sides cut.
    """
    points = sheet.points
    facet, is_on = _nearest_facet(sheet, place)
    cell = -1 if is_on else _cell_around(sheet, place, tiny)
    node = int(np.argmin(np.linalg.norm(points - place, axis=1)))
    (x, y), away = points[node], float(np.linalg.norm(points[node] - place))
    if is_on:
        ends = sheet.rim[facet].tolist()
        length = np.linalg.norm(np.diff(points[ends], axis=0))
        moves = [end for end in ends if end not in kept and _may_move(sheet, end, place, length)]
        found = [sheet.cut(ends, place), *(sheet.moved(end, place) for end in moves)]
    elif cell >= 0:
        corners = sheet.cells[cell].tolist()
        on_rim = set(np.unique(sheet.rim).tolist())
        found = [sheet.moved(corner, place) for corner in corners if corner not in kept | on_rim]
        found.append(sheet.cut(corners, place))
        in_lines = {frozenset(pair) for pairs in sheet.lines.values() for pair in pairs.tolist()}
        sides = zip(corners, corners[1:] + corners[:1], strict=True)
        for a, b in (side for side in sides if frozenset(side) not in in_lines):
            along = points[b] - points[a]
            off = abs(cross(along, place - points[a])) / np.linalg.norm(along)
            found.append(sheet.cut([a, b], place, bool(off > tiny)))
    else:
        raise InputError(f"{where}is {away:g} mm away from the curtain, whose nearest node is at ({x:g}, {y:g})")
    best = max(found, key=lambda one: (one.sine >= NODES.least_sine, not one.turns, one.sine))
    if best.sine < NODES.least_sine:
        raise InputError(
            f"{where}gets no node without a flat cell, the nearest one is {away:g} mm away at [{x:.12g}, {y:.12g}]; "
            f"ask for that place, or use another number of cells"
        )
    return best


def _nearest_facet(sheet: _Sheet, place: Array) -> tuple[int, bool]:
    """The boundary facet nearest to a place, and whether the place is on it: a smooth arch is no polygon."""
    sides = shapely.linestrings(sheet.points[sheet.rim])
    distance = shapely.distance(sides, shapely.Point(place))
    facet = int(np.argmin(distance))
    turns = [_turn(sheet, int(node)) for node in sheet.rim[facet]]
    bulge = max((turn for turn in turns if turn < CORNER), default=0.0) / 4.0
    return facet, bool(distance[facet] <= (NODES.touch + bulge) * shapely.length(sides[facet]))


def _turn(sheet: _Sheet, node: int) -> float:
    """By how much the boundary turns at one of its nodes, radians; pi where several pieces meet."""
    others = [pair[pair != node][0] for pair in sheet.rim[(sheet.rim == node).any(axis=1)]]
    if len(others) != 2:
        return math.pi
    one, two = sheet.points[node] - sheet.points[others[0]], sheet.points[others[1]] - sheet.points[node]
    return abs(math.atan2(float(cross(one, two)), float(one @ two)))


def _may_move(sheet: _Sheet, node: int, place: Array, length: Any) -> bool:
    """Whether a node on the boundary may move to a place on a facet of a length: where the boundary hardly turns."""
    turn, way = _turn(sheet, node), np.linalg.norm(sheet.points[node] - place)
    return turn < 1e-6 or bool(turn < CORNER and way < NODES.near_bend * length)


def _cell_around(sheet: _Sheet, place: Array, tiny: float) -> int:
    """The number of the cell that holds a place, -1 if none does."""
    corners = sheet.points[sheet.cells]
    side, to_place = np.roll(corners, -1, axis=1) - corners, place - corners
    depth = (cross(side, to_place) / np.linalg.norm(side, axis=-1)).min(axis=1)
    cell = int(np.argmax(depth))
    return cell if depth[cell] >= -tiny else -1


def least_sine(corners: Array) -> Array:
    """Least sine (n,) of the corners of counterclockwise polygons (n, k, 2), negative where one is bent in."""
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(ahead, 1, axis=1)
    lengths = np.linalg.norm(ahead, axis=-1) * np.linalg.norm(back, axis=-1)
    return np.asarray((cross(back, ahead) / np.maximum(lengths, 1e-300)).min(axis=1))
