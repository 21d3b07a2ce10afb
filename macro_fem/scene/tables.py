"""The tables of a scene file as records: every key with its default and the range of its values.

Lengths are mm, forces N, line loads N/mm, pressures N/m2, masses kg and kg/m2, angles degrees. x points right, y up, z
towards the viewer; a rectangle spans from (0, 0) to (width, height), a disk is centred at (0, 0). Vectors have two or
three components and are kept as given; a third one that is not 0 takes the curtain into space.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from macro_fem.fem.linear import METHODS
from macro_fem.scene.meshing.edges import canonical
from rve.common.errors import InputError
from rve.common.values import (
    MISSING,
    choice,
    entry,
    finite,
    flag,
    list_of,
    number,
    read_record,
    shown,
    text,
    whole,
)

WEAVE_ANGLES = {"y": 0.0, "x": 90.0}
ELEMENTS = ("P1", "P2", "CR", "Q1", "Q2")
MAX_CELLS = 20_000


MAX_CORNERS = 5_000
"""Most corners of the outline and its holes together; the work grows with their square."""
MAX_ENTRIES = 1_000
"""Most supports, and most loads of one kind."""
LEAST_MM, MOST_MM = 1e-6, 1e9
"""Range of lengths and coordinates, in which squares and ratios stay finite."""
MOST_FORCE = 1e12
MOST_GRAVITY = 1e6
"""m/s2."""
HELD = ("both", "x", "y", "z", "xy", "xz", "yz")
"""What a support may hold: all components, or those named."""


def length(default: Any = MISSING) -> Any:
    """A field for a length in mm."""
    return number(default, least=LEAST_MM, most=MOST_MM)


def _pair(size: float, names: str = "[x, y]") -> Any:
    component = finite(least=-size, most=size)

    def check(value: Any) -> tuple[float, float]:
        if not isinstance(value, list | tuple) or len(value) != 2:
            raise ValueError(f"is not a pair of numbers {names}")
        return component(value[0]), component(value[1])

    return check


_corners = list_of(_pair(MOST_MM), "points [x, y]", least=3, most=MAX_CORNERS)


Vector = tuple[float, ...]
"""Two or three components."""
NO_MOVE: Vector = (0.0, 0.0)


def place() -> Any:
    """A field for a material point [x, y], mm."""
    return entry(_pair(MOST_MM))


def _components(size: float) -> Any:
    component = finite(least=-size, most=size)

    def check(value: Any) -> Vector:
        if not isinstance(value, list | tuple) or len(value) not in (2, 3):
            raise ValueError("is not a list of numbers [x, y] or [x, y, z]")
        return tuple(component(item) for item in value)

    return check


def vector(default: Any = MISSING, *, most: float = MOST_MM) -> Any:
    """A field for a vector [x, y] or [x, y, z] with components up to `most` in size: mm, or N."""
    return entry(_components(most), default)


def in_3d(v: Vector) -> tuple[float, float, float]:
    """A vector of two or three components with the third one, 0 where it is not given.

    >>> in_3d((1.0, 2.0))
    (1.0, 2.0, 0.0)
    """
    x, y, *z = v
    return x, y, z[0] if z else 0.0


def leaves_plane(v: Vector) -> bool:
    """Whether a vector has a third component that is not 0."""
    return in_3d(v)[2] != 0.0


def _line(value: Any) -> tuple[Vector, Vector]:
    points = list_of(_components(MOST_MM), "points [x, y, z]", least=2, most=2)(value)
    first, last = (in_3d(point) for point in points)
    if max(abs(a - b) for a, b in zip(first, last, strict=True)) < LEAST_MM:
        raise ValueError(f"is no line: its points are less than {LEAST_MM:g} mm apart")
    return first, last


def _direction(value: Any) -> Vector:
    v = _components(MOST_MM)(value)
    if not any(v):
        raise ValueError("has no direction: one component must not be 0")
    return v


def _gravity(value: Any) -> float | Vector:
    if isinstance(value, list | tuple):
        return _components(MOST_GRAVITY)(value)
    size: float = finite(least=-MOST_GRAVITY, most=MOST_GRAVITY)(value)
    return size


def _weave_angle(value: Any) -> float:
    if isinstance(value, str) and value in WEAVE_ANGLES:
        return WEAVE_ANGLES[value]
    if isinstance(value, bool) or not isinstance(value, int | float) or not -360.0 <= value <= 360.0:
        raise ValueError('is neither "x", "y" nor an angle from -360 to 360 degrees')
    return float(value)


def _edge(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError("is not the name of an edge")
    return canonical(value)


@dataclass(frozen=True)
class Curtain:
    """The sheet. `weave_angle`: degrees from the vertical to the weave's y axis; "y" is read as 0, "x" as 90."""

    shape: str = choice("rectangle", "disk", "outline", "file", default="rectangle")
    width: float | None = length(None)
    height: float | None = length(None)
    radius: float | None = length(None)
    outline: tuple[tuple[float, float], ...] | None = entry(_corners, None)
    holes: tuple[tuple[tuple[float, float], ...], ...] = entry(list_of(_corners, "polygons", most=MAX_ENTRIES), ())
    file: str | None = text(None)
    weave_angle: float = entry(_weave_angle, 0.0)
    areal_mass: float | None = number(None, least=0.0, most=1e6)


