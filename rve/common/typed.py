"""Records whose fields msgspec checks by their types, in Python and from files; a refusal is one sentence.

A type may have a range, `Annotated[float, Meta(gt=0.0, le=1e6)]`; one with two ends keeps out NaN and infinite numbers.
"""

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from functools import cache
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from rve.common.errors import InputError, shown

Record = TypeVar("Record", bound="Typed")

NAMES = {"float": "a number", "int": "a whole number", "str": "a text", "bool": "true or false", "array": "a list"}


class BadField(InputError):
    """A field that does not fit: `what` is wrong, without the name of the record or the table that has it."""

    def __init__(self, what: str, where: str) -> None:
        super().__init__(f"{where}: {what}")
        self.what = what


class Typed:
    """Base of frozen dataclasses whose fields are checked by their types when a record is made.

    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Steps(Typed):
    ...     most: int = 20
    >>> Steps(most=0.5)
    Traceback (most recent call last):
    ...
    rve.common.typed.BadField: Steps: most = 0.5: expected a whole number, got a number
    """

    def __post_init__(self) -> None:
        """Check every field; BadField (an InputError) for the first one that does not fit."""
        for name, kind in types_of(type(self)).items():  # type: ignore[arg-type]
            try:
                object.__setattr__(self, name, typed(getattr(self, name), kind, name))
            except ValueError as error:
                self.refuse(str(error))
        self.check()

    def check(self) -> None:
        """BadField for fields that contradict each other."""

    def refuse(self, what: str) -> None:
        raise BadField(what, type(self).__name__) from None


@cache
def types_of(cls: Any) -> dict[str, Any]:
    """The type of each field of a dataclass, with its range."""
    hints = get_type_hints(cls, include_extras=True)
    return {item.name: hints[item.name] for item in fields(cls) if item.init}


def typed(value: Any, kind: Any, key: str) -> Any:
    """A value as its type has it: whole numbers as floats, lists as tuples. ValueError: "key = value: what is wrong".

    >>> typed([1, 2], tuple[float, float], "at")
    (1.0, 2.0)
    """
    value = _plain(value)
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        what, _, path = str(error).partition(" - at `$")
        path = path.rstrip("`")
        for name, number in re.findall(r"\.(\w+)|\[(\d+)\]", path):
            value = value[name or int(number)]
        raise ValueError(f"{key}{path} = {shown(value)}: {_words(what, value, kind)}") from None


def read_typed(cls: type[Record], table: Any, where: str) -> Record:
    """The record of a parsed table; InputError, which begins with `where`, for keys and values that do not fit."""
    refuse_unknown(table, types_of(cls), where)  # type: ignore[arg-type]
    for item in fields(cls):  # type: ignore[arg-type]
        if item.init and item.name not in table and item.default is MISSING:
            raise InputError(f"{where} {item.name}: is missing")
    try:
        return cls(**table)
    except BadField as error:
        raise InputError(f"{where} {error.what}") from None


def read_entry(table: Mapping[str, Any], key: str, kind: Any, where: str = "") -> Any:
    """table[key] as its type has it; InputError "where key = value: what is wrong" if it is missing or does not fit.

    >>> read_entry({"r1_mm": 5}, "r1_mm", float, "law.json: cell")
    5.0
    """
    named = f"{where} {key}".lstrip()
    if key not in table:
        raise InputError(f"{named}: is missing")
    try:
        return typed(table[key], kind, named)
    except ValueError as error:
        raise InputError(str(error)) from None


def refuse_unknown(table: Mapping[str, Any], known: Iterable[str], where: str, what: str = "key") -> None:
    """InputError for what is no table, and for its first key that is not known, with the one probably meant."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where} is not a table of names and values")
    known = list(known)
    for key, value in table.items():
        if key not in known:
            named = f"{key} = {shown(value)}" if what == "key" else key
            listed = f"known are {', '.join(known) or 'none'}"
            raise InputError(f"{where} {named:.160}: unknown {what}; {_meant(key, known)}{listed}")


def _plain(value: Any) -> Any:
    """Lists and numbers of Python in place of those of numpy."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _meant(word: str, known: Iterable[str]) -> str:
    return "".join(f"did you mean {near}? " for near in difflib.get_close_matches(word, known, 1))


def _words(what: str, value: Any, kind: Any) -> str:
    """What msgspec says, by the names of types that users know, or the words that a text may be."""
    words = _literals(kind)
    if words and what.startswith(("Invalid enum value", "Expected `str")):
        return f"is not one of {', '.join(words)}; {_meant(str(value), words)}".rstrip("; ")
    told = re.sub("`(.+?)`", lambda found: " or ".join(NAMES.get(one, one) for one in found[1].split(" | ")), what)
    return told[0].lower() + told[1:]


def _literals(kind: Any) -> list[str]:
    """The words that a type allows."""
    if get_origin(kind) is Literal:
        return list(get_args(kind))
    return [word for part in get_args(kind) for word in _literals(part)]
