"""Law files are read here: JSON with a schema version, units, provenance and the checksum of the table behind the law.

`homogenize.laws.stored` writes them.
"""

import pkgutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from homogenize import laws
from homogenize.laws.net import STATED_STIFFNESS
from homogenize.laws.polyhedral import PolyhedralLaw
from homogenize.laws.protocol import check_law
from homogenize.laws.report import ErrorReport
from homogenize.laws.rows import read_rows
from homogenize.laws.stored import SCHEMA, UNITS, Law
from homogenize.laws.strength import read_strength
from rve.common import (
    InputError,
    JsonObject,
    Typed,
    read_as,
    read_json_object,
    read_typed,
    refuse_unknown,
    shown,
    types_of,
)
from rve.common.cell_fields import ArealMass
from rve.common.plugins import load_installed
from rve.geometry import CellInfo, read_cell_info

DEFAULT_LAW = Path(__file__).parent / "data" / "rings_10.json"
"""The file of `default_law`."""


@dataclass(frozen=True)
class LawEntries(Typed):
    """What a law file holds."""

    kind: str
    parameters: JsonObject
    schema: Any = SCHEMA
    units: Any = None
    cell: JsonObject | None = None
    plugin: str | None = None
    strength: JsonObject | None = None
    provenance: JsonObject | None = None
    stiffness_is_measured: bool | None = None
    areal_mass_kg_per_m2: ArealMass | None = None

    def check(self) -> None:
        for key, found, known in (("schema", self.schema, SCHEMA), ("units", self.units, UNITS)):
            if found not in (None, known):
                self.refuse(f"{key} = {shown(found)}, this version reads {key} = {known}")
        if self.kind not in law_kinds() and self.plugin is not None:
            given = f"give --plugin {self.plugin}" if self.plugin.endswith(".py") else f"install {self.plugin}"
            self.refuse(f"kind = {shown(self.kind)}: is of the plugin {self.plugin}, which is not loaded; {given}")
        if self.kind not in law_kinds():
            kinds, again = ", ".join(sorted(law_kinds())), "fit the table again: homogenize fit TABLE --out LAW"
            self.refuse(f"kind = {shown(self.kind)}, this version reads {kinds}; {again}")


def law_kinds() -> dict[str, type[Law]]:
    """The laws that have a file, by kind: the classes of the modules in `homogenize.laws` that name one."""
    for module in pkgutil.iter_modules(laws.__path__):
        import_module(f"{laws.__name__}.{module.name}")
    load_installed()
    return Law.kinds


def default_law() -> PolyhedralLaw:
    """The law for r1/r2 = 10 that ships inside the package, made from the 190 rows of the paper's grid."""
    law = load_law(DEFAULT_LAW)
    assert isinstance(law, PolyhedralLaw)
    return law


def load_law(path: str | Path) -> Law:
    """The law in the file `path`, with its rings, rows, error report and strength.

    InputError names file, key and value of what this version does not read.
    """
    with read_as("law", path):
        entries = read_typed(LawEntries, read_json_object(path), f"{path}:")
    where, provenance = f"{path}:", dict(entries.provenance or {})
    rows, report = provenance.pop("table_rows", None), provenance.pop("report", None)
    strength = None if entries.strength is None else read_strength(entries.strength, f"{where} strength")
    cell = None if entries.cell is None else _read_cell(entries.cell, provenance, f"{where} cell")
    if cell is not None and strength is not None:
        cell = replace(cell, material=strength.material)
    law = replace(
        law_kinds()[entries.kind].from_dict(entries.parameters, f"{where} parameters"),
        cell=cell,
        strength=strength,
        rows=None if rows is None else read_rows(rows, f"{where} provenance table_rows:"),
        report=None if report is None else read_typed(ErrorReport, report, f"{where} provenance report:"),
        stiffness_is_measured=_is_measured(entries, provenance),
        areal_mass_kg_per_m2=entries.areal_mass_kg_per_m2,
        provenance=provenance,
    )
    check_law(law)
    return law


def _read_cell(cell: Mapping[str, Any], provenance: Mapping[str, Any], where: str) -> CellInfo:
    """The rings of a law. What files before version 0.3 do not tell is told by the sidecar of their table, else by the
    sides of the reference cell."""
    refuse_unknown(cell, types_of(CellInfo), where)
    sidecar = provenance.get("table_provenance")
    sidecar = sidecar if isinstance(sidecar, dict) else {}
    options = sidecar.get("options")
    beside = sidecar | (options if isinstance(options, dict) else {})
    told = {key: beside[key] for key in ("weave", "grain", "reference", "material") if key in beside} | dict(cell)
    info = read_cell_info(told, where)
    if "weave" in told:
        return info
    from rve.finite import cell_of_sides  # which brings the solver of every ring

    try:
        mesh = cell_of_sides(info.r1_mm, info.r2_mm, info.sides_mm)
    except InputError:
        return replace(info, weave=None)
    return replace(info, weave=mesh.weave.name, grain=mesh.grain)


def _is_measured(entries: LawEntries, provenance: Mapping[str, Any]) -> bool:
    """Whether the stiffness is that of the rings: files before version 0.3 say so in words, or by a stated number."""
    if entries.stiffness_is_measured is not None:
        return entries.stiffness_is_measured
    if "stiffness" in provenance:
        return not str(provenance["stiffness"]).startswith("stated")
    stated = STATED_STIFFNESS, (STATED_STIFFNESS * np.eye(3)).tolist()
    return entries.parameters.get("stiffness_N_per_mm", STATED_STIFFNESS) not in stated
