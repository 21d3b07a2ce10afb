"""Equilibrium of a finite mesh: a primal-dual interior-point Newton method with the exact sparse matrix.

Minimise -f.x subject to gap >= 0 at every local minimum of every near pair. Contacts follow force gap = mu (1 - gap/R)
as mu -> 0, so that a contact at the reach R has no force and enters smoothly. Lengths are in units of r1, forces in
units of the load's mean force on a link, so that mu is relative.

Gaps stay positive in every accepted step and no step can carry a wire through another (`touching`). Held rings travel
to their places in steps of a part of r1. Where the linear forecast of a gap fails, the step is corrected for what was
missed; where that is not enough, the two rings of the pair are damped against each other, and only they. mu is lifted
where the iterates do not settle at it, so that a fold which runs through the mesh passes in few steps. Steps are those
of `newton`.
"""

from dataclasses import replace

import numpy as np

from rve.common import Array, Flags, tell
from rve.common.factor import Factorizer
from rve.finite.equations import gradients, spread
from rve.finite.newton import Iteration, Step
from rve.finite.search import search
from rve.finite.task import BLOCK, FiniteOptions, Found, Record, State, Task
from rve.finite.touching import NOWHERE, Placed, Touching, fixed_points

_HIGHEST = 0.1
"""Largest mu, the product of force and gap, that lifts lead to."""
_SHRINK, _POWER = 0.3, 1.15
"""mu falls to the lesser of _SHRINK mu and mu^_POWER."""
_PRODUCT = 10.0
"""Sum of force times gap over links times mean force that is enough, over the last mu."""
_CALM = 0.5
"""It falls once the decrement of Newton's method is below this part of mu per ring."""
_SLIDING, _DAMPED, _SLIDES = 1e-5, 0.1, 4
"""But over a floor not below the first mu while a pair is damped by the second: its rings slide, and gain little for
the damping. So for that many lifts; without a floor damped pairs are folds, which the next mu passes in fewer steps."""
_LIFT = 30.0
"""Factor on mu where the iterates do not settle at it."""
_ENDS = 4
"""At the last mu no ring tells that it is the one that does not settle: all are lifted, by this factor the first time
and by its square, cube and fourth power the next times, to where all go together again."""
_TOGETHER = 1e-4
"""mu from which on all rings have the same one; below, each ring has its own."""
_LINKS, _PASSES = 6, 4
"""Links around a ring that are lifted with it, and over which what its contacts do is averaged. Of 481 to 1,013 rings
in space that makes a tenth to a third fewer iterations than one mu for all."""
_DITHERS, _BALANCED = 5, 1e-3
"""Iterations at the last mu in which the residual has not fallen after which unbalanced pairs touch at fixed points, if
it is below the second number."""
_TRIES = 3
"""Times a step is damped pair by pair before it is shortened."""
_NEARER = ((1e-2, np.inf), (1e-4, 0.3), (0.0, 0.15))
"""Reach from these mu on, in r1: contacts farther away have next to no force, and cost as much as others."""
_PARTS = (1, 8, 40)
"""In how many parts held rings are moved: larger ones close gaps for good, in 1 of 100 random starts of a sheet hung by
its corners, and in most that are drawn far together over a floor."""
_STUCK = 50
"""Iterations in which held rings must come nearer to their places by 1 %, or count as out of reach."""


def solve_rings(task: Task, start: Placed, options: FiniteOptions) -> Found:
    """The equilibrium from a start without overlaps and with its links right; a failure has its status."""
    touching = task.find(start, options.reach)
    state = _state(touching, touching.central(options.first), options.first, 1e-3)
    for parts in _PARTS:
        found = _solve(task, state, options, parts)
        if found.status != "out-of-reach":
            break
    return found


def solve_near(task: Task, touching: Touching, force: Array, options: FiniteOptions) -> Found:
    """The equilibrium near a start whose contacts have the forces (m,), such as those of a time step before."""
    state = _state(touching, force, options.first, 0.0)
    return _solve(task, state.at(task.find(touching.placed, _reach(options, options.first))), options, 1)


def _state(touching: Touching, force: Array, mu: float, damping: float) -> State:
    """The first iterate, all rings at one mu."""
    none, n = np.zeros(len(touching.key)), len(touching.placed.x)
    return State(touching, force, np.full(n, mu), damping, none, none, 0.0 * force, np.full(n, -1.0))


