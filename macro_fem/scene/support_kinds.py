"""Supports: what they hold of the outline before it is meshed, and how they hold the nodes of the mesh there.

A support tells `places`: single points of the outline, or a named edge as a whole. The mesher has nodes there, and
`hold` makes constraints of them.
"""

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self, cast

import numpy as np
from msgspec import Meta

from macro_fem.scene import tables
from macro_fem.scene.meshing.edges import UPRIGHT, Border, Line
from macro_fem.scene.obstacles import unit
from macro_fem.scene.tables import LEAST_MM, NO_MOVE, Time, Timed, Way, in_3d, leaves_plane
from rve.common import Array, InputError
from rve.common.records import Index
from rve.geometry import padded

NONE = np.zeros(0, np.int64)
PARALLEL = 1e-9
"""Unit vectors that differ by less than this are one direction."""


@dataclass(frozen=True, eq=False)
class Held:
    """What one support holds: `nodes` (k,), `mask` (k, d) of components and their `positions` (k, d); d = 3 at first.

    `facets` (m,): the facets of the mesh that are held as a whole; none for corners, hooks, runners and points.
    `slide` (d,): the direction, along no axis, in which all nodes slide freely from their positions; None if they do
    not. A direction along an axis is a component that is not in the mask. `track` (m, 3): points of the curve on which
    they hang, None without one. `number`: which of the supports of the scene it is of.
    """

    name: str
    nodes: Index
    mask: np.ndarray
    positions: Array
    facets: np.ndarray = field(default_factory=NONE.copy, repr=False)
    slide: Array | None = None
    track: Array | None = field(default=None, repr=False)
    number: int = 0

    @classmethod
    def nothing(cls, name: str, number: int, d: int) -> Self:
        """Of a support that has let go."""
        return cls(name, NONE, np.zeros((0, d), bool), np.zeros((0, d)), number=number)

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


@dataclass(frozen=True, kw_only=True)
class Support(Timed):
    """What holds the curtain; in motion until `release`, s, where `history` scales `move` and `drawn`.

    Base of own supports: `class Rope(Support, kind="rope")` is `kind = "rope"` of `[[support]]` in a scene file. They
    say where they hold the flat sheet by `places`, and how by `hold`, for which `held_at` does.
    """

    kinds: ClassVar[dict[str, type[Any]]] = {}
    table = "support"
    edge_needed: ClassVar[str | None] = "top"
    one: ClassVar[str] = "point"
    """What results call one of the points that it holds."""
    gather, rings_per_hook, held, capacity = 1.0, 1, "both", cast("float | None", None)
    release: Time | None = field(default=None, repr=False)

    def places(self, border: Border) -> Places:
        """Where it holds a sheet with this border, divided for a mesh, by default all of its edge.

        InputError if there is no such place.
        """
        return Places(edge=self.on_edge or "")

    def hold(self, border: Border, nodes: Index) -> Held:
        """The nodes (k,) of a mesh with this border, held in space and not yet moved; those of an edge are in order.

        InputError if it asks for what has no effect.
        """
        raise NotImplementedError

    def held_at(self, name: str, border: Border, nodes: Index, target: Array, held: str = "both") -> Held:
        """The nodes held at places `target` (k, 2) or (k, 3) in the components of `held`; InputError for others than
        "both", x and y, and some of "xyz", and for a gather that moves none of them."""
        if held != "both" and not set(held) <= set("xyz"):
            raise InputError(f"{name}: held = {held!r}: is both or some of the letters xyz")
        mask = np.tile([held == "both" or axis in held for axis in "xyz"], (len(target), 1))
        way = target[:, :2] - border.points[nodes]
        if self.gather != 1.0 and np.abs(way[mask[:, :2]]).max(initial=0.0) <= 1e-9 * border.size:
            raise InputError(f"[support] gather = {self.gather:g}: has no effect on {name}, which it holds as it is")
        return Held(name, nodes, mask, padded(target))

    def _narrowed(self, border: Border, nodes: Index) -> Array:
        """Places (k, 2) of nodes of the top edge, narrowed by `gather` about the middle of the curtain."""
        middle = 0.5 * (border.points[:, 0].min() + border.points[:, 0].max())
        share = np.array([self.gather, 1.0])
        return np.asarray([middle, 0.0] + share * (border.points[nodes] - [middle, 0.0]))


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


