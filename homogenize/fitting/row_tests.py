"""From a table to the rows of a law, tested before anything is fitted to them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import nnls

from homogenize.laws.rows import ROUNDING, LockedRows, with_mirror
from rve.common import InputError
from rve.common.tensor import WEIGHT, double_dot, eigenvalues, trace

if TYPE_CHECKING:
    from rve import StrainTable

NORMALITY_TOLERANCE = 1e-8
MOST_LISTED = 10
"""Pairs of rows in a sentence."""


@dataclass(frozen=True, eq=False)
class Normality:
    """How well rows belong to one convex set: `slack` = min over all pairs of S_i:(E_i - E_j), zero or negative.

    pairs: row numbers (i, j) where it is below -tolerance, worst first, and the `distance` by which strain j lies
    beyond the half-space of row i. `blamed`: the fewest rows, found greedily, without which no pair is.
    """

    slack: float
    pairs: tuple[tuple[int, int], ...]
    distances: tuple[float, ...]
    blamed: tuple[int, ...]
    tolerance: float

    @property
    def holds(self) -> bool:
        """True if no pair of rows contradicts convexity by more than the tolerance."""
        return self.slack >= -self.tolerance

    def sentence(self) -> str:
        if self.holds:
            return f"normality holds: S_i:(E_i - E_j) >= {self.slack:.1e} for all pairs of rows"
        told = "; ".join(map(self.contradiction, self.blamed[:MOST_LISTED]))
        rest = "; and more" * (len(self.blamed) > MOST_LISTED)
        rows = ", ".join(map(str, self.blamed[:MOST_LISTED])) + ", ..." * bool(rest)
        return (
            f"the rows do not lie on one convex set: {told}{rest}; without rows {rows} the others agree (the first row "
            "is 0): --contradictions drop leaves them out, --contradictions mend moves strains as little as it can, "
            f"--noise {-1.1 * self.slack:.0e} fits a law that is off by as much there"
        )

    def contradiction(self, row: int) -> str:
        """How a row contradicts others, in words."""
        (i, j), far = next(one for one in zip(self.pairs, self.distances, strict=True) if row in one[0])
        others = {other for pair in self.pairs if row in pair for other in pair} - {row}
        most = "itself mirrored" if i == j else f"row {i + j - row}"
        count = f" and {len(others) - 1} others" if len(others) > 1 else ""
        return f"row {row} contradicts {most}{count}, by {far:.1e} of strain"


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
    strings = None if table.h_strings is None else table.h_strings[keep]
    return LockedRows(S, E, double_dot(S, E), table.unique[keep], keep, tuple(dropped), table.is_mirrored, strings)


def normality(rows: LockedRows, tolerance: float = NORMALITY_TOLERANCE) -> Normality:
    """Tests S_i:(E_i - E_j) >= -tolerance for all pairs, mirror images included (Prager's ideal locking).

    >>> E = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.1]])
    >>> S = np.array([[0.5, 0.0, 0.5], [0.5, 0.0, 0.5]])
    >>> normality(LockedRows(S, E, double_dot(S, E), np.ones(2, bool), np.arange(2))).pairs
    ((0, 1),)
    """
    both = with_mirror(rows)
    gap = both.h[:, None] - (both.S * WEIGHT) @ both.E.T
    bad = gap < -tolerance
    beyond, size = np.where(bad, -gap, 0.0), np.sqrt(double_dot(both.S, both.S))
    order, told = np.argsort(-beyond[bad], kind="stable"), dict[tuple[int, int], float]()
    for i, j in np.argwhere(bad)[order].tolist():
        told.setdefault((int(both.source[i]), int(both.source[j])), float(beyond[i, j] / size[i]))
    blamed: list[int] = []
    while bad.any():
        blamed.append(int(np.argmax(np.bincount(both.source, bad.sum(axis=0) + bad.sum(axis=1)))))
        is_out = both.source == blamed[-1]
        bad &= ~is_out[:, None] & ~is_out
    slack = min(float(gap.min()), 0.0)
    return Normality(slack, tuple(told), tuple(told.values()), tuple(sorted(blamed)), tolerance)


def without(rows: LockedRows, found: Normality) -> LockedRows:
    """The rows without those that contradict others, see `Normality`."""
    dropped = tuple(map(found.contradiction, found.blamed))
    return replace(rows.take(~np.isin(rows.source, found.blamed)), dropped=(*rows.dropped, *dropped))


def mended(rows: LockedRows) -> LockedRows:
    """The rows with the nearest strains, in the sum of their squares, that contradict each other nowhere.

    S_i:(E_i - E_j) >= 0 is linear in the strains, so that they are a projection onto a cone: with the rows A of the
    pairs that count, E + A^T y for the y >= 0 that minimises |E + A^T y|. Pairs join until none is violated.
    """
    root, count = np.sqrt(WEIGHT), len(rows)
    S, own = rows.S * root, rows.E * root
    signs = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 1.0]])[: 1 + rows.is_mirrored]
    pairs, E = set[tuple[int, int, int]](), own
    # In which pairs of rows join those that are mended; 5 to 10 are usual.
    for _ in range(100):
        gap = (S * E).sum(axis=1)[:, None, None] - np.einsum("ik,mk,jk->imj", S, signs, E)
        new = {(i, m, j) for i, m, j in np.argwhere(gap < -0.01 * NORMALITY_TOLERANCE).tolist()}
        if new <= pairs:
            break
        pairs |= new
        i, m, j = np.array(sorted(pairs)).T
        A = np.zeros((len(i), count, 3))
        np.add.at(A, (np.arange(len(i)), i), S[i])
        np.add.at(A, (np.arange(len(i)), j), -S[i] * signs[m])
        onto = A.reshape(len(i), -1).T
        E = own + (onto @ nnls(onto, -own.ravel())[0]).reshape(-1, 3)
    moved = np.sqrt(((E - own) ** 2).sum(axis=1))
    told = (
        f"the strain of row {row} is moved by {far:.1e}"
        for row, far in zip(rows.source, moved, strict=True)
        if far > ROUNDING
    )
    E = E / root
    return replace(rows, E=E, h=double_dot(rows.S, E), dropped=(*rows.dropped, *told))
