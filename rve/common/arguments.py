"""Arguments of public functions, and fields of records, that are not of the classes they name: one sentence says so."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache, wraps
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from rve.common.errors import InputError, shown
from rve.common.typed import types_of

Function = TypeVar("Function", bound=Callable[..., Any])

MADE_BY = {
    "Scene": "load_scene reads a file, read_scene a dict",
    "StrainTable": "read_table reads a file",
    "StoredLaw": "load_law reads a file",
    "Cell": "Cell(r1, r2) makes one",
}
"""How users come by the records that functions take."""
NAMES: dict[Any, str] = {float: "number", int: "whole number", bool: "truth value", str: "text", tuple: "list"}
NAMES |= {dict: "dict", list: "list", Sequence: "list", Mapping: "dict", Path: "path", PathLike: "path"}


def checked(function: Function) -> Function:
    """A public function that refuses arguments which are not of the classes it names by InputError.

    >>> @checked
    ... def half(length: float) -> float:
    ...     return 0.5 * length
    >>> half([3.0])
    Traceback (most recent call last):
    ...
    rve.common.errors.InputError: half: length = [3.0]: expected a number, got a list
    """
    signature = inspect.signature(function)

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        with suppress(TypeError):  # of arguments that are missing or too many, which Python tells
            _check(function.__name__, signature.bind(*args, **kwargs).arguments, _hints(function))
        return function(*args, **kwargs)

    return call  # type: ignore[return-value]


def check_fields(record: Any) -> None:
    """InputError for fields of a record that are not of the classes they name."""
    _check(type(record).__name__, vars(record), types_of(type(record)))  # type: ignore[arg-type]


@cache
def _hints(function: Any) -> dict[str, Any]:
    return get_type_hints(function)


def _check(name: str, given: Mapping[str, Any], kinds: Mapping[str, Any]) -> None:
    for key, value in given.items():
        if key in kinds and not _is_a(value, kinds[key]):
            wanted = list(dict.fromkeys(_words(kinds[key])))
            is_plain = isinstance(value, str | Real | list | tuple | dict | None)
            told = f"{name}: {key} = {shown(value)}" if is_plain else f"{name}: {key}"
            got = "" if value is None else f", got {_kind_of(value)}"
            hint = "".join(f"; {MADE_BY[word]}" for word in wanted[:1] if word in MADE_BY)
            words = _with_article(" or ".join(word for word in wanted if word != "text" or "path" not in wanted))
            raise InputError(f"{told}: expected {words}{got}{hint}")


def _kind_of(value: Any) -> str:
    kind = NAMES.get(type(value), type(value).__name__)
    return f"the class {value.__name__}" if isinstance(value, type) else _with_article(kind)


def _with_article(word: str) -> str:
    return word if word[:1] == "'" else f"{'an' if word[:1] in 'aeioAEIO' else 'a'} {word}"


def _is_a(value: Any, kind: Any) -> bool:
    """Whether a value is of a type; of arrays and lists is whatever may be one, of protocols what is no plain data."""
    cls, parts = get_origin(kind) or kind, get_args(kind)
    if cls in (Union, UnionType):
        return any(_is_a(value, part) for part in parts)
    if cls is Annotated:
        return _is_a(value, parts[0])
    if cls is Literal:
        return isinstance(value, str) and value in parts
    if cls is str:
        return isinstance(value, str | PathLike)
    if cls in (float, int):
        return isinstance(value, Real if cls is float else Integral)
    if cls is Any or not isinstance(cls, type):
        return True
    if cls.__module__.startswith("numpy"):  # arrays, and what can be made one
        return not isinstance(value, str | bytes | Mapping | type | None)
    if vars(cls).get("_is_protocol"):
        return not isinstance(value, str | Real | Mapping | Iterable | type | None)
    if cls in (tuple, list, Sequence):
        is_list = isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)
        return is_list and (cls is not tuple or _fits(list(value), parts))
    return isinstance(value, cls)


def _fits(values: list[Any], parts: tuple[Any, ...]) -> bool:
    """Whether values are of the types of a tuple."""
    if Ellipsis in parts:
        parts = parts[:1] * len(values)
    return len(values) == len(parts) and all(map(_is_a, values, parts))


def _words(kind: Any) -> list[str]:
    """What users call the members of a type, without None."""
    cls, parts = get_origin(kind) or kind, get_args(kind)
    if cls in (Union, UnionType):
        words = [word for part in parts for word in _words(part)]
        return ["list of numbers"] if "list of numbers" in words else words  # and what else numpy takes for one
    if cls is Annotated:
        return _words(parts[0])
    if cls is Literal:
        return [repr(part) for part in parts]
    if not isinstance(cls, type) or cls is NoneType:
        return []
    if cls.__module__.startswith("numpy"):
        return ["list of numbers"]
    if cls is tuple and parts:
        return [f"list of {_words(parts[0])[0]}" if Ellipsis in parts else f"list of {len(parts)}"]
    return [NAMES.get(cls, cls.__name__)]
