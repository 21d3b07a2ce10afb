"""The error report of a law: records that a law file holds. `homogenize.fitting.report` computes them."""

from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta

from homogenize.laws.rows import UnitTrace
from rve.common import Typed

Count = Annotated[int, Meta(ge=0, le=1_000_000)]
Size = Annotated[float, Meta(ge=0.0, le=1e300)]


@dataclass(frozen=True)
class Misfit(Typed):
    """Largest and mean error of the support at unit trace of S, where it is largest, over `count` loads."""

    count: Count
    maximum: Size
    mean: Size
    worst_S: tuple[UnitTrace, UnitTrace, UnitTrace]

    def text(self, title: str) -> str:
        """The numbers on a line."""
        S = ", ".join(f"{x:.4f}" for x in self.worst_S)
        return f"{title}: max {self.maximum:.2e} at S = ({S}), mean {self.mean:.2e}, {self.count} loads"


@dataclass(frozen=True)
class ErrorReport(Typed):
    """The error of a law; supports at unit trace of S, so that they compare with strains.

    `rows`: the law at the rows it was fitted to. `held_out`: rows left out in turn, the law refitted without them; None
    where no refit was possible. `gap`: outer minus inner bound at random tensile loads, with no reference at all.
    `below`, `above`: by how much the law leaves the two bounds there, zero if it stays between.
    """

    kind: str
    normality: str
    rows: Misfit
    held_out: Misfit | None
    gap: Misfit
    below: Size
    above: Size
    not_unique: Count
    dropped: tuple[str, ...]

    def text(self) -> str:
        """The report in lines that a person reads."""
        lines, count = [f"{self.kind} law: {self.normality}"], len(self.dropped)
        if count:
            lines.append(
                f"left out or mended: {'; '.join(self.dropped[:5])}{f'; and {count - 5} more' if count > 5 else ''}"
            )
        if self.not_unique:
            lines.append(f"{self.not_unique} rows have no unique strain: theirs is one of many")
        lines.append(self.rows.text("error of h at the rows"))
        if self.held_out is not None:
            lines.append(self.held_out.text("error of h at rows left out"))
        left = f"the law leaves the bounds by {self.below:.1e} below, {self.above:.1e} above (h at unit trace of S)"
        return "\n".join([*lines, self.gap.text("outer minus inner bound of h"), left])

    __str__ = text
