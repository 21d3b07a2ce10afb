"""Outlines as DXF, which CAD programs read and write, by ezdxf (extra `cad`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from macro_fem.fem.cells import signed_areas
from rve.common.errors import InputError, require
from rve.common.files import atomic_path

LAYER = "CURTAIN"


def read_outline(path: Path) -> dict[str, Any]:
    """Keys `outline` and `holes` of a shape from the closed polylines of a DXF file in mm: the largest is the outline.

    InputError where ezdxf is missing, for a file that is none, and where it has no closed polyline or arcs in one.
    """
    require("ezdxf", "cad", "a DXF outline", "give its corners as outline")
    import ezdxf

    try:
        lines: Any = ezdxf.readfile(path).modelspace().query("LWPOLYLINE POLYLINE")
    except (OSError, ezdxf.DXFError) as error:
        raise InputError(f"{path}: cannot be read as DXF: {str(error).splitlines()[0]}") from error
    rings: list[list[tuple[float, float]]] = []
    for line in lines:
        if not (line.closed if line.dxftype() == "LWPOLYLINE" else line.is_closed):
            continue
        if line.has_arc:
            raise InputError(f"{path}: a polyline has arcs: give them as short straight sides")
        rings.append([(float(x), float(y)) for x, y, *_ in line.vertices_in_wcs()])
    if not rings:
        raise InputError(f"{path}: has no closed polyline (LWPOLYLINE or POLYLINE) to be the outline")
    rings.sort(key=lambda ring: -abs(signed_areas(np.array(ring))))
    return {"outline": rings[0], "holes": rings[1:]}


def write_outline(path: Path, p: np.ndarray, facets: np.ndarray) -> None:
    """Write the boundary `facets` (2, k) of a mesh with points `p` (2, n), mm, as closed polylines of a DXF file."""
    require("ezdxf", "cad", "--dxf", "leave it out")
    import ezdxf
    import ezdxf.units

    document = ezdxf.new(units=ezdxf.units.MM)
    document.layers.add(LAYER)
    for ring in loops(facets):
        document.modelspace().add_lwpolyline(p[:, ring].T.tolist(), close=True, dxfattribs={"layer": LAYER})
    with atomic_path(path) as temporary:
        document.saveas(temporary)


def loops(facets: np.ndarray) -> list[list[int]]:
    """The closed loops of nodes that sides (2, k) make, each node in two of them.

    >>> loops(np.array([[0, 1, 2], [1, 2, 0]]))
    [[0, 1, 2]]
    """
    beside: dict[int, list[int]] = {}
    for a, b in facets.T.tolist():
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    found = []
    while beside:
        ring = [next(iter(beside))]
        while neighbours := beside.pop(ring[-1], None):
            ring += [one for one in neighbours if one in beside][:1]
        found.append(ring)
    return found
