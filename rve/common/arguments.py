"""Arguments of public functions, and fields of records, that are not of the classes they name: one sentence says so."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache, wraps
from numbers import Integral, Real
from os import PathLike
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from rve.common.errors import InputError, shown
from rve.common.typed import NAMES, types_of

Function = TypeVar("Function", bound=Callable[..., Any])

MADE_BY = {
    "Scene": "load_scene reads a file, read_scene a dict",
    "StrainTable": "read_table reads a file",
    "Cell": "Cell(r1, r2) makes one, and Cell.of(inner=8, wire=1)",
}
"""How users come by the records that functions take."""


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
def _hints(function: Any) -> Mapping[str, Any]:
    return get_type_hints(function)


def _check(name: str, given: Mapping[str, Any], kinds: Mapping[str, Any]) -> None:
    for key, value in given.items():
        if key in kinds and not _is_a(value, kinds[key]):
            wanted = list(dict.fromkeys(_words(kinds[key])))
            is_plain = isinstance(value, str | Real | list | tuple | dict | None)
            told = f"{name}: {key} = {shown(value)}" if is_plain else f"{name}: {key}"
            got = f"the class {value.__name__}" if isinstance(value, type) else _word(type(value))
            if isinstance(value, list | tuple) and wanted[0].startswith("a list of "):
                got += f" of {len(value)}"
            hint = f"; {MADE_BY[wanted[0]]}" if wanted[0] in MADE_BY else ""
            raise InputError(f"{told}: expected {' or '.join(wanted)}, got {got}{hint}")


def _is_a(value: Any, kind: Any) -> bool:
    """Whether a value is of a type; of arrays and lists is whatever may be one, of protocols what is no plain data."""
    if kind in type(value).__mro__:
        return True
    cls, parts = get_origin(kind) or kind, get_args(kind)
    if cls in (Union, UnionType):
        return any(_is_a(value, part) for part in parts)
    if cls in (Annotated, Literal):
        return _is_a(value, parts[0]) if cls is Annotated else isinstance(value, str) and value in parts
    if cls is Any or not isinstance(cls, type):
        return True
    if cls.__module__.startswith("numpy"):  # arrays, and what can be made one
        return not isinstance(value, str | bytes | Mapping | type | None)
    if vars(cls).get("_is_protocol"):
        return not isinstance(value, str | Real | Iterable | type | None)
    if cls in (tuple, list, Sequence):
        is_list = isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)
        each = parts[:1] * len(list(value)) if is_list and Ellipsis in parts else parts
        return is_list and (cls is not tuple or (len(list(value)) == len(each) and all(map(_is_a, value, each))))
    wider: dict[Any, Any] = {float: Real, int: Integral, str: str | PathLike}
    return isinstance(value, wider.get(cls, cls))


def _words(kind: Any) -> list[str]:
    """What users call the members of a type, without None."""
    cls, parts = get_origin(kind) or kind, get_args(kind)
    if cls in (Union, UnionType):
        words = [word for part in parts for word in _words(part) if word != NAMES["NoneType"]]
        return ["a list"] if "_SupportsArray" in words else words  # of what numpy takes for one
    if cls is tuple and parts:
        return [f"a list, each {_words(parts[0])[0]}" if Ellipsis in parts else f"a list of {len(parts)}"]
    return [repr(part) for part in parts] if cls is Literal else [_word(cls)]


def _word(cls: Any) -> str:
    return NAMES.get(cls.__name__, cls.__name__)
