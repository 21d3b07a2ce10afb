"""Law files are read here: JSON with a schema version, units, provenance and the checksum of the table behind the law.

`homogenize.laws.stored` writes them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from homogenize.laws.cloth import ClothLaw, cloth_from_dict
from homogenize.laws.net import NetLaw, net_from_dict
from homogenize.laws.polyhedral import PolyhedralLaw, polyhedral_from_dict
from homogenize.laws.protocol import CellInfo, MembraneLaw
from homogenize.laws.stored import SCHEMA, UNITS, save_law
from homogenize.strength import Strength, read_strength
from rve.common.errors import InputError
from rve.common.rings import check_rings
from rve.common.storage.reading import read_json
from rve.common.values import checked, mapping, numbers, optional, read_record, shown

__all__ = ["Law", "default_law", "load_law", "save_law", "strength_of_law"]

Law = PolyhedralLaw | NetLaw | ClothLaw
"""The laws that have a file."""
READERS: dict[str, Callable[[dict[str, Any], CellInfo | None, str], Law]] = {
    "cloth": cloth_from_dict,
    "net": net_from_dict,
    "polyhedral": polyhedral_from_dict,
}
REMOVED = {
    "smooth": "fit its table again: homogenize fit TABLE --out LAW",
    "family": "make a table of the rings you need and fit it: rve table --r1 R1 --r2 R2 --out TABLE, "
    "homogenize fit TABLE --out LAW",
}
"""Kinds of files of older versions that are not read any more, and what to do."""


DEFAULT_LAW = Path(__file__).parent / "data" / "rings_10.json"
"""The file of `default_law`."""


def default_law() -> Law:
    """The law for r1/r2 = 10 that ships inside the package, made by `homogenize.fitting.shipped`.

    >>> default_law().name
    'polyhedral'
    """
    return load_law(DEFAULT_LAW)


def strength_of_law(law: MembraneLaw) -> Strength | None:
    """The strength of the rings behind `law`; None if it has none, as laws that are no files and those of old tables.

    >>> strength_of_law(default_law()).material.name
    'steel'
    """
    return law.strength if isinstance(law, Law) else None


def load_law(path: str | Path) -> Law:
    """The law in the file `path`, with its provenance, error report and strength.

    InputError names file, key and value of what this version does not read.
    """
    record = read_json(path)
    law = law_from_record(record, str(path))
    provenance = checked({"provenance": {}} | record, "provenance", mapping, f"{path}:")
    if "sampled_loads" in provenance:
        checked(provenance, "sampled_loads", optional(numbers(None, 2)), f"{path}: provenance")
    return replace(law, provenance=provenance)


def law_from_record(record: Any, source: str) -> Law:
    """The law of a parsed file; `source` names it in the messages of InputError."""
    if not isinstance(record, dict):
        raise InputError(f"{source}: a law file holds one JSON object, this one holds a {type(record).__name__}")
    for key, known in (("schema", SCHEMA), ("units", UNITS)):
        if record.get(key) != known:
            raise InputError(f"{source}: {key} = {shown(record.get(key))}, this version reads {key} = {known}")
    kind = record.get("kind")
    if not isinstance(kind, str) or kind not in READERS:
        removed = f"; {REMOVED[kind]}" if isinstance(kind, str) and kind in REMOVED else ""
        raise InputError(f"{source}: kind = {shown(kind)}, this version reads {', '.join(sorted(READERS))}{removed}")
    cell = checked(record, "cell", optional(mapping), f"{source}:")
    parameters = checked(record, "parameters", mapping, f"{source}:")
    strength = checked({"strength": None} | record, "strength", optional(mapping), f"{source}:")
    law = READERS[kind](
        parameters, None if cell is None else cell_from_dict(cell, f"{source}: cell"), f"{source}: parameters"
    )
    return replace(law, strength=None if strength is None else read_strength(strength, f"{source}: strength"))


def cell_from_dict(table: dict[str, Any], where: str) -> CellInfo:
    """The rings that a file describes; `where` names file and table in the messages of InputError."""
    cell = read_record(CellInfo, table, where)
    check_rings(table, where)
    return cell
