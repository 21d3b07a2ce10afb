"""Law files are read here: JSON with a schema version, units, provenance and the checksum of the table behind the law.

`homogenize.laws.stored` writes them.
"""

import pkgutil
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from homogenize import laws
from homogenize.laws.protocol import CellInfo, MembraneLaw
from homogenize.laws.stored import SCHEMA, UNITS, StoredLaw
from homogenize.strength import Strength, read_strength
from rve.common import Typed, checked, read_as, read_json_object, read_typed, shown
from rve.common.cell_fields import check_rings

DEFAULT_LAW = Path(__file__).parent / "data" / "rings_10.json"
"""The file of `default_law`."""


@dataclass(frozen=True)
class LawEntries(Typed):
    """What a law file holds."""

    schema: Any
    kind: str
    units: Any
    cell: dict[str, Any] | None
    parameters: dict[str, Any]
    strength: dict[str, Any] | None = None
    provenance: dict[str, Any] | None = None

    def check(self) -> None:
        for key, found, known in (("schema", self.schema, SCHEMA), ("units", self.units, UNITS)):
            if found != known:
                self.refuse(f"{key} = {shown(found)}, this version reads {key} = {known}")
        if self.kind not in law_kinds():
            kinds, again = ", ".join(sorted(law_kinds())), "fit the table again: homogenize fit TABLE --out LAW"
            self.refuse(f"kind = {shown(self.kind)}, this version reads {kinds}; {again}")


def law_kinds() -> dict[str, type[StoredLaw]]:
    """The laws that have a file, by kind: the classes of the modules in `homogenize.laws` that name one."""
    for module in pkgutil.iter_modules(laws.__path__):
        import_module(f"{laws.__name__}.{module.name}")
    return StoredLaw.kinds


def default_law() -> StoredLaw:
    """The law for r1/r2 = 10 that ships inside the package, made from the 190 rows of the paper's grid."""
    return load_law(DEFAULT_LAW)


@checked
def strength_of_law(law: MembraneLaw) -> Strength | None:
    """The strength of the rings behind `law`; None if it has none, as laws without a file and those of old tables."""
    return law.strength if isinstance(law, StoredLaw) else None


def load_law(path: str | Path) -> StoredLaw:
    """The law in the file `path`, with its provenance, error report and strength.

    InputError names file, key and value of what this version does not read.
    """
    with read_as("law", path):
        found = read_typed(LawEntries, read_json_object(path), f"{path}:")
    strength = found.strength
    check_rings(found.cell or {}, f"{path}: cell")
    return replace(
        law_kinds()[found.kind].from_dict(found.parameters, f"{path}: parameters"),
        cell=None if found.cell is None else read_typed(CellInfo, found.cell, f"{path}: cell"),
        strength=None if strength is None else read_strength(strength, f"{path}: strength"),
        provenance=found.provenance or {},
    )
