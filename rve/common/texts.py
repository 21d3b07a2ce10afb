"""JSON, TOML and CSV that are read, and CSV as text.

A file that cannot be read is one sentence; what is wrong in a CSV file is told by line and column.
"""

from __future__ import annotations

import csv
import io
import json
import os
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rve.common.errors import InputError, shown
from rve.common.files import AnyPath

if TYPE_CHECKING:
    from rve.common.records import Array

MOST_BYTES = 500_000_000
"""Of a file that is read."""
MOST_TOML_BYTES, MOST_JSON_BYTES, MOST_CSV_BYTES = 1_000_000, 32_000_000, 200_000_000
"""Of those that are parsed, which takes up to thirty times as much memory: JSON of 180 MB took 4.7 GB."""
LARGEST = 1e100
"""Numbers that are typed: their squares must be numbers, too."""

_reads: ContextVar[dict[str, str] | None] = ContextVar("reads", default=None)


@contextmanager
def recorded_reads() -> Iterator[dict[str, str]]:
    """The files that are read in the block: absolute path to the SHA-256 of the content."""
    found: dict[str, str] = {}
    token = _reads.set(found)
    try:
        yield found
    finally:
        _reads.reset(token)


def read_bytes(path: AnyPath, most: int = MOST_BYTES) -> bytes:
    """The content of a file; InputError if it has more than `most` bytes or cannot be read."""
    try:
        with Path(path).open("rb") as file:
            content = file.read(most + 1)
    except (OSError, ValueError, MemoryError) as error:  # ValueError: a name with a null character
        raise InputError(f"{str(path)[:200]}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(content) > most:
        raise InputError(f"{path}: is larger than {most:,} bytes, which is the most that is read")
    found = _reads.get()
    if found is not None:
        found[os.path.abspath(path)] = sha256(content).hexdigest()
    return content


def _parse(path: AnyPath, most: int, kind: str, parse: Callable[[str], Any]) -> Any:
    """What `parse` makes of a UTF-8 file, a byte order mark removed; InputError if it is not of this kind."""
    content = read_bytes(path, most)
    try:
        return parse(content.decode("utf-8-sig"))
    except (RecursionError, MemoryError) as error:
        raise InputError(f"{path}: is not {kind} that can be read: it is nested too deeply, or too large") from error
    except (ValueError, csv.Error) as error:
        raise InputError(f"{path}: is not {kind}: {error}") from error


def read_json_object(path: AnyPath) -> dict[str, Any]:
    """The object in a JSON file; InputError if it is not JSON, nested too deeply, or something else."""
    found = _parse(path, MOST_JSON_BYTES, "JSON", json.loads)
    if not isinstance(found, dict):
        raise InputError(f"{path}: must hold one JSON object, not a {type(found).__name__}")
    return found


def read_toml(path: AnyPath) -> dict[str, Any]:
    """The tables of a TOML file; InputError if it is not TOML or nested too deeply."""
    found: dict[str, Any] = _parse(path, MOST_TOML_BYTES, "TOML", tomllib.loads)
    return found


def read_columns(path: AnyPath, required: tuple[str, ...]) -> dict[str, list[str]]:
    """Columns of a CSV file as text, by name; blank lines are skipped. InputError for a missing column, and no rows."""
    rows: list[list[str]] = _parse(
        path, MOST_CSV_BYTES, "a CSV text file", lambda text: [*filter(None, csv.reader(io.StringIO(text, newline="")))]
    )
    header = [" ".join(name.split()) for name in rows[0]] if rows else []
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
    import numpy as np

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


def numbers_of(text: str, option: str, form: str = "") -> list[float]:
    """Numbers with commas between them, as many as `form` has names; InputError for others.

    >>> numbers_of("5,0.5", "--rings", "R1,R2")
    [5.0, 0.5]
    """
    try:
        values = [float(one) for one in text.split(",")]
    except ValueError:
        values = []
    is_complete = len(values) == form.count(",") + 1 if form else bool(values)
    if not (is_complete and all(abs(one) <= LARGEST for one in values)):
        what = form or "with commas between them"
        raise InputError(f"{option} = {shown(text)}: give finite numbers {what}, at most {LARGEST:g} in size")
    return values


def digits(value: float, count: int = 3) -> str:
    """A number with `count` digits, without an exponent between 1e-3 and 1e6.

    >>> digits(1234.5), digits(0.00123456, 4), digits(1.25e7)
    ('1230', '0.001235', '1.25e+07')
    """
    return f"{float(f'{value:.{count}g}'):g}"


def csv_text(columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Rows as CSV below a line of names.

    >>> print(csv_text(["cells", "pitch_mm"], [[9, None]]), end="")
    cells,pitch_mm
    9,
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([columns, *rows])
    return text.getvalue()
