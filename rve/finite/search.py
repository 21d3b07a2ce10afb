"""The part of a step that a finite mesh can take: no wire through another, no gap closed, links intact.

Where gaps would close the step is corrected with the factor at hand; where that is not enough, the two rings of each
such pair are damped against each other and the step is asked for again.
"""

from dataclasses import replace

import numpy as np

from rve.common import Array, Index
from rve.finite.newton import Iteration, Step
from rve.finite.passage import is_passage_safe
from rve.finite.touching import Touching, followed_gaps, links_intact, of_pairs

_TURNS = 3
"""Trials of a step, as it is and corrected."""
_FARTHEST = 0.995
"""Part of a gap that the linear forecast of a step may close."""
_LEAST = 0.002
"""Part of a pair's gap that must be left after a step."""


def search(now: Iteration, step: Step, *, is_last: bool) -> tuple[Touching | None, float]:
    """The contacts after the longest good part of the step, and the part.

    None where more damping was asked for instead."""
    with np.errstate(divide="ignore", invalid="ignore"):
        open_ = np.where(step.dgap < 0.0, -_FARTHEST * now.con.gap / step.dgap, 1.0)
    length = min(1.0, float(step.safe.min()), float(open_.min(initial=1.0)))
    new = None
    while length > 1e-9:
        new, closing = _try_part(now, step, length)
        if new is not None:
            break
        if len(closing) and not is_last:
            # More damping for the pairs whose gaps would close; for all where one of them was not near before.
            known = of_pairs(now.con.key, closing)
            known, local, damping = known[known >= 0], now.state.local.copy(), now.state.damping
            local[known] = np.maximum(30.0 * local[known], 5.0)
            if len(known) < len(closing):
                damping = max(4.0 * damping, 1e-2)
            now.state = replace(now.state, local=local, damping=damping)
            return None, 0.0
        length *= 0.5
    local = np.where(step.safe < 0.5, np.maximum(2.0 * now.state.local, 0.1), 0.4 * now.state.local)
    now.state = replace(now.state, local=np.where(local < 1e-3, 0.0, local))
    return new, length


def _try_part(now: Iteration, step: Step, length: float) -> tuple[Touching | None, Index]:
    """The contacts after a part of the step, corrected for what known contacts fall short of, None where it is no good;
    and the keys of the pairs whose gaps would close."""
    con, task = now.con, now.task
    q, forecast = length * step.q, con.gap + length * step.dgap
    before = np.minimum(con.deepest, con.reach)
    least = _LEAST * before[con.minima.pair]
    closed: Index = con.key[:0]
    for turn in range(_TURNS):
        now.trials += 1
        placed = con.placed.moved(q)
        gap = followed_gaps(con, placed)
        last, closed = closed, np.unique(con.key[con.minima.pair[gap < least]])
        if not len(closed):
            break
        if turn and len(closed) >= len(last):
            return None, closed
        q = q + now.answer(step, -step.stiff * np.minimum(gap - forecast, 0.0))
    else:
        return None, closed
    found = task.find(placed, con.reach)
    row = of_pairs(con.key, found.key)
    closed = found.key[found.deepest < _LEAST * np.where(row >= 0, before[row], con.reach)]
    is_good = not len(closed) and is_passage_safe(con, found, q) and links_intact(found, task.keys)
    is_good = is_good and (now.is_moving or _fell(now, found, length * step.slope))
    return found if is_good else None, closed


def _fell(now: Iteration, new: Touching, slope: float) -> bool:
    """Whether the barrier function fell enough, to rounding.

    Where the number of a pair's contacts has changed, only its deepest one counts.
    """

    def beyond_deepest(con: Touching) -> Array:
        total = np.bincount(con.minima.pair, con.barrier(con.gap), minlength=len(con.key))
        return np.asarray(total - con.barrier(con.deepest))

    old, mu = now.con, now.state.mu
    row = of_pairs(old.key, new.key)
    changed = (row >= 0) & (old.count[row] != new.count) & (old.count[row] > 0) & (new.count > 0)
    more = (beyond_deepest(new) - beyond_deepest(old)[row])[changed]
    after = now.task.barrier(new, mu) - float(new.greater(mu)[changed] @ more)
    return after <= now.barrier + 1e-4 * slope + 1e-11 * (1.0 + abs(now.barrier))
