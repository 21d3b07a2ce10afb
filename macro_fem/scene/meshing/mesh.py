"""Meshes of curtains: rectangles in rows, any outline with holes by Delaunay's rule on a lattice of the weave, files,
each with its named edges (`edges`) and nodes at hooks, held and loaded points (`places`).
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import shapely
import skfem
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay

from macro_fem.fem.cells import counterclockwise, signed_areas
from macro_fem.scene.meshing.edges import inherited_edges, named_edges, paths
from macro_fem.scene.meshing.mesh_files import MAX_TRIANGLES
from macro_fem.scene.meshing.nodes import with_nodes_at
from macro_fem.scene.meshing.sheet_mesh import read_mesh
from macro_fem.scene.scene import Scene
from macro_fem.scene.shapes import MeshFile, Rectangle
from macro_fem.scene.sites import Hanging
from macro_fem.scene.tables import PatchLoad, Vector
from rve.common import Array, InputError, shown
from rve.common.typed import did_you_mean
from rve.geometry import CellInfo

MAX_LATTICE = 8_000_000
"""Lattice points in the box, turned with the weave, around the outline: 0.5 GB while they are chosen from."""
TIES = 1e-6
"""By how much of their distance from the middle points of square cells move before Delaunay's rule, which leaves their
diagonals open: mirror images get one answer, on every processor."""
CLEARANCE = 0.55
"""Least distance of a lattice point to the boundary in units of the spacing: keeps boundary triangles from slivers."""


@dataclass(frozen=True, eq=False)
class HookRow:
    """The hooks of one support: their nodes (k,), the longest line of the edge and the longest pitch, mm."""

    nodes: np.ndarray
    length: float
    pitch: float


@dataclass(frozen=True, eq=False)
class CurtainMesh:
    """A scikit-fem mesh `mesh` and its named edges: facet numbers per name. `pattern` says how the cells lie.

    `hooks`: the hooks of each support that has some, by its number in the scene. `notes`: what was mended in its file.
    """

    mesh: Any
    pattern: str
    edges: dict[str, np.ndarray] = field(repr=False)
    hooks: dict[int, HookRow] = field(default_factory=dict, repr=False)
    notes: tuple[str, ...] = ()

    @property
    def height(self) -> float:
        """Extent along y, mm."""
        return float(np.ptp(self.mesh.p[1]))

    @property
    def size(self) -> float:
        """Diagonal of the bounding box, mm."""
        return float(np.hypot(*np.ptp(self.mesh.p, axis=1)))

    @property
    def sides(self) -> Array:
        """Every facet from its first to its second end (n_facets, 2), mm."""
        first, second = self.mesh.p.T[self.mesh.facets]
        return np.asarray(second - first)

    @property
    def longest_side(self) -> float:
        """Length of the longest side of a cell, mm."""
        return float(np.hypot(*self.sides.T).max())


def build_mesh(scene: Scene, cell: CellInfo | None) -> CurtainMesh:
    """The mesh a scene asks for, with nodes where it holds and loads points.

    InputError if its outline or mesh file cannot be meshed, an edge is missing, or a point lies off it or would need a
    flat cell.
    """
    mesh = _plain_mesh(scene, cell)
    for item in scene.items:
        edge = getattr(item, "edge", item.edge_needed)
        if edge is not None and edge not in mesh.edges:
            known = "; ".join([", ".join(sorted(mesh.edges)), *mesh.notes])
            near = f"; {did_you_mean(edge, mesh.edges)}".rstrip("; ")
            scene.refuse(f"{item.where} needs edge = {shown(edge)}: the curtain has no such edge, only {known}{near}")
    hooked = [(n, item) for n, item in enumerate(scene.support) if isinstance(item, Hanging) and item.has_hooks]
    top = paths(mesh.mesh.facets[:, mesh.edges["top"]].T, mesh.mesh.p.T) if hooked else []
    rows = {number: item.hook_places(top, f"{scene.source}: {item.where}") for number, item in hooked}
    wanted: list[tuple[str, Vector]]
    wanted = [(f"[support] hook at [{x:g}, {y:g}]", (x, y)) for places, _ in rows.values() for x, y in places.tolist()]
    points: list[Any] = [item for item in scene.items if hasattr(item, "at") and not isinstance(item, PatchLoad)]
    points += [patch for patch in scene.of(PatchLoad) if patch.radius < mesh.longest_side]
    wanted += [(f"{one.where} at = {list(one.at)}", one.at) for one in points]
    if not wanted:
        return mesh
    wheres = [f"{scene.source}: {what}" for what, _ in wanted]
    cut, edges, nodes = with_nodes_at(mesh.mesh, mesh.edges, np.array([at for _, at in wanted]), wheres)
    own = np.split(nodes, np.cumsum([len(places) for places, _ in rows.values()]))
    hooks = {n: HookRow(hung, *fit) for (n, (_, fit)), hung in zip(rows.items(), own[:-1], strict=True)}
    return replace(mesh, mesh=cut, edges=edges, hooks=hooks)


def _plain_mesh(scene: Scene, cell: CellInfo | None) -> CurtainMesh:
    """The mesh of the curtain's shape before nodes are added for points."""
    curtain = scene.curtain
    if isinstance(curtain, MeshFile):
        mesh, edges, notes = read_mesh(curtain, scene.source)
        width, height = np.ptp(mesh.p, axis=1).tolist()
        if cell is not None and min(width, height) < 2.0 * cell.r1_mm:
            scene.refuse(
                f"[curtain] file = {curtain.file!r}: its extents of {width:g} and {height:g} mm are less than a ring, "
                f"{2.0 * cell.r1_mm:g} mm; were metres meant? Scale the mesh by 1000"
            )
        return CurtainMesh(mesh, "file", edges, notes=notes)
    aspect = 1.0 if cell is None else cell.b_y_mm / cell.b_x_mm  # slope of the diagonal families
    outline = curtain.corners(scene.mesh.cells)
    _refuse_too_many(scene, outline, aspect)
    if isinstance(curtain, Rectangle) and not curtain.holes:
        return rectangle(scene, aspect)
    holes = [np.array(hole) for hole in curtain.holes]
    try:
        points, cells = mesh_outline(outline, holes, columns(scene), aspect, math.radians(curtain.weave_angle))
    except ValueError as error:
        raise InputError(f"{scene.source}: [curtain] {error}") from error
    mesh = skfem.MeshTri(points.T.copy(), cells.T.copy())
    return CurtainMesh(mesh, "aligned", named_edges(mesh, holes, {}), notes=scene.notes)


