"""Mesh files, read by meshio, but Gmsh's MSH; one that cannot be read is named for what it is.

meshio's reader of MSH keeps one group of each name, refuses surfaces without a group beside others that have one, and
takes memory by the largest node number and by whatever counts a file states. Here numbers must follow a count.
"""

import io
import math
import re
import warnings
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from rve.common import Array, InputError
from rve.common.records import Index
from rve.common.texts import read_bytes
from rve.geometry import padded

MAX_TRIANGLES = 4_000_000
"""More cells than this are refused: some four million unknowns, 20 GB in a solver."""
CAUSES = (
    (r"vtkLZ4", "it is compressed by LZ4: save it with the compressor ZLib or without one"),
    (r"'pixel'|type 11\b", "it has cells VTK_PIXEL, those of an image: turn them into VTK_QUAD or triangles"),
    (r"cannot handle \(type (\d+)", "it has cells of VTK's type {}: turn them into triangles"),
    (r"version '([^']*)'", "it is of version {}: save it as version 1.0"),
    (r"type UnstructuredGrid, found (\w+)|\(not (\w+)\)", "it holds {}, no unstructured grid: save it as one"),
    (r"(?i)element type not available: (\S+)", "it has elements {}: save triangles or quadrilaterals"),
    (r"cannot handle", "it has cells other than triangles and quadrilaterals: save its surface as these"),
    (r"MemoryError", "it says that it holds more than fits into memory: it is damaged"),
)
"""What meshio says or what a file begins with, and what is wrong with the file, with the remedy."""
NOT_READ = ("svg", "cgns", "flac3d", "tetgen", "wkt")
"""Formats that meshio only writes, reads volumes of, or needs for ever to read (the last) where a file is cut off."""
PARTS = {
    "vtu": (rb"<Piece\b", "pieces"),
    "abaqus": (rb"(?im)^\*NODE[ \t]*(?:,|\r?$)", "lists of nodes"),
    "tecplot": (rb"(?im)^[ \t]*ZONE\b", "zones"),
}
"""What meshio reads only one of."""
ENDS = {"mdpa": (rb"(?m)^\s*Begin (\w+)", rb"(?m)^\s*End (\w+)"), "ply": (rb"\A()ply", rb"(?m)^()end_header")}
"""What begins the parts that meshio looks for the end of, and what ends them, with their names."""
SHAPES = {15: (0, 1), 1: (1, 2), 8: (1, 3), 2: (2, 3), 3: (2, 4), 9: (2, 6), 10: (2, 9), 16: (2, 8)}
"""Dimension and nodes of the elements that a plane sheet may have, of first and second order."""
INT, REAL = "i4", "f8"
Elements = tuple[int, tuple[int, ...], Index]
"""Elements of one type: its number, the numbers of their physical groups, 0 for none, and their node numbers (m, k)."""
CUT = "a section holds less than it says: the file is damaged or cut off"


class Lines(io.TextIOWrapper):
    """A text file whose end is an error: meshio's readers of some formats wait there for more, for ever."""

    def readline(self, *size: Any) -> str:  # type: ignore[override]
        if line := super().readline(*size):
            return line
        raise EOFError


def read_mesh_file(path: Path) -> Any:
    """The `meshio.Mesh` in a file, points (p, 3), named groups as `cell_sets`; InputError with the cause and the remedy
    if it is no mesh that can be read.
    """
    content = read_bytes(path)  # a name that is no file is told first
    import meshio

    forms = {end: form for end, (form, *_) in meshio.extension_to_filetypes.items() if form not in NOT_READ}
    form = next((forms[end] for end in ("".join(path.suffixes[-2:]).lower(), path.suffix.lower()) if end in forms), "")
    if not form:
        raise InputError(f"{path}: is not read; mesh files that are read end in {', '.join(sorted(forms))}")
    is_gmsh, log = path.suffix.lower() == ".msh" and content.lstrip().startswith(b"$"), io.StringIO()
    try:
        with redirect_stdout(log), redirect_stderr(log), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", message=".*unmatched data")  # numpy's, of words among numbers
            mesh = read_gmsh(content) if is_gmsh else _by_meshio(path, form, content)
        points = np.asarray(mesh.points, dtype=float).reshape(len(mesh.points), -1)
        mesh.points = padded(points)
        for block in mesh.cells:
            block.data = block.data if block.dim == 3 else block.data.astype(np.int64)
            if len(block) and not 0 <= np.min(block.data) <= np.max(block.data) < len(points):
                raise InputError(f"a {block.type} names a point that is not among its {len(points)}")
        if re.search("cannot handle|could not parse", log.getvalue()):
            raise InputError(_cause("", log.getvalue()))
    except (Exception, SystemExit) as error:  # meshio raises whatever damaged data leads to
        cause = str(error)
        if isinstance(error, ImportError):
            cause = f"this needs {error.name}: run pip install {error.name}, or save the mesh as .vtu or Gmsh's .msh"
        elif not isinstance(error, InputError):
            cause = _cause(f"{content[:1000].decode('latin-1')}", f"{error!r} {log.getvalue()}")
        raise InputError(f"{path}: cannot be read as {path.suffix[1:].upper()}: {cause}") from error
    return mesh


