"""Columns of CSV files by name, as text and as numbers in a range; what is wrong is told by line and column."""

from __future__ import annotations

import csv
import io
import os

import numpy as np

from rve.common.errors import InputError
from rve.common.reading import MOST_CSV_BYTES, read_text
from rve.common.types import Array
from rve.common.values import shown, shown_key

MOST_CELLS = 5_000_000
"""Cells of a CSV file: some 180,000 rows of a table, 0.5 GB while they are text."""


def read_columns(path: str | os.PathLike[str], required: tuple[str, ...]) -> dict[str, list[str]]:
    """Columns of a CSV file as text, by name; blank lines are skipped.

    InputError for a missing column, an empty table, and more than MOST_CELLS cells.
    """
    rows: list[list[str]] = []
    cells = 0
    try:
        for row in csv.reader(io.StringIO(read_text(path, MOST_CSV_BYTES, "a CSV text file"), newline="")):
            cells += len(row)
            if cells > MOST_CELLS:
                raise InputError(f"{path}: has more than {MOST_CELLS:,} cells, which is the most that is read")
            if row:
                rows.append(row)
    except csv.Error as error:
        raise InputError(f"{path}: is not a CSV text file: {error}") from error
    if not rows:
        raise InputError(f"{path}: is empty; a table needs a header line and at least one row")
    header = [name.strip() for name in rows[0]]
    for name in (*header, *required):
        if header.count(name) > 1:
            raise InputError(f"{path}: a column name occurs twice in the header")
        if name not in header:
            raise InputError(f"{path}: column {name} is missing; it has {', '.join(map(shown_key, header[:40]))}")
    if len(rows) < 2:
        raise InputError(f"{path}: has no rows")
    for number, row in enumerate(rows[1:], 2):
        if len(row) != len(header):
            raise InputError(f"{path}: line {number} has {len(row)} cells, but the header has {len(header)} columns")
    return dict(zip(header, map(list, zip(*rows[1:], strict=True)), strict=True))


def number_column(
    path: str | os.PathLike[str], columns: dict[str, list[str]], name: str, most: float, *, known: bool = False
) -> Array:
    """One column as numbers, nan for empty cells and where the column is absent.

    InputError for texts that are no numbers, infinite ones, those above `most` in size, and with `known` empty cells.
    """
    texts = columns.get(name, [""] * len(next(iter(columns.values()))))
    values = np.full(len(texts), np.nan)
    for row, text in enumerate(texts):
        try:
            values[row] = float(text) if text.strip() else np.nan
        except ValueError:
            raise InputError(f"{path}: line {row + 2}, column {name}: {shown(text)} is not a number") from None
    bad = np.flatnonzero(np.isinf(values) | (np.abs(values) > most) | (known & np.isnan(values)))
    if len(bad):
        wrong = f"must be from {-most:g} to {most:g}" if np.isfinite(values[bad[0]]) else "is not a finite number"
        raise InputError(f"{path}: line {bad[0] + 2}, column {name}: {shown(texts[bad[0]])} {wrong}")
    return values
