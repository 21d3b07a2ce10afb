"""Scenes from TOML tables: each key is checked by the noun that it belongs to, the scene as a whole by `checks`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from macro_fem.scene import support_kinds
from macro_fem.scene.checks import check_scene
from macro_fem.scene.meshing.outline_files import read_outline
from macro_fem.scene.moving import Ball, Motion
from macro_fem.scene.obstacles import Obstacle, Start
from macro_fem.scene.scene import Scene
from macro_fem.scene.shapes import Mesh, MeshFile, Outline, Shape
from macro_fem.scene.tables import Combination, Item, Load, Loading, Project, Solver
from rve.common import InputError, JsonObject, Typed, read_as, read_toml, read_typed, refuse_unknown, shown, types_of
from rve.common.materials import described
from rve.common.plugins import load_installed
from rve.common.typed import did_you_mean, not_one_of

PARTS: dict[str, type[Typed]] = {
    "mesh": Mesh,
    "load": Loading,
    "solver": Solver,
    "start": Start,
    "motion": Motion,
    "project": Project,
}
"""Tables of a scene file that are one record."""
PLUGIN = "; one of a plugin needs --plugin FILE.py"
LISTS: dict[str, type[Item]] = {"support": support_kinds.Support, "obstacle": Obstacle, "body": Ball}
"""Lists of a scene file whose entries say their `kind`."""


def load_scene(path: str | Path) -> Scene:
    """The scene in a TOML file; InputError names file, key and value of the first thing that is wrong."""
    with read_as("scene", path):
        return read_scene(read_toml(path), path)


def read_scene(data: JsonObject, source: str | Path = "scene") -> Scene:
    """The scene of parsed TOML tables.

    >>> read_scene({"curtain": {"width": 1000.0, "height": 500.0}, "support": {"kind": "top"}}).support
    (Top(gather=1.0, move=(0.0, 0.0)),)
    """
    load_installed()
    tables = ("curtain", *LISTS, *PARTS, "material", "combination")
    for name in data if isinstance(data, dict) else ():
        if name not in tables and _home(name):
            raise InputError(f"{source}: {shown(name)}: unknown table; {_home(name)}")
        if name not in tables and not isinstance(data[name], dict | list):
            known = f"{did_you_mean(name, tables)}known are {', '.join(tables)}"
            raise InputError(f"{source}: {name!s:.80} = {shown(data[name])}: stands in no table; {known}")
    refuse_unknown(data, tables, f"{source}:", "table")
    loads = data.get("load")
    for entry in loads if isinstance(loads, list) else [loads]:
        if isinstance(entry, dict) and "kind" in entry:
            kind = entry["kind"]
            told = f"write [[load.{kind}]]" if kind in [*Load.kinds] else not_one_of(kind, Load.kinds)
            raise InputError(f"{source}: [load] kind = {shown(kind)}: {told}")
    for name in ("curtain", "load"):
        if not isinstance(data.get(name, {}), dict):
            raise InputError(f"{source}: [{name}] is not one table")
    if "curtain" not in data:
        least = "" if data else "; a scene has at least [curtain] and [support]"
        raise InputError(f"{source}: [curtain]: is missing{least}")
    load = data.get("load", {})
    refuse_unknown(load, ("gravity", "steps", *Load.kinds), f"{source}: [load]", hint=PLUGIN)
    items = []
    for name, base in LISTS.items():
        items += read_records(data.get(name, []), base.kinds, f"{source}: [{name}]")
    for name, kind in Load.kinds.items():
        items += read_records(load.get(name, []), kind, f"{source}: [load.{name}]")
    single = data | {"load": {key: value for key, value in load.items() if key not in Load.kinds}}
    curtain, notes = {"shape": "rectangle"} | data["curtain"], tuple[str, ...]()
    if curtain["shape"] == "dxf":
        curtain, notes = _from_dxf(curtain, Path(source))
    shape = read_records(curtain, Shape.kinds | {"dxf": Outline}, f"{source}: [curtain]", "shape")[0]
    parts: dict[str, Any] = {
        name: read_typed(cls, single[name], f"{source}: [{name}]") for name, cls in PARTS.items() if name in single
    }
    for key in ("cells", "pattern"):
        if isinstance(shape, MeshFile) and key in data.get("mesh", {}):
            raise InputError(f'{source}: [mesh] {key} = {data["mesh"][key]!r}: has no effect with shape = "file"')
    parts["material"] = described(data.get("material", {}), f"{source}: [material]")
    factors = [_with_own(one) for one in _listed(data.get("combination", []), f"{source}: [combination]")]
    parts["combination"] = tuple(read_records(factors, Combination, f"{source}: [combination]"))
    scene = Scene(shape, tuple(items), **parts, source=Path(source), drawing=data["curtain"].get("file"), notes=notes)
    check_scene(scene)
    return scene


def _home(word: Any) -> str:
    """How a scene names a kind, "" if none has this name."""
    lists = [f"[[load.{word}]]" for kind in Load.kinds if kind == word]
    lists += [f'[[{name}]] kind = "{word}"' for name, base in LISTS.items() for kind in base.kinds if kind == word]
    lists += [f'[curtain] shape = "{word}"' for kind in Shape.kinds if kind == word]
    return f"write {' or '.join(lists)}" if lists else ""


def _from_dxf(curtain: JsonObject, source: Path) -> tuple[JsonObject, tuple[str, ...]]:
    """The table of an outline in place of one that names a DXF file, and what was mended in the file."""
    file = curtain.pop("file", None)
    if not isinstance(file, str) or not file:
        raise InputError(f'{source}: [curtain] file: is missing; shape = "dxf" names the file of the outline')
    refuse_unknown(curtain, ("shape", "weave_angle", "areal_mass"), f"{source}: [curtain] of a DXF file")
    drawing = read_outline(source.parent / file)
    return curtain | {"shape": "outline", "outline": drawing.outline, "holes": drawing.holes}, drawing.notes


def _listed(tables: Any, where: str) -> list[Any]:
    """An array of tables, one of which may stand alone; InputError for what is none."""
    tables = [tables] if isinstance(tables, dict) else tables
    if not isinstance(tables, list):
        raise InputError(f"{where} = {shown(tables)}: is not a table")
    return tables


def _with_own(table: Any) -> Any:
    """The table of a combination with the factors on loads of plugins in an entry of their own."""
    own = Load.kinds.keys() - types_of(Combination)
    if not isinstance(table, dict) or not own & table.keys():
        return table
    rest = {key: value for key, value in table.items() if key not in own}
    return rest | {"own": [(key, table[key]) for key in table if key in own]}


def read_records(
    tables: Any, kinds: type[Typed] | Mapping[str, type[Any]], where: str, word: str = "kind"
) -> list[Any]:
    """The records of an array of tables, one of which may stand alone, of one class, or of that which each `kind` says.

    InputError for kinds, keys and values without sense.
    """
    tables = _listed(tables, where)
    if not isinstance(kinds, Mapping):
        return [read_typed(kinds, table, where) for table in tables]
    found = []
    for table in tables:
        if not isinstance(table, dict):
            raise InputError(f"{where} = {shown(table)}: is not a table")
        kind = table.get(word)
        if not isinstance(kind, str) or kind not in kinds:
            if word not in table:
                home = "".join(_home(key) for key in table if key in kinds)
                raise InputError(f"{where} {word}: is missing; {home or 'it is one of ' + ', '.join(kinds)}")
            home = f"; {_home(kind)}".rstrip("; ")
            raise InputError(f"{where} {word} = {shown(kind)}: {not_one_of(kind, kinds)}{home}{PLUGIN}")
        rest = {key: value for key, value in table.items() if key != word}
        found.append(read_typed(kinds[kind], rest, f"{where} ({kind})" if word == "kind" else where))
    return found
