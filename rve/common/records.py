"""Arrays, and records of arrays with one row per case: rows taken, replaced and joined."""

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rve.common.errors import InputError, shown

Array = NDArray[np.float64]
"""Floating-point array; its shape is stated where it is used."""
Index = NDArray[np.intp]
Flags = NDArray[np.bool_]


def floats(values: Any, what: str) -> Array:
    """Values of others as an array; InputError, which begins with `what`, for words and rows of unlike length."""
    try:
        return np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} = {shown(values)}: is no array of numbers") from error


class ByValue:
    """Base of dataclasses, made with eq=False, that are equal where their fields are: arrays by value, nan to nan."""

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and _is_same(self, other)

    def __hash__(self) -> int:
        return hash(type(self))


def _is_same(a: Any, b: Any) -> bool:
    if is_dataclass(a):
        return type(a) is type(b) and all(_is_same(vars(a)[f.name], vars(b)[f.name]) for f in fields(a))
    if isinstance(a, np.ndarray):
        same_kind = isinstance(b, np.ndarray) and a.shape == b.shape
        return same_kind and bool(((a == b) | (a != a) & (b != b)).all())
    if isinstance(a, list | tuple):
        return type(a) is type(b) and len(a) == len(b) and all(map(_is_same, a, b))
    return bool(a == b)


class Rows(ByValue):
    """Base of frozen dataclasses whose arrays, and whose fields that are Rows, have the case as first axis.

    Other fields belong to all cases. Every method returns a new record; no array is written in place.

    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Point(Rows):
    ...     x: NDArray[np.float64]
    ...     unit: str = "mm"
    >>> three = Point(np.array([1.0, 2.0, 3.0]))
    >>> three.take(np.array([2, 0]))
    Point(x=array([3., 1.]), unit='mm')
    >>> three.put(np.array([1]), Point(np.array([7.0]))).x
    array([1., 7., 3.])
    >>> three.join([three.take(np.array([0]))]).x
    array([1., 2., 3., 1.])
    """

    def take(self, rows: Index | Flags) -> Self:
        """The record of these rows, by number or by flag."""
        return self._with(lambda name, own: own[rows] if isinstance(own, np.ndarray) else own.take(rows))

    def put(self, rows: Index, other: Self) -> Self:
        """A copy in which `rows` are replaced by those of `other`."""

        def put(name: str, own: Any) -> Any:
            if not isinstance(own, np.ndarray):
                return own.put(rows, vars(other)[name])
            copy = own.copy()
            copy[rows] = vars(other)[name]
            return copy

        return self._with(put)

    def join(self, others: Sequence[Self]) -> Self:
        """The rows of this record and of the others, one after the other."""

        def join(name: str, own: Any) -> Any:
            parts = [vars(other)[name] for other in others]
            return np.concatenate([own, *parts]) if isinstance(own, np.ndarray) else own.join(parts)

        return self._with(join)

    def _with(self, change: Callable[[str, Any], Any]) -> Self:
        """A copy in which the fields with one row per case are changed; no cached property goes along."""
        new: dict[str, Any] = {}
        for item in fields(self):  # type: ignore[arg-type]
            own = vars(self)[item.name]
            new[item.name] = change(item.name, own) if isinstance(own, (np.ndarray, Rows)) else own
        return type(self)(**new)
