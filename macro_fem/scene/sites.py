"""Supports: what they hold of the outline, before it is meshed, and the nodes of the mesh there, held or free to slide.

A support tells `places`: single points of the outline, or a named edge as a whole. The mesher has nodes there, and
`hold` makes constraints of them. A node that slides on a line along the unit vector e is at x = x_held + e s with one
unknown s: a column of T. On a line along an axis the component is simply free, and needs no column. A node on two lines
that cross, or on a line and held as a whole by another support, is held.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from macro_fem.fem.cells import in_space_of
from macro_fem.scene.meshing.edges import Border
from macro_fem.scene.tables import NO_MOVE, Time, Timed, Vector, in_3d
from rve.common import Array, InputError
from rve.common.records import Index

NONE = np.zeros(0, np.int64)
PARALLEL = 1e-9
"""Unit vectors that differ by less than this are one direction."""


@dataclass(frozen=True, eq=False)
class Sliding:
    """SupportNodes (m,) that slide along unit vectors `direction` (m, d)."""

    nodes: Index
    direction: Array

    @classmethod
    def none(cls, d: int) -> Self:
        """No node."""
        return cls(NONE, np.zeros((0, d)))

    def along(self, force: Array) -> Array:
        """The components (m,) of nodal forces (n_nodes, d) along the directions."""
        return np.asarray((force[self.nodes] * self.direction).sum(axis=1))


@dataclass(frozen=True, eq=False)
class Held:
    """What one support holds: `nodes` (k,), `mask` (k, d) of components and their `positions` (k, d).

    `facets` (m,): the facets of the mesh that are held as a whole; none for corners, hooks, runners and points.
    `slide` (d,): the direction, along no axis, in which all nodes slide freely from their positions; None if they do
    not. A direction along an axis is a component that is not in the mask. `track` (m, 3): points of the curve on which
    they hang, None without one.
    """

    name: str
    nodes: Index
    mask: np.ndarray
    positions: Array
    facets: np.ndarray = field(default_factory=NONE.copy, repr=False)
    slide: Array | None = None
    track: Array | None = field(default=None, repr=False)

    def components(self, shape: tuple[int, ...]) -> np.ndarray:
        """Whether it holds each component of all nodes, of this shape (n_nodes, d)."""
        held = np.zeros(shape, bool)
        held[self.nodes] = self.mask
        return held


class Places(NamedTuple):
    """Where a support holds an outline: single `points` (k, 2), or the named `edge` as a whole.

    Of hooks: the longest line of the edge and the longest pitch, mm. `nodes` (k,): those of a mesh at the points.
    """

    points: Array = np.zeros((0, 2))
    edge: str = ""
    length: float = 0.0
    pitch: float = 0.0
    nodes: Index = NONE


@dataclass(frozen=True, eq=False)
class SupportNodes:
    """The nodes `number` (k,) of a mesh at the places of a support, those of an edge in order; `border`: of the mesh.

    d: components of places; factor: of the support's move.
    """

    number: Index
    border: Border
    d: int
    factor: float

    @property
    def X(self) -> Array:
        """Their reference places (k, 2)."""
        return self.border.points[self.number]

    def moved(self, places: Array, move: Vector) -> Array:
        """Places (k, 2 or d) with all components (k, d), after the factor of a move."""
        return np.asarray(in_space_of(places, self.d) + self.factor * np.array(in_3d(move)[: self.d]))


@dataclass(frozen=True, kw_only=True)
class Support(Timed):
    """What holds the curtain; in motion until `release`, s, where `history` scales `move` and `drawn`."""

    kinds: ClassVar[dict[str, type[Any]]] = {}
    table = "support"
    edge_needed: ClassVar[str | None] = "top"
    one: ClassVar[str] = "point"
    """What results call one of the points that it holds."""
    release: Time | None = field(default=None, repr=False)

    def places(self, border: Border) -> Places:
        """Where it holds a sheet with this border, divided for a mesh, by default all of its edge.

        InputError if there is no such place.
        """
        return Places(edge=getattr(self, "edge", self.edge_needed) or "")

    def hold(self, nodes: SupportNodes) -> Held:
        """The components and positions of the nodes that it holds; InputError if it asks for what has no effect."""
        raise NotImplementedError

    def _held(self, name: str, nodes: SupportNodes, target: Array, held: str = "both") -> Held:
        """The nodes held at places `target` (k, 2), moved; InputError for a gather that moves none of them."""
        gather = getattr(self, "gather", 1.0)
        mask = np.tile([held == "both" or axis in held for axis in "xyz"[: nodes.d]], (len(target), 1))
        if gather != 1.0 and np.abs((target - nodes.X)[mask[:, :2]]).max(initial=0.0) <= 1e-9 * nodes.border.size:
            raise InputError(f"[support] gather = {gather:g}: has no effect on {name}, which it holds as it is")
        return Held(name, nodes.number, mask, nodes.moved(target, getattr(self, "move", NO_MOVE)))

    def _narrowed(self, nodes: SupportNodes) -> Array:
        """Places (k, 2) of nodes of the top edge, narrowed by `gather` about the middle of the curtain."""
        middle = nodes.border.middle
        return np.stack([middle + getattr(self, "gather", 1.0) * (nodes.X[:, 0] - middle), nodes.X[:, 1]], axis=-1)


class Hanging(Support):
    """A support that may hold single points of the top edge, evenly spaced by its `pitch` or `count`."""

    pitch: float | None
    count: int | None

    def check(self) -> None:
        if self.pitch is not None and self.count is not None:
            self.refuse(f"count = {self.count}: is not used together with pitch")

    @property
    def has_hooks(self) -> bool:
        """Whether it holds single points."""
        return self.pitch is not None or self.count is not None

    def spaces(self, length: float) -> int:
        """How many spaces between hooks fit an open line of this length, mm: the number nearest to `pitch`."""
        if self.count is not None:
            return self.count - 1
        assert self.pitch is not None
        return round(min(length / self.pitch, 1e9))

    def places(self, border: Border) -> Places:
        """Hooks, even from end to end of the lines of the top edge, or without them the whole edge.

        InputError for a pitch that is longer than the edge, or finer than its facets.
        """
        if not self.has_hooks:
            return super().places(border)
        points, longest = [], (0.0, 0.0)
        named = f"{self.where} count = {self.count}:" if self.pitch is None else f"{self.where} pitch = {self.pitch:g}:"
        for line in border.lines("top"):
            length, sides = float(line.arc[-1]), len(line.arc) - 1
            if self.pitch is not None and self.pitch > length * (1.0 + 1e-9):
                raise InputError(f"{named} is wider than the top edge, {length:g} mm")
            number = self.spaces(length) + (1 if line.is_closed and self.count is not None else 0)
            if number > sides:
                raise InputError(
                    f"{named} is finer than the mesh, whose nodes on the top edge are {length / sides:g} mm apart; "
                    "use more cells"
                )
            longest = max(longest[0], length), max(longest[1], length / number)
            points.append(line.at(np.linspace(0.0, length, number + 1)[: number if line.is_closed else None]))
        return Places(np.concatenate(points), "", *longest)


def sliding_nodes(lines: list[tuple[Index, Array]], whole: np.ndarray, d: int) -> Sliding:
    """The nodes of lines (nodes (k,), unit vector (d,)), but those on two that cross and those held as a `whole`."""
    way = np.zeros((len(whole), d))
    fixed = whole.copy()
    for nodes, e in lines:
        before = way[nodes]
        fixed[nodes] |= before.any(axis=1) & (np.abs(before @ e) < 1.0 - PARALLEL)
        way[nodes] = e
    free = np.flatnonzero(way.any(axis=1) & ~fixed)
    return Sliding(free, way[free])


def sloping(direction: Array) -> bool:
    """Whether a unit vector is along no axis."""
    return bool(np.count_nonzero(np.abs(direction) > PARALLEL) > 1)
