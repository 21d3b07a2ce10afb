"""Bounded reading: files of a stated size at most, JSON and TOML of any content, errors in one sentence.

Parsing takes up to thirty times the bytes of a JSON file in memory (a file of empty lists), so the limits keep every
reader below 1 GB. They are far above what the commands write: a law of 5,000 half-spaces has 0.5 MB.
"""

from __future__ import annotations

import json
import os
import re
import tomllib
import warnings
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from rve.common.errors import InputError
from rve.common.values import shown, shown_key

MOST_JSON_BYTES = 32_000_000
MOST_TOML_BYTES = 1_000_000
MOST_KEY_PARTS = 50
MOST_CSV_BYTES = 200_000_000
MOST_MESH_BYTES = 500_000_000


def read_bytes(path: str | os.PathLike[str], most: int) -> bytes:
    """The content of a file of at most `most` bytes; InputError if it is larger or cannot be read."""
    try:
        with Path(path).open("rb") as file:
            # a buffer of the size of the file, not of the limit; what has no size of its own gets the limit
            size = os.fstat(file.fileno()).st_size
            content = file.read(min(size, most) + 1) if size else _read_stream(file, most)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # a name with a null character
        raise InputError(f"{shown(str(path))}: cannot be read: {error}") from error
    except MemoryError as error:
        raise InputError(f"{path}: cannot be read: it does not fit into memory") from error
    if len(content) > most:
        raise InputError(f"{path}: is larger than {most:,} bytes, which is the most that is read")
    return content


def _read_stream(file: BinaryIO, most: int) -> bytes:
    """At most `most` + 1 bytes of a pipe or device."""
    parts, left = [], most + 1
    while left > 0 and (part := file.read(min(left, 1_000_000))):
        parts.append(part)
        left -= len(part)
    return b"".join(parts)


def read_text(path: str | os.PathLike[str], most: int, kind: str) -> str:
    """The content of a UTF-8 file, a byte order mark removed; `kind` names what it should be, for the message."""
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not {kind}: {error}") from error


def read_json(path: str | os.PathLike[str]) -> Any:
    """The value in a JSON file; InputError if it is not JSON, nested too deeply, or names a key twice."""
    text = read_text(path, MOST_JSON_BYTES, "JSON")
    try:
        return json.loads(text, object_pairs_hook=_unique)
    except RecursionError as error:
        raise InputError(f"{path}: is not JSON that can be read: it is nested too deeply") from error
    except ValueError as error:
        raise InputError(f"{path}: is not JSON: {error}") from error


def read_json_object(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The object in a JSON file; InputError as in `read_json`, and if the file holds something else."""
    found = read_json(path)
    if not isinstance(found, dict):
        raise InputError(f"{path}: must hold one JSON object, not a {type(found).__name__}")
    return found


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise ValueError(f"the key {shown_key(twice)} occurs twice")
    return found


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The tables of a TOML file; InputError if it is not TOML or nested too deeply."""
    text = read_text(path, MOST_TOML_BYTES, "TOML")
    for number, line in enumerate(text.splitlines(), 1):
        if _key_parts(line) > MOST_KEY_PARTS:
            raise InputError(f"{path}: line {number}: a key has more than {MOST_KEY_PARTS} parts")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise InputError(f"{path}: is not TOML that can be read: it is nested too deeply") from error
    except MemoryError as error:
        raise InputError(f"{path}: is not TOML that can be read: it does not fit into memory") from error
    except ValueError as error:
        raise InputError(f"{path}: is not TOML: {error}") from error


def _key_parts(line: str) -> int:
    """Dots of the longest key of a line: tomllib takes memory with the square of its parts."""
    keys = line.split("=")[:-1] or [line.replace("[", "")]  # a header, or part of a list
    return max(re.split(r"[,{\[]", key)[-1].count(".") for key in keys)


def parse_numbers(text: str, dtype: np.dtype[np.generic] | type = float) -> NDArray[np.generic]:
    """Numbers separated by white space, (n,); ValueError if the text holds anything else."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # older numpy only warns
        try:
            return np.fromstring(text, dtype=dtype, sep=" ")
        except (DeprecationWarning, ValueError) as error:
            raise ValueError("there is a text where a number should be") from error


def first_line(error: BaseException) -> str:
    """What an error of a parser says, in one line of moderate length."""
    return (str(error).splitlines() or ["its data is damaged"])[0][:200]
