"""The mesh of a scene: its outline is divided, supports and loads tell points of it, and the mesh gets nodes there.

Rectangles are meshed in rows, any outline with holes by Delaunay's rule on a lattice of the weave; files have meshes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import shapely
import skfem
from scipy.spatial import Delaunay, cKDTree

from macro_fem.fem.cells import counterclockwise, signed_areas
from macro_fem.fem.discretization import Discretization
from macro_fem.scene.meshing.edges import Border, border_of, facets_between, in_order, inherited_edges
from macro_fem.scene.meshing.mesh_files import MAX_TRIANGLES
from macro_fem.scene.meshing.nodes import with_nodes_at
from macro_fem.scene.meshing.sheet_mesh import read_mesh
from macro_fem.scene.scene import Scene
from macro_fem.scene.shapes import MeshFile, Rectangle
from macro_fem.scene.support_kinds import Hanging, Places, Support
from macro_fem.scene.tables import Item, PatchLoad, PointLoad
from rve.common import Array, InputError, shown
from rve.common.records import Index, floats
from rve.common.typed import did_you_mean
from rve.geometry import CellInfo

MAX_LATTICE = 8_000_000
"""Lattice points in the box, turned with the weave, around the outline: 0.5 GB while they are chosen from."""
TIES = 1e-6
"""By how much of their distance from the middle points of square cells move before Delaunay's rule, which leaves their
diagonals open: mirror images get one answer, on every processor."""


@dataclass(frozen=True, eq=False)
class CurtainMesh:
    """A scikit-fem mesh `mesh` and its named edges: facet numbers per name. `pattern` says how the cells lie.

    `places`: what each support of the scene holds, with nodes where it is single points. `notes`: what was mended in
    its file.
    """

    mesh: Any
    pattern: str
    edges: dict[str, Index] = field(repr=False)
    places: tuple[Places, ...] = field(default=(), repr=False)
    notes: tuple[str, ...] = ()

    @property
    def hooks(self) -> dict[int, Places]:
        """The hooks of each support that has some, by its number in the scene."""
        return {number: one for number, one in enumerate(self.places) if one.pitch}

    @cached_property
    def border(self) -> Border:
        """Its nodes, and the pairs of them on named edges."""
        return Border(self.mesh.p.T, {name: self.mesh.facets[:, facets].T for name, facets in self.edges.items()})

    @property
    def height(self) -> float:
        """Extent along y, mm."""
        return float(np.ptp(self.mesh.p[1]))

    @property
    def size(self) -> float:
        """Diagonal of the bounding box, mm."""
        return self.border.size

    @property
    def sides(self) -> Array:
        """Every facet from its first to its second end (n_facets, 2), mm."""
        first, second = self.mesh.p.T[self.mesh.facets]
        return np.asarray(second - first)

    @property
    def longest_side(self) -> float:
        """Length of the longest side of a cell, mm."""
        return float(np.hypot(*self.sides.T).max())


class DividedSheet(NamedTuple):
    """A sheet before it is meshed: its `border`, divided as the mesh will be, and how it is filled with cells.

    `fill` gives the mesh and its nodes (n,) at the points of the border. `pattern` and `notes`: as of the mesh.
    """

    border: Border
    fill: Callable[[], tuple[Any, Index]]
    pattern: str
    notes: tuple[str, ...]


def build_mesh(scene: Scene, cell: CellInfo | None) -> CurtainMesh:
    """The mesh a scene asks for, with nodes where it holds and loads points.

    InputError if its outline or mesh file cannot be meshed, an edge is missing, or a point lies off it or would need a
    flat cell.
    """
    sheet = divide(scene, cell)
    _check_edges(scene, sheet)
    with scene.in_errors():
        places = [_places_of(item, sheet) for item in scene.support]
    single = [number for number, one in enumerate(places) if not one.edge]
    single.sort(key=lambda number: not places[number].pitch)  # hooks first
    mesh, numbers = sheet.fill()
    plain = CurtainMesh(mesh, sheet.pattern, {})
    wanted = [(scene.support[number].where, at) for number in single for at in places[number].points.tolist()]
    wanted += [(one.where, [*one.at]) for one in scene.of(PointLoad)]
    wanted += [(one.where, [*one.at]) for one in scene.of(PatchLoad) if one.radius < plain.longest_side]
    lines = {name: numbers[pairs] for name, pairs in sheet.border.edges.items()}
    wheres = [f"{where} at {np.round(at, 9).tolist()}" for where, at in wanted]
    with scene.in_errors():
        mesh, lines, nodes = with_nodes_at(mesh, lines, np.array([at for _, at in wanted]).reshape(-1, 2), wheres)
    parts = np.split(nodes, np.cumsum([len(places[number].points) for number in single]))
    for number, part in zip(single, parts, strict=False):
        places[number] = places[number]._replace(nodes=part)
    edges = {name: facets_between(mesh, pairs) for name, pairs in lines.items()}
    return CurtainMesh(mesh, sheet.pattern, edges, tuple(places), sheet.notes)


def _check_edges(scene: Scene, sheet: DividedSheet) -> None:
    """InputError for an edge that the scene names and the sheet has not."""
    edges = sheet.border.edges
    for item in scene.items:
        edge = item.on_edge
        if edge is not None and edge not in edges:
            scene.refuse(_no_edge(item, edge, sheet))


def _no_edge(item: Item, edge: str, sheet: DividedSheet) -> str:
    """What is said of an edge that a sheet has not."""
    edges = sheet.border.edges
    known = "; ".join([", ".join(sorted(edges)), *sheet.notes])
    near = f"; {did_you_mean(edge, edges)}".rstrip("; ")
    return f"{item.where} needs edge = {shown(edge)}: the curtain has no such edge, only {known}{near}"


def _places_of(item: Support, sheet: DividedSheet) -> Places:
    """Where a support, which may be of a plugin, holds a sheet; InputError for what it says that is no place."""
    places = item.places(sheet.border)
    if not isinstance(places, Places):
        raise InputError(f"{item.where}: places returns {shown(places)}, not macro_fem.scene.Places(points)")
    points = floats(places.points, f"{item.where}: places: points")
    if places.edge and places.edge not in sheet.border.edges:
        raise InputError(_no_edge(item, places.edge, sheet))
    if not places.edge and (points.shape != (len(points), 2) or not len(points) or not np.isfinite(points).all()):
        raise InputError(f"{item.where}: places: points = {shown(points.tolist())}: are not finite and (k, 2)")
    return places._replace(points=points)


def edge_nodes(mesh: CurtainMesh, disc: Discretization, name: str) -> Index:
    """Node numbers on the named edge, ordered along it for straight ones."""
    nodes = np.unique(facet_nodes(mesh, disc, mesh.edges[name]))
    return nodes[in_order(disc.nodes[nodes])]


def facet_nodes(mesh: CurtainMesh, disc: Discretization, facets: Index) -> Index:
    """Node numbers (2, k) at the ends of facets (k,), of P2 (3, k) with the middles; of the hybrid element see
    `macro_fem.bounds.equilibrated`."""
    if disc.element == "equilibrium":
        return np.stack([2 * facets, 2 * facets + 1])
    ends = mesh.mesh.facets[:, facets]
    return np.vstack([ends, mesh.mesh.p.shape[1] + facets]) if disc.element == "P2" else ends


def point_node(at: tuple[float, float], disc: Discretization) -> Index:
    """The number (1,) of the node at a point."""
    return np.array([np.argmin(np.linalg.norm(disc.nodes - np.array(at), axis=1))])


def divide(scene: Scene, cell: CellInfo | None) -> DividedSheet:
    """The sheet of a scene with its border divided; InputError if its outline or mesh file cannot be meshed."""
    curtain = scene.curtain
    if isinstance(curtain, MeshFile):
        mesh, border, notes = read_mesh(curtain, scene.source)
        width, height = np.ptp(mesh.p, axis=1).tolist()
        if cell is not None and min(width, height) < 2.0 * cell.r1_mm:
            scene.refuse(
                f"[curtain] file = {curtain.file!r}: its extents of {width:g} and {height:g} mm are less than the "
                f"mean diameter of a ring, {2.0 * cell.r1_mm:g} mm; were metres meant? Scale the mesh by 1000 (Gmsh: "
                "Mesh.ScalingFactor = 1000)"
            )
        return DividedSheet(border, lambda: (mesh, np.arange(mesh.p.shape[1])), "file", notes)
    aspect = 1.0 if cell is None else cell.b_y_mm / cell.b_x_mm  # slope of the diagonal families
    outline = curtain.corners(scene.mesh.cells)
    _refuse_too_many(scene, outline, aspect)
    if isinstance(curtain, Rectangle) and not curtain.holes:
        return _in_rows(scene, curtain, aspect)
    holes, count = [np.array(hole) for hole in curtain.holes], columns(scene)
    with scene.in_errors("[curtain] "):
        rings, _, middle = _divided(outline, holes, count)
    first, loops = 0, list[Index]()
    for ring in rings:  # the sheet on the left: outline counterclockwise, holes clockwise
        loop = np.append(first + np.arange(len(ring)), first)
        loops.append(loop if (signed_areas(ring) > 0.0) == (not loops) else loop[::-1])
        first += len(ring)

    def fill() -> tuple[Any, Index]:
        with scene.in_errors("[curtain] "):
            points, cells = mesh_outline(outline, holes, count, aspect, math.radians(curtain.weave_angle))
        return skfem.MeshTri(points.T.copy(), cells.T.copy()), np.arange(first)

    return DividedSheet(border_of(np.concatenate(rings) + middle, loops), fill, "aligned", scene.notes)


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


def _in_rows(scene: Scene, curtain: Rectangle, aspect: float) -> DividedSheet:
    """Rows of equal rectangles, each cut into four ("aligned", "crossed") or two ("diagonal") triangles.

    Those of "aligned" have the sides of the weave's cell, so that their diagonals follow both families, and one lower
    row at the bottom; off the axes of the weave "aligned" becomes "crossed".
    """
    W, H, n, pattern = curtain.width, curtain.height, columns(scene), scene.mesh.pattern
    turns = curtain.weave_angle / 90.0
    pattern = "crossed" if pattern == "aligned" and turns != round(turns) else pattern
    if pattern == "aligned":
        y = _rows(H, (aspect if round(turns) % 2 == 0 else 1.0 / aspect) * W / n)
    else:
        y = np.linspace(0.0, H, max(1, round(n * H / W)) + 1)
    x = np.linspace(0.0, W, n + 1)
    across, up = np.zeros_like(x), np.zeros_like(y)
    sides = [(x, across), (up + W, y), (x[::-1], across + H), (up, y[::-1])]
    points = np.concatenate([np.column_stack(side)[:-1] for side in sides])

    def fill() -> tuple[Any, Index]:
        if pattern == "diagonal":
            mesh = skfem.MeshTri.init_tensor(x, y)
        else:
            mesh = skfem.MeshQuad.init_tensor(x, y).to_meshtri(style="x")
        return mesh, cKDTree(mesh.p.T).query(points)[1]

    return DividedSheet(border_of(points, [np.append(np.arange(len(points)), 0)]), fill, pattern, ())


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
    `aspect` whose y axis is turned by `angle` (radians). InputError if the polygons touch, cross or leave no region,
    or are finer than the cells.
    """
    border, spacing, middle = _divided(outline, holes, cells)
    outline, region = outline - middle, shapely.Polygon(outline - middle, [hole - middle for hole in holes])
    inner = _lattice(outline, spacing, aspect, angle)
    sides = region.boundary
    shapely.prepare([region, sides])
    inner = inner[shapely.contains_xy(region, inner)]
    # Least distance of a lattice point to the boundary in units of the spacing: keeps boundary triangles from
    # slivers.
    inner = inner[~shapely.dwithin(sides, shapely.points(inner), 0.55 * spacing)]
    points = np.concatenate([*border, inner])
    tied = TIES * points * ((points / np.abs(points).max()) ** 2 @ [[1.0], [2.0]]) if aspect == 1.0 else 0.0
    triangles = Delaunay(points + tied).simplices
    triangles = triangles[shapely.contains_xy(region, points[triangles].mean(axis=1))]
    triangles = counterclockwise(points, triangles)
    triangles = triangles[np.abs(signed_areas(points[triangles])) > 0.5e-6 * spacing**2]
    _check_border(triangles, [len(part) for part in border])
    used, triangles = np.unique(triangles, return_inverse=True)
    return points[used] + middle, triangles.reshape(-1, 3)


