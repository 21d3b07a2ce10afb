"""Mesh files by meshio."""

import io
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from rve.common.errors import InputError
from rve.common.files import AnyPath, atomic_path
from rve.common.texts import read_bytes

FORMATS = {".msh": "Gmsh MSH 2.2 and 4.1, ASCII or binary", ".vtu": "VTK XML unstructured grid"}


def read_mesh_file(path: Path) -> Any:
    """The `meshio.Mesh` in a file, points (p, 3); InputError if it is no mesh, or none of the formats that are read.

    Physical groups of a Gmsh file are `cell_sets` by name (version 4.1) or cell data "gmsh:physical" (version 2.2).
    """
    read_bytes(path)  # a name that is no file is told first
    kind = path.suffix.lower()
    if kind not in FORMATS:
        listed = ", ".join(f"{ending} ({what})" for ending, what in FORMATS.items())
        raise InputError(f"{path}: is not read, only {listed} are; meshio convert makes one from most others")
    import meshio

    read = meshio.vtu.read if kind == ".vtu" else meshio.gmsh.read
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), warnings.catch_warnings():
            warnings.filterwarnings("error", message=".*unmatched data")  # numpy's, of words among numbers
            mesh = read(path)
        points = np.asarray(mesh.points, dtype=float).reshape(len(mesh.points), -1)
        mesh.points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
        for block in mesh.cells:
            if not np.isin(block.data, np.arange(len(points))).all():
                raise ValueError(f"a {block.type} names a point that is not among its {len(points)}")
    except (Exception, SystemExit) as error:  # meshio raises whatever damaged data leads to
        text = f"it is damaged or of another kind ({type(error).__name__}: {' '.join(str(error).split())[:200]})"
        if "gmsh:physical" in str(error):
            text = "only some of its surfaces are in a physical group: put all into one, or save it as version 2.2"
        raise InputError(f"{path}: cannot be read as {kind[1:].upper()}: {text}") from error
    return mesh


def write_mesh_file(path: AnyPath, mesh: Any) -> None:
    """Write a `meshio.Mesh` as VTU, atomically."""
    import meshio

    with atomic_path(path) as temporary:
        meshio.vtu.write(temporary, mesh)
