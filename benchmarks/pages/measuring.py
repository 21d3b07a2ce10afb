"""Seconds, first digits and decades, as the sections of all reports write them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def least_seconds(call: Callable[[], T], repeats: int = 3, long: float = 1.0) -> tuple[T, float]:
    """What `call` returns, and the processor seconds of its quickest run after a warm-up; one run if it takes `long`.

    Everything timed here runs on one thread, so that processor time is wall time on a machine of its own.

    >>> least_seconds(lambda: 2 + 3)[0]
    5
    """
    began = time.process_time()
    value = call()
    first = time.process_time() - began
    if first >= long:
        return value, first
    times = []
    for _ in range(repeats):
        began = time.process_time()
        value = call()
        times.append(time.process_time() - began)
    return value, min(times)


def decade(error: float, floor: float = 1e-12) -> str:
    """An error by its first digit, or "<= 1e-12" (`floor`) where only round-off is left.

    >>> decade(3.4e-5), decade(2e-15), decade(math.nan)
    ('3e-05', '<= 1e-12', '-')
    """
    if not math.isfinite(error):
        return "-"
    return f"<= {floor:.0e}" if error <= floor else f"{error:.0e}"


def at_most(value: float, least: float = 0.0) -> str:
    """The power of ten that bounds |value| from above, no less than `least`: the same text when round-off moves digits.

    >>> at_most(-3e-13), at_most(3.2e-12, 1e-14), at_most(0.0, 1e-14), at_most(0.0)
    ('<= 1e-12', '<= 1e-11', '<= 1e-14', '0')
    """
    size = max(abs(float(value)), least)
    if not math.isfinite(value):
        return "-"
    return f"<= 1e{math.ceil(math.log10(size) - 1e-9)}" if size else "0"
