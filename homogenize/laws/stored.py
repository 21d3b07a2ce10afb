"""What laws have in common apart from mechanics: rings, provenance, error report, file, picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

from homogenize.laws.protocol import MembraneLaw
from homogenize.laws.report import ErrorReport
from homogenize.laws.rows import LockedRows
from homogenize.laws.strength import Strength
from rve.common import checked, json_text, write_text
from rve.common.optional import Axes
from rve.geometry import CellInfo

SCHEMA = 1
UNITS = {"strain": "1", "line_load": "N/mm", "stiffness": "N/mm", "length": "mm"}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class StoredLaw(MembraneLaw):
    """Base of the laws that have a file: `class ClothLaw(StoredLaw, kind="cloth")` registers the kind of their files.

    cell: the rings behind the law. rows: what it was fitted to. report: how wrong it can be; both None for a law that
    was not fitted. strength: that of the rings (`homogenize.laws.strength`), None if the table of the law has none.
    stiffness_is_measured: whether the stiffness is that of the rings, by their table, or else a stated number.
    provenance: what else its file tells of its origin.
    """

    kinds: ClassVar[dict[str, type[StoredLaw]]] = {}
    kind: ClassVar[str]
    cell: CellInfo | None = None
    provenance: dict[str, Any] = field(default_factory=dict)
    strength: Strength | None = None
    rows: LockedRows | None = None
    report: ErrorReport | None = None
    stiffness_is_measured: bool = False

    def __init_subclass__(cls, kind: str | None = None) -> None:
        """Register the kind of law for `homogenize.load_law`; without a kind it is that of the base."""
        super().__init_subclass__()
        if kind is not None:
            cls.kind, StoredLaw.kinds[kind] = kind, cls

    def to_dict(self) -> dict[str, Any]:
        """The parameters of the law as plain numbers, lists and strings: what its file holds."""
        raise NotImplementedError

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], where: str) -> Self:
        """The law whose `to_dict` wrote `data`; InputError, which begins with `where`, for what is none."""
        raise NotImplementedError

    @property
    def name(self) -> str:
        return self.kind

    def elastic(self) -> MembraneLaw:
        """The law itself, whose compliance is constant."""
        return self

    def softer(self, factor: float) -> Self:
        """The law of rings `factor` times as compliant; the law itself if its stiffness is not that of rings."""
        return self

    @checked
    def save(self, path: str | Path) -> None:
        """Writes the law file `path` (atomic: it is complete or absent); `homogenize.load_law` reads it."""
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


def known(record: dict[str, Any], key: str) -> dict[str, Any]:
    """The record without this key where it has no value."""
    return record if record[key] is not None else {name: value for name, value in record.items() if name != key}


def law_record(law: StoredLaw) -> dict[str, Any]:
    """What the file of a law holds."""
    rows = {} if law.rows is None else {"table_rows": law.rows.to_dict()}
    report = {} if law.report is None else {"report": asdict(law.report)}
    return {
        "schema": SCHEMA,
        "kind": law.name,
        "units": UNITS,
        "cell": None if law.cell is None else known(asdict(law.cell), "drawing"),
        "parameters": law.to_dict(),
        "stiffness_is_measured": law.stiffness_is_measured,
        **({} if law.strength is None else {"strength": law.strength.to_dict()}),
        "provenance": law.provenance | rows | report,
    }


@checked
def strength_of_law(law: MembraneLaw) -> Strength | None:
    """The strength of the rings behind `law`; None if it has none, as laws without a file and those of old tables."""
    return law.strength if isinstance(law, StoredLaw) else None
