"""Records whose fields msgspec checks by their types, in Python and from files; a refusal is one sentence.

A type may have a range, `Annotated[float, Meta(gt=0.0, le=1e6, title="mm")]`; one with two ends keeps out NaN and
infinite numbers. The title is the unit.
"""

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import MISSING, fields
from functools import cache
from inspect import get_annotations
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from rve.common.errors import InputError, shown

Record = TypeVar("Record", bound="Typed")

NAMES = {"float": "a number", "int": "a whole number", "str": "a text", "bool": "true or false", "array": "a list"}
NAMES |= {"object": "a table", "dict": "a dict", "Mapping": "a dict", "Path": "a path", "PathLike": "a path"}
NAMES |= dict.fromkeys(("list", "tuple", "Sequence", "ndarray"), "a list")
NAMES |= dict.fromkeys(("null", "NoneType"), "nothing")
NUMBER = re.compile(r"\s*([-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?)\s*([^\d.,\s]\S*)?\s*")
"""A number, with a decimal point or comma, and what may stand behind it."""
UNITS = {
    "mm": {"m": 1e3, "cm": 10.0, "km": 1e6},
    "N": {"kN": 1e3, "MN": 1e6, "kg": 9.81},
    "N/mm": {"kN/m": 1.0, "N/m": 1e-3, "kN/mm": 1e3},
    "N/m2": {"Pa": 1.0, "kPa": 1e3, "kN/m2": 1e3, "MPa": 1e6, "N/mm2": 1e6, "bar": 1e5},
    "N/mm2": {"MPa": 1.0, "GPa": 1e3, "kN/mm2": 1e3, "Pa": 1e-6, "N/m2": 1e-6},
    "kg": {"g": 1e-3, "t": 1e3},
    "kg/m2": {"g/m2": 1e-3, "kg/mm2": 1e6, "g/mm2": 1e3},
    "kg/m3": {"g/cm3": 1e3, "kg/dm3": 1e3, "kg/mm3": 1e9},
    "kg/mm3": {"kg/m3": 1e-9, "g/cm3": 1e-6},
    "s": {"ms": 1e-3, "min": 60.0, "h": 3600.0},
    "m/s": {"km/h": 1.0 / 3.6, "mm/s": 1e-3},
    "mm/s": {"m/s": 1e3},
    "degrees": {"deg": 1.0, "\N{DEGREE SIGN}": 1.0, "rad": math.degrees(1.0)},
    "m/s2": {"mm/s2": 1e-3, "g": 9.81},
}
"""What a unit of files is in others that a user may have meant, and how many of it these are."""


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
                object.__setattr__(self, name, typed(vars(self)[name], kind, name))
            except ValueError as error:
                self.refuse(str(error))
        self.check()

    def check(self) -> None:
        """BadField for fields that contradict each other."""

    def refuse(self, what: str) -> None:
        raise BadField(what, type(self).__name__) from None


@cache
def types_of(cls: Any) -> Mapping[str, Any]:
    """The type of each field of a dataclass, with its range; InputError for a class that was not made one."""
    hints = get_type_hints(cls, include_extras=True)
    own = [name for name in get_annotations(cls) if get_origin(hints[name]) is not ClassVar]
    if (own or "__init__" in vars(cls)) and "__dataclass_fields__" not in vars(cls):
        raise InputError(f"class {cls.__name__} has no fields of its own: is it a @dataclass(frozen=True)?")
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


def refuse_unknown(
    table: Mapping[str, Any], known: Iterable[str], where: str, what: str = "key", hint: str = ""
) -> None:
    """InputError for what is no table, and for its first key that is not known, with the one probably meant, and the
    `hint` if it is a table itself."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where} is not a table of names and values")
    known = list(known)
    for key, value in table.items():
        if key not in known:
            named = f"{key!s:.80} = {shown(value)}" if what == "key" else f"{key!s:.80}"
            listed = f"{did_you_mean(key, known)}known are {', '.join(known) or 'none'}"
            raise InputError(f"{where} {named}: unknown {what}; {listed}{hint * isinstance(value, dict | list)}")


def _plain(value: Any) -> Any:
    """Lists and numbers of Python in place of those of numpy."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, float):
        return float(value)
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def not_one_of(value: Any, known: Iterable[str]) -> str:
    """What is said of a value that is none of the words known: these, and the one probably meant.

    >>> not_one_of("Hook", ["top", "hooks"])
    'is not one of top, hooks; did you mean hooks?'
    """
    known = list(known)
    return f"is not one of {', '.join(known)}; {did_you_mean(value, known)}".rstrip("; ")


