"""From a table to the rows of a law, tested before anything is fitted to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from homogenize.laws.rows import ROUNDING, LockedRows, with_mirror
from rve.common import InputError
from rve.common.tensor import WEIGHT, double_dot, eigenvalues, trace

if TYPE_CHECKING:
    from rve import StrainTable

NORMALITY_TOLERANCE = 1e-8


@dataclass(frozen=True, eq=False)
class Normality:
    """How well rows belong to one convex set: `slack` = min over all pairs of S_i:(E_i - E_j), zero or negative.

    `worst` (i, j) are the row numbers of the worst pair; `blamed` the fewest rows, found greedily, without which all
    pairs are within `tolerance`.
    """

    slack: float
    worst: tuple[int, int]
    blamed: tuple[int, ...]
    tolerance: float

    @property
    def holds(self) -> bool:
        """True if no pair of rows contradicts convexity by more than the tolerance."""
        return self.slack >= -self.tolerance

    def sentence(self) -> str:
        if self.holds:
            return f"normality holds: S_i:(E_i - E_j) >= {self.slack:.1e} for all pairs of rows"
        rows = ", ".join(str(i) for i in self.blamed[:10]) + (", ..." if len(self.blamed) > 10 else "")
        return (
            f"the rows do not lie on one convex set: S_i:(E_i - E_j) = {self.slack:.3e} for rows {self.worst[0]} and "
            f"{self.worst[1]} (allowed {-self.tolerance:.0e}); without rows {rows} the others agree, and --noise "
            f"{-1.1 * self.slack:.0e} fits a law that is off by as much there"
        )


def rows_from_table(table: StrainTable) -> LockedRows:
    """Hermite data of the converged rows of a table; row numbers count from 0 in the table's order.

    Failed rows, rows that are not tensile and exact duplicates are dropped by name. InputError if nothing is left.
    """
    size = trace(table.S)
    finite = np.isfinite(table.S).all(axis=1) & np.isfinite(table.E).all(axis=1)
    ok = table.converged & finite & (size > 0.0)
    tensile = eigenvalues(table.S)[0] >= -ROUNDING * size
    dropped = [f"row {i}: status {table.status[i]}" for i in np.flatnonzero(~table.converged)]
    dropped += [f"row {i}: not a finite load with S11 + S22 > 0" for i in np.flatnonzero(table.converged & ~ok)]
    dropped += [f"row {i}: the load is not tensile" for i in np.flatnonzero(ok & ~tensile)]
    grid = np.lexsort((table.beta_deg, table.alpha_deg))  # the order of the rows is to change no answer
    keep = grid[(ok & tensile)[grid]]
    if not keep.size:
        raise InputError("the table has no converged tensile row")
    S, E = table.S[keep] / size[keep, None], table.E[keep]
    key = np.round(np.hstack([S, E]) / ROUNDING).astype(np.int64)
    _, index, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    first, earlier = np.sort(index), index[inverse.ravel()]
    dropped += [f"row {keep[i]}: repeats row {keep[j]}" for i, j in enumerate(earlier) if i != j]
    S, E, keep = S[first], E[first], keep[first]
    return LockedRows(S, E, double_dot(S, E), table.unique[keep], keep, tuple(dropped), table.is_mirrored)


def normality(rows: LockedRows, tolerance: float = NORMALITY_TOLERANCE) -> Normality:
    """Tests S_i:(E_i - E_j) >= -tolerance for all pairs, mirror images included (Prager's ideal locking).

    >>> E = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.1]])
    >>> S = np.array([[0.5, 0.0, 0.5], [0.5, 0.0, 0.5]])
    >>> normality(LockedRows(S, E, double_dot(S, E), np.ones(2, bool), np.arange(2))).worst
    (0, 1)
    """
    both = with_mirror(rows)
    gap = both.h[:, None] - (both.S * WEIGHT) @ both.E.T
    i, j = np.unravel_index(int(np.argmin(gap)), gap.shape)
    bad = gap < -tolerance
    blamed: list[int] = []
    while bad.any():
        blamed.append(int(np.argmax(np.bincount(both.source, bad.sum(axis=0) + bad.sum(axis=1)))))
        is_out = both.source == blamed[-1]
        bad &= ~is_out[:, None] & ~is_out
    worst = (int(both.source[i]), int(both.source[j]))
    return Normality(min(float(gap[i, j]), 0.0), worst, tuple(sorted(blamed)), tolerance)
