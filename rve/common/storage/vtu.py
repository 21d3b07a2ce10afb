"""VTU files read within bounds: every array's size is known from the file's counts before it is decoded.

One piece; ASCII, inline binary, or appended data (base64 or raw), plain or compressed by zlib or LZMA: what ParaView
and meshio write. Sizes that the file states are compared with each other, with its own size, and with the limits below.
"""

from __future__ import annotations

import base64
import lzma
import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from rve.common.errors import InputError
from rve.common.storage.reading import MOST_MESH_BYTES, first_line, parse_numbers, read_bytes
from rve.common.types import Array
from rve.common.values import shown

Index = NDArray[np.int64]

MOST_ITEMS = 8_000_000
"""Points, and cells."""
MOST_COMPONENTS = 9
INFLATION, FREE_BYTES = 8, 256_000_000
"""Arrays may take `INFLATION` times the bytes of the file, or `FREE_BYTES`: a megabyte of zlib can hold a gigabyte."""
MOST_TAGS = 10_000
CELL_KINDS = {1: "vertex", 3: "line", 5: "triangle", 9: "quad", 22: "triangle6", 23: "quad8"}
CELL_KINDS |= {10: "tetra", 12: "hexahedron", 7: "polygon", 4: "polyline"}
SIZES = {"vertex": 1, "line": 2, "triangle": 3, "quad": 4}

DISPLACEMENT, OLD_REFERENCE = "displacement_mm", "reference_mm"
"""Fields at the points of a curtain; in files of older versions points are deformed and the reference is a field."""
STRAIN, STRESS = "E_11_12_22", "S_11_12_22_N_per_mm"
LINE_LOAD_1, LINE_LOAD_2, DIRECTION_1 = "line_load_1_N_per_mm", "line_load_2_N_per_mm", "direction_1"
STATE = "state_0_slack_1_wrinkled_2_taut"
"""Fields of the cells of a curtain, written by `macro_fem.output.files`."""

_TYPES = {f"{kind}{bits}": f"{kind[0].lower()}{bits // 8}" for kind in ("Int", "UInt") for bits in (8, 16, 32, 64)}
_TYPES |= {"Float32": "f4", "Float64": "f8"}
_WHOLE = re.compile(rb"<AppendedData\b[^>]*>")


@dataclass(frozen=True, eq=False)
class VtuFile:
    """points (p, 3); cells by kind: point numbers (c, k) of vertices, lines, triangles and quads, in the file's order.

    other: how many cells there are of other kinds; point_data, cell_data: (p,), (c,) or (p, w), (c, w) over all cells.
    """

    points: Array
    cells: dict[str, Index]
    other: dict[str, int]
    point_data: dict[str, Array]
    cell_data: dict[str, Array]


@dataclass(frozen=True)
class _Source:
    """The document: its root, appended bytes (base64 text or raw), header number type, byte order, compressor."""

    root: ElementTree.Element
    appended: bytes
    is_raw: bool
    header: np.dtype[np.unsignedinteger]
    order: str
    compressor: str | None
    size: int


def read_vtu(path: Path) -> VtuFile:
    """The grid in a VTU file; InputError in one sentence if it is none, is damaged, or states more than the limits."""
    content = read_bytes(path, MOST_MESH_BYTES)
    try:
        source = _source(content)
        return _grid(source)
    except KeyError as error:
        raise InputError(f"{path}: cannot be read as VTU: {shown(error.args[0])} is missing or not known") from error
    except MemoryError as error:
        raise InputError(f"{path}: cannot be read as VTU: it does not fit into memory") from error
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: cannot be read as VTU: it is not XML, or not all of one: {error}") from error
    except (ValueError, LookupError, OverflowError, zlib.error, lzma.LZMAError, EOFError) as error:
        raise InputError(f"{path}: cannot be read as VTU: {first_line(error)}") from error


