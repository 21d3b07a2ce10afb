"""What every law of this package has beside its mechanics: rings, provenance, error report, file, picture."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from homogenize.laws.protocol import MembraneLaw
from homogenize.laws.report import ErrorReport, report_from_dict
from homogenize.strength import Strength
from rve.common.errors import require
from rve.common.notebook import as_html
from rve.common.storage.files import write_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCHEMA = 1
UNITS = {"strain": "1", "line_load": "N/mm", "stiffness": "N/mm", "length": "mm"}


class StoredLaw(MembraneLaw, Protocol):
    """Base of the laws that have a file. `provenance` says where the law comes from: table, options, error report.

    strength: that of the rings (`homogenize.strength`), None if the table of the law has none.
    """

    provenance: dict[str, Any]
    strength: Strength | None

    @property
    def report(self) -> ErrorReport | None:
        """How wrong the law can be; None for a law that was not fitted. InputError if its file holds no such report."""
        return report_from_dict(self.provenance["report"]) if "report" in self.provenance else None

    def save(self, path: str | Path) -> None:
        """Writes the law file `path` (atomic: it is complete or absent); `homogenize.load_law` reads it."""
        save_law(self, path)

    def plot(self, ax: Axes | None = None) -> Axes:
        """The admissible strains at constant shear, E22 over E11, on `ax` or on axes of their own (matplotlib)."""
        require("matplotlib", "plots", "plot()", "evaluate law.support")
        from homogenize.laws.picture import plot_sections

        return plot_sections(self, ax=ax)

    def plot_strength(self, yield_N_per_mm2: float | None = None, axes: Any = None) -> Any:
        """Locking surface, first yield and collapse on three axes; see `homogenize.laws.picture`."""
        require("matplotlib", "plots", "plot_strength()", "evaluate law.strength.utilisation")
        from homogenize.laws.picture import plot_strength

        return plot_strength(self, self.strength, yield_N_per_mm2, axes)

    def __str__(self) -> str:
        kind = self.provenance.get("kind", self.name)
        rings = "" if self.cell is None else f", r1 = {self.cell.r1_mm:g} mm, r2 = {self.cell.r2_mm:g} mm"
        return f"{type(self).__name__}: {kind}{rings}"

    def _repr_html_(self) -> str:
        """What a notebook shows: kind, rings, and the lines of the error report."""
        report = self.report
        return as_html(self, lines=() if report is None else report.text().splitlines())


def law_record(law: StoredLaw) -> dict[str, Any]:
    """What the file of a law holds."""
    return {
        "schema": SCHEMA,
        "kind": law.name,
        "units": UNITS,
        "cell": None if law.cell is None else asdict(law.cell),
        "parameters": law.to_dict(),
        **({} if law.strength is None else {"strength": law.strength.to_dict()}),
        "provenance": law.provenance,
    }


def save_law(law: StoredLaw, path: str | Path) -> None:
    """Writes the law to `path` (atomic: the file is complete or absent)."""
    write_text(Path(path), json.dumps(law_record(law), indent=1) + "\n")
