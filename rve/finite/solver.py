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

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rve.common import Array, tell, way
from rve.common.factor import Factorizer
from rve.finite.equations import gradients, spread
from rve.finite.newton import Iteration, Step
from rve.finite.search import search
from rve.finite.task import FiniteOptions, Found, Record, State, Task
from rve.finite.touching import Placed, Touching

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
_TRIES = 3
"""Times a step is damped pair by pair before it is shortened."""
_NEARER = ((1e-2, np.inf), (1e-4, 0.3), (0.0, 0.15))
"""Reach from these mu on, in r1: contacts farther away have next to no force, and cost as much as others."""
_PARTS = (1, 8)
"""In how many parts held rings are moved: all at once closes gaps for good from some starts (1 of 100 at random)."""


def solve_rings(task: Task, start: Placed, options: FiniteOptions) -> Found:
    """The equilibrium from a start without overlaps and with its links right; a failure has its status."""
    touching = task.find(start, options.reach)
    none = np.zeros(len(touching.key))
    state = State(touching, touching.central(options.first), options.first, 1e-3, none, none)
    for parts in _PARTS:
        found = _solve(task, state, options, parts)
        if found.status != "out-of-reach":
            break
    return found


def solve_near(task: Task, touching: Touching, force: Array, options: FiniteOptions) -> Found:
    """The equilibrium near a start whose contacts have the forces (m,), such as those of a time step before."""
    none = np.zeros(len(touching.key))
    state = State(touching, force, options.first, 0.0, none, none)
    return _solve(task, state.at(task.find(touching.placed, _reach(options, state.mu)), state.mu), options, 1)


def _solve(task: Task, state: State, options: FiniteOptions, parts: int) -> Found:
    """The equilibrium, held rings moved in so many parts, each once the rings are calm."""
    start, whole, part = state.touching.placed, task.at, 1
    slides = _SLIDES if start.walls and task.inertia is None else 0
    task = replace(task, at=start.x + (whole - start.x) / parts) if parts > 1 else task
    factorize = Factorizer()
    history: list[Record] = []
    least, finest = np.inf, state
    pace, status, is_minimum = Patience(float(options.patience)), "iterations", False
    for _ in range(options.max_iterations):
        share = way(options.first, state.mu, options.last)
        tell(f"{len(task.force)} rings, iteration {len(history) + 1}, force x gap {state.mu:.0e}", share)
        G = gradients(state.touching)
        residual, product = kkt(state, G, task)
        product *= options.tolerance / max(options.tolerance, _PRODUCT * options.last)
        merit, has_arrived = max(residual, product), np.abs(task.way_left(state.touching.placed)).max() < 1e-12
        is_last = state.mu <= options.last
        if has_arrived and is_last and merit < options.tolerance:
            if is_minimum:
                status = "converged"
                break
            if task.inertia is not None:
                # A time step needs no more damping here; whether its matrix is positive definite shows without it.
                state = replace(state, damping=0.0, local=0.0 * state.local, convex=0.0 * state.convex)
        if has_arrived and is_last and merit < least:
            least, finest = merit, state
        pace = pace.after(merit, history[-1].decrement if history else -1.0)
        # Calm: the last step of Newton's method at this mu could have gained next to nothing.
        gain = history[-1].decrement if history and history[-1].mu == state.mu else -1.0
        is_sliding = pace.lifts < slides and state.mu <= _SLIDING and state.local.max(initial=0.0) >= _DAMPED
        is_calm = not is_last and not is_sliding and 0.0 <= gain < _CALM * state.mu * len(task.force)
        if has_arrived and is_calm and part < parts:
            part += 1
            task = replace(task, at=start.x + (whole - start.x) * part / parts)
            pace, has_arrived = Patience(float(options.patience)), False
        if has_arrived and (is_calm or pace.is_over(options, is_last)):
            if not is_calm and pace.lifts == options.retries:
                status = "stalled"
                break
            if not is_calm and is_last:
                # Points beside a minimum move with it and may keep a last residual: the next end goes without them.
                task = replace(task, beside=not task.beside)
            # Where a fold runs through the mesh at a small mu, every ring that it meets shortens the steps; at a higher
            # mu it passes in a few.
            lower = max(options.last, min(_SHRINK * state.mu, state.mu**_POWER))
            mu = lower if is_calm else min(_HIGHEST, _LIFT * state.mu)
            state = state.at(task.find(state.touching.placed, _reach(options, mu)), mu)
            pace = pace.at_next(is_calm)
            G = gradients(state.touching)
        state, record, is_minimum = _advance(state, task, G, factorize)
        history.append(replace(record, residual=residual))
        if len(history) >= 25 and all(one.length < 1e-6 for one in history[-25:]):
            status = "stalled" if has_arrived else "out-of-reach"
            break
    best = finest if np.isfinite(least) and status != "converged" else state
    return Found(best.touching, best.force, status, max(kkt(best, gradients(best.touching), task)), tuple(history))


