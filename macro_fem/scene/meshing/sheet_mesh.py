"""The sheet in a mesh file: as it is, mended with a note, or refused. Its named groups of lines are edges."""

from pathlib import Path
from typing import Any

import numpy as np
import shapely
import skfem
from scipy.spatial import cKDTree

from macro_fem.fem.cells import components, counterclockwise, signed_areas
from macro_fem.scene.meshing.edges import Border, border_of, boundary_loops, facets_between
from macro_fem.scene.meshing.mesh_files import MAX_TRIANGLES, read_mesh_file
from macro_fem.scene.meshing.nodes import least_sine
from macro_fem.scene.shapes import MeshFile
from macro_fem.scene.tables import MOST_MM
from rve.common import Array, InputError, shown
from rve.common.records import Index

SAME = 1e-6
"""Nodes closer than this part of the longest side of a cell at them are one node. Larger: small cells are lost. Also
the least sine in a cell, and by how much a sheet may leave its plane, over its size."""
NEAR = 1e-3
"""A node closer to a side than this part of a cell's height, and not joined with it, is refused. Larger: slits that are
meant are refused. Smaller: a seam that is not joined is taken for a slit."""
CORNERS = {"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4, "quad9": 4}
"""Corners of the cells of a sheet, by meshio's name of their type."""


def read_mesh(curtain: MeshFile, source: Path) -> tuple[Any, Border, tuple[str, ...]]:
    """The plane mesh of scikit-fem in a file, its border, and sentences on what was mended.

    Quadrilaterals are cut in four. A curtain.vtu is its reference state.

    InputError for a file that cannot be read, and for cells that make no sheet: bent, flat, overlapping, nearly joined.
    """
    try:
        data = read_mesh_file(source.parent / curtain.file)
        points, triangles, second_order = _triangles(data)
        lines = [block.data[:, :2].ravel() for block in data.cells if block.dim == 1 and len(block)]
        places, number, joined = _joined(points, triangles, np.concatenate([*lines, triangles[0]]))
        mesh = skfem.MeshTri(places.T.copy(), number[triangles].T.copy())
        _check_fit(mesh)
        groups, empty = _named_lines(data, mesh, number)
        notes = tuple(f"{curtain.file}: {note}" for note in (*second_order, *joined, *empty))
        return mesh, border_of(mesh.p.T, boundary_loops(mesh), groups), notes
    except InputError as error:
        raise InputError(f"{source}: [curtain] file = {shown(curtain.file)}: {error}") from error


def _triangles(data: Any) -> tuple[Array, Index, list[str]]:
    """Points (p, 2), counterclockwise triangles (m, 3), and a note where cells of second order were read as of first.

    InputError for other cells, those that are bent, flat or not convex, and points out of a plane z = const.
    """
    kinds: dict[tuple[int, int], list[Index]] = {}
    for block in (block for block in data.cells if len(block) and block.dim > 1):
        width = block.data.shape[1] if block.dim == 2 else 0
        sides = CORNERS.get(block.type, width if block.type == "polygon" and width in (3, 4) else 0)
        if not sides:
            raise InputError(
                f"it has cells of type {block.type}, and a sheet has triangles and quadrilaterals of first or second "
                "order: save its surface alone, with first-order cells"
            )
        kinds.setdefault((sides, width), []).append(block.data)
    if not kinds:
        raise InputError("it has no triangles or quadrilaterals")
    cells = {kind: np.concatenate(blocks) for kind, blocks in kinds.items()}
    points = _plane_points(data.points, np.unique(np.concatenate([nodes.ravel() for nodes in cells.values()])))
    parts, notes = [], list[str]()
    for (sides, width), nodes in cells.items():
        corners = nodes[:, :sides]
        if width > sides:
            _check_straight(points[corners], points[nodes[:, sides : 2 * sides]])
            notes = ["second-order cells, whose sides are straight, are read as of first order"]
        if sides == 4:
            same = corners == np.roll(corners, -1, axis=1)
            is_triangle = same.sum(axis=1) == 1  # as some formats write one
            parts.append(counterclockwise(points, corners[is_triangle][~same[is_triangle]].reshape(-1, 3)))
            corners = corners[~is_triangle]
        corners = counterclockwise(points, corners)
        if sides == 4:
            middle = len(points) + np.arange(len(corners))
            points = np.vstack([points, points[corners].mean(axis=1)])
            corners = np.concatenate([np.column_stack([corners[:, [k - 1, k]], middle]) for k in range(4)])
        parts.append(corners)
    triangles = np.concatenate(parts)
    if len(triangles) > MAX_TRIANGLES:
        raise InputError(f"it has {len(triangles)} triangles, at most {MAX_TRIANGLES:.3g} are allowed")
    if len(bad := np.flatnonzero(least_sine(points[triangles]) <= SAME)):
        x, y = points[triangles[bad[0]]].mean(axis=0)
        raise InputError(f"a cell at ({x:g}, {y:g}) is flat or not convex ({len(bad)} such triangles)")
    return points, triangles, notes


def _plane_points(points: Array, used: Index) -> Array:
    """The points (p, 2) of a plane sheet; InputError where those that are used are no numbers or leave the plane."""
    if not np.abs(points[used]).max() <= MOST_MM:  # nor NaN
        raise InputError(f"a coordinate is no finite number up to {MOST_MM:g} mm")
    low, high = points[used].min(axis=0), points[used].max(axis=0)
    if high[2] - low[2] > SAME * (high - low).max():
        raise InputError(f"is not plane, z runs from {low[2]:g} to {high[2]:g}: turn it into a plane z = const")
    return np.ascontiguousarray(points[:, :2])


def _check_straight(corners: Array, middles: Array) -> None:
    """InputError where the middle node (m, k, 2) of the side after a corner (m, k, 2) is off that side."""
    side, away = np.roll(corners, -1, axis=1) - corners, middles - corners
    square = np.maximum((side**2).sum(axis=2, keepdims=True), 1e-300)
    along = np.clip((away * side).sum(axis=2, keepdims=True) / square, 0.0, 1.0)
    off = np.sqrt(((away - along * side) ** 2 / square).sum(axis=2))
    # A side of a second-order cell is straight if its middle node is no farther off, over its length.
    if off.max() > 1e-4:
        x, y = middles.reshape(-1, 2)[off.argmax()]
        raise InputError(
            f"the side of a second-order cell is bent at ({x:g}, {y:g}), by {off.max():.3g} of its length: save "
            "the mesh with first-order cells that are as small as the curve needs"
        )


def _joined(points: Array, triangles: Index, ends: Index) -> tuple[Array, Index, list[str]]:
    """Places (n, 2) of the nodes of `triangles` (m, 3), of those nearly the same one; the number (p,) of each point,
    also of `ends` of lines, among them, -1 for none; and a note if any were joined."""
    own = np.unique(triangles)
    every = np.concatenate([own, np.setdiff1d(ends, own)])
    longest = _lengths(points[triangles]).max(axis=1)
    reach = np.full(len(points), SAME * longest.max())
    np.minimum.at(reach, triangles, SAME * longest[:, None])
    place, reach = points[every], reach[every]
    near = np.flatnonzero(cKDTree(place).query(place, k=2)[0][:, 1] < reach)
    pairs = near[cKDTree(place[near]).query_pairs(reach[near].max(initial=0.0), output_type="ndarray")]
    pairs = pairs[np.linalg.norm(np.diff(place[pairs], axis=1)[:, 0], axis=1) < reach[pairs].min(axis=1)]
    _, first, label = np.unique(components(pairs, len(every))[1], return_index=True, return_inverse=True)
    one = first[label]  # of a triangle, if any of those that are the same is
    kept, number = np.unique(one[: len(own)]), np.full(len(points), -1)
    number[every] = np.where(one < len(own), np.searchsorted(kept, one), -1)
    gone, note = np.setdiff1d(np.arange(len(own)), kept), list[str]()
    if len(gone):
        x, y = place[gone[0]]
        note = [f"{len(gone)} nodes closer than {SAME:g} of a cell to another are joined with it, as at ({x:g}, {y:g})"]
    return place[kept], number, note


def _lengths(corners: Array) -> Array:
    """Lengths (m, 3) of the sides of triangles (m, 3, 2)."""
    return np.asarray(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2))


