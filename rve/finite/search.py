"""The part of a step that a finite mesh can take: no wire through another, no gap closed, links intact.

Where gaps would close the step is corrected with the factor at hand; where that is not enough, the two rings of each
such pair are damped against each other and the step is asked for again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rve.common.types import Array
from rve.finite.equations import spread
from rve.finite.iterate import Linear, State, Step, Work, barrier
from rve.finite.passage import is_passage_safe
from rve.finite.records import FiniteOptions, Task
from rve.finite.touching import (
    Index,
    Placed,
    Touching,
    find_touching,
    followed_gaps,
    links_intact,
    of_pairs,
)

_TURNS = 3
"""Trials of a step, as it is and corrected."""
_FARTHEST = 0.995
"""Part of a gap that the linear forecast of a step may close."""
_LEAST = 0.002
"""Part of a pair's gap that must be left after a step."""


def searched(
    state: State,
    task: Task,
    line: Linear,
    step: Step,
    options: FiniteOptions,
    work: Work,
    *,
    is_last: bool,
) -> tuple[State | None, float]:
    """The iterate after the longest good part of the step; None where more damping was asked for instead."""
    con, gap = state.touching, state.touching.gap
    with np.errstate(divide="ignore", invalid="ignore"):
        open_ = np.where(step.dgap < 0.0, -_FARTHEST * gap / step.dgap, 1.0)
    length = min(1.0, float(step.safe.min()), float(open_.min(initial=1.0)))
    new = None
    while length > 1e-9:
        new, bad = _corrected(state, task, line, step, length, options, work)
        if new is not None and not line.is_moving and not _fell(state, new, line, length * step.slope, task, options):
            new, work.why = None, "rise"
        if new is not None:
            break
        if work.why == "gap" and not is_last:
            _damp_pairs(con, bad, work)
            return None, 0.0
        if work.why == "rise" and not is_last and length < 0.3:
            work.damping = max(4.0 * work.damping, 1e-3)
            return None, 0.0
        length *= 0.5
    tight = step.safe < 0.5
    work.local = np.where(tight, np.maximum(2.0 * work.local, 0.1), 0.4 * work.local)
    work.local[work.local < 1e-3] = 0.0
    return new, length


def _damp_pairs(con: Touching, bad: Index, work: Work) -> None:
    """More damping for the pairs whose gaps would close; for all where one of them was not near before."""
    rows = of_pairs(con.key, bad)
    known = rows >= 0
    work.local[rows[known]] = np.maximum(30.0 * work.local[rows[known]], 5.0)
    if not known.all() or not len(bad):
        work.damping = max(4.0 * work.damping, 1e-2)


def _corrected(
    state: State, task: Task, line: Linear, step: Step, length: float, options: FiniteOptions, work: Work
) -> tuple[State | None, Index]:
    """The iterate after a part of the step, corrected for what known contacts fall short of.

    None where it is no good; then the keys of the pairs whose gaps would close.
    """
    con, n = state.touching, len(task.force)
    q, forecast = length * step.q, con.gap + length * step.dgap
    least = _LEAST * np.minimum(con.deepest, options.reach)[con.minima.pair]
    closed: Index = con.key[:0]
    for turn in range(_TURNS):
        work.trials += 1
        placed = state.placed.moved(q)
        gap = followed_gaps(con, placed, task.wire)
        if (gap >= least).all():
            return _found(state, task, placed, q, options, work)
        work.why, last = "gap", closed
        closed = np.unique(con.key[con.minima.pair[gap < least]])
        if turn and len(closed) >= len(last):
            break
        back = spread(con, line.G, -step.stiff * np.minimum(gap - forecast, 0.0), n)
        q = q + step.solve(back)
    return None, closed


def _found(
    state: State, task: Task, placed: Placed, q: Array, options: FiniteOptions, work: Work
) -> tuple[State | None, Index]:
    """The iterate at a trial that known contacts allow, after a whole search; None as in `_corrected`."""
    found = find_touching(placed, task.linked, task.wire, options.reach, beside=task.beside)
    closing = _is_closing(state.touching, found, options.reach)
    work.why = "gap" if closing.any() else _fault(state, task, placed, found, q, options)
    return None if work.why else replace(state, placed=placed, touching=found), found.key[closing]


def _is_closing(old: Touching, found: Touching, reach: float) -> NDArray[np.bool_]:
    """Pairs (p,) of `found` with next to nothing left of the gap that they had."""
    rows = of_pairs(old.key, found.key)
    before = np.where(rows >= 0, np.minimum(old.deepest[rows], reach), reach)
    return np.asarray(found.deepest < _LEAST * before)


def _fault(state: State, task: Task, placed: Placed, found: Touching, q: Array, options: FiniteOptions) -> str:
    """What is wrong with a trial whose gaps are open: "way", "link", or nothing."""
    if not is_passage_safe(state.placed, state.touching, placed, found, q, task.wire, options.reach):
        return "way"
    return "" if links_intact(placed, found, task.keys) else "link"


def _fell(old: State, new: State, line: Linear, slope: float, task: Task, options: FiniteOptions) -> bool:
    """Whether the barrier function fell enough, to rounding."""
    after = barrier(new.placed, new.touching, task, old.mu, options.reach)
    after += old.mu * _split(old.touching, new.touching, options.reach)
    return after <= line.barrier + 1e-4 * slope + 1e-11 * (1.0 + abs(line.barrier))


def _split(old: Touching, new: Touching, reach: float) -> float:
    """What the barrier rose by where the number of a pair's contacts changed, its deepest one left out, negative."""

    def parts(con: Touching) -> tuple[Array, Array]:
        g, d = (np.minimum(x / reach, 1.0) for x in (con.gap, con.deepest))
        total = np.bincount(con.minima.pair, g - 1.0 - np.log(g), minlength=len(con.key))
        return np.asarray(total), d - 1.0 - np.log(d)

    (all_old, one_old), (all_new, one_new) = parts(old), parts(new)
    i = of_pairs(old.key, new.key)
    changed = (i >= 0) & (old.count[i] != new.count) & (old.count[i] > 0) & (new.count > 0)
    i = i[changed]
    return float(((one_new[changed] - one_old[i]) - (all_new[changed] - all_old[i])).sum())
