"""Half-spaces on points of the curtain, normal . x >= offset: floors, walls, and the tangent planes of bodies.

A point is a node or between nodes of one cell, x = sum of share times node. Each half-space is a linear cone of the
program in `cone_program`. With the size of the curtain as unit its slack is s = (normal . x - offset) / size, its dual
variable u in N/mm counts for the reference area of its point like the multipliers of the law, and the reaction is
area u / size, a push along the normal in N.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from macro_fem.fem.supported import SupportedFem
from rve.common.types import Array

TOUCHED = 1e-9
"""Relative to the size: by how much a node that no unknown moves may be outside its half-space, as rounding."""


@dataclass(frozen=True, eq=False)
class Walls:
    """Half-spaces normal . x >= offset: unit normals (m, d), offset (m,) in mm; a point may have several.

    node (m, k) and share (m, k): the nodes that each point x = sum of share times node is made of; nodes (m,) alone are
    the points themselves. owner (m,): numbers that tell which obstacle each one belongs to, 0 where they are not given.
    """

    node: np.ndarray
    normal: Array
    offset: Array
    owner: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    share: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        if len(self.owner) != len(self.node):
            object.__setattr__(self, "owner", np.zeros(len(self.node), np.int64))
        if self.node.ndim == 1:
            object.__setattr__(self, "node", self.node[:, None])
        if self.share.shape != self.node.shape:
            object.__setattr__(self, "share", np.ones(self.node.shape))

    @classmethod
    def joined(cls, parts: Sequence[Walls]) -> Walls | None:
        """All half-spaces of some parts; None if there is none."""
        if not sum(map(len, parts)):
            return None
        k = max(part.node.shape[1] for part in parts)
        more = [((0, 0), (0, k - part.node.shape[1])) for part in parts]
        return cls(
            np.concatenate([np.pad(part.node, by) for part, by in zip(parts, more, strict=True)]),
            np.concatenate([part.normal for part in parts]),
            np.concatenate([part.offset for part in parts]),
            np.concatenate([part.owner for part in parts]),
            np.concatenate([np.pad(part.share, by) for part, by in zip(parts, more, strict=True)]),
        )

    def __len__(self) -> int:
        return len(self.node)

    def places(self, x: Array) -> Array:
        """Places (m, d) of the points of nodes at x (n_nodes, d)."""
        return np.asarray((self.share[:, :, None] * x[self.node]).sum(axis=1))

    def gap(self, x: Array) -> Array:
        """Distance (m,) of the points of nodes x (n_nodes, d) from their planes, mm; negative where they have
        crossed."""
        return np.asarray((self.normal * self.places(x)).sum(axis=1) - self.offset)

    def nodal(self, force: Array, n_nodes: int) -> Array:
        """Nodal forces (n_nodes, d) of pushes `force` (m,) along the normals, N."""
        out = np.zeros((n_nodes, self.normal.shape[1]))
        np.add.at(out, self.node, self.share[:, :, None] * (force[:, None] * self.normal)[:, None, :])
        return out

    def scaled(self, factor: float) -> Walls:
        """The half-spaces of a curtain whose positions are `factor` times as large."""
        return replace(self, offset=factor * self.offset)

    def only(self, keep: np.ndarray) -> Walls:
        """The half-spaces chosen by a mask or by numbers."""
        return Walls(self.node[keep], self.normal[keep], self.offset[keep], self.owner[keep], self.share[keep])

    def is_movable(self, fem: SupportedFem) -> np.ndarray:
        """Which half-spaces (m,) some unknown moves a point of along the normal; the others hold or do not."""
        if fem.tie is None:
            moves = np.abs(self.normal)[:, None, :] * np.abs(self.share)[:, :, None] * ~fem.held[self.node]
            return np.asarray(moves.sum(axis=(1, 2)) > 1e-12)
        m, d = self.normal.shape
        entries = self.share[:, :, None] * self.normal[:, None, :]
        columns = (d * self.node[:, :, None] + np.arange(d)).reshape(m, -1)
        rows = np.repeat(np.arange(m), columns.shape[1])
        A = sparse.csr_matrix((entries.ravel(), (rows, columns.ravel())), shape=(m, fem.x_held.size))
        return np.asarray(abs(A @ fem.tie).sum(axis=1)).ravel() > 1e-12

    def stuck(self, fem: SupportedFem) -> float:
        """How deep points that no unknown moves along the normal are beyond their half-spaces, mm; 0 if none is."""
        return float((-self.only(~self.is_movable(fem)).gap(fem.x_held)).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class WallRows:
    """The half-spaces as rows of a program: slacks s = A z + b0 without unit, weights v (m,) in mm2."""

    fem: SupportedFem | None
    walls: Walls | None
    size: float = 1.0

    @cached_property
    def v(self) -> Array:
        """Reference area around the point of each row (m,), mm2."""
        if self.fem is None or self.walls is None:
            return np.zeros(0)
        disc = self.fem.disc
        local = disc.cell_dofs.shape[1]
        around = np.bincount(disc.cell_dofs.ravel(), np.repeat(disc.cell_area / local, local), disc.n_nodes)
        return np.asarray((np.abs(self.walls.share) * around[self.walls.node]).sum(axis=1))

    def slack(self, z: Array) -> Array:
        """A z + b0 (m,)."""
        if self.fem is None or self.walls is None:
            return np.zeros(0)
        return self.walls.gap(self.fem.positions(z)) / self.size

    def change(self, dz: Array) -> Array:
        """A dz (m,)."""
        if self.fem is None or self.walls is None:
            return np.zeros(0)
        return np.asarray((self.walls.normal * self.walls.places(self.fem.spread(dz))).sum(axis=1) / self.size)

    def force(self, u: Array) -> Array | float:
        """A^T (v u) (n,), N: the forces on the unknowns of dual variables u (m,); 0 without rows."""
        if self.fem is None or self.walls is None:
            return 0.0
        return self.fem.gather(self.walls.nodal(self.reaction(u), self.fem.disc.n_nodes))

    def reaction(self, u: Array) -> Array:
        """The pushes (m,) of dual variables u (m,), N."""
        return np.asarray(self.v * u / self.size)

    def added(self, weight: Array) -> Array | None:
        """A^T (v weight) A as data of the lower triangle of `fem.pattern`; None without rows."""
        if self.fem is None or self.walls is None:
            return None
        place, row, value = self._products
        scaled = self.v * weight / self.size**2
        return np.asarray(np.bincount(place, value * scaled[row], minlength=self.fem.pattern.nnz), dtype=np.float64)

    @cached_property
    def _products(self) -> tuple[np.ndarray, np.ndarray, Array]:
        """Place in the lower triangle, row and value (k,) of the products of any two entries of every row."""
        assert self.fem is not None
        assert self.walls is not None
        pattern, walls = self.fem.pattern, self.walls
        number = np.full(self.fem.x_held.size, -1)
        number[pattern.free] = np.arange(pattern.n)
        m, d = walls.normal.shape
        column = number[d * walls.node[:, :, None] + np.arange(d)].reshape(m, -1)
        entry = (walls.share[:, :, None] * walls.normal[:, None, :]).reshape(m, -1)
        column = np.where(entry != 0.0, column, -1)
        places, rows, values = [], [], []
        for a, b in np.ndindex(column.shape[1], column.shape[1]):
            i, j = column[:, a], column[:, b]
            row = np.flatnonzero((j >= 0) & (i >= j))
            places.append(pattern.place(i[row], j[row]))
            rows.append(row)
            values.append(entry[row, a] * entry[row, b])
        return np.concatenate(places), np.concatenate(rows), np.concatenate(values)


NO_ROWS = WallRows(None, None)
"""The rows of a program without half-spaces on points."""


def rows_of(fem: SupportedFem, walls: Walls | None, size: float) -> WallRows:
    """The rows of half-spaces that unknowns can meet, in units of `size` mm.

    ValueError if a held node is beyond one that no unknown moves.
    """
    if walls is None or not len(walls):
        return NO_ROWS
    can = walls.is_movable(fem)
    beyond = walls.stuck(fem)
    if beyond > TOUCHED * size:
        raise ValueError(f"a held node is {beyond:g} mm beyond a half-space")
    return WallRows(fem, walls.only(can), size) if can.any() else NO_ROWS


def all_forces(walls: Walls | None, fem: SupportedFem, rows: WallRows, u: Array) -> Array:
    """The reactions (m,) of all half-spaces, N: zero for those that are no rows."""
    if walls is None:
        return np.zeros(0)
    out = np.zeros(len(walls))
    if rows.walls is not None:
        out[walls.is_movable(fem)] = rows.reaction(u)
    return out


def longest(s: Array, ds: Array) -> float:
    """The largest t with s + t ds >= 0 for s > 0; infinite if there is no limit."""
    falls = ds < 0.0
    return float((-s[falls] / ds[falls]).min(initial=np.inf))
