"""Outlines of sheets as DXF files, read and written (ezdxf).

A drawing is *right*, *mended with a note* or *refused with its remedy*. Curves that meet end to end are joined, those
of blocks among them. The closed curve that holds all others is the outline, the others are its holes.
"""

import io
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree

from macro_fem.fem.cells import components, signed_areas
from macro_fem.scene.meshing.edges import boundary_loops
from macro_fem.scene.tables import MOST_MM
from rve.common import Array, InputError, atomic_path, require
from rve.common.texts import read_bytes

MM = 4
UNITS = {0: ("mm", 1.0), 1: ("inches", 25.4), 2: ("feet", 304.8), MM: ("mm", 1.0), 5: ("cm", 10.0), 6: ("m", 1e3)}
UNITS |= {7: ("km", 1e6), 9: ("mils", 0.0254), 10: ("yards", 914.4), 13: ("microns", 1e-3), 14: ("dm", 100.0)}
UNITS |= {21: ("US survey feet", 1.2e6 / 3937.0)}
"""Name and length, mm, of the units of DXF by their number; of 0 it states none."""
CURVES = ("LWPOLYLINE", "POLYLINE", "CIRCLE", "ELLIPSE", "SPLINE", "LINE", "ARC", "3DFACE")
"""What an outline is drawn with in a DXF file."""
UNREAD = ("REGION", "MLINE", "TRACE", "MPOLYGON", "MESH", "BODY", "3DSOLID", "HELIX", "SURFACE", "ACAD_PROXY_ENTITY")
"""What may be a part of an outline and is not read; everything else, such as text and dimensions, is passed over."""
DEPARTURE = 1e-4
"""Departure of chords from round curves over the size of the drawing. Larger: fewer corners. Curves up to twice
as far apart are one that is drawn twice."""
JOINT = 1e-5
"""Ends of curves as far apart over the size of the drawing are joined: rounding of three decimals on 100 mm. Larger:
gaps that are faults of the drawing are closed as well."""
ROUNDING = 1e-9
"""Distances over the size of the drawing, and sines of turns at corners, that are rounding of what is written."""
CAUSES = {
    "Hole lies outside shell": "curves lie beside each other, a curtain is one sheet: keep one outline",
    "Holes are nested": "a curve lies in a hole, or the outermost one is a frame: keep outline and holes",
    "Self-intersection": "curves cross or overlap, or are drawn twice: keep the outline and its holes",
    "Ring Self-intersection": "a curve touches itself: part it there, or draw two",
    "Interior is disconnected": "holes cut the sheet in parts: keep one",
}
"""What shapely finds wrong with an outline and its holes, in words of a drawing."""
DAMAGE = (ArithmeticError, AttributeError, LookupError, OSError, RuntimeError, StopIteration, TypeError, ValueError)
"""What damaged data lead to in ezdxf besides its own errors."""
MOST_PARTS = 200_000
"""Parts of a drawing with its blocks resolved. Larger: a damaged row of blocks is read for minutes."""


@dataclass(frozen=True)
class DrawnOutline:
    """Corners (x, y) of the `outline` and of each of the `holes`, mm; `notes`: what was mended in the file."""

    outline: list[tuple[float, float]]
    holes: list[list[tuple[float, float]]]
    notes: tuple[str, ...]


def read_outline(path: Path) -> DrawnOutline:
    """The outline and holes that a DXF file draws on layers that are on.

    InputError without ezdxf, for no such file, a unit that is not known, curves that are not plane, do not close, cross
    or make several sheets.
    """
    require("ezdxf", "cad", "a DXF outline", "give its corners as outline")
    start = read_bytes(path)[:4]  # a name that is no file is told first, and a sweep sees what it has read
    try:
        if start == b"AC10":
            raise InputError("is a DWG file: save it as DXF")
        curves, notes = _read_curves(path)
        size = float(np.ptp(np.vstack(curves), axis=0).max())
        curves, twice = _distinct([curve for curve in curves if np.ptp(curve, axis=0).max() > JOINT * size], size)
        rings, joints = _joined(curves, size)
        rings, again = _distinct(rings, size)
        outline, *holes = _region(rings, size)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return DrawnOutline(outline, holes, tuple(f"{path.name}: {note}" for note in (*notes, *twice, *joints, *again)))


