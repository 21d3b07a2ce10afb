"""Meshes of curtains: rectangles in rows, any outline with holes by Delaunay's rule on a lattice of the weave, files.

A mesh comes with its named edges, see `edges`, and has nodes at hooks, at held and loaded points, and
at the centres of patches that are smaller than its cells, see `places`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import skfem
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from homogenize import CellInfo
from macro_fem.scene.meshing.edges import facets_between, inherited_edges, named_edges
from macro_fem.scene.meshing.mesh_files import read_mesh_file
from macro_fem.scene.meshing.outline import mesh_outline, regular_polygon
from macro_fem.scene.meshing.places import SAME, counterclockwise, hook_places, make_sheet, through, with_nodes_at
from macro_fem.scene.schema import Scene
from macro_fem.scene.tables import MOST_MM, Curtain, Hooks, Point, PointLoad, Track
from rve.common.errors import InputError
from rve.common.storage.vtu import DISPLACEMENT, OLD_REFERENCE
from rve.common.types import Array
from rve.common.values import shown

MAX_TRIANGLES = 4_000_000
"""More cells than this are refused before their arrays are made: some four million unknowns, 20 GB in a solver."""
MAX_NEAR = 10_000_000
"""Pairs of a side on the boundary and a corner in the circle over it, in a mesh file; usually a few per side."""


@dataclass(frozen=True, eq=False)
class CurtainMesh:
    """A scikit-fem mesh `mesh` and its named edges: facet numbers per name. `pattern` says how the cells lie.

    `hooks`: reference positions (k, 2) of the hooks of each support that has some, by its number in the scene.
    """

    mesh: Any
    pattern: str
    edges: dict[str, np.ndarray] = field(repr=False)
    hooks: dict[int, Array] = field(default_factory=dict, repr=False)

    def edge(self, name: str, where: str) -> np.ndarray:
        """Facet numbers of a named edge; InputError, which begins with `where`, if there is no such edge."""
        if name not in self.edges:
            raise InputError(f"{where} = {name!r}: the curtain has no such edge, only {', '.join(sorted(self.edges))}")
        return self.edges[name]

    @property
    def height(self) -> float:
        """Extent along y, mm."""
        return float(np.ptp(self.mesh.p[1]))

    @property
    def size(self) -> float:
        """Diagonal of the bounding box, mm."""
        return float(np.hypot(*np.ptp(self.mesh.p, axis=1)))

    @property
    def longest_side(self) -> float:
        """Length of the longest side of a cell, mm."""
        return float(np.linalg.norm(np.diff(self.mesh.p[:, self.mesh.facets], axis=1), axis=0).max())


def build_mesh(scene: Scene, cell: CellInfo | None) -> CurtainMesh:
    """The mesh a scene asks for, with nodes where it holds and loads points.

    InputError if its outline or mesh file cannot be meshed, or a point lies off it or would need a flat cell.
    """
    mesh = _plain_mesh(scene, cell)
    mesh = replace(mesh, hooks=_hooks(scene, mesh))
    places, wheres = _wanted(scene, mesh)
    if not len(places) or cKDTree(mesh.mesh.p.T).query(places)[0].max() <= SAME * mesh.size:
        return mesh
    lines = {name: mesh.mesh.facets[:, facets].T for name, facets in mesh.edges.items()}
    sheet = with_nodes_at(make_sheet(mesh.mesh.p.T, mesh.mesh.t.T, lines), places, wheres)
    cut = type(mesh.mesh)(sheet.points.T.copy(), sheet.cells.T.copy())
    return replace(mesh, mesh=cut, edges={name: facets_between(cut, pairs) for name, pairs in sheet.lines.items()})


def _hooks(scene: Scene, mesh: CurtainMesh) -> dict[int, Array]:
    """Places (k, 2) of the hooks of each support that has some, by its number; none where there is no top edge."""
    if "top" not in mesh.edges:
        return {}
    pairs = mesh.mesh.facets[:, mesh.edges["top"]].T
    return {
        number: hook_places(mesh.mesh.p.T, pairs, item.pitch, f"{scene.source}: [support]")
        for number, item in enumerate(scene.support)
        if isinstance(item, Hooks | Track) and item.pitch is not None
    }


def _wanted(scene: Scene, mesh: CurtainMesh) -> tuple[Array, list[str]]:
    """Where nodes are needed (k, 2), and how each place is named in messages (k,)."""
    hooks = [(f"[support] hook at [{x:g}, {y:g}]", (x, y)) for places in mesh.hooks.values() for x, y in places]
    longest = mesh.longest_side
    points = [("[support] (point)", item.at) for item in scene.support if isinstance(item, Point)]
    points += [("[load.point]", point.at) for point in scene.load.point]
    points += [("[load.patch]", patch.at) for patch in scene.load.patch if patch.radius < longest]
    named = hooks + [(f"{what} at = {list(at)}", at) for what, at in points]
    return np.array([at for _, at in named]).reshape(-1, 2), [f"{scene.source}: {what}" for what, _ in named]


def _plain_mesh(scene: Scene, cell: CellInfo | None) -> CurtainMesh:
    """The mesh of the curtain's shape before nodes are added for points."""
    curtain = scene.curtain
    if curtain.shape == "file":
        return read_mesh(curtain, scene.source)
    aspect = weave_aspect(cell)
    _refuse_too_many(scene, aspect)
    if curtain.shape == "rectangle" and not curtain.holes:
        return rectangle(scene, aspect)
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
        points, cells = mesh_outline(outline, holes, columns(scene), aspect, math.radians(curtain.weave_angle))
    except ValueError as error:
        raise InputError(f"{scene.source}: [curtain] {error}") from error
    mesh = skfem.MeshTri(points.T.copy(), cells.T.copy())
    return CurtainMesh(mesh, "aligned", named_edges(mesh, holes, {}))