def _check_fit(mesh: Any) -> None:
    """InputError for cells that overlap, whose areas add up to more than their boundary encloses or whose boundary
    crosses itself, and for nodes of the boundary on a side of it, or nearly so, that they are no ends of."""
    points, rim = mesh.p.T - mesh.p.T[0], mesh.facets[:, mesh.boundary_facets()]
    corners, nodes, sides = points[mesh.t.T], np.unique(rim), shapely.linestrings(points[rim.T])
    area, lines = np.abs(signed_areas(corners)), shapely.union_all(sides)
    excess = abs(float(area.sum()) - shapely.build_area(lines).area) / float(area.sum())
    if excess > SAME:
        raise _overlap(corners, mesh.p.T[0])
    height = np.full(len(points), np.inf)
    np.minimum.at(height, mesh.t.T, (2.0 * area / _lengths(corners).max(axis=1))[:, None])
    near, side = shapely.STRtree(sides).query(shapely.points(points[nodes]), "dwithin", NEAR * height[nodes])
    node, ends = nodes[near], rim[:, side]
    off = shapely.distance(shapely.points(points[node]), sides[side])
    wrong = np.flatnonzero((ends != node).all(axis=0) & (off <= NEAR * height[ends].min(axis=0)))
    if len(wrong):
        x, y = mesh.p[:, node[wrong[0]]]
        raise InputError(
            f"the node ({x:.9g}, {y:.9g}) is {off[wrong[0]]:.3g} mm off the side of a cell that it is no corner of: "
            f"join them, or move them {NEAR:g} of a cell apart"
        )
    if excess > 1e-9 or len(np.unique(shapely.get_coordinates(lines), axis=0)) > len(nodes):
        raise _overlap(corners, mesh.p.T[0])


