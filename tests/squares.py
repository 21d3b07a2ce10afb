"""Mesh files of a square: 3 x 3 quadrilaterals or 18 triangles with a side of 1."""

from pathlib import Path

import meshio
import numpy as np

from macro_fem import read_scene
from macro_fem.scene import build_mesh

MSH = (Path(__file__).parent / "data" / "square.msh").read_text()
"""A Gmsh 4.1 file in text, with entities, sparse order of nodes and physical groups."""


def square(kind):
    """Points (16, 3) and cells of the square."""
    x, y = np.meshgrid(np.arange(4.0), np.arange(4.0), indexing="ij")
    number = np.arange(16).reshape(4, 4)
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=2).reshape(-1, 4)
    cells = quads if kind == "quad" else np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1), cells


def write_square(path, kind="triangle", version="4.1", **how):
    """Writes it by meshio; a Gmsh file in a version, binary unless told otherwise."""
    points, cells = square(kind)
    mesh = meshio.Mesh(points, [(kind, cells)])
    if path.suffix != ".msh":
        mesh.write(path, **how)
        return
    if version == "4.1":
        mesh.point_data["gmsh:dim_tags"] = np.tile([2, 1], (len(points), 1))
    mesh.cell_data |= {name: [np.ones(len(cells), int)] for name in ("gmsh:physical", "gmsh:geometrical")}
    meshio.gmsh.write(path, mesh, version, **how)


def msh22(points, elements, names=()):
    """A Gmsh 2.2 file in text from places by node number, (type, group, node numbers), and (dimension, group, name)."""
    names = [f'{dimension} {group} "{name}"' for dimension, group, name in names]
    nodes = [f"{number} {x} {y} 0" for number, (x, y) in points.items()]
    rows = [f"{k} {kind} 2 {group} 1 {' '.join(map(str, own))}" for k, (kind, group, own) in enumerate(elements, 1)]
    parts = {"MeshFormat": ["2.2 0 8"]}
    for name, lines in {"PhysicalNames": names, "Nodes": nodes, "Elements": rows}.items():
        parts[name] = [str(len(lines)), *lines]
    return "".join("\n".join([f"${name}", *lines, f"$End{name}\n"]) for name, lines in parts.items())


def mesh_of(folder):
    """The mesh of a curtain whose shape is the only mesh file of a folder."""
    tables = {"curtain": {"shape": "file", "file": next(folder.iterdir()).name}, "support": {"kind": "top"}}
    return build_mesh(read_scene(tables, folder / "scene.toml"), None)
