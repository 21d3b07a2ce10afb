"""Files of the rings of a curtain: rings.vtu, worst_cell.csv, written atomically: each file is complete or absent."""

from __future__ import annotations

import base64
import csv
import io
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rve.common.storage.files import write_text
from rve.common.types import Array
from rve.geometry.circles import tangent_frame
from rve.localization.forces import CellForces

_VTK_TYPES = {"f4": "Float32", "f8": "Float64", "i4": "Int32", "u1": "UInt8"}
_POLY_LINE, _QUAD = 4, 9

LINE, TUBE = (24, 0), (28, 8)
"""Points along and around a ring in the files: centre lines (100,000 rings below 30 MB), tori."""


def circles(centre: Array, normal: Array, r1: float, count: int) -> tuple[Array, Array]:
    """Points (n, count, 3) of the centre circles, and the unit vectors from the centre to them."""
    e1, e2 = tangent_frame(normal)
    t = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)[None, :, None]
    out = np.cos(t) * e1[:, None] + np.sin(t) * e2[:, None]
    return centre[:, None] + r1 * out, out


def tubes(
    centre: Array, normal: Array, radii: tuple[float, float], around: tuple[int, int]
) -> tuple[Array, NDArray[np.intp]]:
    """Points (p, 3) and quadrilaterals (n, around[0] * around[1], 4) of tori with radii (r1, r2)."""
    line, out = circles(centre, normal, radii[0], around[0])
    v = np.linspace(0.0, 2.0 * np.pi, around[1], endpoint=False)[:, None]
    points = line[:, :, None] + radii[1] * (np.cos(v) * out[:, :, None] + np.sin(v) * normal[:, None, None])
    here = np.arange(around[0])[:, None] * around[1] + np.arange(around[1])
    next_one = np.roll(here, -1, axis=0)
    quads = np.stack([here, next_one, np.roll(next_one, -1, axis=1), np.roll(here, -1, axis=1)], axis=2).reshape(-1, 4)
    first = around[0] * around[1] * np.arange(len(centre))
    return points.reshape(-1, 3), quads[None] + first[:, None, None]


def write_ring_vtu(
    path: Path,
    placed: tuple[Array, Array],
    radii: tuple[float, float],
    data: dict[str, Array],
    around: tuple[int, int],
    *,
    precise: bool = False,
) -> None:
    """Rings as VTU: closed lines of around[0] points, one cell per ring, or tubes if around[1] > 0.

    placed: centres and unit normals (n, 3) of the rings; radii (r1, r2) in mm; data: numbers per ring (n,) or (n, w).
    Tubes repeat a ring's numbers on each of its quadrilaterals. precise: points and numbers in double precision.
    """
    centre, normal = placed
    n, (along, across) = len(centre), around
    if across:
        points, quads = tubes(centre, normal, radii, around)
        cells, size, kind = quads.reshape(-1, 4), 4, _QUAD
        data = {name: np.repeat(values, along * across, axis=0) for name, values in data.items()}
    else:
        points = circles(centre, normal, radii[0], along)[0].reshape(-1, 3)
        cells = np.concatenate([np.arange(n * along).reshape(n, along), along * np.arange(n)[:, None]], axis=1)
        size, kind = along + 1, _POLY_LINE
    count, real = len(cells), "f8" if precise else "f4"
    arrays = [
        "<Points>" + _array("Points", points.astype(real)) + "</Points>",
        "<Cells>"
        + _array("connectivity", cells.astype("i4"), flat=True)
        + _array("offsets", (size * np.arange(1, count + 1)).astype("i4"))
        + _array("types", np.full(count, kind, dtype="u1"))
        + "</Cells>",
        "<CellData>" + "".join(_array(name, _compact(values, real)) for name, values in data.items()) + "</CellData>",
    ]
    head = '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" '
    head += 'header_type="UInt32" compressor="vtkZLibDataCompressor">\n<UnstructuredGrid>'
    piece = f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{count}">\n'
    write_text(path, head + piece + "\n".join(arrays) + "\n</Piece></UnstructuredGrid></VTKFile>\n")


def _compact(values: Array, real: str) -> NDArray[np.generic]:
    return values.astype("i4" if np.issubdtype(values.dtype, np.integer) else real)


def _array(name: str, values: NDArray[np.generic], *, flat: bool = False) -> str:
    """A DataArray in VTK's inline binary form: blocks of 32 kB, each compressed, their sizes in front."""
    raw, block = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<")).tobytes(), 32768
    packed = [zlib.compress(raw[i : i + block]) for i in range(0, len(raw), block)]
    rest = len(raw) % block
    sizes = np.array([len(packed), block, rest, *map(len, packed)], dtype="<u4").tobytes()
    width = values.shape[1] if values.ndim == 2 and not flat else 1
    text = (base64.b64encode(sizes) + base64.b64encode(b"".join(packed))).decode()
    kind = _VTK_TYPES[values.dtype.str[1:]]
    return f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{width}" format="binary">{text}</DataArray>\n'


def write_forces_csv(path: Path, forces: CellForces, turn: Array) -> None:
    """Contacts of one cell: rings, point, direction, force; turn (3, 3) carries them into the axes of the curtain."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["a_class", "a_i", "a_j", "b_class", "b_i", "b_j", "x_mm", "y_mm", "z_mm", "force_N", "nx", "ny", "nz"]
    )
    columns = (forces.a, forces.b, forces.point @ turn.T, forces.force, forces.normal @ turn.T)
    for a, b, point, force, normal in zip(*columns, strict=True):
        numbers = [f"{x:.12g}" for x in (*point, force, *normal)]
        writer.writerow([*map(int, a), *map(int, b), *numbers])
    write_text(path, text.getvalue())
