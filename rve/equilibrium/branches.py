"""Cauchy loads under which several locked states coexist: the one of largest work, or two or three of equal work.

Every state locked under a Cauchy load is locked under its S = J F^-1 s F^-T as well. A row (S_i, E_i) is the largest of
its states if S_i:(E_i - E_j) >= 0 for all known states j; otherwise it is solved again from j. Two states may each do
more work under the S of the other: a mesh carries the load with both side by side, under the common S* that s gives on
a mixture (1 - t) E_A + t E_B of their strains. Likewise for three states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rve.common import Array, Flags, Index, Rows, tell
from rve.common.tensor import WEIGHT, double_dot
from rve.equilibrium.dead_load import MARGINS, LoadedCell, random_poses, restart, restart_patiently, solve_dead
from rve.equilibrium.interior_point import Equilibrium, LockedStates
from rve.equilibrium.largest_work import GAIN, ROUNDS, KnownStates, Largest, climbed, largest, states_beyond
from rve.equilibrium.limits import strain_is_unique
from rve.equilibrium.mixtures import MOVED, balance_works, best_mixture
from rve.geometry.pose import Pose, start_pose, strain_of

SAMPLE = 8
"""One in so many rows, and every row of rank one, is also solved as a dead load: independent starts."""
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
        good = np.flatnonzero(np.isfinite(self.E[:, 0]))
        return KnownStates(self.found.pose.take(good), self.S[good], self.E[good]).with_images(mesh)

    def contradicted(self, states: KnownStates) -> Index:
        """Rows under whose S one of the states does more work than their own, or that are on their way."""
        return np.flatnonzero((_missing_work(self, states) > GAIN) | (self.branch == UNDECIDED))


def largest_rows(rows: RowStates, s: Array, mesh: LoadedCell) -> tuple[RowStates, Flags, Beside]:
    """The rows with their states of largest work under the Cauchy loads s (n, 3); which of them (n,) a known state
    still contradicts; what lies beside those that coexist."""
    left, beside = np.zeros(len(s), dtype=bool), Beside()
    good = rows.take(np.isfinite(rows.E[:, 0]))
    if not len(good.s):
        return rows, left, beside
    is_larger = mesh.cell.weave.is_larger
    known = states_beyond(good.found.pose, good.S, mesh) if is_larger else _dead_states(good, mesh)
    known = known.with_images(mesh)
    stalled = np.flatnonzero(np.isin(rows.found.status, ("stalled", "no-limit")))
    if len(stalled):  # on their way from a known state
        _, lead, S = _best_mixtures(s[stalled], rows.states(mesh).join([known]), mesh)
        rows = rows.put(stalled, rows.take(stalled).led(lead, S, mesh))
    for count in range(ROUNDS):
        states = rows.states(mesh).join([known])
        bad = rows.contradicted(states)
        if not len(bad):
            break
        tell(f"{len(bad)} loads for which other states do more work, round {count + 1}")
        none = Largest.of(mesh, rows.S[bad], rows.found.take(bad))
        best = climbed(none, states) if is_larger else largest(rows.S[bad], mesh, states)
        known = known.join([best.states.with_images(mesh)])
        solved, more, both = _solve_from_rivals(rows.take(bad), s[bad], states.join([known]), mesh)
        rows, known = rows.put(bad, solved), known.join([more.with_images(mesh)])
        beside |= {int(bad[i]): each for i, each in both.items()}
    left[rows.contradicted(rows.states(mesh).join([known]))] = True
    return rows, left, beside


def _best_mixtures(s: Array, states: KnownStates, mesh: LoadedCell) -> tuple[list[list[int]], Pose, Array]:
    """`best_mixture` of known states for each Cauchy load s (n, 3): states, pose of the largest share, and S (n, 3)."""
    mixtures, S = zip(*(best_mixture(each, states.E, mesh) for each in s), strict=True)
    return list(mixtures), states.pose.take(np.array([members[0] for members in mixtures])), np.array(S)


def _dead_states(good: RowStates, mesh: LoadedCell) -> KnownStates:
    """Locked states under the S of some rows as dead loads, from the slack pose and from a random admissible pose each,
    or two for weaves without images.
    """
    thin = good.S[:, 0] * good.S[:, 2] - good.S[:, 1] ** 2 < 1e-6
    sample = good.take(thin | (np.arange(len(thin)) % SAMPLE == 0))
    n, tries = len(sample.S), 2 if mesh.dead.weave.has_images else 3
    S, once = np.tile(sample.S, (tries, 1)), replace(mesh.options, attempts=1)
    start = start_pose(mesh.dead.weave, n).join([random_poses(mesh.dead, n * (tries - 1))])
    found = solve_dead(S, mesh.dead, once, start)
    return KnownStates.of(mesh, found, S, found.status == "converged")


def _missing_work(rows: RowStates, states: KnownStates) -> Array:
    """How much more work than its own state the best of the states does under the S of each row, (n,); 0 if none does,
    nan for rows without a state."""
    gain = (rows.S * WEIGHT) @ states.E.T - double_dot(rows.S, rows.E)[:, None]
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
    new = restart(s, mesh.cauchy, lead, MARGINS[0], mesh.options)

    def climb(new: Equilibrium) -> tuple[RowStates, Flags]:
        made = RowStates.of(mesh, new, s, "restart", strain_is_unique(mesh.cauchy, new, s))
        return made, _missing_work(made, known) <= GAIN

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
    fresh = np.flatnonzero(np.abs(made.E - rows.E).max(axis=1) > MOVED)
    waiting = rows.led(lead.put(fresh, new.pose.take(fresh)), S, mesh)
    left = np.flatnonzero(~climbs)
    made = made.put(left, waiting.take(left))
    for i, row in first.items():
        made = made.put(np.array([i]), row)
    return made, reached, both
