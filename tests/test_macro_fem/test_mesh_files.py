"""Mesh files: groups of lines, kinds of cells, and a sentence for what is wrong."""

import pytest

from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.schema import read_scene
from rve.common.errors import InputError
from rve.common.meshes import read_mesh_file
from tests.fuzz.targets import TARGETS, msh_41

MESHES = [name for name in TARGETS if name.startswith(("msh", "vtu"))]


def mesh_of(folder):
    tables = {"curtain": {"shape": "file", "file": next(folder.iterdir()).name}, "support": {"kind": "top"}}
    return build_mesh(read_scene(tables, folder / "scene.toml"), None)


@pytest.mark.parametrize("name", MESHES)
def test_every_offered_format_gives_the_same_square(name, tmp_path):
    TARGETS[name].make(tmp_path)
    mesh = mesh_of(tmp_path).mesh
    assert mesh.p.shape[1] == 16
    assert mesh.p.max() == 3.0
    assert mesh.t.shape[1] == (9 if mesh.t.shape[0] == 4 else 18)


def test_lines_keep_their_physical_group(tmp_path):
    (tmp_path / "mesh.msh").write_text(msh_41())
    found = mesh_of(tmp_path)
    upper = found.mesh.p[:, found.mesh.facets[:, found.edges["upper"]]]
    assert upper.shape == (2, 2, 3)
    assert (upper[1] == 3.0).all()


def test_a_line_in_two_groups_belongs_to_both(tmp_path):
    text = msh_41().replace("0 1 7 0\n", "0 2 7 9 0\n").replace("2\n1 7", '3\n1 9 "rail"\n1 7')
    (tmp_path / "mesh.msh").write_text(text)
    edges = mesh_of(tmp_path).edges
    assert len(edges["rail"]) == 3
    assert edges["rail"].tolist() == edges["upper"].tolist()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("4.1 0 8", "5.1 0 8", "Need mesh format"),
        ("1 1 0 4\n", "1 1 1 4\n", "parametric nodes"),
        ("2 1 2 18", "2 1 777 18", "is damaged"),
        ("3 3 0 1 8 1 1\n", "3 3 0 0 1 1\n", "only some of its surfaces are in a physical group"),
        ("2 21 1 21", "999999999999 21 1 21", "999999999999 nodes or elements are too many"),
    ],
)
def test_what_is_wrong_with_a_gmsh_file_is_one_sentence(tmp_path, old, new, words):
    assert old in msh_41()
    (tmp_path / "mesh.msh").write_text(msh_41().replace(old, new, 1))
    with pytest.raises(InputError, match=rf"mesh\.msh: cannot be read as MSH: .*{words}"):
        read_mesh_file(tmp_path / "mesh.msh")


@pytest.mark.parametrize("ending", ["", ".stl", ".vtk", ".xdmf", ".inp"])
def test_other_formats_are_refused_with_the_list_of_these(tmp_path, ending):
    path = tmp_path / f"mesh{ending}"
    path.write_text("x")
    with pytest.raises(InputError, match=r"are not read, only \.msh .*meshio convert"):
        read_mesh_file(path)
