"""Equilibrium of a finite mesh: a primal-dual interior-point Newton method with the exact sparse matrix.

Minimise -f.x subject to gap >= 0 at every local minimum of every near pair. Contacts follow force gap = mu (1 - gap/R)
as mu -> 0, so that a contact at the reach R has no force and enters smoothly. Lengths are in units of r1, forces in
units of the load's mean force on a link, so that mu is relative.

Gaps stay positive in every accepted step and no step can carry a wire through another (`touching`). Held rings travel
to their places in steps of a part of r1. Where the linear forecast of a gap fails, the step is corrected for what was
missed; where that is not enough, the two rings of the pair are damped against each other, and only they.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rve.common.types import Array
from rve.finite.equations import BLOCK, blocks, gradients, lacking, matrix, metric, pair_vectors, spread, times
from rve.finite.factor import Factorizer
from rve.finite.iterate import Linear, State, Step, Work, barrier, central
from rve.finite.records import FiniteOptions, Found, Record, Task
from rve.finite.search import searched
from rve.finite.touching import Placed, Touching, find_touching, handed_on, of_pairs

_SOFT = 1e-10
"""Stiffness of every coordinate: rings that nothing touches stay where they are."""
_IDLE = 1e-6
"""Contacts with less force than this part of mu do without curvature."""
X = dict(proj=1, c0=0.2, c1=3.0, cd=0.3, low=0.3, high=1e6, patience=12, lift=30.0, grow=1.5)
_TRIES = 7
"""Times a step is damped pair by pair before it is shortened."""

_NEARER = ((1e-2, np.inf), (1e-4, 0.3), (0.0, 0.15))
"""Reach from these mu on, in r1: contacts farther away have next to no force, and cost as much as others."""


def solve_rings(
    task: Task, start: Placed, options: FiniteOptions, say: Callable[[Record], None] | None = None
) -> Found:
    """The equilibrium from a start without overlaps and with its links right; a failure has its status."""
    factorize = Factorizer(options.method)
    touching = find_touching(start, task.linked, task.wire, options.reach, beside=task.beside)
    force = central(touching.gap, options.mu_start, options.reach)
    state = State(start, touching, force, options.mu_start, 1e-3, np.zeros(len(touching.key)))
    history: list[Record] = []
    least, finest = np.inf, state
    idle, best, status, is_minimum, turns = 0, np.inf, "iterations", False, 0
    base, here, patience = options, 0, float(X['patience'])
    for _ in range(options.max_iterations):
        G = gradients(state.placed, state.touching)
        residual, product = kkt(state.touching, G, state.force, task)
        has_arrived = _way_to_go(state, task) < 1e-12
        if has_arrived and is_minimum and max(residual, product) < options.tolerance and state.mu <= options.mu_end:
            status = "converged"
            break
        merit = max(residual, product)
        if has_arrived and state.mu <= options.mu_end and merit < least:
            least, finest = merit, state
        idle, best = (0, merit) if merit < 0.9 * best else (idle + 1, best)
        is_calm = state.mu > options.mu_end and _is_calm(history, state, options)
        here += 1
        mu = state.mu
        if has_arrived and is_calm:
            mu = max(options.mu_end, min(options.shrink * mu, mu**options.power))
        elif has_arrived and here > patience and (state.mu > options.mu_end or idle >= options.patience):
            turns += 1
            if turns > options.retries:
                status = "stalled"
                break
            if state.mu <= options.mu_end:
                task = replace(task, beside=not task.beside)
                state = _found_again(state, task, options.reach)
            mu = min(options.mu_start, X['lift'] * mu)
            patience *= X['grow']
        if mu != state.mu:
            state, idle, best, here = replace(state, mu=mu), 0, np.inf, 0
            state, options = _nearer(state, task, options, base.reach)
            G = gradients(state.placed, state.touching)
        state, record, is_minimum = _advanced(state, task, G, options, factorize)
        history.append(replace(record, residual=residual))
        if say is not None:
            say(history[-1])
        if _is_stuck(history):
            status = "stalled" if has_arrived else "out-of-reach"
            break
    return _answer(finest if np.isfinite(least) and status != "converged" else state, task, status, history)


def _answer(state: State, task: Task, status: str, history: list[Record]) -> Found:
    residual = max(kkt(state.touching, gradients(state.placed, state.touching), state.force, task))
    return Found(state.placed, state.touching, state.force, status, residual, tuple(history))


def _nearer(state: State, task: Task, options: FiniteOptions, widest: float) -> tuple[State, FiniteOptions]:
    """The state with the contacts that count at its mu: the smaller mu, the nearer they are."""
    part = next(part for least, part in _NEARER if state.mu >= least)
    reach = min(widest, part)
    if reach == options.reach:
        return state, options
    return _found_again(state, task, reach), replace(options, reach=reach)


def _found_again(state: State, task: Task, reach: float) -> State:
    """The state with its contacts looked for again, forces handed on."""
    con = find_touching(state.placed, task.linked, task.wire, reach, beside=task.beside)
    force = handed_on(state.touching, state.force, con, central(con.gap, state.mu, reach))
    rows = of_pairs(state.touching.key, con.key)
    return replace(state, touching=con, force=force, local=np.where(rows >= 0, state.local[rows], 0.0))


def kkt(touching: Touching, G: Array, force: Array, task: Task) -> tuple[float, float]:
    """Sum of the unbalanced forces over the sum of the loads; sum of force times gap over (links times mean force)."""
    out = spread(touching, G, force, len(task.force))
    out[:, :3] += task.force
    unbalanced = np.abs(np.where(task.free, out, 0.0)).sum()
    return float(unbalanced / np.abs(task.force).sum()), float((force * touching.gap).sum() / len(task.linked))


def _way_to_go(state: State, task: Task) -> float:
    return float(np.abs(np.where(task.held, task.at - state.placed.x, 0.0)).max(initial=0.0))


def _is_calm(history: list[Record], state: State, options: FiniteOptions) -> bool:
    """Whether the last step of Newton's method at this mu could have gained next to nothing."""
    if not history or history[-1].mu != state.mu:
        return False
    return 0.0 <= history[-1].decrement < options.calm * state.mu * len(state.placed.x)


