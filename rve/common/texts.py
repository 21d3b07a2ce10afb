"""JSON, TOML and CSV that are read, and CSV as text.

A file that cannot be read is one sentence; what is wrong in a CSV file is told by line and column.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from rve.common.errors import InputError, shown
from rve.common.files import TABLE_FORMAT, UNREADABLE, AnyPath, JsonObject
from rve.common.typed import alone, folded, nearest

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


TAKEN = {
    "law": "macro_fem run SCENE --law takes it, and homogenize strain, support, strength, plot and export do",
    "strain-load table": "homogenize fit takes it and makes a law",
    "sidecar file of a table": "give the CSV beside it",
    "list of loads": "rve table --loads takes it",
    "scene": "macro_fem run takes it",
    "record of a curtain": "macro_fem localize takes its folder",
    "folder of a curtain": "macro_fem localize takes it",
    "mesh file": 'a scene takes it, [curtain] shape = "file"',
    "drawing": 'a scene takes it, [curtain] shape = "dxf"',
    "workbook": "save it as CSV with commas",
    "record of another command": "no command takes it",
    "folder of another command": "no command takes it",
    "picture": "no command takes it",
    "report": "no command takes it",
}
"""What a file or folder may be, and which command takes it."""
_ENDINGS = {".vtu": "mesh file", ".msh": "mesh file", ".dxf": "drawing", ".xlsx": "workbook", ".ods": "workbook"}
_ENDINGS |= {".png": "picture", ".svg": "picture", ".gif": "picture", ".pdf": "report"}


@contextmanager
def read_as(kind: str, path: AnyPath) -> Iterator[None]:
    """A block that reads a file as one kind of `TAKEN`; an InputError then says what it is, where that is another."""
    try:
        yield
    except InputError as error:
        found = _what_is(path)
        if found in ("", kind):
            raise
        raise InputError(f"{path}: is a {found}, not a {kind}; {TAKEN[found]}") from error


def _what_is(path: AnyPath) -> str:
    """The kind of a file or folder, "" if it is none of `TAKEN`."""
    try:
        place = Path(path)
        if place.is_dir():
            is_curtain = (place / "summary.json").exists() and (place / "curtain.vtu").exists()
            return "folder of a curtain" if is_curtain else "folder of another command" * any(place.glob("*.json"))
        if place.suffix.lower() in _ENDINGS:
            return _ENDINGS[place.suffix.lower()]
        with place.open("rb") as file:
            text = file.read(MOST_JSON_BYTES).decode("utf-8-sig")
        header = {folded(name) for name in re.split(r"[,;\t]", text.partition("\n")[0])}
        if "e11" in header or {"alphadeg", "betadeg"} <= header:
            return "strain-load table" if "e11" in header else "list of loads"
        record = json.loads(text) if text.lstrip()[:1] == "{" else tomllib.loads(text)
        if record.get("format") == TABLE_FORMAT:
            return "sidecar file of a table"
        parts = {"law": {"kind", "parameters"}, "record of a curtain": {"status", "files", "order"}}
        parts |= {"record of another command": {"files", "versions"}, "scene": {"curtain"}}
        return next((kind for kind, keys in parts.items() if keys <= record.keys()), "")
    except UNREADABLE:
        return ""


def read_bytes(path: AnyPath, most: int = MOST_BYTES) -> bytes:
    """The content of a file; InputError if it has more than `most` bytes or cannot be read."""
    try:
        with Path(path).open("rb") as file:
            size = os.fstat(file.fileno()).st_size  # 0 of a pipe
            content = file.read((min(size, most) or most) + 1)  # memory for as many bytes is taken at once
    except TypeError:
        raise InputError(f"a file is read by its path, not from {shown(path):.80}") from None
    except (OSError, ValueError, MemoryError) as error:  # ValueError: a name with a null character
        raise InputError(
            f"{str(path)[:200]}: cannot be read: {(isinstance(error, OSError) and error.strerror) or error}"
        ) from error
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
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not {kind}: it is no text in UTF-8; save it in this encoding") from error
    except json.JSONDecodeError as error:
        missing = not error.doc[error.pos :].strip() or "Unterminated" in error.msg
        what = "the text ends too early: the file was cut off" if missing else "look for a comma, quote, or bracket"
        said = f"line {error.lineno}, column {error.colno}: {what}" if error.doc.strip() else "it is empty"
        raise InputError(f"{path}: is not {kind}: {said}") from error
    except (ValueError, csv.Error) as error:
        raise InputError(f"{path}: is not {kind}: {_toml_hint(content, str(error)) or error}") from error


def _toml_hint(content: bytes, said: str) -> str:
    """What is wrong in the line at which a parser of TOML stopped, "" if that is none of what users of CSV and of other
    programs write."""
    place = re.search(r"at line (\d+), column", said)
    lines = content.decode("utf-8-sig").split("\n")
    if not place or int(place[1]) > len(lines):
        return ""
    line = re.sub(r"\"[^\"]*\"|'[^']*'", '""', lines[int(place[1]) - 1]).partition("#")[0].strip()
    key, sign, value = line.partition("=")
    hint = alone(value)
    if ";" in line:
        hint = "has a semicolon; write commas in lists, and each key on a line of its own"
    elif re.fullmatch(r"\[[\w.-]+\]", line) and "twice" in said:
        hint = f"{line:.80} stands twice; where there may be several, write [{line:.80}]"
    elif not sign and re.match(r"[\w.-]+\s*:", line):
        hint = "write = between a key and its value"
    elif value.strip().lower() in ("true", "false"):
        hint = f"write {value.strip().lower()}, without capitals"
    elif not hint and re.fullmatch(r"\s*[A-Za-z][\w.-]*", value):
        hint = f'write {key.strip():.80} = "{value.strip():.80}", a text in quotes'
    return f"line {place[1]}: {hint}" if hint else ""


def read_json_object(path: AnyPath) -> JsonObject:
    """The object in a JSON file; InputError if it is not JSON, nested too deeply, or something else."""
    found = _parse(path, MOST_JSON_BYTES, "JSON", json.loads)
    if not isinstance(found, dict):
        raise InputError(f"{path}: must hold one JSON object, not a {type(found).__name__}")
    return found


def read_toml(path: AnyPath) -> JsonObject:
    """The tables of a TOML file; InputError if it is not TOML or nested too deeply."""
    found: JsonObject = _parse(path, MOST_TOML_BYTES, "TOML", tomllib.loads)
    return found


@dataclass(frozen=True)
class Columns:
    """Columns of text by name; `source` and `places` say in messages where each row is from."""

    source: AnyPath
    texts: Mapping[str, Sequence[str]]
    places: Sequence[str]

    def numbers(self, name: str, most: float, known: Sequence[bool] | None = None) -> Array:
        """One column as numbers, nan for empty cells and where the column is absent.

        InputError for texts that are no numbers, those above `most` in size, and empty cells of rows that must be
        `known`.
        """
        import numpy as np

        texts = self.texts.get(name, [""] * len(self.places))
        values = np.full(len(texts), np.nan)
        for row, text in enumerate(texts):
            try:
                values[row] = float(text) if text.strip() else np.nan
            except ValueError:
                hint = "".join(f"; {words}" for words in [alone(text)] if words)
                self.refuse(row, name, f"{shown(text)} is not a number{hint}")
        missing = np.isnan(values) & (np.zeros(len(texts), dtype=bool) if known is None else known)
        bad = np.flatnonzero(missing | np.isinf(values) | (np.abs(values) > most))
        if len(bad):
            wrong = f"must be from {-most:g} to {most:g}" if np.isfinite(values[bad[0]]) else "is not a finite number"
            self.refuse(int(bad[0]), name, f"{shown(texts[bad[0]])} {wrong}")
        return values

    def refuse(self, row: int, name: str, what: str) -> NoReturn:
        """InputError that names a row and a column."""
        raise InputError(f"{self.source}: {self.places[row]}, column {name}: {what}") from None


def read_columns(path: AnyPath, required: Sequence[str], optional: Sequence[str] = ()) -> Columns:
    """Columns of a CSV file; commas are between them, or semicolons or tabs; blank lines and lines that begin with #
    are skipped. InputError for a missing column, for one that is none of those `required` and `optional` but for case
    and blanks, and for no rows."""
    lines, rows = _parse(path, MOST_CSV_BYTES, "a CSV text file", _rows)
    header = [" ".join(name.split()) for name in rows[0]] if rows else []
    check_header(path, header, required, optional)
    if len(rows) < 2:
        raise InputError(f"{path}: has no rows")
    for line, row in zip(lines, rows, strict=True):
        if len(row) != len(header):
            hint = "; decimals have a point, no comma" if len(row) > len(header) else ""
            raise InputError(
                f"{path}: line {line} has {len(row)} cells, but the header has {len(header)} columns{hint}"
            )
    texts = dict(zip(header, zip(*rows[1:], strict=True), strict=True))
    return Columns(path, texts, [f"line {line}" for line in lines[1:]])


def check_header(source: AnyPath, header: Sequence[str], required: Sequence[str], optional: Sequence[str]) -> None:
    """InputError for names of columns as of `read_columns`."""
    has = f"it has {', '.join(filter(None, header))[:400] or 'no header line'}"
    for name in (*required, *filter(None, header)):  # pandas writes a column without a name
        if header.count(name) > 1:
            raise InputError(f"{source}: column {name} occurs twice; {has}")
        if name not in header:
            for other in nearest(name, [other for other in header if other not in required]):
                has = f"write {name} in place of {other}"
            raise InputError(f"{source}: column {name} is missing; {has}")
    plain = {folded(name): name for name in optional}
    for name in header:
        if name not in optional and (known := plain.get(folded(name))):
            raise InputError(f"{source}: column {name}: write {known}")


def _rows(text: str) -> tuple[list[int], list[list[str]]]:
    """The rows of a CSV text that are no comments, and the numbers of their lines."""
    first = next((line for line in text.splitlines() if line.strip() and line.lstrip()[0] != "#"), "")
    sign = next((sign for sign in ";\t" if sign in first and "," not in first), ",")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=sign)
    kept = [(reader.line_num, row) for row in reader if any(map(str.strip, row)) and row[0].lstrip()[:1] != "#"]
    return [line for line, _ in kept], [row for _, row in kept]


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


def filled(package: str, name: str, values: Mapping[str, str]) -> str:
    """The text of the file `name` beside the modules of a package, each @KEY@ in it replaced by its value."""
    text = resources.files(package).joinpath(name).read_text(encoding="utf-8")
    for key, value in values.items():
        text = text.replace(f"@{key}@", value)
    return text


def csv_text(columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Rows as CSV below a line of names.

    >>> print(csv_text(["cells", "pitch_mm"], [[9, None]]), end="")
    cells,pitch_mm
    9,
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([columns, *rows])
    return text.getvalue()
