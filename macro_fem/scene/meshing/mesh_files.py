"""Meshes in files as plane sheets: their cells checked, their groups of lines as named edges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import skfem
from scipy.spatial import cKDTree

from macro_fem.fem.cells import counterclockwise, cross, signed_areas
from macro_fem.scene.meshing.edges import facets_between, named_edges
from macro_fem.scene.meshing.places import least_sine
from macro_fem.scene.shapes import MeshFile
from macro_fem.scene.tables import MOST_MM
from rve.common.errors import InputError
from rve.common.meshes import read_mesh_file
from rve.common.types import Array
from rve.common.values import shown

MAX_NEAR = 10_000_000
"""Pairs of a side on the boundary and a corner in the circle over it, in a mesh file; usually a few per side."""


def read_mesh(curtain: MeshFile, source: Path) -> tuple[Any, dict[str, np.ndarray]]:
    """The plane mesh of scikit-fem in a file, and its named edges: facet numbers per name.

    A curtain.vtu is its reference state. InputError for cells that are inverted, doubled, flat or not plane.
    """
    where = f"{source}: [curtain] file = {shown(curtain.file)}:"
    try:
        data = read_mesh_file(source.parent / curtain.file)
    except InputError as error:
        raise InputError(f"{where} {error}") from error
    kinds = [kind for kind in ("triangle", "quad") if len(data.cells_dict.get(kind, ()))]
    if len(kinds) != 1:
        raise InputError(f"{where} needs cells of one kind, triangle or quad, it has {sorted(data.cells_dict)}")
    if "reference_mm" in data.point_data:
        raise InputError(f"{where} is the deformed curtain of version 0.2 or before; solve it again")
    cells = np.asarray(data.cells_dict[kinds[0]], dtype=np.int64)
    if cells.size and not 0 <= cells.min() <= cells.max() < len(data.points):
        raise InputError(f"{where} a cell names point {cells.max()}, there are {len(data.points)}")
    used, cells = np.unique(cells, return_inverse=True)
    cells = cells.reshape(-1, 3 if kinds[0] == "triangle" else 4)
    points = _plane_points(np.asarray(data.points, dtype=float)[used], where)
    _check_cells(points, cells, where)
    mesh_type = skfem.MeshTri if kinds[0] == "triangle" else skfem.MeshQuad
    mesh = mesh_type(points.T.copy(), cells.T.copy())
    _check_sides(mesh, where)
    lines = physical_lines(data, mesh, used, where)
    try:
        edges = named_edges(mesh, [], lines)
    except InputError as error:
        raise InputError(f"{where} {error}") from error
    return mesh, edges


def physical_lines(data: Any, mesh: Any, used: np.ndarray, where: str) -> dict[str, np.ndarray]:
    """Node pairs (k, 2) of the physical groups of lines in a Gmsh file, by name, or by number where they have none.

    `used` are the numbers in the file of the nodes of `mesh`. InputError for a group of which only a part lies on
    sides of cells.
    """
    names = {int(tag): str(name) for name, (tag, dim) in data.field_data.items() if dim == 1}
    tags = data.cell_data.get("gmsh:physical", [])
    in_sets = names.values() & data.cell_sets.keys()  # there a line may belong to several groups
    found: dict[str, list[np.ndarray]] = {}
    for number, block in enumerate(data.cells):
        if block.type != "line":
            continue
        for name in in_sets:
            found.setdefault(name, []).append(block.data[data.cell_sets[name][number]])
        for one in np.unique(tags[number]) if tags else ():
            if (name := names.get(int(one), str(int(one)))) not in in_sets:
                found.setdefault(name, []).append(block.data[tags[number] == one])
    lines = {}
    for name, blocks in found.items():
        pairs = np.concatenate(blocks).astype(np.int64)
        place = np.minimum(np.searchsorted(used, pairs), len(used) - 1)
        place = place[(used[place] == pairs).all(axis=1)]
        on_sides = len(facets_between(mesh, place)) if len(place) else 0
        if 0 < on_sides < len(np.unique(np.sort(pairs, axis=1), axis=0)):
            raise InputError(f"{where} group {name!r}: only {on_sides} of its {len(pairs)} lines are sides of cells")
        if on_sides:
            lines[name] = place
    return lines


def _check_sides(mesh: Any, where: str) -> None:
    """InputError if more than two cells share a side, or a corner of one cell lies on the side of another."""
    sides = np.bincount(mesh.t2f.ravel(), minlength=mesh.facets.shape[1])
    if sides.max() > 2:
        (x, y) = mesh.p[:, mesh.facets[:, sides.argmax()]].mean(axis=1)
        raise InputError(f"{where} {sides.max()} cells share the side around ({x:g}, {y:g})")
    rim = mesh.boundary_facets()
    a, b = mesh.p[:, mesh.facets[0, rim]].T, mesh.p[:, mesh.facets[1, rim]].T
    corners = mesh.p[:, np.unique(mesh.facets[:, rim])].T
    length = np.linalg.norm(b - a, axis=1)
    tree, middle, radius = cKDTree(corners), 0.5 * (a + b), 0.499999 * length
    pairs = int(tree.query_ball_point(middle, radius, return_length=True).sum())
    if pairs > MAX_NEAR:
        raise InputError(
            f"{where} sides on the boundary are so much longer than others that {pairs:.3g} pairs of side and corner "
            f"would have to be compared, at most {MAX_NEAR:.3g} are"
        )
    for side, numbers in enumerate(tree.query_ball_point(middle, radius) if pairs else ()):
        along = (b[side] - a[side]) / length[side]
        off = corners[numbers] - a[side]
        on = np.abs(cross(along, off)) < 1e-9 * length[side]
        if on.any():
            x, y = corners[numbers][on][0]
            raise InputError(f"{where} the point ({x:g}, {y:g}) lies on the side of a cell that it is no corner of")


def _plane_points(points: Array, where: str) -> Array:
    if not np.all(np.isfinite(points)):
        raise InputError(f"{where} point {int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])} is not finite")
    if not points.size:
        raise InputError(f"{where} has no points")
    if np.abs(points).max() > MOST_MM:
        raise InputError(f"{where} a coordinate is {np.abs(points).max():g} mm, at most {MOST_MM:g} are allowed")
    if points.shape[1] == 3 and np.ptp(points[:, 2]) > 1e-9 * np.ptp(points, axis=0).max():
        raise InputError(f"{where} is not plane, z runs from {points[:, 2].min():g} to {points[:, 2].max():g}")
    return np.ascontiguousarray(points[:, :2], dtype=float)


def _check_cells(points: Array, cells: np.ndarray, where: str) -> None:
    area = signed_areas(points[cells])
    area *= 1.0 if np.count_nonzero(area > 0.0) >= np.count_nonzero(area < 0.0) else -1.0  # either sense, but one
    scale = np.abs(area).max()
    for bad, what in (
        (area < -1e-12 * scale, "is inverted against most others"),
        (np.abs(area) <= 1e-12 * scale, "has no area"),
        (least_sine(points[counterclockwise(points, cells)]) <= 0.0, "is not convex"),
    ):
        if bad.any():
            raise InputError(f"{where} cell {int(np.flatnonzero(bad)[0])} {what} ({int(bad.sum())} such cells)")
    _, first, counts = np.unique(np.sort(cells, axis=1), axis=0, return_index=True, return_counts=True)
    if counts.max() > 1:
        raise InputError(f"{where} cell {int(first[counts > 1][0])} is there {int(counts.max())} times")