def _divided(outline: Array, holes: list[Array], cells: int) -> tuple[list[Array], float, Array]:
    """The rings (k, 2) of an outline and its holes, divided at least `cells` times along the width, about their
    `middle` (2,); the spacing, and the middle. InputError for polygons that bound no region."""
    _check_region(outline, holes)
    middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))  # far from the origin digits cancel
    spacing = float(np.ptp(outline[:, 0])) / cells
    rings = shapely.segmentize([shapely.LinearRing(one - middle) for one in (outline, *holes)], spacing * (1.0 + 1e-9))
    return [shapely.get_coordinates(one)[:-1] for one in rings], spacing, middle


def _lattice(outline: Array, spacing: float, aspect: float, angle: float) -> Array:
    """Corners and centres of rectangles spacing x aspect spacing, turned by `angle`, that cover an outline around 0."""
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    reach = np.abs(outline @ turn).max(axis=0) + spacing * (1.0 + aspect)
    n, m = math.ceil(reach[0] / spacing), math.ceil(reach[1] / (spacing * aspect))
    if 8 * n * m > MAX_LATTICE:
        raise InputError(
            f"outline: the lattice of the weave around it has {8 * n * m:.3g} points, at most {MAX_LATTICE:.3g} are "
            "allowed; use fewer cells, or a shape that is less slender across the weave"
        )
    i, j = np.meshgrid(np.arange(-n, n + 1.0), np.arange(-m, m + 1.0), indexing="ij")
    corners = np.stack([i.ravel(), j.ravel()], axis=-1)
    local = np.concatenate([corners, corners + 0.5]) * spacing * np.array([1.0, aspect])
    return np.asarray(local @ turn.T)


