"""What laws have in common apart from mechanics: rings, provenance, error report, file, picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from homogenize.laws.geometry import Polyhedron, highest, outer_vertices, polyhedron_of, respond
from homogenize.laws.protocol import Cut, HalfSpaces, MembraneLaw, Response, check_finite, check_law
from homogenize.laws.report import ErrorReport
from homogenize.laws.rows import LockedRows
from homogenize.laws.strength import Strength
from rve.common import (
    Array,
    InputError,
    JsonObject,
    checked,
    json_text,
    read_entry,
    refuse_unknown,
    types_of,
    write_text,
)
from rve.common.optional import Axes
from rve.common.plugins import plugin_of, register
from rve.common.tensor import WEIGHT
from rve.geometry import CellInfo

SCHEMA = 1
UNITS = {"strain": "1", "line_load": "N/mm", "stiffness": "N/mm", "length": "mm"}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Law(MembraneLaw):
    """Base of laws: `class ClothLaw(Law, kind="cloth")` registers the kind of their files.

    A law is a set of half-spaces S:E <= h. One of a few gives them all by `half_spaces`, and `compliance` if it
    stretches beyond them; one of many gives some to start with, and `support` and `cut`. Its other fields are its
    parameters, which its file holds under their names.

    cell: the rings behind the law. rows: what it was fitted to. report: how wrong it can be; both None for a law that
    was not fitted. strength: that of the rings (`homogenize.laws.strength`), None if the table of the law has none.
    stiffness_is_measured: whether the stiffness is that of the rings, by their table, or else a stated number.
    areal_mass_kg_per_m2: of a mesh whose rings are not known; None where it is not known, or is that of the cell.
    provenance: what else its file tells of its origin.
    """

    kinds: ClassVar[dict[str, type[Law]]] = {}
    kind: ClassVar[str] = ""
    cell: CellInfo | None = None
    provenance: JsonObject = field(default_factory=dict)
    strength: Strength | None = None
    rows: LockedRows | None = None
    report: ErrorReport | None = None
    stiffness_is_measured: bool = False
    areal_mass_kg_per_m2: float | None = None

    def __init_subclass__(cls, kind: str | None = None) -> None:
        """Register the kind of law for `homogenize.load_law`; without a kind it is that of the base."""
        super().__init_subclass__()
        if kind is not None:
            cls.kind = kind
            register(Law.kinds, kind, cls)

    @property
    def compliance(self) -> Array:
        return np.zeros((3, 3))

    def half_spaces(self) -> HalfSpaces:
        raise InputError(f"{type(self).__name__} has none: return homogenize.laws.HalfSpaces(S, h)")

    def support(self, S: Array) -> Array:
        check_finite(S, "line loads")
        return highest(S, self._vertices)

    def cut(self, E: Array) -> Cut:
        """The half-space of `half_spaces` that each E (n, 3) violates most."""
        check_finite(E)
        first = self.half_spaces()
        beyond = E @ (first.S * WEIGHT).T - first.h
        worst = beyond.argmax(axis=1)
        return Cut(first.S[worst], first.h[worst], beyond.max(axis=1))

    def response(self, E: Array) -> Response:
        check_finite(E)
        if not self.compliance.any():
            raise InputError(f"a law of kind {self.name} does not stretch, it has no response: use kind = 'rigid'")
        return respond(E, self._polyhedron)

    @cached_property
    def _vertices(self) -> Array:
        first = self.half_spaces()
        return outer_vertices(first.S, first.h)

    @cached_property
    def _polyhedron(self) -> Polyhedron:
        first = self.half_spaces()
        return polyhedron_of(first.S, first.h, np.asarray(np.linalg.inv(self.compliance)))

    def to_dict(self) -> JsonObject:
        """The parameters of the law as plain numbers, lists and strings: what its file holds."""
        values = (vars(self)[name] for name in parameters_of(type(self)))
        plain = (value.tolist() if isinstance(value, np.ndarray | np.generic) else value for value in values)
        return dict(zip(parameters_of(type(self)), plain, strict=True))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], where: str) -> Self:
        """The law whose `to_dict` wrote `data`; InputError, which begins with `where`, for what is none."""
        kinds = parameters_of(cls)
        refuse_unknown(data, kinds, where)
        needed = {item.name for item in fields(cls) if item.default is MISSING and item.default_factory is MISSING}
        given = kinds.keys() & (needed | data.keys())
        return cls(**{name: read_entry(data, name, kinds[name], where) for name in given})

    @property
    def name(self) -> str:
        return self.kind or type(self).__name__

    def elastic(self) -> MembraneLaw:
        """The law itself, whose compliance is constant."""
        return self

    def softer(self, factor: float) -> Self:
        """The law of rings `factor` times as compliant; the law itself if its stiffness is not that of rings."""
        return self

    @checked
    def save(self, path: str | Path) -> None:
        """Writes the law file `path` (atomic: it is complete or absent); `homogenize.load_law` reads it."""
        if not self.kind:
            raise InputError(f"{self.name}: has no word for its file: class {self.name}(Law, kind='word')")
        check_law(self)
        write_text(path, json_text(law_record(self), indent=1))

    def plot(self, ax: Axes | None = None) -> Axes:
        """The admissible strains at constant shear, E22 over E11, on `ax` or on axes of their own (matplotlib)."""
        from homogenize.laws.pictures import plot_sections

        return plot_sections(self, ax=ax)

    def plot_strength(self, yield_N_per_mm2: float | None = None, axes: Any = None) -> Any:
        """Locking surface, first yield and collapse on three axes; see `homogenize.laws.pictures`."""
        from homogenize.laws.pictures import plot_strength

        return plot_strength(self, self.strength, yield_N_per_mm2, axes)

    def __str__(self) -> str:
        kind = self.name if self.report is None else self.report.kind
        rings = "" if self.cell is None else f", r1 = {self.cell.r1_mm:g} mm, r2 = {self.cell.r2_mm:g} mm"
        return f"{type(self).__name__}: {kind}{rings}"

    __repr__ = __str__


def known(record: JsonObject, key: str) -> JsonObject:
    """The record without this key where it has no value."""
    return record if record[key] is not None else {name: value for name, value in record.items() if name != key}


def parameters_of(cls: type[Law]) -> Mapping[str, Any]:
    """The fields of a law besides those that all laws have, with their types."""
    return {name: kind for name, kind in types_of(cls).items() if name not in types_of(Law)}


def law_record(law: Law) -> JsonObject:
    """What the file of a law holds."""
    plugin = plugin_of(type(law))
    rows = {} if law.rows is None else {"table_rows": law.rows.to_dict()}
    report = {} if law.report is None else {"report": asdict(law.report)}
    return {
        "schema": SCHEMA,
        "kind": law.name,
        **({} if plugin is None else {"plugin": plugin}),
        "units": UNITS,
        "cell": None if law.cell is None else known(asdict(law.cell), "drawing"),
        "parameters": law.to_dict(),
        "stiffness_is_measured": law.stiffness_is_measured,
        **({} if law.strength is None else {"strength": law.strength.to_dict()}),
        **({} if law.areal_mass_kg_per_m2 is None else {"areal_mass_kg_per_m2": law.areal_mass_kg_per_m2}),
        "provenance": law.provenance | rows | report,
    }


@checked
def strength_of_law(law: MembraneLaw) -> Strength | None:
    """The strength of the rings behind `law`; None if it has none, as laws without a file and those of old tables."""
    return law.strength if isinstance(law, Law) else None
