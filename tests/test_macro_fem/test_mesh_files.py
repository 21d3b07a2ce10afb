"""Mesh files: every plane format gives its sheet, what is mended is said, what is wrong is one sentence."""

import json
import re
import tracemalloc
from contextlib import suppress

import meshio
import numpy as np
import pytest
from click.testing import CliRunner

from homogenize import default_law, diagonal_net
from macro_fem import read_scene, solve
from macro_fem.cli import main
from macro_fem.fem import signed_areas
from rve import InputError
from tests.squares import MSH, mesh_of, msh22, write_square
from tests.test_macro_fem.sheets import solve_scene

CORNERS = {1: (0, 0), 2: (400, 0), 3: (400, 400), 4: (0, 400)}
PLATES = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [1, 0], [2, 0], [2, 1], [1, 1]], float) * 100.0
"""Two plates whose seam has nodes 1 and 2 of the first, 4 and 7 of the second."""
SEAM = np.array([0, 0, 0, 0, 1, 0, 0, 1.0])
"""The nodes of the second plate on the seam."""


def measures(mesh, edge="top"):
    """The area of a mesh, and the length of an edge."""
    points, ends = mesh.mesh.p.T, mesh.mesh.p.T[mesh.mesh.facets[:, mesh.edges[edge]]]
    return np.abs(signed_areas(points[mesh.mesh.t.T])).sum(), np.linalg.norm(ends[1] - ends[0], axis=1).sum()


def sheet_of(folder, points, *blocks, **support):
    """The scene of a VTU with the cells of these blocks (type, nodes)."""
    flat = np.column_stack([points, np.zeros((len(points), 3 - np.shape(points)[1]))])
    meshio.Mesh(flat, [(kind, np.array(cells)) for kind, cells in blocks]).write(folder / "mesh.vtu")
    curtain = {"shape": "file", "file": "mesh.vtu", "areal_mass": 1.0}
    return read_scene({"curtain": curtain, "support": support or {"kind": "top"}}, folder / "scene.toml")


GMSH = [{"version": version, "binary": binary} for version in ("2.2", "4.0", "4.1") for binary in (False, True)]
QUAD_TOO = ("avs", "bdf", "dato", "inp", "mdpa", "mesh", "meshb", "obj", "ply", "tec", "vol", "vtk", "vtu")


@pytest.mark.parametrize(
    ("ending", "kind", "how"),
    [
        *((".msh", kind, how) for how in GMSH for kind in ("triangle", "quad")),
        *((f".{ending}", "triangle", {}) for ending in (*QUAD_TOO, "off", "stl", "xml")),
        *((f".{ending}", "quad", {}) for ending in QUAD_TOO),
        (".vtu", "quad", {"binary": False}),
        (".vtu", "triangle", {"compression": "lzma"}),
        (".vtk", "quad", {"file_format": "vtk42"}),
    ],
)
def test_every_offered_format_gives_the_same_square(ending, kind, how, tmp_path):
    write_square(tmp_path / f"a{ending}", kind, **how)
    mesh = mesh_of(tmp_path)
    assert measures(mesh) == pytest.approx((9.0, 3.0), rel=1e-7)
    assert mesh.mesh.t.shape[1] == (18 if kind == "triangle" else 36)  # quadrilaterals are cut in four
    assert not mesh.notes


NUMBERED = re.sub(r"\b16\b", "3000000000", MSH).replace("2 3000000000 1 3000000000", "2 16 1 3000000000")
PARTS = """$EndEntities
$PartitionedEntities
2
1
7 1
0 1 1 0
5 1 1 2 1 2 0 3 0 3 3 0 1 7 0
6 2 1 1 1 0 0 0 3 3 0 1 8 1 5
$EndPartitionedEntities"""
IN_PARTS = MSH.replace("$EndEntities", PARTS).replace("1 1 1 3\n", "1 5 1 3\n").replace("2 1 2 18\n", "2 6 2 18\n")
PARAMETRIC = re.sub(r"^(\d) 3 0$", r"\1 3 0 0.5", MSH.replace("1 1 0 4\n", "1 1 1 4\n"), flags=re.MULTILINE)


