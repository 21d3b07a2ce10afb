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
from rve.equilibrium.dead_load import MARGINS, LoadedCell, follow_promising, random_poses, restart, restart_patiently
from rve.equilibrium.interior_point import Equilibrium, unit_loads
from rve.equilibrium.largest_work import GAIN, ROUNDS, KnownStates, Largest, climbed, largest, states_beyond
from rve.equilibrium.limits import balanced, strain_is_unique
from rve.equilibrium.mixtures import MOVED, best_mixture, equal_shares
from rve.geometry.pose import Pose, start_pose, strain_of

SAMPLE = 4
"""One in so many rows, and every row of rank one, is also solved as a dead load: independent starts."""
STUCK, DETOURS = 2, 12
"""Rounds after which mixtures are also looked for by so many steps in a row that do not lower their gain."""
UNDECIDED = "below"
"""Branch of a row between two rounds whose pose is that of its last rival."""
ROUND_OFF = 1e-12
"""Differences of loads S below which they are one."""
BALANCE_STEPS = 8
"""Steps of Newton's method for the load S* of coexisting states."""
WORK_TOLERANCE, LOAD_TOLERANCE = 1e-10, 1e-6
"""Differences of the works S*:E at unit trace, and of S* from that of the mixture, below which states are in balance;
after `BALANCE_STEPS` equal works are enough."""


@dataclass(frozen=True)
class RowStates(Rows):
    """Locked states under the Cauchy loads s (n, 3), weave axes: poses, S of unit trace and E (n, 3), nan where none is
    known; branch (n,): "slack", "restart" or "coexisting"; unique (n,), False for coexisting states.
    """

    pose: Pose
    S: Array
    E: Array
    branch: NDArray[np.str_]
    unique: Flags

    @staticmethod
    def of(mesh: LoadedCell, pose: Pose, s: Array, branch: str, unique: Flags) -> RowStates:
        """Locked poses under Cauchy loads."""
        E = strain_of(pose, mesh.sides)
        return RowStates(pose, mesh.conjugate(E, s), E, np.full(len(s), branch, dtype="<U16"), unique)

    @staticmethod
    def undecided(mesh: LoadedCell, pose: Pose, S: Array) -> RowStates:
        """Poses between two rounds, with the loads S (n, 3) of their mixtures, under which other states may do more."""
        branch, unique = np.full(len(S), UNDECIDED, dtype="<U16"), np.zeros(len(S), dtype=bool)
        return RowStates(pose, S, strain_of(pose, mesh.sides), branch, unique)

    def states(self, mesh: LoadedCell) -> KnownStates:
        """The known states, with their images."""
        good = np.flatnonzero(np.isfinite(self.E[:, 0]))
        return KnownStates(self.pose.take(good), self.S[good], self.E[good]).with_images(mesh)


def make_rows(found: Equilibrium, s: Array, mesh: LoadedCell) -> RowStates:
    """Rows of the converged ones of these locked states under Cauchy loads s (n, 3)."""
    nan, one = np.full((len(s), 3), np.nan), np.ones(len(s), dtype=bool)
    rows = RowStates(found.pose, nan, nan, np.full(len(s), "slack", dtype="<U16"), one)
    good = np.flatnonzero(found.status == "converged")
    return rows.put(good, RowStates.of(mesh, found.pose.take(good), s[good], "slack", one[good]))


def largest_rows(
    rows: RowStates, found: Equilibrium, s: Array, mesh: LoadedCell
) -> tuple[RowStates, Equilibrium, Flags, Flags, KnownStates]:
    """The rows and equilibria with their states of largest work; which have changed, and which a known state still
    contradicts, (n,) each; all known states.

    Equilibria of rows whose branch is "coexisting" are those under the dead load S, of the others under s.
    """
    changed, left = np.zeros((2, len(s)), dtype=bool)
    if not np.isfinite(rows.E).any():
        return rows, found, changed, left, rows.states(mesh)
    is_larger = mesh.cauchy.weave.is_larger
    known = _further_states(rows, mesh) if is_larger else _dead_states(rows, mesh)
    stalled = np.flatnonzero(np.isin(found.status, ("stalled", "no-limit")))
    if len(stalled):  # on their way from a known state
        _, lead, S = _best_mixtures(s[stalled], rows.states(mesh).join([known]), mesh)
        rows = rows.put(stalled, RowStates.undecided(mesh, lead, S))
    for count in range(ROUNDS):
        detours = DETOURS if count >= STUCK else 0
        bad, states = _contradicted(rows, known, mesh)
        if not len(bad):
            break
        tell(f"{len(bad)} loads for which other states do more work, round {count + 1}")
        S = rows.S[bad]
        if is_larger:
            own = balanced(rows.pose.take(bad), unit_loads(S), mesh.dead)
            best = climbed(Largest.of(mesh, S, own), states)
        else:
            best = largest(S, mesh, states)
        known = known.join([best.states.with_images(mesh)])
        rows, new, done, more = _solve_from_rivals(rows, s, bad, states.join([known]), mesh, detours)
        known = known.join([more.with_images(mesh)])
        found = found.put(done, new)
        changed[done] = True
    left[_contradicted(rows, known, mesh)[0]] = True
    return rows, found, changed, left, known


