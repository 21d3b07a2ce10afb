"""The answer of a finite mesh: where every ring is, which forces its contacts carry, and how good that is."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from rve.common.drawing.page import write_page
from rve.common.drawing.views import View
from rve.common.errors import InputError, require
from rve.common.notebook import as_html
from rve.common.types import Array
from rve.finite.equations import gradients, spread
from rve.finite.layout import FiniteMesh
from rve.finite.records import SENTENCES, FiniteOptions, Found, Record, Task
from rve.finite.solver import solve_rings
from rve.finite.touching import Placed, find_touching, links_intact
from rve.finite.walls import HalfSpace
from rve.localization.files import LINE, write_ring_vtu

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TINY = 1e-9
_SEEN = 1e-3
"""Forces of supports below this part of the largest one are not drawn."""
_CLEAR = 0.3
"""Distance in r1 of the start from half-spaces that would cut it."""


@dataclass(frozen=True, eq=False)
class FiniteSolution:
    """Rings of a finite mesh in equilibrium.

    centre, normal (n, 3): centres in mm and unit normals; load, reaction (n, 3): dead forces and forces of the supports
    in N; pairs (m, 2): rings a < b of each contact, with its unit normal from a to b (m, 3), the force (m,) in N with
    which they push each other apart, and the gap (m,) in mm; walls: half-spaces, with the force wall_force (k, 3) in N
    of each on the rings. way_left_mm: how far a held ring or a half-space is from its place.

    status "converged": a local minimum of the potential. `message` says what each status means. kkt_residual: the
    largest of unbalanced force over load, force times gap over (links times mean force), and overlap over r1. Where
    supports or half-spaces are out of reach there is no equilibrium: forces are nan and kkt_residual is inf.
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
    walls: tuple[HalfSpace, ...]
    wall_force: Array
    status: str
    is_space: bool
    links_intact: bool
    min_gap_mm: float
    way_left_mm: float
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

    def __str__(self) -> str:
        return f"FiniteSolution: {self.status}, {len(self.centre)} rings, mean height {self.mean_height:.3f} mm"

    def _repr_html_(self) -> str:
        """What a notebook shows: status, what it means, and its numbers."""
        numbers = {
            "potential_N_mm": self.potential,
            "largest_contact_force_N": float(self.force.max(initial=0.0)),
            "min_gap_mm": self.min_gap_mm,
            "kkt_residual": self.kkt_residual,
            "iterations": self.iterations,
            "wall_s": self.wall_s,
        }
        return as_html(self, numbers, (self.message,))

    @property
    def largest_force(self) -> Array:
        """Largest contact force (n,) in N on each ring; nan where the solution has no forces."""
        if not np.isfinite(self.force).all():
            return np.full(len(self.centre), np.nan)
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
        """Centre lines of all rings with numbers per ring in double precision, for ParaView."""
        data: dict[str, Any] = {
            "ring": np.arange(len(self.centre)),
            "class_i_j": self.mesh.index,
            "centre_mm": self.centre,
            "normal": self.normal,
            "contact_force_N": self.largest_force,
            "support_force_N": self.reaction,
            "reference_mm": np.column_stack([self.mesh.X, np.zeros(len(self.centre))]),
        }
        cell = self.mesh.cell
        write_ring_vtu(path, (self.centre, self.normal), (cell.r1, cell.r2), data, LINE, precise=True)

    def view(self) -> View:
        """All rings in space, coloured by contact force, with the forces of the supports."""
        from rve.finite.view import finite_view

        return finite_view(self)

    def write_html(self, path: str | Path) -> None:
        """Write the rings as one HTML file that turns in a browser without a network; InputError without plotly."""
        write_page(path, self.view())

    def plot(self, ax: Axes | None = None) -> Axes:
        """Every ring in the plane x, y, coloured by its largest contact force, on `ax` or axes of their own."""
        require("matplotlib", "plots", "plot()", "write rings.vtu and read it in another program")
        from rve.localization.picture import plot_rings

        force = self.largest_force
        has_forces = bool(np.isfinite(force).all())
        ax = plot_rings(self.centre, self.normal, self.mesh.cell.r1, force if has_forces else None, ax, width=1.0)
        pulled = np.linalg.norm(np.nan_to_num(self.reaction), axis=1)
        held = pulled > _SEEN * pulled.max(initial=0.0)
        if held.any():
            ax.plot(*self.centre[held, :2].T, "v", color="#009e73", ms=10, mec="white", label="held rings")
            ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), frameon=False)
        ax.set_title(f"{len(self.centre)} rings: {self.status}\nmean height {self.mean_height:.1f} mm", fontsize=11)
        return ax


