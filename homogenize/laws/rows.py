"""Rows of a law: Hermite data of the support function, each a value and a gradient at once, and their form in a file.

S_i of unit trace, h_i = S_i:E_i and E_i = dh/dS. Where the strain is not unique only the value counts. Where the weave
is its own mirror image, the image of a row is a row as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from rve.common import Array, Flags, Index, JsonObject, Rows, Typed, read_typed
from rve.common.tensor import IDENTITY, double_dot, eigenvalues, mirror, trace

ROUNDING = 1e-9
UnitTrace = Annotated[float, Meta(ge=-1.0 - 2.0 * ROUNDING, le=1.0 + 2.0 * ROUNDING)]
"""A component of a tensile load of unit trace: of both ROUNDING may be left."""
Component = Annotated[float, Meta(ge=-1e3, le=1e3)]
Triples = Annotated[tuple[tuple[Component, Component, Component], ...], Meta(min_length=1, max_length=1_000_000)]


@dataclass(frozen=True, eq=False)
class LockedRows(Rows):
    """Sampled boundary of K+: S (n, 3) of unit trace, E (n, 3), h (n,) = S:E, `unique` (n,), row number `source` (n,).

    `dropped` says in words which rows of the table were left out and why; `is_mirrored` whether the weave is its own
    mirror image, so that every row stands for two. h_strings (n,): S:E of rings drawn to strings, nan where the table
    does not tell it; None where it tells none.
    """

    S: Array
    E: Array
    h: Array
    unique: Flags
    source: Index
    dropped: tuple[str, ...] = ()
    is_mirrored: bool = True
    h_strings: Array | None = None

    def __len__(self) -> int:
        return len(self.h)

    def to_dict(self) -> JsonObject:
        """Loads, strains and flags as plain lists for a file, and whether the weave is its own mirror image."""
        lists = {"S": self.S.tolist(), "E": self.E.tolist(), "unique": self.unique.tolist()}
        if self.h_strings is not None:
            lists["h_strings"] = [None if np.isnan(h) else float(h) for h in self.h_strings]
        return lists | {"is_mirrored": self.is_mirrored}


def with_mirror(rows: LockedRows) -> LockedRows:
    """The rows and their images under S12 -> -S12, E12 -> -E12, each once; the rows alone if the weave is chiral."""
    if not rows.is_mirrored:
        return rows
    other = (np.abs(rows.S[:, 1]) > ROUNDING) | (np.abs(rows.E[:, 1]) > ROUNDING)
    image = rows.take(other)
    return rows.join([replace(image, S=mirror(image.S), E=mirror(image.E))])


@dataclass(frozen=True)
class RowEntries(Typed):
    """What a law file holds of the rows: tensile loads S of unit trace, strains E of real cells, flags."""

    S: Triples
    E: Triples
    unique: tuple[bool, ...]
    is_mirrored: bool = True
    h_strings: tuple[Annotated[float, Meta(ge=0.0, le=1e3)] | None, ...] | None = None

    def check(self) -> None:
        lengths = len(self.S), len(self.E), len(self.unique)
        if not lengths[0] == lengths[1] == lengths[2]:
            self.refuse(f"S, E, unique: differ in length, {lengths}")
        if self.h_strings is not None and len(self.h_strings) != lengths[0]:
            self.refuse(f"h_strings: has {len(self.h_strings)} values for {lengths[0]} rows")
        S, E = np.array(self.S), np.array(self.E)
        good = (np.abs(trace(S) - 1.0) < ROUNDING) & (eigenvalues(S)[0] >= -ROUNDING)
        good &= eigenvalues(2.0 * E + IDENTITY)[0] > 0.0
        if not good.all():
            i = int(np.argmin(good))
            pair = f"S = {S[i].tolist()}, E = {E[i].tolist()}"
            self.refuse(f"row {i}: {pair} is no tensile load of unit trace on a cell with I + 2E positive definite")


def read_rows(table: Any, where: str) -> LockedRows:
    """The rows that `LockedRows.to_dict` wrote; InputError, which begins with `where`, for rows that no fit writes."""
    entries = read_typed(RowEntries, table, where)
    S, E = np.array(entries.S), np.array(entries.E)
    unique, number = np.array(entries.unique), np.arange(len(S))
    strings = None if entries.h_strings is None else np.array(entries.h_strings, float)
    return LockedRows(S, E, double_dot(S, E), unique, number, (), entries.is_mirrored, strings)
