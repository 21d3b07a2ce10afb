"""A scene: what hangs where, under which load, and how it is to be solved. Read from TOML and checked at the door.

Lengths are mm, forces N, line loads N/mm, masses kg and kg/m2, angles degrees. x points right, y up; a rectangle spans
from (0, 0) to (width, height), a disk is centred at (0, 0).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from macro_fem.scene.edges import canonical
from rve.common.errors import InputError, OldName
from rve.common.reading import read_toml
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
    shown_key,
    text,
    whole,
    words,
)

HANG_ANGLES = {"y": 0.0, "x": 90.0}
ELEMENTS = ("P1", "P2", "CR", "Q1", "Q2")
MAX_CELLS = 20_000
FEATURES = ("third-coordinate", "all-half-spaces", "ties", "coarse-start", "bounds")
"""What a scene leaves out where it can; see `macro_fem.output.explain`."""
FORCE_IS_IDLE = "has no effect, as the solver decides which features to use; leave it out, --explain says what was used"


MAX_CORNERS = 5_000
"""Corners of the outline and its holes together: every one is compared with every other."""
MAX_ENTRIES = 1_000
"""Supports, or loads of one kind."""
LEAST_MM, MOST_MM = 1e-6, 1e9
"""Lengths and coordinates: their squares and ratios must stay numbers."""
MOST_FORCE = 1e12


def length(default: Any = MISSING) -> Any:
    """A field for a length in mm."""
    return number(default, least=LEAST_MM, most=MOST_MM)


def _pair(size: float) -> Any:
    component = finite(least=-size, most=size)

    def check(value: Any) -> tuple[float, float]:
        if not isinstance(value, list | tuple) or len(value) != 2:
            raise ValueError("is not a pair of numbers [x, y]")
        return component(value[0]), component(value[1])

    return check


_corners = list_of(_pair(MOST_MM), "points [x, y]", least=3, most=MAX_CORNERS)


def vector(default: Any = MISSING, *, most: float = MOST_MM) -> Any:
    """A field for a pair [x, y] with components up to `most` in size: mm, or N."""
    return entry(_pair(most), default)


def _hang(value: Any) -> float:
    if isinstance(value, str) and value in HANG_ANGLES:
        return HANG_ANGLES[value]
    if isinstance(value, bool) or not isinstance(value, int | float) or not -360.0 <= value <= 360.0:
        raise ValueError('is neither "x", "y" nor an angle from -360 to 360 degrees')
    return float(value)


def _edge(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError("is not the name of an edge")
    return canonical(value)


@dataclass(frozen=True)
class Curtain:
    """The sheet. `hang` is read as the angle from the vertical to the weave's y axis: "y" is 0, "x" is 90 degrees."""

    shape: str = choice("rectangle", "disk", "outline", "file", default="rectangle")
    width: float | None = length(None)
    height: float | None = length(None)
    radius: float | None = length(None)
    outline: tuple[tuple[float, float], ...] | None = entry(_corners, None)
    holes: tuple[tuple[tuple[float, float], ...], ...] = entry(list_of(_corners, "polygons", most=MAX_ENTRIES), ())
    file: str | None = text(None)
    hang: float = entry(_hang, 0.0)
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
    move: tuple[float, float] = vector((0.0, 0.0))


@dataclass(frozen=True)
class Top:
    """The whole top edge held; `gather` narrows it."""

    gather: float = number(1.0, above=0.0, most=1e6)
    move: tuple[float, float] = vector((0.0, 0.0))


@dataclass(frozen=True)
class Rail:
    """The top edge held in height, free to slide sideways."""


@dataclass(frozen=True)
class Hooks:
    """Points of the top edge, held or sliding along a rail: one at each end, evenly spaced close to `pitch` mm."""

    pitch: float = length()
    gather: float = number(1.0, above=0.0, most=1e6)
    sliding: bool = flag(False)


@dataclass(frozen=True)
class Edge:
    """A named edge held, by default in both directions, and moved by `move` mm."""

    edge: str = entry(_edge)
    held: str = choice("both", "x", "y", default="both")
    gather: float = number(1.0, above=0.0, most=1e6)
    move: tuple[float, float] = vector((0.0, 0.0))


@dataclass(frozen=True)
class Point:
    """The material point `at` held and moved by `move` mm."""

    at: tuple[float, float] = vector()
    held: str = choice("both", "x", "y", default="both")
    move: tuple[float, float] = vector((0.0, 0.0))


Support = Corners | Top | Rail | Hooks | Edge | Point
SUPPORTS: dict[str, type[Support]] = {
    "corners": Corners,
    "top": Top,
    "rail": Rail,
    "hooks": Hooks,
    "edge": Edge,
    "point": Point,
}


@dataclass(frozen=True)
class EdgeLoad:
    """Force per reference length of a named edge, N/mm."""

    edge: str = entry(_edge)
    force: tuple[float, float] = vector(most=MOST_FORCE)


@dataclass(frozen=True)
class PointLoad:
    """Force in N on the material point `at`."""

    at: tuple[float, float] = vector()
    force: tuple[float, float] = vector(most=MOST_FORCE)


