"""Mixtures of two or three locked states that do the same work under the load of their mixed strain."""

from dataclasses import replace
from itertools import combinations
from operator import itemgetter

import numpy as np

from rve.common import Array, Flags
from rve.common.tensor import WEIGHT, double_dot
from rve.equilibrium.dead_load import MARGINS, LoadedCell, restart_patiently
from rve.equilibrium.interior_point import Equilibrium, LockedStates, unit_loads
from rve.equilibrium.largest_work import GAIN, KnownStates
from rve.geometry.kinematics import cauchy_of
from rve.geometry.pose import strain_of

MOVED = 1e-6
"""Strain by which states must differ to be two."""
SHARE_STEPS = 30
"""Steps of Newton's method for the shares of given strains."""
PART = 1e-7
"""Change of shares by which their derivatives are taken as differences."""
MIXTURE_STEPS = 30
"""Exchanges of states in a mixture; eight were the most of 59 loads at r1/r2 = 29 to 100."""
BALANCE_STEPS = 8
"""Steps of Newton's method for the load S* of coexisting states."""
WORK_TOLERANCE, LOAD_TOLERANCE = 1e-10, 1e-6
"""Differences of the works S*:E at unit trace, and of S* from that of the mixture, below which states are in balance;
after `BALANCE_STEPS` equal works are enough."""


def best_mixture(s: Array, E: Array, mesh: LoadedCell) -> tuple[list[int], Array]:
    """Up to three of the strains E (m, 3), the largest share first, whose mixture of equal works under its S answers
    the Cauchy load s (3,), and S (3,): no other strain does more work under S.

    The state of most work under S joins the mixture, or replaces some of it, as lowers its gain the most; no mixture is
    tried twice. The mixture of least gain if none answers.
    """
    chosen, answers, visited, rival = list[int](), [], set[frozenset[int]](), int(np.argmax((s * WEIGHT) @ E.T))
    for _ in range(MIXTURE_STEPS):
        tried = []
        for some in [kept for size in range(3) for kept in combinations(chosen, size)]:
            members = [rival, *some]
            shares = None if frozenset(members) in visited else equal_shares(s, E[members], mesh)
            if shares is not None:
                S = mixed_load(s, E[members], shares, mesh)
                works = E @ (S * WEIGHT)
                gain = float(works.max() - shares @ works[members])
                tried.append((gain, [members[k] for k in np.argsort(-shares)], S, int(works.argmax())))
        if not tried:
            break
        gain, chosen, S, rival = min(tried, key=itemgetter(0))
        answers.append((gain, chosen, S))
        if gain <= GAIN:
            break
        visited.add(frozenset(chosen))
    return min(answers, key=itemgetter(0))[1:]


def equal_shares(s: Array, E: Array, mesh: LoadedCell) -> Array | None:
    """Positive shares (k,) of the strains E (k, 3) that all do the same work under the S of their mixture and the
    Cauchy load s (3,), by Newton's method; None where there are none, and for strains that are the same."""
    k = len(E)
    w, loads = np.full(k, 1.0 / k), np.tile(s, (k, 1))
    if k == 1 or is_repeated(E).any():
        return w if k == 1 else None
    for _ in range(SHARE_STEPS):
        near = w + PART * np.column_stack([-np.sign(np.arange(k)), np.eye(k)[:, 1:]])
        short = (mesh.conjugate(near @ E, loads) * WEIGHT) @ (E[1:] - E[0]).T
        step = np.linalg.lstsq((short[1:] - short[0]).T / PART, -short[0], rcond=None)[0]
        step = np.append(-step.sum(), step)
        if np.abs(step).max() < 1e-12:
            return w
        w = w + min(1.0, 0.9 / max((-step / w).max(), 1e-300)) * step
        if w.min() < 1e-6:
            break
    return None


def mixed_load(s: Array, E: Array, shares: Array, mesh: LoadedCell) -> Array:
    """S (3,) of unit trace of the Cauchy load s (3,) on the mixture of the strains E (k, 3) by shares (k,)."""
    return mesh.conjugate((shares @ E)[None], s[None])[0]


def is_repeated(E: Array) -> Flags:
    """Which of the strains E (m, 3) are those of an earlier one, (m,)."""
    return np.array([bool((np.abs(E[:k] - E[k]).max(axis=1) < MOVED).any()) for k in range(len(E))])


def balance_works(
    s: Array, start: KnownStates, mesh: LoadedCell
) -> tuple[tuple[LockedStates, Array, Array] | None, KnownStates]:
    """Locked states that do the same work under the load S* of their mixture and the Cauchy load s (3,), the largest
    share first, each under the unit Cauchy load that it carries in its own pose; their shares; S* (3,). None where
    they are not found. And the states that were reached last.

    From the states `start` of a mixture; all follow its S. Narrow gaps keep a state on its branch where it would join
    another. States that have become one count once.
    """
    found: Equilibrium | None = None
    before: tuple[Array, Array] | None = None
    reached, S = start, np.zeros(3)
    for left in reversed(range(BALANCE_STEPS + 1)):
        if (own := ~is_repeated(start.E)).sum() > 1:
            start, found = start.take(own), found and found.take(own)
        shares = equal_shares(s, start.E, mesh)
        if shares is None:
            break
        to = mixed_load(s, start.E, shares, mesh)
        way, is_equal = to - S, np.ptp(start.E @ (S * WEIGHT)) <= WORK_TOLERANCE
        if found and is_equal and (not left or np.abs(way).max() <= LOAD_TOLERANCE):
            order = np.argsort(-shares)
            return (_under_own_loads(found.take(order), S, mesh), shares[order], S), reached
        if not left:
            break
        old, back = before or (to, 0.0 * way)
        turn = way - back  # the S that the states lead to depends on S: a secant step
        before, S = (to, way), to - float(way @ turn) / max(float(turn @ turn), 1e-300) * (to - old)
        loads, here = np.tile(S, (len(shares), 1)), start.pose
        for margin in MARGINS:
            new = restart_patiently(loads, mesh.dead, here, mesh.options, margin)
            start = KnownStates(new.pose, loads, strain_of(new.pose, mesh.sides))
            if equal_shares(s, start.E, mesh) is not None:
                break
        found, good = new, new.status == "converged"
        reached = start.take(good)
        if not good.all():
            break
    return None, reached


def _under_own_loads(found: Equilibrium, S: Array, mesh: LoadedCell) -> LockedStates:
    """Equilibria under the dead load S (3,) as those under the unit Cauchy loads that they carry."""
    E = strain_of(found.pose, mesh.sides)
    own = cauchy_of(unit_loads(np.tile(S, (len(E), 1))), E)
    lam = found.lam / np.sqrt(double_dot(own, own))[:, None, None]
    return LockedStates(replace(found, lam=lam), unit_loads(own), np.zeros(len(E), dtype=bool), mesh.cell)
