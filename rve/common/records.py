"""Records of arrays with one row per case: rows taken, replaced and joined, written once for all records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.intp]
Flags = NDArray[np.bool_]


class Rows:
    """Base of frozen dataclasses whose arrays, and whose fields that are Rows, have the case as first axis.

    Other fields belong to all cases and stay as they are. Every method returns a new record; no array is written in
    place.

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

    def _rowwise(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray | Rows)}

    def take(self, rows: Index | Flags) -> Self:
        """The record of these rows, by number or by flag."""
        columns = {
            name: value[rows] if isinstance(value, np.ndarray) else value.take(rows)
            for name, value in self._rowwise().items()
        }
        return replace(self, **columns)  # type: ignore[type-var]

    def put(self, rows: Index, other: Self) -> Self:
        """A copy in which `rows` are replaced by those of `other`."""
        columns = {}
        for name, value in self._rowwise().items():
            part = getattr(other, name)
            if isinstance(value, np.ndarray):
                columns[name] = value.copy()
                columns[name][rows] = part
            else:
                columns[name] = value.put(rows, part)
        return replace(self, **columns)  # type: ignore[type-var]

    def join(self, others: Sequence[Self]) -> Self:
        """The rows of this record and of the others, one after the other."""
        columns = {}
        for name, value in self._rowwise().items():
            parts = [getattr(other, name) for other in others]
            columns[name] = np.concatenate([value, *parts]) if isinstance(value, np.ndarray) else value.join(parts)
        return replace(self, **columns)  # type: ignore[type-var]
