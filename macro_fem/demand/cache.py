"""Solutions of the rings in the cache: what a load direction's answer depends on, and what an answer must hold."""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from rve import Cell
from rve.common.cache import Cache
from rve.common.files import versions
from rve.common.types import Array

Beside = tuple[tuple[float, float], ...]
"""Directions as points of the unit disc."""
FORMAT = "ring-mesh support value"
VERSION = 3
"""Raised when the same direction would be answered differently, so that older files are no longer read."""
NOT_ASKED = ("r1", "r2", "density", "material", "weave")
"""Fields of a cell that enter by name and ratio, or not at all."""
ROUNDING = 1e-9
"""By how much h of a kept answer may differ from S:E, which it is computed as."""


@dataclass(frozen=True)
class RingAnswer:
    """What the rings answer to a load direction: h = max S:E, E (3,) that reaches it, status, and whether E is unique.

    h and E are nan where `status` is not "converged".
    """

    h: float
    E: tuple[float, float, float]
    status: str
    unique: bool


def read_answer(cache: Cache, cell: Cell, S: Array, beside: Beside = ()) -> RingAnswer | None:
    """The kept answer to the direction S (3,) of unit trace; None if it is not there, or not h = S:E.

    beside: directions that were solved with it, whose locked states were starts.
    """
    found = cache.get(question(cell, S, beside))
    try:
        return None if found is None else _answer(found, S)
    except (ValueError, KeyError, TypeError):
        return None


def keep_answer(cache: Cache, cell: Cell, S: Array, answer: RingAnswer, beside: Beside = ()) -> None:
    """Keeps an answer; InputError if the folder cannot be written."""
    cache.put(question(cell, S, beside), asdict(answer) | {"versions": versions()})


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


def _answer(found: dict[str, Any], S: Array) -> RingAnswer:
    """The answer in a file; ValueError, KeyError or TypeError if it is none."""
    status, unique = str(found["status"]), bool(found["unique"])
    if status != "converged":
        return RingAnswer(math.nan, (math.nan,) * 3, status, unique)
    h, (E11, E12, E22) = float(found["h"]), (float(x) for x in found["E"])
    if not abs(S[0] * E11 + 2.0 * S[1] * E12 + S[2] * E22 - h) < ROUNDING:
        raise ValueError("h is not S:E")
    return RingAnswer(h, (E11, E12, E22), status, unique)