def states_beside(rows: RowStates, known: KnownStates, s: Array, mesh: LoadedCell) -> tuple[Index, Array, KnownStates]:
    """Coexisting rows (k,), their other states of the same work, each once, and the shares (k,) of these in the mixture
    under the Cauchy loads s (n, 3); 0 where shares are not found."""
    row, share, state = list[int](), list[float](), list[int]()
    for i in np.flatnonzero(rows.branch == "coexisting").tolist():
        under = np.flatnonzero(np.abs(rows.S[i] - known.S).max(axis=1) < ROUND_OFF)
        E = np.vstack([rows.E[i], known.E[under]])
        others = np.flatnonzero((np.abs((E - E[0]) @ (rows.S[i] * WEIGHT)) <= WORK_TOLERANCE) & ~_is_repeated(E))[1:]
        shares = equal_shares(s[i], E[[0, *others]], mesh)
        row += [i] * len(others)
        share += [0.0] * len(others) if shares is None else shares[1:].tolist()
        state += under[others - 1].tolist()
    return np.array(row, dtype=int), np.array(share), known.take(np.array(state, dtype=int))


def _is_repeated(E: Array) -> Flags:
    """Which of the strains E (m, 3) are those of an earlier one, (m,)."""
    return np.array([bool((np.abs(E[:k] - E[k]).max(axis=1) < MOVED).any()) for k in range(len(E))])


def _best_mixtures(
    s: Array, states: KnownStates, mesh: LoadedCell, detours: int = 0
) -> tuple[list[list[int]], Pose, Array]:
    """`best_mixture` of known states for each Cauchy load s (n, 3): states, pose of the largest share, and S (n, 3)."""
    mixtures, S = zip(*(best_mixture(each, states.E, mesh, detours) for each in s), strict=True)
    return list(mixtures), states.pose.take(np.array([members[0] for members in mixtures])), np.array(S)


def _further_states(rows: RowStates, mesh: LoadedCell) -> KnownStates:
    """Locked states of a larger cell that do more work under the S of some row than its own, which was found before."""
    good = rows.take(np.isfinite(rows.E[:, 0]))
    found = balanced(good.pose, unit_loads(good.S), mesh.dead)
    return states_beyond(found, good.S, mesh).with_images(mesh)


def _dead_states(rows: RowStates, mesh: LoadedCell) -> KnownStates:
    """Locked states under the S of some rows as dead loads, from the slack pose and from a random admissible pose each,
    or two for weaves without images, with their images; only those whose paths promise more work than their own row's.
    """
    good = rows.take(np.isfinite(rows.E[:, 0]))
    thin = good.S[:, 0] * good.S[:, 2] - good.S[:, 1] ** 2 < 1e-6
    sample = good.take(thin | (np.arange(len(thin)) % SAMPLE == 0))
    n, tries = len(sample.S), 2 if mesh.dead.weave.has_images else 3
    S, E = np.tile(sample.S, (tries, 1)), np.tile(sample.E, (tries, 1))
    start = start_pose(mesh.dead.weave, n).join([random_poses(mesh.dead, n * (tries - 1))])
    pick, found = follow_promising(S, E, mesh, start)
    return KnownStates.of(mesh, found, S[pick], found.status == "converged").with_images(mesh)


def _contradicted(rows: RowStates, known: KnownStates, mesh: LoadedCell) -> tuple[Index, KnownStates]:
    """Rows under whose S a known state does more work than their own, or that are on their way; all known states."""
    good = np.flatnonzero(np.isfinite(rows.E[:, 0]))
    states = rows.states(mesh).join([known])
    bad = _missing_work(rows.S[good], rows.E[good], states) > GAIN
    return good[bad | (rows.branch[good] == UNDECIDED)], states


def _missing_work(S: Array, E: Array, states: KnownStates) -> Array:
    """How much more work than the strains E (n, 3) the best of the states does under S (n, 3), (n,); 0 if none does."""
    gain = (S * WEIGHT) @ states.E.T - double_dot(S, E)[:, None]
    return np.asarray(gain.max(axis=1, initial=0.0))