def did_you_mean(word: Any, known: Iterable[str]) -> str:
    """A question for the word that is nearest of those known, "" if none is near.

    >>> did_you_mean("e 11", ["E11", "alpha_deg"])
    'did you mean E11? '
    """
    return "".join(f"did you mean {near}? " for near in nearest(word, known))


def nearest(word: Any, known: Iterable[str]) -> list[str]:
    """The word that is nearest of those known, whatever its case and blanks; none if none is near."""
    words = {folded(one): one for one in known}
    return [words[near] for near in difflib.get_close_matches(folded(word), words, 1)]


def folded(word: Any) -> str:
    """The first letters of a word without case, blanks and lines, by which words are compared."""
    return re.sub(r"[\s_-]", "", str(word)[:80]).casefold()


def alone(text: str, unit: str = "") -> str:
    """How the number in a text is written; "" if there is none, and none that is written in another way.

    >>> alone("0,5"), alone("0.5 kN", "N"), alone("5 mm")
    ('has a decimal comma; write 0.5', 'write the number alone, in N: 500', 'write the number alone: 5')
    """
    found = NUMBER.fullmatch(text)
    if not found:
        return ""
    number, behind = found[1].replace(",", "."), found[2] or ""
    if not behind:
        return f"has a decimal comma; write {number}" if "," in found[1] else ""
    factor = 1.0 if behind == unit or not unit else UNITS.get(unit, {}).get(behind)
    value = "" if factor is None else f": {float(number) * factor:g}"
    return f"write the number alone{', in ' * bool(unit)}{unit}{value}"


def _words(what: str, value: Any, kind: Any) -> str:
    """What msgspec says, by the names of types that users know, or the words that a text may be; and the way out."""
    words, numbers = _literals(kind), _numbers(kind)
    if words and what.startswith(("Invalid enum value", "Expected `str")):
        return not_one_of(value, words)
    told = re.sub(
        "`(.+?)`",
        lambda found: " or ".join(NAMES.get(kind, kind) for kind in found[1].removesuffix(" | null").split(" | ")),
        what,
    )
    units, hint = {_unit(number) for number in numbers}, ""
    unit = units.pop() if len(units) == 1 else ""
    if isinstance(value, str) and re.search("`.*(float|int|array).*`, got", what):
        hint = alone(value, unit) or "write it without quotes" * bool(NUMBER.fullmatch(value))
    elif isinstance(value, int | float) and unit and re.search("[<>]", what):
        told += f" {unit}"
        hint = _in_other_unit(value, numbers[0])
    elif isinstance(value, list) and f"length {len(value) / 2:g}, got" in what:
        hint = "a decimal comma is written as a point"
    return told[0].lower() + told[1:] + ("; " * bool(hint)) + hint


def _in_other_unit(value: float, kind: Any) -> str:
    """The number that is meant, and its unit, if it would be in the range of a type from one; else ""."""
    for other, factor in UNITS.get(_unit(kind), {}).items():
        with suppress(msgspec.ValidationError):
            return f"did you mean {msgspec.convert(factor * value, kind):g}, from {other}?"
    return ""


def _literals(kind: Any) -> list[str]:
    """The words that a type allows."""
    if get_origin(kind) is Literal:
        return list(get_args(kind))
    if kind is bool:
        return ["true", "false"]
    return [word for part in get_args(kind) for word in _literals(part)]


def _numbers(kind: Any) -> list[Any]:
    """The types of numbers with a range that a type is made of."""
    parts = get_args(kind)
    if get_origin(kind) is Annotated and parts[0] in (float, int):
        return [kind]
    return [number for part in parts for number in _numbers(part)]


def _unit(number: Any) -> str:
    """The unit of such a type, "" for none."""
    return "".join(part.title or "" for part in get_args(number) if isinstance(part, msgspec.Meta))
