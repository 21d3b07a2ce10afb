"""What a scene is made of: nouns whose fields are the keys of a scene file, each with its range.

Lengths are mm, forces N, line loads N/mm, pressures N/m2, masses kg and kg/m2, angles degrees. x points right, y up, z
towards the viewer; a rectangle spans from (0, 0) to (width, height), a disk is centred at (0, 0). Vectors have two or
three components and are kept as given; a third one that is not 0 takes the curtain into space.
"""

import datetime
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from rve.common import Array, Typed
from rve.common.plugins import register

LEAST_MM, MOST_MM = 1e-6, 1e9
"""Range of lengths and coordinates, in which squares and ratios stay finite."""

Length = Annotated[float, Meta(ge=LEAST_MM, le=MOST_MM, title="mm")]
Coordinate = Annotated[float, Meta(ge=-MOST_MM, le=MOST_MM, title="mm")]
Force = Annotated[float, Meta(ge=-1e12, le=1e12, title="N")]
LineForce = Annotated[float, Meta(ge=-1e12, le=1e12, title="N/mm")]
Capacity = Annotated[float, Meta(gt=0.0, le=1e12, title="N")]
Factor = Annotated[float, Meta(gt=0.0, le=1e6)]
Share = Annotated[float, Meta(gt=0.0, le=1.0)]
Degrees = Annotated[float, Meta(ge=-360.0, le=360.0, title="degrees")]
Acceleration = Annotated[float, Meta(ge=-1e3, le=1e3, title="m/s2")]
Name = Annotated[str, Meta(min_length=1, max_length=80)]
Time = Annotated[float, Meta(ge=0.0, le=1e6, title="s")]
Mass = Annotated[float, Meta(ge=0.0, le=1e9, title="kg")]
History = Annotated[tuple[tuple[Time, Annotated[float, Meta(ge=-1e6, le=1e6)]], ...], Meta(max_length=10_000)]
"""Pairs of time, s, and share, for scenes in motion (`macro_fem.scene.moving`)."""
Place = tuple[Coordinate, Coordinate]
Point3 = tuple[Coordinate, Coordinate, Coordinate]
Vector = tuple[float, ...]
"""Two or three components."""
Way = Annotated[tuple[Coordinate, ...], Meta(min_length=2, max_length=3)]
Direction = Annotated[tuple[Annotated[float, Meta(ge=-MOST_MM, le=MOST_MM)], ...], Meta(min_length=2, max_length=3)]
Forces = Annotated[tuple[Force, ...], Meta(min_length=2, max_length=3)]
Polygon = Annotated[tuple[Place, ...], Meta(min_length=3)]
RingsPerHook = Annotated[int, Meta(ge=1, le=1_000)]
Count = Annotated[int, Meta(ge=2, le=20_000)]
HeldAxes = Literal["both", "x", "y", "z", "xy", "xz", "yz"]
"""What a support may hold: all components, or those named."""
NO_MOVE: Vector = (0.0, 0.0)


def in_3d(v: Vector) -> tuple[float, float, float]:
    """A vector of two or three components with the third one, 0 where it is not given.

    >>> in_3d((1.0, 2.0))
    (1.0, 2.0, 0.0)
    """
    x, y, *z = v
    return x, y, z[0] if z else 0.0


def check_directions(record: Typed, **vectors: Vector) -> None:
    """Refuse vectors of a record whose components are all 0."""
    for key, vector in vectors.items():
        if not any(vector):
            record.refuse(f"{key} = {list(vector)}: has no direction: one component must not be 0")


def leaves_plane(v: Vector) -> bool:
    """Whether a vector has a third component that is not 0."""
    return in_3d(v)[2] != 0.0


class Entry(Typed):
    """A record of a scene file whose class files name by a word."""

    kinds: ClassVar[dict[str, type[Any]]]
    """The classes of a list or table by what files call them."""
    kind: ClassVar[str]

    def __init_subclass__(cls, kind: str = "") -> None:
        """Make the kind known to scene files."""
        super().__init_subclass__()
        if kind:
            cls.kind = kind
            register(cls.kinds, kind, cls)