def _read_curves(path: Path) -> tuple[list[Array], list[str]]:
    """Points (k, 2) along each curve of a plane drawing, mm, and notes on its unit and blocks."""
    import ezdxf
    from ezdxf.lldxf.tagger import struct  # which reads binary files

    try:
        with redirect_stderr(io.StringIO()):  # what ezdxf logs
            drawing = ezdxf.readfile(path)
            off = {one.dxf.name.lower() for one in drawing.layers if one.is_off()}
            frozen = {one.dxf.name.lower() for one in drawing.layers if one.is_frozen()}
            parts = list(islice(_parts(drawing.modelspace(), off | frozen, frozen), MOST_PARTS))
            if len(parts) == MOST_PARTS:
                raise InputError(f"has more than {MOST_PARTS} parts in its blocks: is a row of blocks damaged?")
            if unread := sorted({one.dxftype() for one, _ in parts if one.dxftype().endswith(UNREAD)}):
                raise InputError(f"{', '.join(unread)}: not read as curves; explode them or turn their layer off")
            rough = [(one, _points(one, math.inf), block) for one, block in parts if one.dxftype() in CURVES]
            drawn = [(one, points, block) for one, points, block in rough if (points != points[:1]).any()]
            if not drawn:
                raise InputError(
                    "needs closed curves in model space on layers that are on: polylines, circles, ellipses, splines, "
                    "or lines and arcs that meet end to end"
                )
            every = np.vstack([points for _, points, _ in drawn])
            if not np.abs(every).max() <= MOST_MM:  # nor NaN
                raise InputError(f"a coordinate is no finite number up to {MOST_MM:g}")
            extent = np.ptp(every, axis=0)
            curves = [_points(one, DEPARTURE * float(extent.max())) for one, _, _ in drawn]
    except InputError:
        raise
    except (ezdxf.DXFError, struct.error, *DAMAGE) as error:
        raise InputError("cannot be read as DXF: it is damaged, cut off or of another kind; save it anew") from error
    if drawing.units not in UNITS:
        raise InputError(f"states the unit {drawing.units} of $INSUNITS, which is not read: save it in mm")
    unit, factor = UNITS[drawing.units]
    width, height, rise = factor * extent
    if rise > JOINT * max(width, height, rise):
        z = factor * every[:, 2]
        raise InputError(
            f"is not plane, z runs from {z.min():g} to {z.max():g} mm: turn it into a plane z = const, or turn off the "
            "layer of what is no part of the sheet"
        )
    size = f"the drawing has {width:g} x {height:g} mm{', were mm meant?' if max(width, height) > 1e5 else ''}"
    notes = [] if drawing.units == MM else [f"lengths are in {unit} of {factor:g} mm, {size}"]
    if drawing.units == 0:
        notes = [f"no unit is stated and mm are read, {size}"]
    if blocks := sorted({name for _, _, name in drawn if name}):
        listed = ", ".join(map(repr, blocks))
        notes.append(f"curves of the blocks {listed} are read; turn off the layer of what is no part of the sheet")
    return [factor * curve[:, :2] for curve in curves], notes


def _parts(
    entities: Iterable[Any], hidden: set[str], frozen: set[str], host: str = "0", above: tuple[str, ...] = ()
) -> Iterator[tuple[Any, str | None]]:
    """What is drawn on layers that are not hidden, that of blocks too, with the block of model space that it is of.

    What is on layer "0" of a block is on the layer `host` of the block; `above`: names of the blocks that it is in.
    """
    from ezdxf.xclip import XClip

    for one in entities:
        layer = one.dxf.get("layer", "0").lower()
        layer = host if layer == "0" else layer
        if one.dxftype() != "INSERT":
            if layer not in hidden and not one.dxf.get("invisible", 0):
                yield one, above[0] if above else None
        elif layer not in frozen and not one.dxf.get("invisible", 0):
            name, block = one.dxf.name, one.block()
            if block is None or block.block.is_xref or XClip(one).is_clipping_enabled or one.mcount > MOST_PARTS:
                raise InputError(f"block {name!r} is clipped, missing, in another file or too many: explode or bind it")
            if name in above:
                raise InputError(f"block {name!r} holds itself: turn its layer off")
            for single in one.multi_insert() if one.mcount > 1 else [one]:
                yield from _parts(single.virtual_entities(), hidden, frozen, layer, (*above, name))


