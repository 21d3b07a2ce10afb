"""The answer of a finite mesh: where every ring is, which forces its contacts carry, and how good that is."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from rve.common.errors import InputError, require
from rve.common.types import Array
from rve.finite.equations import gradients, spread
from rve.finite.layout import FiniteMesh
from rve.finite.records import SENTENCES, FiniteOptions, Found, Record, Task
from rve.finite.solver import solve_rings
from rve.finite.touching import Placed, find_touching, links_intact
from rve.geometry.circles import tangent_frame
from rve.localization.files import LINE, write_ring_vtu

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TINY = 1e-9


@dataclass(frozen=True, eq=False)
class FiniteSolution:
    """Rings of a finite mesh in equilibrium.

    centre, normal (n, 3): centres in mm and unit normals; load, reaction (n, 3): dead forces and forces of the supports
    in N; pairs (m, 2): rings a < b of each contact, with its unit normal from a to b (m, 3), the force (m,) in N with
    which they push each other apart, and the gap (m,) in mm.

    status "converged": a local minimum of the potential. `message` says what each status means. kkt_residual: the
    largest of unbalanced force over load, force times gap over (links times mean force), and overlap over r1.
    """

    mesh: FiniteMesh
    centre: Array
    normal: Array
    load: Array
    reaction: Array
    pairs: NDArray[np.intp]
    contact_normal: Array
    force: Array
    gap: Array
    status: str
    is_space: bool
    links_intact: bool
    min_gap_mm: float
    kkt_residual: float
    iterations: int
    wall_s: float
    history: tuple[Record, ...]

    @property
    def message(self) -> str:
        """What the status means, and what to try."""
        return SENTENCES[self.status]

    @property
    def potential(self) -> float:
        """-sum load . (x - X) in N mm."""
        X = np.column_stack([self.mesh.X, np.zeros(len(self.mesh.X))])
        return float(-(self.load * (self.centre - X)).sum())

    @property
    def mean_height(self) -> float:
        """Mean of y over the reference area, mm."""
        return float(self.mesh.area @ self.centre[:, 1] / self.mesh.area.sum())

    @property
    def largest_force(self) -> Array:
        """Largest contact force (n,) in N on each ring."""
        out = np.zeros(len(self.centre))
        for side in self.pairs.T:
            np.maximum.at(out, side, self.force)
        return out

    def line_load(self, group: NDArray[np.intp], area: Array) -> Array:
        """First Piola-Kirchhoff line load P (k, 3, 2) in N/mm of parts of the mesh: the virial of contact forces.

        group (n,): the part 0 ... k - 1 that each ring belongs to; area (k,): reference areas in mm2. A contact between
        two parts counts half in each. P = -sum of force normal x (X_b - X_a) over the area.
        """
        branch = self.mesh.X[self.pairs[:, 1]] - self.mesh.X[self.pairs[:, 0]]
        pull = (-0.5 * self.force[:, None] * self.contact_normal)[:, :, None] * branch[:, None, :]
        out = np.zeros((len(area), 3, 2))
        for side in self.pairs.T:
            np.add.at(out, group[side], pull)
        return np.asarray(out / area[:, None, None])

    def write_vtu(self, path: Path) -> None:
        """Centre lines of all rings with numbers per ring, for ParaView."""
        data: dict[str, Any] = {
            "ring": np.arange(len(self.centre)),
            "class_i_j": self.mesh.index,
            "contact_force_N": self.largest_force,
            "support_force_N": self.reaction,
            "reference_mm": np.column_stack([self.mesh.X, np.zeros(len(self.centre))]),
        }
        cell = self.mesh.cell
        write_ring_vtu(path, (self.centre, self.normal), (cell.r1, cell.r2), data, LINE)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Every ring in the plane x, y, coloured by its largest contact force, on `ax` or axes of their own."""
        require("matplotlib", "plots", "plot()", "write rings.vtu and read it in another program")
        import matplotlib.pyplot as plt
        from matplotlib.collections import LineCollection

        if ax is None:
            ax = plt.subplots(figsize=(8, 8), layout="constrained")[1]
        e1, e2 = tangent_frame(self.normal)
        t = np.linspace(0.0, 2.0 * np.pi, 25)[None, :, None]
        lines = self.centre[:, None] + self.mesh.cell.r1 * (np.cos(t) * e1[:, None] + np.sin(t) * e2[:, None])
        rings = LineCollection(list(lines[:, :, :2]), array=self.largest_force, cmap="viridis", linewidths=0.8)
        ax.add_collection(rings)
        ax.autoscale()
        ax.set(aspect="equal", xlabel="x (mm)", ylabel="y (mm)")
        ax.figure.colorbar(rings, ax=ax, label="largest contact force on the ring (N)")
        return ax

    def __str__(self) -> str:
        return f"FiniteSolution: {self.status}, {len(self.centre)} rings, mean height {self.mean_height:.3f} mm"


