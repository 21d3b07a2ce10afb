"""Meshes of curtains: rectangles in rows, any outline with holes by Delaunay's rule on a lattice of the weave, files.

A mesh comes with its named boundary edges: "top", "bottom", "left", "right" of a rectangle, otherwise "outline" and
"hole 1", "hole 2", ...; "top" and "bottom" of any shape are the straight boundary pieces at its extreme heights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import skfem
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from homogenize.law import Array, CellInfo, InputError
from macro_fem.mesh_files import read_mesh_file
from macro_fem.outline import distance_to_polygon, mesh_outline, regular_polygon
from macro_fem.scene import MOST_MM, Curtain, Mesh, Scene
from rve.values import shown

MAX_TRIANGLES = 4_000_000
"""More cells than this are refused before their arrays are made: some four million unknowns, 20 GB in a solver."""
MAX_NEAR = 10_000_000
"""Pairs of a side on the boundary and a corner in the circle over it, in a mesh file; usually a few per side."""


@dataclass(frozen=True, eq=False)
class CurtainMesh:
    """A scikit-fem mesh `mesh` and its named edges: facet numbers per name. `pattern` says how the cells lie."""

    mesh: Any
    pattern: str
    edges: dict[str, np.ndarray] = field(repr=False)

    @property
    def height(self) -> float:
        """Extent along y, mm."""
        return float(np.ptp(self.mesh.p[1]))

    @property
    def size(self) -> float:
        """Diagonal of the bounding box, mm."""
        return float(np.hypot(*np.ptp(self.mesh.p, axis=1)))


def build_mesh(scene: Scene, cell: CellInfo | None) -> CurtainMesh:
    """The mesh a scene asks for; InputError if its outline or mesh file cannot be meshed."""
    curtain = scene.curtain
    if curtain.shape == "file":
        return read_mesh(curtain, scene.source)
    aspect = weave_aspect(cell)
    _refuse_too_many(scene, aspect)
    if curtain.shape == "rectangle" and not curtain.holes:
        return rectangle(curtain, scene.mesh, aspect)
    if curtain.shape == "disk":
        assert curtain.radius is not None
        sides = max(8, math.ceil(math.pi * scene.mesh.cells))
        outline = regular_polygon(curtain.radius, sides)
    elif curtain.shape == "rectangle":
        assert curtain.width is not None
        assert curtain.height is not None
        W, H = curtain.width, curtain.height
        outline = np.array([[0.0, 0.0], [W, 0.0], [W, H], [0.0, H]])
    else:
        outline = np.array(curtain.outline)
    holes = [np.array(hole) for hole in curtain.holes]
    try:
        points, cells = mesh_outline(outline, holes, scene.mesh.cells, aspect, math.radians(curtain.hang))
    except ValueError as error:
        raise InputError(f"{scene.source}: [curtain] {error}") from error
    mesh = skfem.MeshTri(points.T.copy(), cells.T.copy())
    return CurtainMesh(mesh, "aligned", named_edges(mesh, holes, is_box=curtain.shape == "rectangle"))


def _refuse_too_many(scene: Scene, aspect: float) -> None:
    """InputError if the box around the shape is a thread, or would hold more than `MAX_TRIANGLES` cells."""
    curtain, cells = scene.curtain, scene.mesh.cells
    if curtain.shape == "rectangle":
        assert curtain.width is not None
        assert curtain.height is not None
        slender = curtain.height / curtain.width
    elif curtain.shape == "outline":
        width, height = np.ptp(np.array(curtain.outline), axis=0)
        slender = float(height / width) if width > 0.0 else 0.0  # no width: refused as an outline without area
    else:
        slender = 1.0
    if 0.0 < slender < 1e-6:
        raise InputError(
            f"{scene.source}: [curtain] is {slender:.3g} times as high as wide: check the units of its sides"
        )
    least_row = min(1.0, aspect, 1.0 / aspect)
    count = 4.0 * cells * max(1.0, cells * slender / least_row)
    if count > MAX_TRIANGLES:
        raise InputError(
            f"{scene.source}: [mesh] cells = {cells}: makes up to {count:.3g} triangles on a curtain {slender:.3g} "
            f"times as high as wide, at most {MAX_TRIANGLES:.3g} are allowed; use fewer cells or check its units"
        )


def weave_aspect(cell: CellInfo | None) -> float:
    """b_y / b_x: the slope of the diagonal families; 1 for a law without rings."""
    return 1.0 if cell is None else cell.b_y_mm / cell.b_x_mm


def rectangle(curtain: Curtain, spec: Mesh, aspect: float) -> CurtainMesh:
    """Rows of equal rectangles, each cut into four ("aligned", "crossed") or two ("diagonal") triangles.

    The rectangles of "aligned" have the sides of the weave's cell, so that their diagonals follow both families; what
    is left of the height makes one lower row at the bottom. Off the axes of the weave no such rectangle exists and
    "aligned" becomes "crossed".
    """
    assert curtain.width is not None
    assert curtain.height is not None
    W, H, n = curtain.width, curtain.height, spec.cells
    quarter_turns = curtain.hang / 90.0
    is_aligned = spec.pattern == "aligned" and quarter_turns == round(quarter_turns)
    pattern = "crossed" if spec.pattern == "aligned" and not is_aligned else spec.pattern
    if is_aligned:
        ratio = aspect if round(quarter_turns) % 2 == 0 else 1.0 / aspect
        y = _rows(H, ratio * W / n)
    else:
        y = np.linspace(0.0, H, max(1, round(n * H / W)) + 1)
    x = np.linspace(0.0, W, n + 1)
    quads = skfem.MeshQuad.init_tensor(x, y)
    if spec.element in ("Q1", "Q2"):
        mesh: Any = quads
    elif pattern == "diagonal":
        mesh = skfem.MeshTri.init_tensor(x, y)
    else:
        mesh = cut_in_four(quads)
    return CurtainMesh(mesh, pattern, named_edges(mesh, [], is_box=True))


def _rows(height: float, row: float) -> Array:
    """Heights of rows of `row` mm from the top down, ascending; the lowest takes what is left, at least half a row."""
    n = math.floor(height / row + 1e-9)
    left = height - n * row
    if n > 0 and left < 0.5 * row:
        n, left = n - 1, left + row
    lower = [0.0] if left > 1e-9 * height else []
    return np.concatenate([lower, height - row * np.arange(n, -1, -1.0)])


def cut_in_four(quads: skfem.MeshQuad) -> skfem.MeshTri:
    """Each quadrilateral cut along both diagonals."""
    centre = quads.p[:, quads.t].mean(axis=1)
    new = quads.p.shape[1] + np.arange(quads.t.shape[1])
    cells = [np.vstack([quads.t[i], quads.t[(i + 1) % 4], new]) for i in range(4)]
    return skfem.MeshTri(np.hstack([quads.p, centre]), np.hstack(cells))


def refine(mesh: CurtainMesh, cells: np.ndarray, scene: Scene) -> CurtainMesh:
    """The mesh with the given triangles cut in four and their neighbours as needed to fit (red, green, blue)."""
    finer = mesh.mesh.refined(np.asarray(cells))
    if not isinstance(finer, skfem.MeshTri1):
        raise InputError(f"{scene.source}: [solver] adapt: needs triangles")
    holes = [np.array(hole) for hole in scene.curtain.holes]
    is_box = scene.curtain.shape in ("rectangle", "file")
    return CurtainMesh(finer, mesh.pattern, named_edges(finer, holes, is_box=is_box))


def named_edges(mesh: Any, holes: list[Array], *, is_box: bool) -> dict[str, np.ndarray]:
    """Boundary facets by name; see the module header."""
    boundary = mesh.boundary_facets()
    ends = mesh.p[:, mesh.facets[:, boundary]]
    tiny = 1e-9 * float(np.ptp(mesh.p, axis=1).max())
    low, high = mesh.p.min(axis=1), mesh.p.max(axis=1)
    edges = {
        "top": boundary[np.all(np.abs(ends[1] - high[1]) < tiny, axis=0)],
        "bottom": boundary[np.all(np.abs(ends[1] - low[1]) < tiny, axis=0)],
    }
    if is_box:
        edges["left"] = boundary[np.all(np.abs(ends[0] - low[0]) < tiny, axis=0)]
        edges["right"] = boundary[np.all(np.abs(ends[0] - high[0]) < tiny, axis=0)]
    middle = ends.mean(axis=1).T
    in_hole = np.zeros(len(boundary), bool)
    for number, hole in enumerate(holes, start=1):
        near = distance_to_polygon(middle, hole) < 1e3 * tiny
        edges[f"hole {number}"] = boundary[near]
        in_hole |= near
    edges["outline"] = boundary[~in_hole]
    return {name: facets for name, facets in edges.items() if len(facets)}


def read_mesh(curtain: Curtain, source: Path) -> CurtainMesh:
    """The plane mesh in a file; InputError for cells that are inverted, doubled, flat or not plane."""
    where = f"{source}: [curtain] file = {shown(curtain.file)}:"
    try:
        data = read_mesh_file(source.parent / str(curtain.file))
    except InputError as error:
        raise InputError(f"{where} {error}") from error
    kinds = [kind for kind in ("triangle", "quad") if len(data.cells_dict.get(kind, ()))]
    if len(kinds) != 1:
        raise InputError(f"{where} needs cells of one kind, triangle or quad, it has {sorted(data.cells_dict)}")
    cells = np.asarray(data.cells_dict[kinds[0]], dtype=np.int64)
    used, cells = np.unique(cells, return_inverse=True)
    cells = cells.reshape(-1, 3 if kinds[0] == "triangle" else 4)
    points = _plane_points(data.points[used], where)
    _check_cells(points, cells, where)
    mesh_type = skfem.MeshTri if kinds[0] == "triangle" else skfem.MeshQuad
    mesh = mesh_type(points.T.copy(), cells.T.copy())
    _check_sides(mesh, where)
    return CurtainMesh(mesh, "file", named_edges(mesh, [], is_box=True))


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
        on = np.abs(along[0] * off[:, 1] - along[1] * off[:, 0]) < 1e-9 * length[side]
        if on.any():
            x, y = corners[numbers][on][0]
            raise InputError(f"{where} the point ({x:g}, {y:g}) lies on the side of a cell that it is no corner of")


def _plane_points(points: Array, where: str) -> Array:
    if not np.all(np.isfinite(points)):
        raise InputError(f"{where} point {int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])} is not finite")
    if np.abs(points).max() > MOST_MM:
        raise InputError(f"{where} a coordinate is {np.abs(points).max():g} mm, at most {MOST_MM:g} are allowed")
    if points.shape[1] == 3 and np.ptp(points[:, 2]) > 1e-9 * np.ptp(points, axis=0).max():
        raise InputError(f"{where} is not plane, z runs from {points[:, 2].min():g} to {points[:, 2].max():g}")
    return np.ascontiguousarray(points[:, :2], dtype=float)


def _check_cells(points: Array, cells: np.ndarray, where: str) -> None:
    area = signed_areas(points, cells)
    area *= 1.0 if np.count_nonzero(area > 0.0) >= np.count_nonzero(area < 0.0) else -1.0  # either sense, but one
    scale = np.abs(area).max()
    for bad, what in (
        (area < -1e-12 * scale, "is inverted against most others"),
        (np.abs(area) <= 1e-12 * scale, "has no area"),
        (_least_corner(points, cells) <= 0.0, "is not convex"),
    ):
        if bad.any():
            raise InputError(f"{where} cell {int(np.flatnonzero(bad)[0])} {what} ({int(bad.sum())} such cells)")
    _, first, counts = np.unique(np.sort(cells, axis=1), axis=0, return_index=True, return_counts=True)
    if counts.max() > 1:
        raise InputError(f"{where} cell {int(first[counts > 1][0])} is there {int(counts.max())} times")


def _least_corner(points: Array, cells: np.ndarray) -> Array:
    """The smallest area (n_cells,) that two neighbouring sides span: not positive where a corner points inwards."""
    p = points[cells]
    side = np.roll(p, -1, axis=1) - p
    before = np.roll(side, 1, axis=1)
    turn = before[..., 0] * side[..., 1] - before[..., 1] * side[..., 0]
    return np.asarray((turn * np.sign(signed_areas(points, cells))[:, None]).min(axis=1))


def signed_areas(points: Array, cells: np.ndarray) -> Array:
    """Areas (n_cells,) of polygons given by their corners in order, positive if counterclockwise."""
    x, y = points[cells, 0], points[cells, 1]
    return 0.5 * (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1)


def components(cells: np.ndarray, n_nodes: int) -> tuple[int, np.ndarray]:
    """How many connected pieces the cells (n_cells, n_local) form, and the piece of each node (n_nodes,)."""
    row = np.repeat(cells[:, 0], cells.shape[1])
    graph = coo_matrix((np.ones(len(row)), (row, cells.ravel())), shape=(n_nodes, n_nodes))
    number, label = connected_components(graph, directed=False)
    return int(number), label
