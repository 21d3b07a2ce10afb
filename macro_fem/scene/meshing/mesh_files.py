"""Meshes in files as plane sheets (meshio); groups of lines are named edges."""

import io
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import skfem
from scipy.spatial import cKDTree

from macro_fem.fem.cells import counterclockwise, cross, signed_areas
from macro_fem.scene.meshing.edges import facets_between, named_edges
from macro_fem.scene.meshing.nodes import least_sine
from macro_fem.scene.shapes import MeshFile
from macro_fem.scene.tables import MOST_MM
from rve.common import Array, InputError, shown
from rve.common.texts import read_bytes

FORMATS = {".msh": "Gmsh MSH 2.2 and 4.1, ASCII or binary", ".vtu": "VTK XML unstructured grid"}


def read_mesh_file(path: Path) -> Any:
    """The `meshio.Mesh` in a file, points (p, 3); InputError if it is no mesh, or none of the formats that are read.

    Physical groups of a Gmsh file are `cell_sets` by name (version 4.1) or cell data "gmsh:physical" (version 2.2).
    """
    read_bytes(path)  # a name that is no file is told first
    kind = path.suffix.lower()
    if kind not in FORMATS:
        listed = ", ".join(f"{ending} ({what})" for ending, what in FORMATS.items())
        raise InputError(f"{path}: is not read, only {listed} are; meshio convert makes one from most others")
    import meshio

    read = meshio.vtu.read if kind == ".vtu" else meshio.gmsh.read
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), warnings.catch_warnings():
            warnings.filterwarnings("error", message=".*unmatched data")  # numpy's, of words among numbers
            mesh = read(path)
        points = np.asarray(mesh.points, dtype=float).reshape(len(mesh.points), -1)
        mesh.points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
        for block in mesh.cells:
            if not np.isin(block.data, np.arange(len(points))).all():
                raise ValueError(f"a {block.type} names a point that is not among its {len(points)}")
    except (Exception, SystemExit) as error:  # meshio raises whatever damaged data leads to
        text = f"it is damaged or of another kind ({type(error).__name__}: {' '.join(str(error).split())[:200]})"
        if "gmsh:physical" in str(error):
            text = "only some of its surfaces are in a physical group: put all into one, or save it as version 2.2"
        raise InputError(f"{path}: cannot be read as {kind[1:].upper()}: {text}") from error
    return mesh


def read_mesh(curtain: MeshFile, source: Path) -> tuple[Any, dict[str, np.ndarray]]:
    """The plane mesh of scikit-fem in a file, and its named edges: facet numbers per name.

    Quadrilaterals are cut in four. A curtain.vtu is its reference state. InputError for cells that are inverted,
    doubled, flat or not plane.
    """
    try:
        data = read_mesh_file(source.parent / curtain.file)
        kinds = [kind for kind in ("triangle", "quad") if len(data.cells_dict.get(kind, ()))]
        if len(kinds) != 1:
            raise InputError(f"needs cells of one kind, triangle or quad, it has {sorted(data.cells_dict)}")
        given = data.cells_dict[kinds[0]]
        used, cells = np.unique(given, return_inverse=True)
        cells = cells.reshape(given.shape)
        points = _plane_points(np.asarray(data.points, dtype=float)[used])
        _check_cells(points, cells)
        mesh = (skfem.MeshTri if kinds[0] == "triangle" else skfem.MeshQuad)(points.T.copy(), cells.T.copy())
        _check_sides(mesh)
        mesh = mesh if kinds[0] == "triangle" else mesh.to_meshtri(style="x")
        return mesh, named_edges(mesh, [], physical_lines(data, mesh, used))
    except InputError as error:
        raise InputError(f"{source}: [curtain] file = {shown(curtain.file)}: {error}") from error


