"""What every section says in the same words: outcomes, refusals, what is noise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

R_NOISE, GAP_NOISE = 1e-11, 1e-12
"""Weighted residual, and overlap in mm, below which digits are round-off: shown as this bound."""


def outcomes(status: Any) -> str:
    """Statuses and how many of each, "converged" first.

    >>> outcomes(["stalled", "converged", "converged"])
    '2 converged, 1 stalled'
    """
    names, counts = np.unique(np.asarray(status), return_counts=True)
    found = {str(name): int(count) for name, count in zip(names, counts, strict=True)}
    order = sorted(found, key=lambda name: (name != "converged", name))
    return ", ".join(f"{found[name]} {name}" for name in order)


def refusal(act: Callable[[], object]) -> str:
    """The one sentence with which input is refused, or "accepted"."""
    try:
        act()
    except ValueError as error:
        return str(error)
    return "accepted"