def _check_region(outline: Array, holes: list[Array]) -> None:
    """InputError for an outline and holes that bound no region."""
    for polygon in (outline, *holes):
        if (polygon == np.roll(polygon, -1, axis=0)).all(axis=1).any():
            raise InputError("outline and holes: have two equal corners in a row")
    region = shapely.Polygon(outline, holes)
    if not region.is_valid:
        raise InputError(f"the outline and its holes bound no region: {shapely.is_valid_reason(region)}, mm")
    if region.area <= 1e-9 * float(np.ptp(outline, axis=0).max()) ** 2:
        raise InputError("outline: has no area, its corners lie on a line")


def _check_border(triangles: np.ndarray, lengths: list[int]) -> None:
    """Every piece of the border is an edge of the mesh: else corners are closer together than the cells."""
    edges = set(map(frozenset, np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)]).tolist()))
    for number in np.split(np.arange(sum(lengths)), np.cumsum(lengths)[:-1]):
        if not edges.issuperset(map(frozenset, zip(number.tolist(), np.roll(number, -1).tolist(), strict=True))):
            raise InputError("outline and holes: come closer to each other than the cells are wide; use more cells")


def refine(mesh: CurtainMesh, cells: np.ndarray) -> CurtainMesh:
    """The mesh with the given triangles cut in four and their neighbours as needed to fit (red, green, blue)."""
    finer = mesh.mesh.refined(np.asarray(cells))
    return replace(mesh, mesh=finer, edges=inherited_edges(mesh.mesh, finer, mesh.edges))