@pytest.mark.parametrize(
    "text",
    [
        MSH,
        MSH.replace("0 0 0 3 3 0 1 8 1 1\n", "0 0 0 3 3 0 0 1 1\n"),  # SaveAll: no group of surfaces
        MSH.replace('2 8 "sheet"', '2 8 "upper"'),
        MSH.replace("3 3 0 1 7 0\n", "3 3 0 2 -7 9 0\n"),  # reversed, and in two groups
        NUMBERED,
        IN_PARTS,
        PARAMETRIC,
    ],
)
def test_a_group_of_lines_in_a_gmsh_file_is_an_edge(tmp_path, text):
    (tmp_path / "mesh.msh").write_text(text)
    assert measures(mesh_of(tmp_path), "upper") == pytest.approx((9.0, 3.0))


def test_version_2_has_surfaces_in_two_groups_and_none_by_tag_0(tmp_path):
    surfaces = [(2, group, own) for own in ((1, 2, 3), (1, 3, 4)) for group in (2, 3)]
    lines = [(1, 1, (3, 4)), (1, 0, (1, 2))]
    names = [(1, 1, "rail"), (1, 5, "lost"), (2, 2, "sheet")]
    (tmp_path / "mesh.msh").write_text(msh22(CORNERS, [*lines, *surfaces], names))
    mesh = mesh_of(tmp_path)
    assert measures(mesh, "rail") == (160_000.0, 400.0)
    assert set(mesh.edges) == {"rail", "outline", "top", "bottom", "left", "right"}
    assert mesh.notes == (
        "mesh.msh: the group 'lost' has no lines in the file: save it without SaveAll, or as version 4.1",
    )


SPARSE = msh22(CORNERS | {3: (400, 400), 2_000_000_000: (0, 400)}, [(2, 0, (1, 2, 3)), (2, 0, (1, 3, 2_000_000_000))])


@pytest.mark.parametrize(
    "text",
    [SPARSE, NUMBERED]
    + [MSH.replace(old, new, 1) for old, new in [("2 16 1", "2 999999999 1"), ("2 21 1", "999999999 21 1")]]
    + [MSH.replace("2 1 2 18", "2 1 2 999999999"), MSH.replace("\n4 1 5 6", "\n4 1 5 999999999")]
    + [SPARSE.replace("Elements\n2", "Elements\n999999999"), SPARSE.replace("Nodes\n5", "Nodes\n-1")],
)
def test_memory_is_in_proportion_to_the_file(tmp_path, text):
    (tmp_path / "mesh.msh").write_text(text)
    tracemalloc.start()
    with suppress(InputError):
        mesh_of(tmp_path)
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()


