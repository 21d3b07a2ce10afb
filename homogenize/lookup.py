"""Which half-space is violated most, found by looking near by: a map of the upper envelope of all half-spaces.

With T = (E11 + E22)/2, D = (E11 - E22)/2, G = E12 and a load of unit trace as (p, q) = (S11 - S22, 2 S12) a half-space
reads T + p D + q G <= h. Which one is violated most depends on (D, G) alone: the highest plane p D + q G - h there. A
grid over (D, G) lists, for each cell, every plane that is highest somewhere in it: few in most cells, many around a
vertex. Points off the grid, and cells with too many, are left to a search through all planes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from homogenize.protocol import Array

Index = NDArray[np.intp]

CELLS = (192, 96)
COARSE = 12
"""Fine cells per coarse cell and side: planes are sifted for the coarse ones first."""
FEW, MANY = 6, 32
"""Planes listed in a plain cell, and in a crowded one."""
SEARCH_BLOCK = 256


@dataclass(frozen=True, eq=False)
class Envelope:
    """Planes (m, 3) with rows p, q, -h, and the cells of the map: `origin` (2,), `per_unit` (2,) place them.

    `few` (cells, FEW) lists plane numbers, `slots` (3, FEW, cells) their coefficients; `crowd` (cells,) is -1, or the
    row of `many` (crowded, MANY) that lists the planes instead, or -2 where there are too many.
    """

    planes: Array
    origin: Array
    per_unit: Array
    few: Index
    slots: Array
    crowd: Index
    many: Index

    def highest(self, E: Array) -> tuple[Index, Array]:
        """Most violated half-space and its S:E - h at E (3, n), each (n,)."""
        T, D, G = 0.5 * (E[0] + E[2]), 0.5 * (E[0] - E[2]), E[1]
        u, v = (D - self.origin[0]) * self.per_unit[0], (G - self.origin[1]) * self.per_unit[1]
        on_grid = (u >= 0.0) & (u < CELLS[0]) & (v >= 0.0) & (v < CELLS[1])
        cell = np.where(on_grid, u, 0.0).astype(np.intp) * CELLS[1] + np.where(on_grid, v, 0.0).astype(np.intp)
        P, Q, H = self.slots
        best, slot = P[0].take(cell) * D + Q[0].take(cell) * G + H[0].take(cell), np.zeros(len(D), np.intp)
        for k in range(1, FEW):
            value = P[k].take(cell) * D + Q[k].take(cell) * G + H[k].take(cell)
            slot[value > best] = k
            np.maximum(best, value, out=best)
        index = self.few.ravel().take(cell * FEW + slot)
        crowd = np.where(on_grid, self.crowd.take(cell), -2)
        self._look_closer(np.flatnonzero(crowd >= 0), crowd, D, G, index, best)
        self._search(np.flatnonzero(crowd == -2), D, G, index, best)
        return index, T + best

    def _look_closer(self, points: Index, crowd: Index, D: Array, G: Array, index: Index, best: Array) -> None:
        """Enters the highest of the planes of crowded cells into index and best."""
        near = self.many[crowd[points]]
        planes = self.planes[near]
        height = planes[:, :, 0] * D[points, None] + planes[:, :, 1] * G[points, None] + planes[:, :, 2]
        top, row = height.argmax(axis=1), np.arange(len(points))
        index[points], best[points] = near[row, top], height[row, top]

    def _search(self, points: Index, D: Array, G: Array, index: Index, best: Array) -> None:
        """Enters the highest of all planes into index and best."""
        for start in range(0, len(points), SEARCH_BLOCK):
            part = points[start : start + SEARCH_BLOCK]
            height = np.stack([D[part], G[part], np.ones(len(part))], axis=1) @ self.planes.T
            index[part] = height.argmax(axis=1)
            best[part] = height[np.arange(len(part)), index[part]]


def envelope_of(S: Array, h: Array, box: Array) -> Envelope:
    """The map of the half-spaces S (m, 3) of unit trace, h (m,), over the box [[D, G] least, [D, G] most]."""
    planes = np.ascontiguousarray(np.stack([S[:, 0] - S[:, 2], 2.0 * S[:, 1], -h], axis=1))
    size = (box[1] - box[0]) / CELLS
    few, crowd = np.zeros((CELLS[0] * CELLS[1], FEW), np.intp), np.full(CELLS[0] * CELLS[1], -1)
    many: list[Index] = []
    for i in range(0, CELLS[0], COARSE):
        for j in range(0, CELLS[1], COARSE):
            near = highest_somewhere(planes, box[0] + size * [i, j], size * COARSE)
            for k in range(i, i + COARSE):
                for l in range(j, j + COARSE):
                    found = near[highest_somewhere(planes[near], box[0] + size * [k, l], size)]
                    cell = k * CELLS[1] + l
                    few[cell] = np.resize(found, FEW)
                    if len(found) > MANY:
                        crowd[cell] = -2
                    elif len(found) > FEW:
                        crowd[cell] = len(many)
                        many.append(np.resize(found, MANY))
    slots = np.ascontiguousarray(planes.T[:, few.T])
    return Envelope(planes, box[0], 1.0 / size, few, slots, crowd, np.array(many, np.intp).reshape(-1, MANY))


def highest_somewhere(planes: Array, corner: Array, size: Array) -> Index:
    """Numbers of the planes (m, 3) that may be highest in the rectangle: none that one other exceeds all over it."""
    x = corner + size * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 0.5]])
    height = x @ planes[:, :2].T + planes[:, 2]
    rivals = np.unique(height.argmax(axis=1))
    lead = (height[:4, :, None] - height[:4, None, rivals]).max(axis=0)
    return np.flatnonzero((lead >= -1e-15).all(axis=1))
