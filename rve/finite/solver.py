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

from rve.common.progress import tell, way
from rve.common.types import Array
from rve.finite.equations import gradients, spread
from rve.finite.factor import Factorizer
from rve.finite.iterate import State, Step, Work, central, springs
from rve.finite.newton import linearized, newton
from rve.finite.records import FiniteOptions, Found, Record, Task
from rve.finite.search import searched
from rve.finite.touching import Placed, Touching, find_touching, handed_on, of_pairs

_HIGHEST = 0.1
"""Largest mu, the product of force and gap, that lifts lead to."""
_SHRINK, _POWER = 0.3, 1.15
"""mu falls to the lesser of _SHRINK mu and mu^_POWER."""
_PRODUCT = 10.0
"""Sum of force times gap over links times mean force that is enough, over the last mu."""
_CALM = 0.5
"""It falls once the decrement of Newton's method is below this part of mu per ring."""
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
    touching = find_touching(start, task.linked, task.wire, options.reach, beside=task.beside)
    none = np.zeros(len(touching.key))
    force = central(touching.gap, options.first, options.reach)
    state = State(start, touching, force, options.first, 1e-3, none, none)
    for parts in _PARTS:
        found = _solve(task, state, options, parts)
        if found.status != "out-of-reach":
            break
    return found


def solve_near(task: Task, start: Placed, touching: Touching, force: Array, options: FiniteOptions) -> Found:
    """The equilibrium near a start whose contacts have the forces (m,), such as those of a time step before."""
    none = np.zeros(len(touching.key))
    near = _near(options, options.first)
    state = State(start, touching, force, options.first, 0.0, none, none)
    return _solve(task, _found_again(state, task, near.reach), options, 1)


def _solve(task: Task, state: State, options: FiniteOptions, parts: int) -> Found:
    """The equilibrium, held rings moved in so many parts, each once the rings are calm."""
    start, whole, part = state.placed, task.at, 1
    task = replace(task, at=start.x + (whole - start.x) / parts) if parts > 1 else task
    factorize = Factorizer()
    history: list[Record] = []
    least, finest = np.inf, state
    pace, status, is_minimum, near = Patience(float(options.patience)), "iterations", False, _near(options, state.mu)
    for _ in range(options.max_iterations):
        share = way(options.first, state.mu, options.last)
        tell(f"{len(task.force)} rings, iteration {len(history) + 1}, force x gap {state.mu:.0e}", share)
        G = gradients(state.placed, state.touching)
        residual, product = kkt(state.placed, state.touching, G, state.force, task)
        product *= options.tolerance / max(options.tolerance, _PRODUCT * options.last)
        merit, has_arrived = max(residual, product), _way_to_go(state, task) < 1e-12
        is_last = state.mu <= options.last
        if has_arrived and is_last and merit < options.tolerance and is_minimum:
            status = "converged"
            break
        if has_arrived and is_last and merit < options.tolerance and task.inertia is not None:
            # A time step needs no more damping here; whether its matrix is positive definite shows without it.
            none = np.zeros(len(state.local))
            state = replace(state, damping=0.0, local=none, convex=none)
        if has_arrived and is_last and merit < least:
            least, finest = merit, state
        pace = pace.after(merit, history[-1].decrement if history else -1.0)
        is_calm = not is_last and _is_calm(history, state, options)
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
            state, near = _at_next_mu(state, task, options, is_calm)
            pace = pace.at_next(is_calm)
            G = gradients(state.placed, state.touching)
        state, record, is_minimum = _advanced(state, task, G, near, factorize)
        history.append(replace(record, residual=residual))
        if _is_stuck(history):
            status = "stalled" if has_arrived else "out-of-reach"
            break
    return _answer(finest if np.isfinite(least) and status != "converged" else state, task, status, history)


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


def _answer(state: State, task: Task, status: str, history: list[Record]) -> Found:
    residual = max(kkt(state.placed, state.touching, gradients(state.placed, state.touching), state.force, task))
    return Found(state.placed, state.touching, state.force, status, residual, tuple(history))


def _at_next_mu(state: State, task: Task, options: FiniteOptions, is_calm: bool) -> tuple[State, FiniteOptions]:
    """The state with a lower mu, or a higher one where it did not get calm, and the contacts that count there.

    The smaller mu, the nearer are the contacts that count. Where a fold runs through the mesh at a small mu, every ring
    that it meets shortens the steps; at a higher one it passes in a few.
    """
    mu = max(options.last, min(_SHRINK * state.mu, state.mu**_POWER)) if is_calm else min(_HIGHEST, _LIFT * state.mu)
    near = _near(options, mu)
    return _found_again(replace(state, mu=mu), task, near.reach), near


