"""The answer of a finite mesh: where every ring is, which forces its contacts carry, and how good that is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rve.common import Array, digits
from rve.common.optional import Axes, Plotter
from rve.finite.contacts import MeshContacts, links_intact
from rve.finite.layout import RingLayout
from rve.finite.newton import gradients, spread
from rve.finite.problem import Obstacle, Problem, RoundBody, ScaledProblem
from rve.placed.drawn import DrawnRings

SENTENCES = {
    "converged": "a local minimum of the potential: forces balance, gaps and links are within tolerance",
    "out-of-reach": "held rings or walls did not reach their places: the mesh locks before; move them closer together",
    "stalled": "no step lowers the residual further; start from another disturbance, or allow a larger residual",
    "iterations": "the limit of iterations was reached: allow more, and hold what slides on a floor without friction",
}


@dataclass(frozen=True, eq=False)
class IterationRecord:
    """One iteration: the accepted fraction of its step, numbers of trial steps and of factors."""

    length: float
    trials: int
    factors: int


@dataclass(frozen=True, eq=False)
class SolverResult:
    """End of a path without units: contacts, which have the pose, their forces (m,), status, residual.

    Without convergence it is the iterate of least residual.
    """

    contacts: MeshContacts
    force: Array
    status: str
    residual: float
    history: tuple[IterationRecord, ...]


@dataclass(frozen=True, eq=False)
class RingContacts:
    """Points of contacts: pairs (m, 2) of rings a < b, unit normals (m, 3) from a to b, forces (m,) in N with which
    they push each other apart, gaps (m,) in mm; the least gap of any two rings, whether exactly the linked ones are."""

    pairs: NDArray[np.intp]
    normal: Array
    force: Array
    gap: Array
    min_gap_mm: float
    links_intact: bool

    @property
    def whole(self) -> tuple[NDArray[np.intp], Array]:
        """Pairs (k, 2) and forces (k,) in N of whole contacts.

        Circles have two minima of their distance at most: a pair with more points is one contact, spread over them.
        """
        _, pair, count = np.unique(self.pairs, axis=0, return_inverse=True, return_counts=True)
        pair = pair.ravel()
        is_wide = count[pair] > 2
        at = np.where(is_wide, -1 - pair, np.arange(len(pair)))
        _, first, back = np.unique(at, return_index=True, return_inverse=True)
        push = np.zeros((len(first), 3))
        np.add.at(push, back.ravel(), self.force[:, None] * self.normal)
        return self.pairs[first], np.asarray(np.linalg.norm(push, axis=1))


@dataclass(frozen=True, eq=False, repr=False)
class FiniteSolution:
    """Rings of a finite mesh in equilibrium.

    centre, normal (n, 3): centres in mm and unit normals; load, reaction (n, 3): dead forces and forces of the supports
    in N, without those that keep rings in the plane; contacts: where rings touch, and with which forces; walls:
    half-spaces, with the force wall_force (k, 3) in N of each on the rings. way_left_mm: how far a held ring or a
    half-space is from its place.

    status "converged": a local minimum of the potential. `message` says what each status means. kkt_residual: the
    largest of unbalanced force over load, force times gap over (links times mean force), and overlap over r1. Where
    supports or half-spaces are out of reach there is no equilibrium: forces are nan and kkt_residual is inf.
    """

    mesh: RingLayout
    centre: Array
    normal: Array
    load: Array
    reaction: Array
    contacts: RingContacts
    walls: tuple[Obstacle, ...]
    wall_force: Array
    status: str
    is_space: bool
    way_left_mm: float
    kkt_residual: float
    history: tuple[IterationRecord, ...]
    wall_s: float = 0.0

    @property
    def iterations(self) -> int:
        """Iterations of the solver."""
        return len(self.history)

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

    __repr__ = __str__

    @property
    def largest_force(self) -> Array:
        """Largest contact force (n,) in N on each ring; nan where the solution has no forces."""
        if not np.isfinite(self.contacts.force).all():
            return np.full(len(self.centre), np.nan)
        out, (pairs, force) = np.zeros(len(self.centre)), self.contacts.whole
        for side in pairs.T:
            np.maximum.at(out, side, force)
        return out

    def line_load(self, group: NDArray[np.intp], area: Array) -> Array:
        """First Piola-Kirchhoff line load P (k, 3, 2) in N/mm of parts of the mesh: the virial of contact forces.

        group (n,): the part 0 ... k - 1 that each ring belongs to; area (k,): reference areas in mm2. A contact between
        two parts counts half in each. P = -sum of force normal x (X_b - X_a) over the area.
        """
        con, X = self.contacts, self.mesh.X
        branch = X[con.pairs[:, 1]] - X[con.pairs[:, 0]]
        pull = (-0.5 * con.force[:, None] * con.normal)[:, :, None] * branch[:, None, :]
        out = np.zeros((len(area), 3, 2))
        for side in con.pairs.T:
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
        self.drawn.write_vtu(path, data, real=np.float64)

    @property
    def drawn(self) -> DrawnRings:
        """The rings to draw, grey where there are no forces, and the balls beside them."""
        cell, force = self.mesh.cell, self.largest_force
        has_forces = bool(np.isfinite(force).all())
        balls = tuple((b.name, np.array(b.place), b.radius) for b in self.walls if isinstance(b, RoundBody))
        radii, wires = self.mesh.sizes
        return DrawnRings(
            self.centre, self.normal, cell.r1 * radii, cell.r2 * wires, force if has_forces else None, balls
        )

    def view(self, plotter: Plotter | None = None) -> Plotter:
        """All rings in space, coloured by contact force, balls at held rings and arrows of the forces on them.

        A plotter of pyvista. Rings are grey without forces, because supports are out of reach.
        """
        from rve.common.drawing.plane import BLUE, GREEN
        from rve.common.drawing.space import THREE_QUARTERS, add, arrows, balls, look

        plotter = self.drawn.draw(plotter)
        held = self._pulling
        if np.isfinite(self.contacts.force).all() and len(held):
            at, forces = self.centre[held], self.reaction[held]
            largest, size = np.linalg.norm(forces, axis=1).max(), float(np.linalg.norm(np.ptp(self.centre, axis=0)))
            add(plotter, "held rings", balls(at, max(0.5 * self.mesh.cell.r1, 0.004 * size)), GREEN)
            name = f"force of supports, longest {digits(largest)} N"
            add(plotter, name, arrows(at, 0.15 * size * forces / largest), BLUE)
            look(plotter, THREE_QUARTERS)
        return plotter

    @property
    def _pulling(self) -> NDArray[np.intp]:
        """The rings (k,) that supports hold with a force worth drawing."""
        force = np.linalg.norm(np.nan_to_num(self.reaction), axis=1)
        # Forces of supports below this part of the largest one are not drawn.
        return np.flatnonzero(force > 1e-3 * force.max(initial=0.0))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Every ring in the plane x, y, coloured by its largest contact force, on `ax` or axes of their own."""
        ax = self.drawn.plot(ax, width=1.0)
        held = self._pulling
        if len(held):
            ax.plot(*self.centre[held, :2].T, "v", color="#009e73", ms=10, mec="white", label="held rings")
            ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), frameon=False)
        ax.set_title(f"{len(self.centre)} rings: {self.status}\nmean height {self.mean_height:.1f} mm", fontsize=11)
        return ax