def _by_meshio(path: Path, form: str, content: bytes) -> Any:
    """What meshio reads; InputError for a file of which it would leave out a part, or look for more for ever."""
    import meshio

    pattern, what = PARTS.get(form, (b"$^", ""))
    if (count := len(re.findall(pattern, content))) > 1:
        raise InputError(f"it has {count} {what}, of which only one would be read: merge them")
    grid = re.search(rb"(?m)^DIMENSIONS((?:[ \t]+\d{1,9})+)", content) if form == "vtk" else None
    if grid and 4 * math.prod(map(int, grid[1].split())) > MAX_TRIANGLES:  # stated by three numbers only
        raise InputError(f"it is a grid of more than {MAX_TRIANGLES // 4:.3g} points: save a part of it")
    stated = sum(map(int, re.findall(rb"element face (\d+)", content))) if form == "ply" else 0
    begin, end = ENDS.get(form, (b"$^", b"$^"))
    if re.findall(begin, content) != re.findall(end, content) or stated > len(content):
        raise InputError("it is damaged or cut off")
    with path.open("rb") as file:
        mesh = meshio.read(Lines(file) if form in ("nastran", "off", "tecplot") else path, form)
    if form == "nastran":
        stated = len(re.findall(rb"(?m)^C(?:TRIA|QUAD)", content))  # it passes over the cards of other elements
    if stated > sum(len(block) for block in mesh.cells if block.dim == 2):
        raise InputError(f"only a part of its {stated} cells can be read: it is damaged, or has cells of another kind")
    return mesh


def _cause(head: str, said: str) -> str:
    """What is wrong with a file by how it begins and what was said of it, with the remedy."""
    for pattern, cause in CAUSES:
        if match := re.search(pattern, head if "vtkLZ4" in pattern else said):
            return cause.format(*filter(None, match.groups()))
    return "it is damaged, cut off or of another kind: save it again, or as .vtu or Gmsh's .msh"


class Numbers:
    """The numbers of a section in turn: of text, or of bytes in the `order` "<" or ">", whose counts have `size`."""

    def __init__(self, body: bytes, order: str, size: str = INT) -> None:
        self.rest: Any = memoryview(body) if order else np.fromstring(body, sep=" ")
        self.order, self.size = order, size

    def rows(self, count: int, *parts: tuple[str, int]) -> list[Any]:
        """The next `count` rows: an array (count, n) of each part (type, n); InputError if there are fewer."""
        kind = np.dtype([(str(k), self.order + code, (n,)) for k, (code, n) in enumerate(parts)])
        ends = np.cumsum([n for _, n in parts])
        length = count * int(kind.itemsize if self.order else ends[-1])
        if not 0 <= length <= len(self.rest):
            raise InputError(CUT)
        block, self.rest = self.rest[:length], self.rest[length:]
        if self.order:
            records = np.frombuffer(block, kind) if length else np.zeros(count, kind)
            columns = [records[name] for name in kind.names or ()]
        else:
            columns = np.split(block.reshape(count, ends[-1]), ends[:-1], axis=1)
        return [part.astype("f8" if code == REAL else "i8") for part, (code, _) in zip(columns, parts, strict=True)]

    def take(self, code: str, count: int) -> list[int]:
        """The next `count` numbers of a type."""
        return list(self.rows(1, (code, count))[0][0].tolist()) if count else []

    def count(self, number: int = 1) -> int:
        """The first of the next `number` counts."""
        return self.take(self.size, number)[0]


