"""From table rows to Hermite data of the support function, tested before anything is fitted to them.

Each converged row is a value and a gradient at once: S_i of unit trace, h_i = S_i:E_i and E_i = dh/dS. Where the strain
is not unique only the value counts. Where the weave is its own mirror image, the image of a row is a row as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from msgspec import Meta

from rve.common import Array, Flags, Index, InputError, Rows, Typed, read_typed
from rve.common.tensor import IDENTITY, WEIGHT, double_dot, eigenvalues, mirror, trace

if TYPE_CHECKING:
    from rve import StrainTable

NORMALITY_TOLERANCE = 1e-8
ROUNDING = 1e-9
Component = Annotated[float, Meta(ge=-1e3, le=1e3)]
Triples = Annotated[tuple[tuple[Component, Component, Component], ...], Meta(min_length=1, max_length=1_000_000)]


@dataclass(frozen=True, eq=False)
class LockedRows(Rows):
    """Sampled boundary of K+: S (n, 3) of unit trace, E (n, 3), h (n,) = S:E, `unique` (n,), row number `source` (n,).

    `dropped` says in words which rows of the table were left out and why; `is_mirrored` whether the weave is its own
    mirror image, so that every row stands for two.
    """

    S: Array
    E: Array
    h: Array
    unique: Flags
    source: Index
    dropped: tuple[str, ...] = ()
    is_mirrored: bool = True

    def __len__(self) -> int:
        return len(self.h)


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


def with_mirror(rows: LockedRows) -> LockedRows:
    """The rows and their images under S12 -> -S12, E12 -> -E12, each once; the rows alone if the weave is chiral."""
    if not rows.is_mirrored:
        return rows
    other = (np.abs(rows.S[:, 1]) > ROUNDING) | (np.abs(rows.E[:, 1]) > ROUNDING)
    image = rows.take(other)
    return rows.join([replace(image, S=mirror(image.S), E=mirror(image.E))])


def rows_to_dict(rows: LockedRows) -> dict[str, Any]:
    """Loads, strains and flags of the rows as plain lists for a file, and whether the weave is its own mirror image."""
    return {name: getattr(rows, name).tolist() for name in ("S", "E", "unique")} | {"is_mirrored": rows.is_mirrored}


@dataclass(frozen=True)
class RowEntries(Typed):
    """What a law file holds of the rows: tensile loads S of unit trace, strains E of real cells, flags."""

    S: Triples
    E: Triples
    unique: tuple[bool, ...]
    is_mirrored: bool = True

    def check(self) -> None:
        lengths = len(self.S), len(self.E), len(self.unique)
        if not lengths[0] == lengths[1] == lengths[2]:
            self.refuse(f"S, E, unique: differ in length, {lengths}")
        S, E = np.array(self.S), np.array(self.E)
        good = (np.abs(trace(S) - 1.0) < ROUNDING) & (eigenvalues(S)[0] >= -ROUNDING)
        good &= eigenvalues(2.0 * E + IDENTITY)[0] > 0.0
        if not good.all():
            i = int(np.argmin(good))
            pair = f"S = {S[i].tolist()}, E = {E[i].tolist()}"
            self.refuse(f"row {i}: {pair} is no tensile load of unit trace on a cell with I + 2E positive definite")


def rows_from_provenance(provenance: dict[str, Any], source: str) -> LockedRows | None:
    """The rows in the provenance of a law, as `rows_to_dict` wrote them; None if it holds none.

    InputError, which names the file `source`, for rows that no fit writes.
    """
    if "table_rows" not in provenance:
        return None
    found = read_typed(RowEntries, provenance["table_rows"], f"{source}: provenance table_rows:")
    S, E = np.array(found.S), np.array(found.E)
    unique, number = np.array(found.unique), np.arange(len(S))
    return LockedRows(S, E, double_dot(S, E), unique, number, is_mirrored=found.is_mirrored)


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
