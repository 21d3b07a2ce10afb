"""Clocks and processes, and the text of errors and statuses, alike in all reports."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
T = TypeVar("T")
Row = dict[str, Any]
"""One row of a table: a value for each column name. A name that begins with "_" is no column: its value is kept for
diagrams and conclusions."""


def least_seconds(call: Callable[[], T], repeats: int = 3, long: float = 1.0) -> tuple[T, float]:
    """The answer of `call`, and the processor seconds of its quickest run after a warm-up; one run if it takes `long`.

    Everything timed here runs on one thread: processor time is the wall time on an otherwise idle machine.
    """
    times: list[float] = []
    while True:
        began = time.process_time()
        value = call()
        times.append(time.process_time() - began)
        if len(times) > repeats or times[0] >= long:
            return value, min(times[1:] or times)


def ladder(
    method: str,
    rungs: Mapping[str, Callable[[], T]],
    judge: Callable[[T, float], Row],
    repeats: int = 3,
    long: float = 1.0,
) -> list[Row]:
    """A row for each setting of a method: the names of both, and what `judge` makes of the answer and its seconds."""
    timed = {setting: least_seconds(call, repeats, long) for setting, call in rungs.items()}
    return [{"method": method, "setting": setting} | judge(*found) for setting, found in timed.items()]


def decade(error: float, floor: float = 1e-12) -> str:
    """An error by its first digit, or "<= 1e-12" (`floor`) where it is round-off.

    >>> decade(3.4e-5), decade(2e-15), decade(math.nan)
    ('3e-05', '<= 1e-12', '-')
    """
    if not math.isfinite(error):
        return "-"
    return f"<= {floor:.0e}" if error <= floor else f"{error:.0e}"


def signed(error: float, floor: float, digits: float = 1) -> str:
    """An error with its sign and that many digits, or "<= 1e-06" (`floor`) where its size is below the floor.

    >>> signed(-3.4e-5, 1e-6), signed(2e-7, 1e-6), signed(math.nan, 1e-6)
    ('-3e-05', '<= 1e-06', '-')
    """
    text = decade(abs(error), floor)
    return f"{error:+.{digits - 1:.0f}e}" if text[0].isdigit() else text


def at_most(value: float, least: float = 0.0) -> str:
    """The power of ten that bounds |value| from above, at least `least`: the same text when round-off moves digits.

    >>> at_most(-3e-13), at_most(3.2e-12, 1e-14), at_most(0.0, 1e-14), at_most(0.0)
    ('<= 1e-12', '<= 1e-11', '<= 1e-14', '0')
    """
    size = max(abs(float(value)), least)
    if not math.isfinite(value):
        return "-"
    return f"<= 1e{math.ceil(math.log10(size) - 1e-9)}" if size else "0"


TEXTS: dict[str, Callable[..., str]] = {"decade": decade, "at_most": at_most, "signed": signed}
"""Forms of columns that make text of a number; arguments follow the name: `decade 1e-9`."""


def outcomes(status: Any) -> str:
    """Statuses and how many of each, "converged" first.

    >>> outcomes(["stalled", "converged", "converged"])
    '2 converged, 1 stalled'
    """
    names, counts = np.unique(np.asarray(status), return_counts=True)
    order = sorted(zip(names, counts, strict=True), key=lambda one: (one[0] != "converged", one[0]))
    return ", ".join(f"{count} {name}" for name, count in order)


def count_of(flags: Sequence[Any]) -> str:
    """How many of them are true, "2 of 3"."""
    return f"{sum(map(bool, flags)):,} of {len(flags):,}"