@dataclass(frozen=True)
class Corners(Support, kind="corners"):
    """Both ends of the top edge held; `gather` narrows their distance; `rings_per_hook` as for hooks."""

    one = "corner"

    gather: tables.Factor = 1.0
    move: Way = NO_MOVE
    rings_per_hook: tables.RingsPerHook = 1

    def places(self, border: Border) -> Places:
        return Places(border.points[border.nodes("top")[[0, -1]]])

    def hold(self, border: Border, nodes: Index) -> Held:
        return self.held_at("corners", border, nodes, self._narrowed(border, nodes))


@dataclass(frozen=True)
class Top(Support, kind="top"):
    """The whole top edge held; `gather` narrows it."""

    gather: tables.Factor = 1.0
    move: Way = NO_MOVE

    def hold(self, border: Border, nodes: Index) -> Held:
        return self.held_at("top", border, nodes, self._narrowed(border, nodes))


@dataclass(frozen=True)
class Rail(Support, kind="rail"):
    """The top edge held in height, and in space in z too, free to slide sideways."""

    def hold(self, border: Border, nodes: Index) -> Held:
        return self.held_at("rail", border, nodes, border.points[nodes], "yz")


@dataclass(frozen=True)
class Hooks(Hanging, kind="hooks"):
    """Points of the top edge, held or sliding along a rail: one at each end, evenly spaced close to `pitch` mm.

    `count`: how many there are along each line of the edge, in place of a pitch. `capacity`: the force in N that a hook
    bears; `rings_per_hook`: the rings that share this force. Results are compared with what both bear.
    """

    one = "hook"

    pitch: tables.Length | None = None
    count: tables.Count | None = None
    gather: tables.Factor = 1.0
    sliding: bool = False
    capacity: tables.Capacity | None = None
    rings_per_hook: tables.RingsPerHook = 1

    def check(self) -> None:
        if self.pitch is None and self.count is None:
            self.refuse("pitch: is missing; give it in mm, or the count of hooks")
        super().check()

    def hold(self, border: Border, nodes: Index) -> Held:
        held = "yz" if self.sliding else "both"
        return self.held_at("hooks", border, nodes, self._narrowed(border, nodes), held)


@dataclass(frozen=True)
class Edge(Support, kind="edge"):
    """A named edge held, by default in all directions, and moved by `move` mm.

    `along`: two points [x, y, z] of a straight line on which the edge lies, such as a cable, from its left or lower end
    to the other; an edge whose left end is the upper one lies in the sense of the line. With `sliding` the edge slides
    on that line, which has no end.
    """

    edge: tables.Name
    held: tables.HeldAxes = "both"
    gather: tables.Factor = 1.0
    move: Way = NO_MOVE
    along: tuple[Way, Way] | None = None
    sliding: bool = False

    def check(self) -> None:
        if self.along is None:
            if self.sliding:
                self.refuse("sliding = true: has no effect without along, the line to slide on")
            return
        first, last = map(in_3d, self.along)
        object.__setattr__(self, "along", (first, last))
        if max(abs(a - b) for a, b in zip(first, last, strict=True)) < LEAST_MM:
            self.refuse(f"along = {[first, last]}: is no line: its points are less than {LEAST_MM:g} mm apart")
        if self.gather != 1.0:
            self.refuse(f"gather = {self.gather:g}: has no effect with along, which says where the edge lies")
        if self.held != "both":
            self.refuse(f"held = {self.held!r}: has no effect with along, which holds all but what slides")

    @property
    def space_reason(self) -> str:
        if self.along and any(map(leaves_plane, self.along)):
            return f"along = {[list(point) for point in self.along]} leaves the plane"
        return super().space_reason

    def hold(self, border: Border, nodes: Index) -> Held:
        if self.along is not None:
            return self._on_line(border, *map(np.array, self.along))
        X = border.points[nodes]
        centre = 0.5 * (X.min(axis=0) + X.max(axis=0))
        return self.held_at(f"edge {self.edge}", border, nodes, centre + self.gather * (X - centre), self.held)

    def _on_line(self, border: Border, first: Array, last: Array) -> Held:
        """The edge evenly between two points (3,) of a straight line, held or free to slide."""
        line, e = _in_sense(border.line(self.edge, f"{self.where} edge"), last - first), unit(last - first)
        places = first + (line.arc / line.arc[-1])[:, None] * (last - first)
        mask = np.ones(places.shape, bool)
        if self.sliding and not sloping(e):
            mask[:, np.abs(e) > PARALLEL] = False
        return Held(f"edge {self.edge}", line.nodes, mask, places, slide=e if self.sliding and sloping(e) else None)


