"""A finite piece of mesh: which rings it has, which of them interlink, what area each one stands for.

Rings sit at the lattice points of the reference cell that lie inside an outline. A rectangle of whole cells has rings
of class 0 on its corners and along its edges. A ring stands for the part of its brick that lies inside the outline:
bricks of b_x by b_y / (rings per cell), centred on the rings, tile the plane. So weight and outline are those of the
membrane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rve.common.errors import InputError
from rve.common.types import Array
from rve.equilibrium.interior_point import DirectOptions
from rve.geometry.cell import Cell
from rve.geometry.pose import start_pose
from rve.geometry.weave import WEAVES
from rve.solve import reference_sides, weave_sides
from rve.strained.placed import axes_of_weave, reference_shares, shares

if TYPE_CHECKING:
    from rve.finite.solution import FiniteSolution
    from rve.finite.task import FiniteOptions
    from rve.finite.walls import HalfSpace

Index = NDArray[np.intp]

MOST_RINGS = 1_000_000
_SAMPLES = 8


@dataclass(frozen=True, eq=False)
class FiniteMesh:
    """Rings of a finite piece of mesh in the reference state.

    X (n, 2): centres in mm; index (n, 3): class and lattice point i, j; area (n,): reference area in mm2 that each ring
    stands for; linked (m, 2): pairs of rings that interlink; sides: b_x, b_y of the reference cell in mm, in the axes
    of the weave; hang_deg: angle from the vertical to the weave's y axis; bars: rings (k,) in order that stay on a
    line, between the first and the last in proportion to the reference.

    >>> mesh = FiniteMesh.rectangle(Cell(), 2, 1)
    >>> len(mesh.X), len(mesh.linked), bool(np.isclose(mesh.area.sum(), np.ptp(mesh.X, axis=0).prod()))
    (8, 8, True)
    """

    cell: Cell
    X: Array
    index: Index
    area: Array
    linked: Index
    sides: tuple[float, float]
    hang_deg: float = 0.0
    bars: tuple[Index, ...] = ()

    @classmethod
    def rectangle(cls, cell: Cell, columns: int, rows: int) -> FiniteMesh:
        """A rectangle of `columns` by `rows` reference cells, its lower left corner at the origin."""
        if columns < 1 or rows < 1:
            raise InputError(f"{columns} x {rows} cells: a rectangle has one cell or more along each side")
        width, height = reference_sides(cell, DirectOptions())
        W, H = columns * width, rows * height
        return cls.inside(cell, [(0.0, 0.0), (W, 0.0), (W, H), (0.0, H)])

    @classmethod
    def inside(
        cls,
        cell: Cell,
        outline: Sequence[tuple[float, float]] | Array,
        holes: Sequence[Sequence[tuple[float, float]] | Array] = (),
        hang_deg: float = 0.0,
    ) -> FiniteMesh:
        """The rings whose reference centres lie inside a polygon, in mm, or on it, and not inside a hole.

        The lattice has a point of class 0 on the first corner of the outline if its sides are whole cells, and in the
        middle of its bounding box otherwise. InputError if there are fewer than two rings, more than a million, or
        a ring without a link.
        """
        border = np.asarray(outline, dtype=float)
        gaps = [np.asarray(hole, dtype=float) for hole in holes]
        for polygon in (border, *gaps):
            if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3 or not np.isfinite(polygon).all():
                raise InputError("an outline or a hole is not a list of three or more points [x, y]")
        sides = tuple(cell.r1 * side for side in weave_sides(cell, reference_sides(cell, DirectOptions())))
        axes = axes_of_weave(cell, hang_deg)
        origin = _origin(border, np.array(sides), axes)
        index, X = _sites(cell, border, gaps, np.array(sides), axes, origin)
        linked = _linked(cell, index)
        _check_rings(index, linked)
        area = _areas(X, cell, border, gaps, np.array(sides), axes)
        return cls(cell, X, index, area, linked, (sides[0], sides[1]), hang_deg)

    @property
    def mass(self) -> Array:
        """Mass (n,) in kg: a whole ring's for a whole brick, less on the boundary."""
        return np.asarray(self.cell.ring_mass * self.area * self.cell.weave.classes / np.prod(self.sides))

    def slack(self) -> tuple[Array, Array]:
        """Centres (n, 3) in mm and unit normals (n, 3) of the slack weave of largest clearance."""
        pose = start_pose(self.cell.weave, 1)
        axes = axes_of_weave(self.cell, self.hang_deg)
        share = np.concatenate([np.zeros((1, 1, 2)), shares(pose)], axis=1)[0]
        ij = self.index[:, 1:] + share[self.index[:, 0]]
        flat = self.cell.r1 * (ij[:, :1] * pose.a1 + ij[:, 1:] * pose.a2) @ axes.T
        normal = pose.normals[0, self.index[:, 0]]
        zero = np.zeros(len(flat))
        return np.column_stack([flat, zero]), np.column_stack([normal[:, :2] @ axes.T, normal[:, 2]])

    def solve(
        self,
        force: Array,
        held: NDArray[np.bool_],
        at: Array,
        *,
        space: bool = True,
        walls: Sequence[HalfSpace] = (),
        guide: Array | None = None,
        options: FiniteOptions | None = None,
    ) -> FiniteSolution:
        """The rings under dead forces (n, 3) in N, coordinates `held` (n, 3) kept at the places `at` (n, 3) in mm.

        In space, or with all centres in the plane z = 0. Every ring stays out of `walls` with its whole wire. Starts
        from the slack weave; held rings and half-spaces that cut it travel to their places. guide (n, 3): places in mm
        that pull at the centres in the beginning and no more at the end, nan where none does. A local minimum of the
        potential is found, which need not be the lowest; guide and motion have a part in which. An answer that has
        not converged is returned with its status. InputError for other shapes, no load, and pieces that nothing holds.

        >>> mesh = FiniteMesh.rectangle(Cell(), 1, 1)
        >>> force, at = np.zeros((5, 3)), np.column_stack([mesh.X, np.zeros(5)])
        >>> force[:, 1] = -9.81 * mesh.mass
        >>> mesh.solve(force, at[:, [1, 1, 1]] > 12.0, at, space=False).status
        'converged'
        """
        from rve.finite.problem import Problem
        from rve.finite.solution import solve_mesh
        from rve.finite.step import rest_by_motion

        held = np.asarray(held, dtype=bool)
        at = np.asarray(at, dtype=float)
        near = None if guide is None else np.asarray(guide, dtype=float)
        problem = Problem(self, np.asarray(force, dtype=float), held, at, space, tuple(walls), near)
        if options is not None and options.by_motion:
            return rest_by_motion(problem, options)
        return solve_mesh(problem, options)