def _source(content: bytes) -> _Source:
    tag = _WHOLE.search(content)
    is_raw = tag is not None and b'"raw"' in tag.group()
    appended = b""
    text = content
    if tag is not None and is_raw:
        end = content.rfind(b"</AppendedData>")
        if end < tag.end():
            raise ValueError("the appended data does not end")
        appended, text = content[tag.end() : end], content[: tag.end()] + content[end:]
    if text.count(b"<") > MOST_TAGS or b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise ValueError(f"it has more than {MOST_TAGS} tags, or declares its own")
    root = ElementTree.fromstring(text)
    if root.tag != "VTKFile" or root.get("type") != "UnstructuredGrid":
        raise ValueError(f"it holds a {shown(root.get('type', root.tag))}, not an UnstructuredGrid")
    if tag is not None and not is_raw:
        appended = (root.findtext("AppendedData") or "").strip().encode()
    _, _, appended = appended.partition(b"_")
    order = {"LittleEndian": "<", "BigEndian": ">"}[root.get("byte_order", "LittleEndian")]
    header = np.dtype(order + {"UInt32": "u4", "UInt64": "u8"}[root.get("header_type", "UInt32")])
    return _Source(root, appended, is_raw, header, order, root.get("compressor") or None, len(content))


def _grid(source: _Source) -> VtuFile:
    pieces = source.root.findall("UnstructuredGrid/Piece")
    if len(pieces) != 1:
        raise ValueError(f"it has {len(pieces)} pieces, one is read")
    piece = pieces[0]
    n_points, n_cells = (_count(piece, f"NumberOf{what}") for what in ("Points", "Cells"))
    arrays = _named(piece, "Cells")
    point_data, cell_data = _named(piece, "PointData"), _named(piece, "CellData")
    places = list(_named(piece, "Points").values())
    if len(places) != 1 or _width(places[0]) != 3:
        raise ValueError("Points must hold one array of three components")
    plan = [(one, n_points) for one in (*places, *point_data.values())]
    plan += [(one, n_cells) for one in (*cell_data.values(), arrays["offsets"], arrays["types"])]
    _refuse_inflation(source, sum(count * _width(one) * _dtype(one, "<").itemsize for one, count in plan))
    offsets, types = (_whole(arrays[name], n_cells, source) for name in ("offsets", "types"))
    if n_cells and (offsets[0] < 0 or np.diff(offsets).min(initial=0) < 0 or offsets[-1] > 27 * MOST_ITEMS):
        raise ValueError("the offsets of its cells do not grow, or reach too far")
    length = int(offsets[-1]) if n_cells else 0
    _refuse_inflation(source, length * _dtype(arrays["connectivity"], "<").itemsize)
    connectivity = _whole(arrays["connectivity"], length, source)
    cells, other = _cells(connectivity, offsets, types)
    for kind, numbers in cells.items():
        outside = np.flatnonzero((numbers < 0).any(axis=1) | (numbers >= n_points).any(axis=1))
        if len(outside):
            raise ValueError(f"{kind} {outside[0]} names a point that is not among the {n_points} of the file")
    return VtuFile(
        _values(places[0], n_points, source),
        cells,
        other,
        {name: _values(one, n_points, source) for name, one in point_data.items()},
        {name: _values(one, n_cells, source) for name, one in cell_data.items()},
    )


def _cells(connectivity: Index, offsets: Index, types: Index) -> tuple[dict[str, Index], dict[str, int]]:
    sizes = np.diff(offsets, prepend=0)
    cells, other = {}, {}
    for number in np.unique(types).tolist():
        rows = np.flatnonzero(types == number)
        kind = CELL_KINDS.get(number, f"VTK cell type {number}")
        size = SIZES.get(kind)
        if size is None:
            other[kind] = len(rows)
            continue
        if (sizes[rows] != size).any():
            raise ValueError(f"a {kind} has {sizes[rows][sizes[rows] != size][0]} points")
        cells[kind] = connectivity[offsets[rows][:, None] + np.arange(-size, 0)]
    return cells, other


def _count(piece: ElementTree.Element, name: str) -> int:
    count = int(piece.attrib[name])
    if not 0 <= count <= MOST_ITEMS:
        raise ValueError(f"{name} = {shown(count)}: must be from 0 to {MOST_ITEMS}")
    return count


def _named(piece: ElementTree.Element, section: str) -> dict[str, ElementTree.Element]:
    arrays = piece.findall(f"{section}/DataArray")
    return {one.get("Name", str(number)): one for number, one in enumerate(arrays)}


def _width(array: ElementTree.Element) -> int:
    width = int(array.get("NumberOfComponents") or 1)
    if not 1 <= width <= MOST_COMPONENTS:
        raise ValueError(f"NumberOfComponents = {shown(width)}: must be from 1 to {MOST_COMPONENTS}")
    return width


def _dtype(array: ElementTree.Element, order: str) -> np.dtype[np.generic]:
    return np.dtype(order + _TYPES[array.attrib["type"]])