class Item(Entry):
    """Something that holds, loads or meets the curtain, an entry of one of the lists of a scene file."""

    table: ClassVar[str]
    """The list of a scene file that holds such entries."""
    edge_needed: ClassVar[str | None] = None
    """The named edge of the curtain that it needs, if it has no `edge` of its own."""
    move: Vector = NO_MOVE
    history: History = ()
    release: float | None = None

    @property
    def on_edge(self) -> str | None:
        """The named edge of the curtain that it needs."""
        return vars(self).get("edge", self.edge_needed)

    @property
    def where(self) -> str:
        """The entry in messages."""
        return f"[{self.table}] ({self.kind})"

    @property
    def space_reason(self) -> str:
        """Why the entry takes the curtain into space; "" if it does not."""
        for key in ("move", "force", "direction"):
            if leaves_plane(way := vars(self).get(key, NO_MOVE)):
                return f"{key} = {list(way)} leaves the plane"
        return ""


@dataclass(frozen=True, kw_only=True)
class Timed(Item):
    """An entry that `history` scales in scenes in motion: pairs of time and share (`macro_fem.scene.moving`)."""

    history: History = field(default=(), repr=False)


class Load(Timed):
    """Base of loads besides the weight of the mesh: `class Snow(Load, kind="snow")` is `[load.snow]` in a scene file.

    Own ones say a force by `per_area`, or by `per_length` with a field `edge`. It is proportional to those of its
    fields that are called force, pressure or mass, which load combinations and a `history` scale.
    `Load(gravity=..., steps=...)` itself is a `Loading`.
    """

    kinds: ClassVar[dict[str, type[Any]]] = {}
    table = property(lambda self: f"load.{self.kind}")
    where = property(lambda self: f"[{self.table}]")

    def __new__(cls, *args: Any, **kwargs: Any) -> Any:
        """A load, or the table [load] if none of its kinds is asked for."""
        return super().__new__(cls) if cls is not Load else Loading(*args, **kwargs)

    def per_area(self, X: Array) -> Array:
        """Force per reference area (n, 2) or (n, 3), N/mm2, at points X (n, 2) of the flat sheet, mm."""
        raise NotImplementedError

    def per_length(self, X: Array) -> Array:
        """Force per reference length of its `edge` (n, 2) or (n, 3), N/mm, at points X (n, 2) of the flat sheet, mm."""
        raise NotImplementedError


@dataclass(frozen=True)
class EdgeLoad(Load, kind="edge"):
    """Force per reference length of a named edge, N/mm."""

    edge: Name
    force: Annotated[tuple[LineForce, ...], Meta(min_length=2, max_length=3)]


@dataclass(frozen=True)
class PointLoad(Load, kind="point"):
    """Force in N on the material point `at`; `rings_per_hook`: the rings that share it."""

    at: Place
    force: Forces
    rings_per_hook: RingsPerHook = 1


@dataclass(frozen=True)
class PatchLoad(Load, kind="patch"):
    """Force in N, distributed evenly over the reference disk of `radius` around `at`."""

    at: Place
    radius: Length
    force: Forces


@dataclass(frozen=True)
class Bar(Load, kind="bar"):
    """A bar of `mass` kg along a named edge. A straight one keeps the edge on a line whose length is free to shrink."""

    mass: Mass
    edge: Name = "bottom"
    straight: bool = True


@dataclass(frozen=True)
class Wind(Load, kind="wind"):
    """A load of `pressure` N/m2 of reference area along `direction`, whose length does not matter.

    Instead of the pressure: `speed` in m/s, with `air_density` in kg/m3 (1.25 by default); its drag is that of the
    layers of the law's rings on the present front (`macro_fem.scene.loads`). With `follows` a pressure is per present
    area, normal to the present surface, on the side where it first blows, and that of a speed is from the component of
    the speed along the normal.
    """

    direction: Direction
    pressure: Annotated[float, Meta(ge=-1e9, le=1e9, title="N/m2")] | None = None
    speed: Annotated[float, Meta(ge=0.0, le=1e3, title="m/s")] | None = None
    air_density: Annotated[float, Meta(gt=0.0, le=1e4, title="kg/m3")] | None = None
    follows: bool = False

    def check(self) -> None:
        check_directions(self, direction=self.direction)
        if self.pressure is None and self.speed is None:
            self.refuse("pressure: is missing; give it in N/m2, or speed in m/s")
        for key, value in (("speed", self.speed), ("air_density", self.air_density)):
            if self.pressure is not None and value is not None:
                self.refuse(f"{key} = {value:g}: is not used together with pressure")

    @property
    def space_reason(self) -> str:
        follows = "follows = true: pressure is normal to the surface" if self.follows else ""
        return super().space_reason or follows

    @property
    def is_shaped(self) -> bool:
        """Whether its force depends on the present shape."""
        return self.follows or self.speed is not None


