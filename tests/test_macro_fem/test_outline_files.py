"""Drawings in DXF files: right, mended with a note, or refused with a remedy; areas by closed forms."""

import json
import math
import re
from itertools import pairwise

import ezdxf
import numpy as np
import pytest
import shapely
import skfem
from click.testing import CliRunner
from ezdxf.math import bulge_to_arc

from macro_fem import read_scene
from macro_fem.cli import main
from macro_fem.scene import mesh_outline, read_outline, write_outline
from rve import InputError
from tests.test_macro_fem.test_outlines_behaviour import star

BOX = [(0, 0), (600, 0), (600, 400), (0, 400)]


def area(drawing):
    return shapely.Polygon(drawing.outline, drawing.holes).area


def area_within(corners, bulges):
    """Shoelace formula and circular segments: a bulge is the tangent of a quarter of an arc's angle."""
    z = corners @ [1.0, 1.0j]
    side, angle = np.abs(np.roll(z, -1) - z), 4.0 * np.arctan(bulges)
    sine = np.where(bulges == 0.0, 1.0, np.sin(0.5 * angle))
    segments = np.where(bulges == 0.0, 0.0, 0.125 * side**2 / sine**2 * (angle - np.sin(angle)))
    return float(0.5 * (np.conj(z) * np.roll(z, -1)).imag.sum() + segments.sum())


def draw(layout, corners, bulges, rng, is_whole, flipped=False):
    """A polyline, or its lines and arcs in any order and sense, through OCS coordinates if it is flipped."""
    layer = {"extrusion": (0, 0, -1)} if flipped else {}
    mirror = [-1.0, 1.0] if flipped else [1.0, 1.0]
    vertices = np.column_stack([corners * mirror, -bulges if flipped else bulges])
    if is_whole:
        layout.add_polyline2d(vertices.tolist(), format="xyb", close=True, dxfattribs=layer)
        return
    for k in rng.permutation(len(vertices)):
        (*a, bulge), (*b, _) = vertices[k], vertices[(k + 1) % len(vertices)]
        if bulge:
            centre, start, end, radius = bulge_to_arc(a, b, bulge)
            layout.add_arc(centre, radius, math.degrees(start), math.degrees(end), dxfattribs=layer)
        else:
            layout.add_line(*rng.permutation([a * np.array(mirror), b * np.array(mirror)]))