def _refuse_inflation(source: _Source, size: int) -> None:
    most = max(FREE_BYTES, INFLATION * source.size)
    if size > most:
        raise ValueError(f"its arrays would take {size:,} bytes, for a file of {source.size:,} at most {most:,}")


def _whole(array: ElementTree.Element, count: int, source: _Source) -> Index:
    if _dtype(array, "<").kind not in "iu":
        raise ValueError(f"array {shown(array.get('Name'))} does not hold whole numbers")
    return _decoded(array, count, source).astype(np.int64)


def _values(array: ElementTree.Element, count: int, source: _Source) -> Array:
    width = _width(array)
    found = _decoded(array, count * width, source).astype(np.float64)
    return found.reshape(count, width) if width > 1 else found


def _decoded(array: ElementTree.Element, count: int, source: _Source) -> NDArray[np.generic]:
    """The `count` numbers of a DataArray."""
    form, dtype = array.attrib["format"], _dtype(array, source.order)
    if form == "ascii":
        found = parse_numbers(array.text or "", dtype.newbyteorder("="))
        if len(found) != count:
            raise ValueError(f"array {shown(array.get('Name'))} has {len(found)} numbers, not {count}")
        return found
    if form == "binary":
        text, start = (array.text or "").strip().encode(), 0
    elif form == "appended":
        text, start = source.appended, int(array.attrib["offset"])
        if not 0 <= start <= len(text):
            raise ValueError(f"offset = {shown(start)} is not within the appended data of {len(text)} bytes")
    else:
        raise ValueError(f"format = {shown(form)} is not one of ascii, binary, appended")
    stream = _Stream(memoryview(text)[start:], source.is_raw and form == "appended")
    return np.frombuffer(_payload(stream, count * dtype.itemsize, source), dtype)


@dataclass(frozen=True)
class _Stream:
    """Bytes that stand in a text, as base64 or raw."""

    text: memoryview
    is_raw: bool

    def take(self, size: int) -> bytes:
        """The first `size` bytes."""
        length = size if self.is_raw else -(-size // 3) * 4
        if length > len(self.text):
            raise ValueError(f"{length} bytes of data are stated, {len(self.text)} are left in the file")
        part = bytes(self.text[:length])
        found = part if self.is_raw else base64.b64decode(part, validate=True)
        if len(found) < size:
            raise ValueError("its base64 data ends early")
        return found[:size]

    def after(self, size: int) -> _Stream:
        """What follows a part of `size` bytes that was encoded by itself."""
        return _Stream(self.text[size if self.is_raw else -(-size // 3) * 4 :], self.is_raw)


def _payload(stream: _Stream, size: int, source: _Source) -> bytes:
    """The `size` bytes of one array without header and compression."""
    width = source.header.itemsize
    first = int(np.frombuffer(stream.take(width), source.header)[0])
    if source.compressor is None:
        if first != size:
            raise ValueError(f"an array states {first} bytes where its counts make {size}")
        return stream.take(width + size)[width:]
    if first == size == 0:
        return b""
    if first * width > len(stream.text):
        raise ValueError(f"an array states {first} compressed blocks, more than the file holds")
    head = np.frombuffer(stream.take((3 + first) * width), source.header).astype(object)
    blocks = [int(head[1])] * (first - 1) + [int(head[2]) or int(head[1])] if first else []
    if sum(blocks) != size:
        raise ValueError(f"an array states {sum(blocks)} bytes where its counts make {size}")
    packed = stream.after((3 + first) * width).take(sum(map(int, head[3:])))
    parts, start = [], 0
    for length, block in zip(map(int, head[3:]), blocks, strict=True):
        parts.append(_inflated(packed[start : start + length], block, source.compressor))
        start += length
    return b"".join(parts)


def _inflated(packed: bytes, size: int, compressor: str) -> bytes:
    if compressor == "vtkZLibDataCompressor":
        found = zlib.decompressobj().decompress(packed, size + 1)
    elif compressor == "vtkLZMADataCompressor":
        found = lzma.LZMADecompressor(memlimit=FREE_BYTES).decompress(packed, size + 1)
    else:
        raise ValueError(f"compressor = {shown(compressor)}: zlib and LZMA are read; save it with one of them")
    if len(found) != size:
        raise ValueError("a compressed block does not have the size that the file states")
    return found