GRID = "GRID,1,,0.0,0.0,0.0\nGRID,2,,1.0,0.0,0.0\nGRID,3,,0.0,1.0,0.0\n"


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.msh", MSH.replace("4.1 0 8", "5.1 0 8"), "version 5.1: save it as"),
        ("a.msh", "$NOD\n1\n1 0 0 0\n$ENDNOD\n", "version 1: save it as"),
        ("a.msh", SPARSE.replace("Nodes", "ParametricNodes"), "parametric nodes"),
        ("a.msh", MSH.replace("2 1 2 18", "2 1 777 18"), "type 777"),
        ("a.msh", MSH.replace("2 21 1 21", "999999999999 21 1 21"), "less than it says"),
        ("a.msh", MSH[:-40], "no end: it is cut off"),
        ("a.msh", MSH.replace("\n4 1 5 6", "\n4 1 5 99"), "node 99, which is not in the file"),
        ("a.msh", SPARSE.replace("400 400", "four 400"), "is damaged"),
        ("a.vtu", '<VTKFile type="UnstructuredGrid" compressor="vtkLZ4DataCompressor"></VTKFile>', "LZ4: save it"),
        ("a.vtu", '<VTKFile type="UnstructuredGrid" version="3.0"></VTKFile>', "version 3.0: save it"),
        ("a.vtu", '<VTKFile type="PolyData" version="1.0"></VTKFile>', "PolyData, no unstructured grid"),
        ("a.vtu", "<Piece a> </Piece> <Piece b>", "2 pieces, of which only one would be read: merge"),
        (
            "a.vtk",
            "# vtk DataFile Version 3.0\n\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 9999 9999 1\n",
            "a grid of",
        ),
        ("a.inp", "*NODE\n1, 0, 0\n*NODE\n2, 0, 0\n", "2 lists of nodes"),
        ("a.ply", "ply\nformat ascii 1.0\n", "is damaged"),
        ("a.off", "OFF\n", "is damaged"),  # where meshio would wait for ever, as in the next two
        ("a.nas", "x\n", "is damaged"),
        ("a.bdf", f"BEGIN BULK\n{GRID}CTRIA3,1,1,1,2,3\nCTRIAX,2,1,1,3,2\nENDDATA\n", "a part of its 2 cells"),
        ("a.mdpa", "Begin Nodes\n", "cut off"),
    ],
)
def test_a_file_that_cannot_be_read_is_named_for_what_it_is(tmp_path, capfd, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=rf"cannot be read as {name[2:].upper()}: .*{words}") as error:
        mesh_of(tmp_path)
    assert not re.search(r"Error|Exception|None|\bobject\b|\n", str(error.value).replace(str(tmp_path), ""))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("cell", [(8, [0, 1, 3, 2]), (6, [0, 1, 3, 2])])
def test_cells_of_images_and_strips_are_not_left_out(tmp_path, cell):
    text = (
        "# vtk DataFile Version 3.0\n\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 6 double\n0 0 0 1 0 0 1 1 0 0 1 0 2 0 0"
    )
    kind, own = cell
    rows = f" 2 1 0\nCELLS 2 10\n4 1 4 5 2\n4 {' '.join(map(str, own))}\nCELL_TYPES 2\n9\n{kind}\n"
    (tmp_path / "a.vtk").write_text(text + rows)
    with pytest.raises(InputError, match="cells other than triangles"):
        mesh_of(tmp_path)


@pytest.mark.parametrize("ending", ["", ".stp", ".svg", ".wkt"])
def test_endings_that_are_not_read_are_refused_with_the_list_of_those_that_are(tmp_path, ending):
    (tmp_path / f"mesh{ending}").write_text("x")
    with pytest.raises(InputError, match=r"is not read; mesh files that are read end in .*\.msh, .*\.vtu"):
        mesh_of(tmp_path)


@pytest.mark.parametrize(
    ("points", "blocks"),
    [
        (PLATES[:4], [("triangle", [[0, 1, 2], [0, 3, 2]])]),  # of opposite orientation
        (PLATES[:4], [("quad", [[0, 1, 2, 2], [0, 2, 2, 3]])]),  # triangles as some formats write them
        (PLATES[:4], [("quad", [[3, 2, 1, 0]])]),
        ([*PLATES[:4], (50, 20)], [("quad", [[0, 4, 2, 3]]), ("triangle", [[0, 1, 4], [1, 2, 4]])]),
    ],
)
def test_cells_of_either_sense_and_kind_are_read(tmp_path, points, blocks):
    sheet_of(tmp_path, points, *blocks)
    mesh = mesh_of(tmp_path)
    assert measures(mesh) == pytest.approx((1e4, 100.0))
    assert not mesh.notes


def middled(nodes, points, bent=0.0):
    """Cells with a middle node on every side, off it by `bent` of its length, each with its own."""
    start, end = points[nodes], np.roll(points[nodes], -1, axis=1)
    middle = 0.5 * (start + end) + bent * (end - start)[..., ::-1] * [1.0, -1.0]
    more = len(points) + np.arange(middle[..., 0].size).reshape(nodes.shape)
    return np.vstack([points, middle.reshape(-1, 2)]), np.hstack([nodes, more])


