"""Implicit steps in time, Euler's and BDF2 with steps of any ratio; the step of a curtain; the energies of any step.

Velocities are differences of positions and accelerations the same differences of velocities. With steps h and before it
h / w,

    beta h v+ = x+ - X,   beta h a+ = v+ - V,   beta = (1 + w) / (1 + 2 w),
    X = beta ((1 + w) x_n - w^2 / (1 + w) x_(n-1)),   V the same of velocities,

and beta = 1, X = x_n, V = v_n for Euler's. The equation of motion M a+ = f makes the step of a curtain the convex
program of the static solver with the mass term added,

    minimise  |x - x_hat|^2_M / (2 (beta h)^2) + damping and drag - f.x + stored energy   over admissible x,

x_hat = X + beta h V. Nodes of bodies with mass follow those of the curtain (`macro_fem.fem.supported`). Round obstacles
and bodies enter by tangent half-spaces, taken where the curtain would go, and found again at the answer until they no
longer turn.

With dx = x+ - x_n and M a+ = f + supports + pushes - B^T (w P+) - damping M v+ times dx,

    kinetic + potential + stored  changes by  work - lost_by_scheme - lost_by_locking - lost_by_damping,

    work     = (live loads + supports).dx + pushes along the moves of obstacles, of forces at the end of the step for
               Euler's and of the mean of those at both ends for BDF2,
    locking  = sum w P+:(F+ - F_n) of the rigid law, >= 0 because F_n is admissible and P+ an outward normal at F+, and
               pushes times the gaps at x_n, >= 0 as well: tautening and touching are plastic impacts,
    damping  = damping dx.M dx / h,
    scheme   = dx.M a+ - (v+.M v+ - v_n.M v_n) / 2, which is |v+ - v_n|^2_M / 2 for Euler's; of the damping and the work
               what forces at the end of the step do beyond them; what pushes do because tangents of round bodies turn;
               and of the elastic law sum w P+:(F+ - F_n) - (Psi+ - Psi_n), which is >= 0.

Every term comes from its own formula, so their sum closes only as far as the step was solved. In smooth motion BDF2
loses h^3 by scheme and locking together, since work and damping are of second order: more is an impact or a rebound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from macro_fem.curtain import CurtainProblem
from macro_fem.fem.assembly import gradient, internal_force
from macro_fem.fem.supported import SupportedFem
from macro_fem.solvers.cones import Cones, green_strain
from macro_fem.solvers.path import Inertia, PathOptions, PathResult, Terms, times
from macro_fem.solvers.walls import Walls
from macro_fem.solvers.warm_path import solve_step_path
from rve.common import Array


@dataclass(frozen=True, eq=False)
class Moment:
    """Positions x (n, d) in mm and velocities v (n, d) in mm/s at the time t in s."""

    t: float
    x: Array
    v: Array


def predicted(now: Moment, before: Moment | None, h: float) -> Moment:
    """The moment after a step h at the last acceleration: x+ differs from its x by a third power of h, v+ by h^2."""
    a = np.zeros_like(now.v) if before is None else (now.v - before.v) / (now.t - before.t)
    return Moment(now.t + h, now.x + h * now.v + 0.5 * h * h * a, now.v + h * a)


@dataclass(frozen=True)
class Account:
    """Energies at one moment and sums of work and losses since the start, N mm."""

    kinetic: float = 0.0
    potential: float = 0.0
    stored: float = 0.0
    work: float = 0.0
    lost_by_scheme: float = 0.0
    lost_by_locking: float = 0.0
    lost_by_damping: float = 0.0


def kinetic_energy(mass: Array, v: Array) -> float:
    """v.M v / 2 of masses (n,) and velocities (n, d), N mm."""
    return 0.5 * float((mass[:, None] * v * v).sum())


@dataclass(frozen=True, eq=False)
class StepEnd:
    """What a step ends in: positions x (n, d) in mm, forces (n, d) in N, and what they and the law have done, N mm.

    supports, pushes: of supports and of contacts; inner: B^T (w P+) of the law, which resists. stored: Psi+ of an
    elastic law, None of a rigid one; pushed, moves: what obstacles push with, and their moves along it, of any one
    shape; touched: pushes times the gaps at x_n.
    """

    x: Array
    supports: Array
    pushes: Array
    inner: Array | float = 0.0
    stored: float | None = None
    pushed: Array | float = 0.0
    moves: Array | float = 0.0
    touched: float = 0.0


@dataclass(frozen=True, eq=False)
class Forces:
    """Forces at the end of a step: outer (n, d) of loads but the weight, and of supports; push (n, d) of contacts and
    of a rigid law; pushed: of each obstacle, of any shape."""

    outer: Array
    push: Array
    pushed: Array

    def mean(self, other: Forces) -> Forces:
        """Halfway between these and others."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Forces(*(0.5 * (one + two) for one, two in pairs))


