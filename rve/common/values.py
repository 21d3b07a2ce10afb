"""Values read from files, checked: numbers in a range, lists of numbers of a shape, choices, texts; records of them.

A check takes a value as a TOML or JSON parser gives it and returns it in its own type, or raises ValueError with what
is wrong with it and what is allowed. `checked` and `read_record` add file and key. All readers of the three packages
use these checks, and so do option records made in Python (`Options`); nothing here knows of rings, laws or curtains.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, field, fields
from typing import Any, Self, TypeVar

import numpy as np

from rve.common.errors import InputError
from rve.common.types import Array

Check = Callable[[Any], Any]
Record = TypeVar("Record")


class BadValue(ValueError):
    """What is wrong with a value, to be completed with file and key."""


_short = reprlib.Repr()
_short.maxstring = _short.maxother = _short.maxlong = 80


def shown(value: Any) -> str:
    """A value as an error message shows it: its repr, cut to about a line however large or deep the value is."""
    text = _short.repr(value)
    return text if len(text) <= 160 else f"{text[:157]}..."


# Checks: each returns a function of one value.


def finite(*, above: float = -math.inf, least: float = -math.inf, most: float = math.inf) -> Check:
    """A finite number > above, >= least and <= most.

    >>> finite(above=0.0, most=10.0)(3)
    3.0
    """

    def check(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise BadValue("is not a number")
        try:
            x = float(value)
        except OverflowError:  # a whole number of more than 308 digits
            x = math.inf
        if not math.isfinite(x):
            raise BadValue("is not a finite number")
        if not x > above:
            raise BadValue(f"must be greater than {above:g}")
        if x < least:
            raise BadValue(f"must be at least {least:g}")
        if x > most:
            raise BadValue(f"must be at most {most:g}")
        return x

    return check


def integer(least: int, most: int) -> Check:
    """A whole number from least to most."""

    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise BadValue("is not a whole number")
        if not least <= value <= most:
            raise BadValue(f"must be from {least} to {most}")
        return value

    return check


def boolean(value: Any) -> bool:
    """true or false."""
    if not isinstance(value, bool):
        raise BadValue("is neither true nor false")
    return value


def string(value: Any) -> str:
    """A text that is not empty."""
    if not isinstance(value, str) or not value:
        raise BadValue("is not a text")
    return value


def mapping(value: Any) -> dict[str, Any]:
    """A table of names and values."""
    if not isinstance(value, dict):
        raise BadValue("is not a table of names and values")
    return value


def one_of(*names: str) -> Check:
    """One of some words."""

    def check(value: Any) -> str:
        if value not in names:
            raise BadValue(f"is not one of {', '.join(names)}")
        return str(value)

    return check


def list_of(check_item: Check, what: str, *, least: int = 0, most: int) -> Check:
    """A list of least to most values that each pass a check; `what` names them in the plural."""

    def check(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple) or len(value) < least:
            raise BadValue(f"is not a list of {f'at least {least} ' if least else ''}{what}")
        if len(value) > most:
            raise BadValue(f"has {len(value)} {what}, at most {most} are allowed")
        return tuple(checked_item(item) for item in value)

    def checked_item(item: Any) -> Any:
        try:
            return check_item(item)
        except BadValue as error:
            raise BadValue(f"holds {shown(item)}, which {error}") from error

    return check


def numbers(*shape: int | None, least: float = -math.inf, most: float = math.inf, longest: int = 1_000_000) -> Check:
    """Nested lists of finite numbers from least to most as an array of this shape; None: any length from 1 to longest.

    >>> numbers(None, 2)([[1, 2], [3, 4], [5, 6]]).shape
    (3, 2)
    """
    words = " x ".join("n" if size is None else str(size) for size in shape)

    def check(value: Any) -> Array:
        level, sizes = [value], []
        for _ in shape:
            if not all(isinstance(item, list | tuple) for item in level):
                raise BadValue(f"is not a list of {words} numbers")
            widths = {len(item) for item in level}
            if len(widths) != 1:
                raise BadValue(f"is not a list of {words} numbers: its rows have different lengths")
            sizes.append(widths.pop())
            if sizes[-1] > longest:
                raise BadValue(f"has {sizes[-1]} rows, at most {longest} are allowed")
            level = [number for item in level for number in item]
            if not level:
                raise BadValue(f"is not a list of {words} numbers: it is empty")
        if any(want is not None and want != size for want, size in zip(shape, sizes, strict=True)):
            raise BadValue(f"is a list of {' x '.join(map(str, sizes))} numbers, it must be {words}")
        one = finite(least=least, most=most)
        try:
            return np.array([one(number) for number in level]).reshape(sizes)
        except BadValue as error:
            raise BadValue(f"holds a number that {error}") from error

    return check


def optional(check_value: Check) -> Check:
    """None, or what passes the check."""
    return lambda value: None if value is None else check_value(value)


# Fields of records: the check of a key stands beside it in the dataclass.


def entry(check: Check, default: Any = MISSING) -> Any:
    """A field of a record with this check."""
    return field(metadata={"check": check}) if default is MISSING else field(default=default, metadata={"check": check})


def number(
    default: Any = MISSING, *, above: float = -math.inf, least: float = -math.inf, most: float = math.inf
) -> Any:
    """A field for a finite number > above, >= least and <= most."""
    return entry(finite(above=above, least=least, most=most), default)


def whole(default: Any = MISSING, *, least: int, most: int) -> Any:
    """A field for a whole number from least to most."""
    return entry(integer(least, most), default)


def flag(default: bool) -> Any:
    """A field that is true or false."""
    return entry(boolean, default)


def choice(*names: str, default: Any = MISSING) -> Any:
    """A field for one of some words."""
    return entry(one_of(*names), default)


def text(default: Any = MISSING) -> Any:
    """A field for a text."""
    return entry(string, default)


def words(*names: str) -> Any:
    """A field for a list of some words, none by default."""
    return entry(list_of(one_of(*names), "words", most=100), ())


def checked(table: Mapping[str, Any], key: str, check: Check, where: object) -> Any:
    """table[key] after its check; InputError "where key = value: what is wrong" if it is missing or does not pass.

    >>> checked({"r1_mm": 5}, "r1_mm", finite(above=0.0), "law.json: cell")
    5.0
    """
    named = f"{where} {key}".lstrip()
    if key not in table:
        raise InputError(f"{named}: is missing")
    try:
        return check(table[key])
    except ValueError as error:
        raise InputError(f"{named} = {shown(table[key])}: {error}") from error


def read_record(cls: type[Record], table: Any, where: str, *, strict: bool = True) -> Record:
    """The record of a parsed table; `where` names file and table in the messages of InputError.

    Keys without a field are refused, or with strict = False ignored.
    """
    if not isinstance(table, dict):
        raise InputError(f"{where} is not a table of names and values")
    known: dict[str, Field[Any]] = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    for key, value in table.items():
        if strict and key not in known:
            raise InputError(f"{where} {shown_key(key)} = {shown(value)}: unknown key; known are {', '.join(known)}")
    values = {
        key: checked(table, key, item.metadata["check"], where)
        for key, item in known.items()
        if key in table or item.default is MISSING
    }
    return cls(**values)


def shown_key(key: str) -> str:
    """A key as an error message shows it."""
    return key if key.isidentifier() and key.isascii() and len(key) <= 80 else shown(key)


class Options:
    """Base of frozen dataclasses of options: a value is checked by the check of its field when the record is made.

    InputError for a name that is no field, and for a value that does not pass.

    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Steps(Options):
    ...     most: int = whole(20, least=1, most=100)
    >>> Steps(most=0)
    Traceback (most recent call last):
    ...
    rve.common.errors.InputError: Steps: most = 0: must be from 1 to 100
    """

    def __new__(cls, *values: Any, **named: Any) -> Self:
        """An empty record, if all names are known."""
        known = [item.name for item in fields(cls)]  # type: ignore[arg-type]
        for name in named:
            if name not in known:
                raise InputError(f"{cls.__name__}: {shown_key(name)}: unknown option; known are {', '.join(known)}")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        """Check every field that has a check."""
        for item in fields(self):  # type: ignore[arg-type]
            if "check" in item.metadata:
                checked(vars(self), item.name, item.metadata["check"], f"{type(self).__name__}:")
