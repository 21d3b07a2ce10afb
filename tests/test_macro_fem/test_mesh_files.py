"""Mesh files: groups of lines, kinds of cells, and a sentence for what is wrong."""

import pytest

from macro_fem.scene.meshing.mesh_files import read_mesh_file
from rve.common import InputError
from tests.squares import MSH, mesh_of, write_square


@pytest.mark.parametrize(
    ("name", "kind", "how"),
    [("a.msh", "triangle", {}), ("a.vtu", "triangle", {"binary": False}), ("a.vtu", "quad", {"compression": "zlib"})],
)
def test_every_offered_format_gives_the_same_square(name, kind, how, tmp_path):
    write_square(tmp_path / name, kind, **how)
    mesh = mesh_of(tmp_path).mesh
    assert (mesh.p.shape[1], mesh.p.max()) == (16 if kind == "triangle" else 25, 3.0)
    assert mesh.t.shape[1] == (18 if kind == "triangle" else 36)  # quadrilaterals are cut in four


def test_lines_keep_their_physical_group_or_both_of_them(tmp_path):
    text = MSH.replace("0 1 7 0\n", "0 2 7 9 0\n").replace("2\n1 7", '3\n1 9 "rail"\n1 7')
    (tmp_path / "mesh.msh").write_text(text)
    found = mesh_of(tmp_path)
    assert found.edges["rail"].tolist() == found.edges["upper"].tolist()
    upper = found.mesh.p[:, found.mesh.facets[:, found.edges["upper"]]]
    assert upper.shape == (2, 2, 3)
    assert (upper[1] == 3.0).all()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("4.1 0 8", "5.1 0 8", "Need mesh format"),
        ("1 1 0 4\n", "1 1 1 4\n", "parametric nodes"),
        ("2 1 2 18", "2 1 777 18", "is damaged"),
        ("3 3 0 1 8 1 1\n", "3 3 0 0 1 1\n", "only some of its surfaces are in a physical group"),
        ("2 21 1 21", "999999999999 21 1 21", "is damaged"),
    ],
)
def test_what_is_wrong_with_a_gmsh_file_is_one_sentence(tmp_path, old, new, words):
    assert old in MSH
    (tmp_path / "mesh.msh").write_text(MSH.replace(old, new, 1))
    with pytest.raises(InputError, match=rf"mesh\.msh: cannot be read as MSH: .*{words}"):
        read_mesh_file(tmp_path / "mesh.msh")


@pytest.mark.parametrize("ending", ["", ".stl", ".vtk", ".xdmf", ".inp"])
def test_other_formats_are_refused_with_the_list_of_these(tmp_path, ending):
    path = tmp_path / f"mesh{ending}"
    path.write_text("x")
    with pytest.raises(InputError, match=r"is not read, only \.msh .*meshio convert"):
        read_mesh_file(path)
