"""Mesh files: Gmsh's by `gmsh_files`, all others by meshio; one that cannot be read is named for what it is."""

import io
import math
import re
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from macro_fem.scene.meshing.gmsh_files import read_gmsh
from rve.common import InputError
from rve.common.texts import read_bytes

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
        mesh.points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
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
