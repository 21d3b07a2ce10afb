"""Gmsh files (MSH 2.2 and 4.1, ASCII and binary) read within bounds: points, cells, and physical groups.

Counts in the file say how many numbers follow; a count beyond the end of the file is refused before anything is made.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rve.common.storage.reading import parse_numbers
from rve.common.types import Array
from rve.common.values import shown

Index = NDArray[np.int64]

KINDS = {1: "line", 2: "triangle", 3: "quad", 4: "tetra", 5: "hexahedron", 6: "wedge", 7: "pyramid", 8: "line3"}
KINDS |= {9: "triangle6", 10: "quad9", 11: "tetra10", 15: "vertex", 16: "quad8"}
SIZES = {1: 2, 2: 3, 3: 4, 4: 4, 5: 8, 6: 6, 7: 5, 8: 3, 9: 6, 10: 9, 11: 10, 15: 1, 16: 8}
_SECTION = re.compile(rb"^\$(\w+)[ \t]*\r?\n", re.MULTILINE)


@dataclass(frozen=True, eq=False)
class GmshFile:
    """points (p, 3); blocks: kind, point numbers (c, k), and the physical group, 0 for none, of each block of cells.

    names: dimension and name of a physical group by (dimension, number).
    """

    points: Array
    blocks: list[tuple[str, Index, int]]
    names: dict[tuple[int, int], str]


class _Numbers(Protocol):
    """Numbers of a section, taken one after the other; ValueError where fewer are left than asked for."""

    def ints(self, count: int) -> Index: ...

    def sizes(self, count: int) -> Index: ...

    def doubles(self, count: int) -> Array: ...


@dataclass
class _Text:
    """Numbers of an ASCII section."""

    values: Array
    place: int = 0

    def doubles(self, count: int) -> Array:
        if not 0 <= count <= len(self.values) - self.place:
            raise ValueError(f"{count} numbers are stated where {len(self.values) - self.place} are left")
        self.place += count
        return self.values[self.place - count : self.place]

    def ints(self, count: int) -> Index:
        found = self.doubles(count)
        if not (np.abs(found) < 2.0**53).all() or (found != np.round(found)).any():
            raise ValueError("a tag or count is not a whole number")
        return found.astype(np.int64)

    sizes = ints


@dataclass
class _Binary:
    """Numbers of a binary section; `order` and `wide` say how the file writes whole numbers."""

    data: memoryview
    place: int
    wide: np.dtype[np.generic]
    order: str

    def _take(self, count: int, dtype: np.dtype[np.generic]) -> NDArray[np.generic]:
        left = len(self.data) - self.place
        if not 0 <= count * dtype.itemsize <= left:
            raise ValueError(f"{count} numbers are stated where {left} bytes are left")
        self.place += count * dtype.itemsize
        return np.frombuffer(self.data[self.place - count * dtype.itemsize : self.place], dtype)

    def ints(self, count: int) -> Index:
        return self._take(count, np.dtype(f"{self.order}i4")).astype(np.int64)

    def sizes(self, count: int) -> Index:
        return self._take(count, self.wide).astype(np.int64)

    def doubles(self, count: int) -> Array:
        return self._take(count, np.dtype(f"{self.order}f8")).astype(np.float64)


@dataclass
class _Found:
    """What the sections have given so far."""

    tags: Index = field(default_factory=lambda: np.zeros(0, np.int64))
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    groups: dict[tuple[int, int], Index] = field(default_factory=dict)
    blocks: list[tuple[int, Index, int]] = field(default_factory=list)
    names: dict[tuple[int, int], str] = field(default_factory=dict)


def read_gmsh(content: bytes) -> GmshFile:
    """The mesh in the bytes of a Gmsh file; ValueError says what is wrong with it."""
    head = re.match(rb"\s*\$MeshFormat\s+(\S+)\s+([01])\s+([48])[ \t]*\r?\n", content)
    if not head:
        raise ValueError("it does not begin with $MeshFormat, version, file type and size of numbers")
    version, is_binary = head[1].decode("ascii", "replace"), head[2] == b"1"
    if version not in ("2", "2.2", "4.1"):
        raise ValueError(f"MSH version {shown(version)} is not read; save it as 2.2 or 4.1")
    order = "<"
    if is_binary and content[head.end() : head.end() + 4] != b"\1\0\0\0":
        order = ">"
    wide = np.dtype(f"{order}u{int(head[3])}")
    readers = {b"Nodes": _nodes_2, b"Elements": _elements_2} if version[0] == "2" else _SECTIONS_4
    found, place = _Found(), head.end()
    while section := _SECTION.search(content, place):
        name, place = section[1], section.end()
        if name.startswith(b"End"):
            continue
        end = content.find(b"$End" + name, place)
        if name == b"PhysicalNames":
            found.names |= _names(content[place:end].decode("utf-8", "replace"))
        elif name in readers and is_binary:
            numbers = _Binary(memoryview(content), place, wide, order)
            readers[name](numbers, found)
            place = numbers.place
            continue
        elif name in readers:
            readers[name](
                _Text(parse_numbers(content[place : end if end >= 0 else None].decode("ascii")).astype(float)), found
            )
        if end < 0:
            raise ValueError(f"section {shown(name.decode())} does not end")
        place = end
    return _mesh(found)


def _names(text: str) -> dict[tuple[int, int], str]:
    rows = re.findall(r'^\s*(\d{1,9})\s+(\d{1,9})\s+"([^"\n]*)"', text, re.MULTILINE)
    return {(int(dimension), int(tag)): name for dimension, tag, name in rows}


def _one(numbers: Index) -> int:
    return int(numbers[0])


def _count_2(numbers: _Numbers) -> int:
    """The count in front of a section of version 2, which is text in binary files too."""
    if isinstance(numbers, _Text):
        return _one(numbers.ints(1))
    assert isinstance(numbers, _Binary)
    line = re.compile(rb"\s*(\d{1,12})[ \t]*\r?\n").match(numbers.data, numbers.place)
    if not line:
        raise ValueError("a section does not begin with a count")
    numbers.place = line.end()
    return int(line[1])


def _nodes_2(numbers: _Numbers, found: _Found) -> None:
    count = _count_2(numbers)
    if isinstance(numbers, _Binary):
        rows = numbers._take(count, np.dtype([("tag", f"{numbers.order}i4"), ("at", f"{numbers.order}f8", 3)]))
        found.tags, found.points = rows["tag"].astype(np.int64), rows["at"].astype(np.float64)  # type: ignore[call-overload]
        return
    rows = numbers.doubles(4 * count).reshape(count, 4)
    found.tags, found.points = _Text(rows[:, 0]).ints(count), rows[:, 1:]


def _elements_2(numbers: _Numbers, found: _Found) -> None:
    count = _count_2(numbers)
    if isinstance(numbers, _Binary):
        while count > 0:
            kind, size, tags = numbers.ints(3).tolist()
            rows = numbers.ints(size * _row(kind, tags, 1)).reshape(size, -1)
            found.blocks += _grouped(kind, tags, rows[:, 1:])
            count -= max(size, 1)
        return
    assert isinstance(numbers, _Text)
    values = numbers.ints(len(numbers.values) - numbers.place)
    place = 0
    while count > 0:
        if place + 3 > len(values):
            raise ValueError(f"{count} elements more are stated than the file holds")
        kind, tags = values[place + 1 : place + 3].tolist()
        row = _row(kind, tags, 3)
        most = min(count, (len(values) - place) // row)
        if not most:
            raise ValueError("the last element ends early")
        size = _alike(values[place : place + most * row].reshape(most, row), kind, tags)
        rows = values[place : place + size * row].reshape(size, row)
        found.blocks += _grouped(kind, tags, rows[:, 3:])
        place, count = place + size * row, count - size


def _row(kind: int, tags: int, head: int) -> int:
    """How many numbers one element has in a file of version 2."""
    if kind not in SIZES or not 0 <= tags <= 100:
        raise ValueError(f"element type {kind} with {tags} tags is not read")
    return head + tags + SIZES[kind]


def _alike(rows: Index, kind: int, tags: int) -> int:
    """How many of the first rows are of this type and number of tags, looked at in growing parts."""
    length = 0
    step = 64
    while length < len(rows):
        part = rows[length : length + step]
        other = np.flatnonzero((part[:, 1] != kind) | (part[:, 2] != tags))
        if len(other):
            return length + int(other[0])
        length += len(part)
        step *= 4
    return length


def _grouped(kind: int, tags: int, rows: Index) -> list[tuple[int, Index, int]]:
    """Blocks of one physical group each from rows of tags and nodes."""
    if not tags:
        return [(kind, rows, 0)]
    return [(kind, rows[rows[:, 0] == group, tags:], int(group)) for group in np.unique(rows[:, 0])]


def _entities(numbers: _Numbers, found: _Found) -> None:
    for dimension, count in enumerate(numbers.sizes(4).tolist()):
        for _ in range(count):
            tag = _one(numbers.ints(1))
            numbers.doubles(3 if dimension == 0 else 6)
            found.groups[dimension, tag] = numbers.ints(_one(numbers.sizes(1)))
            if dimension:
                numbers.ints(_one(numbers.sizes(1)))


def _nodes(numbers: _Numbers, found: _Found) -> None:
    tags, points = [], []
    for _ in range(_one(numbers.sizes(4))):
        if numbers.ints(3)[2]:
            raise ValueError("parametric nodes are not read; save it without them")
        count = _one(numbers.sizes(1))
        tags.append(numbers.sizes(count))
        points.append(numbers.doubles(3 * count).reshape(count, 3))
    if tags:
        found.tags, found.points = np.concatenate(tags), np.concatenate(points)


def _elements(numbers: _Numbers, found: _Found) -> None:
    for _ in range(_one(numbers.sizes(4))):
        dimension, tag, kind = numbers.ints(3).tolist()
        if kind not in SIZES:
            raise ValueError(f"element type {kind} is not read")
        count = _one(numbers.sizes(1))
        rows = numbers.sizes(count * (1 + SIZES[kind])).reshape(count, -1)[:, 1:]
        groups = found.groups.get((dimension, tag), np.zeros(0, np.int64)).tolist() or [0]
        for group in groups if kind == 1 else groups[:1]:  # a line may belong to several named edges
            found.blocks.append((kind, rows, group))


_SECTIONS_4 = {b"Entities": _entities, b"Nodes": _nodes, b"Elements": _elements}


def _mesh(found: _Found) -> GmshFile:
    """Tags of nodes become numbers of points."""
    order = np.argsort(found.tags, kind="stable")
    tags = found.tags[order]
    if len(tags) == 0:
        raise ValueError("it has no nodes")
    if (np.diff(tags) == 0).any():
        raise ValueError(f"node {tags[np.flatnonzero(np.diff(tags) == 0)[0]]} is there twice")
    blocks = []
    for kind, rows, group in found.blocks:
        place = np.minimum(np.searchsorted(tags, rows), len(tags) - 1)
        if (tags[place] != rows).any():
            raise ValueError(f"a {KINDS[kind]} names node {rows[tags[place] != rows][0]}, which is not in the file")
        blocks.append((KINDS[kind], order[place].astype(np.int64), group))
    return GmshFile(found.points, blocks, found.names)
