"""Edges that lie on curves and lines in space, and slide on straight ones in any direction: cables, sloping rails.

A node that slides on a line along the unit vector e is at x = x_held + e s with one unknown s: a column of T. On a line
along an axis the component is simply free, and needs no column. A node on two lines that cross, or on a line and held
as a whole by another support, is held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from rve.common.types import Array

PARALLEL = 1e-9
"""Unit vectors that differ by less than this are one direction."""


@dataclass(frozen=True, eq=False)
class Sliding:
    """Nodes (m,) that slide along unit vectors `direction` (m, d)."""

    nodes: np.ndarray
    direction: Array

    @classmethod
    def none(cls, d: int) -> Sliding:
        """No node."""
        return cls(np.zeros(0, np.int64), np.zeros((0, d)))

    def columns(self, n_nodes: int) -> sparse.csc_matrix:
        """The columns (n_nodes * d, m) of T that these nodes have."""
        m, d = self.direction.shape
        rows = d * self.nodes[:, None] + np.arange(d)
        some = self.direction.ravel() != 0.0
        entries = (self.direction.ravel()[some], (rows.ravel()[some], np.repeat(np.arange(m), d)[some]))
        return sparse.coo_matrix(entries, shape=(n_nodes * d, m)).tocsc()

    def tied(self, tie: sparse.csc_matrix | None, free: np.ndarray) -> sparse.csc_matrix:
        """T with these columns at its end; without `tie` the components `free` (n_nodes, d) are the first ones."""
        if tie is None:
            own = np.flatnonzero(free)
            tie = sparse.csc_matrix((np.ones(len(own)), (own, np.arange(len(own)))), shape=(free.size, len(own)))
        return sparse.hstack([tie, self.columns(len(free))]).tocsc()

    def without(self, nodes: np.ndarray) -> Sliding:
        """The same without some of the nodes."""
        others = ~np.isin(self.nodes, nodes)
        return Sliding(self.nodes[others], self.direction[others])

    def along(self, force: Array) -> Array:
        """The components (m,) of nodal forces (n_nodes, d) along the directions."""
        return np.asarray((force[self.nodes] * self.direction).sum(axis=1))

    def common(self, nodes: np.ndarray) -> Array | None:
        """The direction (d,) in which all of these nodes slide; None if they have no single one, or some do not slide.

        >>> one = Sliding(np.array([3, 5]), np.array([[0.6, 0.8, 0.0], [-0.6, -0.8, 0.0]]))
        >>> one.common(np.array([5, 3])).tolist()
        [0.6, 0.8, 0.0]
        """
        own = np.isin(self.nodes, nodes)
        if own.sum() != len(nodes) or not own.any():
            return None
        directions = self.direction[own]
        aligned = np.abs(np.abs(directions @ directions[0]) - 1.0) < PARALLEL
        return directions[0] if aligned.all() else None


def sliding_nodes(lines: list[tuple[np.ndarray, Array]], whole: np.ndarray) -> Sliding:
    """The nodes that slide: those of lines (nodes (k,), unit vector (d,)) that lie on no second, crossing one.

    Nodes held as a `whole` (n_nodes,) do not slide.
    """
    way = np.zeros((len(whole), len(lines[0][1])))
    fixed = whole.copy()
    for nodes, e in lines:
        before = way[nodes]
        fixed[nodes] |= before.any(axis=1) & (np.abs(before @ e) < 1.0 - PARALLEL)
        way[nodes] = e
    free = np.flatnonzero(way.any(axis=1) & ~fixed)
    return Sliding(free, way[free])


def unit_direction(way: Array) -> Array:
    """The unit vector along a vector (d,); an axis exactly where it is along one."""
    e = way / np.linalg.norm(way)
    axis = int(np.argmax(np.abs(e)))
    return np.eye(len(e))[axis] if 1.0 - abs(e[axis]) < PARALLEL**2 else e


def sloping(direction: Array) -> bool:
    """Whether a unit vector is along no axis."""
    return bool(np.count_nonzero(direction) > 1)