@dataclass(frozen=True)
class Patience:
    """How many iterations in a row the residual has not fallen at this mu, and how many the Newton decrement."""

    patience: float
    lifts: int = 0
    idle: int = 0
    best: float = np.inf
    slow: int = -1
    least: float = np.inf

    def after(self, merit: float, decrement: float) -> Patience:
        """The pace after one more iterate; decrement of the step that led to it, negative where there is none."""
        is_better, is_nearer = merit < 0.9 * self.best, self.slow >= 0 and 0.0 <= decrement < 0.7 * self.least
        return replace(
            self,
            idle=0 if is_better else self.idle + 1,
            best=merit if is_better else self.best,
            slow=0 if is_nearer else self.slow + 1,
            least=decrement if is_nearer else self.least,
        )

    def at_next(self, is_calm: bool) -> Patience:
        """The pace at another mu; a lift costs iterations, so that the next one is longer in coming."""
        return Patience(self.patience if is_calm else min(1.5 * self.patience, 100.0), self.lifts + (not is_calm))

    def is_over(self, options: FiniteOptions, is_last: bool) -> bool:
        """Whether mu is to be lifted; the last one only where the residual does not fall."""
        return self.idle > 1.5 * options.patience if is_last else self.slow > self.patience


def _reach(options: FiniteOptions, mu: float) -> float:
    """The reach of contacts that count at a mu."""
    return min(options.reach, next(reach for least, reach in _NEARER if mu >= least))


def kkt(state: State, G: Array, task: Task) -> tuple[float, float]:
    """Sum of the unbalanced forces over the sum of the loads; sum of force times gap over (links times mean force)."""
    con = state.touching
    out = spread(con, G, state.force)
    out[:, :3] += task.force
    out += task.springs(con.placed, 0.0)[1]
    own = out[task.free]
    unbalanced = np.abs(own if task.tie is None else task.tie.T @ own).sum()
    return float(unbalanced / task.load), float((state.force * con.gap).sum() / len(task.linked))


def _advance(state: State, task: Task, G: Array, factorize: Factorizer) -> tuple[State, Record, bool]:
    """The next iterate, its record, and whether the matrix was positive definite without damping."""
    now = Iteration(state, task, G, factorize)
    new, step, length = None, None, 0.0
    for attempt in range(_TRIES + 1):
        step = now.step()
        if step is None:
            break
        new, length = search(now, step, is_last=attempt == _TRIES)
        if new is not None:
            break
    damping, counts = now.added.damping, (len(state.force), now.trials, now.factors)
    if step is None or new is None:
        damping = max(10.0 * damping, 1e-6)
        return replace(state, damping=min(damping, 1e9)), Record(state.mu, 0.0, -1.0, 0.0, damping, *counts), False
    is_exact = state.damping < 1e-6 and state.convex.max(initial=0.0) == 0.0 and state.local.max(initial=0.0) < 1e-2
    record = Record(state.mu, 0.0, -step.slope, length, damping, *counts)
    return _accept(now, new, step, length), record, is_exact and now.failed == 0


def _accept(now: Iteration, new: Touching, step: Step, length: float) -> State:
    """The new iterate with its forces and the damping for the next step."""
    state, added = now.state, now.added
    with np.errstate(divide="ignore", invalid="ignore"):
        longest = np.where(step.dforce < 0.0, -0.99 * state.force / step.dforce, np.inf).min(initial=1.0)
    force = state.force + min(float(longest), length) * step.dforce
    damping = 0.3 * added.damping if length > 0.3 else added.damping
    convex = np.where((added.convex > state.convex) | (length <= 0.3), added.convex, 0.3 * added.convex)
    convex[convex < 0.02] = 0.0
    damping = damping if damping > 1e-9 else 0.0
    end = replace(state, force=force, damping=damping, local=added.local, convex=convex).at(new, state.mu)
    return replace(end, force=np.clip(end.force, 0.3 * new.central(state.mu), 1e6 * state.mu / new.gap))
