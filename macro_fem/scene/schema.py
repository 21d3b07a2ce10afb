"""A scene: curtain, mesh, supports, loads and solver, read from TOML and checked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from macro_fem.scene.obstacles import OBSTACLES, Obstacle, Start, check_obstacle, is_flat, is_in_plane, read_start
from macro_fem.scene.old_names import with_new_names
from macro_fem.scene.tables import (
    LIVE_LOADS,
    MAX_CORNERS,
    NO_MOVE,
    SUPPORTS,
    Curtain,
    Edge,
    Load,
    Mesh,
    Solver,
    Support,
    Track,
    Wind,
    entries,
    in_3d,
    leaves_plane,
    read_kinds,
)
from macro_fem.scene.tracks import check_track
from rve.common.errors import InputError
from rve.common.materials import described
from rve.common.notebook import as_html
from rve.common.storage.reading import read_toml
from rve.common.values import read_record, shown, shown_key


@dataclass(frozen=True)
class Scene:
    """A checked scene; `source` names its file in messages and is where relative mesh files are looked for."""

    curtain: Curtain
    mesh: Mesh
    support: tuple[Support, ...]
    load: Load
    solver: Solver
    source: Path
    obstacle: tuple[Obstacle, ...] = ()
    start: Start | None = None
    material: tuple[tuple[str, Any], ...] = ()  # of the rings, in place of the law's: `homogenize.with_material`

    @property
    def in_space(self) -> bool:
        """Whether the curtain needs a third coordinate."""
        return bool(self.space_reason)

    @property
    def space_reason(self) -> str:
        """Why the curtain needs a third coordinate; "" in the plane."""
        return next(_out_of_plane(self), "")

    @property
    def d(self) -> int:
        """Coordinates of a place: 2 in the plane, 3 in space."""
        return 3 if self.in_space else 2

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
        return replace(self, support=(*self.support, *_read_supports({"kind": kind, **keys}, self.source)))

    def loaded_by(self, kind: str, **keys: Any) -> Scene:
        """The scene with one more load: "bar", "point", "patch", "edge" or "wind", its keys as in [[load.KIND]].

        InputError as for a file.

        >>> Scene.rectangle(3000, 2500).hung_by("hooks", pitch=200).loaded_by("bar", mass=12).load.bar
        (Bar(mass=12.0, edge='bottom', straight=True),)
        """
        if kind not in LIVE_LOADS:
            raise InputError(f"{self.source}: [load] {shown(kind)}: is not one of {', '.join(LIVE_LOADS)}")
        added = getattr(_read_load({kind: keys}, self.source), kind)
        more: dict[str, Any] = {kind: (*getattr(self.load, kind), *added)}
        return replace(self, load=replace(self.load, **more))

    def beside(self, kind: str, **keys: Any) -> Scene:
        """The scene with one more body to stay outside of: a kind of [[obstacle]], its keys by name."""
        return replace(
            self, obstacle=(*self.obstacle, *read_kinds({"kind": kind, **keys}, OBSTACLES, "obstacle", self.source))
        )

    def with_keys(self, table: str, **keys: Any) -> Scene:
        """The scene with keys of its tables "curtain", "mesh", "load", "solver", "start" or "material" set anew.

        InputError as for a file; what tables must agree on is checked when the scene is solved.

        >>> Scene.rectangle(100, 50).with_keys("solver", bounds=True).with_keys("mesh", cells=8).mesh.cells
        8
        """
        where = f"{self.source}: [{table}]"
        if table == "material":
            return replace(self, material=described(dict(self.material) | keys, where))
        if table == "start":
            return replace(self, start=read_start(keys, self.source))
        if table not in ("curtain", "mesh", "load", "solver"):
            raise InputError(f"{where}: is not one of curtain, mesh, load, solver, start, material")
        if table == "load" and (live_keys := keys.keys() & LIVE_LOADS):
            raise InputError(f"{where} {min(live_keys)}: is added by loaded_by")
        old = getattr(self, table)
        known = [field.name for field in fields(old) if not (table == "load" and field.name in LIVE_LOADS)]
        given = {name: getattr(old, name) for name in known if getattr(old, name) is not None}
        new = read_record(type(old), given | keys, where)
        live = {name: getattr(old, name) for name in LIVE_LOADS} if table == "load" else {}
        return replace(self, **{table: replace(new, **live)})

    def _repr_html_(self) -> str:
        """What a notebook shows: the tables of the scene."""
        parts = (self.curtain, self.mesh, *self.support, self.load, *self.obstacle, self.start, self.solver)
        return as_html(f"Scene: {self.source}", dict(self.material), (str(part) for part in parts if part is not None))


def load_scene(path: str | Path) -> Scene:
    """The scene in a TOML file; InputError names file, key and value of the first thing that is wrong."""
    return read_scene(read_toml(path), path)


def read_scene(data: dict[str, Any], source: str | Path = "scene") -> Scene:
    """The scene of parsed TOML tables; OldName is the warning for a name that has changed.

    >>> read_scene({"curtain": {"width": 1000.0, "height": 500.0}, "support": {"kind": "top"}}).support
    (Top(gather=1.0, move=(0.0, 0.0)),)
    """
    data = with_new_names(data, source)
    tables = ("curtain", "mesh", "support", "load", "solver", "obstacle", "start", "material")
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
        obstacle=read_kinds(data.get("obstacle", []), OBSTACLES, "obstacle", source),
        start=read_start(data.get("start"), source),
        material=described(data.get("material", {}), f"{source}: [material]"),
    )
    _check_mesh_keys(scene, data, source)
    check_scene(scene)
    return scene


def check_scene(scene: Scene) -> None:
    """InputError for tables that contradict each other, and for keys that change nothing."""
    if not scene.support:
        raise InputError(f"{scene.source}: [support]: is missing, so nothing holds the curtain")
    _check_shape(scene.curtain, scene.source)
    _check_effect(scene, scene.source)
    check_solver(scene, scene.source)


def _out_of_plane(scene: Scene) -> Iterator[str]:
    """What takes a scene into space, the first thing first."""
    for item in scene.support:
        move = getattr(item, "move", ())
        if move and leaves_plane(move):
            yield f"[support] move = {list(move)} leaves the plane"
        if isinstance(item, Track):
            yield "[support] kind = 'track' leaves the plane"
        if isinstance(item, Edge) and item.along and any(map(leaves_plane, item.along)):
            yield f"[support] along = {[list(point) for point in item.along]} leaves the plane"
    if isinstance(scene.load.gravity, tuple) and leaves_plane(scene.load.gravity):
        yield f"[load] gravity = {list(scene.load.gravity)} leaves the plane"
    for name in ("edge", "point", "patch"):
        for load in getattr(scene.load, name):
            if leaves_plane(load.force):
                yield f"[load.{name}] force = {list(load.force)} leaves the plane"
    for wind in scene.load.wind:
        if leaves_plane(wind.direction):
            yield f"[load.wind] direction = {list(wind.direction)} leaves the plane"
    for obstacle in scene.obstacle:
        if not is_in_plane(obstacle):
            yield f"[obstacle] {obstacle.name} is not a half-space of the plane"
    if scene.start is not None:
        yield "[start] lays the sheet in space"
    if any(wind.follows for wind in scene.load.wind):
        yield "[load.wind] follows = true: pressure is normal to the surface"
    if scene.solver.space:
        yield "[solver] space = true asks for it"


def _read_supports(tables: Any, source: str | Path) -> tuple[Support, ...]:
    supports = read_kinds(tables, SUPPORTS, "support", source)
    if not supports:
        raise InputError(f"{source}: [support]: is missing, so nothing holds the curtain")
    return supports


def _read_load(table: Any, source: str | Path) -> Load:
    if not isinstance(table, dict):
        raise InputError(f"{source}: [load] is not a table")
    live: dict[str, tuple[Any, ...]] = {}
    for name, cls in LIVE_LOADS.items():
        items = entries(table.get(name, []), f"{source}: [load] {name}")
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
    """InputError unless exactly the keys that describe the shape are given."""
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


def _check_mesh_keys(scene: Scene, data: dict[str, Any], source: str | Path) -> None:
    """InputError for keys of [mesh] that a mesh from a file leaves without effect."""
    mesh = data.get("mesh", {})
    for key in ("cells", "pattern"):
        if scene.curtain.shape == "file" and key in mesh:
            raise InputError(f'{source}: [mesh] {key} = {mesh[key]!r}: has no effect with shape = "file"')


def _check_effect(scene: Scene, source: str | Path) -> None:
    """InputError for a key that is given and changes nothing."""
    shape = scene.curtain.shape
    if scene.mesh.pattern != "aligned" and (shape != "rectangle" or scene.curtain.holes):
        what = f'shape = "{shape}"' if shape != "rectangle" else "holes"
        raise InputError(f"{source}: [mesh] pattern = {scene.mesh.pattern!r}: has no effect with {what}")
    for item in scene.support:
        held = getattr(item, "held", "both")
        move = getattr(item, "move", NO_MOVE)
        for axis, way in zip("xyz", in_3d(move), strict=True):
            if way != 0.0 and held != "both" and axis not in held:
                raise InputError(
                    f"{source}: [support] move = {list(move)}: has no effect along {axis}, as held = {held!r}"
                )
        if isinstance(item, Track):
            check_track(item, source)
        if isinstance(item, Edge):
            _check_line(item, source)
        if held == "z" and not scene.in_space:
            raise InputError(f"{source}: [support] held = 'z': holds nothing, as the scene lies in the plane")
    for wind in scene.load.wind:
        _check_wind(wind, source)
    for obstacle in scene.obstacle:
        check_obstacle(obstacle, source)
    load = scene.load
    uses_start = any(not is_flat(item) for item in scene.obstacle) or any(wind.follows for wind in load.wind)
    if scene.start is not None and not uses_start:
        raise InputError(f"{source}: [start]: has no effect without bodies and following pressure")
    moves = any(any(getattr(item, "move", ())) for item in (*scene.support, *scene.obstacle))
    if load.steps > 1 and not (moves or load.edge or load.point or load.patch or load.wind):
        raise InputError(f"{source}: [load] steps = {load.steps}: has no effect without live loads and moves")


def _check_wind(wind: Wind, source: str | Path) -> None:
    """InputError unless exactly one of pressure and speed is given, and only keys that have an effect."""
    where = f"{source}: [load.wind]"
    if wind.pressure is None and wind.speed is None:
        raise InputError(f"{where} pressure: is missing; give it in N/m2, or speed in m/s")
    if wind.pressure is not None:
        for key in ("speed", "air_density", "drag_coefficient"):
            if getattr(wind, key) is not None:
                raise InputError(f"{where} {key} = {getattr(wind, key):g}: is not used together with pressure")


def _check_line(item: Edge, source: str | Path) -> None:
    """InputError for keys of an edge that have no effect with a line, or without one."""
    where = f"{source}: [support] (edge)"
    if item.along is None:
        if item.sliding:
            raise InputError(f"{where} sliding = true: has no effect without along, the line to slide on")
        return
    if item.gather != 1.0:
        raise InputError(f"{where} gather = {item.gather:g}: has no effect with along, which says where the edge lies")
    if item.held != "both":
        raise InputError(f"{where} held = {item.held!r}: has no effect with along, which holds all but what slides")


def check_solver(scene: Scene, source: str | Path) -> None:
    """InputError if the solver does not go with the mesh or the shape."""
    element, shape, solver = scene.mesh.element, scene.curtain.shape, scene.solver
    if element in ("Q1", "Q2") and (shape not in ("rectangle", "file") or scene.curtain.holes):
        raise InputError(f"{source}: [mesh] element = {element!r}: needs a rectangle without holes or a mesh file")
    if solver.kind == "clarabel" and solver.linear_solver != "auto":
        raise InputError(
            f"{source}: [solver] linear_solver = {solver.linear_solver!r}: has no effect with kind = 'clarabel'"
        )
    if solver.kind == "elastic" and (solver.bounds or solver.adapt):
        raise InputError(f"{source}: [solver] bounds and adapt: belong to ideal locking, not to kind = 'elastic'")
    if (solver.bounds or solver.adapt) and any(wind.follows for wind in scene.load.wind):
        raise InputError(f"{source}: [solver] bounds and adapt: do not go with following pressure, no dead load")
    bodies = [item.name for item in scene.obstacle if not is_flat(item)]
    if (solver.bounds or solver.adapt) and bodies:
        raise InputError(
            f"{source}: [solver] bounds and adapt: do not go with {bodies[0]}: outside a body the problem is not convex"
        )
    if (solver.bounds or solver.adapt) and element != "P1":
        raise InputError(f"{source}: [solver] bounds and adapt: need element = 'P1', not {element!r}")
