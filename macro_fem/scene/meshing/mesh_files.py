"""Mesh files: Gmsh's MSH and VTU are read within bounds; other formats are refused with the list of these."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from macro_fem.scene.meshing.gmsh import GmshFile, read_gmsh
from rve.common.errors import InputError
from rve.common.storage.reading import MOST_MESH_BYTES, first_line, read_bytes
from rve.common.storage.vtu import VtuFile, read_vtu

FORMATS = {".msh": "Gmsh MSH 2.2 and 4.1, ASCII or binary", ".vtu": "VTK XML unstructured grid"}


def read_mesh_file(path: Path) -> Any:
    """The mesh in a file as a `meshio.Mesh`; InputError if it is no mesh, or none of the formats that are read.

    Physical groups of a Gmsh file are cell data "gmsh:physical" with the names in field data, as meshio has them.
    """
    kind = path.suffix.lower()
    if kind not in FORMATS:
        listed = ", ".join(f"{ending} ({what})" for ending, what in FORMATS.items())
        raise InputError(
            f"{path}: files {f'ending in {kind}' if kind else 'without an ending'} are not read, only {listed}; "
            "meshio convert makes one from most others"
        )
    if kind == ".vtu":
        return _from_vtu(read_vtu(path))
    content = read_bytes(path, MOST_MESH_BYTES)
    try:
        return _from_gmsh(read_gmsh(content))
    except (ValueError, OverflowError) as error:
        raise InputError(f"{path}: cannot be read as MSH: {first_line(error)}") from error
    except MemoryError as error:
        raise InputError(f"{path}: cannot be read as MSH: it does not fit into memory") from error


def _from_vtu(file: VtuFile) -> Any:
    """Cells of other kinds than vertices, lines, triangles and quads are left out."""
    import meshio

    return meshio.Mesh(file.points, list(file.cells.items()), point_data=file.point_data)


def _from_gmsh(file: GmshFile) -> Any:
    import meshio

    lines_last = sorted(file.names.items(), key=lambda item: item[0][0] == 1)  # a name may stand for lines and cells
    names = {name: np.array([tag, dimension]) for (dimension, tag), name in lines_last}
    groups = [np.full(len(cells), group) for _, cells, group in file.blocks]
    blocks = [(kind, cells) for kind, cells, _ in file.blocks]
    return meshio.Mesh(file.points, blocks, cell_data={"gmsh:physical": groups}, field_data=names)
