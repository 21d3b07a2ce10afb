"""Every reader with valid files for it: what the fuzz tests mutate."""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np

from homogenize.io import load_law
from homogenize.laws.cloth import ClothLaw
from homogenize.laws.net import ring_cell, ring_net
from homogenize.laws.polyhedral import polyhedral_law
from macro_fem.rings.curtain import read_curtain
from macro_fem.rings.localize import parse_window
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.schema import load_scene, read_scene
from rve.directions import parse_angles, read_loads
from rve.geometry.cell import Cell
from rve.solve import solve_table
from rve.table import read_table, write_table

ROOT = Path(__file__).parents[2]


class Target(NamedTuple):
    """`make(folder)` writes valid files; `read(folder)` reads them."""

    make: Callable[[Path], object]
    read: Callable[[Path], object]


def law(r2=0.5, mass=None):
    """A law of 17 half-spaces: an ellipsoid's."""
    angle = 0.25 * np.pi * np.arange(8)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    p = np.vstack([np.zeros((1, 2)), 0.5 * ring, ring])
    S = np.stack([0.5 * (1 + p[:, 0]), 0.5 * p[:, 1], 0.5 * (1 - p[:, 0])], axis=1)
    h = 0.05 * (S[:, 0] - S[:, 2]) + np.sqrt(0.1 * S[:, 0] ** 2 + 0.02 * S[:, 1] ** 2 + 0.08 * S[:, 2] ** 2) - r2 / 10
    cell = ring_cell(5.0, r2, 2.0 * (5.0 + r2), 12.6 + r2)
    return polyhedral_law(S, h, None, cell)


@cache
def table():
    """Four rows: locked, locked, compressive, free."""
    return solve_table(Cell(), ([0.0, 20.0, 10.0, 30.0], [90.0, 30.0, 95.0, 0.0]))


def make_table(folder):
    write_table(table(), folder / "table.csv")


OUTLINE = """
[curtain]
shape = "outline"
outline = [[0, 0], [100, 0], [100, 60], [50, 100], [0, 60]]
holes = [[[40, 30], [60, 30], [50, 50]]]
weave_angle = 12.5
[mesh]
cells = 9
[support]
kind = "top"
"""


def make_scenes(folder):
    (folder / "outline.toml").write_text(OUTLINE)
    for path in (ROOT / "examples").glob("*.toml"):
        (folder / path.name).write_bytes(path.read_bytes())


def read_scenes(folder):
    """Every scene, and unless mutation asks for a large one the mesh of the outline."""
    for path in folder.glob("*.toml"):
        scene = load_scene(path)
        if path.name == "outline.toml" and scene.mesh.cells <= 20:
            build_mesh(scene, None)


def square(kind):
    """Points and cells of a square of 3 x 3 quadrilaterals or 18 triangles, its top edge as lines."""
    x, y = np.meshgrid(np.arange(4.0), np.arange(4.0), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1)
    number = np.arange(16).reshape(4, 4)
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=2).reshape(-1, 4)
    cells = quads if kind == "quad" else np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return points, cells, np.stack([number[:-1, 3], number[1:, 3]], axis=1)


