"""Outlines of sheets as DXF files, read and written (ezdxf)."""

from pathlib import Path
from typing import Any

import numpy as np

from macro_fem.fem.cells import cross, signed_areas
from macro_fem.scene.meshing.edges import boundary_loops
from rve.common import InputError, atomic_path, require
from rve.common.texts import read_bytes

CURVES = ("LWPOLYLINE", "POLYLINE", "CIRCLE", "ELLIPSE", "SPLINE", "LINE", "ARC")
"""What an outline is drawn with in a DXF file."""


def read_outline(path: Path, departure: float = 1e-4) -> dict[str, Any]:
    """Keys `outline` and `holes` of a shape from the closed curves of a DXF file in mm: the largest is the outline.

    Layers that are off or frozen are left out. departure: of chords from round curves, over the size of the drawing.
    InputError without ezdxf, for no such file, another unit, no curves, curves that are not closed, and those of
    blocks, which may be posts or the frame of the sheet.
    """
    require("ezdxf", "cad", "a DXF outline", "give its corners as outline")
    import ezdxf.disassemble
    import ezdxf.path

    read_bytes(path)  # a name that is no file is told first, and a sweep sees what it has read
    try:
        drawing = ezdxf.readfile(path)
        hidden = {layer.dxf.name.lower() for layer in drawing.layers if layer.is_off() or layer.is_frozen()}
        drawn = [one for one in drawing.modelspace() if one.dxf.layer.lower() not in hidden]
        for block in (one for one in drawn if one.dxftype() == "INSERT"):
            if any(part.dxftype() in CURVES for part in ezdxf.disassemble.recursive_decompose([block])):
                raise ValueError(f"block {block.dxf.name!r} has curves: explode it or turn its layer off")
        ways = [ezdxf.path.make_path(one) for one in drawn if one.dxftype() in CURVES]
        ways = [way for way in ways if len(way)]
        if gaps := [way.start for way in ways if not way.is_closed]:  # as in the path of a periodic spline
            where = f"({gaps[0].x:g}, {gaps[0].y:g})"
            raise ValueError(f"the curve from {where} is not closed: make it a closed polyline or turn its layer off")
        chord = departure * max(ezdxf.path.bbox(ways).size) if ways else 0.0
        rings = [[(x, y) for x, y, _ in way.flattening(chord)][:-1] for way in ways]
    except Exception as error:  # ezdxf raises whatever damaged data leads to
        what = str(error).split("\n")[0] or "it is damaged or cut off"
        raise InputError(f"{path}: cannot be read as DXF: {what}") from error
    if drawing.units not in (0, ezdxf.units.MM):
        raise InputError(f"{path}: states the unit {ezdxf.units.unit_name(drawing.units).lower()}, it must be mm")
    if not rings:
        raise InputError(f"{path}: needs closed curves: polylines, circles, ellipses or splines")
    outline, *holes = sorted(rings, key=lambda ring: -abs(signed_areas(np.array(ring))))
    return {"outline": outline, "holes": holes}


STRAIGHT = 1e-9
"""Sine of the turn at nodes of the boundary that are corners of an outline; less is rounding of a straight side."""


def write_outline(path: Path, mesh: Any) -> None:
    """Write the corners of the boundary of a scikit-fem mesh, mm, as closed polylines of a DXF file."""
    import ezdxf.units

    document = ezdxf.new(units=ezdxf.units.MM)
    document.layers.add("CURTAIN")
    for loop in boundary_loops(mesh):
        points = mesh.p[:, loop[1:]].T
        before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
        lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
        corners = points[(np.abs(cross(before, after)) > STRAIGHT * lengths) | ((before * after).sum(axis=1) < 0.0)]
        document.modelspace().add_lwpolyline(corners.tolist(), close=True, dxfattribs={"layer": "CURTAIN"})
    with atomic_path(path) as temporary:
        document.saveas(temporary)
