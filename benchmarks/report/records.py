"""Records of a report: sections of tables and diagrams, kept as JSON and shown as Markdown and HTML.

A column that holds wall times, or numbers made of them, is marked `timed`. All other columns are reproducible, and
`differences` checks that they are.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from itertools import zip_longest
from types import MappingProxyType
from typing import Any, get_args, get_origin, get_type_hints

from benchmarks.report.measure import Row, at_most, decade, signed

Value = str | int | float | None
TEXTS: dict[str, Callable[..., str]] = {"decade": decade, "at_most": at_most, "signed": signed}
"""Forms that make text of a number, see `benchmarks.report.measure`; arguments follow the name: `decade 1e-9`."""


@dataclass(frozen=True)
class Column:
    """Name with unit, format of numbers, and whether they depend on the machine's speed."""

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
        """ValueError unless every row is as long as the columns are many."""
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table '{self.title}': {len(row)} values under {len(self.columns)} columns: {row}")


@dataclass(frozen=True)
class Curve:
    """The ladder of one method; pairs that are not finite are left out. Without `joined`, points without a line."""

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    joined: bool = True


@dataclass(frozen=True)
class Diagram:
    """Curves over logarithmic axes, or (`bars`) a bar for each x = 0, 1, 2... with the names in `ticks`.

    Bars start at `base`: 1 where they are ratios, so that bars of ratios below 1 point downwards.
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
    """One topic: what was done (Markdown), tables, diagrams, and the conclusion computed from them (Markdown).

    `key`, `machine` and `seconds` are filled in by the command that measures the section.
    """

    title: str
    text: str
    tables: tuple[Table, ...] = ()
    diagrams: tuple[Diagram, ...] = ()
    conclusion: str = ""
    key: str = ""
    machine: str = ""
    seconds: float = math.nan


@dataclass(frozen=True)
class Report:
    """Title, introduction and sections; `command` makes the report again."""

    key: str
    title: str
    text: str
    command: str
    sections: tuple[Section, ...] = ()


def table(title: str, rows: Sequence[Row], forms: Mapping[str, str] = MappingProxyType({}), note: str = "") -> Table:
    """The rows as a table; the longest row gives the columns, shorter ones (failed runs) have dashes in the others.

    `forms` says how a column is written (`.3g` if it is not named): a format of Python or one of `TEXTS`, and `timed`
    where the values depend on the speed of the machine. ValueError for a form or a value without a column.

    >>> rows = [{"n": 1, "error": 3.4e-5, "s": 2.0}, {"n": 2}]
    >>> table("Runs", rows, {"error": "decade", "s": ".1f timed"}).rows
    ((1, '3e-05', 2.0), (2, None, None))
    """
    heads = _heads(max(rows, key=len, default=forms))
    if unknown := {*forms, *(head for row in rows for head in _heads(row))} - {*heads}:
        raise ValueError(f"table '{title}': no columns {sorted(unknown)} among {heads}")
    written = {head: forms.get(head, "") for head in heads}
    cells = tuple(tuple(_cell(row.get(head), form) for head, form in written.items()) for row in rows)
    return Table(title, tuple(_column(*one) for one in written.items()), cells, note)


def curves(rows: Sequence[Row], by: str, x: str, y: str) -> tuple[Curve, ...]:
    """A curve of the columns x and y for each value in the column `by`, in the order of the rows."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row[by], []).append(row)
    return tuple(
        Curve(name, tuple(float(row[x]) for row in mine), tuple(float(row[y]) for row in mine))
        for name, mine in groups.items()
    )


def to_json(report: Report) -> dict[str, Any]:
    """The report as plain data, with None for numbers that are not finite."""
    plain: dict[str, Any] = _plain(asdict(report))
    return plain


def from_json(data: dict[str, Any]) -> Report:
    """The report of `to_json`; KeyError or TypeError if the data is no report."""
    report: Report = _record(Report, data)
    return report


def differences(first: Report, second: Report) -> list[str]:
    """The rows in which two runs of a report disagree, apart from times, as "one or the other"."""
    pairs = zip_longest(_lines(first), _lines(second), fillvalue="no row")
    return [f"{one} or {two}" for one, two in pairs if one != two]


def shown(value: Value, form: str) -> str:
    """A cell as text."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "-"
    if isinstance(value, str):
        return value
    return f"{value:,d}" if isinstance(value, int) else format(value, form)


def _lines(report: Report) -> list[str]:
    """Every row of every table as text, without columns that are timed."""
    tables = [(f"{section.key}, {table.title}", table) for section in report.sections for table in section.tables]
    lines = []
    for name, table in tables:
        for row in table.rows:
            cells = [(c.name, shown(v, c.form)) for v, c in zip(row, table.columns, strict=True) if not c.timed]
            lines.append(f"{name}: " + "; ".join(f"{head} {text}" for head, text in cells))
    return lines


def _heads(row: Mapping[str, Any]) -> list[str]:
    return [head for head in row if not head.startswith("_")]


def _column(head: str, form: str) -> Column:
    formats = [word for word in form.split() if word != "timed"]
    is_text = bool(formats) and formats[0] in TEXTS
    return Column(head, ".3g" if is_text or not formats else formats[0], "timed" in form.split())


def _cell(value: Any, form: str) -> Value:
    """The value as JSON keeps it: numbers of the standard types, text where the form asks for it."""
    value = value.item() if hasattr(value, "item") else value
    name, *arguments = form.split() or [""]
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None or isinstance(value, str) or name not in TEXTS:
        return value
    return TEXTS[name](value, *map(float, arguments))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.item() if hasattr(value, "item") else value


def _record(kind: Any, data: Any) -> Any:
    """The record of this kind, or what a field of this kind holds: None stands for nan where a number is due."""
    if is_dataclass(kind):
        make: Any = kind
        kinds = get_type_hints(kind)
        return make(**{name: _record(kinds[name], value) for name, value in data.items()})
    if get_origin(kind) is tuple:
        return tuple(_record(get_args(kind)[0], part) for part in data)
    return math.nan if data is None and kind is float else data