def _points(entity: Any, chord: float) -> Array:
    """Points (k, 3) along a curve of ezdxf, none if it has no length; round ones by chords within `chord` of them.

    Vertices that guide a smoothed polyline are no part of it.
    """
    from ezdxf.entities import Ellipse
    from ezdxf.math import rational_bspline_from_ellipse
    from ezdxf.path import make_path, to_bsplines_and_vertices

    kind = entity.dxftype()
    if kind in ("CIRCLE", "ARC", "ELLIPSE"):
        if kind != "ELLIPSE" and not entity.dxf.radius:
            return np.zeros((0, 3))
        ellipse = (entity if kind == "ELLIPSE" else Ellipse.from_arc(entity)).construction_tool()
        return _chords(rational_bspline_from_ellipse(ellipse), chord)
    if kind == "SPLINE":
        return _chords(entity.construction_tool(), chord)
    if kind == "POLYLINE":
        if not (entity.is_2d_polyline or entity.is_3d_polyline):
            raise InputError("POLYLINE: a mesh is not read as a curve; explode it or turn its layer off")
        entity.vertices[:] = [one for one in entity.vertices if not one.dxf.flags & 16]
    # Four cubic pieces (a third of the segments) of an arc in a polyline are 4e-6 of its radius off a half circle. Each
    # has a corner or more.
    parts = to_bsplines_and_vertices(make_path(entity, segments=12))
    points = [np.array(one, dtype=float) if isinstance(one, list) else _chords(one, chord) for one in parts]
    return np.vstack([np.zeros((0, 3)), *points])


def _chords(curve: Any, chord: float) -> Array:
    """Points (k, 3) near a B-spline of ezdxf, with chords within `chord` of it.

    Between both ends they lie outside of the curve by so much that the polygon has the area of the curve.
    """
    knots, weights = np.array(curve.knots()), np.array(curve.weights() or np.ones(curve.count))[:, None]
    rational = BSpline(knots, np.hstack([weights * np.array(curve.control_points), weights]), curve.degree)
    spans = np.unique(np.clip(knots, knots[curve.degree], knots[-curve.degree - 1]))  # a periodic one repeats itself

    def place(t: Array) -> Array:
        return np.asarray(rational(t)[..., :3] / rational(t)[..., 3:])

    counts = np.ones(len(spans) - 1, dtype=int)
    while True:
        parts = [np.linspace(*pair, count, endpoint=False) for pair, count in zip(pairwise(spans), counts, strict=True)]
        t = np.concatenate([*parts, spans[-1:]])
        points = place(t)
        side = np.diff(points, axis=0)[:, None]
        inner = place(t[:-1, None] + np.diff(t)[:, None] * [0.25, 0.5, 0.75])
        length = np.maximum(np.linalg.norm(side, axis=2, keepdims=True), 1e-150)
        off = inner - points[:-1, None]
        off -= (off * side).sum(axis=2, keepdims=True) * side / length**2
        # Departure of chords from a round curve over its own size, so that small holes stay round: 22 corners of a
        # circle.
        allowed = max(min(chord, 5e-3 * np.ptp(points, axis=0).max()), 1e-12 * np.abs(points).max())
        worst = np.maximum.reduceat(np.linalg.norm(off, axis=2).max(axis=1), np.cumsum(counts) - counts)
        if chord == math.inf or not worst.max() > allowed:
            break
        counts = np.where(worst > allowed, np.ceil(1.01 * counts * np.sqrt(worst / allowed)), counts).astype(int)
    length = length[:, 0]
    area = length * (4.0 * off[:, 0] + 2.0 * off[:, 1] + 4.0 * off[:, 2]) / 12.0  # Simpson's rule, towards the curve
    if np.linalg.norm(points[0] - points[-1]) <= ROUNDING * length.sum():
        move = (area + np.roll(area, 1, axis=0)) / (length + np.roll(length, 1, axis=0))
        return np.asarray(points + np.vstack([move, move[:1]]) * (chord < math.inf))
    area[[0, -1]] *= 2.0
    points[1:-1] += (area[:-1] + area[1:]) / (length[:-1] + length[1:]) * (chord < math.inf)
    return points


def _distinct(curves: list[Array], size: float) -> tuple[list[Array], list[str]]:
    """The curves (k, 2) without those that repeat another one, and a note on them."""
    lines = np.array([shapely.LineString(curve) for curve in curves])
    near = np.minimum(2.0 * DEPARTURE * size, 0.1 * shapely.length(lines))  # of short ones neighbours are near
    one, two = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=near)
    one, two = one[one < two], two[one < two]
    same = shapely.hausdorff_distance(lines[one], lines[two]) <= np.minimum(near[one], near[two])
    twice = np.unique(two[same])
    if not len(twice):
        return curves, []
    kept = [curve for number, curve in enumerate(curves) if number not in set(twice.tolist())]
    return kept, [f"curves that are drawn twice are read once: {len(twice)}, one from {_place(curves[twice[0]][0])}"]