@dataclass(frozen=True)
class PatchLoad:
    """Force in N spread evenly over the reference disk of `radius` around `at`: a hand that pulls."""

    at: tuple[float, float] = vector()
    radius: float = length()
    force: tuple[float, float] = vector(most=MOST_FORCE)


@dataclass(frozen=True)
class Bar:
    """A bar of `mass` kg along a named edge. A straight one keeps the edge on a line whose length is free to shrink."""

    mass: float = number(least=0.0, most=1e9)
    edge: str = entry(_edge, "bottom")
    straight: bool = flag(True)


@dataclass(frozen=True)
class Load:
    """Weight by `gravity` (m/s2) and the live loads; `steps` applies live loads and moves in equal steps."""

    gravity: float = number(9.81, least=-1e6, most=1e6)
    steps: int = whole(1, least=1, most=1000)
    edge: tuple[EdgeLoad, ...] = ()
    point: tuple[PointLoad, ...] = ()
    patch: tuple[PatchLoad, ...] = ()
    bar: tuple[Bar, ...] = ()


LIVE_LOADS: dict[str, type[Any]] = {"edge": EdgeLoad, "point": PointLoad, "patch": PatchLoad, "bar": Bar}


@dataclass(frozen=True)
class Solver:
    """`rigid`: ideal locking, `conic`: the same by a cone program (clarabel), `newton`: the elastic law.

    `tolerance` is relative to the problem's energy scale, total load times size. `spread` adds an even tension of this
    part of (total load / size) everywhere, which opens out what hangs slack and has no shape of its own; the bounds in
    the summary allow for it, 0 switches it off. `force`, of an older version, has no effect.
    """

    kind: str = choice("rigid", "conic", "newton", default="rigid")
    tolerance: float = number(1e-9, least=1e-12, most=1e-2)
    max_iterations: int = whole(400, least=1, most=10_000)
    spread: float = number(1e-6, least=0.0, most=1e-2)
    bounds: bool = flag(False)
    adapt: int = whole(0, least=0, most=12)
    force: tuple[str, ...] = words("all", *FEATURES)


@dataclass(frozen=True)
class Scene:
    """A checked scene; `source` names its file in messages and is where relative mesh files are looked for."""

    curtain: Curtain
    mesh: Mesh
    support: tuple[Support, ...]
    load: Load
    solver: Solver
    source: Path

    @classmethod
    def rectangle(cls, width: float, height: float, *, cells: int = 32, **curtain: Any) -> Scene:
        """A rectangle of width by height mm under its own weight, not hung yet; more keys of [curtain] by name.

        >>> Scene.rectangle(1000, 500).hung_by("corners", gather=0.9).support
        (Corners(gather=0.9, move=(0.0, 0.0)),)
        """
        tables = {"curtain": {"width": width, "height": height, **curtain}, "mesh": {"cells": cells}}
        scene = read_scene(tables | {"support": {"kind": "top"}})
        return replace(scene, support=())

    def hung_by(self, kind: str, **keys: Any) -> Scene:
        """The scene with one more support of a kind of [[support]], its keys by name; InputError as for a file."""
        added = _read_supports({"kind": kind, **keys}, self.source)
        scene = replace(self, support=(*self.support, *added))
        check_solver(scene, self.source)
        return scene


def load_scene(path: str | Path) -> Scene:
    """The scene in a TOML file; InputError names file, key and value of the first thing that is wrong."""
    return read_scene(read_toml(path), path)


def read_scene(data: dict[str, Any], source: str | Path = "scene") -> Scene:
    """The scene of parsed TOML tables.

    >>> read_scene({"curtain": {"width": 1000.0, "height": 500.0}, "support": {"kind": "top"}}).support
    (Top(gather=1.0, move=(0.0, 0.0)),)
    """
    tables = ("curtain", "mesh", "support", "load", "solver")
    for key in data:
        if key not in tables:
            raise InputError(f"{source}: {shown_key(key)}: unknown table; known are {', '.join(tables)}")
    if "curtain" not in data:
        raise InputError(f"{source}: [curtain]: is missing")
    scene = Scene(
        curtain=read_record(Curtain, data["curtain"], f"{source}: [curtain]"),
        mesh=read_record(Mesh, data.get("mesh", {}), f"{source}: [mesh]"),
        support=_read_supports(data.get("support", []), source),
        load=_read_load(data.get("load", {}), source),
        solver=read_record(Solver, data.get("solver", {}), f"{source}: [solver]"),
        source=Path(source),
    )
    _check_shape(scene.curtain, source)
    _check_effect(scene, data, source)
    if scene.solver.force:
        warnings.warn(f"{source}: [solver] force: {FORCE_IS_IDLE}", OldName, stacklevel=3)
    check_solver(scene, source)
    return scene


