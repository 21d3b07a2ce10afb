"""Solutions of the rings on disk, one small file per load direction, safe to share between processes.

A file is written whole or not at all. Its name is a hash of all that its content depends on: weave, grain, wire r2/r1,
direction, and the version of this format and of the solver. Files that are damaged or say something else are ignored.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from rve import Cell
from rve.common.errors import InputError
from rve.common.storage.files import check_out_folder, versions, write_text
from rve.common.types import Array

Beside = tuple[tuple[float, float], ...]
"""Directions as points of the unit disc."""
FORMAT = "ring-mesh support value"
VERSION = 2
"""Raised when the same direction would be answered differently, so that older files are no longer read."""
MOST_BYTES = 10_000
NOT_ASKED = ("r1", "r2", "density", "material", "weave")
"""Fields of a cell that enter by name and ratio, or not at all."""


@dataclass(frozen=True)
class RingAnswer:
    """What the rings answer to a load direction: h = max S:E, E (3,) that reaches it, status, and whether E is unique.

    h and E are nan where `status` is not "converged".
    """

    h: float
    E: tuple[float, float, float]
    status: str
    unique: bool


@dataclass(frozen=True)
class RingCache:
    """A folder of answers; None keeps nothing."""

    folder: Path | None

    def get(self, cell: Cell, S: Array, beside: Beside = ()) -> RingAnswer | None:
        """The answer to the direction S (3,) of unit trace, None if it is not there or not readable.

        beside: directions that were solved with it, whose locked states were starts.
        """
        if self.folder is None:
            return None
        asked = question(cell, S, beside)
        try:
            with (self.folder / file_name(asked)).open("rb") as file:
                found = json.loads(file.read(MOST_BYTES))
            return _answer(found) if found["question"] == asked else None
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return None

    def put(self, cell: Cell, S: Array, answer: RingAnswer, beside: Beside = ()) -> None:
        """Keeps an answer; InputError if the folder cannot be written."""
        if self.folder is None:
            return
        asked = question(cell, S, beside)
        record = {
            "question": asked,
            "h": answer.h if math.isfinite(answer.h) else None,
            "E11_E12_E22": [x if math.isfinite(x) else None for x in answer.E],
            "status": answer.status,
            "unique": answer.unique,
            "versions": versions(),
        }
        self.folder.mkdir(parents=True, exist_ok=True)
        write_text(self.folder / file_name(asked), json.dumps(record, indent=1, allow_nan=False) + "\n")


NO_CACHE = RingCache(None)


def open_cache(folder: str | Path | None) -> RingCache:
    """The cache in a folder, which is made; InputError if it is a file or cannot be written. None: nothing is kept."""
    if folder is None:
        return NO_CACHE
    check_out_folder(folder, "--cache")
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--cache = {folder}: cannot be made: {error.strerror}; give another folder") from error
    return RingCache(Path(folder))


def default_folder() -> Path:
    """Where answers are kept unless told otherwise: $XDG_CACHE_HOME/ring-mesh, by default ~/.cache/ring-mesh."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "ring-mesh"


def question(cell: Cell, S: Array, beside: Beside = ()) -> dict[str, Any]:
    """All that the answer depends on: every field of the cell but its size and metal."""
    others = {one.name: str(getattr(cell, one.name)) for one in fields(cell) if one.name not in NOT_ASKED}
    return {
        "format": FORMAT,
        "format_version": VERSION,
        "weave": cell.weave.name,
        "repeat": list(cell.weave.repeat),
        "r2_over_r1": cell.wire,
        **others,
        "S11_S12_S22": [float(x) for x in S],
        "beside": [list(x) for x in beside],
    }


def file_name(asked: dict[str, Any]) -> str:
    """Name of the file that answers a question.

    >>> len(file_name({"format": FORMAT}))
    45
    """
    return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()[:40] + ".json"


def _answer(found: dict[str, Any]) -> RingAnswer:
    """The answer in a file; ValueError, KeyError or TypeError if it is none."""
    status, unique, E = found["status"], found["unique"], found["E11_E12_E22"]
    if not isinstance(status, str) or not isinstance(unique, bool) or len(E) != 3:
        raise ValueError("no answer")
    if status != "converged":
        return RingAnswer(math.nan, (math.nan,) * 3, status, unique)
    numbers = [float(found["h"]), *(float(x) for x in E)]
    if not all(math.isfinite(x) and abs(x) < 10.0 for x in numbers):
        raise ValueError("no finite strain")
    return RingAnswer(numbers[0], (numbers[1], numbers[2], numbers[3]), status, unique)