@pytest.mark.parametrize("seed", range(16))
def test_a_drawing_has_its_area_whatever_it_is_made_of(tmp_path, seed):
    """Lines, arcs and polylines, in mirrored planes, units, blocks turned, mirrored or stretched, old and new."""
    rng = np.random.default_rng(seed)
    version, (unit, length) = [("R12", (0, 1.0)), ("R2000", (1, 25.4)), ("R2010", (6, 1000.0)), ("R2018", (5, 10.0))][
        seed % 4
    ]
    document = ezdxf.new(version)
    if unit:
        document.units = unit
    block = document.blocks.new("SHEET")
    curves = [(star(rng.uniform(0.6, 1.0, 11)), 1.0), (star(rng.uniform(0.1, 0.2, 6)) + 0.2, -1.0)]
    expected = 0.0
    for corners, sign in curves:
        bulges = rng.uniform(-0.1, 0.3, len(corners)) * (rng.random(len(corners)) < 0.5)
        draw(block, corners, bulges, rng, is_whole=rng.random() < 0.3, flipped=rng.random() < 0.5)
        expected += sign * area_within(corners, bulges)
    scales = [(1.0, 1.0), (-2.0, 2.0), (3.0, 1.5), (1.0, 1.0)][seed // 4]
    place = {"xscale": 400.0 / length * scales[0], "yscale": 400.0 / length * scales[1], "rotation": 33.0}
    if seed < 12:
        document.modelspace().add_blockref("SHEET", (7.0, -3.0), place)
    else:
        document.blocks.new("FRAME").add_blockref("SHEET", (5.0, 5.0), place)
        document.modelspace().add_blockref("FRAME", (1.0, 2.0), {"rotation": 21.0, "yscale": -1.0})
    document.modelspace().add_text("SHEET 1 OF 1")
    document.saveas(tmp_path / "sheet.dxf", fmt="bin" if seed % 3 == 0 else "asc")
    drawing = read_outline(tmp_path / "sheet.dxf")
    assert area(drawing) == pytest.approx(400.0**2 * abs(math.prod(scales)) * expected, rel=1e-4)
    assert ("the drawing has" in drawing.notes[0], "block" in drawing.notes[-1]) == (True, True)


def spline_area(points):
    """The integral of x dy over the pieces of a closed uniform cubic B-spline, which are polynomials."""
    basis = np.array([[-1, 3, -3, 1], [3, -6, 3, 0], [-3, 0, 3, 0], [1, 4, 1, 0]]) / 6.0
    parts = [basis @ np.roll(points, -k, axis=0)[:4] for k in range(len(points))]
    return sum((np.poly1d(part[:, 0]) * np.poly1d(part[:, 1]).deriv()).integ()(1.0) for part in parts)


def rim(layout, corners=BOX, **how):
    """A closed polyline."""
    layout.add_lwpolyline(corners, close=True, dxfattribs=how)


def lines(layout, corners=BOX, last=BOX[0]):
    """Lines from corner to corner, then to `last`."""
    for a, b in pairwise([*corners, last]):
        layout.add_line(a, b)


def shifted(by):
    return [(x + by, y + by) for x, y in BOX]


KNOTS = 100.0 * star(np.array([2.0, 3.0, 2.5, 1.5, 3.0, 2.0, 2.2]))


def with_block(layout, insert, layer="0"):
    """A box, and a circle of 10 mm in the block POST."""
    rim(layout)
    layout.doc.blocks.new("POST").add_circle((0, 0), 10)
    layout.add_blockref("POST", (50, 50), {"layer": layer, **insert})


def hidden(layout, layer):
    layout.doc.layers.add("OFF").off()
    layout.doc.layers.add("FROZEN").freeze()
    with_block(layout, {}, layer)
    layout.add_line((0, 0), (5, 5, 5), {"layer": layer})


MENDED = {
    "rounding": (lambda m: lines(m, last=(0, 1e-8)), 240e3, ""),
    "nearly closed": (lambda m: lines(m, last=(0, 2e-3)), 240e3, r"joined, they are at most 0.002 mm at \(0, 0.002\)"),
    "nearly closed polyline": (
        lambda m: m.add_lwpolyline([*BOX, (0, 2e-3)]),
        240e3,
        "joined, they are at most 0.002 mm",
    ),
    "corners twice": (lambda m: rim(m, [*BOX[:2], *BOX[1:], BOX[0]]), 240e3, ""),
    "twice": (lambda m: (rim(m), rim(m)), 240e3, r"drawn twice are read once: 1, one from \(0, 0\)"),
    "twice in pieces": (lambda m: (lines(m), lines(m, BOX[::-1], BOX[-1])), 240e3, "drawn twice are read once: 4"),
    "twice nearly": (lambda m: (lines(m), rim(m, shifted(0.05))), 240e3, "drawn twice are read once: 1"),
    "arcs on a circle": (
        lambda m: [m.add_circle((0, 0), 100), m.add_arc((0, 0), 100, 20, 90), m.add_arc((0, 0), 100, 90, 20)],
        math.pi * 1e4,
        "drawn twice are read once: 1",
    ),
    "ellipse": (
        lambda m: [m.add_ellipse((0, 0), (80, 60), 0.5, 0, math.pi), m.add_line((80, 60), (-80, -60))],
        0.25 * math.pi * 1e4,
        "",
    ),
    "spline": (lambda m: m.add_spline().set_closed([(*one, 0) for one in KNOTS]), spline_area(KNOTS), ""),
    "lens": (lambda m: m.add_lwpolyline([(0, 0, 1), (200, 0, 1)], format="xyb", close=True), math.pi * 1e4, ""),
    "face": (lambda m: m.add_3dface([(x, y, 7) for x, y in BOX]), 240e3, ""),
    "guides of a smoothed polyline": (
        lambda m: m.add_polyline2d(BOX, close=True).append_vertex((9, 9), dxfattribs={"flags": 16}),
        240e3,
        "",
    ),
    "array of blocks": (
        lambda m: with_block(m, {"row_count": 2, "column_count": 3, "row_spacing": 90, "column_spacing": 90}),
        240e3 - 6 * math.pi * 100,
        "curves of the blocks 'POST' are read",
    ),
    "layer that is off": (lambda m: hidden(m, "OFF"), 240e3, ""),
    "layer that is frozen": (lambda m: hidden(m, "FROZEN"), 240e3, ""),
}


def file_of(folder, make, unit=4):
    document = ezdxf.new(units=unit)
    make(document.modelspace())
    document.saveas(folder / "sheet.dxf")
    return folder / "sheet.dxf"


@pytest.mark.parametrize("name", MENDED)
def test_a_drawing_is_right_or_mended_with_a_note(tmp_path, name):
    make, expected, words = MENDED[name]
    drawing = read_outline(file_of(tmp_path, make))
    assert area(drawing) == pytest.approx(expected, rel=1e-4)
    assert len(drawing.notes) == bool(words)
    if words:
        assert re.search(words, drawing.notes[0])


def tilted(layout, rise):
    layout.add_polyline3d([(x, y, rise * x) for x, y in BOX], close=True)


def holds_itself(layout):
    with_block(layout, {})
    layout.doc.blocks.get("POST").add_blockref("POST", (1, 1))


REFUSED = {
    "tilted": (lambda m: tilted(m, 0.75), "is not plane, z runs from 0 to 450 mm: turn it into a plane"),
    "tilted little": (lambda m: tilted(m, 1e-4), "is not plane, z runs from 0 to 0.06 mm"),
    "tilted circle": (lambda m: m.add_circle((0, 0), 9, {"extrusion": (0, 0.6, 0.8)}), "is not plane"),
    "two planes": (lambda m: [rim(m), m.add_circle((50, 50, 5), 9)], "is not plane, z runs from 0 to 5 mm"),
    "gap": (lambda m: lines(m, last=(0, 0.3)), r"gaps of 0.3 mm from \(0, 0\) to \(0, 0.3\)"),
    "open polyline": (lambda m: m.add_lwpolyline(BOX), r"gaps of 400 mm from \(0, 0\) to \(0, 400\): draw them"),
    "two gaps": (lambda m: lines(m, BOX[1:], (0, 5)), "gaps of 5 mm|gaps of 600 mm"),
    "line that goes on": (lambda m: lines(m, last=(0, -3)), r"gaps of 3 mm from \(0, 0\) to \(0, -3\)"),
    "division": (lambda m: [rim(m), m.add_line((300, 0), (300, 400))], "gaps of 400 mm"),
    "diagonal": (lambda m: [lines(m), m.add_line(BOX[0], BOX[2])], r"3 curves meet at \(0, 0\), one is drawn twice or"),
    "twice askew": (lambda m: [rim(m), rim(m, shifted(1.0))], r"cross or overlap, or are drawn twice.*at \(600, 1\)"),
    "two sheets": (lambda m: [rim(m), rim(m, shifted(900))], "beside each other, a curtain is one sheet"),
    "island": (lambda m: [rim(m), m.add_circle((90, 90), 60), m.add_circle((90, 90), 30)], "a curve lies in a hole"),
    "no area": (lambda m: [rim(m), rim(m, [(9, 9), (60, 9)])], r"from \(9, 9\) encloses no area"),
    "hole beyond": (lambda m: [rim(m), m.add_circle((600, 90), 30)], "curves cross or overlap"),
    "holes and hatches alone": (lambda m: [m.add_hatch(), m.add_circle((0, 0), 0)], "needs closed curves"),
    "region": (lambda m: [rim(m), m.add_trace([(0, 0), (9, 0), (0, 9), (9, 9)])], "TRACE: not read as curves; explode"),
    "huge": (lambda m: m.add_circle((0, 0), 1e12), r"no finite number up to 1e\+09"),
    "missing block": (lambda m: [rim(m), m.add_blockref("NONE", (0, 0))], "block 'NONE' is clipped, missing"),
    "other file": (lambda m: [m.doc.add_xref_def("a.dxf", "A"), rim(m), m.add_blockref("A", (0, 0))], "'A' is clipped"),
    "block in itself": (holds_itself, "block 'POST' holds itself"),
    "endless array": (
        lambda m: with_block(m, {"row_count": 999, "column_count": 999, "row_spacing": 9, "column_spacing": 9}),
        "or too many",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_drawing_that_is_no_plane_sheet_is_refused_by_place_and_remedy(tmp_path, name):
    make, words = REFUSED[name]
    with pytest.raises(InputError, match=words):
        read_outline(file_of(tmp_path, make))


def test_files_that_are_no_drawings_are_refused_and_units_that_are_not_read(tmp_path):
    path = file_of(tmp_path, rim, unit=18)
    with pytest.raises(InputError, match=r"the unit 18 of .INSUNITS, which is not read: save it in mm"):
        read_outline(path)
    assert read_outline(file_of(tmp_path, rim, unit=6)).notes[0].endswith("600000 x 400000 mm, were mm meant?")
    text = path.read_bytes()
    for data, words in ((b"no drawing", "damaged"), (text[:3000], "damaged"), (b"AC1032\0\0", "is a DWG file")):
        path.write_bytes(data)
        with pytest.raises(InputError, match=words):
            read_outline(path)
    with pytest.raises(InputError, match="No such file"):
        read_outline(tmp_path / "none.dxf")


@pytest.mark.parametrize("seed", range(6))
def test_what_is_written_reads_back_to_the_last_digit(tmp_path, seed):
    rng = np.random.default_rng(seed)
    size, place = 10.0 ** (seed % 4 + 1), rng.uniform(-1.0, 1.0, 2) * 10.0 ** (seed + 1)
    corners = [place + size * star(rng.uniform(0.5, 1.0, 9)), place + size * star(rng.uniform(0.1, 0.2, 5))]
    points, cells = mesh_outline(corners[0], corners[1:], 40, 1.15, 0.3)
    write_outline(tmp_path / "sheet.dxf", skfem.MeshTri(points.T.copy(), cells.T.copy()))
    drawing = read_outline(tmp_path / "sheet.dxf")
    assert drawing.notes == ()
    for given, read in zip(corners, [drawing.outline, *drawing.holes], strict=True):
        assert np.sort(np.array(read), axis=0) == pytest.approx(np.sort(given, axis=0), rel=1e-14, abs=0.0)
    assert area(drawing) == pytest.approx(shapely.Polygon(corners[0], corners[1:]).area, rel=1e-12)


def test_a_drawing_in_inches_is_solved_in_mm_and_says_so(tmp_path):
    """On the line that is printed and in the summary; the grain is that of the scene."""
    file_of(tmp_path, lambda m: lines(m, [(0, 0), (24, 0), (24, 16), (0, 16)]), unit=1)
    scene = tmp_path / "scene.toml"
    scene.write_text('curtain = {shape = "dxf", file = "sheet.dxf"}\nmesh.cells = 6\nsupport = {kind = "top"}\n')
    done = CliRunner().invoke(main, ["run", str(scene), "--out", str(tmp_path / "out"), "--no-picture"])
    note = "sheet.dxf: lengths are in inches of 25.4 mm, the drawing has 609.6 x 406.4 mm"
    assert note in done.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["notes"] == [note]
    assert summary["order"]["mesh_width_mm"] == pytest.approx(609.6)
    assert summary["support_forces"][0]["length_held_mm"] == pytest.approx(609.6)


def test_a_scene_says_what_it_takes_of_a_drawing(tmp_path):
    file_of(tmp_path, lambda m: [rim(m), m.add_circle((90, 90), 30)])
    tables = {"shape": "dxf", "file": "sheet.dxf", "weave_angle": 10.0}

    def read(**keys):
        scene = {"curtain": {**tables, **keys}, "support": {"kind": "top"}}
        return read_scene(scene, tmp_path / "scene.toml").curtain

    curtain = read()
    assert (curtain.weave_angle, curtain.outline, len(curtain.holes)) == (10.0, tuple(map(tuple, BOX)), 1)
    for keys, words in (({"holes": []}, "holes = .*unknown"), ({"file": ""}, "file: is missing")):
        with pytest.raises(InputError, match=words):
            read(**keys)
