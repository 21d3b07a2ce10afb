"""From a scene to a curtain: mesh, supports, loads, solver; the record that pictures and files are made of."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from homogenize import MembraneLaw
from macro_fem.fem.assembly import internal_force, load_vector
from macro_fem.fem.discretization import Discretization, Points, discretize
from macro_fem.fem.linear import chosen
from macro_fem.fem.rotated import elastic, rotated
from macro_fem.fem.space import padded
from macro_fem.fem.supported import SupportedFem
from macro_fem.scene.cables import check_tracks
from macro_fem.scene.loads import nodal_forces
from macro_fem.scene.meshing.mesh import CurtainMesh
from macro_fem.scene.obstacles import Body, Obstacle, Placed, breadth, is_flat, placed, with_rounding
from macro_fem.scene.schema import Scene
from macro_fem.scene.supports import Supports, build_supports, pin_sliding
from macro_fem.scene.tables import Wind
from macro_fem.solvers.cone_program import Iteration
from macro_fem.solvers.cones import Cones, green_strain, least_slack
from macro_fem.solvers.newton import NewtonRecord
from macro_fem.solvers.status import FREE, Accuracy, Evidence, Judged, Reach, Settling, Verdict, judged, load_scale
from macro_fem.solvers.walls import TOUCHED, Walls
from rve.common.cells import recovered
from rve.common.errors import InputError
from rve.common.types import Array

SLACK = 1e-3
"""A larger principal line load below this part of the greatest one anywhere counts as none: slack."""
WRINKLED = 0.05
"""A smaller principal line load below this part of the larger one beside it counts as none: drawn in one direction."""


THINNEST = 0.2
"""Half the least width of a body over the longest side of a cell. Thinner bodies pass between the points that meet
them."""


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
    walls: Walls | None = None  # half-spaces that nodes stay inside of: floors, walls, tangent planes of bodies
    bodies: tuple[Placed, ...] = ()  # obstacles that are no half-spaces
    follows: tuple[Wind, ...] = ()  # pressures normal to the present surface, not part of `force`

    @cached_property
    def frame(self) -> Array:
        """Where the reference axes point (d, 2) in a curtain that hangs flat, about: two orthogonal unit vectors.

        In space these follow the supports and the resultant load, so that they turn with the scene.
        """
        if self.fem.d == 2:
            return np.eye(2)
        X, mask = self.disc.nodes, self.supports.mask
        here = mask.any(axis=1)
        total = float(np.linalg.norm(self.force, axis=1).sum())
        load = self.force.T @ (X - X[here].mean(axis=0))
        way = supported_map(self)[1] + load / (total * self.mesh.size or 1.0)
        U, size, Vt = np.linalg.svd(way, full_matrices=False)
        if size[1] < 1e-6 * size[0]:
            U, _, Vt = np.linalg.svd(way + 1e-3 * max(size[0], 1.0) * np.eye(3, 2), full_matrices=False)
        return np.asarray(U @ Vt)

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
    wall_forces (m,): the push of each half-space of `problem.walls` along its normal, N.
    settling: how far the rounds of `macro_fem.shape_loop` have come, None where the problem is convex.
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
    wall_forces: Array = field(default_factory=lambda: np.zeros(0), repr=False)
    settling: Settling | None = None

    @cached_property
    def evidence(self) -> Evidence:
        """The errors of this answer, from its own numbers: nothing that a solver reports enters but the dual value."""
        return Evidence(self.relative_gap, self.residual, self._violation())

    @cached_property
    def verdict(self) -> Verdict:
        """Status and message: see `macro_fem.solvers.status`."""
        verdict = judged(self.stop, self.evidence, self.asked, self.iterations, self.reach, self.give)
        return verdict if self.settling is None else self.settling.verdict(verdict)

    @property
    def relative_gap(self) -> float:
        """(primal - dual) / (total load times size): the error of the potential on the scale of the curtain."""
        return float((self.primal - self.dual) / (self._total * self.problem.mesh.size))

    @cached_property
    def residual(self) -> float:
        """Sum of the forces on free unknowns that do not balance, over the sum of the loads."""
        fem = self.problem.fem
        own = self.P - self.tension * unit_tensors(self.problem)
        return float(np.abs(fem.gather(self.problem.force + self.pushes) - fem.force(own)).sum()) / self._total

    @cached_property
    def pushes(self) -> Array:
        """Forces of floors, walls and bodies on the nodes (n_nodes, d), N."""
        walls = self.problem.walls
        n_nodes = self.problem.disc.n_nodes
        return np.zeros_like(self.problem.force) if walls is None else walls.nodal(self.wall_forces, n_nodes)

    @property
    def _total(self) -> float:
        return load_scale(self.problem.force, self.problem.disc.weight)

    def _violation(self) -> float:
        """Largest relative violation of the law; none where rings are elastic, which any strain goes with."""
        E = green_strain(self.F / (1.0 + (self.give or 0.0)))
        if not (np.isfinite(E).all() and np.isfinite(self.P).all()):
            return np.inf
        walls = self.problem.walls
        crossed = 0.0 if walls is None else -float(walls.gap(self.x).min(initial=np.inf)) / self.problem.mesh.size
        return max(0.0, crossed) if self.elastic else max(-least_slack(self.problem.law, E), crossed)

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
        return self.x - self.problem.fem.reference

    @property
    def reactions(self) -> Array:
        """Forces of the supports on the curtain (n_nodes, d), N."""
        return np.where(self.problem.supports.mask, self.unbalanced, 0.0)

    @property
    def unbalanced(self) -> Array:
        """Inner forces less loads and pushes of obstacles at all nodes (n_nodes, d), N."""
        own = self.P - self.tension * unit_tensors(self.problem)
        return internal_force(self.problem.disc, own) - self.problem.force - self.pushes

    def mean_height(self) -> float:
        """Mean of y over the reference area, mm."""
        ones = load_vector(discretize(self.problem.mesh.mesh, self.problem.disc.element), np.array([1.0]))[:, 0]
        return float(ones @ self.x[:, 1] / ones.sum())

    def places(self, X: Array) -> Array:
        """Where the points X (n, 2) in mm of the reference are, (n, 3) in mm, linear between the nodes.

        Points beside the mesh are where the nearest node is.
        """
        from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

        nodes = self.problem.disc.nodes
        x = LinearNDInterpolator(nodes, self.x)(X)
        lost = ~np.isfinite(x).all(axis=1)
        x[lost] = NearestNDInterpolator(nodes, self.x)(X[lost])
        return padded(x)

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
    if scene.solver.kind == "elastic" and not law.compliance.any():
        raise InputError(
            f"{scene.source}: [solver] kind = 'elastic': a law of kind {law.name} is inextensible, use kind = 'rigid'"
        )
    try:
        chosen(scene.solver.linear_solver)
    except ValueError as error:
        raise InputError(f"{scene.source}: [solver] linear_solver: {error}") from error
    force = nodal_forces(scene, mesh, disc, law.cell, factor)
    supports = pin_sliding(build_supports(scene, mesh, disc, factor), disc, force, scene.source)
    hung = rotated(law, scene.curtain.weave_angle)
    if scene.solver.kind != "elastic":
        check_tracks(scene, mesh, hung)
    fem = supports.fem(disc, scene.solver.linear_solver)
    problem = Problem(scene, mesh, disc, hung, supports, fem, force, factor)
    return _with_obstacles(problem) if scene.obstacle or any(wind.follows for wind in scene.load.wind) else problem


def _with_obstacles(problem: Problem) -> Problem:
    """The problem with floors, walls, bodies and following pressure; InputError for a support inside an obstacle."""
    scene, fem, supports = problem.scene, problem.fem, problem.supports
    cell = float(np.sqrt(2.0 * problem.disc.cell_area.mean()))
    met = [with_rounding(item, cell) for item in scene.obstacle]
    obstacles = [placed(number, item, problem.factor, fem.d) for number, item in enumerate(met)]
    for one in obstacles:
        _check_is_met(one.obstacle, scene, problem.mesh)
        for held in supports.held:
            fixed = held.nodes[(supports.mask & fem.held)[held.nodes].all(axis=1)]
            deep = -one.gap(supports.positions[fixed]).min(initial=np.inf)
            if deep > TOUCHED * problem.mesh.size:
                at = f" after {problem.factor:.3g} of the prescribed moves" if scene.load.steps > 1 else ""
                raise InputError(
                    f"{scene.source}: [obstacle] {one.obstacle.name}: {held.name} is {deep:.4g} mm inside it{at}"
                )
    points = problem.disc.hull.places(fem.reference)
    flat = [tangent_walls(one, fem, one.normal(points)) for one in obstacles if is_flat(one.obstacle)]
    bodies = tuple(one for one in obstacles if not is_flat(one.obstacle))
    follows = tuple(wind for wind in scene.load.wind if wind.follows)
    return replace(problem, walls=Walls.joined(flat), bodies=bodies, follows=follows)


def _check_is_met(obstacle: Obstacle, scene: Scene, mesh: CurtainMesh) -> None:
    """InputError for a body that is so thin that it would pass between the points of a cell."""
    if is_flat(obstacle):
        return
    half, side = breadth(cast(Body, obstacle)), mesh.longest_side
    if half < THINNEST * side:
        raise InputError(
            f"{scene.source}: [obstacle] {obstacle.name}: half its least width, {half:.4g} mm, is less than a fifth of "
            f"the sides of cells, up to {side:.4g} mm, between which it would pass: use more cells"
        )


def meeting_points(obstacle: Obstacle, disc: Discretization) -> Points:
    """The points of a mesh that stay outside of an obstacle: those whose hull holds the mesh for a half-space, nodes
    for a body, and for most bodies middles of sides and cells."""
    if is_flat(obstacle):
        return disc.hull
    return disc.meeting if getattr(obstacle, "clear", "nodes") == "cells" else disc.at_nodes


def tangent_walls(body: Placed, fem: SupportedFem, normal: Array) -> Walls:
    """The half-spaces of normals (m, d) that touch a body, at all points that meet it and can move."""
    at = meeting_points(body.obstacle, fem.disc)
    free = np.flatnonzero((np.not_equal(at.share, 0.0) & ~np.all(fem.held, axis=1)[at.node]).any(axis=1))
    own = at.only(free)
    return Walls(own.node, normal[free], body.offset(normal[free]), np.full(len(free), body.number), own.share)


def spread_tension(problem: Problem) -> float:
    """The even tension in N/mm that opens out slack parts; see `scene.Solver`."""
    return problem.scene.solver.stabilising_tension * float(np.abs(problem.force).sum()) / problem.mesh.size


def spread_allowance(problem: Problem, tension: float) -> float:
    """How much more than the spread problem's a bound of the load's own potential must allow, N mm.

    -l.z = -(l + l_e).z + l_e.z, and l_e.z = tension times the integral of Q:F over the area, where Q is the frame, two
    orthogonal unit vectors: (Q:F)^2 <= 2 tr C with tr C = 2 + 2 tr E <= 2 + 4 h(I/2).
    """
    half = np.array([[0.5, 0.0, 0.5]])
    largest = np.sqrt(2.0 * (2.0 + 4.0 * float(problem.law.support(half)[0])))
    return tension * largest * float(problem.disc.weight.sum())


def unit_tensors(problem: Problem) -> Array:
    """The frame at every point (nq, d, 2): the unit tensor of a plane curtain."""
    return np.broadcast_to(problem.frame, (problem.disc.n_points, problem.fem.d, 2))


def gathered_start(problem: Problem) -> Array:
    """Positions (n_nodes, d) of the curtain drawn up into a line through its supports: slack wherever it can be."""
    X, mask, held = problem.disc.nodes, problem.supports.mask, problem.supports.positions
    if problem.fem.d == 3:
        middle, A = supported_map(problem)
        U, size, Vt = np.linalg.svd(A, full_matrices=False)
        return np.asarray(middle + X @ (U * np.minimum(size, 1.0) @ Vt).T)
    start = np.empty_like(X)
    for axis in range(2):
        nodes = mask[:, axis]
        if np.count_nonzero(nodes) and np.ptp(X[nodes, axis]) > 0.0:
            slope = np.polyfit(X[nodes, axis], held[nodes, axis], 1)[0]
            start[:, axis] = np.clip(slope, 0.0, 1.0) * (X[:, axis] - X[nodes, axis].mean()) + held[nodes, axis].mean()
        else:
            start[:, axis] = held[nodes, axis].mean() if nodes.any() else X[:, axis].mean()
    return start


def supported_map(problem: Problem) -> tuple[Array, Array]:
    """The affine map X -> b + A X, b (d,) and A (d, 2), nearest to where the supports hold their points; A = 0 along
    directions of which they say nothing."""
    X, mask, held = problem.disc.nodes, problem.supports.mask, problem.supports.positions
    d = held.shape[1]
    b, A = np.zeros(d), np.zeros((d, 2))
    for axis in range(d):
        nodes = mask[:, axis]
        if nodes.any():
            centre, mean = X[nodes].mean(axis=0), held[nodes, axis].mean()
            A[axis] = np.linalg.lstsq(X[nodes] - centre, held[nodes, axis] - mean, rcond=1e-9)[0]
            b[axis] = mean - A[axis] @ centre
        elif axis < 2:
            b[axis] = X[:, axis].mean()
    return b, A
