"""The error report of a law: records that a law file holds. `homogenize.fitting.report` computes them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from rve.common.values import finite, integer, list_of, numbers, optional, read_record, string

MOST_ROWS = 1_000_000
"""Limit of counts and of lists in a law file."""
_count, _size = integer(0, MOST_ROWS), finite(least=0.0)


@dataclass(frozen=True)
class Misfit:
    """Largest and mean error of the support at unit trace of S, where it is largest, over `count` loads."""

    count: int = field(metadata={"check": _count})
    maximum: float = field(metadata={"check": _size})
    mean: float = field(metadata={"check": _size})
    worst_S: tuple[float, float, float] = field(metadata={"check": lambda value: tuple(numbers(3)(value).tolist())})


def _misfit(value: Any) -> Misfit:
    return read_record(Misfit, value, "the law's report:")


@dataclass(frozen=True)
class ErrorReport:
    """What is known of a law's error; supports at unit trace of S, so that they compare with strains.

    `rows`: the law at the rows it was fitted to. `held_out`: rows left out in turn, the law refitted without them; None
    where no refit was possible. `gap`: outer minus inner bound at random tensile loads, with no reference at all.
    `below`, `above`: by how much the law leaves the two bounds there, zero if it stays between.
    """

    kind: str = field(metadata={"check": string})
    normality: str = field(metadata={"check": string})
    rows: Misfit = field(metadata={"check": _misfit})
    held_out: Misfit | None = field(metadata={"check": optional(_misfit)})
    gap: Misfit = field(metadata={"check": _misfit})
    below: float = field(metadata={"check": _size})
    above: float = field(metadata={"check": _size})
    not_unique: int = field(metadata={"check": _count})
    dropped: tuple[str, ...] = field(metadata={"check": list_of(string, "sentences", most=MOST_ROWS)})

    def text(self) -> str:
        """The report in lines that a person reads."""
        lines = [f"{self.kind} law: {self.normality}"]
        lines += _left_out(self.dropped)
        if self.not_unique:
            lines.append(f"{self.not_unique} rows have no unique strain: theirs is one of many")
        lines.append(_line("error of h at the rows", self.rows))
        if self.held_out is not None:
            lines.append(_line("error of h at rows left out", self.held_out))
        lines.append(_line("outer minus inner bound of h", self.gap))
        lines.append(
            f"the law leaves the bounds by {self.below:.1e} below, {self.above:.1e} above (h at unit trace of S)"
        )
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.text()

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for a law file."""
        return asdict(self)


def _left_out(dropped: tuple[str, ...]) -> list[str]:
    """A line for each reason for which rows are left out, and the first of them.

    >>> _left_out(("row 3: status stalled", "row 28: twice", "row 47: twice"))
    ['left out, status stalled: row 3', 'left out, twice: rows 28, 47']
    """
    rows: dict[str, list[str]] = {}
    for row, _, reason in (one.partition(": ") for one in dropped):
        rows.setdefault(reason, []).append(row.removeprefix("row "))
    return [
        f"left out, {reason}: row{'s' * (len(names) > 1)} {', '.join(names[:5])}"
        f"{f' and {len(names) - 5} more' if len(names) > 5 else ''}"
        for reason, names in rows.items()
    ]


def report_from_dict(data: Any) -> ErrorReport:
    """The report that `ErrorReport.to_dict` wrote; InputError names an entry that is missing or impossible."""
    return read_record(ErrorReport, data, "the law's report:", strict=False)


def _line(title: str, misfit: Misfit) -> str:
    S = ", ".join(f"{x:.4f}" for x in misfit.worst_S)
    return f"{title}: max {misfit.maximum:.2e} at S = ({S}), mean {misfit.mean:.2e}, {misfit.count} loads"