@dataclass(frozen=True)
class Mesh:
    """`cells` along the width. `pattern`: "aligned" has edges along both diagonal families of the weave."""

    cells: int = whole(32, least=1, most=MAX_CELLS)
    element: str = choice(*ELEMENTS, default="P1")
    pattern: str = choice("aligned", "crossed", "diagonal", default="aligned")


@dataclass(frozen=True)
class Corners:
    """Both ends of the top edge held; `gather` narrows their distance."""

    gather: float = number(1.0, above=0.0, most=1e6)
    move: tuple[float, ...] = vector(NO_MOVE)


@dataclass(frozen=True)
class Top:
    """The whole top edge held; `gather` narrows it."""

    gather: float = number(1.0, above=0.0, most=1e6)
    move: tuple[float, ...] = vector(NO_MOVE)


@dataclass(frozen=True)
class Rail:
    """The top edge held in height, and in space in z too, free to slide sideways."""


@dataclass(frozen=True)
class Hooks:
    """Points of the top edge, held or sliding along a rail: one at each end, evenly spaced close to `pitch` mm.

    `capacity`: the force in N that a hook bears; results are compared with it.
    """

    pitch: float = length()
    gather: float = number(1.0, above=0.0, most=1e6)
    sliding: bool = flag(False)
    capacity: float | None = number(None, above=0.0, most=MOST_FORCE)


@dataclass(frozen=True)
class Edge:
    """A named edge held, by default in all directions, and moved by `move` mm.

    `along`: two points [x, y, z] of a straight line on which the edge lies, from its left or lower end to the other,
    such as a cable; with `sliding` the edge slides on that line, which has no end.
    """

    edge: str = entry(_edge)
    held: str = choice(*HELD, default="both")
    gather: float = number(1.0, above=0.0, most=1e6)
    move: tuple[float, ...] = vector(NO_MOVE)
    along: tuple[Vector, Vector] | None = entry(_line, None)
    sliding: bool = flag(False)


@dataclass(frozen=True)
class Point:
    """The material point `at` held and moved by `move` mm."""

    at: tuple[float, float] = place()
    held: str = choice(*HELD, default="both")
    move: tuple[float, ...] = vector(NO_MOVE)


@dataclass(frozen=True)
class Track:
    """The top edge on a curve in plan at the height y = `height`, that of the top edge by default.

    The curve is `path`, a list of points [x, z], an arc of `radius` and `angle` (degrees; positive bulges towards the
    viewer), or straight and as long as `fullness` says: mesh length of the top edge over length of the track. `pitch`:
    distance of the runners along the mesh; without it the whole edge is held. `drawn`: the part of the track that the
    curtain covers, from its `side`. `capacity`: the force in N that a runner bears, as for hooks.
    """

    path: tuple[tuple[float, float], ...] | None = entry(
        list_of(_pair(MOST_MM, "[x, z]"), "points [x, z]", least=2, most=MAX_CORNERS), None
    )
    radius: float | None = length(None)
    angle: float | None = number(None, least=-360.0, most=360.0)
    height: float | None = number(None, least=-MOST_MM, most=MOST_MM)
    fullness: float | None = number(None, above=0.0, most=1e6)
    pitch: float | None = length(None)
    drawn: float = number(1.0, above=0.0, most=1.0)
    side: str = choice("start", "end", default="start")
    capacity: float | None = number(None, above=0.0, most=MOST_FORCE)


Support = Corners | Top | Rail | Hooks | Edge | Point | Track
SUPPORTS: dict[str, type[Support]] = {
    "corners": Corners,
    "top": Top,
    "rail": Rail,
    "hooks": Hooks,
    "edge": Edge,
    "point": Point,
    "track": Track,
}


@dataclass(frozen=True)
class EdgeLoad:
    """Force per reference length of a named edge, N/mm."""

    edge: str = entry(_edge)
    force: tuple[float, ...] = vector(most=MOST_FORCE)


@dataclass(frozen=True)
class PointLoad:
    """Force in N on the material point `at`."""

    at: tuple[float, float] = place()
    force: tuple[float, ...] = vector(most=MOST_FORCE)


