"""A finite piece of mesh: which rings it has, which of them interlink, what area each one stands for.

Rings sit at the lattice points of the reference cell that lie inside an outline. A rectangle of whole cells has rings
of class 0 on its corners and along its edges. A ring stands for the part of its brick that lies inside the outline:
bricks of b_x by b_y / (rings per cell), centred on the rings, tile the plane. So weight and outline are those of the
membrane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import shapely

from rve.common import Array, Index, InputError, checked
from rve.common.cell_fields import gyration_radius
from rve.geometry.cell import Cell, weave_sides
from rve.geometry.pattern import padded
from rve.geometry.pose import start_pose
from rve.geometry.weave import WEAVES
from rve.locking.interior_point import DirectOptions
from rve.placed.fit import axes_of_weave, neighbours, reference_shares
from rve.solve import reference_sides

MOST_RINGS = 1_000_000


@dataclass(frozen=True, eq=False)
class RingLayout:
    """Rings of a finite piece of mesh in the reference state.

    X (n, 2): centres in mm; index (n, 3): class and lattice point i, j; area (n,): reference area in mm2 that each ring
    stands for; linked (m, 2): pairs of rings that interlink; sides: b_x, b_y of the reference cell in mm, in the axes
    of the weave; hang_deg: angle from the vertical to the weave's y axis; bars: rings (k,) in order that stay on a
    line, between the first and the last in proportion to the reference.

    >>> layout = RingLayout.rectangle(Cell(), 2, 1)
    >>> len(layout.X), len(layout.linked), bool(np.isclose(layout.area.sum(), np.ptp(layout.X, axis=0).prod()))
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
    @checked
    def rectangle(cls, cell: Cell, columns: int, rows: int) -> Self:
        """A rectangle of `columns` by `rows` reference cells, its lower left corner at the origin."""
        if columns < 1 or rows < 1:
            raise InputError(f"{columns} x {rows} cells: a rectangle has one cell or more along each side")
        sides_mm = reference_sides(cell, DirectOptions())
        W, H = np.array([columns, rows]) * sides_mm
        return cls.inside(cell, [(0.0, 0.0), (W, 0.0), (W, H), (0.0, H)], sides_mm=sides_mm)

    @classmethod
    @checked
    def inside(
        cls,
        cell: Cell,
        outline: Sequence[tuple[float, float]] | Array,
        holes: Sequence[Sequence[tuple[float, float]] | Array] = (),
        hang_deg: float = 0.0,
        sides_mm: tuple[float, float] | None = None,
    ) -> Self:
        """The rings whose reference centres lie inside a polygon, in mm, or on it, and not inside a hole.

        sides_mm: b_x, b_y of the reference cell, by default that of rings side by side. The lattice has a point of
        class 0 on the first corner of the outline if its sides are whole cells, and in the middle of its bounding box
        otherwise. InputError if there are fewer than two rings, more than a million, or a ring without a link.
        """
        border = np.asarray(outline, dtype=float)
        inner = [np.asarray(hole, dtype=float) for hole in holes]
        for polygon in (border, *inner):
            if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3 or not np.isfinite(polygon).all():
                raise InputError("an outline or a hole is not a list of three or more points [x, y]")
        sides_mm = reference_sides(cell, DirectOptions()) if sides_mm is None else sides_mm
        sides = cell.r1 * np.array(weave_sides(cell, sides_mm))
        axes = axes_of_weave(cell, hang_deg)
        region = shapely.Polygon(border, inner)
        index, X = _sites(cell, border, region, sides, axes)
        if len(index) < 2:
            raise InputError(f"the outline holds {len(index)} rings; a mesh has two or more")
        pairs = [np.column_stack(ends) for pair, *ends in neighbours(cell.weave, index) if cell.weave.linked[pair]]
        linked = np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)
        loose = len(np.setdiff1d(np.arange(len(index)), linked))
        if loose:
            raise InputError(f"{loose} of {len(index)} rings inside the outline link no other; enlarge or smooth it")
        area = _areas(X, region, sides / (1, cell.weave.classes), axes)
        return cls(cell, X, index, area, linked, (float(sides[0]), float(sides[1])), hang_deg)

    @property
    def sizes(self) -> tuple[Array, Array]:
        """Radii (n,) of the centre circles in r1, and of the wires in r2."""
        weave, kind = self.cell.weave, self.index[:, 0]
        return weave.radii[kind], weave.wires[kind]

    @property
    def weighing_area(self) -> Array:
        """Reference area (n,) in mm2 of each ring in proportion to its mass: all of the area together."""
        weave = self.cell.weave
        if weave.is_of_equal_rings:
            return self.area
        share = self.area * weave.masses[self.index[:, 0]]
        return np.asarray(share * (self.area.sum() / share.sum()))

    @property
    def mass(self) -> Array:
        """Mass (n,) in kg: a whole ring's for a whole brick, less on the boundary."""
        masses = float(self.cell.weave.masses.sum())
        return np.asarray(self.cell.ring_mass * self.weighing_area * masses / np.prod(self.sides))

    @property
    def gyration_mm(self) -> Array:
        """Radii of gyration (n, 1) of the rings about a diameter in mm."""
        radii, wires = self.sizes
        return np.asarray(gyration_radius(self.cell.r1 * radii, self.cell.r2 * wires))[:, None]

    def slack(self) -> tuple[Array, Array]:
        """Centres (n, 3) in mm and unit normals (n, 3) of the slack weave of largest clearance."""
        pose = start_pose(self.cell.weave, 1)
        axes = axes_of_weave(self.cell, self.hang_deg)
        ij = self.index[:, 1:] + reference_shares(self.cell)[self.index[:, 0]]
        flat = self.cell.r1 * (ij[:, :1] * pose.a1 + ij[:, 1:] * pose.a2) @ axes.T
        normal, height = (one[0, self.index[:, 0]] for one in (pose.normals, padded(pose.centres)))
        centre = np.column_stack([flat, self.cell.r1 * height[:, 2]])
        return centre, np.column_stack([normal[:, :2] @ axes.T, normal[:, 2]])