def _refuse_too_many(scene: Scene, outline: Array, aspect: float) -> None:
    """InputError if the box around the shape is too slender, or would hold more than `MAX_TRIANGLES` cells."""
    cells = scene.mesh.cells
    width, height = np.ptp(outline, axis=0)
    slender = float(height / width) if width > 0.0 else 0.0  # no width: refused as an outline without area
    if 0.0 < slender < 1e-6:
        scene.refuse(f"[curtain] is {slender:.3g} times as high as wide: check the units of its sides")
    least_row = min(1.0, aspect, 1.0 / aspect)
    count = 4.0 * cells * max(1.0, cells * slender / least_row)
    if count > MAX_TRIANGLES:
        scene.refuse(
            f"[mesh] cells = {cells}: makes up to {count:.3g} triangles on a curtain {slender:.3g} times as high as "
            f"wide, at most {MAX_TRIANGLES:.3g} are allowed; use fewer cells or check its units"
        )


def columns(scene: Scene) -> int:
    """The number of columns of a rectangle nearest to `cells` at which every hook has a node; else `cells`."""
    curtain, cells = scene.curtain, scene.mesh.cells
    if not isinstance(curtain, Rectangle):
        return cells
    between = [item.spaces(curtain.width) for item in scene.of(Hanging) if item.has_hooks]
    step = math.lcm(*(number for number in between if 1 <= number <= cells))
    return step * max(1, round(cells / step)) if step <= cells else cells


def rectangle(scene: Scene, aspect: float) -> CurtainMesh:
    """Rows of equal rectangles, each cut into four ("aligned", "crossed") or two ("diagonal") triangles.

    Those of "aligned" have the sides of the weave's cell, so that their diagonals follow both families, and one lower
    row at the bottom; off the axes of the weave "aligned" becomes "crossed".
    """
    curtain, spec = scene.curtain, scene.mesh
    assert isinstance(curtain, Rectangle)
    W, H, n = curtain.width, curtain.height, columns(scene)
    turns = curtain.weave_angle / 90.0
    pattern = "crossed" if spec.pattern == "aligned" and turns != round(turns) else spec.pattern
    if pattern == "aligned":
        y = _rows(H, (aspect if round(turns) % 2 == 0 else 1.0 / aspect) * W / n)
    else:
        y = np.linspace(0.0, H, max(1, round(n * H / W)) + 1)
    x = np.linspace(0.0, W, n + 1)
    is_diagonal = pattern == "diagonal"
    mesh = skfem.MeshTri.init_tensor(x, y) if is_diagonal else skfem.MeshQuad.init_tensor(x, y).to_meshtri(style="x")
    return CurtainMesh(mesh, pattern, named_edges(mesh, [], {}))


def _rows(height: float, row: float) -> Array:
    """Heights of rows of `row` mm from the top down, ascending; the lowest takes what is left, at least half a row."""
    n = math.floor(height / row + 1e-9)
    left = height - n * row
    if n > 0 and left < 0.5 * row:
        n, left = n - 1, left + row
    lower = [0.0] if left > 1e-9 * height else []
    return np.concatenate([lower, height - row * np.arange(n, -1, -1.0)])