def _in_sense(line: Line, way: Array) -> Line:
    """An edge from its left or lower end; where these are two ends, from that which turns it least towards a way (d,),
    and if that decides nothing either from the left one, or of a steep edge the lower one."""
    x, y = line.points[-1] - line.points[0]
    x, y = (0.0 if abs(one) < UPRIGHT * abs(other) else one for one, other in ((x, y), (y, x)))
    sense = x + y if x * y >= 0.0 else float(way[:2] @ (x, y))
    if abs(sense) <= 1e-9 * abs(x * y):
        sense = x if abs(x) >= abs(y) else y
    return line if sense > 0.0 else Line(line.points[::-1], line.nodes[::-1])


def sloping(direction: Array) -> bool:
    """Whether a unit vector is along no axis."""
    return bool(np.count_nonzero(np.abs(direction) > PARALLEL) > 1)


@dataclass(frozen=True)
class Point(Support, kind="point"):
    """The material point `at` held and moved by `move` mm; `rings_per_hook` as for hooks."""

    edge_needed = None
    at: tables.Place
    held: tables.HeldAxes = "both"
    move: Way = NO_MOVE
    rings_per_hook: tables.RingsPerHook = 1

    def places(self, border: Border) -> Places:
        return Places(np.array([self.at]))

    def hold(self, border: Border, nodes: Index) -> Held:
        return self.held_at(f"point ({self.at[0]:g}, {self.at[1]:g})", border, nodes, border.points[nodes], self.held)


@dataclass(frozen=True, eq=False)
class Curve:
    """A track: a `plan` of points [x, z], or an arc of `radius` and `angle` (radians, signed) with its ends at z = 0.

    length and height (y) in mm. The arc is symmetric about x = middle; it bulges towards the viewer if angle > 0.
    """

    length: float
    height: float
    plan: Line | None = None
    radius: float = 0.0
    angle: float = 0.0
    middle: float = 0.0

    def at(self, s: Array) -> Array:
        """Places (n, 3) at the distances s (n,) from the start, measured along the track, mm.

        >>> Curve(np.pi * 100.0, 50.0, radius=100.0, angle=np.pi).at(np.array([50.0 * np.pi])).round(9).tolist()
        [[0.0, 50.0, 100.0]]
        """
        if self.plan is None:
            turn = (s / self.length - 0.5) * abs(self.angle)
            x = self.middle + self.radius * np.sin(turn)
            z = math.copysign(self.radius, self.angle) * (np.cos(turn) - math.cos(0.5 * self.angle))
        else:
            x, z = self.plan.at(s).T
        return np.stack([x, np.full(len(s), self.height), z], axis=-1)


