"""Mesh files: meshio, an independent reader, sees the same points and cells; groups, order and mixtures of cells."""

from random import Random

import meshio
import numpy as np
import pytest

from macro_fem.scene.meshing.gmsh import read_gmsh
from macro_fem.scene.meshing.mesh_files import read_mesh_file
from rve.common.errors import InputError
from rve.common.storage.vtu import read_vtu
from tests.fuzz.targets import TARGETS, make_curtain, make_vtu, msh_41, square


@pytest.mark.parametrize("name", [name for name in TARGETS if name.startswith(("msh", "vtu"))])
def test_meshio_sees_the_same(name, tmp_path):
    TARGETS[name].make(tmp_path)
    path = next(iter(tmp_path.iterdir()))
    ours, theirs = read_mesh_file(path), meshio.read(path)
    np.testing.assert_array_equal(ours.points, theirs.points)
    assert ours.cells_dict.keys() == theirs.cells_dict.keys()
    for kind, cells in theirs.cells_dict.items():
        np.testing.assert_array_equal(ours.cells_dict[kind], cells)


@pytest.mark.parametrize("binary", [False, True])
def test_fields_of_a_curtain_are_those_meshio_sees(tmp_path, binary):
    make_curtain(tmp_path, binary)
    ours, theirs = read_vtu(tmp_path / "curtain.vtu"), meshio.read(tmp_path / "curtain.vtu")
    assert ours.point_data.keys() == theirs.point_data.keys()
    for name, values in theirs.point_data.items():
        np.testing.assert_array_equal(ours.point_data[name], values)
    for name, values in theirs.cell_data.items():
        np.testing.assert_array_equal(ours.cell_data[name], values[0])


@pytest.mark.parametrize("name", ["msh-2.2-text", "msh-2.2-binary", "msh-4.1-text"])
def test_lines_keep_their_physical_group(name, tmp_path):
    TARGETS[name].make(tmp_path)
    mesh = read_mesh_file(tmp_path / "mesh.msh")
    assert mesh.field_data["upper"].tolist() == [7, 1]
    lines = [
        block.data
        for block, group in zip(mesh.cells, mesh.cell_data["gmsh:physical"], strict=True)
        if block.type == "line" and (group == 7).all()
    ]
    (upper,) = lines
    assert upper.shape == (3, 2)
    assert (mesh.points[upper][..., 1] == 3.0).all()


def test_a_line_in_two_groups_belongs_to_both():
    text = msh_41().replace("0 1 7 0\n", "0 2 7 9 0\n").replace("2\n1 7", '3\n1 9 "rail"\n1 7')
    found = read_gmsh(text.encode())
    assert found.names[1, 9] == "rail"
    assert [(kind, group) for kind, _, group in found.blocks] == [("line", 7), ("line", 9), ("triangle", 8)]


def test_elements_of_version_2_may_alternate():
    """Types, and numbers of tags, change from line to line; node numbers are sparse and not in order."""
    text = """$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
5
900 0 0 0
7 1 0 0
30 1 1 0
4 0 1 0
11 2 0.5 0
$EndNodes
$Elements
4
1 1 2 5 1 900 7
2 3 2 6 1 900 7 30 4
3 2 0 7 11 30
4 1 1 5 30 4
$EndElements
"""
    found = read_gmsh(text.encode())
    by_kind = [(kind, cells.tolist(), group) for kind, cells, group in found.blocks]
    assert by_kind == [
        ("line", [[0, 1]], 5),
        ("quad", [[0, 1, 2, 3]], 6),
        ("triangle", [[1, 4, 2]], 0),
        ("line", [[2, 3]], 5),
    ]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("4.1 0 8", "4.0 0 8", "MSH version '4.0' is not read"),
        ("$MeshFormat", "$Format", "does not begin with"),
        ("1 1 0 4\n", "1 1 1 4\n", "parametric nodes"),
        ("\n16\n0 3 0", "\n4\n0 3 0", "node 4 is there twice"),
        ("1 4 8\n", "1 4 99\n", "a line names node 99, which is not in the file"),
        ("2 1 2 18", "2 1 77 18", "element type 77"),
        ("$EndElements", "", "does not end"),
        ("0 3 0\n", "0 three 0\n", "a text where a number should be"),
        ("1 4 8\n", "1 4 8.5\n", "not a whole number"),
    ],
)
def test_what_is_wrong_with_a_gmsh_file_is_said(tmp_path, old, new, words):
    assert old in msh_41()
    (tmp_path / "mesh.msh").write_text(msh_41().replace(old, new, 1))
    with pytest.raises(InputError, match=rf"mesh\.msh: cannot be read as MSH: .*{words}"):
        read_mesh_file(tmp_path / "mesh.msh")


def test_other_kinds_of_cells_in_a_vtu_are_named(tmp_path):
    points, cells, lines = square("triangle")
    mesh = meshio.Mesh(points, [("line", lines), ("triangle", cells), ("tetra", np.array([[0, 1, 2, 5]]))])
    meshio.vtu.write(tmp_path / "mesh.vtu", mesh)
    found = read_vtu(tmp_path / "mesh.vtu")
    assert {kind: len(one) for kind, one in found.cells.items()} == {"line": 3, "triangle": 18}
    assert found.other == {"tetra": 1}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("UnstructuredGrid", "PolyData", "it holds a 'PolyData', not an UnstructuredGrid"),
        ('NumberOfPoints="16"', 'NumberOfPoints="17"', "numbers, not 51"),
        ('type="Float64" Name="Points"', 'type="Text" Name="Points"', "'Text' is missing or not known"),
        ("<VTKFile", '<!DOCTYPE a [<!ENTITY b "c">]><VTKFile', "declares its own"),
        ("</VTKFile>", "", "not XML, or not all of one"),
    ],
)
def test_what_is_wrong_with_a_vtu_is_said(tmp_path, old, new, words):
    make_vtu(tmp_path, binary=False)
    path = tmp_path / "mesh.vtu"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=rf"mesh\.vtu: cannot be read as VTU: .*{words}"):
        read_vtu(path)


def test_the_same_seed_makes_the_same_file(tmp_path):
    TARGETS["vtu-text"].make(tmp_path)
    content = (tmp_path / "mesh.vtu").read_bytes()
    one, two = (TARGETS["vtu-text"].mutate("mesh.vtu", content, Random("vtu-text:3")) for _ in range(2))
    assert one == two
    assert one != content