def _overlap(corners: Array, origin: Array) -> InputError:
    """What is wrong with triangles (m, 3, 2) that overlap: where most, and their areas."""
    cells = shapely.polygons(corners)
    one, two = shapely.STRtree(cells).query(cells, "intersects")
    one, two = one[one < two], two[one < two]
    common = shapely.intersection(cells[one], cells[two])
    area = shapely.area(common)
    x, y = shapely.get_coordinates(shapely.point_on_surface(common[area.argmax()]))[0] + origin
    twice = cells[np.union1d(one[area > 0.0], two[area > 0.0])]
    total = float(shapely.area(cells).sum())
    covered = total - float(shapely.area(twice).sum()) + shapely.union_all(twice).area
    return InputError(
        f"cells overlap, as at ({x:g}, {y:g}): their areas add up to {total:.6g} mm2, and they cover {covered:.6g}: "
        "remove what is there twice"
    )


def _named_lines(data: Any, mesh: Any, number: Index) -> tuple[dict[str, np.ndarray], list[str]]:
    """Node pairs (k, 2) in `mesh` of the named groups of lines in a file, and notes on those without lines.

    number (p,): nodes of `mesh` by points of the file, -1 for none. InputError for a group of which only a part lies on
    sides of cells.
    """
    found, notes = dict[str, list[Index]](), list[str]()
    for name, members in data.cell_sets.items():
        found[name] = [block.data[own, :2] for block, own in zip(data.cells, members, strict=False) if block.dim == 1]
        if not any(len(own) for own in members):
            notes.append(f"the group {name!r} has no lines in the file: save it without SaveAll, or as version 4.1")
    for block, tags in zip(data.cells, data.cell_data.get("gmsh:physical", ()), strict=False):  # of MSH made VTU
        for tag in np.unique(tags[tags != 0]).tolist() if block.dim == 1 else ():
            found.setdefault(str(tag), []).append(block.data[tags == tag, :2])
    lines = {}
    for name, parts in found.items():
        own = np.unique(np.sort(number[np.concatenate([*parts, np.zeros((0, 2), np.int64)])], axis=1), axis=0)
        on_sides = len(facets_between(mesh, own[own[:, 0] >= 0]))
        if 0 < on_sides < len(own):
            raise InputError(f"group {name!r}: only {on_sides} of its {len(own)} lines are sides of cells")
        if on_sides:
            lines[name] = own
    return lines, notes