@dataclass(frozen=True, eq=False, kw_only=True)
class Reached:
    """What is known at the end of a step: the moment, the account, the forces, and what tells of impacts, N mm.

    gain: the work of contacts and a rigid law by the mean of their forces at both ends: about 0 in smooth motion,
    positive where the differences throw back what has met something. rebound: that in one more such step at the last
    velocities: positive where what touches or is taut leaves while it is still pushed. late: the work less that by
    forces at the end alone.
    """

    moment: Moment
    account: Account
    forces: Forces | None = None
    gain: float = 0.0
    late: float = 0.0
    rebound: float = 0.0


@dataclass(frozen=True, eq=False)
class TimeStep:
    """A step of h s from `now` of nodes of masses (n,) in N s2/mm under forces (n, d) in N at its end: Euler's without
    a moment before, else BDF2's.

    dead: weight; live: other loads that do not depend on the velocity. drag: symmetric blocks C (n, d, d) in N s/mm of
    forces -C v that belong to `live`; damping (n,) or one for all: 1/s, of forces -damping M v.
    """

    now: Moment
    before: Moment | None
    h: float
    mass: Array
    dead: Array
    live: Array
    drag: Array | None = None
    damping: Array | float = 0.0

    @cached_property
    def differences(self) -> tuple[float, Array, Array]:
        """beta h in s, X (n, d) in mm and V (n, d) in mm/s, see above."""
        now, before = self.now, self.before
        if before is None:
            return self.h, now.x, now.v
        w = self.h / (now.t - before.t)
        beta = (1.0 + w) / (1.0 + 2.0 * w)
        own, old = beta * (1.0 + w), beta * w * w / (1.0 + w)
        return beta * self.h, own * now.x - old * before.x, own * now.v - old * before.v

    @property
    def x_hat(self) -> Array:
        """X + beta h V (n, d): where nodes would go without forces, mm."""
        beta_h, X, V = self.differences
        return X + beta_h * V

    def live_at(self, v: Array) -> Array:
        """Forces (n, d) beside the weight and damping at velocities v (n, d), N."""
        return self.live if self.drag is None else self.live - times(self.drag, v)

    def velocity(self, x: Array) -> Array:
        """v+ (n, d) of positions x (n, d), mm/s."""
        beta_h, X, _ = self.differences
        return (x - X) / beta_h

    @property
    def resist(self) -> Array:
        """Damping times the mass (n, 1), N s/mm."""
        return (self.damping * self.mass)[:, None]

    def momentum_rate(self, x: Array) -> Array:
        """M a+ (n, d) of positions x (n, d), N."""
        return self.mass[:, None] * (x - self.x_hat) / self.differences[0] ** 2

    def unbalanced(self, x: Array) -> Array:
        """M a+ and damping less loads (n, d) at positions x (n, d), N: what supports, contacts and the law make up."""
        v = self.velocity(x)
        return self.momentum_rate(x) + self.resist * v - self.dead - self.live_at(v)

    def inertia(self, fem: SupportedFem) -> Inertia:
        """The quadratic term: W x_hat = M (X + beta h V) / (beta h)^2 + (damping M + C) X / (beta h)."""
        beta_h, X, V = self.differences
        d, m, b = X.shape[1], self.mass[:, None] / beta_h**2, 1.0 / beta_h
        resist = b * self.resist[:, :, None] * np.eye(d)
        if self.drag is not None:
            resist = resist + b * self.drag
        W = m[:, :, None] * np.eye(d) + resist
        aim = m * self.x_hat + times(resist, X)
        x_hat: Array = np.linalg.solve(W, aim[:, :, None])[:, :, 0].astype(float)
        momentum = b * float((self.mass[:, None] * np.abs(V)).sum())
        return Inertia(fem, W, x_hat, momentum, kinetic_energy(self.mass, V))

    def finish(self, last: Account, end: StepEnd, before: Forces | None = None) -> Reached:
        """What is known at the end of this step, given the account and the forces at its start."""
        dx, v, is_rigid = end.x - self.now.x, self.velocity(end.x), end.stored is None
        kinetic, damped = kinetic_energy(self.mass, v), float((self.resist * dx * dx).sum()) / self.h
        dashpot, inner = float((self.resist * v * dx).sum()), float((end.inner * dx).sum())
        push, pushed = end.pushes - (end.inner if is_rigid else 0.0), np.asarray(end.pushed)
        forces = Forces(self.live_at(v) + end.supports, push, pushed)
        mean = forces if self.before is None or before is None else forces.mean(before)
        moved, moves = float((pushed * end.moves).sum()), float((mean.pushed * end.moves).sum())
        late, work = float((forces.outer * dx).sum()) + moved, float((mean.outer * dx).sum()) + moves
        stored = 0.0 if end.stored is None else end.stored - last.stored
        account = Account(
            kinetic=kinetic,
            potential=last.potential - float((self.dead * dx).sum()),
            stored=last.stored + stored,
            work=last.work + work,
            lost_by_scheme=last.lost_by_scheme
            + float((self.momentum_rate(end.x) * dx).sum())
            - (kinetic - kinetic_energy(self.mass, self.now.v))
            + (dashpot - damped)
            + (work - late)
            + (moved - float((end.pushes * dx).sum()) - end.touched)
            + (0.0 if is_rigid else inner - stored),
            lost_by_locking=last.lost_by_locking + end.touched + (inner if is_rigid else 0.0),
            lost_by_damping=last.lost_by_damping + damped,
        )
        return Reached(
            moment=Moment(self.now.t + self.h, end.x, v),
            account=account,
            forces=forces,
            gain=float((mean.push * dx).sum()) - moves,
            late=work - late,
            rebound=self.h * float((push * v).sum()) - moved,
        )


