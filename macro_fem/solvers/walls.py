"""Half-spaces on points of the curtain, normal . x >= offset: floors, walls, and the tangent planes of bodies.

Each is a linear cone of the program in `cone_program`. With the size of the curtain as unit its slack is
s = (normal . x - offset) / size, its dual variable u in N/mm counts for the reference area of its point like the
multipliers of the law, and the reaction is area u / size, a push along the normal in N.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from macro_fem.fem.supported import SupportedFem
from rve.common import Array

TOUCHED = 1e-9
"""Relative to the size: by how much a node that no unknown moves may be outside its half-space."""


@dataclass(frozen=True, eq=False)
class Walls:
    """Half-spaces normal . x >= offset for the points `at` (m, n_nodes), shares of nodes: unit normals (m, d), offset
    (m,) in mm; owner (m,): the number of the obstacle that each one belongs to.
    """

    at: sparse.csr_matrix
    normal: Array
    offset: Array
    owner: np.ndarray

    @classmethod
    def none(cls, shape: tuple[int, ...]) -> Walls:
        """No half-spaces on nodes at x of a shape (n_nodes, d)."""
        return cls(sparse.csr_matrix((0, shape[0])), np.zeros((0, shape[1])), np.zeros(0), np.zeros(0, int))

    @classmethod
    def joined(cls, parts: Sequence[Walls]) -> Walls:
        """All half-spaces of one or more parts, of all nodes or the first ones."""
        n, ats = max(part.at.shape[1] for part in parts), [part.at for part in parts]
        wide = [sparse.csr_matrix((at.data, at.indices, at.indptr), shape=(at.shape[0], n)) for at in ats]
        each = ([getattr(part, name) for part in parts] for name in ("normal", "offset", "owner"))
        return cls(sparse.vstack(wide, format="csr"), *map(np.concatenate, each))

    def take(self, which: np.ndarray) -> Walls:
        """Some of the half-spaces, by number or by flag."""
        return Walls(self.at[which], self.normal[which], self.offset[which], self.owner[which])

    def __len__(self) -> int:
        return len(self.offset)

    def gap(self, x: Array) -> Array:
        """Distance (m,) of the points of nodes x (n_nodes, d) from their planes, mm; negative where they crossed."""
        return np.asarray((self.normal * (self.at @ x)).sum(axis=1) - self.offset)

    @property
    def matrix(self) -> sparse.csr_matrix:
        """normal . x of the points (m, n_nodes d) of all components of nodes."""
        at, d = self.at, self.normal.shape[1]
        component = d * at.indices[:, None] + np.arange(d)
        share = at.data[:, None] * np.repeat(self.normal, np.diff(at.indptr), axis=0)
        shape = (at.shape[0], d * at.shape[1])
        return sparse.csr_matrix((share.ravel(), component.ravel(), d * at.indptr), shape=shape)

    def nodal(self, force: Array) -> Array:
        """Nodal forces (n_nodes, d) of pushes `force` (m,) along the normals, N."""
        return np.asarray(self.matrix.T @ force).reshape(self.at.shape[1], -1)

    def is_movable(self, fem: SupportedFem) -> np.ndarray:
        """Which half-spaces (m,) some unknown moves a point of along the normal; the others hold or do not."""
        return np.asarray(abs(self.matrix @ fem.T).sum(axis=1)).ravel() > 1e-12

    def stuck(self, fem: SupportedFem) -> float:
        """How deep points that no unknown moves along the normal are beyond their half-spaces, mm; 0 if none is."""
        return float((-self.take(~self.is_movable(fem)).gap(fem.x_held)).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class WallRows:
    """The half-spaces of `walls` that unknowns can meet as rows of a program; there may be none. The others must hold.

    Slacks s = A z + b0 are in units of `size` mm, weights v (m,) in mm2.
    """

    fem: SupportedFem
    walls: Walls
    size: float

    @cached_property
    def is_row(self) -> np.ndarray:
        """Which half-spaces are rows."""
        return self.walls.is_movable(self.fem)

    @cached_property
    def rows(self) -> Walls:
        """The half-spaces that are rows."""
        return self.walls.take(self.is_row)

    @cached_property
    def A(self) -> sparse.csr_matrix:
        """Unknowns to slacks (m, n)."""
        return (self.rows.matrix @ self.fem.T / self.size).tocsr()

    @cached_property
    def v(self) -> Array:
        """Reference area around the point of each row (m,), mm2; that of a node in the mean where there is none."""
        disc = self.fem.disc
        local = disc.cell_dofs.shape[1]
        around = np.bincount(disc.cell_dofs.ravel(), np.repeat(disc.cell_area / local, local), disc.n_nodes)
        v = abs(self.rows.at) @ around
        return np.asarray(np.where(v > 0.0, v, around.mean()))

    def slack(self, z: Array) -> Array:
        """A z + b0 (m,)."""
        return self.rows.gap(self.fem.positions(z)) / self.size

    def force(self, u: Array) -> Array:
        """A^T (v u) (n,), N: the forces on the unknowns of dual variables u (m,)."""
        return np.asarray(self.A.T @ (self.v * u))

    def reactions(self, u: Array) -> Array:
        """The pushes of all half-spaces, N, at dual variables u (m,): none of those that are no rows."""
        out = np.zeros(len(self.walls))
        out[self.is_row] = self.v * u / self.size
        return out

    def added(self, weight: Array) -> sparse.csc_matrix:
        """A^T (v weight) A (n, n): what the rows of these weights (m,) add to Newton's matrix."""
        return (self.A.T @ self.A.multiply((self.v * weight)[:, None])).tocsc()


def longest(s: Array, ds: Array) -> float:
    """The largest t with s + t ds >= 0 for s > 0; infinite if there is no limit."""
    falls = ds < 0.0
    return float((-s[falls] / ds[falls]).min(initial=np.inf))