@pytest.mark.parametrize(("kind", "nodes"), [("triangle6", [[0, 1, 2], [0, 2, 3]]), ("quad8", [[0, 1, 2, 3]])])
def test_second_order_cells_are_read_if_their_sides_are_straight(tmp_path, kind, nodes):
    points, cells = middled(np.array(nodes), PLATES[:4])
    sheet_of(tmp_path, points, (kind, cells))
    mesh = mesh_of(tmp_path)
    assert measures(mesh) == pytest.approx((1e4, 100.0))
    assert mesh.notes == ("mesh.vtu: second-order cells, whose sides are straight, are read as of first order",)
    points, cells = middled(np.array(nodes), PLATES[:4], bent=1e-3)
    sheet_of(tmp_path, points, (kind, cells))
    with pytest.raises(InputError, match=r"bent at \(.*, by 0.001 of its length: save"):
        mesh_of(tmp_path)


def plates(gap):
    """Two plates of 2 x 2 cells whose nodes on the seam are a gap, mm, apart; those of the whole sheet without one."""
    x, y = np.meshgrid(np.linspace(0.0, 200.0, 5), np.linspace(0.0, 100.0, 3), indexing="ij")
    points, n = np.column_stack([x.ravel(), y.ravel()]), 3
    quads = np.array([[n * i + j, n * i + n + j, n * i + n + j + 1, n * i + j + 1] for i in range(4) for j in range(2)])
    if gap is None:
        return points, quads
    right = np.where((quads >= 6) & (quads < 9), quads + 9, quads)
    return np.vstack([points, points[6:9] + np.array([gap, 0.0])]), np.vstack([quads[:4], right[4:]])


@pytest.mark.parametrize("gap", [0.0, 2e-5, -2e-5])
def test_doubled_nodes_of_a_seam_are_joined_with_a_note(tmp_path, gap):
    support = {"kind": "corners", "gather": 0.8}
    heights = [
        solve_scene(sheet_of(tmp_path, points, ("quad", quads), **support), diagonal_net(1.1)).mean_height()
        for points, quads in (plates(None), plates(gap))
    ]
    assert heights[1] == pytest.approx(heights[0], rel=1e-6)
    (note,) = mesh_of(tmp_path).notes
    assert note.startswith("mesh.vtu: 3 nodes closer than 1e-06 of a cell to another are joined with it, as at (100")


def test_what_was_mended_is_printed_and_in_the_summary(tmp_path):
    points, quads = plates(0.0)
    sheet_of(tmp_path, points, ("quad", quads))
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text('[curtain]\nshape = "file"\nfile = "mesh.vtu"\n[support]\nkind = "top"\n')
    result = CliRunner().invoke(main, ["run", str(scene), "--out", str(out), "--no-picture"])
    (note,) = json.loads((out / "summary.json").read_text())["notes"]
    assert note.startswith("mesh.vtu: 3 nodes closer than")
    assert note in result.stdout


TWO = np.vstack([PLATES[:4], PLATES[:4] + np.array([75.0, 25.0])])
QUADS = ("quad", [[0, 1, 2, 3], [4, 5, 6, 7]])
T_SHAPE = [[0, 0], [1, 0], [0.5, 1], [0.5, 0.5], [0.5, -1]]
HANGING = [[0, 0], [2, 0], [2, 2], [0, 2], [2, 1], [4, 1]]