MSH_41 = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
2
1 7 "upper"
2 8 "sheet"
$EndPhysicalNames
$Entities
0 1 1 0
1 0 3 0 3 3 0 1 7 0
1 0 0 0 3 3 0 1 8 1 1
$EndEntities
$Nodes
2 16 1 16
1 1 0 4
4
8
12
16
0 3 0
1 3 0
2 3 0
3 3 0
2 1 0 12
{tags}
{points}
$EndNodes
$Elements
2 21 1 21
1 1 1 3
1 4 8
2 8 12
3 12 16
2 1 2 18
{cells}
$EndElements
"""


def msh_41():
    """A Gmsh 4.1 file in text, with entities, sparse order of nodes and physical groups."""
    points, cells, _ = square("triangle")
    rest = [i for i in range(16) if i % 4 != 3]
    return MSH_41.format(
        tags="\n".join(str(i + 1) for i in rest),
        points="\n".join(" ".join(f"{x:g}" for x in points[i]) for i in rest),
        cells="\n".join(f"{k + 4} {a + 1} {b + 1} {c + 1}" for k, (a, b, c) in enumerate(cells.tolist())),
    )


def make_msh_41_binary(folder):
    points, cells, _ = square("triangle")
    entity = np.tile([2, 1], (len(points), 1))
    mesh = meshio.Mesh(points, [("triangle", cells)], point_data={"gmsh:dim_tags": entity})
    mesh.cell_data |= {name: [np.ones(len(cells), int)] for name in ("gmsh:physical", "gmsh:geometrical")}
    meshio.write(folder / "mesh.msh", mesh, file_format="gmsh", binary=True)


def make_vtu(folder, kind="triangle", **how):
    points, cells, _ = square(kind)
    meshio.vtu.write(folder / "mesh.vtu", meshio.Mesh(points, [(kind, cells)]), **how)


def read_mesh_of(name):
    tables = {"curtain": {"shape": "file", "file": name}, "support": {"kind": "top"}}
    return lambda folder: build_mesh(read_scene(tables, folder / "scene.toml"), None)


def make_curtain(folder):
    points, cells, _ = square("triangle")
    n = len(cells)
    fields = {"E_11_12_22": np.full((n, 3), 0.1), "S_11_12_22_N_per_mm": np.tile([1.0, 0.1, 0.5], (n, 1))}
    fields |= {"line_load_1_N_per_mm": np.ones(n), "state_0_slack_1_wrinkled_2_taut": np.full(n, 2.0)}
    moved = points * [1.1, 0.9, 1.0]
    mesh = meshio.Mesh(
        moved,
        [("triangle", cells)],
        point_data={"displacement_mm": moved - points, "reference_mm": points},
        cell_data={name: [values] for name, values in fields.items()},
    )
    meshio.vtu.write(folder / "curtain.vtu", mesh)
    rings = {"r1_mm": 5.0, "r2_mm": 0.5, "b_x_mm": 11.0, "b_y_mm": 12.646}
    (folder / "summary.json").write_text(json.dumps({"status": "converged", "hang_deg": 0.0, "rings": rings}))


def read_curtain_files(folder):
    curtain = read_curtain(folder)
    curtain.told.cell(curtain.source)


def read_directions(folder):
    """The options --alpha, --loads' rival, and --window, from a text."""
    text = (folder / "options.txt").read_bytes().decode("utf-8", "surrogateescape")
    first, _, second = text.partition(" ")
    parse_angles(first, "--alpha")
    parse_window(second)


TARGETS = {
    "table": Target(make_table, lambda folder: read_table(folder / "table.csv")),
    "law-polyhedral": Target(
        lambda folder: law().save(folder / "law.json"), lambda folder: load_law(folder / "law.json")
    ),
    "law-cloth": Target(
        lambda folder: ClothLaw(cell=law().cell).save(folder / "law.json"),
        lambda folder: load_law(folder / "law.json"),
    ),
    "law-net": Target(
        lambda folder: ring_net(law().cell).save(folder / "law.json"),
        lambda folder: load_law(folder / "law.json"),
    ),
    "scene": Target(make_scenes, read_scenes),
    "loads": Target(
        lambda folder: (folder / "loads.csv").write_text("beta_deg,alpha_deg,note\n30,20,x\n60,-5,y\n"),
        lambda folder: read_loads(folder / "loads.csv"),
    ),
    "directions": Target(lambda folder: (folder / "options.txt").write_text("0:45:5 0,0,50,80.5"), read_directions),
    "msh-4.1-text": Target(lambda folder: (folder / "mesh.msh").write_text(msh_41()), read_mesh_of("mesh.msh")),
    "msh-4.1-binary": Target(make_msh_41_binary, read_mesh_of("mesh.msh")),
    "vtu-text": Target(lambda folder: make_vtu(folder, binary=False), read_mesh_of("mesh.vtu")),
    "vtu-zlib": Target(lambda folder: make_vtu(folder, "quad", compression="zlib"), read_mesh_of("mesh.vtu")),
    "curtain": Target(make_curtain, read_curtain_files),
}