@dataclass(frozen=True)
class Track(Hanging, kind="track"):
    """The top edge on a curve in plan at the height y = `height`, that of the top edge by default.

    The curve is `path`, a list of points [x, z], an arc of `radius` and `angle` (degrees; positive bulges towards the
    viewer), or straight and as long as `fullness` says: mesh length of the top edge over length of the track. `pitch`:
    distance of the runners along the mesh, `count`: how many there are; without both the whole edge is held. `drawn`:
    the part of the track that the curtain covers, from its `side`. `capacity` and `rings_per_hook`: of each runner.

    Between the corners of the mesh a track is straight, which keeps bounds of the curtain rigorous.
    """

    one = "runner"

    path: Annotated[tuple[tables.Place, ...], Meta(min_length=2)] | None = None
    radius: tables.Length | None = None
    angle: tables.Degrees | None = None
    height: tables.Coordinate | None = None
    fullness: tables.Factor | None = None
    pitch: tables.Length | None = None
    count: tables.Count | None = None
    drawn: tables.Share = 1.0
    side: Literal["start", "end"] = "start"
    capacity: tables.Capacity | None = None
    rings_per_hook: tables.RingsPerHook = 1

    def check(self) -> None:
        if self.path is not None:
            for key, value in (("radius", self.radius), ("angle", self.angle)):
                if value is not None:
                    self.refuse(f"{key} = {value:g}: is not used together with path")
            for one, two in pairwise(self.path):
                if one == two:
                    self.refuse(f"path: holds [{one[0]:g}, {one[1]:g}] twice in a row")
        elif self.fullness is None and (self.radius is None or self.angle is None):
            missing = "radius" if self.radius is None else "angle"
            self.refuse(f"{missing}: is missing; a track needs path, or radius and angle, or fullness")
        if self.angle == 0.0:
            self.refuse("angle = 0: makes no arc; leave it out for a straight track")
        super().check()
        for key, value in (("capacity", self.capacity), ("rings_per_hook", self.rings_per_hook)):
            if not self.has_hooks and value not in (None, 1):
                self.refuse(f"{key} = {value:g}: has no effect without pitch, that of the runners")
        if self.side == "end" and self.drawn == 1.0 and not self.history:
            self.refuse("side = 'end': has no effect with drawn = 1")

    @property
    def space_reason(self) -> str:
        return "kind = 'track' leaves the plane"

    def along(self, border: Border) -> tuple[Line, Curve]:
        """The top edge of a sheet and the track above it."""
        edge = border.line("top", f"{self.where} needs edge")
        return edge, self.curve(edge, self.where)

    def hold(self, border: Border, nodes: Index) -> Held:
        edge, curve = self.along(border)
        length, s = edge.arc[-1], edge.arc
        if self.has_hooks:
            s = np.linspace(0.0, length, len(nodes))
        # Points of a track in pictures.
        places, drawn = self.on_track(curve, s, length), curve.at(np.linspace(0.0, curve.length, 200))
        return Held("track", nodes if self.has_hooks else edge.nodes, np.ones(places.shape, bool), places, track=drawn)

    def on_track(self, curve: Curve, s: Array, edge_length: float) -> Array:
        """Places (n, 3) on the track of material points at the distances s (n,) along the top edge, mm."""
        covered = self.drawn * curve.length
        start = 0.0 if self.side == "start" else curve.length - covered
        return curve.at(start + covered * s / edge_length)

    def curve(self, edge: Line, where: str) -> Curve:
        """The track for this top edge, as high as its highest point and about the middle of its x where that is open.

        The length follows from `path`, or from `radius` and `angle`; what these leave open, from `fullness`.
        InputError, which begins with `where`, if they contradict each other.
        """
        edge_length, (x, y) = edge.arc[-1], edge.points.T
        middle = 0.5 * float(x.min() + x.max())
        height = float(y.max()) if self.height is None else self.height
        wanted = math.nan if self.fullness is None else edge_length / self.fullness
        radius, angle = self.radius, None if self.angle is None else math.radians(self.angle)
        if self.path is not None:
            plan = Line(np.array(self.path))
            curve = Curve(plan.arc[-1], height, plan)
        elif radius is None and angle is None:
            ends = np.array([[middle - 0.5 * wanted, 0.0], [middle + 0.5 * wanted, 0.0]])
            curve = Curve(wanted, height, Line(ends))
        else:
            if radius is None:
                radius = wanted / abs(angle or 1.0)
            if angle is None:
                angle = wanted / radius
            if abs(angle) > 2.0 * math.pi:
                raise InputError(
                    f"{where} radius = {radius:g}: a track of {wanted:g} mm, which fullness = {self.fullness:g} asks "
                    f"for, is longer than the whole circle of {2.0 * math.pi * radius:g} mm; use a larger one of both"
                )
            curve = Curve(radius * abs(angle), height, None, radius, angle, middle)
        # A fullness that is given besides a track of known length may differ from theirs by this part of it.
        if abs(wanted / curve.length - 1.0) > 0.01:
            raise InputError(
                f"{where} fullness = {self.fullness:g}: contradicts a track of {curve.length:g} mm and a top edge of "
                f"{edge_length:g} mm, which make {edge_length / curve.length:.4g}; give one of them less"
            )
        return curve