@dataclass(frozen=True)
class TurnOptions:
    """Numbers of the rounds of a step."""

    rounds: int = 8
    settled: float = 1e-4
    """How often tangent half-spaces are found anew at most, and reactions that may still turn, over all forces."""
    gap: float = 1e-10
    least_gap: float = 1e-2
    first_gap: float = 1.0
    """Relative gap that a step is solved to, the part of it that its path is followed to (forces of slack half-spaces
    drift over many steps with larger ones), and the gap of its first state in cones, in energy scales."""


TURNS = TurnOptions()


def solve_step(
    problem: CurtainProblem,
    fem: SupportedFem,
    step: TimeStep,
    known: tuple[Cones | None, Array | None],
    tangents: Callable[[Array], Walls],
) -> tuple[PathResult, Walls]:
    """The solver's record of a step of the curtain of a problem, with the nodes of `fem`, from the half-spaces of the
    step before and their multipliers, `known`; and half-spaces of obstacles. tangents: those where obstacles and bodies
    are closest to nodes at x (n, d)."""
    law, inertia, compliance = problem.law, step.inertia(fem), np.zeros((3, 3))
    if problem.scene.solver.is_elastic:
        law, compliance = problem.elastic_law, problem.elastic_law.compliance
    load = fem.gather(step.dead + step.live)
    cones, lam = known
    path = PathOptions(TURNS.gap, 1e-9, drawn=False, first_gap=TURNS.first_gap, least_gap=TURNS.least_gap)
    path = replace(path, cones=cones, lam=lam)
    place, walls = step.now.x, tangents(step.now.x)
    for rounds in range(1, TURNS.rounds + 1):
        terms = Terms(compliance, walls=walls, inertia=inertia)
        result = solve_step_path(fem, law, load, fem.unknowns(place), problem.mesh.size, path, terms)
        place = fem.positions(result.z)
        if not len(walls) or result.status != "converged" or rounds == TURNS.rounds:
            break
        anew = tangents(place)
        turned = float(result.wall_forces @ np.linalg.norm(anew.normal - walls.normal, axis=1))
        turned /= float(np.abs(result.wall_forces).sum() + np.abs(load).sum() + inertia.force_scale)
        if turned < TURNS.settled:
            break
        walls, path = anew, replace(path, cones=result.cones, lam=result.lam, pushes=result.wall_forces)
    return result, walls


def end_of(problem: CurtainProblem, fem: SupportedFem, step: TimeStep, result: PathResult, walls: Walls) -> StepEnd:
    """The end of the step of a curtain, without what pushes have done."""
    x = fem.positions(result.z)
    pushes, inner = walls.nodal(result.wall_forces), internal_force(fem.disc, result.P)
    supports = np.where(fem.held, step.unbalanced(x) + inner - pushes, 0.0)
    return StepEnd(x, supports, pushes, inner, stored_energy(problem, x))


def stored_energy(problem: CurtainProblem, x: Array) -> float | None:
    """The stored energy of a curtain with its nodes, and maybe more, at x (n, d), N mm; None where rings are rigid."""
    if not problem.scene.solver.is_elastic:
        return None
    E = green_strain(gradient(problem.disc, x))
    return float(problem.disc.weight @ problem.elastic_law.response(E).energy)