@dataclass(frozen=True, eq=False)
class Problem:
    """What a mesh is asked for, see `FiniteMesh.solve`; force, held, at, guide (n, 3) in N and mm."""

    mesh: FiniteMesh
    force: Array
    held: NDArray[np.bool_]
    at: Array
    is_space: bool
    walls: tuple[HalfSpace, ...] = ()
    guide: Array | None = None

    def check(self) -> None:
        """InputError for arrays of other shapes, no load, or a piece that nothing holds against its load."""
        mesh, force, n = self.mesh, self.force, len(self.mesh.X)
        guide = self.at if self.guide is None else self.guide
        for name, array in (("force", force), ("held", self.held), ("at", self.at), ("guide", guide)):
            if array.shape != (n, 3):
                raise InputError(f"{name}: has shape {array.shape}, it must be ({n}, 3), one row per ring")
        if not (np.isfinite(force).all() and np.isfinite(self.at[self.held]).all()):
            raise InputError("force and places must be finite numbers")
        if np.isinf(guide).any():
            raise InputError("guide: places must be finite numbers, or nan for none")
        if not np.abs(force).sum() > 0.0:
            raise InputError("the mesh carries no load, so that it has no shape; give it weight or a pull")
        graph = coo_matrix((np.ones(len(mesh.linked)), mesh.linked.T), shape=(n, n))
        count, label = connected_components(graph, directed=False)
        for piece in range(count):
            self._check_piece(np.flatnonzero(label == piece))

    def _check_piece(self, rings: NDArray[np.intp]) -> None:
        for axis in range(3):
            push = float(self.force[rings, axis].sum())
            stopped = any(wall.unit[axis] * push < 0.0 for wall in self.walls)
            if abs(push) > _TINY * np.abs(self.force).sum() and not (self.held[rings, axis].any() or stopped):
                x, y = self.mesh.X[rings].mean(axis=0)
                raise InputError(
                    f"nothing carries the force of {push:.6g} N along {'xyz'[axis]} on the piece around "
                    f"({x:g}, {y:g}) mm, it would move for ever; hold one of its rings"
                )

    def start(self, options: FiniteOptions) -> Placed:
        """The slack weave, as near to the held places as a translation brings it; in space with a disturbance in z.

        Half-spaces that it cuts begin farther back.
        """
        mesh, r1 = self.mesh, self.mesh.cell.r1
        centre, normal = mesh.slack()
        for axis in range(3):
            rows = self.held[:, axis]
            if rows.any():
                centre[:, axis] += (self.at[rows, axis] - centre[rows, axis]).mean()
        x = centre / r1
        if self.is_space:
            shift = options.disturbance * np.random.default_rng(options.seed).uniform(-1.0, 1.0, len(x))
            x[:, 2] += np.where(self.held[:, 2], 0.0, shift)
        places, units = self.planes()
        for place, m in zip(places, units, strict=True):
            lowest = float(((x - place) @ m - np.sqrt(1.0 - np.minimum((normal @ m) ** 2, 1.0))).min())
            place += min(0.0, lowest - _CLEAR) * m
        return Placed(np.concatenate([x, places]), np.concatenate([normal, units]), len(self.walls))

    def planes(self) -> tuple[Array, Array]:
        """Points (k, 3) in units of r1, r2 off the half-spaces, and unit normals (k, 3)."""
        units = np.array([wall.unit for wall in self.walls]).reshape(-1, 3)
        cell = self.mesh.cell
        off = np.array([wall.offset + cell.r2 for wall in self.walls]) / cell.r1
        return off[:, None] * units, units

    def task(self) -> tuple[Task, float]:
        """The equations without units, half-spaces as held rows after the rings; the unit of force in N."""
        mesh, r1, n, k = self.mesh, self.mesh.cell.r1, len(self.mesh.X), len(self.walls)
        unit = np.abs(self.force).sum() * float(np.hypot(*np.ptp(mesh.X, axis=0))) / (len(mesh.linked) * r1)
        free = np.zeros((n + k, 5), dtype=bool)
        free[:n] = True
        free[:n, :3] = ~self.held
        at = self.at if self.is_space else self.at * [1.0, 1.0, 0.0]
        force = np.concatenate([self.force / unit, np.zeros((k, 3))])
        held = np.concatenate([self.held, np.ones((k, 3), dtype=bool)])
        guide = None if self.guide is None else np.concatenate([self.guide / r1, np.full((k, 3), np.nan)])
        at = np.concatenate([at / r1, self.planes()[0]])
        return Task(mesh.linked, mesh.cell.wire, force, held, at, free, guide=guide), unit


def solve_mesh(problem: Problem, options: FiniteOptions | None = None) -> FiniteSolution:
    """The answer to a problem; see `FiniteMesh.solve`."""
    began = time.perf_counter()
    options = options or FiniteOptions()
    problem.check()
    task, unit = problem.task()
    found = solve_rings(task, problem.start(options), options)
    return _solution(problem, task, found, unit, time.perf_counter() - began)


def _solution(problem: Problem, task: Task, found: Found, unit: float, wall_s: float) -> FiniteSolution:
    mesh, con = problem.mesh, found.touching
    r1, n = mesh.cell.r1, len(mesh.X)
    check = find_touching(found.placed, task.linked, task.wire, 0.1)
    lowest = r1 * float(check.deepest.min(initial=np.inf))
    total = spread(con, gradients(found.placed, con), found.force, len(task.force))[:, :3] + task.force
    reaction = np.where(task.held, -unit * total, 0.0)
    pair = con.minima.pair
    ring = ~con.at_wall
    residual = max(found.residual, -lowest / r1)
    if found.status == "out-of-reach":
        unit, residual, reaction = np.nan, np.inf, np.full_like(reaction, np.nan)
    missing = np.where(task.held, task.at - found.placed.x, 0.0)
    return FiniteSolution(
        mesh=mesh,
        centre=r1 * found.placed.x[:n],
        normal=found.placed.normal[:n],
        load=problem.force,
        reaction=reaction[:n],
        pairs=np.column_stack([con.a[pair], con.b[pair]])[ring],
        contact_normal=con.minima.normal[ring],
        force=unit * found.force[ring],
        gap=r1 * con.gap[ring],
        walls=problem.walls,
        wall_force=reaction[n:],
        status=found.status,
        is_space=problem.is_space,
        links_intact=links_intact(found.placed, check, task.keys),
        min_gap_mm=lowest,
        way_left_mm=r1 * float(np.sqrt((missing**2).sum(axis=1)).max()),
        kkt_residual=residual,
        iterations=len(found.history),
        wall_s=wall_s,
        history=found.history,
    )