def read_gmsh(content: bytes) -> Any:
    """The `meshio.Mesh` in an MSH file, with physical groups as `cell_sets` by name, or by number if they have none.

    A surface that several groups have is there once. InputError, or what damaged data lead to, if it cannot be read.
    """
    import meshio

    sections = dict(_sections(content))
    words, _, one = sections["MeshFormat"].partition(b"\n")
    version, is_binary, size = words.decode().split()
    order = "" if is_binary == "0" else "<" if one.startswith(b"\1") else ">"
    if version not in ("2", "2.0", "2.1", "2.2", "4", "4.0", "4.1"):
        raise InputError(f"it is of version {version}: save it as version 4.1")
    if version < "4":
        tags, points, blocks = _read_2(sections, order)
    else:
        tags, points, blocks = _read_4(sections, order, f"u{int(size)}", is_4_0=version != "4.1")
    in_order = np.argsort(tags)
    if (np.diff(tags[in_order]) == 0).any():
        raise InputError("two of its nodes have one number")
    titles = re.findall(rb'^\s*(\d)\s+(\d+)\s+"(.*)"', sections.get("PhysicalNames", b""), re.MULTILINE)
    names = {(int(dimension), int(group)): text.decode(errors="replace") for dimension, group, text in titles}
    elements, cells = _gathered(blocks), []
    none = [np.zeros(0, np.int64)] * len(elements)
    sets = {name: [*none] for (dimension, _), name in names.items() if dimension == 1}  # SaveAll may leave them empty
    for number, (kind, groups, nodes) in enumerate(elements):
        index = in_order[np.minimum(np.searchsorted(tags, nodes, sorter=in_order), len(tags) - 1)]
        if len(lost := nodes[tags[index] != nodes]):
            raise InputError(f"an element has the node {lost[0]}, which is not in the file")
        cells.append((meshio.gmsh.gmsh_to_meshio_type[kind], index))
        for group in filter(None, groups if len(nodes) else ()):
            name = names.get((SHAPES[kind][0], group), str(group))
            sets.setdefault(name, [*none])[number] = np.arange(len(nodes))
    return meshio.Mesh(points, cells, cell_sets=sets)


