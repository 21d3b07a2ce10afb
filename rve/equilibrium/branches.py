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
from rve.common.tensor import WEIGHT, double_dot, trace
from rve.common.types import Array
from rve.equilibrium.dead_load import MARGINS, DeadLoad, follow_promising, random_poses, restart, restart_patiently
from rve.equilibrium.interior_point import DirectOptions, Equilibrium, unit_loads
from rve.equilibrium.larger_cells import balanced, states_beyond
from rve.equilibrium.largest_work import GAIN, KnownStates, Largest, climbed, largest
from rve.equilibrium.limits import strain_is_unique
from rve.equilibrium.locked_states import LockedStates
from rve.equilibrium.system import Equations
from rve.geometry.kinematics import deformation_gradient, second_pk
from rve.geometry.pose import Pose, start_pose, strain_of

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


@dataclass(frozen=True)
class LoadedCell:
    """What does not change: equations under Cauchy and under dead loads, sides of the reference cell in r1, options."""

    cauchy: Equations
    dead: Equations
    sides: tuple[float, float]
    options: DirectOptions

    @staticmethod
    def of(equations: Equations, sides: tuple[float, float], options: DirectOptions) -> LoadedCell:
        """The mesh of these equations under Cauchy loads."""
        return LoadedCell(equations, replace(equations, load=DeadLoad(sides)), sides, options)

    def conjugate(self, E: Array, s: Array) -> Array:
        """S (n, 3) of unit trace of the Cauchy loads s on cells with the strains E, by the rotation rule."""
        S = second_pk(deformation_gradient(E), s)
        return np.asarray(S / trace(S)[:, None])


def make_rows(states: LockedStates, mesh: LoadedCell) -> RowStates:
    """Rows of the converged ones of these locked states."""
    pose, s, good = states.pose, states.s, states.found.status == "converged"
    E = np.where(good[:, None], strain_of(pose, mesh.sides), np.nan)
    S = np.full(E.shape, np.nan)
    S[good] = mesh.conjugate(E[good], s[good])
    return RowStates(pose, S, E, np.full(len(s), "slack", dtype="<U16"), np.ones(len(s), dtype=bool))


def largest_rows(rows: RowStates, s: Array, mesh: LoadedCell) -> tuple[RowStates, Equilibrium | None, Index, Flags]:
    """The rows with their states of largest work; equilibria of the changed rows and their numbers; contradicted (n,).

    Equilibria of rows whose branch is "coexisting" are those under the dead load S, of the others under s.
    """
    found: Equilibrium | None = None
    where, left = np.zeros(0, dtype=np.intp), np.zeros(len(s), dtype=bool)
    if not np.isfinite(rows.E).any():
        return rows, found, where, left
    is_larger = mesh.cauchy.weave.is_larger
    known = (further_states if is_larger else dead_states)(rows, mesh)
    for count in range(ROUNDS):
        bad, states = find_contradictions(rows, known, mesh)
        if not len(bad):
            break
        tell(f"{len(bad)} loads for which other states do more work, round {count + 1}")
        if is_larger:
            best = climb(rows.take(bad), states, mesh)
        else:
            best = largest(rows.S[bad], mesh.dead, mesh.sides, mesh.options, states)
        rivals = best.states(mesh.sides)
        known = known.plus(rivals.with_images(mesh.cauchy.weave.has_images))
        bad = bad[np.isfinite(best.h)]
        rows, new, done = solve_from_rivals(rows, s, bad, rivals.pose, known.plus(states), mesh)
        found, where = merge_equilibria(found, where, new, done)
    bad, _ = find_contradictions(rows, known, mesh)
    left[bad] = True
    return rows, found, where, left


def further_states(rows: RowStates, mesh: LoadedCell) -> KnownStates:
    """Locked states of a larger cell that do more work under the S of some row than its own, which was found before."""
    good = rows.take(np.flatnonzero(np.isfinite(rows.E[:, 0])))
    found = balanced(good.pose, unit_loads(good.S), mesh.dead, mesh.options.reach)
    return states_beyond(found, good.S, mesh.dead, mesh.sides, mesh.options).with_images(mesh.cauchy.weave.has_images)


def climb(rows: RowStates, states: KnownStates, mesh: LoadedCell) -> Largest:
    """The largest work under the S of these rows that is reached from the states that do more work than their own."""
    found = balanced(rows.pose, unit_loads(rows.S), mesh.dead, mesh.options.reach)
    none = np.full(len(rows.S), -np.inf)
    best = Largest(rows.S, found, none, np.full(len(rows.S), "slack", dtype="<U16"), [[] for _ in rows.S])
    return climbed(best, states, mesh.dead, mesh.sides, mesh.options)


def merge_equilibria(
    found: Equilibrium | None, where: Index, new: Equilibrium | None, rows: Index
) -> tuple[Equilibrium | None, Index]:
    """Equilibria of the rows `where`, replaced or joined by `new` ones of `rows`."""
    if new is None or not len(rows):
        return found, where
    if found is None:
        return new, rows
    keep = np.flatnonzero(~np.isin(where, rows))
    both = np.concatenate([where[keep], rows])
    order = np.argsort(both)
    return found.take(keep).join([new]).take(order), both[order]


