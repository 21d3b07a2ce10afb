"""Answers on disk, keyed by what they depend on: one small file each, safe to share between processes.

A file holds the question, the answer, the checksums of the files that were read for it, and a checksum of all three.
A file that is damaged, answers another question, or was made from files that have changed since counts as missing.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rve.common.errors import InputError
from rve.common.files import check_out_folder, checksum, write_text
from rve.common.reading import MOST_JSON_BYTES

Record = Mapping[str, Any]


@dataclass(frozen=True)
class Cache:
    """A folder of answers, made when the first one is kept; None keeps nothing."""

    folder: Path | None

    def get(self, question: Record) -> dict[str, Any] | None:
        """The answer to a question that JSON can hold; None if it is not there, or no longer holds."""
        path = self._path(question)
        if path is None:
            return None
        try:
            with path.open("rb") as file:
                found = json.loads(file.read(MOST_JSON_BYTES))
            whole = (found["question"], found["answer"], found["files"])
            is_sound = found["sha256"] == _digest(whole) and _digest(whole[0]) == _digest(question)
            if not is_sound or any(checksum(name) != known for name, known in whole[2].items()):
                return None
        except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
            return None
        answer: dict[str, Any] = found["answer"]
        return answer

    def put(self, question: Record, answer: Record, files: Mapping[str, str] | None = None) -> None:
        """Keeps an answer and the checksums of the `files` it was made from; InputError if it cannot be written."""
        path = self._path(question)
        if path is None:
            return
        whole = (question, answer, dict(files or {}))
        record = dict(zip(("question", "answer", "files", "sha256"), (*whole, _digest(whole)), strict=True))
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{path.parent}: cannot be made: {error.strerror}; give another folder") from error
        write_text(path, json.dumps(record, indent=1) + "\n")

    def _path(self, question: Record) -> Path | None:
        return None if self.folder is None else self.folder / f"{_digest(question)[:40]}.json"


NO_CACHE = Cache(None)


def open_cache(folder: str | Path | None, option: str = "--cache") -> Cache:
    """The cache in a folder, which is made; InputError if it is a file or cannot be written. None: nothing is kept."""
    if folder is None:
        return NO_CACHE
    check_out_folder(folder, option)
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{option} = {folder}: cannot be made: {error.strerror}; give another folder") from error
    return Cache(Path(folder))


def _digest(value: Any) -> str:
    """SHA-256 of a value that JSON can hold; tuples are lists, and keys have no order."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
