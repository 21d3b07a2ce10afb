"""Mesh files by meshio, and the names of the fields in a curtain's file."""

from __future__ import annotations

import io
import re
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from rve.common.errors import InputError
from rve.common.files import AnyPath, atomic_path
from rve.common.reading import MOST_MESH_BYTES, read_bytes

FORMATS = {".msh": "Gmsh MSH 2.2 and 4.1, ASCII or binary", ".vtu": "VTK XML unstructured grid"}

DISPLACEMENT = "displacement_mm"
"""Fields at the points of a curtain; in files of older versions points are deformed and the reference is a field."""
STRAIN, STRESS = "E_11_12_22", "S_11_12_22_N_per_mm"
LINE_LOAD_1, LINE_LOAD_2, DIRECTION_1 = "line_load_1_N_per_mm", "line_load_2_N_per_mm", "direction_1"
STATE = "state_0_slack_1_wrinkled_2_taut"
"""Fields of the cells of a curtain, written by `macro_fem.output.files`."""


def read_mesh_file(path: Path) -> Any:
    """The `meshio.Mesh` in a file, points (p, 3); InputError if it is no mesh, or none of the formats that are read.

    Physical groups of a Gmsh file are `cell_sets` by name (version 4.1) or cell data "gmsh:physical" (version 2.2).
    """
    kind = path.suffix.lower()
    if kind not in FORMATS:
        listed = ", ".join(f"{ending} ({what})" for ending, what in FORMATS.items())
        raise InputError(
            f"{path}: files {f'ending in {kind}' if kind else 'without an ending'} are not read, only {listed}; "
            "meshio convert makes one from most others"
        )
    content = read_bytes(path, MOST_MESH_BYTES)
    import meshio

    if kind == ".msh" and (large := re.search(rb"^[ \t]*(\d{9,})\b(?!\.)", content, re.MULTILINE)):
        raise InputError(f"{path}: cannot be read as MSH: {large[1][:20].decode()} nodes or elements are too many")
    read = meshio.vtu.read if kind == ".vtu" else meshio.gmsh.read
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), warnings.catch_warnings():
            warnings.filterwarnings("error", message=".*unmatched data")  # numpy's, of words among numbers
            mesh = read(path)
        points = np.asarray(mesh.points, dtype=float).reshape(len(mesh.points), -1)
        mesh.points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
        _check_cells(mesh)
    except (Exception, SystemExit) as error:  # meshio raises whatever damaged data leads to
        raise InputError(f"{path}: cannot be read as {kind[1:].upper()}: {_what_is_wrong(error)}") from error
    return mesh


def _check_cells(mesh: Any) -> None:
    """ValueError for a cell whose points are not in the file."""
    for block in mesh.cells:
        cells = np.asarray(block.data)
        outside = np.flatnonzero(((cells < 0) | (cells >= len(mesh.points))).any(axis=1))
        if len(outside):
            raise ValueError(f"{block.type} {outside[0]} names a point that is not among its {len(mesh.points)}")


def _what_is_wrong(error: BaseException) -> str:
    """The first line that a reader says, of moderate length; its kind where it says nothing in words."""
    text = next(iter(str(error).splitlines()), "")[:200]
    if "gmsh:physical" in str(error):
        return "only some of its surfaces are in a physical group: put all into one, or save it as version 2.2"
    return (
        text
        if " " in text
        else f"it is damaged or of another kind ({type(error).__name__}{f' {text}' if text else ''})"
    )


def write_mesh_file(path: AnyPath, mesh: Any) -> None:
    """Write a `meshio.Mesh` as VTU, atomically."""
    import meshio

    with atomic_path(path) as temporary:
        meshio.vtu.write(temporary, mesh)
