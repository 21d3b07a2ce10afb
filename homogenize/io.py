"""Law files: JSON with a schema version, units, provenance and the checksum of the table behind the law."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from homogenize.laws.net import net_from_dict
from homogenize.laws.polyhedral import PolyhedralLaw, polyhedral_from_dict
from homogenize.laws.protocol import CellInfo, MembraneLaw
from homogenize.laws.smooth import smooth_from_dict
from homogenize.strength import read_strength
from rve.common.errors import InputError
from rve.common.files import write_text
from rve.common.reading import read_json
from rve.common.rings import check_rings
from rve.common.values import checked, mapping, numbers, optional, read_record, shown

SCHEMA = 1
UNITS = {"strain": "1", "line_load": "N/mm", "stiffness": "N/mm", "length": "mm"}
READERS: dict[str, Callable[[dict[str, Any], CellInfo | None, str], MembraneLaw]] = {
    "net": net_from_dict,
    "polyhedral": polyhedral_from_dict,
    "smooth": smooth_from_dict,
}


def default_law() -> MembraneLaw:
    """The law for r1/r2 = 10 that ships inside the package, made by `homogenize.ship`.

    >>> default_law().name
    'polyhedral'
    """
    return load_law(Path(__file__).parent / "data" / "rings_10.json")


def law_record(law: MembraneLaw, provenance: dict[str, Any] | None = None) -> dict[str, Any]:
    """What the file of a law holds."""
    strength = law.strength if isinstance(law, PolyhedralLaw) else None
    return {
        "schema": SCHEMA,
        "kind": law.name,
        "units": UNITS,
        "cell": None if law.cell is None else asdict(law.cell),
        "parameters": law.to_dict(),
        **({} if strength is None else {"strength": strength.to_dict()}),
        "provenance": provenance or {},
    }


def save_law(law: MembraneLaw, path: str | Path, provenance: dict[str, Any] | None = None) -> None:
    """Writes the law to `path` in one piece: a reader never sees half a file."""
    path = Path(path)
    text = json.dumps(law_record(law, provenance), indent=1) + "\n"
    write_text(path, text)


@dataclass(frozen=True, eq=False)
class LawFile:
    """A law and where it comes from: table, checksum, error report, sampled loads."""

    law: MembraneLaw
    provenance: dict[str, Any]


def load_law(path: str | Path) -> MembraneLaw:
    """The law in the file `path`; InputError names file, key and value if it is not one that this version reads."""
    return read_law_file(path).law


def read_law_file(path: str | Path) -> LawFile:
    """The law in the file `path` with its provenance; InputError as in `load_law`."""
    record = read_json(path)
    law = law_from_record(record, str(path))
    provenance = record.get("provenance", {})
    if not isinstance(provenance, dict):
        raise InputError(f"{path}: provenance = {shown(provenance)}: is not a table of names and values")
    if "sampled_loads" in provenance:
        checked(provenance, "sampled_loads", optional(numbers(None, 2)), f"{path}: provenance")
    return LawFile(law, provenance)


def law_from_record(record: Any, source: str) -> MembraneLaw:
    """The law of a parsed file; `source` names it in the messages of InputError."""
    if not isinstance(record, dict):
        raise InputError(f"{source}: a law file holds one JSON object, this one holds a {type(record).__name__}")
    check_format(record, source, tuple(sorted(READERS)))
    cell = checked(record, "cell", optional(mapping), f"{source}:")
    parameters = checked(record, "parameters", mapping, f"{source}:")
    law = READERS[record["kind"]](
        parameters, None if cell is None else cell_from_dict(cell, f"{source}: cell"), f"{source}: parameters"
    )
    if "strength" not in record or not isinstance(law, PolyhedralLaw):
        return law
    return replace(
        law, strength=read_strength(checked(record, "strength", mapping, f"{source}:"), f"{source}: strength")
    )


def check_format(record: dict[str, Any], source: str, kinds: tuple[str, ...]) -> None:
    """InputError unless schema, units and kind of a file are those that this version reads."""
    for key, known in (("schema", SCHEMA), ("units", UNITS)):
        if record.get(key) != known:
            raise InputError(f"{source}: {key} = {shown(record.get(key))}, this version reads {key} = {known}")
    if record.get("kind") not in kinds:
        raise InputError(f"{source}: kind = {shown(record.get('kind'))}, this version reads {', '.join(kinds)}")


def cell_from_dict(table: dict[str, Any], where: str) -> CellInfo:
    """The rings that a file describes; `where` names file and table in the messages of InputError."""
    cell = read_record(CellInfo, table, where)
    check_rings(table, where)
    return cell