def _joined(curves: list[Array], size: float) -> tuple[list[Array], list[str]]:
    """Closed curves (k, 2), those made of open ones that meet end to end among them, and a note if rounding parts ends.

    InputError for gaps, by place and width, and for places where more than two ends meet.
    """
    given = np.concatenate([curve[[0, -1]] for curve in curves])
    node = components(cKDTree(given).query_pairs(JOINT * size, output_type="ndarray"), len(given))[1]
    places = given[np.unique(node, return_index=True)[1]]
    ends = node.reshape(-1, 2)
    pieces = [np.vstack([places[a], curve[1:-1], places[b]]) for curve, (a, b) in zip(curves, ends, strict=True)]
    meet = np.bincount(ends[ends[:, 0] != ends[:, 1]].ravel(), minlength=len(places))
    if (loose := places[meet == 1]).size:
        width, other = (part[:, 1] for part in cKDTree(loose).query(loose, k=2))
        gaps = sorted({(float(w), *sorted((a, int(b)))) for a, (w, b) in enumerate(zip(width, other, strict=True))})
        listed = [f"{w:.4g} mm from {_place(loose[a])} to {_place(loose[b])}" for w, a, b in gaps[:3]]
        more = f" and {len(gaps) - 3} more" if len(gaps) > 3 else ""
        raise InputError(
            f"curves do not close, gaps of {', '.join(listed)}{more}: draw them end to end, and remove what "
            "is no part of the sheet or turn its layer off"
        )
    if len(many := np.flatnonzero(meet > 2)):
        raise InputError(
            f"{meet[many[0]]} curves meet at {_place(places[many[0]])}, one is drawn twice or no part of the outline: "
            "remove it, or turn its layer off"
        )
    rings = [shapely.get_coordinates(one) for one in shapely.get_parts(shapely.line_merge(_lines(pieces)))]
    away = np.linalg.norm(given - places[node], axis=1)
    if away.max() <= ROUNDING * size:
        return rings, []
    where = f"{away.max():.2g} mm at {_place(given[away.argmax()])}"
    return rings, [f"ends of curves that are nearly together are joined, they are at most {where} apart"]


def _lines(curves: list[Array]) -> Any:
    """The curves (k, 2) as lines of shapely."""
    return shapely.MultiLineString([shapely.LineString(curve) for curve in curves])


def _place(point: Sequence[float] | Array) -> str:
    """A point (2,) as messages name it."""
    return f"({point[0]:.9g}, {point[1]:.9g})"


def _region(rings: list[Array], size: float) -> list[Any]:
    """Corners of the outline, and of its holes from the largest to the smallest; InputError if they bound no region."""
    rings = [shapely.get_coordinates(shapely.remove_repeated_points(_lines([one]), ROUNDING * size)) for one in rings]
    for ring in rings:
        if len(ring) < 4:
            raise InputError(f"the curve from {_place(ring[0])} encloses no area: remove it, or turn its layer off")
    outline, *holes = sorted(rings, key=lambda ring: -abs(signed_areas(ring)))
    reason, _, at = shapely.is_valid_reason(shapely.Polygon(outline, holes)).rstrip("]").partition("[")
    if at:
        cause = CAUSES.get(reason, "curves bound no sheet: keep the outline and its holes")
        x, y = map(float, at.split())
        raise InputError(f"{cause}, and turn off the layer of the others (at {_place((x, y))})")
    return [list(map(tuple, one[:-1].tolist())) for one in (outline, *holes)]


def write_outline(path: Path, mesh: Any) -> None:
    """Write the corners of the boundary of a scikit-fem mesh, mm, as closed polylines of a DXF file."""
    import ezdxf

    document = ezdxf.new(units=MM)
    document.layers.add("CURTAIN")
    rings = [shapely.normalize(shapely.Polygon(mesh.p[:, loop].T)) for loop in boundary_loops(mesh)]  # from a corner
    for ring in shapely.simplify(rings, ROUNDING * float(np.ptp(mesh.p, axis=1).max()), preserve_topology=False):
        corners = shapely.get_coordinates(ring)[:-1].tolist()
        document.modelspace().add_lwpolyline(corners, close=True, dxfattribs={"layer": "CURTAIN"})
    with atomic_path(path) as temporary:
        document.saveas(temporary)
