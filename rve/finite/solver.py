"""Equilibrium of a finite mesh: a primal-dual interior-point Newton method with the exact sparse matrix.

Minimise -f.x subject to gap >= 0 at every local minimum of every near pair. Contacts follow force gap = mu (1 - gap/R)
as mu -> 0, so that a contact at the reach R has no force and enters smoothly. Lengths are in units of r1, forces in
units of the load's mean force on a link, so that mu is relative.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rve.common.types import Array
from rve.finite.equations import BLOCK, blocks, gradients, matrix, metric, spread
from rve.finite.factor import Factorizer
from rve.finite.touching import (
    Index,
    Placed,
    Touching,
    find_touching,
    handed_on,
    safe_parts,
    links_intact,
    nearest,
    passes_through,
    ways,
)

_SOFT = 1e-10
WHY=[]


@dataclass(frozen=True)
class FiniteOptions:
    """Options of `FiniteMesh.solve`; lengths in units of r1, forces in units of the mean force on a link.

    mu_start, mu_end: first and last product of force and gap; shrink, power: mu falls to the lesser of shrink mu and
    mu^power. tolerance: of the Karush-Kuhn-Tucker residual. reach: gap beyond which a contact is not looked at.
    step: largest way of held rings in one iteration. method: "cholmod", "superlu" or "auto". patience: iterations
    without progress after which mu falls all the same.
    """

    tolerance: float = 1e-8
    mu_start: float = 0.1
    mu_end: float = 1e-10
    shrink: float = 0.3
    power: float = 1.15
    reach: float = 0.6
    step: float = 0.3
    max_iterations: int = 1000
    method: str = "auto"
    patience: int = 25
    calm: float = 0.02


@dataclass(frozen=True, eq=False)
class Task:
    """What is solved: linked pairs (m, 2), wire, dead forces (n, 3), held coordinates (n, 3) and where, free (n, 5)."""

    linked: Index
    wire: float
    force: Array
    held: NDArray[np.bool_]
    at: Array
    free: NDArray[np.bool_]

    @property
    def keys(self) -> Index:
        """Keys of the linked pairs."""
        return np.asarray(self.linked[:, 0] * len(self.force) + self.linked[:, 1])


@dataclass(frozen=True, eq=False)
class _State:
    placed: Placed
    touching: Touching
    lift: Array
    force: Array
    mu: float
    damping: float
    local: Array

    @property
    def share(self) -> Array:
        return shares_of(self.touching)

    @property
    def gap(self) -> Array:
        """Gaps with what overlapping pairs are still allowed."""
        return self.touching.gap + self.lift[self.touching.minima.pair]


@dataclass(frozen=True, eq=False)
class Record:
    """One iteration: mu, residual of the forces, part of the step taken, damping, contacts, trials, factors."""

    mu: float
    residual: float
    off: float
    length: float
    damping: float
    contacts: int
    trials: int
    factors: int
    lifted: float
    decrement: float = 0.0


def solve_rings(
    task: Task, start: Placed, options: FiniteOptions, say: Callable[[Record], None] | None = None
) -> tuple[Placed, Touching, Array, str, list[Record]]:
    """Placement, contacts, forces, why it stopped, history."""
    factorize = Factorizer(options.method)
    touching = find_touching(start, task.linked, task.wire, options.reach)
    lift = np.where(touching.deepest > 0.0, 0.0, 0.1 * task.wire - np.minimum(touching.deepest, 0.0))
    mu = options.mu_start
    state = _State(start, touching, lift, np.zeros(len(touching.gap)), mu, 1e-3, np.zeros(len(touching.key)))
    state = replace(state, force=central(state.gap, mu * state.share, options.reach))
    history: list[Record] = []
    idle, best = 0, np.inf
    for _ in range(options.max_iterations):
        G = gradients(state.placed, state.touching)
        residual, off = _measure(state, task, G, options)
        there = bool(np.abs(np.where(task.held, task.at - state.placed.x, 0.0)).max(initial=0.0) < 1e-13)
        there = there and not state.lift.any()
        if there and state.mu <= options.mu_end and residual < 1e-9 and off < options.mu_end * 10:
            return state.placed, state.touching, state.force, "converged", history
        merit = max(residual, off)
        idle = 0 if merit < 0.9 * best else idle + 1
        best = min(best, merit)
        calm = history and 0 < history[-1].decrement < options.calm * state.mu * len(state.force) and history[-1].mu == state.mu
        if there and (merit < 10.0 * state.mu or calm or idle >= options.patience):
            mu = max(options.mu_end, min(options.shrink * state.mu, state.mu**options.power))
            state, idle, best = replace(state, mu=mu), 0, np.inf
        state, record = _advanced(state, task, G, options, factorize)
        history.append(replace(record, residual=residual, off=off))
        if say is not None:
            say(history[-1])
        if len(history) > 40 and all(one.length < 1e-6 for one in history[-25:]):
            return state.placed, state.touching, state.force, "stalled", history
    return state.placed, state.touching, state.force, "iterations", history


SOFT_FROM = 0.3


def shares_of(con: Touching) -> Array:
    """Parts (m,) of mu: two minima of a pair that are about to merge count half each."""
    double = con.count[con.minima.pair] >= 2
    t = np.clip(con.minima.curvature / SOFT_FROM, 0.0, 1.0)
    return np.where(double, 1.0 + 0 * t, 1.0)


def central(gap: Array, mu: Array | float, reach: float) -> Array:
    """Forces on the central path."""
    return np.asarray(mu * np.maximum(1.0 / gap - 1.0 / reach, 1e-8))


def _measure(state: _State, task: Task, G: Array, options: FiniteOptions) -> tuple[float, float]:
    """Largest unbalanced force on a free coordinate, and largest distance of force gap from the central path."""
    out = spread(state.touching, G, state.force, len(task.force))
    out[:, :3] += task.force
    gap = state.gap
    off = np.abs(state.force * gap - state.mu * state.share * np.maximum(1.0 - gap / options.reach, 0.0)).max(initial=0.0)
    return float(np.abs(np.where(task.free, out, 0.0)).max()), float(off)


def potential(state: _State, task: Task, options: FiniteOptions) -> float:
    gap = np.minimum(state.gap / options.reach, 1.0)
    return float(-(task.force * state.placed.x).sum() + state.mu * (state.share * (gap - 1.0 - np.log(gap))).sum())


def _advanced(
    state: _State, task: Task, G: Array, options: FiniteOptions, factorize: Factorizer
) -> tuple[_State, Record]:
    mu, reach = state.mu, options.reach
    con, gap, lam = state.touching, state.gap, state.force
    pair = con.minima.pair
    n = len(task.force)
    mus = mu * state.share
    stiff = (lam + mus / reach) / gap
    lowered = 0.9 * state.lift
    pull = mus * (1.0 / gap - 1.0 / reach) + stiff * lowered[pair]
    rhs = spread(con, G, pull, n)
    rhs[:, :3] += task.force
    K = blocks(state.placed, con, G, stiff, lam, 1e-6 * mu)
    held = np.where(task.held, task.at - state.placed.x, 0.0)
    far = np.sqrt((held**2).sum(axis=1)).max(initial=0.0)
    held = held * min(1.0, options.step / max(far, 1e-300))
    full = np.zeros((n, BLOCK))
    full[:, :3] = held
    weight = np.bincount(pair, lam, minlength=len(con.key))
    heavy = np.maximum(weight, 0.1 * mu * np.isin(con.key, task.keys))
    damping, local, factors, trials, new, length = state.damping, state.local.copy(), 0, 0, None, 1.0
    now = potential(state, task, options)
    moving = far > 0.0 or bool(state.lift.any())
    for attempt in range(8):
        while True:
            shifted = K + metric(con, heavy * (damping + local))
            if far > 0.0:
                v = np.concatenate([full[con.a], full[con.b]], axis=1)
                w = np.matmul(shifted, v[:, :, None])[:, :, 0]
                push = rhs.copy()
                for k in range(BLOCK):
                    push[:, k] -= np.bincount(con.a, w[:, k], minlength=n) + np.bincount(con.b, w[:, 5 + k], minlength=n)
            else:
                push = rhs
            A = matrix(con, shifted, np.full((n, BLOCK), _SOFT + 1e-6 * damping), task.free)
            solve = factorize(A)
            factors += 1
            if solve is not None or damping > 1e8:
                break
            damping = max(1e-3, 5.0 * damping)
        if solve is None:
            return state, Record(mu, 0.0, 0.0, 0.0, damping, len(lam), 0, factors, 0.0)
        q = solve(np.where(task.free, push, 0.0).ravel()).reshape(n, BLOCK)
        q = np.where(task.free, q, 0.0) + full
        dx, tilt = q[:, :3], q[:, 3:]
        dgap = (G * np.concatenate([q[con.a], q[con.b]], axis=1)[pair]).sum(axis=1) - lowered[pair]
        dlam = (mus * (1.0 - gap / reach) - lam * gap) / gap - stiff * dgap
        slope = -float((np.where(task.free, rhs, 0.0) * q).sum())
        safe = safe_parts(con, dx, tilt, task.wire, reach)
        with np.errstate(divide="ignore", invalid="ignore"):
            reachable = np.where(dgap < 0.0, -0.995 * gap / dgap, 1.0)
        length = min(float(safe.min()), float(reachable.min(initial=1.0)))
        while length > 1e-9:
            trials += 1
            step = length * q
            new, why, bad = _tried(state, task, step, length, lowered, options)
            for _ in range(2):
                if why != "gap":
                    break
                miss = _missed(state, bad, length * (dgap + lowered[pair]))
                back = spread(con, G, -stiff * miss, n)
                step = step + solve(np.where(task.free, back, 0.0).ravel()).reshape(n, BLOCK)
                trials += 1
                new, why, bad = _tried(state, task, step, length, lowered, options)
            if why == "gap":
                bad = bad.key[(bad.deepest <= 0.0)]
            if new is not None:
                if moving or _fell(state, new, now, length * slope, task, options):
                    break
                new, why = None, "rise"
            WHY.append(why)
            if why == "gap" and attempt < 7:
                break
            if why == "rise" and attempt < 7 and length < 0.3:
                damping = max(4 * damping, 1e-3)
                break
            length *= 0.5
        if new is not None:
            break
        if why == "gap":
            place = np.minimum(np.searchsorted(con.key, bad), len(con.key) - 1)
            rows = place[con.key[place] == bad]
            local[rows] = np.maximum(8.0 * local[rows], 1.0)
            if len(rows) < len(bad) or not len(rows):
                damping = max(4 * damping, 1e-2)
    tight = safe < 0.5
    local[tight] = np.maximum(2.0 * local[tight], 0.1)
    local[~tight] *= 0.4
    local[local < 1e-3] = 0.0
    if new is None:
        return replace(state, damping=max(10.0 * damping, 1e-6)), Record(
            mu, 0.0, 0.0, 0.0, damping, len(lam), trials, factors, 0.0
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        longest = np.where(dlam < 0.0, -0.99 * lam / dlam, np.inf).min(initial=1.0)
    lam = lam + min(longest, length) * dlam
    fresh = central(new.gap, mu * new.share, reach)
    lam = handed_on(con, lam, new.touching, fresh)
    lam = np.clip(lam, 1e-6 * fresh, 1e6 * mu / new.gap)
    damping = 0.3 * damping if length > 0.3 else damping
    damping = damping if damping > 1e-9 else 0.0
    place = np.minimum(np.searchsorted(con.key, new.touching.key), len(con.key) - 1)
    local = np.where(con.key[place] == new.touching.key, local[place], 0.0)
    new = replace(new, force=lam, damping=damping, local=local)
    return new, Record(mu, 0.0, 0.0, length, damping, len(lam), trials, factors, float(new.lift.max(initial=0.0)), -slope)


def _tried(
    state: _State, task: Task, step: Array, length: float, lowered: Array, options: FiniteOptions
):
    """The state after a part of the step, or None if rings overlap, unlink or may have passed through each other."""
    dx, tilt = step[:, :3], step[:, 3:]
    placed = state.placed.moved(dx, tilt)
    con = find_touching(placed, task.linked, task.wire, options.reach)
    old = state.touching
    lift = np.zeros(len(con.key))
    place = np.minimum(np.searchsorted(old.key, con.key), len(old.key) - 1)
    known = old.key[place] == con.key
    kept = state.lift - length * lowered
    lift[known] = kept[place[known]]
    # pairs that are near at both ends: no wire has passed through another
    way = ways(old, dx, tilt)
    back = np.minimum(np.searchsorted(con.key, old.key), len(con.key) - 1)
    both = con.key[back] == old.key
    limit = 2.0 * task.wire + options.reach
    d0 = np.minimum(old.deepest + 2.0 * task.wire, limit)
    d1 = np.where(both, np.minimum(con.deepest[back] + 2.0 * task.wire, limit), limit)
    if (way >= d0 + d1).any():
        return None, 'way', con.key[:0]
    before = np.where(known, np.minimum((old.deepest + state.lift)[place], 1.0), 1.0)
    slack = con.deepest + lift
    if (slack < 0.002 * np.minimum(before, options.reach)).any():
        return None, 'gap', con
    if not links_intact(placed, con, task.keys):
        return None, 'link', con.key[:0]
    if passes_through(state.placed, placed, old.key, con.key):
        return None, 'pass', con.key[:0]
    lift = np.clip(0.5 * np.minimum(slack, 1.0) - np.minimum(con.deepest, 1.0), 0.0, lift)
    lift[lift < 1e-14] = 0.0
    return _State(placed, con, lift, np.zeros(0), state.mu, state.damping, np.zeros(len(con.key))), "", con


def _fell(old: _State, new: _State, before: float, slope: float, task: Task, options: FiniteOptions) -> bool:
    """Whether the barrier function fell enough; pairs whose number of minima changed count by their deepest alone."""
    after = potential(new, task, options) + _correction(old, new, options)
    return after <= before + 1e-4 * slope + 1e-11 * (1.0 + abs(before))


def _correction(old: _State, new: _State, options: FiniteOptions) -> float:
    """What the barrier rose by because minima split, merged, appeared or vanished, to be left out."""

    def per_pair(state: _State) -> tuple[Array, Array]:
        g = np.minimum(state.gap / options.reach, 1.0)
        value = g - 1.0 - np.log(g)
        total = np.bincount(state.touching.minima.pair, value, minlength=len(state.touching.key))
        d = np.minimum((state.touching.deepest + state.lift) / options.reach, 1.0)
        return total, d - 1.0 - np.log(d)

    (t0, s0), (t1, s1) = per_pair(old), per_pair(new)
    a, b = old.touching, new.touching
    place = np.minimum(np.searchsorted(a.key, b.key), len(a.key) - 1)
    changed = (a.key[place] == b.key) & (a.count[place] != b.count) & (a.count[place] > 0) & (b.count > 0)
    i = place[changed]
    return float(new.mu * ((s1[changed] - s0[i]) - (t1[changed] - t0[i])).sum())


def _missed(state, new, linear):
    """By how much the gaps (m,) at a trial differ from their linear forecast; 0 where a pair's minima changed."""
    heir, far = nearest(state.touching, new)
    good = (heir >= 0) & (far < 0.1)
    miss = new.gap[heir] - state.touching.gap - linear
    return np.where(good, np.minimum(miss, 0.0), 0.0)