def _refuse_too_many(scene: Scene, aspect: float) -> None:
    """InputError if the box around the shape is too slender, or would hold more than `MAX_TRIANGLES` cells."""
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


def columns(scene: Scene) -> int:
    """The number of columns of a rectangle nearest to `cells` at which every hook has a node; else `cells`."""
    curtain, cells = scene.curtain, scene.mesh.cells
    if curtain.shape != "rectangle":
        return cells
    assert curtain.width is not None
    pitches = [item.pitch for item in scene.support if isinstance(item, Hooks | Track) and item.pitch is not None]
    between = [round(min(curtain.width / pitch, 1e9)) for pitch in pitches]
    step = math.lcm(*(number for number in between if 1 <= number <= cells))
    return step * max(1, round(cells / step)) if step <= cells else cells


def rectangle(scene: Scene, aspect: float) -> CurtainMesh:
    """Rows of equal rectangles, each cut into four ("aligned", "crossed") or two ("diagonal") triangles.

    The rectangles of "aligned" have the sides of the weave's cell, so that their diagonals follow both families; what
    is left of the height makes one lower row at the bottom. Off the axes of the weave no such rectangle exists and
    "aligned" becomes "crossed". Quadrilaterals cannot be cut, so that their grid lines pass through all points.
    """
    curtain, spec = scene.curtain, scene.mesh
    assert curtain.width is not None
    assert curtain.height is not None
    W, H, n = curtain.width, curtain.height, columns(scene)
    quarter_turns = curtain.weave_angle / 90.0
    is_aligned = spec.pattern == "aligned" and quarter_turns == round(quarter_turns)
    pattern = "crossed" if spec.pattern == "aligned" and not is_aligned else spec.pattern
    if is_aligned:
        ratio = aspect if round(quarter_turns) % 2 == 0 else 1.0 / aspect
        y = _rows(H, ratio * W / n)
    else:
        y = np.linspace(0.0, H, max(1, round(n * H / W)) + 1)
    x = np.linspace(0.0, W, n + 1)
    if spec.element in ("Q1", "Q2"):
        points = [item.at for item in (*scene.support, *scene.load.point) if isinstance(item, Point | PointLoad)]
        x, y = (through(lines, np.array([at[k] for at in points])) for k, lines in enumerate((x, y)))
    quads = skfem.MeshQuad.init_tensor(x, y)
    if spec.element in ("Q1", "Q2"):
        mesh: Any = quads
    elif pattern == "diagonal":
        mesh = skfem.MeshTri.init_tensor(x, y)
    else:
        mesh = cut_in_four(quads)
    return CurtainMesh(mesh, pattern, named_edges(mesh, [], {}))


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
    return replace(mesh, mesh=finer, edges=inherited_edges(mesh.mesh, finer, mesh.edges))


def read_mesh(curtain: Curtain, source: Path) -> CurtainMesh:
    """The plane mesh in a file, and its lines in physical groups as named edges.

    A curtain.vtu is read as its reference state. InputError for cells that are inverted, doubled, flat or not plane.
    """
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
    points = _plane_points(reference_points(data)[used], where)
    if DISPLACEMENT in data.point_data:  # older versions wrote the cells of curtain.vtu in either sense
        cells = counterclockwise(points, cells)
    _check_cells(points, cells, where)
    mesh_type = skfem.MeshTri if kinds[0] == "triangle" else skfem.MeshQuad
    mesh = mesh_type(points.T.copy(), cells.T.copy())
    _check_sides(mesh, where)
    lines = physical_lines(data, mesh, used, where)
    try:
        edges = named_edges(mesh, [], lines)
    except InputError as error:
        raise InputError(f"{where} {error}") from error
    return CurtainMesh(mesh, "file", edges)


def reference_points(data: Any) -> Array:
    """Points (n, 2 or 3) of a mesh without load: those of the file, but `reference_mm` of an old curtain.vtu."""
    old = data.point_data.get(OLD_REFERENCE)
    return np.asarray(data.points if old is None or np.shape(old) != data.points.shape else old, dtype=float)


def physical_lines(data: Any, mesh: Any, used: np.ndarray, where: str) -> dict[str, np.ndarray]:
    """Node pairs (k, 2) of the physical groups of lines in a Gmsh file, by name, or by number where they have none.

    `used` are the numbers in the file of the nodes of `mesh`. InputError for a group of which only a part lies on
    sides of cells.
    """
    names = {int(tag): str(name) for name, (tag, dim) in data.field_data.items() if dim == 1}
    tags = data.cell_data.get("gmsh:physical", [])
    found: dict[str, list[np.ndarray]] = {}
    for block, tag in zip(data.cells, tags, strict=False):
        for one in np.unique(tag) if block.type == "line" else ():
            found.setdefault(names.get(int(one), str(int(one))), []).append(block.data[tag == one])
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
    x, y = np.moveaxis(points[cells] - points[cells[:, :1]], 2, 0)  # from a corner: far from the origin digits cancel
    return 0.5 * (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1)


def components(cells: np.ndarray, n_nodes: int) -> tuple[int, np.ndarray]:
    """How many connected pieces the cells (n_cells, n_local) form, and the piece of each node (n_nodes,)."""
    row = np.repeat(cells[:, 0], cells.shape[1])
    graph = coo_matrix((np.ones(len(row)), (row, cells.ravel())), shape=(n_nodes, n_nodes))
    number, label = connected_components(graph, directed=False)
    return int(number), label
