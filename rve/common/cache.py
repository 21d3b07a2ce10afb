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

from rve.common.files import checksum, make_folder, write_text
from rve.common.reading import MOST_JSON_BYTES

Record = Mapping[str, Any]


@dataclass(frozen=True)
class Cache:
    """A folder of answers, made when the first one is kept; None keeps nothing."""

    folder: Path | None

    def get(self, question: Record) -> dict[str, Any] | None:
        """The answer to a question that JSON can hold; None if it is not there, or no longer holds."""
        if self.folder is None:
            return None
        try:
            with self._path(question).open("rb") as file:
                found: dict[str, Any] = json.loads(file.read(MOST_JSON_BYTES))
            known = found.pop("sha256")
            is_whole = known == _digest(found) and _digest(found["question"]) == _digest(question)
            is_current = is_whole and all(checksum(name) == one for name, one in found["files"].items())
            answer: dict[str, Any] = found["answer"]
        except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
            return None
        return answer if is_current else None

    def put(self, question: Record, answer: Record, files: Mapping[str, str] | None = None) -> None:
        """Keeps an answer and the checksums of the `files` it was made from; InputError if it cannot be written."""
        if self.folder is None:
            return
        make_folder(self.folder)
        record = {"question": question, "answer": answer, "files": dict(files or {})}
        write_text(self._path(question), json.dumps(record | {"sha256": _digest(record)}, indent=1) + "\n")

    def _path(self, question: Record) -> Path:
        assert self.folder is not None
        return self.folder / f"{_digest(question)[:40]}.json"


NO_CACHE = Cache(None)


def open_cache(folder: str | Path | None, option: str = "--cache") -> Cache:
    """The cache in a folder, which is made; InputError if it cannot be. None: nothing is kept."""
    return NO_CACHE if folder is None else Cache(make_folder(folder, option))


def _digest(value: Any) -> str:
    """SHA-256 of a value that JSON can hold; tuples are lists, and keys have no order."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
