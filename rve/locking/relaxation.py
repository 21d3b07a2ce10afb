"""Cauchy loads under which several locked states coexist: the one of largest work, or two or three of equal work.

Every state locked under a Cauchy load is locked under its S = J F^-1 s F^-T as well. A row (S_i, E_i) is the largest of
its states if S_i:(E_i - E_j) >= 0 for all known states j, those that `search` finds under its S among them; otherwise
it is solved again from j. Two states may each do more work under the S of the other: a mesh carries the load with both
side by side, under the common S* that s gives on a mixture (1 - t) E_A + t E_B of their strains. Likewise for three
states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from rve.common import Array, Flags, Index, Rows, tell
from rve.common.tensor import WEIGHT, double_dot
from rve.geometry.kinematics import cauchy_of
from rve.geometry.pose import Pose, strain_of
from rve.locking.dead_load import RESTART, LoadedCell, restart, restart_patiently
from rve.locking.global_search import SEARCH, BestStates, KnownStates, search, states_beyond
from rve.locking.interior_point import Equilibrium, LockedStates, unit_loads
from rve.locking.limits import strain_is_unique


@dataclass(frozen=True)
class MixtureOptions:
    """Numbers of states that coexist."""

    moved: float = 1e-6
    """Strain by which states must differ to be two."""
    share_steps: int = 30
    """Steps of Newton's method for the shares of given strains."""
    part: float = 1e-7
    """Change of shares by which their derivatives are taken as differences."""
    mixture_steps: int = 30
    """Exchanges of states in a mixture; eight were the most of 59 loads at r1/r2 = 29 to 100."""
    balance_steps: int = 8
    """Steps of Newton's method for the load S* of coexisting states."""
    work_tolerance: float = 1e-10
    load_tolerance: float = 1e-6
    """Differences of the works S*:E at unit trace, and of S* from that of the mixture, below which states are in
    balance; after `MIXTURE.balance_steps` equal works are enough."""


MIXTURE = MixtureOptions()
UNDECIDED = "below"
"""Branch of a row between two rounds whose pose is that of its last rival."""
Beside = dict[int, tuple[Array, LockedStates]]
"""Of rows in which several states coexist: the shares of the other states, and these."""


@dataclass(frozen=True)
class RowStates(Rows):
    """The locked states of the rows of a table: equilibria under the Cauchy loads s (n, 3), weave axes; S of unit trace
    and E (n, 3), nan where no state is known; branch (n,): "slack", "restart" or "coexisting"; unique (n,), False for
    coexisting states, of which the one with the largest share is here, under the unit load that it carries in its own
    pose.
    """

    found: Equilibrium
    s: Array
    S: Array
    E: Array
    branch: NDArray[np.str_]
    unique: Flags

    @staticmethod
    def of(mesh: LoadedCell, found: Equilibrium, s: Array, branch: str, unique: Flags) -> RowStates:
        """Rows of equilibria under Cauchy loads, known where these have converged."""
        S, E = np.full((2, len(s), 3), np.nan)
        good = np.flatnonzero(found.status == "converged")
        E[good] = strain_of(found.pose.take(good), mesh.sides)
        S[good] = mesh.conjugate(E[good], s[good])
        return RowStates(found, s, S, E, np.full(len(s), branch, dtype="<U16"), unique)

    @staticmethod
    def coexisting(states: LockedStates, S: Array, mesh: LoadedCell) -> RowStates:
        """The row of the first of these states of equal work under S (3,)."""
        one = states.take(np.array([0]))
        return replace(RowStates.of(mesh, one.found, one.s, "coexisting", one.unique), S=S[None])

    def led(self, pose: Pose, S: Array, mesh: LoadedCell) -> RowStates:
        """These rows at poses between two rounds, with the loads S (n, 3) of their mixtures, under which other states
        may do more work."""
        branch, unique = np.full(len(S), UNDECIDED, dtype="<U16"), np.zeros(len(S), dtype=bool)
        return RowStates(replace(self.found, pose=pose), self.s, S, strain_of(pose, mesh.sides), branch, unique)

    def states(self, mesh: LoadedCell) -> KnownStates:
        """The known states, with their images."""
        good = np.isfinite(self.E[:, 0])
        return KnownStates.of(mesh, self.found.pose.take(good), self.S[good])

    def as_best(self, mesh: LoadedCell) -> BestStates:
        """The rows as the best states so far under their S; those on their way are none."""
        work = np.where(self.branch == UNDECIDED, -np.inf, double_dot(self.S, self.E))
        return BestStates.of(mesh, self.S, self.found, work)

    def contradicted(self, states: KnownStates) -> Index:
        """Rows under whose S one of the states does more work than their own, or that are on their way."""
        return np.flatnonzero((_missing_work(self, states) > SEARCH.gain) | (self.branch == UNDECIDED))


