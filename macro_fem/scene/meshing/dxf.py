"""Outlines as DXF, which CAD programs read and write, by ezdxf (extra `cad`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from macro_fem.fem.cells import signed_areas
from macro_fem.scene.meshing.edges import boundary_loops
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
    closed = [line for line in lines if (line.closed if line.dxftype() == "LWPOLYLINE" else line.is_closed)]
    if not closed or any(line.has_arc for line in closed):
        raise InputError(f"{path}: needs closed polylines (LWPOLYLINE or POLYLINE) of straight sides, no arcs")
    rings = [[(float(x), float(y)) for x, y, *_ in line.vertices_in_wcs()] for line in closed]
    rings.sort(key=lambda ring: -abs(signed_areas(np.array(ring))))
    return {"outline": rings[0], "holes": rings[1:]}


def write_outline(path: Path, mesh: Any) -> None:
    """Write the boundary of a scikit-fem mesh, mm, as closed polylines of a DXF file."""
    require("ezdxf", "cad", "--dxf", "leave it out")
    import ezdxf
    import ezdxf.units

    document = ezdxf.new(units=ezdxf.units.MM)
    document.layers.add(LAYER)
    for loop in boundary_loops(mesh):
        document.modelspace().add_lwpolyline(mesh.p[:, loop.nodes].T.tolist(), close=True, dxfattribs={"layer": LAYER})
    with atomic_path(path) as temporary:
        document.saveas(temporary)