@checked
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


def _sites(cell: Cell, border: Array, region: shapely.Polygon, sides: Array, axes: Array) -> tuple[Index, Array]:
    """Lattice points and centres of the rings inside the outline and outside the holes."""
    ij = (border - border[0]) @ axes / sides
    is_whole = np.abs(ij - np.round(ij)).max() < 1e-4
    origin = border[0] if is_whole else 0.5 * (border.min(axis=0) + border.max(axis=0))
    ij = (border - origin) @ axes / sides
    low, high = np.floor(ij.min(axis=0)).astype(int) - 1, np.ceil(ij.max(axis=0)).astype(int) + 1
    count = cell.weave.classes * int((high - low + 1).prod())
    if count > MOST_RINGS:
        raise InputError(f"the box around the outline has {count} rings, at most {MOST_RINGS} are allowed")
    i, j = (x.ravel() for x in np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)))
    index = np.concatenate([np.column_stack([np.full(len(i), k), i, j]) for k in range(cell.weave.classes)])
    X = ((index[:, 1:] + reference_shares(cell)[index[:, 0]]) * sides) @ axes.T + origin
    sides_of_region = region.boundary
    shapely.prepare([region, sides_of_region])
    near = shapely.dwithin(sides_of_region, shapely.points(X), 1e-4 * float(sides.min()))
    keep = shapely.contains_xy(region, X) | near
    index, X = index[keep], X[keep]
    order = np.lexsort((X[:, 0], X[:, 1]))
    return index[order], X[order]


def _areas(X: Array, region: shapely.Polygon, brick: Array, axes: Array) -> Array:
    """Reference area (n,) in mm2 of each ring; their sum is the area inside the outline."""
    t = (np.arange(8) + 0.5) / 8 - 0.5
    offsets = np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2) * brick @ axes.T
    share = sum(shapely.contains_xy(region, X + offset) / len(offsets) for offset in offsets)
    share = np.maximum(share, 1.0 / len(offsets))
    return np.asarray(share * region.area / share.sum())