def _solve(task: Task, state: State, options: FiniteOptions, parts: int) -> Found:
    """The equilibrium, held rings moved in so many parts, each once the rings are calm."""
    start, whole, part = state.touching.placed, task.at, 1
    slides = _SLIDES if start.walls and task.inertia is None else 0
    task = replace(task, at=start.x + (whole - start.x) / parts) if parts > 1 else task
    factorize, history = Factorizer(), list[Record]()
    least, finest, ends, ways = np.inf, state, 0, list[float]()
    pace, status, is_minimum = Patience(options, len(state.mu)), "iterations", False
    for _ in range(options.max_iterations):
        most = float(state.mu.max())
        tell(f"{len(task.force)} rings, iteration {len(history) + 1}, force x gap {most:.0e} to {options.last:.0e}")
        residual, product = kkt(state, task)
        merit = max(residual, product * options.tolerance / max(options.tolerance, _PRODUCT * options.last))
        ways.append(float(np.abs(task.way_left(state.touching.placed)).max()))
        has_arrived = ways[-1] < 1e-12
        is_last = state.mu <= options.last
        is_end = bool(has_arrived and is_last.all())
        if is_end and merit < options.tolerance:
            if is_minimum:
                status = "converged"
                break
            if task.inertia is not None:
                # A time step needs no more damping here; whether its matrix is positive definite shows without it.
                state = replace(state, damping=0.0, local=0.0 * state.local, convex=0.0 * state.convex)
        if is_end and merit < least:
            least, finest = merit, state
        pace.count(merit, state.gain)
        if is_end and pace.idle == _DITHERS and merit < _BALANCED:
            known, (state, task) = len(task.points.key), _with_fixed_points(state, task)
            pace.best = np.inf if len(task.points.key) > known else pace.best
        # Calm: the last step of Newton's method at this mu could have gained next to nothing.
        is_sliding = pace.lifts.max() < slides and most <= _SLIDING and state.local.max(initial=0.0) >= _DAMPED
        is_calm = ~is_last & (state.gain >= 0.0) & (state.gain < _CALM * state.mu) & (not is_sliding)
        if has_arrived and is_calm.all() and part < parts:
            part, ways = part + 1, []
            task = replace(task, at=start.x + (whole - start.x) * part / parts)
            pace, has_arrived = Patience(options, len(state.mu)), False
        is_over = ~is_calm & pace.is_over(options, is_last)
        if has_arrived and (is_calm.any() or is_over.any()):
            if (is_over & (pace.lifts == options.retries)).any():
                status = "stalled"
                break
            is_stuck = is_end and is_over.any()
            if is_stuck:
                # Points beside a minimum move with it and may keep a last residual: the next end goes without them.
                task, ends = replace(task, beside=not task.beside, points=NOWHERE), ends + 1
            lift = _LIFT ** (1 + (ends - 1) % _ENDS) if is_stuck else _LIFT
            mu, is_lifted = _next_mu(state, task, is_calm, np.where(is_over, lift, 0.0), options)
            pace.begin(mu != state.mu, is_lifted)
            state, reach = replace(state, mu=mu), _reach(options, float(mu.max()))
            if reach != state.touching.reach or is_stuck:
                state = state.at(task.find(state.touching.placed, reach))
        state, record, is_minimum = _advance(state, task, factorize)
        history.append(record)
        is_held_up = not has_arrived and len(ways) > _STUCK and ways[-1] > 0.99 * ways[-1 - _STUCK]
        if is_held_up or (len(history) >= 25 and all(one.length < 1e-6 for one in history[-25:])):
            status = "stalled" if has_arrived else "out-of-reach"
            break
    best = finest if np.isfinite(least) and status != "converged" else state
    return Found(best.touching, best.force, status, max(kkt(best, task)), tuple(history))


def _next_mu(state: State, task: Task, is_calm: Flags, lift: Array, options: FiniteOptions) -> tuple[Array, Flags]:
    """mu (n,) of the rings for the next iterate, and which of them were lifted; lift (n,): factors on it, or 0."""
    # Where a fold runs through the mesh at a small mu, every ring it meets shortens the steps; at a higher mu it
    # passes in a few.
    con, level = state.touching, lift * state.mu
    felt = con.count > 0
    for _ in range(_LINKS):
        near = con.greater(level)[felt]
        for end in (con.a, con.b):
            np.maximum.at(level, end[felt], near)
    is_for_all = _is_together(state, task) or bool((lift > 0.0).all())
    level = np.minimum(level, _HIGHEST if is_for_all else 0.9 * _TOGETHER)
    is_lifted = level > state.mu
    lower = np.maximum(options.last, np.minimum(_SHRINK * state.mu, state.mu**_POWER))
    return np.where(is_lifted, level, np.where(is_calm, lower, state.mu)), is_lifted | (lift > 0.0)


