"""Equilibrium of a finite mesh: a primal-dual interior-point Newton method with the exact sparse matrix.

Minimise -f.x subject to gap >= 0 at every local minimum of every near pair. Contacts follow force gap = mu (1 - gap/R)
as mu -> 0, so that a contact at the reach R has no force and enters smoothly. Lengths are in units of r1, forces in
units of the load's mean force on a link, so that mu is relative.

Gaps stay positive in every accepted step and no step can carry a wire through another (`contacts`). Supports travel to
their places in steps of a fraction of r1. mu is lifted where the iterates stagnate, so that a fold which runs through
the mesh passes in few steps. At a small mu each ring has its own. Steps are those of `newton`.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rve.common import Array, Flags, InputError, shown, tell
from rve.common.factor import Factorizer
from rve.finite.contacts import NO_POINTS, MeshContacts, MeshPose, make_fixed_points
from rve.finite.layout import RingLayout
from rve.finite.newton import NewtonSystem, Step, gradients, line_search, norm_of_tilts, spread, spread_out
from rve.finite.problem import BLOCK, METHOD, FiniteOptions, HalfSpace, Iterate, Problem, ScaledProblem
from rve.finite.solution import FiniteSolution, IterationRecord, SolverResult, as_solution


@dataclass(frozen=True, eq=False)
class FiniteMesh(RingLayout):
    """A finite piece of mesh that can be solved: rings in the reference state, see `RingLayout`."""

    def solve(
        self,
        force: Array,
        held: Flags,
        at: Array,
        *,
        space: bool = True,
        walls: Sequence[HalfSpace] = (),
        guide: Array | None = None,
        options: FiniteOptions | None = None,
    ) -> FiniteSolution:
        """The rings under dead forces (n, 3) in N, coordinates `held` (n, 3) kept at the places `at` (n, 3) in mm.

        In space, or with all centres in the plane z = 0. Every ring stays out of `walls` with its whole wire. Starts
        from the slack weave; held rings and half-spaces that cut it travel to their places. guide (n, 3): places in mm
        that pull at the centres in the beginning and no more at the end, nan where none does. A local minimum of the
        potential is found, which need not be the lowest; guide and disturbance have a part in which. Where supports or
        half-spaces are not reached they move in smaller parts, and in space what does not converge begins again with
        another disturbance. An answer that has not converged is returned with its status. InputError for other shapes,
        no load, and pieces that nothing holds.

        >>> from rve.geometry import Cell
        >>> mesh = FiniteMesh.rectangle(Cell(), 1, 1)
        >>> force, at = np.zeros((5, 3)), np.column_stack([mesh.X, np.zeros(5)])
        >>> force[:, 1] = -9.81 * mesh.mass
        >>> mesh.solve(force, at[:, [1, 1, 1]] > 12.0, at, space=False).status
        'converged'
        """
        began, force, at = time.perf_counter(), np.asarray(force, dtype=float), np.asarray(at, dtype=float)
        near = np.full(force.shape, np.nan) if guide is None else np.asarray(guide, dtype=float)
        options = FiniteOptions() if options is None else options
        if not isinstance(options, FiniteOptions):
            raise InputError(f"options = {shown(options)}: expected FiniteOptions")
        problem = Problem(self, force, np.asarray(held, dtype=bool), at, space, tuple(walls), near)
        problem.check()
        scaled, starts = problem.scaled(), options.starts if space and options.disturbance else 1
        solutions: list[FiniteSolution] = []
        for seed in range(options.seed, options.seed + max(1, starts)):
            start = problem.start(replace(options, seed=seed))
            solutions.append(as_solution(problem, scaled, solve_rings(scaled, start, options)))
            if solutions[-1].status in ("converged", "out-of-reach"):
                break
        best = min(solutions, key=lambda solution: solution.kkt_residual)
        history = sum((solution.history for solution in solutions), ())
        return replace(best, history=history, wall_s=time.perf_counter() - began)


def solve_rings(problem: ScaledProblem, start: MeshPose, options: FiniteOptions) -> SolverResult:
    """The equilibrium from a start without overlaps and with the right links; a failure has its status."""
    contacts = problem.find(start, options.reach)
    iterate = _first_iterate(contacts, contacts.central_forces(options.first), options.first, 1e-3)
    for parts in problem.method.path.parts:
        result = _Path(problem, iterate, options, parts).follow()
        if result.status != "out-of-reach":
            break
    return result


def solve_near(problem: ScaledProblem, contacts: MeshContacts, force: Array, options: FiniteOptions) -> SolverResult:
    """The equilibrium near a start whose contacts have the forces (m,), such as those of a time step before."""
    iterate = _first_iterate(contacts, force, options.first, 0.0)
    path = _Path(problem, iterate, options, 1)
    path.iterate = iterate.at(problem.find(contacts.pose, path.reach(options.first)))
    return path.follow()


def _first_iterate(contacts: MeshContacts, force: Array, mu: float, damping: float) -> Iterate:
    """The first iterate, all rings at the same mu."""
    none, n = np.zeros(len(contacts.key)), len(contacts.pose.x)
    rings = np.full(n, mu), damping, none, none, 0.0 * force, np.full(n, -1.0), np.zeros(n)
    return Iterate(contacts, force, *rings, np.full(n, METHOD.step.turn))


class _Path:
    """The central path of a problem, supports moved in so many parts, each once the rings are centred.

    merit: the larger of the residuals over their tolerance, times the tolerance. is_last (n,): rings at the last mu.
    is_end: all rings are, and supports are at their places. is_centred (n,): rings whose mu falls, since the last step
    of Newton's method at it could have gained next to nothing. is_stagnant (n,): rings whose mu is lifted.
    """

    def __init__(self, problem: ScaledProblem, iterate: Iterate, options: FiniteOptions, parts: int) -> None:
        self.problem, self.iterate, self.options, self.parts = problem, iterate, options, parts
        self.method = problem.method.path
        self.start, self.targets, self.part = iterate.contacts.pose, problem.at, 1
        self.stagnation = Stagnation(options, len(iterate.mu))
        self.best, self.best_merit = iterate, np.inf
        self.distances: list[float] = []  # of supports from their places, in this part
        self.history: list[IterationRecord] = []
        self.slides = self.method.slides if self.start.walls and problem.inertia is None else 0
        self.is_minimum, self.factorize = False, Factorizer()
        if parts > 1:
            self._aim()

    def follow(self) -> SolverResult:
        """The end of the path, and why it ends there."""
        for _ in range(self.options.max_iterations):
            self._observe()
            if self.is_end and self.merit < self.options.tolerance and self.is_minimum:
                return self._result("converged")
            if self.has_arrived and (self.is_stagnant & (self.stagnation.lifts == self.options.retries)).any():
                return self._result("stalled")
            self._adapt()
            self._advance()
            if not self.has_arrived and self._are_supports_stuck():
                return self._result("out-of-reach")
            last = self.history[-self.method.window :]
            if len(last) == self.method.window and all(record.length < 1e-6 for record in last):
                return self._result("stalled" if self.has_arrived else "out-of-reach")
        return self._result("iterations")

    def _aim(self) -> None:
        """Let the places of supports be those at the end of this part of their way."""
        x = self.start.x
        self.problem = replace(self.problem, at=x + (self.targets - x) * self.part / self.parts)

    def _observe(self) -> None:
        """Measure the iterate."""
        iterate, options, most = self.iterate, self.options, float(self.iterate.mu.max())
        count = f"{len(self.problem.force)} rings, iteration {len(self.history) + 1}"
        tell(f"{count}, force x gap {most:.0e} to {options.last:.0e}")
        residual, product = residuals(iterate, self.problem)
        self.merit = max(residual, product * options.tolerance / max(options.tolerance, 10.0 * options.last))
        self.distances.append(float(np.abs(self.problem.way_left(iterate.contacts.pose)).max()))
        self.has_arrived, self.is_last = self.distances[-1] < 1e-12, iterate.mu <= options.last
        self.is_end = bool(self.has_arrived and self.is_last.all())
        if self.is_end and self.merit < self.best_merit:
            self.best, self.best_merit = iterate, self.merit
        self.stagnation.count(self.merit, iterate.gain)
        is_sliding = most <= self.method.slide_mu and iterate.local.max(initial=0.0) >= self.method.slide_damping
        is_sliding = is_sliding and self.stagnation.lifts.max() < self.slides
        centred = self.method.centred_wide if self.problem.wide else self.method.centred
        is_centred = (iterate.gain >= 0.0) & (iterate.gain < centred * iterate.mu)
        self.is_centred = is_centred & ~self.is_last & (not is_sliding)
        self.is_stagnant = ~self.is_centred & self.stagnation.is_over(options, self.is_last)

    def _adapt(self) -> None:
        """Change what the next step is made of: fixed points, the places of supports, mu."""
        if self.is_end and self.merit < self.options.tolerance and self.problem.inertia is not None:
            # A time step needs no more damping here; whether its matrix is positive definite shows without it.
            none = 0.0 * self.iterate.local
            self.iterate = replace(self.iterate, damping=0.0, local=none, convex=none)
        if self.is_end and self.stagnation.idle == self.method.idle and not self.problem.wide:
            self._add_fixed_points()
        if self.has_arrived and self.is_centred.all() and self.part < self.parts:
            self.part, self.distances, self.has_arrived = self.part + 1, [], False
            self.stagnation = Stagnation(self.options, len(self.iterate.mu))
            self._aim()
        elif self.has_arrived and (self.is_centred.any() or self.is_stagnant.any()):
            self._change_mu()

    def _change_mu(self) -> None:
        """Lower mu of centred rings and lift that of stagnant ones."""
        iterate, problem = self.iterate, self.problem
        is_stuck = self.is_end and bool(self.is_stagnant.any())
        if is_stuck:
            # Guard points move with their minimum and may keep a last residual: the next end goes without them.
            self.problem = replace(problem, guard_points=not problem.guard_points, fixed_points=NO_POINTS)
        mu, is_lifted = self._next_mu()
        self.stagnation.begin(mu != iterate.mu, is_lifted)
        self.iterate, reach = replace(iterate, mu=mu), self.reach(float(mu.max()))
        if reach != iterate.contacts.reach or is_stuck:
            self.iterate = self.iterate.at(self.problem.find(iterate.contacts.pose, reach, iterate.contacts))

    def _next_mu(self) -> tuple[Array, Flags]:
        """mu (n,) of the rings for the next iterate, and which of them were lifted.

        Rings near a lifted one are lifted as well: at a small mu a fold shortens the steps at every ring that it meets,
        at a larger mu it passes in a few steps.
        """
        iterate, con, options = self.iterate, self.iterate.contacts, self.options
        level = np.where(self.is_stagnant, self.method.lift * iterate.mu, 0.0)
        coupled = con.count > 0
        for _ in range(self.method.links):
            near = con.pair_max(level)[coupled]
            for end in (con.a, con.b):
                np.maximum.at(level, end[coupled], near)
        is_for_all = _have_one_mu(iterate, self.problem) or bool(self.is_stagnant.all())
        level = np.minimum(level, options.first if is_for_all else 0.9 * self.problem.method.ring_mu)
        is_lifted = level > iterate.mu
        lower = np.maximum(options.last, np.minimum(self.method.shrink * iterate.mu, iterate.mu**self.method.power))
        mu = np.where(is_lifted, level, np.where(self.is_centred, lower, iterate.mu))
        return mu, is_lifted | self.is_stagnant

    def reach(self, mu: float) -> float:
        """The reach of contacts at a mu."""
        return min(self.options.reach, next(reach for least, reach in self.method.reaches if mu >= least))

    def _add_fixed_points(self) -> None:
        """Fix the contact points of soft pairs of rings both of which have a tenth or more of the largest unbalanced
        force, and damp these pairs no more."""
        problem, iterate, con = self.problem, self.iterate, self.iterate.contacts
        size = np.abs(problem.motions @ _unbalanced(iterate, problem)).reshape(-1, BLOCK).max(axis=1)
        pairs = np.flatnonzero(np.minimum(size[con.a], size[con.b]) > 0.1 * size.max())
        points = make_fixed_points(con, pairs, problem.method.soft)
        if len(points.key):
            self.problem = replace(problem, fixed_points=problem.fixed_points.join([points]))
            iterate = replace(iterate, local=np.where(np.isin(con.key, points.key), 0.0, iterate.local))
            self.iterate = iterate.at(self.problem.find(con.pose, con.reach))
            self.stagnation.best = np.inf

    def _advance(self) -> None:
        """Take a step, or damp more where there is none."""
        iterate = self.iterate
        system = NewtonSystem(iterate, self.problem, gradients(iterate.contacts), self.factorize)
        new, step, length = None, None, 0.0
        for attempt in range(self.problem.method.step.attempts + 1):
            step = system.step()
            if step is None:
                break
            new, length = line_search(system, step, is_last=attempt == self.problem.method.step.attempts)
            if new is not None:
                break
        self.history.append(IterationRecord(length, system.trials, system.factors))
        if step is None or new is None:
            damping = min(max(10.0 * system.iterate.damping, 1e-6), 1e9)
            self.iterate, self.is_minimum = (
                replace(iterate, damping=damping, gain=np.full(len(iterate.mu), -1.0)),
                False,
            )
            return
        is_exact = iterate.damping < 1e-6 and not iterate.convex.any() and iterate.local.max(initial=0.0) < 1e-2
        self.is_minimum = is_exact and system.failed == 0 and not system.iterate.swing.any()
        if self.is_end and self.is_minimum and self.problem.wide:
            # Gaps of wide contacts round off to 1e-6 of their forces: these follow from the last step.
            at_points = spread_out(iterate, step.dforce, step.dgap, step.q)
            if max(residuals(at_points, self.problem)) < self.options.tolerance:
                self.iterate = at_points
                return
        self.iterate = _accept(system, new, step, length)

    def _are_supports_stuck(self) -> bool:
        """Whether supports have come no nearer to their places over the window."""
        window = self.method.window
        return len(self.distances) > window and self.distances[-1] > 0.99 * self.distances[-1 - window]

    def _result(self, status: str) -> SolverResult:
        """The last iterate; without convergence that of least residual at the end of the path, if there is one."""
        end = self.best if np.isfinite(self.best_merit) and status != "converged" else self.iterate
        none = 0.0 * end.force
        end = spread_out(end, none, none, np.zeros((len(end.mu), BLOCK)))
        return SolverResult(end.contacts, end.force, status, max(residuals(end, self.problem)), tuple(self.history))


class Stagnation:
    """Iterations in a row without progress: idle, of the residual since the last change of mu; slow (n,), of the gain
    of rings. patience (n,): after how many a ring is stagnant; lifts (n,): how often its mu was lifted.
    """

    def __init__(self, options: FiniteOptions, n: int) -> None:
        self.patience, self.lifts = np.full(n, float(options.patience)), np.zeros(n, int)
        self.slow, self.least = np.full(n, -1), np.full(n, np.inf)
        self.idle, self.best = 0, np.inf

    def count(self, merit: float, gain: Array) -> None:
        """One more iterate; gain (n,) of the step that led to it, negative where there is none."""
        self.idle += 1
        if merit < 0.9 * self.best:
            self.idle, self.best = 0, merit
        is_nearer = (self.slow >= 0) & (gain >= 0.0) & (gain < 0.7 * self.least)
        self.slow = np.where(is_nearer, 0, self.slow + 1)
        self.least = np.where(is_nearer, gain, self.least)

    def begin(self, is_new: Flags, is_lifted: Flags) -> None:
        """Rings have another mu or were lifted; since a lift costs iterations, patience grows with each."""
        self.patience = np.where(is_lifted, np.minimum(1.5 * self.patience, 100.0), self.patience)
        self.lifts = self.lifts + is_lifted
        self.slow = np.where(is_new | is_lifted, -1, self.slow)
        self.least = np.where(is_new | is_lifted, np.inf, self.least)
        self.idle, self.best = 0, np.inf

    def is_over(self, options: FiniteOptions, is_last: Flags) -> Flags:
        """Which rings (n,) are stagnant; at the last mu all of them, once the residual does not fall."""
        if is_last.all():
            return np.full(len(is_last), self.idle > 1.5 * options.patience)
        return ~is_last & (self.slow > self.patience)


def residuals(iterate: Iterate, problem: ScaledProblem) -> tuple[float, float]:
    """Sum of the unbalanced forces over the sum of the loads; sum of force times gap over (links times mean force)."""
    unbalanced = np.abs(_unbalanced(iterate, problem)).sum()
    return float(unbalanced / problem.load), float((iterate.force * iterate.contacts.gap).sum() / len(problem.linked))


def _unbalanced(iterate: Iterate, problem: ScaledProblem) -> Array:
    """Unbalanced forces (u,) on the free motions."""
    con = iterate.contacts
    out = spread(con, gradients(con), iterate.force) + problem.springs(con.pose, 0.0)[1]
    out[:, :3] += problem.force
    return np.asarray(problem.motions.T @ out.ravel())


def _accept(system: NewtonSystem, new: MeshContacts, step: Step, length: float) -> Iterate:
    """The new iterate with its forces and the damping for the next step."""
    start, iterate = system.start, system.iterate
    with np.errstate(divide="ignore", invalid="ignore"):
        longest = np.where(step.dforce < 0.0, -0.99 * iterate.force / step.dforce, np.inf).min(initial=1.0)
    force = iterate.force + min(float(longest), length) * step.dforce
    damping = 0.3 * iterate.damping if length > 0.3 else iterate.damping
    convex = np.where((iterate.convex > start.convex) | (length <= 0.3), iterate.convex, 0.3 * iterate.convex)
    convex[convex < 0.02] = 0.0
    damping = damping if damping > 1e-9 else 0.0
    turn = iterate.turn if length <= 0.3 else np.minimum(METHOD.step.turn, 2.0 * iterate.turn)
    free = replace(iterate, swing=np.zeros_like(turn), turn=turn)
    end = replace(free, force=force, damping=damping, convex=convex, gain=_gain(system, step)).at(new)
    mu = end.contact_mu
    return replace(end, force=np.clip(end.force, 0.3 * new.central_forces(mu), 1e6 * mu / new.gap))


def _gain(system: NewtonSystem, step: Step) -> Array:
    """Newton decrement by rings (n,): the mean while they have one mu, then that of the contacts near each."""
    con, n = system.con, len(system.iterate.mu)
    if _have_one_mu(system.iterate, system.problem):
        return np.full(n, -step.slope / len(system.problem.force))
    coupled = con.count > 0
    a, b = con.a[coupled], con.b[coupled]
    work = np.bincount(con.minima.pair, step.stiff * step.dgap**2, len(con.key))[coupled]
    gain = 0.5 * (np.bincount(a, work, n) + np.bincount(b, work, n)) + system.iterate.swing * norm_of_tilts(step.q) ** 2
    count = 1.0 + np.bincount(a, minlength=n) + np.bincount(b, minlength=n)
    for _ in range(system.problem.method.path.smoothing):
        gain = (gain + np.bincount(a, gain[b], n) + np.bincount(b, gain[a], n)) / count
    return np.asarray(gain)


def _have_one_mu(iterate: Iterate, problem: ScaledProblem) -> bool:
    """Whether all rings have the same mu: at a large one folds form all over the mesh, over floors rings slide, and a
    time step has few iterations."""
    return bool(
        iterate.mu.max() >= problem.method.ring_mu or iterate.contacts.pose.walls or problem.inertia is not None
    )