FACTORED = ("force", "pressure", "mass")
"""Fields of loads that load combinations scale."""
PartialFactor = Annotated[float, Meta(ge=0.0, le=1e3)]


@dataclass(frozen=True)
class Combination(Typed):
    """Partial factors on the loads of a scene: on the weight of the mesh, and on all loads of a kind.

    Each combination is solved besides the loads as they are; a factor that is not given is 1.
    """

    name: Name
    weight: PartialFactor = 1.0
    bar: PartialFactor = 1.0
    wind: PartialFactor = 1.0
    edge: PartialFactor = 1.0
    point: PartialFactor = 1.0
    patch: PartialFactor = 1.0
    own: tuple[tuple[str, PartialFactor], ...] = ()
    """Of loads of plugins, by their kinds; in a file they are keys as the others."""

    def factor(self, kind: str) -> float:
        """The factor on loads of a kind."""
        return float(vars(self).get(kind, dict(self.own).get(kind, 1.0)))


Words = Annotated[str, Meta(max_length=200)]


@dataclass(frozen=True)
class Project(Typed):
    """What a report is headed by; a date of TOML is kept as its text, "2026-11-28"."""

    title: Words = ""
    client: Words = ""
    author: Words = ""
    number: Words = ""
    date: Words = ""

    def __post_init__(self) -> None:
        """A date becomes a text, then every field is checked."""
        if isinstance(self.date, datetime.date):
            object.__setattr__(self, "date", self.date.isoformat())
        super().__post_init__()


@dataclass(frozen=True)
class Loading(Typed):
    """The table [load]: weight, and how live loads grow; `steps` applies live loads and moves in equal steps.

    `gravity` in m/s2: a number is downwards, a vector [x, y] or [x, y, z] has the direction of the weight.
    """

    gravity: Acceleration | Annotated[tuple[Acceleration, ...], Meta(min_length=2, max_length=3)] = 9.81
    steps: Annotated[int, Meta(ge=1, le=1000)] = 1

    @property
    def acceleration(self) -> Vector:
        """Gravity as a vector of three components, m/s2."""
        return in_3d(self.gravity) if isinstance(self.gravity, tuple) else (0.0, -self.gravity, 0.0)


@dataclass(frozen=True)
class Solver(Typed):
    """`kind`: "rigid" is ideal locking, "elastic" the elastic law; "auto" is rigid, with forces of elastic rings where
    rigid ones leave them open (`macro_fem.curtain`); "plastic" is ideal locking with rings that flow where they
    collapse, with `strings` until they are drawn to strings, which stretch no more, or as their wire if "elastic".

    `tolerance` is relative to the problem's energy scale, total load times size. `stabilising_tension` adds an even
    tension of this part of (total load / size) everywhere, which decides the shape of slack parts. The bounds in the
    summary allow for it, 0 switches it off. `bounds` asks for bounds of the continuous curtain, `adapt` for this number
    of refinements where the bounds differ. `space` gives a plane scene the third coordinate that it does not need.
    """

    kind: Literal["auto", "rigid", "elastic", "plastic"] = "auto"
    tolerance: Annotated[float, Meta(ge=1e-12, le=1e-2)] = 1e-9
    max_iterations: Annotated[int, Meta(ge=1, le=10_000)] = 400
    stabilising_tension: Annotated[float, Meta(ge=0.0, le=1e-2)] = 1e-6
    bounds: bool = False
    adapt: Annotated[int, Meta(ge=0, le=12)] = 0
    space: bool = False
    strings: bool | Literal["elastic"] = False

    @property
    def is_elastic(self) -> bool:
        """Whether elastic rings are asked for, instead of ideal locking."""
        return self.kind == "elastic"

    @property
    def is_plastic(self) -> bool:
        """Whether rings may flow."""
        return self.kind == "plastic"

    @property
    def is_bounded(self) -> bool:
        """Whether bounds of the continuous curtain are wanted."""
        return self.bounds or self.adapt > 0
