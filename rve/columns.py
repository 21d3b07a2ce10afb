"""Columns of CSV files by name, as text and as numbers in a range; what is wrong is told by line and column."""

from __future__ import annotations

import csv
import io

import numpy as np

from rve.common.errors import InputError, shown
from rve.common.files import AnyPath
from rve.common.reading import MOST_CSV_BYTES, read_text
from rve.common.types import Array


def read_columns(path: AnyPath, required: tuple[str, ...]) -> dict[str, list[str]]:
    """Columns of a CSV file as text, by name; blank lines are skipped. InputError for a missing column, and no rows."""
    text = io.StringIO(read_text(path, MOST_CSV_BYTES, "a CSV text file"), newline="")
    try:
        rows = [row for row in csv.reader(text) if row]
    except csv.Error as error:
        raise InputError(f"{path}: is not a CSV text file: {error}") from error
    header = [name.strip() for name in rows[0]] if rows else []
    for name in (*required, *header):
        if header.count(name) != 1:
            wrong = "is missing" if name not in header else "occurs twice"
            raise InputError(f"{path}: column {name} {wrong}; it has {', '.join(header)[:400] or 'no header line'}")
    if len(rows) < 2:
        raise InputError(f"{path}: has no rows")
    for number, row in enumerate(rows[1:], 2):
        if len(row) != len(header):
            raise InputError(f"{path}: line {number} has {len(row)} cells, but the header has {len(header)} columns")
    return dict(zip(header, map(list, zip(*rows[1:], strict=True)), strict=True))


def number_column(
    path: AnyPath, columns: dict[str, list[str]], name: str, most: float, known: list[bool] | None = None
) -> Array:
    """One column as numbers, nan for empty cells and where the column is absent.

    InputError for texts that are no numbers, those above `most` in size, and empty cells of rows that must be `known`.
    """
    texts = columns.get(name, [""] * len(next(iter(columns.values()))))
    values = np.full(len(texts), np.nan)
    for row, text in enumerate(texts):
        try:
            values[row] = float(text) if text.strip() else np.nan
        except ValueError:
            raise InputError(f"{path}: line {row + 2}, column {name}: {shown(text)} is not a number") from None
    missing = np.isnan(values) & (np.zeros(len(texts), dtype=bool) if known is None else known)
    bad = np.flatnonzero(missing | np.isinf(values) | (np.abs(values) > most))
    if len(bad):
        wrong = f"must be from {-most:g} to {most:g}" if np.isfinite(values[bad[0]]) else "is not a finite number"
        raise InputError(f"{path}: line {bad[0] + 2}, column {name}: {shown(texts[bad[0]])} {wrong}")
    return values
