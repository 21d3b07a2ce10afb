"""Columns of CSV files by name, as text and as numbers in a range; what is wrong is told by line and column."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path

import numpy as np

from rve.common.errors import InputError
from rve.common.reading import MOST_CSV_BYTES, read_text
from rve.common.types import Array
from rve.common.values import shown, shown_key

MOST_CELLS = 5_000_000
"""Cells of a CSV file: some 180,000 rows of a table, 0.5 GB while they are text."""


def _read_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """Header and rows of a CSV file of at most MOST_CELLS cells; blank lines are skipped."""
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
    if len(set(header)) < len(header):
        raise InputError(f"{path}: a column name occurs twice in the header")
    for number, row in enumerate(rows[1:], 2):
        if len(row) != len(header):
            raise InputError(f"{path}: line {number} has {len(row)} cells, but the header has {len(header)} columns")
    return header, rows[1:]


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        return float(text) if text.strip() else np.nan
    except ValueError:
        raise InputError(f"{path}: line {line}, column {name}: {shown(text)} is not a number") from None


def read_columns(path: str | os.PathLike[str], required: tuple[str, ...]) -> dict[str, list[str]]:
    """Columns of a CSV file as text, by name; raises InputError for a missing column or an empty table."""
    path = Path(path)
    header, rows = _read_rows(path)
    for name in required:
        if name not in header:
            raise InputError(f"{path}: column {name} is missing; it has {', '.join(map(shown_key, header[:40]))}")
    if not rows:
        raise InputError(f"{path}: has no rows")
    return {name: [row[i] for row in rows] for i, name in enumerate(header)}


def numeric_column(path: str | os.PathLike[str], columns: dict[str, list[str]], name: str) -> Array:
    """One column as numbers, nan for empty cells and where the column is absent."""
    size = len(next(iter(columns.values())))
    if name not in columns:
        return np.full(size, np.nan)
    return np.array([_number(Path(path), line, name, text) for line, text in enumerate(columns[name], 2)])


def ranged_column(path: str | os.PathLike[str], columns: dict[str, list[str]], name: str, most: float) -> Array:
    """One column as numbers, nan for empty cells; InputError for infinite ones and those above `most` in size."""
    values = numeric_column(path, columns, name)
    bad = np.flatnonzero(np.isinf(values) | (np.abs(values) > most))
    if len(bad):
        wrong = "is not finite" if np.isinf(values[bad[0]]) else f"must be from {-most:g} to {most:g}"
        raise InputError(f"{path}: line {bad[0] + 2}, column {name}: {shown(columns[name][bad[0]])} {wrong}")
    return values