def as_solution(problem: Problem, scaled: ScaledProblem, result: SolverResult) -> FiniteSolution:
    """The result of the solver in units."""
    mesh, con, unit = problem.mesh, result.contacts, scaled.unit
    r1, n, pair, ring = mesh.cell.r1, len(mesh.X), con.minima.pair, ~con.at_wall
    lowest = r1 * float(con.deepest.min(initial=np.inf))
    pushes = spread(con, gradients(con), result.force)[:, :3]
    total = pushes + scaled.force + scaled.springs(con.pose, 0.0)[1][:, :3]
    reaction = np.where(scaled.held, -unit * total, 0.0)
    if not problem.is_space:  # the plane, not a support, keeps the rings in it
        reaction[:n, 2] = 0.0
    residual = max(result.residual, -lowest / r1)
    if result.status == "out-of-reach":
        unit, residual, reaction = np.nan, np.inf, np.full_like(reaction, np.nan)
    return FiniteSolution(
        mesh=mesh,
        centre=r1 * con.pose.x[:n],
        normal=con.pose.normal[:n],
        load=problem.force,
        reaction=reaction[:n],
        contacts=RingContacts(
            np.column_stack([con.a[pair], con.b[pair]])[ring],
            con.minima.normal[ring],
            unit * result.force[ring],
            r1 * con.gap[ring],
            lowest,
            links_intact(con, scaled.keys),
        ),
        walls=tuple(
            wall.moved(r1 * place) if isinstance(wall, RoundBody) else wall
            for wall, place in zip(problem.walls, con.pose.x[n:], strict=True)
        ),
        wall_force=-unit * pushes[n:],
        status=result.status,
        is_space=problem.is_space,
        way_left_mm=r1 * float(np.linalg.norm(scaled.way_left(con.pose), axis=1).max()),
        kkt_residual=residual,
        history=result.history,
    )
