"""From a scene to a curtain: mesh, supports, loads, solver; the record that pictures and files are made of."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import cached_property

import numpy as np

from homogenize import MembraneLaw
from macro_fem.fem.assembly import internal_force, load_vector
from macro_fem.fem.discretization import Discretization, discretize
from macro_fem.fem.rotated import elastic, rotated
from macro_fem.fem.supported import SupportedFem
from macro_fem.scene.loads import nodal_forces
from macro_fem.scene.mesh import CurtainMesh
from macro_fem.scene.schema import Scene
from macro_fem.scene.supports import Supports, build_supports, pin_sliding
from macro_fem.solvers.cone_program import Iteration
from macro_fem.solvers.cones import Cones, green_strain, least_slack
from macro_fem.solvers.newton import NewtonRecord
from macro_fem.solvers.status import FREE, Accuracy, Evidence, Judged, Reach, Verdict, judged, load_scale
from rve.common.cells import recovered
from rve.common.errors import InputError
from rve.common.types import Array

SLACK = 1e-3
"""A larger principal line load below this part of the greatest one anywhere counts as none: slack."""
WRINKLED = 0.05
"""A smaller principal line load below this part of the larger one beside it counts as none: drawn in one direction."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A scene made discrete at one load step: everything a solver needs."""

    scene: Scene
    mesh: CurtainMesh
    disc: Discretization
    law: MembraneLaw
    supports: Supports
    fem: SupportedFem
    force: Array  # (n_nodes, d), N
    factor: float = 1.0  # share of live loads and moves
    cones: Cones | None = None  # half-spaces to begin with, instead of the law's own few

    @cached_property
    def elastic_law(self) -> MembraneLaw:
        """The law of an elastic curtain, whose rings give by direction where the law knows it."""
        return elastic(self.law)