def mesh_outline(
    outline: Array, holes: list[Array], cells: int, aspect: float, angle: float
) -> tuple[Array, np.ndarray]:
    """Points (n, 2) and counterclockwise triangles (m, 3) of the region inside `outline` and outside `holes`.

    The width is divided into `cells`; inner edges follow both diagonal families of a weave with cell sides in the ratio
    `aspect` whose y axis is turned by `angle` (radians). ValueError if the polygons touch, cross or leave no region,
    or are finer than the cells.
    """
    _check_region(outline, holes)
    middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))  # far from the origin digits cancel
    outline, holes = outline - middle, [hole - middle for hole in holes]
    region, spacing = shapely.Polygon(outline, holes), float(np.ptp(outline[:, 0])) / cells
    rings = shapely.segmentize([shapely.LinearRing(one) for one in (outline, *holes)], spacing * (1.0 + 1e-9))
    border = [shapely.get_coordinates(one)[:-1] for one in rings]  # corners and points no farther than `spacing` apart
    inner = _lattice(outline, spacing, aspect, angle)
    sides = region.boundary
    shapely.prepare([region, sides])
    inner = inner[shapely.contains_xy(region, inner)]
    inner = inner[~shapely.dwithin(sides, shapely.points(inner), CLEARANCE * spacing)]
    points = np.concatenate([*border, inner])
    tied = TIES * points * ((points / np.abs(points).max()) ** 2 @ [[1.0], [2.0]]) if aspect == 1.0 else 0.0
    triangles = Delaunay(points + tied).simplices
    triangles = triangles[shapely.contains_xy(region, points[triangles].mean(axis=1))]
    triangles = counterclockwise(points, triangles)
    triangles = triangles[np.abs(signed_areas(points[triangles])) > 0.5e-6 * spacing**2]
    _check_border(triangles, [len(part) for part in border])
    used, triangles = np.unique(triangles, return_inverse=True)
    return points[used] + middle, triangles.reshape(-1, 3)


def _lattice(outline: Array, spacing: float, aspect: float, angle: float) -> Array:
    """Corners and centres of rectangles spacing x aspect spacing, turned by `angle`, that cover an outline around 0."""
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    reach = np.abs(outline @ turn).max(axis=0) + spacing * (1.0 + aspect)
    n, m = math.ceil(reach[0] / spacing), math.ceil(reach[1] / (spacing * aspect))
    if 8 * n * m > MAX_LATTICE:
        raise ValueError(
            f"outline: the lattice of the weave around it has {8 * n * m:.3g} points, at most {MAX_LATTICE:.3g} are "
            "allowed; use fewer cells, or a shape that is less slender across the weave"
        )
    i, j = np.meshgrid(np.arange(-n, n + 1.0), np.arange(-m, m + 1.0), indexing="ij")
    corners = np.stack([i.ravel(), j.ravel()], axis=-1)
    local = np.concatenate([corners, corners + 0.5]) * spacing * np.array([1.0, aspect])
    return local @ turn.T


def _check_region(outline: Array, holes: list[Array]) -> None:
    """ValueError for an outline and holes that bound no region."""
    for polygon in (outline, *holes):
        if (polygon == np.roll(polygon, -1, axis=0)).all(axis=1).any():
            raise ValueError("outline and holes: have two equal corners in a row")
    region = shapely.Polygon(outline, holes)
    if not region.is_valid:
        raise ValueError(f"the outline and its holes bound no region: {shapely.is_valid_reason(region)}, mm")
    if region.area <= 1e-9 * float(np.ptp(outline, axis=0).max()) ** 2:
        raise ValueError("outline: has no area, its corners lie on a line")


def _check_border(triangles: np.ndarray, lengths: list[int]) -> None:
    """Every piece of the border is an edge of the mesh: else corners are closer together than the cells."""
    edges = set(map(frozenset, np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)]).tolist()))
    for number in np.split(np.arange(sum(lengths)), np.cumsum(lengths)[:-1]):
        if not edges.issuperset(map(frozenset, zip(number.tolist(), np.roll(number, -1).tolist(), strict=True))):
            raise ValueError("outline and holes: come closer to each other than the cells are wide; use more cells")


def refine(mesh: CurtainMesh, cells: np.ndarray) -> CurtainMesh:
    """The mesh with the given triangles cut in four and their neighbours as needed to fit (red, green, blue)."""
    finer = mesh.mesh.refined(np.asarray(cells))
    return replace(mesh, mesh=finer, edges=inherited_edges(mesh.mesh, finer, mesh.edges))


def components(cells: np.ndarray, n_nodes: int) -> tuple[int, np.ndarray]:
    """How many connected pieces the cells (n_cells, n_local) form, and the piece of each node (n_nodes,)."""
    row = np.repeat(cells[:, 0], cells.shape[1])
    graph = coo_matrix((np.ones(len(row)), (row, cells.ravel())), shape=(n_nodes, n_nodes))
    number, label = connected_components(graph, directed=False)
    return int(number), label
