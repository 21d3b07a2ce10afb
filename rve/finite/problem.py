"""What a finite mesh is asked for: its forces, what holds it, where it starts, and its equations without units."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, identity
from scipy.sparse.csgraph import connected_components

from rve.common import Array, Flags, InputError
from rve.finite.layout import FiniteMesh
from rve.finite.task import BLOCK, FiniteOptions, Task
from rve.finite.touching import Placed, find_touching
from rve.finite.walls import HalfSpace, Obstacle, RoundBody

_TINY = 1e-9
_MOST = 0.25
"""Largest disturbance of the start over its least gap: near jamming there is less room than was asked for."""
_CLEAR = 0.3
"""Distance in r1 of the start from half-spaces that would cut it."""


@dataclass(frozen=True, eq=False)
class Problem:
    """What a mesh is asked for, see `FiniteMesh.solve`; force, held, at, guide (n, 3) in N and mm.

    Where the mesh is not in space the plane keeps the third coordinate of all rings."""

    mesh: FiniteMesh
    force: Array
    held: Flags
    at: Array
    is_space: bool
    walls: tuple[Obstacle, ...] = ()
    guide: Array | float = np.nan

    def check(self) -> None:
        """InputError for arrays of other shapes, no load, or a piece that nothing holds against its load."""
        mesh, force, n = self.mesh, self.force, len(self.mesh.X)
        for name, array in (("force", force), ("held", self.held), ("at", self.at), ("guide", self.guide)):
            if np.shape(array) != (n, 3):
                raise InputError(f"{name}: has shape {np.shape(array)}, it must be ({n}, 3), one row per ring")
        if not np.isfinite([*force.ravel(), *self.at[self.held]]).all() or np.isinf(self.guide).any():
            raise InputError("force, places and guide must be finite numbers; nan in a guide is none")
        if not np.abs(force).sum() > 0.0:
            raise InputError("the mesh carries no load, so that it has no shape; give it weight or a pull")
        on_bars = np.concatenate([*mesh.bars, np.zeros(0, dtype=np.intp)])
        if self.held[on_bars].any() or len(np.unique(on_bars)) < len(on_bars):
            raise InputError("a ring of a straight bar is held or has a second bar; leave one of them out")
        for bar in mesh.bars:
            X = mesh.X[bar]
            across = X - X[0] - along(X)[:, None] * (X[-1] - X[0])
            if len(bar) < 2 or np.abs(across).max() > 1e-4 * mesh.cell.r1:
                raise InputError("the rings of a bar lie on no line; let the outline be whole cells of the weave")
        graph = coo_matrix((np.ones(len(mesh.linked)), mesh.linked.T), shape=(n, n))
        count, label = connected_components(graph, directed=False)
        for piece in range(count):
            rings = np.flatnonzero(label == piece)
            for axis in range(3):
                push = float(force[rings, axis].sum())
                is_kept = self.held[rings, axis].any() or (axis == 2 and not self.is_space)
                is_kept |= any(isinstance(w, HalfSpace) and w.unit[axis] * push < 0.0 for w in self.walls)
                if abs(push) > _TINY * np.abs(force).sum() and not is_kept:
                    x, y = mesh.X[rings].mean(axis=0)
                    raise InputError(
                        f"nothing carries the force of {push:.6g} N along {'xyz'[axis]} on the piece around "
                        f"({x:g}, {y:g}) mm, it would move for ever; hold one of its rings"
                    )

    def _motions(self, free: Flags) -> csr_matrix:
        """The motions of `Task` for free coordinates (n, 5); on a bar, x = (1 - s) x_first + s x_last."""
        T, is_own = identity(free.size, format="lil"), free.copy()
        for bar in self.mesh.bars:
            is_own[bar[1:-1], :3] = False
            for ring, share in zip(bar[1:-1], along(self.mesh.X[bar])[1:-1], strict=True):
                for axis in range(3):
                    row, first, last = BLOCK * np.array([ring, bar[0], bar[-1]]) + axis
                    T[row, row], T[row, first], T[row, last] = 0.0, 1.0 - share, share
        return csr_matrix(T)[:, np.flatnonzero(is_own)]

    def start(self, options: FiniteOptions) -> Placed:
        """The slack weave, as near to the held places as a translation brings it; in space with a disturbance in z.

        Half-spaces that it cuts begin farther back.
        """
        mesh, r1 = self.mesh, self.mesh.cell.r1
        centre, normal = mesh.slack()
        for axis in range(3 if self.is_space else 2):
            rows = self.held[:, axis]
            if rows.any():
                centre[:, axis] += (self.at[rows, axis] - centre[rows, axis]).mean()
        x = centre / r1
        if self.is_space:
            clear = find_touching(Placed(x, normal), mesh.linked, mesh.cell.wire, options.disturbance / _MOST)
            most = min(options.disturbance, _MOST * float(clear.deepest.min(initial=np.inf)))
            shift = most * np.random.default_rng(options.seed).uniform(-1.0, 1.0, len(x))
            x[:, 2] += np.where(self.held[:, 2], 0.0, shift)
        for bar in self.mesh.bars:
            x[bar] = x[bar[0]] + along(mesh.X[bar])[:, None] * (x[bar[-1]] - x[bar[0]])
        placed = self.placed(r1 * x, normal)
        for place, m in zip(placed.x[len(x) :], placed.normal[len(x) :], strict=True):
            lowest = float(((x - place) @ m - np.sqrt(1.0 - np.minimum((normal @ m) ** 2, 1.0))).min())
            place += min(0.0, lowest - _CLEAR) * m
        return placed

    def placed(self, centre: Array, normal: Array) -> Placed:
        """Rings with centres (n, 3) in mm and normals (n, 3), and the rows of half-spaces and balls."""
        cell, rows = self.mesh.cell, [wall.row(self.mesh.cell.r2) for wall in self.walls]
        place, unit = (np.array([row[k] for row in rows]).reshape(-1, 3) for k in (0, 1))
        radius = np.array([row[2] for row in rows]) / cell.r1
        return Placed(np.concatenate([centre, place]) / cell.r1, np.concatenate([normal, unit]), radius)

    def task(self, load: float | None = None) -> Task:
        """The equations without units, rows of half-spaces, held, and of balls after the rings.

        load: what residuals and mu are measured by, N; the sum of the dead loads if None.
        """
        mesh, r1, n, k = self.mesh, self.mesh.cell.r1, len(self.mesh.X), len(self.walls)
        load = float(np.abs(self.force).sum()) if load is None else load
        unit = load * float(np.hypot(*np.ptp(mesh.X, axis=0))) / (len(mesh.linked) * r1)
        loose = np.array([[isinstance(wall, RoundBody)] * 3 for wall in self.walls], dtype=bool).reshape(k, 3)
        free = np.zeros((n + k, BLOCK), dtype=bool)
        free[:n], free[n:, :3] = True, loose
        kept = self.held | np.array([False, False, not self.is_space])
        free[:n, :3] = ~kept
        at = self.at if self.is_space else self.at * [1.0, 1.0, 0.0]
        force = np.concatenate([self.force, np.array([wall.load for wall in self.walls]).reshape(k, 3)]) / unit
        held = np.concatenate([kept, ~loose])
        guide = np.concatenate([np.broadcast_to(self.guide, (n, 3)) / r1, np.full((k, 3), np.nan)])
        at, size = self.placed(at, at).x, load / unit
        motions = self._motions(free)
        return Task(mesh.linked, mesh.cell.wire, force, held, at, motions, guide=guide, load=size, unit=unit)


def along(X: Array) -> Array:
    """How far points (k, 2) are from the first to the last, as parts (k,) of that way."""
    way = X[-1] - X[0]
    return np.asarray((X - X[0]) @ way / (way @ way))