def cell_of_sides(r1: float, r2: float, sides: tuple[float, float]) -> Cell:
    """The cell of rings with these radii whose reference cell has the sides b_x, b_y, all in mm: weave and grain.

    InputError if no weave has.

    >>> cell = cell_of_sides(5.0, 0.5, (11.0, 12.646069623526))
    >>> cell.weave.name, cell.grain
    ('4-in-1', 'y')
    """
    for weave in WEAVES.values():
        for grain in ("y", "x"):
            if r1 / r2 > weave.jamming_ratio:
                cell = Cell(r1, r2, weave, grain)
                if np.allclose(reference_sides(cell, DirectOptions()), sides, rtol=1e-4):
                    return cell
    raise InputError(
        f"a reference cell of {sides[0]:g} x {sides[1]:g} mm is that of no known weave with r1 = {r1:g}, r2 = {r2:g} mm"
    )


def _origin(border: Array, sides: Array, axes: Array) -> Array:
    """Where the lattice point (0, 0) of class 0 is, mm."""
    ij = (border - border[0]) @ axes / sides
    if np.abs(ij - np.round(ij)).max() < 1e-4:
        return border[0]
    return 0.5 * (border.min(axis=0) + border.max(axis=0))


def _sites(
    cell: Cell, border: Array, holes: list[Array], sides: Array, axes: Array, origin: Array
) -> tuple[Index, Array]:
    """Lattice points and centres of the rings inside the outline and outside the holes."""
    ij = (border - origin) @ axes / sides
    low, high = np.floor(ij.min(axis=0)).astype(int) - 1, np.ceil(ij.max(axis=0)).astype(int) + 1
    count = cell.weave.classes * int((high - low + 1).prod())
    if count > MOST_RINGS:
        raise InputError(f"the box around the outline has {count} rings, at most {MOST_RINGS} are allowed")
    i, j = (x.ravel() for x in np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)))
    parts = []
    for ring, share in enumerate(reference_shares(cell)):
        X = ((np.column_stack([i, j]) + share) * sides) @ axes.T + origin
        parts.append((np.column_stack([np.full(len(i), ring), i, j]), X))
    index, X = (np.concatenate(column) for column in zip(*parts, strict=True))
    keep = _inside(X, border) | _is_on(X, border, 1e-4 * sides.min())
    for hole in holes:
        keep &= ~_inside(X, hole) | _is_on(X, hole, 1e-4 * sides.min())
    order = np.lexsort((X[keep, 0], X[keep, 1]))
    return index[keep][order], X[keep][order]


