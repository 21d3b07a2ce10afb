"""Cauchy loads under which several locked states coexist: the one of largest work, or two of equal work.

A Cauchy load has no potential, but every state locked under it is locked under its S = J F^-1 s F^-T as well. A row
(S_i, E_i) is the largest of its states if no known state does more work under S_i: S_i:(E_i - E_j) >= 0 for all j.
Where a state does, the row is solved again from it. It may be that each of two states does more work than the other
under the S of the other. Then no single state is the answer: a large mesh carries the load with both states side by
side. Their common load S*, under which both do the same work, is the one that s gives on a mixture
(1 - t) E_A + t E_B of their strains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rve.common.progress import tell
from rve.common.records import Flags, Index, Rows
from rve.common.tensor import WEIGHT, double_dot
from rve.common.types import Array
from rve.equilibrium.dead_load import MARGINS, LoadedCell, follow_promising, random_poses, restart, restart_patiently
from rve.equilibrium.interior_point import Equilibrium, unit_loads
from rve.equilibrium.largest_work import GAIN, KnownStates, Largest, balanced, climbed, largest, states_beyond
from rve.equilibrium.limits import strain_is_unique
from rve.geometry.pose import Pose, start_pose

SAMPLE = 4
"""One in so many rows, and every row of rank one, is also solved as a dead load: independent starts."""
ROUNDS = 4
"""Rounds of restarts at most; a row that still contradicts a known state has the status "below"."""
MOVED = 1e-6
"""Strain by which a state must differ from the old one of its row to be another state."""
UNDECIDED = "below"
"""Branch of a row between two rounds whose pose is that of its last rival."""
BALANCE_STEPS = 20
WORK_TOLERANCE = 1e-10
"""Difference of the works S*:E_A and S*:E_B at unit trace at which two coexisting states are in balance."""


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
        E = mesh.strain(pose)
        return RowStates(pose, mesh.conjugate(E, s), E, np.full(len(s), branch, dtype="<U16"), unique)

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
) -> tuple[RowStates, Equilibrium, Flags, Flags]:
    """The rows and equilibria with their states of largest work; which have changed, and which a known state still
    contradicts, (n,) each.

    Equilibria of rows whose branch is "coexisting" are those under the dead load S, of the others under s.
    """
    changed, left = np.zeros((2, len(s)), dtype=bool)
    if not np.isfinite(rows.E).any():
        return rows, found, changed, left
    is_larger = mesh.cauchy.weave.is_larger
    known = _further_states(rows, mesh) if is_larger else _dead_states(rows, mesh)
    for count in range(ROUNDS):
        bad, states = _contradicted(rows, known, mesh)
        if not len(bad):
            break
        tell(f"{len(bad)} loads for which other states do more work, round {count + 1}")
        S = rows.S[bad]
        if is_larger:
            own = balanced(rows.pose.take(bad), unit_loads(S), mesh.dead, mesh.options.reach)
            best = climbed(Largest.of(mesh, S, own), states)
        else:
            best = largest(S, mesh, states)
        rivals = best.states
        known = known.join([rivals.with_images(mesh)])
        bad = bad[np.isfinite(best.h)]
        rows, new, done = _solve_from_rivals(rows, s, bad, rivals.pose, known.join([states]), mesh)
        found = found.put(done, new)
        changed[done] = True
    left[_contradicted(rows, known, mesh)[0]] = True
    return rows, found, changed, left


def _further_states(rows: RowStates, mesh: LoadedCell) -> KnownStates:
    """Locked states of a larger cell that do more work under the S of some row than its own, which was found before."""
    good = rows.take(np.isfinite(rows.E[:, 0]))
    found = balanced(good.pose, unit_loads(good.S), mesh.dead, mesh.options.reach)
    return states_beyond(found, good.S, mesh).with_images(mesh)


def _dead_states(rows: RowStates, mesh: LoadedCell) -> KnownStates:
    """Locked states under the S of some rows as dead loads, from the slack pose and from a random admissible pose each,
    with their images; only those whose paths promise more work than the state of their own row does.
    """
    good = rows.take(np.isfinite(rows.E[:, 0]))
    thin = good.S[:, 0] * good.S[:, 2] - good.S[:, 1] ** 2 < 1e-6
    sample = good.take(thin | (np.arange(len(thin)) % SAMPLE == 0))
    n = len(sample.S)
    S, E = np.tile(sample.S, (2, 1)), np.tile(sample.E, (2, 1))
    start = start_pose(mesh.dead.weave, n).join([random_poses(mesh.dead, n)])
    pick, found = follow_promising(S, E, mesh, start)
    ended = np.flatnonzero(found.status == "converged")
    pose = found.pose.take(ended)
    return KnownStates(pose, S[pick[ended]], mesh.strain(pose)).with_images(mesh)


def _contradicted(rows: RowStates, known: KnownStates, mesh: LoadedCell) -> tuple[Index, KnownStates]:
    """Rows under whose S a known state, or the image of one, does more work than their own, and rows that are still
    on their way; all known states.
    """
    good = np.flatnonzero(np.isfinite(rows.E[:, 0]))
    states = rows.states(mesh).join([known])
    bad = _missing_work(rows.S[good], rows.E[good], states) > GAIN
    return good[bad | (rows.branch[good] == UNDECIDED)], states


def _missing_work(S: Array, E: Array, states: KnownStates) -> Array:
    """How much more work than the strains E (n, 3) the best of the states does under S (n, 3), (n,); 0 if none does."""
    gain = (S * WEIGHT) @ states.E.T - double_dot(S, E)[:, None]
    return np.asarray(gain.max(axis=1, initial=0.0))


def _solve_from_rivals(
    rows: RowStates, s: Array, bad: Index, rivals: Pose, known: KnownStates, mesh: LoadedCell
) -> tuple[RowStates, Equilibrium, Index]:
    """The rows `bad` solved again from their rivals, poses (k,) that do more work under their S; equilibria of the rows
    that are solved now, and their numbers.

    A row takes the state that is reached from its rival if no known state does more work. Otherwise it coexists with
    its rival, if each does more work under the S of the other. Otherwise it goes on from the state that was reached, or
    from its rival if that is where it came from.
    """
    old, s = rows.E[bad], s[bad]
    new = restart_patiently(s, mesh.cauchy, rivals, mesh.options)
    E, S = mesh.strain(new.pose), np.ones((len(bad), 3))
    got = new.status == "converged"
    S[got] = mesh.conjugate(E[got], s[got])
    climbs = got & (_missing_work(S, E, known) <= GAIN)
    pick, rest = np.flatnonzero(climbs), np.flatnonzero(~climbs)
    unique = strain_is_unique(mesh.cauchy, new, s)[pick]
    rows = rows.put(bad[pick], RowStates.of(mesh, new.pose.take(pick), s[pick], "restart", unique))
    if not len(rest):
        return rows, new, bad
    both, S_star, fine = balance_works(s[rest], rows.pose.take(bad[rest]), rivals.take(rest), mesh)
    ok, left = rest[fine], rest[~fine]
    some = RowStates.of(mesh, both.pose.take(fine), s[ok], "coexisting", np.zeros(len(ok), dtype=bool))
    rows = rows.put(bad[ok], replace(some, S=S_star[fine]))
    fresh = np.flatnonzero(got[left] & (np.abs(E[left] - old[left]).max(axis=1) > MOVED))
    pose = rivals.take(left).put(fresh, new.pose.take(left[fresh]))
    rows = rows.put(bad[left], RowStates.of(mesh, pose, s[left], UNDECIDED, np.zeros(len(left), dtype=bool)))
    keep = np.sort(np.concatenate([pick, ok]))
    return rows, new.put(ok, both.take(fine)).take(keep), bad[keep]


def balance_works(s: Array, first: Pose, second: Pose, mesh: LoadedCell) -> tuple[Equilibrium, Array, Flags]:
    """Equilibria (k,) under the dead loads S* at which two states do the same work; S* (k, 3); where it was found.

    The share t of the second state is found by the Illinois method: t = 0 has the second state do more work, t = 1 the
    first. Both states follow the load from step to step. The equilibrium is that of the larger share.
    """
    poses = [first, second]
    E = [mesh.strain(pose) for pose in poses]
    low, high = np.zeros(len(s)), np.ones(len(s))
    t, S = 0.5 * high, mesh.conjugate(E[0], s)
    g_low, g_high = double_dot(S, E[1] - E[0]), double_dot(mesh.conjugate(E[1], s), E[1] - E[0])
    fine = (g_low > 0.0) & (g_high < 0.0)
    found = [restart(S, mesh.dead, pose, MARGINS[0], replace(mesh.options, max_iterations=0)) for pose in poses]
    open_, last_up = np.flatnonzero(fine), np.full(len(s), -1)
    for _ in range(BALANCE_STEPS):
        if not len(open_):
            break
        i = open_
        t[i] = low[i] + (high[i] - low[i]) * g_low[i] / (g_low[i] - g_high[i])
        S[i] = mesh.conjugate((1.0 - t[i])[:, None] * E[0][i] + t[i][:, None] * E[1][i], s[i])
        for k in range(2):
            new = restart_patiently(S[i], mesh.dead, poses[k].take(i), mesh.options)
            found[k], poses[k] = found[k].put(i, new), poses[k].put(i, new.pose)
            E[k][i] = mesh.strain(new.pose)
            fine[i] &= new.status == "converged"
        g = double_dot(S[i], E[1][i] - E[0][i])
        up = g > 0.0
        again = up == last_up[i]
        g_high[i] = np.where(up, np.where(again, 0.5 * g_high[i], g_high[i]), g)
        g_low[i] = np.where(up, g, np.where(again, 0.5 * g_low[i], g_low[i]))
        last_up[i] = up
        low[i], high[i] = np.where(up, t[i], low[i]), np.where(up, high[i], t[i])
        open_ = i[(np.abs(g) > WORK_TOLERANCE) & fine[i]]
    fine[open_] = False
    take = np.flatnonzero(t > 0.5)
    return found[0].put(take, found[1].take(take)), S, fine
