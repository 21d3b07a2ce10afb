"""Records of a report: sections of tables and diagrams, as data that JSON keeps and Markdown and HTML show.

A column or diagram that holds wall times, or what is made of them, says so (`timed`): everything else comes out the
same when the report is made again, and `differences` checks it.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

Value = str | int | float | None


@dataclass(frozen=True)
class Column:
    """Name with unit, how numbers are written, and whether they depend on the machine's speed."""

    name: str
    form: str = ".3g"
    timed: bool = False


@dataclass(frozen=True)
class Table:
    """Rows under columns; a number that does not exist (a failed run) is None and is shown as a dash."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Value, ...], ...]
    note: str = ""

    def __post_init__(self) -> None:
        """Rows as long as the columns are many."""
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table '{self.title}': {len(row)} values under {len(self.columns)} columns: {row}")


@dataclass(frozen=True)
class Curve:
    """One method's ladder, in the order of the ladder; pairs that are not finite are left out of the picture.

    `joined` by a line, or a choice of things that are no ladder.
    """

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    joined: bool = True


@dataclass(frozen=True)
class Diagram:
    """Curves over logarithmic axes, or (`bars`) one bar for each x = 0, 1, 2... with the names of `ticks`.

    Bars stand on `base`: 1 where they are ratios, so that those below 1 hang.
    """

    key: str
    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    bars: bool = False
    ticks: tuple[str, ...] = ()
    base: float = 0.0


@dataclass(frozen=True)
class Section:
    """One topic: what was done (Markdown), tables, diagrams, and what follows from them (Markdown)."""

    key: str
    title: str
    text: str
    tables: tuple[Table, ...] = ()
    diagrams: tuple[Diagram, ...] = ()
    conclusion: str = ""
    machine: str = ""
    seconds: float = math.nan


@dataclass(frozen=True)
class Report:
    """A title page and sections; `command` makes it again."""

    key: str
    title: str
    text: str
    command: str
    sections: tuple[Section, ...] = field(default=())


def to_json(report: Report) -> dict[str, Any]:
    """The report as plain data, with None for numbers that are not finite."""
    return _plain(asdict(report))


def from_json(data: dict[str, Any]) -> Report:
    """The report of `to_json`; KeyError or TypeError if the data is none."""
    sections = tuple(
        Section(
            **{
                **section,
                "tables": tuple(_table(table) for table in section["tables"]),
                "diagrams": tuple(_diagram(diagram) for diagram in section["diagrams"]),
                "seconds": math.nan if section["seconds"] is None else section["seconds"],
            }
        )
        for section in data["sections"]
    )
    return Report(**{**data, "sections": sections})


def differences(first: Report, second: Report) -> list[str]:
    """Where two runs of a report disagree, times aside: one sentence each, none if they are the same."""
    found = []
    ours, theirs = ({section.key: section for section in report.sections} for report in (first, second))
    for key in ours.keys() ^ theirs.keys():
        found.append(f"section {key} is in one of them only")
    for key in ours.keys() & theirs.keys():
        tables = zip(ours[key].tables, theirs[key].tables, strict=False)
        if len(ours[key].tables) != len(theirs[key].tables):
            found.append(f"section {key} has {len(ours[key].tables)} tables, or {len(theirs[key].tables)}")
        for a, b in tables:
            found += [f"{key}, {a.title}: {one} or {two}" for one, two in _unequal_rows(a, b)]
    return found


def shown(value: Value, form: str) -> str:
    """A cell as text."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "-"
    if isinstance(value, str):
        return value
    return f"{value:,d}" if isinstance(value, int) else format(value, form)


def _unequal_rows(a: Table, b: Table) -> list[tuple[list[str], list[str]]]:
    if a.columns != b.columns or len(a.rows) != len(b.rows):
        return [([f"{len(a.rows)} rows"], [f"{len(b.rows)} rows"])]
    kept = [i for i, column in enumerate(a.columns) if not column.timed]
    pairs = []
    for one, two in zip(a.rows, b.rows, strict=True):
        texts = [[shown(row[i], a.columns[i].form) for i in kept] for row in (one, two)]
        if texts[0] != texts[1]:
            pairs.append((texts[0], texts[1]))
    return pairs


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.item() if hasattr(value, "item") else value


def _table(data: dict[str, Any]) -> Table:
    columns = tuple(Column(**column) for column in data["columns"])
    return Table(data["title"], columns, tuple(tuple(row) for row in data["rows"]), data["note"])


def _diagram(data: dict[str, Any]) -> Diagram:
    curves = tuple(
        Curve(**{**curve, **{axis: tuple(math.nan if v is None else v for v in curve[axis]) for axis in ("x", "y")}})
        for curve in data["curves"]
    )
    return Diagram(**{**data, "curves": curves, "ticks": tuple(data["ticks"])})
