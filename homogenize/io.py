"""Law files: JSON with a schema version, units, provenance and the checksum of the table behind the law."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from homogenize.net import net_from_dict
from homogenize.polyhedral import polyhedral_from_dict
from homogenize.protocol import CellInfo, InputError, MembraneLaw
from homogenize.smooth import smooth_from_dict
from rve.files import write_text

SCHEMA = 1
UNITS = {"strain": "1", "line_load": "N/mm", "stiffness": "N/mm", "length": "mm"}
READERS: dict[str, Callable[[dict[str, Any], CellInfo | None], MembraneLaw]] = {
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
    return {
        "schema": SCHEMA,
        "kind": law.name,
        "units": UNITS,
        "cell": None if law.cell is None else asdict(law.cell),
        "parameters": law.to_dict(),
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
    path = Path(path)
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path}: is not JSON: {error}") from error
    law = law_from_record(record, str(path))
    provenance = record.get("provenance", {})
    if not isinstance(provenance, dict):
        raise InputError(f"{path}: provenance = {provenance!r} is not an object")
    return LawFile(law, provenance)


def law_from_record(record: Any, source: str) -> MembraneLaw:
    """The law of a parsed file; `source` names it in the messages of InputError."""
    if not isinstance(record, dict):
        raise InputError(f"{source}: a law file holds one JSON object, this one holds a {type(record).__name__}")
    if record.get("schema") != SCHEMA:
        raise InputError(f"{source}: schema = {record.get('schema')!r}, this version reads schema = {SCHEMA}")
    if record.get("units") != UNITS:
        raise InputError(f"{source}: units = {record.get('units')!r}, this version reads {UNITS}")
    kind = record.get("kind")
    if kind not in READERS:
        raise InputError(f"{source}: kind = {kind!r}, this version reads {', '.join(sorted(READERS))}")
    try:
        cell = None if record["cell"] is None else CellInfo(**{k: float(v) for k, v in record["cell"].items()})
        return READERS[kind](record["parameters"], cell)
    except KeyError as error:
        raise InputError(f"{source}: key {error} is missing") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{source}: {error}") from error
