"""Nodes where a scene needs them: at hooks, at held and loaded points, at the centres of patches smaller than cells.

A mesh is cut where a node is missing: the cell or side around the place is divided there, so that every other side
stays as it is, along the weave where it was, and whatever the old mesh could do the new one can. Where that would make
a sliver a side is bent through the place, or a node next to it is moved, inside the mesh or along the boundary. What
would need cells with corners of less than some 3 degrees is refused.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from macro_fem.fem.cells import counterclockwise, cross
from macro_fem.scene.meshing.edges import CORNER, paths
from macro_fem.scene.tables import Support
from rve.common.errors import InputError
from rve.common.types import Array

SAME = 1e-9
"""Places nearer to a node than this part of the size of the mesh have a node."""
LEAST_SINE = 0.05
"""Least sine of a corner of a cell around a new or moved node, 3 degrees. Larger: more nodes are moved, which turns
sides away from the weave, and more places refused. Smaller: cells that are too thin for the solvers' rounding."""
TOUCH = 1e-3
"""Places within this part of a boundary facet's length of it are on it, whether just inside or just outside."""
NEAR_BEND = 0.25
"""Nodes of a bent boundary move along it by at most this part of a facet, which changes the shape a little."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """Points (n, 2), cells (m, 3 or 4) counterclockwise, boundary facets `rim` (k, 2), and named `lines` of facets."""

    points: Array
    cells: np.ndarray
    rim: np.ndarray
    lines: dict[str, np.ndarray]

    @property
    def size(self) -> float:
        """Diagonal of the bounding box, mm."""
        return float(np.hypot(*np.ptp(self.points, axis=0)))


@dataclass(frozen=True, eq=False)
class _Change:
    """A node at `place` (a new one, or an old one moved) with cells `removed` (k,) and `added` (j, 3 or 4) for it.

    `edge`: the side that is cut. `sine`: the least one of the corners of the added cells. `turns`: whether old sides
    get another direction, as a side does that is bent and all sides at a node that moves.
    """

    node: int
    place: Array
    removed: np.ndarray
    added: np.ndarray
    edge: tuple[int, int] | None
    sine: float
    turns: bool = False


def make_sheet(points: Array, cells: np.ndarray, lines: dict[str, np.ndarray] | None = None) -> Sheet:
    """A sheet of cells in either sense."""
    cells = counterclockwise(points, cells)
    pairs = np.stack([cells, np.roll(cells, -1, axis=1)], axis=-1).reshape(-1, 2)
    key = pairs.min(axis=1).astype(np.int64) * len(points) + pairs.max(axis=1)
    _, first, counts = np.unique(key, return_index=True, return_counts=True)
    return Sheet(points, cells, pairs[first[counts == 1]], lines or {})


@dataclass(frozen=True, eq=False)
class HookRow:
    """The hooks of one support: reference `places` (k, 2), the `pitch` that fits the edge, mm, and their nodes (k,)."""

    places: Array
    pitch: float
    nodes: np.ndarray


def hook_places(points: Array, pairs: np.ndarray, item: Support, where: str) -> HookRow:
    """Hooks on an edge of facets `pairs` (m, 2): evenly spaced along each of its lines, with one at each end.

    The spacing is the one nearest to the pitch that fits; that of the longest line is told. InputError if the pitch is
    longer than the edge, or finer than its facets.
    """
    found, fitted = [], []
    pitch, count = getattr(item, "pitch", None), getattr(item, "count", None)
    named = f"{where} count = {count}:" if pitch is None else f"{where} pitch = {pitch:g}:"
    for path in paths(map(tuple, pairs), points):
        line = points[path]
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        length, is_closed = float(arc[-1]), path[0] == path[-1]
        if pitch is not None and pitch > length * (1.0 + 1e-9):
            raise InputError(f"{named} is wider than the top edge, {length:g} mm")
        number = item.spaces(length) + (1 if is_closed and count is not None else 0)
        if number > len(path) - 1:
            raise InputError(
                f"{named} is finer than the mesh, whose nodes on the top edge are "
                f"{length / (len(path) - 1):g} mm apart; use more cells"
            )
        fitted.append((length, length / number))
        at = np.linspace(0.0, length, number + 1)[: number if is_closed else None]
        found.append(np.stack([np.interp(at, arc, line[:, 0]), np.interp(at, arc, line[:, 1])], axis=-1))
    return HookRow(np.concatenate(found), max(fitted)[1], np.zeros(0, np.int64))


def with_nodes_at(sheet: Sheet, places: Array, wheres: list[str]) -> tuple[Sheet, np.ndarray]:
    """The sheet with a node at each of the places (k, 2), and these nodes (k,); InputError, which begins with
    `wheres`, if it cannot."""
    tiny = SAME * sheet.size
    distance, node = cKDTree(sheet.points).query(places)
    kept = set(node[distance < tiny].tolist()) | _ends_of_lines(sheet)
    for k in np.flatnonzero(distance >= tiny):
        away = np.linalg.norm(sheet.points - places[k], axis=1)
        nearest = int(np.argmin(away))
        if away[nearest] >= tiny:
            change = _best_change(sheet, places[k], kept, f"{wheres[k]}: ")
            sheet, nearest = _applied(sheet, change), change.node
        kept.add(nearest)
        node[k] = nearest
    return sheet, node


def through(lines: Array, places: Array) -> Array:
    """Ascending grid `lines` (n,) with the inner line nearest to each place moved to it, or a new line if it is taken.

    >>> through(np.array([0.0, 10.0, 20.0, 30.0]), np.array([12.0, 13.0, 30.0])).tolist()
    [0.0, 12.0, 13.0, 20.0, 30.0]
    """
    tiny = SAME * float(lines[-1] - lines[0])
    wanted = [x for x in np.unique(places) if lines[0] < x < lines[-1] and np.abs(lines - x).min() > tiny]
    taken = np.isin(np.arange(len(lines)), [0, len(lines) - 1])
    for x in places:
        taken |= np.abs(lines - x) <= tiny
    for x in wanted:
        nearest = int(np.argmin(np.abs(lines - x)))
        if taken[nearest]:
            after = int(np.searchsorted(lines, x))
            lines, taken = np.insert(lines, after, x), np.insert(taken, after, True)
        else:
            lines, taken = lines.copy(), taken.copy()
            lines[nearest], taken[nearest] = x, True
    return lines


def _ends_of_lines(sheet: Sheet) -> set[int]:
    """Nodes of named lines that must not move: their ends, and all that lie inside the mesh."""
    rim = np.unique(sheet.rim)
    kept: set[int] = set()
    for pairs in sheet.lines.values():
        nodes, counts = np.unique(pairs, return_counts=True)
        kept |= set(nodes[(counts != 2) | ~np.isin(nodes, rim)].tolist())
    return kept


def _best_change(sheet: Sheet, place: Array, kept: set[int], where: str) -> _Change:
    """The change that gives the place a node with the best cells; InputError if there is none."""
    facet, is_on = _nearest_facet(sheet, place)
    cell = -1 if is_on else _cell_around(sheet, place)
    node = int(np.argmin(np.linalg.norm(sheet.points - place, axis=1)))
    x, y = sheet.points[node]
    away = float(np.linalg.norm(sheet.points[node] - place))
    if not is_on and cell < 0:
        raise InputError(f"{where}is {away:g} mm away from the curtain, whose nearest node is at ({x:g}, {y:g})")
    changes = _on_boundary(sheet, place, sheet.rim[facet], kept) if is_on else _inside(sheet, place, cell, kept)
    sound = [change for change in changes if change.sine >= LEAST_SINE]
    if not sound:
        raise InputError(
            f"{where}gets no node without a flat cell, the nearest one is {away:g} mm away at ({x:g}, {y:g}); ask for "
            f"that place, or use another number of cells or triangles"
        )
    return max(sound, key=lambda change: (not change.turns, change.sine))


def _nearest_facet(sheet: Sheet, place: Array) -> tuple[int, bool]:
    """The boundary facet nearest to a place, and whether the place is on it: a smooth arch is no polygon."""
    a, b = sheet.points[sheet.rim[:, 0]], sheet.points[sheet.rim[:, 1]]
    along, length = b - a, np.linalg.norm(b - a, axis=1)
    s = np.clip(((place - a) * along).sum(axis=1) / length**2, 0.0, 1.0)
    distance = np.linalg.norm(place - a - s[:, None] * along, axis=1)
    facet = int(np.argmin(distance))
    turns = [_turn(sheet, int(node)) for node in sheet.rim[facet]]
    bulge = max((turn for turn in turns if turn < CORNER), default=0.0) / 4.0
    return facet, bool(distance[facet] <= (TOUCH + bulge) * length[facet])


def _turn(sheet: Sheet, node: int) -> float:
    """By how much the boundary turns at one of its nodes, radians; pi where several pieces meet."""
    others = [pair[pair != node][0] for pair in sheet.rim[(sheet.rim == node).any(axis=1)]]
    if len(others) != 2:
        return math.pi
    one, two = sheet.points[node] - sheet.points[others[0]], sheet.points[others[1]] - sheet.points[node]
    return abs(math.atan2(float(cross(one, two)), float(one @ two)))


def _cell_around(sheet: Sheet, place: Array) -> int:
    """The number of the cell that holds a place, -1 if none does."""
    corners = sheet.points[sheet.cells]
    side, to_place = np.roll(corners, -1, axis=1) - corners, place - corners
    depth = (cross(side, to_place) / np.linalg.norm(side, axis=-1)).min(axis=1)
    cell = int(np.argmax(depth))
    return cell if depth[cell] >= -SAME * sheet.size else -1


def _on_boundary(sheet: Sheet, place: Array, facet: np.ndarray, kept: set[int]) -> list[_Change]:
    """A cut of the facet, and moves of its ends along the boundary."""
    a, b = int(facet[0]), int(facet[1])
    changes = [_cut_edge(sheet, place, a, b)]
    length = float(np.linalg.norm(sheet.points[b] - sheet.points[a]))
    for node in (a, b):
        turn, way = _turn(sheet, node), float(np.linalg.norm(sheet.points[node] - place))
        if node not in kept and (turn < 1e-6 or (turn < CORNER and way < NEAR_BEND * length)):
            changes.append(_moved(sheet, place, node))
    return [change for change in changes if change is not None]


def _inside(sheet: Sheet, place: Array, cell: int, kept: set[int]) -> list[_Change]:
    """A cut of the cell, of each of its sides, and moves of its corners."""
    corners = [int(node) for node in sheet.cells[cell]]
    rim, sides = set(np.unique(sheet.rim).tolist()), list(zip(corners, corners[1:] + corners[:1], strict=True))
    changes: list[_Change | None] = [_moved(sheet, place, node) for node in corners if node not in kept | rim]
    if len(corners) == 3:
        added = np.array([[a, b, len(sheet.points)] for a, b in sides])
        changes.append(_change(sheet, place, len(sheet.points), np.array([cell]), added))
        in_lines = {frozenset(pair) for pairs in sheet.lines.values() for pair in pairs.tolist()}
        changes += [_bent_edge(sheet, place, a, b) for a, b in sides if frozenset((a, b)) not in in_lines]
    return [change for change in changes if change is not None]


def _moved(sheet: Sheet, place: Array, node: int) -> _Change:
    star = np.flatnonzero((sheet.cells == node).any(axis=1))
    change = _change(sheet, place, node, star, sheet.cells[star])
    return replace(change, turns=True)


def _cut_edge(sheet: Sheet, place: Array, a: int, b: int) -> _Change | None:
    """The side from a to b cut at a place; None for quadrilaterals, which would need a node on a side."""
    if sheet.cells.shape[1] != 3:
        return None
    beside = np.flatnonzero(((sheet.cells == a) | (sheet.cells == b)).sum(axis=1) == 2)
    new = len(sheet.points)
    added = np.concatenate([np.where(sheet.cells[beside] == old, new, sheet.cells[beside]) for old in (a, b)])
    return _change(sheet, place, new, beside, added, (a, b))


def _bent_edge(sheet: Sheet, place: Array, a: int, b: int) -> _Change | None:
    """The side from a to b inside the mesh cut, and bent where the place is not quite on it."""
    along, to_place = sheet.points[b] - sheet.points[a], place - sheet.points[a]
    off = abs(float(cross(along, to_place))) / float(np.linalg.norm(along))
    change = _cut_edge(sheet, place, a, b)
    return None if change is None else replace(change, turns=off > SAME * sheet.size)


def _change(
    sheet: Sheet, place: Array, node: int, removed: np.ndarray, added: np.ndarray, edge: tuple[int, int] | None = None
) -> _Change:
    corners = np.where((added == node)[..., None], place, sheet.points[np.minimum(added, len(sheet.points) - 1)])
    return _Change(node, place, removed, added, edge, float(least_sine(corners).min(initial=1.0)))


def least_sine(corners: Array) -> Array:
    """Least sine (n,) of the corners of counterclockwise polygons (n, k, 2), negative where one is bent in."""
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(ahead, 1, axis=1)
    lengths = np.linalg.norm(ahead, axis=-1) * np.linalg.norm(back, axis=-1)
    return np.asarray((cross(back, ahead) / np.maximum(lengths, 1e-300)).min(axis=1))


def _applied(sheet: Sheet, change: _Change) -> Sheet:
    """The sheet after a change."""
    is_new = change.node == len(sheet.points)
    points = np.concatenate([sheet.points, change.place[None]]) if is_new else sheet.points.copy()
    points[change.node] = change.place
    cells = np.concatenate([np.delete(sheet.cells, change.removed, axis=0), change.added])
    if change.edge is None:
        return replace(sheet, points=points, cells=cells)
    lines = {name: _with_cut(pairs, change.edge, change.node) for name, pairs in sheet.lines.items()}
    return Sheet(points, cells, _with_cut(sheet.rim, change.edge, change.node), lines)


def _with_cut(pairs: np.ndarray, edge: tuple[int, int], node: int) -> np.ndarray:
    """Pairs of nodes (k, 2) with the pair `edge` replaced by its two halves."""
    is_edge = (np.sort(pairs, axis=1) == sorted(edge)).all(axis=1)
    halves = [[a, node, node, b] for a, b in pairs[is_edge].tolist()]
    return np.concatenate([pairs[~is_edge], np.array(list(itertools.chain(*halves)), dtype=pairs.dtype).reshape(-1, 2)])