def _inside(points: Array, polygon: Array) -> NDArray[np.bool_]:
    """Even-odd rule, (n,)."""
    x, y = points.T
    result = np.zeros(len(points), bool)
    for (ax, ay), (bx, by) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if ay != by:
            result ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) * (bx - ax) / (by - ay))
    return result


def _is_on(points: Array, polygon: Array, tolerance: float) -> NDArray[np.bool_]:
    """Whether points lie within a tolerance of a side, (n,)."""
    result = np.zeros(len(points), bool)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        along = b - a
        s = np.clip((points - a) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
        result |= np.linalg.norm(points - a - s[:, None] * along, axis=1) <= tolerance
    return result


def _linked(cell: Cell, index: Index) -> Index:
    """Pairs (m, 2) of rings that the weave links."""
    low = index[:, 1:].min(axis=0) - 1
    shape = (cell.weave.classes, *(index[:, 1:].max(axis=0) - low + 2))
    table = np.full(shape, -1)
    table[index[:, 0], index[:, 1] - low[0], index[:, 2] - low[1]] = np.arange(len(index))
    found = []
    for a, b, i, j in cell.weave.pairs[cell.weave.linked]:
        first = np.flatnonzero(index[:, 0] == a)
        to = index[first, 1:] + (i, j) - low
        there = ((to >= 0) & (to < shape[1:])).all(axis=1)
        second = table[b, to[there, 0], to[there, 1]]
        found.append(np.column_stack([first[there], second])[second >= 0])
    pairs = np.sort(np.concatenate(found), axis=1)
    return np.asarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])


def _check_rings(index: Index, linked: Index) -> None:
    if len(index) < 2:
        raise InputError(f"the outline holds {len(index)} rings; a mesh has two or more")
    alone = np.setdiff1d(np.arange(len(index)), linked)
    if len(alone):
        raise InputError(f"{len(alone)} of {len(index)} rings inside the outline link no other; enlarge or smooth it")


def _areas(X: Array, cell: Cell, border: Array, holes: list[Array], sides: Array, axes: Array) -> Array:
    """Reference area (n,) in mm2 of each ring; their sum is the area inside the outline."""
    brick = sides / (1, cell.weave.classes)
    t = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    offsets = np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2) * brick @ axes.T
    part = np.zeros(len(X))
    for offset in offsets:
        at = X + offset
        keep = _inside(at, border)
        for hole in holes:
            keep &= ~_inside(at, hole)
        part += keep / len(offsets)
    total = _polygon_area(border) - sum(_polygon_area(hole) for hole in holes)
    part = np.maximum(part, 1.0 / len(offsets))
    return np.asarray(part * total / part.sum())


def _polygon_area(polygon: Array) -> float:
    x, y = (polygon - polygon[0]).T
    return 0.5 * abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()))