def _is_stuck(history: list[Record]) -> bool:
    return len(history) >= 25 and all(one.length < 1e-6 for one in history[-25:])


def _linearized(state: State, task: Task, G: Array, options: FiniteOptions) -> Linear:
    con, gap, mu, reach = state.touching, state.touching.gap, state.mu, options.reach
    stiff = (state.force + mu / reach) / gap
    rhs = spread(con, G, mu * (1.0 / gap - 1.0 / reach), len(task.force))
    rhs[:, :3] += task.force
    K = blocks(state.placed, con, G, stiff, state.force, _IDLE * mu)
    way = np.where(task.held, task.at - state.placed.x, 0.0)
    far = float(np.sqrt((way**2).sum(axis=1)).max(initial=0.0))
    held = np.zeros((len(way), BLOCK))
    held[:, :3] = way * min(1.0, options.step / max(far, 1e-300))
    # Damping is measured in the force that a pair carries: pairs near supports need more of it.
    carried = np.bincount(con.minima.pair, state.force, minlength=len(con.key))
    heavy = np.maximum(carried, 0.1 * mu * np.isin(con.key, task.keys))
    value = barrier(state.placed, con, task, mu, reach)
    return Linear(G, stiff, K, rhs, held, heavy, value, far > 0.0)


def _newton(
    state: State, task: Task, line: Linear, options: FiniteOptions, factorize: Factorizer, work: Work
) -> Step | None:
    """The step of the damped equations, with more damping where their matrix is not positive definite."""
    con, n = state.touching, len(task.force)
    while True:
        K = line.blocks + metric(line.heavy * (work.damping + work.local))
        if work.convex > 0.0:
            if work.lacking is None:
                work.lacking = lacking(line.blocks)
            K += work.convex * work.lacking
        push = line.rhs - times(con, K, line.held, n) if line.is_moving else line.rhs
        solve = factorize(matrix(con, K, np.full((n, BLOCK), _SOFT + 1e-6 * work.damping), task.free))
        work.factors += 1
        if solve is not None:
            break
        if work.damping > 1e8:
            return None
        if X['proj'] and work.convex < 1.0:
            work.convex = min(1.0, max(X['c0'], X['c1'] * work.convex))
            continue
        work.damping = max(1e-3, 5.0 * work.damping)
    q = solve(np.where(task.free, push, 0.0).ravel()).reshape(n, BLOCK)
    q = np.where(task.free, q, 0.0) + line.held
    gap = con.gap
    dgap = (line.G * pair_vectors(con, q)[con.minima.pair]).sum(axis=1)
    dforce = (state.mu * (1.0 - gap / options.reach) - state.force * gap) / gap - line.stiff * dgap
    slope = -float((np.where(task.free, line.rhs, 0.0) * q).sum())
    return Step(q, dgap, dforce, slope, solve)


def _advanced(
    state: State, task: Task, G: Array, options: FiniteOptions, factorize: Factorizer
) -> tuple[State, Record, bool]:
    """The next iterate, its record, and whether the matrix was positive definite without damping."""
    line = _linearized(state, task, G, options)
    work = Work(state.damping, state.local.copy(), state.convex)
    new, step, length = None, None, 0.0
    for attempt in range(_TRIES + 1):
        step = _newton(state, task, line, options, factorize, work)
        if step is None:
            break
        new, length = searched(state, task, line, step, options, work, is_last=attempt == _TRIES)
        if new is not None:
            break
    is_minimum = work.factors == 1 and state.damping < 1e-6 and state.convex == 0.0 and state.local.max(initial=0.0) < 1e-2
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
    force = np.clip(force, X['low'] * fresh, X['high'] * state.mu / new.touching.gap)
    damping = 0.3 * work.damping if length > 0.3 else work.damping
    rows = of_pairs(state.touching.key, new.touching.key)
    local = np.where(rows >= 0, work.local[rows], 0.0)
    convex = X['cd'] * work.convex if length > 0.3 else work.convex
    return replace(
        new,
        force=force,
        damping=damping if damping > 1e-9 else 0.0,
        local=local,
        convex=convex if convex > 0.02 else 0.0,
    )