def _solve_from_rivals(
    rows: RowStates, s: Array, bad: Index, known: KnownStates, mesh: LoadedCell, detours: int
) -> tuple[RowStates, Equilibrium, Index, KnownStates]:
    """The rows `bad` solved again from the best mixtures of known states; equilibria of the rows that are solved now,
    and their numbers; the states that were reached on the way.

    A row takes the state that is reached from the largest share of its mixture if no known state does more work. Else
    the states of the mixture coexist, if they can be brought to the same work. Else it goes on from the new state.
    """
    old, s = rows.E[bad], s[bad]
    mixtures, lead, S = _best_mixtures(s, known, mesh, detours)

    def climbing(new: Equilibrium) -> tuple[Flags, Array, Flags]:
        E, own, got = strain_of(new.pose, mesh.sides), np.ones((len(bad), 3)), new.status == "converged"
        own[got] = mesh.conjugate(E[got], s[got])
        return got, E, got & (_missing_work(own, E, known) <= GAIN)

    new = restart(s, mesh.cauchy, lead, MARGINS[0], mesh.options)
    got, E, climbs = climbing(new)
    rest = np.flatnonzero(~climbs)
    owner = np.repeat(np.arange(len(rest)), [len(mixtures[i]) for i in rest])
    several = known.pose.take(np.array([k for i in rest for k in mixtures[i]], dtype=int))
    both, S_star, fine, more = balance_works(s[rest], owner, several, new.take(rest), mesh)
    ok = rest[fine]
    # Most rows that stall are two states in balance: a patient restart is left to the others.
    slow = np.setdiff1d(np.flatnonzero(~got), ok)
    if len(slow):
        new = new.put(slow, restart_patiently(s[slow], mesh.cauchy, lead.take(slow), mesh.options))
        got, E, climbs = climbing(new)
    pick, left = np.flatnonzero(climbs), np.setdiff1d(np.flatnonzero(~climbs), ok)
    unique = strain_is_unique(mesh.cauchy, new, s)[pick]
    rows = rows.put(bad[pick], RowStates.of(mesh, new.pose.take(pick), s[pick], "restart", unique))
    some = RowStates.of(mesh, both.pose.take(fine), s[ok], "coexisting", np.zeros(len(ok), dtype=bool))
    rows = rows.put(bad[ok], replace(some, S=S_star[fine]))
    fresh = np.flatnonzero(got[left] & (np.abs(E[left] - old[left]).max(axis=1) > MOVED))
    pose = lead.take(left).put(fresh, new.pose.take(left[fresh]))
    rows = rows.put(bad[left], RowStates.undecided(mesh, pose, S[left]))
    keep = np.sort(np.concatenate([pick, ok]))
    return rows, new.put(ok, both.take(fine)).take(keep), bad[keep], more


def balance_works(
    s: Array, owner: Index, pose: Pose, before: Equilibrium, mesh: LoadedCell
) -> tuple[Equilibrium, Array, Flags, KnownStates]:
    """Equilibria (k,) of the largest shares under the dead loads S* at which the states of each row do the same work;
    S* (k, 3); where it was found; all states that were reached. Poses (q,) are starts, that of the largest share first,
    for the rows owner (q,); equilibria `before` (k,) stay where no S* is found.

    S is that of the mixture of strains, and all states follow it; narrow gaps keep a state on its branch where it would
    join another. States that join all the same count once.
    """
    first, members = np.unique(owner, return_index=True)[1], [np.flatnonzero(owner == i) for i in range(len(s))]
    E, S, fine = strain_of(pose, mesh.sides), np.zeros((len(s), 3)), np.zeros(len(s), dtype=bool)
    trail: dict[int, tuple[Array, Array]] = {}
    open_ = [i for i, own in enumerate(members) if len(own) > 1]
    found = replace(before.take(owner), status=np.full(len(owner), "stalled", dtype="<U16"))

    def equal(i: int) -> bool:
        return bool(np.ptp(E[members[i]] @ (S[i] * WEIGHT)) <= WORK_TOLERANCE)

    for _ in range(BALANCE_STEPS):
        left = []
        for i in open_:
            own = members[i]
            other = ~_is_repeated(E[own])  # two that have become one state count once
            members[i] = own[other] if other.sum() > 1 else own
            shares = equal_shares(s[i], E[members[i]], mesh)
            if shares is None:
                continue
            first[i] = members[i][np.argmax(shares)]
            to = mesh.conjugate((shares @ E[members[i]])[None], s[i : i + 1])[0]
            way = to - S[i]
            fine[i] = equal(i) and np.abs(way).max() <= LOAD_TOLERANCE
            if not fine[i]:
                left.append(i)
                old, back = trail.get(i, (to, 0.0 * way))
                turn = way - back  # the S that the states lead to depends on S: a secant step
                trail[i], S[i] = (to, way), to - (way @ turn) / max(turn @ turn, 1e-300) * (to - old)
        if not left:
            break
        lost = left
        for margin in MARGINS:
            pick = np.concatenate([members[i] for i in lost])
            new = restart_patiently(S[owner[pick]], mesh.dead, pose.take(pick), mesh.options, margin)
            found = found.put(pick, new)
            E[pick] = strain_of(new.pose, mesh.sides)
            lost = [i for i in lost if equal_shares(s[i], E[members[i]], mesh) is None]
            if not lost:
                break
        pose = found.pose
        open_ = [i for i in left if (found.status[members[i]] == "converged").all()]
    else:
        fine[open_] = [equal(i) and equal_shares(s[i], E[members[i]], mesh) is not None for i in open_]
    return found.take(first), S, fine, KnownStates.of(mesh, found, S[owner], found.status == "converged")
