"""Which half-space is violated most: a map of the upper envelope of all half-spaces.

With T = (E11 + E22)/2, D = (E11 - E22)/2, G = E12 and a load of unit trace as (p, q) = (S11 - S22, 2 S12) a half-space
reads T + p D + q G <= h. Which one is violated most depends on (D, G) alone: the highest plane p D + q G - h there. A
grid over (D, G) lists, for each cell, every plane that is highest somewhere in it. Cells with more than FEW planes are
cut again; those that still have more lie around a vertex and get lists of up to MANY. In cells with more than MANY
planes all of these are compared, for points off the grid all planes of the law.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rve.common.types import Array

Index = NDArray[np.intp]

CELLS = (96, 48)
CUT = 8
"""A cell with more than FEW planes is cut in CUT x CUT; the first cells are also searched in groups of this size."""
FEW, MANY = 6, 32
"""Planes listed in a plain cell, and in a cell near a vertex. Longer lists cost time in every call."""
SEARCH_BLOCK = 256
"""Points compared with all planes at a time: more need more memory."""
OFF = np.iinfo(np.intp).min
"""Stands for "off the grid" where others are lists of planes."""
RECTANGLES = 64
"""Rectangles searched at a time: more do not fit into the processor's cache."""


@dataclass(frozen=True, eq=False)
class Envelope:
    """Planes (m, 3) with rows p, q, -h, and the cells of the map: `origin` (2,), `per_unit` (2,) place the first ones.

    `cut` (first cells,) is -1, or the number of the first of the smaller cells of a cell. For all cells: `few`
    (cells, FEW) lists plane numbers, `slots` (3, FEW, cells) their coefficients; `crowd` (cells,) is -1, or the row of
    `many` (crowded, MANY) that lists the planes instead, or -2 - k where `most`[k] lists them, as there are too many.
    """

    planes: Array
    origin: Array
    per_unit: Array
    cut: Index
    few: Index
    slots: Array
    crowd: Index
    many: Index
    most: tuple[Index, ...]

    def highest(self, E: Array) -> tuple[Index, Array]:
        """Most violated half-space and its S:E - h at E (3, n), each (n,)."""
        T, D, G = 0.5 * (E[0] + E[2]), 0.5 * (E[0] - E[2]), E[1]
        cell, on_grid = self._cell(D, G)
        P, Q, H = self.slots
        best, slot = P[0].take(cell) * D + Q[0].take(cell) * G + H[0].take(cell), np.zeros(len(D), np.intp)
        for k in range(1, FEW):
            value = P[k].take(cell) * D + Q[k].take(cell) * G + H[k].take(cell)
            slot[value > best] = k
            np.maximum(best, value, out=best)
        index = self.few.ravel().take(cell * FEW + slot)
        crowd = np.where(on_grid, self.crowd.take(cell), OFF)
        self._look_closer(np.flatnonzero(crowd >= 0), crowd, D, G, index, best)
        wide = np.flatnonzero(crowd < -1)
        for number in np.unique(crowd[wide]):
            among = None if number == OFF else self.most[-2 - number]
            self._search(wide[crowd[wide] == number], among, D, G, index, best)
        return index, T + best

    def _cell(self, D: Array, G: Array) -> tuple[Index, NDArray[np.bool_]]:
        """Cell of each point, (n,), 0 off the grid, and whether it is on the grid."""
        u, v = (D - self.origin[0]) * self.per_unit[0], (G - self.origin[1]) * self.per_unit[1]
        on_grid = (u >= 0.0) & (u < CELLS[0]) & (v >= 0.0) & (v < CELLS[1])
        if not on_grid.all():
            u, v = np.where(on_grid, u, 0.0), np.where(on_grid, v, 0.0)
        i, j = u.astype(np.intp), v.astype(np.intp)
        cell = i * CELLS[1] + j
        smaller = self.cut.take(cell)
        inner = ((u - i) * CUT).astype(np.intp) * CUT + ((v - j) * CUT).astype(np.intp)
        return np.where(smaller < 0, cell, smaller + inner), on_grid

    def _look_closer(self, points: Index, crowd: Index, D: Array, G: Array, index: Index, best: Array) -> None:
        """Enters the highest of the planes of crowded cells into index and best."""
        near = self.many[crowd[points]]
        planes = self.planes[near]
        height = planes[:, :, 0] * D[points, None] + planes[:, :, 1] * G[points, None] + planes[:, :, 2]
        top, row = height.argmax(axis=1), np.arange(len(points))
        index[points], best[points] = near[row, top], height[row, top]

    def _search(self, points: Index, among: Index | None, D: Array, G: Array, index: Index, best: Array) -> None:
        """Enters the highest of the planes `among` (k,), or of all, into index and best."""
        planes = self.planes if among is None else self.planes[among]
        for start in range(0, len(points), SEARCH_BLOCK):
            part = points[start : start + SEARCH_BLOCK]
            # no matrix product: three columns are not worth waking the threads of BLAS, 20 ms against 3 ms
            height = D[part, None] * planes[:, 0]
            height += G[part, None] * planes[:, 1]
            height += planes[:, 2]
            top = height.argmax(axis=1)
            index[part] = top if among is None else among[top]
            best[part] = height[np.arange(len(part)), top]