def _sections(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Names and contents of what stands between $Name and $EndName."""
    head, at = re.compile(rb"^\$(\w+)[ \t]*\r?\n", re.MULTILINE), 0
    while found := head.search(content, at):
        name, at = found[1].decode(), content.find(b"$End" + found[1], found.end())
        if name in ("NOD", "ParametricNodes"):
            what = "is of version 1" if name == "NOD" else "has parametric nodes"
            raise InputError(f"it {what}: save it as version 4.1")
        if at < 0:
            raise InputError(f"its ${name} has no end: it is cut off")
        yield name, content[found.end() : at]
        at += 1


def _nodes_of(kind: int) -> int:
    """Nodes of an element of a type; InputError for those that no plane sheet is made of."""
    if kind not in SHAPES:
        raise InputError(
            f"it has elements of Gmsh's type {kind}, and a sheet has triangles and quadrilaterals of first or second "
            "order: save its surface alone, with Mesh.ElementOrder = 1"
        )
    return SHAPES[kind][1]


def _gathered(blocks: Iterator[Elements]) -> list[Elements]:
    """The elements in one block of each type and groups, without surfaces that a block before has as well."""
    found: dict[int, dict[tuple[int, ...], list[Index]]] = {}
    for kind, groups, nodes in blocks:
        found.setdefault(kind, {}).setdefault(groups, []).append(nodes)
    elements = []
    for kind, parts in found.items():
        each = [np.concatenate(part) for part in parts.values()]
        nodes, of = np.concatenate(each), np.repeat(np.arange(len(each)), [len(part) for part in each])
        if SHAPES[kind][0] == 2:
            _, first, same = np.unique(np.sort(nodes, axis=1), axis=0, return_index=True, return_inverse=True)
            of = np.where(of == of[first[same.ravel()]], of, -1)
        elements += [(kind, groups, nodes[of == number]) for number, groups in enumerate(parts)]
    return elements


def _read_2(sections: dict[str, bytes], order: str) -> tuple[Index, Array, Iterator[Elements]]:
    """Numbers (p,) and places (p, 3) of the nodes, and the elements, of a file of version 2."""
    count, _, body = sections["Nodes"].partition(b"\n")
    tags, points = Numbers(body, order).rows(int(count), (INT, 1), (REAL, 3))
    count, _, body = sections["Elements"].partition(b"\n")

    def blocks() -> Iterator[Elements]:
        for kind, labels, rows in (_binary_tables if order else _text_tables)(body, order, int(count)):
            group = np.abs(rows[:, 1]) if labels else np.zeros(len(rows), np.int64)
            for one in np.unique(group).tolist():
                yield kind, (one,), rows[group == one, 1 + labels :]

    return tags[:, 0], points, blocks()


def _binary_tables(body: bytes, order: str, count: int) -> Iterator[tuple[int, int, Index]]:
    """Elements of version 2: their type, how many labels they have, and rows (m, k) of number, labels and nodes."""
    numbers = Numbers(body, order)
    while count > 0:
        kind, many, labels = numbers.take(INT, 3)
        yield kind, labels, numbers.rows(many, (INT, 1 + labels + _nodes_of(kind)))[0]
        count -= many


def _text_tables(body: bytes, order: str, count: int) -> Iterator[tuple[int, int, Index]]:
    """`_binary_tables` of text, which has an element a line."""
    lines, tables = body.splitlines(), dict[tuple[bytes, bytes], list[list[bytes]]]()
    if len(lines) < count:
        raise InputError(CUT)
    for number, kind, labels, *rest in map(bytes.split, lines[:count]):
        tables.setdefault((kind, labels), []).append([number, *rest])
    for (kind, labels), rows in tables.items():
        yield int(kind), int(labels), np.array(rows).astype(np.int64)[:, : 1 + int(labels) + _nodes_of(int(kind))]


def _read_4(
    sections: dict[str, bytes], order: str, size: str, *, is_4_0: bool
) -> tuple[Index, Array, Iterator[Elements]]:
    """`_read_2` of version 4; 4.0 puts the number of an entity before its dimension, and node numbers beside places."""
    groups: dict[tuple[int, int], tuple[int, ...]] = {}
    for name in ("Entities", "PartitionedEntities"):
        if name in sections:
            groups |= _entity_groups(Numbers(sections[name], order, size), name != "Entities", 6 if is_4_0 else 3)
    nodes, elements = (Numbers(sections[name], order, size) for name in ("Nodes", "Elements"))
    heads, numbered = (2, INT) if is_4_0 else (4, size)

    def entities(numbers: Numbers) -> Iterator[tuple[tuple[int, int], int, int]]:
        for _ in range(numbers.count(heads)):
            first, second, more = numbers.take(INT, 3)
            yield (second, first) if is_4_0 else (first, second), more, numbers.count()

    parts = list[list[Array]]()
    for (dimension, _), is_parametric, count in entities(nodes):
        place = REAL, 3 + is_parametric * dimension
        together = nodes.rows(count, (numbered, 1), place) if is_4_0 else nodes.rows(count, (numbered, 1))
        parts.append(together if is_4_0 else [*together, *nodes.rows(count, place)])

    def blocks() -> Iterator[Elements]:
        for entity, kind, count in entities(elements):
            yield kind, groups.get(entity, ()), elements.rows(count, (numbered, 1 + _nodes_of(kind)))[0][:, 1:]

    tags, points = np.concatenate([tag[:, 0] for tag, _ in parts]), np.concatenate([at[:, :3] for _, at in parts])
    return tags, points, blocks()


def _entity_groups(body: Numbers, is_partitioned: bool, corners: int) -> dict[tuple[int, int], tuple[int, ...]]:
    """Physical groups of each entity by its dimension and number; corners: how many numbers say where a point is."""
    groups = {}
    if is_partitioned:
        body.take(INT, 2 * body.take(body.size, 2)[1])  # ghosts
    for dimension, count in enumerate(body.take(body.size, 4)):
        for _ in range(count):
            tag = body.take(INT, 3 if is_partitioned else 1)[0]
            if is_partitioned:
                body.take(INT, body.count())
            body.take(REAL, 6 if dimension else corners)
            groups[dimension, tag] = tuple(abs(group) for group in body.take(INT, body.count()))  # negative: reversed
            if dimension:
                body.take(INT, body.count())
    return groups