def largest_rows(rows: RowStates, s: Array, mesh: LoadedCell, sample: KnownStates) -> tuple[RowStates, Flags, Beside]:
    """The rows with their states of largest work under the Cauchy loads s (n, 3); which of them (n,) a known state
    still contradicts; what lies beside those that coexist.

    Every row is searched under its S from the `sample`, as a dead load by itself is, and again whenever its S changes.
    """
    left, beside = np.zeros(len(s), dtype=bool), Beside()
    good = rows.take(np.isfinite(rows.E[:, 0]))
    if not len(good.s):
        return rows, left, beside
    is_larger = mesh.cell.weave.is_larger
    known = states_beyond(good.found.pose, good.S, mesh) if is_larger else sample
    stalled = np.flatnonzero(np.isin(rows.found.status, ("stalled", "no-limit")))
    if len(stalled):  # on their way from a known state
        _, lead, S = _best_mixtures(s[stalled], rows.states(mesh).join([known]), mesh)
        rows = rows.put(stalled, rows.take(stalled).led(lead, S, mesh))
    fresh = np.flatnonzero(np.isfinite(rows.E[:, 0]))
    for count in range(SEARCH.rounds + 1):
        states = rows.states(mesh).join([known])
        if is_larger:  # a search of every row would take too long
            fresh = rows.contradicted(states)
        best = search(rows.take(fresh).as_best(mesh), states if is_larger else sample, states)
        better = best.branch == "restart"
        known = known.join([KnownStates.of(mesh, best.found.pose.take(better), best.S[better])])
        states = rows.states(mesh).join([known])
        bad = rows.contradicted(states)
        if not len(bad) or count == SEARCH.rounds:
            break
        tell(f"{len(bad)} loads for which other states do more work, round {count + 1}")
        solved, more, both = _solve_from_rivals(rows.take(bad), s[bad], states, mesh)
        rows, known, fresh = rows.put(bad, solved), known.join([more]), bad
        beside |= {int(bad[i]): each for i, each in both.items()}
    left[bad] = True
    return rows, left, beside


def _best_mixtures(s: Array, states: KnownStates, mesh: LoadedCell) -> tuple[list[list[int]], Pose, Array]:
    """`best_mixture` of known states for each Cauchy load s (n, 3): states, pose of the largest share, and S (n, 3)."""
    mixtures, S = zip(*(best_mixture(each, states.E, mesh) for each in s), strict=True)
    return list(mixtures), states.pose.take(np.array([members[0] for members in mixtures])), np.array(S)


def _missing_work(rows: RowStates, states: KnownStates) -> Array:
    """How much more work than its own state the best of the states does under the S of each row, (n,); 0 if none does,
    nan for rows without a state."""
    gain = states.works(rows.S) - double_dot(rows.S, rows.E)[:, None]
    return np.asarray(gain.max(axis=1, initial=0.0))