@dataclass(frozen=True)
class PatchLoad:
    """Force in N, distributed evenly over the reference disk of `radius` around `at`."""

    at: tuple[float, float] = place()
    radius: float = length()
    force: tuple[float, ...] = vector(most=MOST_FORCE)


@dataclass(frozen=True)
class Bar:
    """A bar of `mass` kg along a named edge. A straight one keeps the edge on a line whose length is free to shrink."""

    mass: float = number(least=0.0, most=1e9)
    edge: str = entry(_edge, "bottom")
    straight: bool = flag(True)


@dataclass(frozen=True)
class Wind:
    """A load of `pressure` N/m2 of reference area along `direction`, whose length does not matter.

    Instead of the pressure: `speed` in m/s, with `air_density` in kg/m3 (1.25 by default) and `drag_coefficient` per
    total area (by default that of the law's rings, see `macro_fem.scene.wind`). With `follows` it is per present area,
    normal to the present surface, on the side where it first blows.
    """

    direction: tuple[float, ...] = entry(_direction)
    pressure: float | None = number(None, least=-1e9, most=1e9)
    speed: float | None = number(None, least=0.0, most=1e3)
    air_density: float | None = number(None, above=0.0, most=1e4)
    drag_coefficient: float | None = number(None, least=0.0, most=1e3)
    follows: bool = flag(False)


@dataclass(frozen=True)
class Load:
    """Weight and live loads; `steps` applies live loads and moves in equal steps.

    `gravity` in m/s2: a number is downwards, a vector [x, y] or [x, y, z] has the direction of the weight.
    """

    gravity: float | tuple[float, ...] = entry(_gravity, 9.81)
    steps: int = whole(1, least=1, most=1000)
    edge: tuple[EdgeLoad, ...] = ()
    point: tuple[PointLoad, ...] = ()
    patch: tuple[PatchLoad, ...] = ()
    bar: tuple[Bar, ...] = ()
    wind: tuple[Wind, ...] = ()

    @property
    def acceleration(self) -> Vector:
        """Gravity as a vector of three components, m/s2."""
        return in_3d(self.gravity) if isinstance(self.gravity, tuple) else (0.0, -self.gravity, 0.0)


LIVE_LOADS: dict[str, type[Any]] = {
    "edge": EdgeLoad,
    "point": PointLoad,
    "patch": PatchLoad,
    "bar": Bar,
    "wind": Wind,
}


@dataclass(frozen=True)
class Solver:
    """`kind`: "rigid" is ideal locking, "clarabel" the same by an independent solver, "elastic" the elastic law.

    `tolerance` is relative to the problem's energy scale, total load times size. `stabilising_tension` adds an even
    tension of this part of (total load / size) everywhere, which decides the shape of slack parts. The bounds in the
    summary allow for it, 0 switches it off; an elastic curtain is only guided by it. `bounds` asks for bounds of the
    continuous curtain, `adapt` for this number of refinements where the bounds differ. `space` gives a plane scene the
    third coordinate that it does not need. `linear_solver`: the method of `macro_fem.fem.linear` that factorizes.
    """

    kind: str = choice("rigid", "elastic", "clarabel", default="rigid")
    tolerance: float = number(1e-9, least=1e-12, most=1e-2)
    max_iterations: int = whole(400, least=1, most=10_000)
    stabilising_tension: float = number(1e-6, least=0.0, most=1e-2)
    bounds: bool = flag(False)
    adapt: int = whole(0, least=0, most=12)
    space: bool = flag(False)
    linear_solver: str = choice(*METHODS, default="auto")


def entries(tables: Any, where: str) -> list[Any]:
    """The entries of an array of tables, one of which may stand alone; InputError for anything else, or too many."""
    tables = [tables] if isinstance(tables, dict) else tables
    if not isinstance(tables, list):
        raise InputError(f"{where} = {shown(tables)}: is not a table")
    if len(tables) > MAX_ENTRIES:
        raise InputError(f"{where}: has {len(tables)} entries, at most {MAX_ENTRIES} are allowed")
    return tables


def read_kinds(tables: Any, kinds: Mapping[str, type[Any]], name: str, source: str | Path) -> tuple[Any, ...]:
    """The records of [[name]], whose class each `kind` says; InputError for a kind, key or value without sense."""
    found = []
    for table in entries(tables, f"{source}: [{name}]"):
        if not isinstance(table, dict):
            raise InputError(f"{source}: [{name}] = {shown(table)}: is not a table")
        kind = table.get("kind")
        if not isinstance(kind, str) or kind not in kinds:
            raise InputError(f"{source}: [{name}] kind = {shown(kind)}: is not one of {', '.join(kinds)}")
        rest = {key: value for key, value in table.items() if key != "kind"}
        found.append(read_record(kinds[kind], rest, f"{source}: [{name}] ({kind})"))
    return tuple(found)
