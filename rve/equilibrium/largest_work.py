"""The largest work of a dead load: locked states from several starts, and the best of them, h(S) = max S:E.

The slack pose has the symmetry of `symmetry`, and paths from it keep it, so random admissible poses are starts as well,
and so is every known state that does more work. A locked state of the primitive cell need not be a maximum in a larger
one: starts there are its motions of negative stiffness, and a small disturbance of all rings at random.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rve.common import Array, Flags, Index, Rows
from rve.common.tensor import WEIGHT, disc, double_dot, mirror
from rve.equilibrium.dead_load import MARGINS, NEAR_MARGIN, STARTS, LoadedCell, random_poses, restart, solve_dead
from rve.equilibrium.interior_point import Equilibrium, unit_loads
from rve.equilibrium.limits import balanced, loose_motions
from rve.equilibrium.system import Equations
from rve.geometry.pose import Pose, mirrored, strain_of, tiled

GAIN = 1e-9
"""Work at unit trace of S by which a state must exceed another to count as a better one; round-off leaves 1e-12."""
NEIGHBOURS, NEAR = 8, 0.25
"""A load is restarted from the locked states of so many loads nearest to it, up to this distance in the disc of loads
of unit trace."""
SAME_STATE = 1e-7
"""Differences of strain up to which two states are one."""
ROUNDS = 6
"""Rounds of restarts at most; a load that is still below a known state then has the status "below"."""
VICINITY = 0.15
"""Distance in the disc of loads up to which the states found from random starts are shared."""
NO_WORK = 1e6
"""Minus this stands for the work of a load for which no state is known."""
UNSTABLE, MODES = -1e-6, 3
"""Stiffness in s r1^2 below which a motion gives way, and how many of a state are followed, the softest ones."""
PUSH, DISTURBED = 0.06, 0.2
"""Largest displacement of a start along a motion, and of one at random, in radii of the wire: none passes another."""


@dataclass(frozen=True)
class KnownStates(Rows):
    """Locked poses of any loads, (m,), their loads S and strains E (m, 3) in weave axes: starts for other loads."""

    pose: Pose
    S: Array
    E: Array

    @staticmethod
    def of(mesh: LoadedCell, found: Equilibrium, S: Array, known: Flags) -> KnownStates:
        """Those of these equilibria under loads S (n, 3) that are `known` (n,)."""
        pose = found.pose.take(known)
        return KnownStates(pose, S[known], strain_of(pose, mesh.sides))

    def with_images(self, mesh: LoadedCell) -> KnownStates:
        """These states and, for a weave that is its own mirror image, what a mirror shows of them."""
        if not mesh.dead.weave.has_images:
            return self
        return self.join([KnownStates(mirrored(self.pose), mirror(self.S), mirror(self.E))])


@dataclass(frozen=True)
class Largest:
    """Locked states of largest work under the loads S (n, 3) of unit trace: equilibria; h (n,), -inf where there is
    none; branch (n,): "slack", "random", "neighbour" or "restart"; works: per load, ascending, S:E of all its states.
    """

    mesh: LoadedCell
    S: Array
    found: Equilibrium
    h: Array
    branch: NDArray[np.str_]
    works: list[list[float]]

    @staticmethod
    def of(mesh: LoadedCell, S: Array, found: Equilibrium) -> Largest:
        """No states yet, in the place of these equilibria."""
        slack = np.full(len(S), "slack", dtype="<U16")
        return Largest(mesh, S, found, np.full(len(S), -np.inf), slack, [[] for _ in S])

    @property
    def states(self) -> KnownStates:
        """The converged states."""
        return KnownStates.of(self.mesh, self.found, self.S, np.isfinite(self.h))

    def raised(self, rows: Index, new: Equilibrium, branch: str) -> Largest:
        """With the best of the states known and those of `new` under the loads `rows`, which may be several of one."""
        work = double_dot(self.S[rows], strain_of(new.pose, self.mesh.sides))
        h, names, works, best = self.h.copy(), self.branch.copy(), [*self.works], np.full(len(self.h), -1)
        for k in np.lexsort((work, rows)):
            row, value = rows[k], float(work[k])
            if new.status[k] != "converged":
                continue
            if all(abs(value - other) > GAIN for other in works[row]):
                works[row] = sorted([*works[row], value])
            if value > h[row] + GAIN:
                h[row], best[row] = value, k
        up = np.flatnonzero(best >= 0)
        names[up] = branch
        return replace(self, found=self.found.put(up, new.take(best[up])), h=h, branch=names, works=works)


def largest(
    S: Array, mesh: LoadedCell, known: KnownStates | None = None, company: KnownStates | None = None
) -> Largest:
    """The states of largest work under the dead loads S (n, 3) of unit trace, weave axes.

    From the slack pose first, which is all for options.branches = "first"; then from random admissible poses; then from
    the states of the nearest loads, those of `known` and `company` (reached from the slack pose only) included; then,
    where a state of another load does more work, from that state, until none does.
    """
    found = solve_dead(S, mesh.dead, mesh.options)
    best = Largest.of(mesh, S, found).raised(np.arange(len(S)), found, "slack")
    if mesh.options.branches == "first":
        return best
    best = _with_random_starts(best, S if known is None else np.concatenate([S, known.S]))
    states = best.states.join([more for more in (known, company) if more is not None]).with_images(mesh)
    best = _with_neighbours(best, states)
    return climbed(best, states.join([best.states.with_images(mesh)]))


def climbed(best: Largest, states: KnownStates) -> Largest:
    """The best states after restarts from those of `states`, and of each other, that do more work, until none does."""
    mesh, S = best.mesh, best.S
    tried: set[tuple[int, int]] = set()
    for _ in range(ROUNDS):
        rows, source = _better_states(best, states, tried)
        if not len(rows):
            return best
        for margin in MARGINS:
            new = restart(S[rows], mesh.dead, states.pose.take(source), margin, mesh.options)
            best = best.raised(rows, new, "restart")
            low = best.h[rows] < double_dot(S[rows], states.E[source]) - GAIN
            rows, source = rows[low], source[low]
            if not len(rows):
                break
        states = states.join([best.states.with_images(mesh)])
    rows, _ = _better_states(best, states, set())
    best.found.status[rows[np.isfinite(best.h[rows])]] = "below"
    return best


def _with_random_starts(best: Largest, near: Array) -> Largest:
    """The best states after random starts; a load has the fewer of them, the more of the loads `near` are about it."""
    mesh = best.mesh
    about = (np.linalg.norm(disc(best.S)[:, None] - disc(near)[None], axis=2) < VICINITY).sum(axis=1)
    rows = np.repeat(np.arange(len(best.S)), -(-STARTS // np.maximum(about, 1)))
    once = replace(mesh.options, attempts=1)
    new = solve_dead(best.S[rows], mesh.dead, once, random_poses(mesh.dead, len(rows)))
    return best.raised(rows, new, "random")


def _with_neighbours(best: Largest, states: KnownStates) -> Largest:
    """The best states after restarts from those of near loads whose strain is another one."""
    distance = np.linalg.norm(disc(best.S)[:, None] - disc(states.S)[None], axis=2)
    own = strain_of(best.found.pose, best.mesh.sides)
    is_other = np.abs(own[:, None] - states.E[None]).max(axis=2) > SAME_STATE
    distance[~(is_other & (distance < NEAR) & np.isfinite(best.h)[:, None])] = np.inf
    source = np.argsort(distance, axis=1, kind="stable")[:, :NEIGHBOURS]
    rows, place = np.nonzero(np.isfinite(np.take_along_axis(distance, source, axis=1)))
    if not len(rows):
        return best
    start = states.pose.take(source[rows, place])
    return best.raised(rows, restart(best.S[rows], best.mesh.dead, start, NEAR_MARGIN, best.mesh.options), "neighbour")


def _better_states(best: Largest, states: KnownStates, tried: set[tuple[int, int]]) -> tuple[Index, Index]:
    """Loads (k,) and, for each, the state of most work among those not tried that do more than h; notes them."""
    gain = (best.S * WEIGHT) @ states.E.T - np.maximum(best.h, -NO_WORK)[:, None]
    for row, column in tried:
        gain[row, column] = -np.inf
    rows = np.flatnonzero(gain.max(axis=1, initial=-np.inf) > GAIN)
    source = gain[rows].argmax(axis=1) if len(rows) else rows
    tried.update(zip(rows.tolist(), source.tolist(), strict=True))
    return rows, source


def in_cell(found: Equilibrium, s: Array, equations: Equations) -> Equilibrium:
    """Locked states of the planar primitive cell under the loads s (n, 3), in the larger cell of `equations`."""
    made = balanced(tiled(found.pose, equations.weave), s, equations)
    return replace(made, iterations=found.iterations, status=found.status, attempts=found.attempts)


def states_beyond(pose: Pose, S: Array, mesh: LoadedCell) -> KnownStates:
    """States that do more work under the dead loads S (n, 3) of unit trace than these locked ones of a larger cell."""
    equations, s = mesh.dead, unit_loads(S)
    way = np.random.default_rng(0).uniform(-1.0, 1.0, (len(S), equations.modes.shape[1]))
    way[:, :3] = 0.0
    rows, ways = [np.arange(len(S))], [DISTURBED * equations.wire * way]
    for i, stiffness, motions in loose_motions(equations, balanced(pose, s, equations), s):
        gives = motions.T[np.flatnonzero(stiffness < UNSTABLE)[:MODES]]
        rows.append(np.full(len(gives), i))
        ways.append(PUSH * equations.wire * gives / np.abs(gives).max(axis=1, keepdims=True))
    row, way = np.concatenate(rows), np.concatenate(ways)
    here = pose.take(row)
    start = equations.moved(here, way)
    new = restart(S[row], equations, start, NEAR_MARGIN, mesh.options)
    more = double_dot(S[row], strain_of(new.pose, mesh.sides) - strain_of(here, mesh.sides)) > GAIN
    return KnownStates.of(mesh, new, S[row], more & (new.status == "converged"))


def largest_beyond(planar: Largest, known: KnownStates | None, mesh: LoadedCell) -> Largest:
    """The largest work in the larger cell `mesh` that is reached from the states of the primitive cell."""
    found = in_cell(planar.found, unit_loads(planar.S), mesh.dead)
    best = replace(planar, mesh=mesh, found=found)
    states = best.states if known is None else best.states.join([known])
    ended = np.flatnonzero(np.isfinite(best.h))
    return climbed(best, states.join([states_beyond(best.found.pose.take(ended), best.S[ended], mesh)]))