def _near(options: FiniteOptions, mu: float) -> FiniteOptions:
    """The options with the reach of contacts that count at a mu."""
    return replace(options, reach=min(options.reach, next(part for least, part in _NEARER if mu >= least)))


def _found_again(state: State, task: Task, reach: float) -> State:
    """The state with its contacts looked for again, forces handed on."""
    con = find_touching(state.placed, task.linked, task.wire, reach, beside=task.beside)
    force = handed_on(state.touching, state.force, con, central(con.gap, state.mu, reach))
    rows = of_pairs(state.touching.key, con.key)
    local, convex = (np.where(rows >= 0, of[rows], 0.0) for of in (state.local, state.convex))
    return replace(state, touching=con, force=force, local=local, convex=convex)


def kkt(placed: Placed, touching: Touching, G: Array, force: Array, task: Task) -> tuple[float, float]:
    """Sum of the unbalanced forces over the sum of the loads; sum of force times gap over (links times mean force)."""
    out = spread(touching, G, force, len(task.force))
    out[:, :3] += task.force
    out += springs(placed, task, 0.0)[1]
    own = out[task.free]
    unbalanced = np.abs(own if task.tie is None else task.tie.T @ own).sum()
    return float(unbalanced / task.load), float((force * touching.gap).sum() / len(task.linked))


def _way_to_go(state: State, task: Task) -> float:
    return float(np.abs(np.where(task.held, task.at - state.placed.x, 0.0)).max(initial=0.0))


def _is_calm(history: list[Record], state: State, options: FiniteOptions) -> bool:
    """Whether the last step of Newton's method at this mu could have gained next to nothing."""
    if not history or history[-1].mu != state.mu:
        return False
    return 0.0 <= history[-1].decrement < _CALM * state.mu * len(state.placed.x)


def _is_stuck(history: list[Record]) -> bool:
    return len(history) >= 25 and all(one.length < 1e-6 for one in history[-25:])


def _advanced(
    state: State, task: Task, G: Array, options: FiniteOptions, factorize: Factorizer
) -> tuple[State, Record, bool]:
    """The next iterate, its record, and whether the matrix was positive definite without damping."""
    line = linearized(state, task, G, options)
    work = Work(state.damping, state.local.copy(), state.convex.copy(), np.zeros(len(state.force)))
    new, step, length = None, None, 0.0
    for attempt in range(_TRIES + 1):
        step = newton(state, task, line, options, factorize, work)
        if step is None:
            break
        new, length = searched(state, task, line, step, options, work, is_last=attempt == _TRIES)
        if new is not None:
            break
    is_exact = state.damping < 1e-6 and state.convex.max(initial=0.0) == 0.0 and state.local.max(initial=0.0) < 1e-2
    is_minimum = is_exact and work.failed == 0
    if step is None or new is None:
        damping = max(10.0 * work.damping, 1e-6)
        record = Record(state.mu, 0.0, -1.0, 0.0, damping, len(state.force), work.trials, work.factors)
        return replace(state, damping=min(damping, 1e9)), record, False
    record = Record(state.mu, 0.0, -step.slope, length, work.damping, len(state.force), work.trials, work.factors)
    return _accepted(state, new, step, length, options, work), record, is_minimum


def _accepted(state: State, new: State, step: Step, length: float, options: FiniteOptions, work: Work) -> State:
    """The new iterate with its forces and the damping for the next step."""
    force = state.force
    with np.errstate(divide="ignore", invalid="ignore"):
        longest = np.where(step.dforce < 0.0, -0.99 * force / step.dforce, np.inf).min(initial=1.0)
    force = force + min(float(longest), length) * step.dforce
    fresh = central(new.touching.gap, state.mu, options.reach)
    force = handed_on(state.touching, force, new.touching, fresh)
    force = np.clip(force, 0.3 * fresh, 1e6 * state.mu / new.touching.gap)
    damping = 0.3 * work.damping if length > 0.3 else work.damping
    rows = of_pairs(state.touching.key, new.touching.key)
    raised = work.convex > state.convex
    convex = np.where(raised | (length <= 0.3), work.convex, 0.3 * work.convex)
    convex[convex < 0.02] = 0.0
    local, convex = (np.where(rows >= 0, of[rows], 0.0) for of in (work.local, convex))
    return replace(new, force=force, damping=damping if damping > 1e-9 else 0.0, local=local, convex=convex)