def solve_mesh(
    mesh: FiniteMesh,
    force: Array,
    held: NDArray[np.bool_],
    at: Array,
    *,
    space: bool = True,
    options: FiniteOptions | None = None,
    say: Callable[[Record], None] | None = None,
) -> FiniteSolution:
    """See `FiniteMesh.solve`."""
    began = time.perf_counter()
    options = options or FiniteOptions()
    n, r1 = len(mesh.X), mesh.cell.r1
    force, at = np.asarray(force, dtype=float), np.asarray(at, dtype=float)
    held = np.asarray(held, dtype=bool) | (np.array([False, False, not space]))
    _check(mesh, force, held, at)
    at = at if space else at * [1.0, 1.0, 0.0]
    size = float(np.hypot(*np.ptp(mesh.X, axis=0)))
    unit = np.abs(force).sum() * size / (len(mesh.linked) * r1)
    free = np.ones((n, 5), dtype=bool)
    free[:, :3] = ~held
    task = Task(mesh.linked, mesh.cell.wire, force / unit, held, at / r1, free)
    found = solve_rings(task, _start(mesh, held, at, space, options), options, say)
    return _solution(mesh, task, found, unit, space, time.perf_counter() - began)


def _start(mesh: FiniteMesh, held: NDArray[np.bool_], at: Array, space: bool, options: FiniteOptions) -> Placed:
    """The slack weave, as near to the held places as a translation brings it; in space with a disturbance in z."""
    centre, normal = mesh.slack()
    for axis in range(3):
        rows = held[:, axis]
        if rows.any():
            centre[:, axis] += (at[rows, axis] - centre[rows, axis]).mean()
    x = centre / mesh.cell.r1
    if space:
        shift = options.disturbance * np.random.default_rng(options.seed).uniform(-1.0, 1.0, len(x))
        x[:, 2] += np.where(held[:, 2], 0.0, shift)
    return Placed(x, normal)


def _check(mesh: FiniteMesh, force: Array, held: NDArray[np.bool_], at: Array) -> None:
    """InputError for arrays of other shapes, no load, or a piece that nothing holds against its load."""
    n = len(mesh.X)
    for name, array in (("force", force), ("held", held), ("at", at)):
        if array.shape != (n, 3):
            raise InputError(f"{name}: has shape {array.shape}, it must be ({n}, 3), one row per ring")
    if not (np.isfinite(force).all() and np.isfinite(at[held]).all()):
        raise InputError("force and places must be finite numbers")
    total = np.abs(force).sum()
    if not total > 0.0:
        raise InputError("the mesh carries no load, so that it has no shape; give it weight or a pull")
    graph = coo_matrix((np.ones(len(mesh.linked)), mesh.linked.T), shape=(n, n))
    count, label = connected_components(graph, directed=False)
    for piece in range(count):
        rings = np.flatnonzero(label == piece)
        for axis in range(3):
            push = float(force[rings, axis].sum())
            if abs(push) > _TINY * total and not held[rings, axis].any():
                x, y = mesh.X[rings].mean(axis=0)
                raise InputError(
                    f"nothing carries the force of {push:.6g} N along {'xyz'[axis]} on the piece around "
                    f"({x:g}, {y:g}) mm, it would move for ever; hold one of its rings"
                )


def _solution(mesh: FiniteMesh, task: Task, found: Found, unit: float, space: bool, wall: float) -> FiniteSolution:
    r1, con = mesh.cell.r1, found.touching
    check = find_touching(found.placed, task.linked, task.wire, 0.1)
    lowest = r1 * float(check.deepest.min(initial=np.inf))
    G = gradients(found.placed, con)
    total = spread(con, G, found.force, len(mesh.X))[:, :3] + task.force
    pair = con.minima.pair
    return FiniteSolution(
        mesh=mesh,
        centre=r1 * found.placed.x,
        normal=found.placed.normal,
        load=unit * task.force,
        reaction=np.where(task.held, -unit * total, 0.0),
        pairs=np.column_stack([con.a[pair], con.b[pair]]),
        contact_normal=con.minima.normal,
        force=unit * found.force,
        gap=r1 * con.gap,
        status=found.status,
        is_space=space,
        links_intact=links_intact(found.placed, check, task.keys),
        min_gap_mm=lowest,
        kkt_residual=max(found.residual, -lowest / r1),
        iterations=len(found.history),
        wall_s=wall,
        history=found.history,
    )