def _solve_from_rivals(
    rows: RowStates, s: Array, known: KnownStates, mesh: LoadedCell
) -> tuple[RowStates, KnownStates, Beside]:
    """The rows solved again from the best mixtures of known states; the states that were reached on the way; what lies
    beside those that coexist.

    A row takes the state that is reached from the largest share of its mixture if no known state does more work. Else
    the states of the mixture coexist, if they can be brought to the same work. Else it goes on from the new state.
    """
    mixtures, lead, S = _best_mixtures(s, known, mesh)
    new = restart(s, mesh.cauchy, lead, RESTART.margins[0], mesh.options)

    def climb(new: Equilibrium) -> tuple[RowStates, Flags]:
        made = RowStates.of(mesh, new, s, "restart", strain_is_unique(mesh.cauchy, new, s))
        return made, _missing_work(made, known) <= SEARCH.gain

    made, climbs = climb(new)
    both, first, reached = Beside(), dict[int, RowStates](), known.take(np.zeros(0, dtype=int))
    for i in np.flatnonzero(~climbs).tolist():
        if len(mixtures[i]) > 1:
            balanced, more = balance_works(s[i], known.take(np.array(mixtures[i])), mesh)
            reached = reached.join([more])
            if balanced is not None:
                states, shares, S_star = balanced
                rest = np.arange(1, len(shares))
                both[i], first[i] = (shares[rest], states.take(rest)), RowStates.coexisting(states, S_star, mesh)
    # Most rows that stall are states in balance: a patient restart is left to the others.
    slow = np.array([i for i in np.flatnonzero(new.status != "converged") if i not in both], dtype=int)
    if len(slow):
        new = new.put(slow, restart_patiently(s[slow], mesh.cauchy, lead.take(slow), mesh.options))
        made, climbs = climb(new)
    fresh = np.flatnonzero(np.abs(made.E - rows.E).max(axis=1) > MIXTURE.moved)
    waiting = rows.led(lead.put(fresh, new.pose.take(fresh)), S, mesh)
    left = np.flatnonzero(~climbs)
    made = made.put(left, waiting.take(left))
    for i, row in first.items():
        made = made.put(np.array([i]), row)
    return made, KnownStates.of(mesh, reached.pose, reached.S), both


def best_mixture(s: Array, E: Array, mesh: LoadedCell) -> tuple[list[int], Array]:
    """Up to three of the strains E (m, 3), the largest share first, whose mixture of equal works under its S answers
    the Cauchy load s (3,), and S (3,): no other strain does more work under S.

    The state of most work under S joins the mixture, or replaces some of it, as lowers its gain the most; no mixture is
    tried twice. The mixture of least gain if none answers.
    """
    chosen, answers, visited, rival = list[int](), [], set[frozenset[int]](), int(np.argmax((s * WEIGHT) @ E.T))
    for _ in range(MIXTURE.mixture_steps):
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
        if gain <= SEARCH.gain:
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
    for _ in range(MIXTURE.share_steps):
        near = w + MIXTURE.part * np.column_stack([-np.sign(np.arange(k)), np.eye(k)[:, 1:]])
        short = (mesh.conjugate(near @ E, loads) * WEIGHT) @ (E[1:] - E[0]).T
        step = np.linalg.lstsq((short[1:] - short[0]).T / MIXTURE.part, -short[0], rcond=None)[0]
        step = np.append(-step.sum(), step)
        if np.abs(step).max() < 1e-12:
            return w
        w = w + min(1.0, 0.9 / max((-step / w).max(), 1e-300)) * step
        if w.min() < 1e-6:
            break
    return None


def mixed_load(s: Array, E: Array, shares: Array, mesh: LoadedCell) -> Array:
    """S (3,) of unit trace of the Cauchy load s (3,) on the mixture of the strains E (k, 3) by shares (k,)."""
    return np.asarray(mesh.conjugate((shares @ E)[None], s[None])[0])


def is_repeated(E: Array) -> Flags:
    """Which of the strains E (m, 3) are those of an earlier one, (m,)."""
    return np.array([bool((np.abs(E[:k] - E[k]).max(axis=1) < MIXTURE.moved).any()) for k in range(len(E))])


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
    for left in reversed(range(MIXTURE.balance_steps + 1)):
        if (own := ~is_repeated(start.E)).sum() > 1:
            start, found = start.take(own), found and found.take(own)
        shares = equal_shares(s, start.E, mesh)
        if shares is None:
            break
        to = mixed_load(s, start.E, shares, mesh)
        way, is_equal = to - S, np.ptp(start.E @ (S * WEIGHT)) <= MIXTURE.work_tolerance
        if found and is_equal and (not left or np.abs(way).max() <= MIXTURE.load_tolerance):
            order = np.argsort(-shares)
            return (_under_own_loads(found.take(order), S, mesh), shares[order], S), reached
        if not left:
            break
        old, back = before or (to, 0.0 * way)
        turn = way - back  # the S that the states lead to depends on S: a secant step
        before, S = (to, way), to - float(way @ turn) / max(float(turn @ turn), 1e-300) * (to - old)
        loads, here = np.tile(S, (len(shares), 1)), start.pose
        for margin in RESTART.margins:
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