def dead_states(rows: RowStates, mesh: LoadedCell) -> KnownStates:
    """Locked states under the S of some rows as dead loads, from the slack pose and from a random admissible pose each,
    with their images; only those whose paths promise more work than the state of their own row does.
    """
    good = np.flatnonzero(np.isfinite(rows.E[:, 0]))
    S = rows.S[good]
    thin = S[:, 0] * S[:, 2] - S[:, 1] ** 2 < 1e-6
    sample = rows.take(good[thin | (np.arange(len(good)) % SAMPLE == 0)])
    n = len(sample.S)
    S, E = np.tile(sample.S, (2, 1)), np.tile(sample.E, (2, 1))
    start = start_pose(mesh.dead.weave, n).join([random_poses(mesh.dead, n)])
    pick, found = follow_promising(S, E, mesh.dead, mesh.sides, mesh.options, start)
    ended = np.flatnonzero(found.status == "converged")
    pose = found.pose.take(ended)
    return KnownStates(pose, S[pick[ended]], strain_of(pose, mesh.sides)).with_images(mesh.cauchy.weave.has_images)


def find_contradictions(rows: RowStates, known: KnownStates, mesh: LoadedCell) -> tuple[Index, KnownStates]:
    """Rows under whose S a known state, or the image of one, does more work than their own, and rows that are still
    on their way; all known states.
    """
    good = np.flatnonzero(np.isfinite(rows.E[:, 0]))
    own = KnownStates(rows.pose.take(good), rows.S[good], rows.E[good]).with_images(mesh.cauchy.weave.has_images)
    states = own.plus(known)
    bad = missing_work(rows.S[good], rows.E[good], states) > GAIN
    return good[bad | (rows.branch[good] == UNDECIDED)], states


def missing_work(S: Array, E: Array, states: KnownStates) -> Array:
    """How much more work than the strains E (n, 3) the best of the states does under S (n, 3), (n,); 0 if none does."""
    gain = (S * WEIGHT) @ states.E.T - double_dot(S, E)[:, None]
    return np.asarray(gain.max(axis=1, initial=0.0))


def solve_from_rivals(
    rows: RowStates, s: Array, bad: Index, rivals: Pose, known: KnownStates, mesh: LoadedCell
) -> tuple[RowStates, Equilibrium | None, Index]:
    """The rows `bad` solved again from their rivals, poses (k,) that do more work under their S; equilibria of the rows
    that are solved now, and their numbers.

    A row takes the state that is reached from its rival if no known state does more work. Otherwise it coexists with
    its rival, if each does more work under the S of the other. Otherwise it goes on from the state that was reached, or
    from its rival if that is where it came from.
    """
    old = rows.E[bad]
    new = restart_patiently(s[bad], mesh.cauchy, rivals, mesh.options)
    E, S = strain_of(new.pose, mesh.sides), np.ones((len(bad), 3))
    got = new.status == "converged"
    S[got] = mesh.conjugate(E[got], s[bad[got]])
    climbs = got & (missing_work(S, E, known) <= GAIN)
    pick, rest = np.flatnonzero(climbs), np.flatnonzero(~climbs)
    if len(pick):
        unique = strain_is_unique(mesh.cauchy, new.take(pick), s[bad[pick]])
        rows = replace_rows(rows, bad[pick], new.pose.take(pick), S[pick], E[pick], "restart", unique)
    if not len(rest):
        return rows, new, bad
    both, S_star, fine = balance_works(s[bad[rest]], rows.pose.take(bad[rest]), rivals.take(rest), mesh)
    ok, on = np.flatnonzero(fine), np.flatnonzero(~fine)
    pose, where = both.pose.take(ok), bad[rest[ok]]
    rows = replace_rows(
        rows, where, pose, S_star[ok], strain_of(pose, mesh.sides), "coexisting", np.zeros(len(ok), bool)
    )
    left, where = rest[on], bad[rest[on]]
    fresh = np.flatnonzero(got[left] & (np.abs(E[left] - old[left]).max(axis=1) > MOVED))
    pose = rivals.take(left).put(fresh, new.pose.take(left[fresh]))
    E = strain_of(pose, mesh.sides)
    rows = replace_rows(rows, where, pose, mesh.conjugate(E, s[where]), E, UNDECIDED, np.zeros(len(on), bool))
    keep = np.sort(np.concatenate([pick, rest[ok]]))
    return rows, new.put(rest[ok], both.take(ok)).take(keep), bad[keep]


def replace_rows(
    rows: RowStates, where: Index, pose: Pose, S: Array, E: Array, branch: str, unique: Flags
) -> RowStates:
    """The rows with other states at `where`."""
    return rows.put(where, RowStates(pose, S, E, np.full(len(where), branch, dtype="<U16"), unique))


def balance_works(s: Array, first: Pose, second: Pose, mesh: LoadedCell) -> tuple[Equilibrium, Array, Flags]:
    """Equilibria (k,) under the dead loads S* at which two states do the same work; S* (k, 3); where it was found.

    The share t of the second state is found by the Illinois method: t = 0 has the second state do more work, t = 1 the
    first. Both states follow the load from step to step. The equilibrium is that of the larger share.
    """
    poses = [first, second]
    E = [strain_of(pose, mesh.sides) for pose in poses]
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
            E[k][i] = strain_of(new.pose, mesh.sides)
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
