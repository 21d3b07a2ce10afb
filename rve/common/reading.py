"""Reading of JSON, TOML and text: files of a stated size at most, errors in one sentence, a list of what was read."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from hashlib import sha256
from pathlib import Path
from typing import Any

from rve.common.errors import InputError
from rve.common.files import AnyPath

MOST_JSON_BYTES = 32_000_000
"""Parsing takes up to thirty times the bytes of a JSON file; a law of 5,000 half-spaces has 0.5 MB."""
MOST_TOML_BYTES = 1_000_000
MOST_CSV_BYTES = 200_000_000
MOST_MESH_BYTES = 500_000_000

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


def read_bytes(path: AnyPath, most: int) -> bytes:
    """The content of a file of at most `most` bytes; InputError if it is larger or cannot be read."""
    try:
        with Path(path).open("rb") as file:
            size = os.fstat(file.fileno()).st_size or most  # a pipe has no size of its own
            content = file.read(min(size, most) + 1)
    except (OSError, ValueError, MemoryError) as error:  # ValueError: a name with a null character
        raise InputError(f"{str(path)[:200]}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(content) > most:
        raise InputError(f"{path}: is larger than {most:,} bytes, which is the most that is read")
    found = _reads.get()
    if found is not None:
        found[os.path.abspath(path)] = sha256(content).hexdigest()
    return content


def read_text(path: AnyPath, most: int, kind: str) -> str:
    """The content of a UTF-8 file, a byte order mark removed; `kind` names what it should be, for the message."""
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
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


def _parse(path: AnyPath, most: int, kind: str, parse: Any) -> Any:
    text = read_text(path, most, kind)
    try:
        return parse(text)
    except (RecursionError, MemoryError) as error:
        raise InputError(f"{path}: is not {kind} that can be read: it is nested too deeply, or too large") from error
    except ValueError as error:
        raise InputError(f"{path}: is not {kind}: {error}") from error
