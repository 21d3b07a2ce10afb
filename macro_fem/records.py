"""Tables of a scene file to frozen records: unknown keys, wrong types and values out of range end in one sentence.

The type and range of a key stand beside it in the record, as `number(...)`, `choice(...)` and so on; the reader below
knows nothing of curtains.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import MISSING, Field, field, fields
from typing import Any, TypeVar

from homogenize.law import InputError

Check = Callable[[Any], Any]
Record = TypeVar("Record")


class _BadValue(ValueError):
    """What is wrong with a value, to be completed with file and key."""


def _entry(check: Check, default: Any) -> Any:
    return field(metadata={"check": check}) if default is MISSING else field(default=default, metadata={"check": check})


def _as_number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _BadValue("is not a number")
    try:
        x = float(value)
    except OverflowError:  # a whole number of more than 308 digits
        x = math.inf
    if not math.isfinite(x):
        raise _BadValue("is not a finite number")
    return x


def number(
    default: Any = MISSING, *, above: float = -math.inf, least: float = -math.inf, most: float = math.inf
) -> Any:
    """A finite number > above, >= least and <= most."""

    def check(value: Any) -> float:
        x = _as_number(value)
        if not x > above:
            raise _BadValue(f"must be greater than {above:g}")
        if x < least:
            raise _BadValue(f"must be at least {least:g}")
        if x > most:
            raise _BadValue(f"must be at most {most:g}")
        return x

    return _entry(check, default)


def whole(default: Any = MISSING, *, least: int, most: int) -> Any:
    """A whole number from least to most."""

    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise _BadValue("is not a whole number")
        if not least <= value <= most:
            raise _BadValue(f"must be from {least} to {most}")
        return value

    return _entry(check, default)


def flag(default: bool) -> Any:
    """true or false."""

    def check(value: Any) -> bool:
        if not isinstance(value, bool):
            raise _BadValue("is neither true nor false")
        return value

    return _entry(check, default)


def choice(*names: str, default: Any = MISSING) -> Any:
    """One of some words."""

    def check(value: Any) -> str:
        if value not in names:
            raise _BadValue(f"is not one of {', '.join(names)}")
        return str(value)

    return _entry(check, default)


def text(default: Any = MISSING) -> Any:
    """Any words."""

    def check(value: Any) -> str:
        if not isinstance(value, str) or not value:
            raise _BadValue("is not a text")
        return value

    return _entry(check, default)


def as_vector(value: Any) -> tuple[float, float]:
    """A pair of finite numbers."""
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise _BadValue("is not a pair of numbers [x, y]")
    return _as_number(value[0]), _as_number(value[1])


def vector(default: Any = MISSING) -> Any:
    """A pair [x, y]."""
    return _entry(as_vector, default)


def as_polygon(value: Any) -> tuple[tuple[float, float], ...]:
    """At least three points."""
    if not isinstance(value, list | tuple) or len(value) < 3:
        raise _BadValue("is not a list of at least three points [x, y]")
    return tuple(as_vector(point) for point in value)


def polygon(default: Any = MISSING) -> Any:
    """A closed polygon: a list of at least three points."""
    return _entry(as_polygon, default)


def polygons(default: Any = MISSING) -> Any:
    """A list of closed polygons."""

    def check(value: Any) -> tuple[tuple[tuple[float, float], ...], ...]:
        if not isinstance(value, list | tuple):
            raise _BadValue("is not a list of polygons")
        return tuple(as_polygon(item) for item in value)

    return _entry(check, default)


def words(*names: str) -> Any:
    """A list of some words, none by default."""

    def check(value: Any) -> tuple[str, ...]:
        if not isinstance(value, list | tuple):
            raise _BadValue("is not a list of words")
        for name in value:
            if name not in names:
                raise _BadValue(f"holds {name!r}, which is not one of {', '.join(names)}")
        return tuple(value)

    return _entry(check, ())


def custom(check: Check, default: Any = MISSING) -> Any:
    """A value with a check of its own, which raises ValueError with what is wrong."""
    return _entry(check, default)


def read_record(cls: type[Record], table: Any, where: str) -> Record:
    """The record of `table`, a parsed TOML table; `where` is "file: [table]" for the messages of InputError."""
    if not isinstance(table, dict):
        raise InputError(f"{where} is not a table")
    known: dict[str, Field[Any]] = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    for key, value in table.items():
        if key not in known:
            raise InputError(f"{where} {key} = {value!r}: unknown key; known are {', '.join(known)}")
    values = {}
    for key, entry in known.items():
        if key not in table:
            if entry.default is MISSING:
                raise InputError(f"{where} {key}: is missing")
            continue
        try:
            values[key] = entry.metadata["check"](table[key])
        except ValueError as error:
            raise InputError(f"{where} {key} = {table[key]!r}: {error}") from error
    return cls(**values)