@dataclass(frozen=True)
class Decision:
    """A feature, whether the run has used it, and why in this scene."""

    feature: str
    used: bool
    why: str

    def to_dict(self) -> dict[str, str | bool]:
        """For summary.json."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class CurtainSolution(Judged):
    """The curtain at one load step.

    x (n_nodes, d) positions, mm; at the points F, E, P = F S (nq, d, 2) in N per mm of reference length, and S; primal
    and dual values of the potential -sum force . (x - X), N mm; reactions (n_nodes, d), N. `tension` is the even
    tension in N/mm that P balances besides the load.

    Status and message are not given but follow from the rest: `stop` is why the solver stopped, `asked` what the
    numbers of an answer must not exceed, `reach` how much farther apart the supports could be, `give` by how much the
    rings of a relaxed problem gave beyond locking, whose bounds primal and dual then are; None for the law as it is.
    `elastic`: P is the stress of the elastic law, else of ideal locking. `decided`: what the solver itself decided.
    """

    problem: Problem
    stop: str
    asked: Accuracy
    x: Array
    F: Array
    P: Array
    S: Array
    primal: float
    dual: float
    iterations: int
    wall_s: float
    reach: Reach = FREE
    give: float | None = None
    elastic: bool = False
    cones: Cones | None = field(default=None, repr=False)
    history: tuple[Iteration | NewtonRecord, ...] = field(default=(), repr=False)
    tension: float = 0.0
    decided: tuple[Decision, ...] = ()

    @cached_property
    def evidence(self) -> Evidence:
        """The errors of this answer, from its own numbers: nothing that a solver reports enters but the dual value."""
        return Evidence(self.relative_gap, self.residual, self._violation())

    @cached_property
    def verdict(self) -> Verdict:
        """Status and message: see `macro_fem.solvers.status`."""
        return judged(self.stop, self.evidence, self.asked, self.iterations, self.reach, self.give)

    @property
    def relative_gap(self) -> float:
        """(primal - dual) / (total load times size): the error of the potential on the scale of the curtain."""
        return float((self.primal - self.dual) / (self._total * self.problem.mesh.size))

    @cached_property
    def residual(self) -> float:
        """Sum of the forces on free unknowns that do not balance, over the sum of the loads."""
        fem = self.problem.fem
        own = self.P - self.tension * unit_tensors(self.problem)
        return float(np.abs(fem.gather(self.problem.force) - fem.force(own)).sum()) / self._total

    @property
    def _total(self) -> float:
        return load_scale(self.problem.force, self.problem.disc.weight)

    def _violation(self) -> float:
        """Largest relative violation of the law; none where rings are elastic, which any strain goes with."""
        E = green_strain(self.F / (1.0 + (self.give or 0.0)))
        if not (np.isfinite(E).all() and np.isfinite(self.P).all()):
            return np.inf
        return 0.0 if self.elastic else -least_slack(self.problem.law, E)

    @property
    def stretch_excess(self) -> float:
        """Largest stretch anywhere beyond that at which the rings lock, relative; 0 where none is."""
        return float(np.sqrt(1.0 + max(0.0, -least_slack(self.problem.law, self.E)))) - 1.0

    @property
    def E(self) -> Array:
        """Green strain (nq, 3)."""
        return green_strain(self.F)

    @property
    def displacement(self) -> Array:
        """x - X (n_nodes, d), mm."""
        return self.x - self.problem.disc.nodes

    @property
    def reactions(self) -> Array:
        """Forces of the supports on the curtain (n_nodes, d), N."""
        own = self.P - self.tension * unit_tensors(self.problem)
        balance = internal_force(self.problem.disc, own) - self.problem.force
        return np.where(self.problem.supports.mask, balance, 0.0)

    def mean_height(self) -> float:
        """Mean of y over the reference area, mm."""
        ones = load_vector(discretize(self.problem.mesh.mesh, self.problem.disc.element), np.array([1.0]))[:, 0]
        return float(ones @ self.x[:, 1] / ones.sum())

    def principal(self) -> tuple[Array, Array]:
        """Principal line loads (n_cells, 2), larger first, and the reference direction of the larger (n_cells, 2).

        These are the singular values of P, forces per reference length: what the rings of a pitch carry, finite even
        where the mesh is drawn together to a line. P is averaged over neighbours first (see `recovered`).
        """
        _, values, Vt = np.linalg.svd(self.recovered(self.problem.disc.cell_mean(self.P)))
        return values, Vt[:, 0, :]

    def recovered(self, values: Array) -> Array:
        """Cell values (n_cells, ...) averaged over neighbours, see `rve.common.cells.recovered`."""
        return recovered(self.problem.mesh.mesh.t.T, values, self.problem.disc.cell_area)

    def state(self) -> np.ndarray:
        """Per cell 0 where it is slack, 1 where it is drawn in one direction (wrinkled), 2 where it is taut in both."""
        values, _ = self.principal()
        is_drawn = values[:, 0] > SLACK * float(values.max(initial=0.0))
        return is_drawn.astype(int) + (is_drawn & (values[:, 1] > WRINKLED * values[:, 0]))


def make_problem(scene: Scene, law: MembraneLaw, mesh: CurtainMesh, factor: float = 1.0) -> Problem:
    """The discrete problem of a scene on a mesh, live loads and moves scaled by `factor`; InputError as found."""
    try:
        disc = discretize(mesh.mesh, scene.mesh.element)
    except ValueError as error:
        raise InputError(f"{scene.source}: [mesh] {error}") from error
    force = nodal_forces(scene, mesh, disc, law.cell, factor)
    supports = pin_sliding(build_supports(scene, mesh, disc, factor), disc, force, scene.source)
    hung = rotated(law, scene.curtain.weave_angle)
    return Problem(scene, mesh, disc, hung, supports, supports.fem(disc), force, factor)


def spread_tension(problem: Problem) -> float:
    """The even tension in N/mm that opens out slack parts; see `scene.Solver`."""
    return problem.scene.solver.stabilising_tension * float(np.abs(problem.force).sum()) / problem.mesh.size


def spread_allowance(problem: Problem, tension: float) -> float:
    """How much more than the spread problem's a bound of the load's own potential must allow, N mm.

    -l.z = -(l + l_e).z + l_e.z, and l_e.z = tension times the integral of tr F over the area, |tr F|^2 <= 2 tr C with
    tr C = 2 + 2 tr E <= 2 + 4 h(I/2).
    """
    half = np.array([[0.5, 0.0, 0.5]])
    largest = np.sqrt(2.0 * (2.0 + 4.0 * float(problem.law.support(half)[0])))
    return tension * largest * float(problem.disc.weight.sum())


def unit_tensors(problem: Problem) -> Array:
    """The unit tensor at every point (nq, d, 2)."""
    return np.broadcast_to(np.eye(problem.fem.d, 2), (problem.disc.n_points, problem.fem.d, 2))


def gathered_start(problem: Problem) -> Array:
    """Positions (n_nodes, d) of the curtain drawn up into a line through its supports: slack wherever it can be."""
    X, mask, held = problem.disc.nodes, problem.supports.mask, problem.supports.positions
    start = np.empty_like(X)
    for axis in range(2):
        nodes = mask[:, axis]
        if np.count_nonzero(nodes) and np.ptp(X[nodes, axis]) > 0.0:
            slope = np.polyfit(X[nodes, axis], held[nodes, axis], 1)[0]
            start[:, axis] = np.clip(slope, 0.0, 1.0) * (X[:, axis] - X[nodes, axis].mean()) + held[nodes, axis].mean()
        else:
            start[:, axis] = held[nodes, axis].mean() if nodes.any() else X[:, axis].mean()
    return start