@pytest.mark.parametrize(
    ("points", "blocks", "words"),
    [
        (TWO, [QUADS], r"overlap, as at \(8.*, .*\): their areas add up to 20000 mm2, and they cover 18125: remove"),
        (TWO, [("quad", [[0, 1, 2, 3], [1, 2, 3, 0]])], "add up to 20000 mm2, and they cover 10000"),
        (PLATES[[0, 1, 2, 3] * 2], [QUADS], "add up to 20000 mm2, and they cover 10000"),
        (PLATES[[0, 1, 2, 3] * 2] + 1e-9, [QUADS], "add up to 20000 mm2, and they cover 10000"),
        (np.vstack([PLATES[:4], 50.0 + 0.1 * PLATES[:4]]), [QUADS], "add up to 10100 mm2, and they cover 10000"),
        (T_SHAPE, [("triangle", [[0, 1, 2], [0, 1, 3], [1, 0, 4]])], "overlap"),
        (HANGING, [("triangle", [[0, 1, 2], [0, 2, 3], [1, 5, 4], [4, 5, 2]])], r"node \(2, 1\) is 0 mm off the side"),
        (PLATES + [1e-3, 0] * SEAM[:, None], [QUADS], r"node \(100.*\) is 0.001 mm off the side .*0.001 of a cell"),
        (PLATES - [1e-3, 0] * SEAM[:, None], [QUADS], r"is 0.001 mm off the side|overlap"),
        (PLATES[:4], [("triangle", [[0, 1, 2], [0, 0, 3]])], "is flat"),
        ([[0, 0], [9, 0], [2, 2], [0, 9]], [("quad", [[0, 1, 2, 3]])], "not convex"),
        (PLATES[:4], [("triangle", [[0, 1, 2], [0, 2, 9]])], "names a point"),
        ([[0, 0, 0], [9, 0, 1], [0, 9, 0]], [("triangle", [[0, 1, 2]])], "not plane, z runs from 0 to 1: turn it"),
        ([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], [("tetra", [[0, 1, 2, 3]])], "type tetra.*save its surface"),
        ([[0, 0], [9, 0], [9, 9], [5, 9], [0, 9]], [("polygon", [[0, 1, 2, 3, 4]])], "type polygon"),
        ([[0, 0], [9, 0], [np.inf, 9]], [("triangle", [[0, 1, 2]])], "no finite number"),
        ([[0, 0], [9, 0]], [("line", [[0, 1]])], "no triangles"),
    ],
)
def test_cells_that_make_no_sheet_are_refused(tmp_path, points, blocks, words):
    sheet_of(tmp_path, np.array(points, float), *blocks)
    with pytest.raises(InputError, match=words):
        mesh_of(tmp_path)


@pytest.mark.parametrize("outline", [False, True])
def test_far_from_the_origin_the_answer_is_the_same(tmp_path, outline):
    """10 km away places are known to 2e-9 mm, and the solver takes the same steps."""
    corners = np.array([[0, 0], [600, 0], [600, 400], [300, 500], [0, 400.0]])
    heights, steps = [], []
    for away in (0.0, 1e7):
        support = [{"kind": "point", "at": [away, away + 400.0]}]
        support += [{"kind": "point", "at": [away + 600.0, away + 400.0], "move": [-90.0, 0.0]}]
        if outline:
            curtain = {"shape": "outline", "outline": (corners + away).tolist(), "areal_mass": 1.0}
            scene = read_scene({"curtain": curtain, "mesh": {"cells": 6}, "support": support})
        else:
            points, quads = plates(None)
            table = {"curtain": {"shape": "file", "file": "mesh.vtu", "areal_mass": 1.0}, "support": support}
            sheet_of(tmp_path, points * [3.0, 4.0] + away, ("quad", quads))
            scene = read_scene(table, tmp_path / "scene.toml")
        curtain = solve_scene(scene, diagonal_net(1.1))
        assert curtain.status == "converged"
        heights.append(curtain.mean_height() - away)
        steps.append(curtain.iterations)
    assert heights[1] == pytest.approx(heights[0], abs=6e-7)
    assert steps[1] <= steps[0] + 2


def test_a_mesh_in_metres_is_refused_with_the_way_out(tmp_path):
    write_square(tmp_path / "mesh.vtu")
    tables = {"curtain": {"shape": "file", "file": "mesh.vtu"}, "support": {"kind": "top"}}
    said = "of 3 and 3 mm are less than the mean diameter of a ring, 10 mm; were metres meant? Scale the mesh by 1000"
    with pytest.raises(InputError, match=re.escape(said)):
        solve(read_scene(tables, tmp_path / "scene.toml"), default_law())