class Patience:
    """How many iterations in a row the residual has not fallen, and of each ring (n,) how many what a step gains.

    patience, lifts, slow, least: of each of n rings; idle, best: of the residual since the last change of mu.
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
        """Rings have another mu or were lifted; a lift costs iterations, so that the next one is longer in coming."""
        self.patience = np.where(is_lifted, np.minimum(1.5 * self.patience, 100.0), self.patience)
        self.lifts = self.lifts + is_lifted
        self.slow = np.where(is_new | is_lifted, -1, self.slow)
        self.least = np.where(is_new | is_lifted, np.inf, self.least)
        self.idle, self.best = 0, np.inf

    def is_over(self, options: FiniteOptions, is_last: Flags) -> Flags:
        """Whether mu is to be lifted (n,); the last one only where the residual does not fall."""
        if is_last.all():
            return np.full(len(is_last), self.idle > 1.5 * options.patience)
        return ~is_last & (self.slow > self.patience)


def _reach(options: FiniteOptions, mu: float) -> float:
    """The reach of contacts that count at a mu."""
    return min(options.reach, next(reach for least, reach in _NEARER if mu >= least))


def kkt(state: State, task: Task) -> tuple[float, float]:
    """Sum of the unbalanced forces over the sum of the loads; sum of force times gap over (links times mean force)."""
    unbalanced = np.abs(_unbalanced(state, task)).sum()
    return float(unbalanced / task.load), float((state.force * state.touching.gap).sum() / len(task.linked))


def _unbalanced(state: State, task: Task) -> Array:
    """Unbalanced forces (u,) on the free motions."""
    out = spread(state.touching, gradients(state.touching), state.force) + task.springs(state.touching.placed, 0.0)[1]
    out[:, :3] += task.force
    return np.asarray(task.motions.T @ out.ravel())


def _with_fixed_points(state: State, task: Task) -> tuple[State, Task]:
    """The iterate and what is solved with fixed points for pairs of rings both of which have a tenth or more of the
    largest unbalanced force; these pairs are damped no more. The same ones where no such pair has soft minima."""
    con, size = state.touching, np.abs(task.motions @ _unbalanced(state, task)).reshape(-1, BLOCK).max(axis=1)
    more = fixed_points(con, np.flatnonzero(np.minimum(size[con.a], size[con.b]) > 0.1 * size.max()))
    if not len(more.key):
        return state, task
    task = replace(task, points=task.points.join([more]))
    state = replace(state, local=np.where(np.isin(con.key, more.key), 0.0, state.local))
    return state.at(task.find(con.placed, con.reach)), task


def _advance(state: State, task: Task, factorize: Factorizer) -> tuple[State, Record, bool]:
    """The next iterate, its record, and whether the matrix was positive definite without damping."""
    now = Iteration(state, task, gradients(state.touching), factorize)
    new, step, length = None, None, 0.0
    for attempt in range(_TRIES + 1):
        step = now.step()
        if step is None:
            break
        new, length = search(now, step, is_last=attempt == _TRIES)
        if new is not None:
            break
    record = Record(length, now.trials, now.factors)
    if step is None or new is None:
        damping = max(10.0 * now.state.damping, 1e-6)
        return replace(state, damping=min(damping, 1e9), gain=np.full(len(state.mu), -1.0)), record, False
    is_exact = state.damping < 1e-6 and state.convex.max(initial=0.0) == 0.0 and state.local.max(initial=0.0) < 1e-2
    return _accept(now, new, step, length), record, is_exact and now.failed == 0


def _accept(now: Iteration, new: Touching, step: Step, length: float) -> State:
    """The new iterate with its forces and the damping for the next step."""
    start, state = now.start, now.state
    with np.errstate(divide="ignore", invalid="ignore"):
        longest = np.where(step.dforce < 0.0, -0.99 * state.force / step.dforce, np.inf).min(initial=1.0)
    force = state.force + min(float(longest), length) * step.dforce
    damping = 0.3 * state.damping if length > 0.3 else state.damping
    convex = np.where((state.convex > start.convex) | (length <= 0.3), state.convex, 0.3 * state.convex)
    convex[convex < 0.02] = 0.0
    damping = damping if damping > 1e-9 else 0.0
    end = replace(state, force=force, damping=damping, convex=convex, gain=_gain(now, step)).at(new)
    mu = end.contact_mu
    return replace(end, force=np.clip(end.force, 0.3 * new.central(mu), 1e6 * mu / new.gap))


def _gain(now: Iteration, step: Step) -> Array:
    """What a step could gain, by rings (n,): one for all while they go together, then what contacts near them do."""
    con, n = now.con, len(now.state.mu)
    if _is_together(now.state, now.task):
        return np.full(n, -step.slope / len(now.task.force))
    felt = con.count > 0
    a, b = con.a[felt], con.b[felt]
    work = np.bincount(con.minima.pair, step.stiff * step.dgap**2, len(con.key))[felt]
    gain = 0.5 * (np.bincount(a, work, n) + np.bincount(b, work, n))
    count = 1.0 + np.bincount(a, minlength=n) + np.bincount(b, minlength=n)
    for _ in range(_PASSES):
        gain = (gain + np.bincount(a, gain[b], n) + np.bincount(b, gain[a], n)) / count
    return np.asarray(gain)


def _is_together(state: State, task: Task) -> bool:
    """Whether all rings have the same mu: at a large one folds form all over the mesh, over floors rings slide, and a
    time step has few iterations."""
    return bool(state.mu.max() >= _TOGETHER or state.touching.placed.walls or task.inertia is not None)