def physical_lines(data: Any, mesh: Any, used: np.ndarray) -> dict[str, np.ndarray]:
    """Node pairs (k, 2) of the physical groups of lines in a Gmsh file by name or number; `used`: its nodes in `mesh`.

    InputError for a group of which only a part lies on sides of cells.
    """
    names = {int(tag): str(name) for name, (tag, dim) in data.field_data.items() if dim == 1}
    pairs, sets = data.cells_dict.get("line", np.zeros((0, 2), int)), data.cell_sets_dict
    found = {name: pairs[sets[name]["line"]] for name in names.values() if "line" in sets.get(name, {})}
    tags = data.cell_data_dict.get("gmsh:physical", {}).get("line", ())
    for tag in np.unique(tags):  # a line may belong to several groups, of which this is one
        found.setdefault(names.get(int(tag), str(int(tag))), pairs[tags == tag])
    lines = {}
    for name, own in found.items():
        place = np.minimum(np.searchsorted(used, own), len(used) - 1)
        place = place[(used[place] == own).all(axis=1)]
        on_sides = len(facets_between(mesh, place))
        if 0 < on_sides < len(np.unique(np.sort(own, axis=1), axis=0)):
            raise InputError(f"group {name!r}: only {on_sides} of its {len(own)} lines are sides of cells")
        if on_sides:
            lines[name] = place
    return lines


def _plane_points(points: Array) -> Array:
    """The points (n, 2) of a plane sheet; InputError for others."""
    if not np.abs(points).max(initial=0.0) <= MOST_MM:  # nor NaN
        raise InputError(f"a coordinate is no finite number up to {MOST_MM:g} mm")
    if np.ptp(points[:, 2]) > 1e-9 * np.ptp(points, axis=0).max():
        raise InputError(f"is not plane, z runs from {points[:, 2].min():g} to {points[:, 2].max():g}")
    return np.ascontiguousarray(points[:, :2])


def _check_cells(points: Array, cells: np.ndarray) -> None:
    """InputError for cells without a sound shape, or one that is there twice."""
    area = signed_areas(points[cells])
    area *= 1.0 if np.count_nonzero(area > 0.0) >= np.count_nonzero(area < 0.0) else -1.0  # either sense, but one
    scale = np.abs(area).max()
    for bad, what in (
        (area < -1e-12 * scale, "is inverted against most others"),
        (np.abs(area) <= 1e-12 * scale, "has no area"),
        (least_sine(points[counterclockwise(points, cells)]) <= 0.0, "is not convex"),
    ):
        if bad.any():
            raise InputError(f"cell {int(np.flatnonzero(bad)[0])} {what} ({int(bad.sum())} such cells)")
    _, first, counts = np.unique(np.sort(cells, axis=1), axis=0, return_index=True, return_counts=True)
    if counts.max() > 1:
        raise InputError(f"cell {int(first[counts > 1][0])} is there {int(counts.max())} times")


def _check_sides(mesh: Any) -> None:
    """InputError if more than two cells share a side, or a corner of one cell lies on the side of another."""
    sides = np.bincount(mesh.t2f.ravel(), minlength=mesh.facets.shape[1])
    if sides.max() > 2:
        (x, y) = mesh.p[:, mesh.facets[:, sides.argmax()]].mean(axis=1)
        raise InputError(f"{sides.max()} cells share the side around ({x:g}, {y:g})")
    rim = mesh.facets[:, mesh.boundary_facets()]
    corners, (a, b) = mesh.p[:, np.unique(rim)].T, mesh.p[:, rim].transpose(1, 2, 0)
    length = np.linalg.norm(b - a, axis=1)
    for side, near in enumerate(cKDTree(corners).query_ball_point(0.5 * (a + b), 0.499999 * length)):
        off = np.abs(cross((b[side] - a[side]) / length[side], corners[near] - a[side]))
        if off.min(initial=np.inf) < 1e-9 * length[side]:
            x, y = corners[near][off.argmin()]
            raise InputError(f"the point ({x:g}, {y:g}) lies on the side of a cell that it is no corner of")