def _read_supports(tables: Any, source: str | Path) -> tuple[Support, ...]:
    if isinstance(tables, dict):
        tables = [tables]
    if not isinstance(tables, list):
        raise InputError(f"{source}: [support] is not a table")
    if not tables:
        raise InputError(f"{source}: [support]: is missing, so nothing holds the curtain")
    if len(tables) > MAX_ENTRIES:
        raise InputError(f"{source}: [support]: has {len(tables)} entries, at most {MAX_ENTRIES} are allowed")
    supports = []
    for table in tables:
        if not isinstance(table, dict):
            raise InputError(f"{source}: [support] = {shown(table)}: is not a table")
        kind = table.get("kind")
        if not isinstance(kind, str) or kind not in SUPPORTS:
            raise InputError(f"{source}: [support] kind = {shown(kind)}: is not one of {', '.join(SUPPORTS)}")
        rest = {key: value for key, value in table.items() if key != "kind"}
        supports.append(read_record(SUPPORTS[kind], rest, f"{source}: [support] ({kind})"))
    return tuple(supports)


def _read_load(table: Any, source: str | Path) -> Load:
    if not isinstance(table, dict):
        raise InputError(f"{source}: [load] is not a table")
    live: dict[str, tuple[Any, ...]] = {}
    for name, cls in LIVE_LOADS.items():
        items = table.get(name, [])
        items = [items] if isinstance(items, dict) else items
        if not isinstance(items, list):
            raise InputError(f"{source}: [load] {name} = {shown(items)}: is not a table")
        if len(items) > MAX_ENTRIES:
            raise InputError(f"{source}: [load] {name}: has {len(items)} entries, at most {MAX_ENTRIES} are allowed")
        live[name] = tuple(read_record(cls, item, f"{source}: [load.{name}]") for item in items)
    plain = {key: value for key, value in table.items() if key not in LIVE_LOADS}
    known = ("gravity", "steps", *LIVE_LOADS)
    for key, value in plain.items():
        if key not in known:
            raise InputError(
                f"{source}: [load] {shown_key(key)} = {shown(value)}: unknown key; known are {', '.join(known)}"
            )
    base = read_record(Load, plain, f"{source}: [load]")
    return Load(base.gravity, base.steps, **live)


_NEEDS = {"rectangle": ("width", "height"), "disk": ("radius",), "outline": ("outline",), "file": ("file",)}


def _check_shape(curtain: Curtain, source: str | Path) -> None:
    """Exactly the keys that describe the shape are given."""
    needs = _NEEDS[curtain.shape]
    for key in ("width", "height", "radius", "outline", "file"):
        value = getattr(curtain, key)
        if key in needs and value is None:
            raise InputError(f'{source}: [curtain] {key}: is missing, shape = "{curtain.shape}" needs it')
        if key not in needs and value is not None:
            raise InputError(f'{source}: [curtain] {key} = {shown(value)}: is not used by shape = "{curtain.shape}"')
    corners = len(curtain.outline or ()) + sum(map(len, curtain.holes))
    if corners > MAX_CORNERS:
        raise InputError(
            f"{source}: [curtain] outline and holes: have {corners} corners, at most {MAX_CORNERS} are allowed"
        )
    if curtain.holes and curtain.shape == "file":
        raise InputError(f'{source}: [curtain] holes: are not used by shape = "file"')


def _check_effect(scene: Scene, data: dict[str, Any], source: str | Path) -> None:
    """InputError for a key that is given and changes nothing."""
    mesh, shape = data.get("mesh", {}), scene.curtain.shape
    for key in ("cells", "pattern"):
        if shape == "file" and key in mesh:
            raise InputError(f'{source}: [mesh] {key} = {mesh[key]!r}: has no effect with shape = "file"')
    if scene.mesh.pattern != "aligned" and (shape != "rectangle" or scene.curtain.holes):
        what = f'shape = "{shape}"' if shape != "rectangle" else "holes"
        raise InputError(f"{source}: [mesh] pattern = {scene.mesh.pattern!r}: has no effect with {what}")
    for item in scene.support:
        held = getattr(item, "held", "both")
        move = getattr(item, "move", (0.0, 0.0))
        for axis, way in zip("xy", move, strict=True):
            if way != 0.0 and held not in ("both", axis):
                raise InputError(
                    f"{source}: [support] move = {list(move)}: has no effect along {axis}, as held = {held!r}"
                )
    load = scene.load
    moves = any(any(getattr(item, "move", ())) for item in scene.support)
    if load.steps > 1 and not (moves or load.edge or load.point or load.patch):
        raise InputError(f"{source}: [load] steps = {load.steps}: has no effect without live loads and moves")


def check_solver(scene: Scene, source: str | Path) -> None:
    """InputError if the solver does not go with the mesh or the shape."""
    element, shape, solver = scene.mesh.element, scene.curtain.shape, scene.solver
    if element in ("Q1", "Q2") and (shape not in ("rectangle", "file") or scene.curtain.holes):
        raise InputError(f"{source}: [mesh] element = {element!r}: needs a rectangle without holes or a mesh file")
    if solver.kind == "newton" and (solver.bounds or solver.adapt):
        raise InputError(f"{source}: [solver] bounds and adapt: belong to ideal locking, not to kind = 'newton'")
    if (solver.bounds or solver.adapt) and element != "P1":
        raise InputError(f"{source}: [solver] bounds and adapt: need element = 'P1', not {element!r}")