def envelope_of(S: Array, h: Array, box: Array) -> Envelope:
    """The map of the half-spaces S (m, 3) of unit trace, h (m,), over the box [[D, G] least, [D, G] most]."""
    planes = np.ascontiguousarray(np.stack([S[:, 0] - S[:, 2], 2.0 * S[:, 1], -h], axis=1))
    size = (box[1] - box[0]) / CELLS
    groups = (CELLS[0] // CUT, CELLS[1] // CUT)
    lists: list[Index] = [np.zeros(0, np.intp)] * (CELLS[0] * CELLS[1])
    near = highest_somewhere(planes, np.arange(len(planes)), box[0] + corners(groups) * size * CUT, size * CUT)
    for group, found in zip(corners(groups) * CUT, near, strict=True):
        inner = group + corners((CUT, CUT))
        for place, one in zip(inner, highest_somewhere(planes, found, box[0] + inner * size, size), strict=True):
            lists[int(place[0]) * CELLS[1] + int(place[1])] = one
    cut = np.full(len(lists), -1)
    for cell in range(len(cut)):
        if len(lists[cell]) > FEW:
            cut[cell] = len(lists)
            corner = box[0] + size * [cell // CELLS[1], cell % CELLS[1]]
            inner = corner + corners((CUT, CUT)) * size / CUT
            lists += highest_somewhere(planes, lists[cell], inner, size / CUT)
    few = np.array([np.resize(one, FEW) for one in lists], np.intp)
    crowd = np.full(len(lists), -1)
    many: list[Index] = []
    most: list[Index] = []
    for cell, one in enumerate(lists):
        if len(one) > MANY:
            crowd[cell] = -2 - len(most)
            most.append(one)
        elif FEW < len(one) <= MANY:
            crowd[cell] = len(many)
            many.append(np.resize(one, MANY))
    slots = np.ascontiguousarray(planes.T[:, few.T])
    return Envelope(
        planes, box[0], 1.0 / size, cut, few, slots, crowd, np.array(many, np.intp).reshape(-1, MANY), tuple(most)
    )


def corners(shape: tuple[int, int]) -> Array:
    """Places (k, 2) of the cells of a grid, the second number running fastest."""
    i, j = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    return np.column_stack([i, j]).astype(float)


def highest_somewhere(planes: Array, near: Index, corner: Array, size: Array) -> list[Index]:
    """For each rectangle, corner (k, 2), the numbers in `near` of planes (m, 3) that may be highest in it.

    Left out is what one other plane, highest at a corner or in the middle, exceeds all over the rectangle.
    """
    five = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 0.5]])
    found: list[Index] = []
    for start in range(0, len(corner), RECTANGLES):
        x = corner[start : start + RECTANGLES, None] + five * size
        height = x @ planes[near, :2].T + planes[near, 2]
        rivals = height.argmax(axis=2)
        keep = np.ones((len(x), len(near)), bool)
        for k in range(5):
            rival = np.take_along_axis(height, rivals[:, None, k : k + 1], axis=2)
            keep &= (height[:, :4] - rival[:, :4]).max(axis=1) >= -1e-15
        found += [near[row] for row in keep]
    return found
