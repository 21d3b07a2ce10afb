"""Files are whole or not there. A twin of `rve.files`, because a law must load and save without the rings."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from homogenize.protocol import InputError


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Lets `write` fill a temporary file beside `path` and moves it into place when it is complete.

    InputError if the folder cannot be written; nothing is left behind if `write` fails.
    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=path.suffix)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Writes a whole text file, or nothing."""
    write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
