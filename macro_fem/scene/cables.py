"""Edges that slide on straight lines in any direction: cables, sloping rails.

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

    def columns(self, n_nodes: int) -> sparse.csc_matrix:
        """The columns (n_nodes * d, m) of T that these nodes have."""
        m, d = self.direction.shape
        rows = d * self.nodes[:, None] + np.arange(d)
        entries = (self.direction.ravel(), (rows.ravel(), np.repeat(np.arange(m), d)))
        return sparse.coo_matrix(entries, shape=(n_nodes * d, m)).tocsc()

    def tied(self, tie: sparse.csc_matrix | None, free: np.ndarray) -> sparse.csc_matrix:
        """T with these columns at its end; without `tie` the components `free` (n_nodes, d) are the first ones."""
        if tie is None:
            own = np.flatnonzero(free)
            tie = sparse.csc_matrix((np.ones(len(own)), (own, np.arange(len(own)))), shape=(free.size, len(own)))
        return sparse.hstack([tie, self.columns(len(free))]).tocsc()

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


def unit_direction(along: tuple[tuple[float, ...], ...]) -> Array:
    """The unit vector from the first to the second point of a line; an axis exactly where the line is along it."""
    way = np.subtract(along[1], along[0])
    e = way / np.linalg.norm(way)
    axis = int(np.argmax(np.abs(e)))
    return np.eye(len(e))[axis] if 1.0 - abs(e[axis]) < PARALLEL**2 else e


def sloping(direction: Array) -> bool:
    """Whether a unit vector is along no axis."""
    return bool(np.count_nonzero(direction) > 1)
