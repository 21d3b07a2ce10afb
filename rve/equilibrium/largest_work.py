"""The largest work of a dead load (`dead_load`): locked states from several starts, and the best of them.

The locked states of a load S are the stationary points of S:E over the admissible poses, and the support function
h(S) = max S:E is the largest of them.

Every locked state is an admissible pose, so it is a start for every other load: a restart from a state that does more
work than the one known so far climbs from there. The slack pose of a weave has the symmetry of `symmetry`, and paths
from it keep that symmetry though a state without it may do more work: random admissible poses are starts as well. What
remains assumed is that the starts together reach the largest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rve.common.records import Index, Rows
from rve.common.tensor import IDENTITY, WEIGHT, disc, double_dot, mirror
from rve.common.types import Array
from rve.equilibrium.dead_load import MARGINS, NEAR_MARGIN, STARTS, follow_promising, random_poses, restart, solve_dead
from rve.equilibrium.interior_point import DirectOptions, Equilibrium
from rve.equilibrium.system import Equations
from rve.geometry.pose import Pose, mirrored, strain_of

GAIN = 1e-9
"""Work at unit trace of S by which a state must exceed another to count as a better one; round-off leaves 1e-12."""
WORK_NOISE = 1e-7
"""Smaller differences in work are rounding; see SAME_BRANCH_RATIO."""
NEIGHBOURS, NEAR = 8, 0.25
"""The locked states of so many loads nearest to a load are compared with its own, up to this distance in the disc of
loads of unit trace."""
SAME_BRANCH_RATIO = 0.5
"""Two states i, j of one smooth branch lose about the same work under each other's load: S_i:(E_i - E_j) and
S_j:(E_j - E_i) agree to second order in the distance. Where one is less than this share of the other, i is restarted
from j. A tenth of the pairs is, and at r1/r2 = 50 all that lead to a state of more work are among them."""
ROUNDS = 6
"""Rounds of restarts at most; a load that is still below a known state then has the status "below"."""
VICINITY = 0.15
"""Distance in the disc of loads up to which the states found from random starts are shared."""
NO_WORK = 1e6
"""Minus this stands for the work of a load for which no state is known."""


@dataclass(frozen=True)
class KnownStates(Rows):
    """Locked poses of any loads, (m,), their loads S and strains E (m, 3) in weave axes: starts for other loads."""

    pose: Pose
    S: Array
    E: Array

    def __len__(self) -> int:
        return len(self.E)

    def plus(self, other: KnownStates) -> KnownStates:
        """These states, then the others."""
        return self.join([other])

    def with_images(self, is_mirrored: bool) -> KnownStates:
        """These states and, for a weave that is its own mirror image, what a mirror shows of them."""
        return self.plus(KnownStates(mirrored(self.pose), mirror(self.S), mirror(self.E))) if is_mirrored else self


@dataclass(frozen=True)
class Largest:
    """Locked states of largest work under the loads S (n, 3): equilibria; h (n,), -inf where there is none; branch
    (n,): "slack", "random", "neighbour" or "restart"; works: per load the works S:E, at unit trace of S and in
    ascending order, of the states that were found under it.
    """

    S: Array
    found: Equilibrium
    h: Array
    branch: NDArray[np.str_]
    works: list[list[float]]

    def states(self, sides: tuple[float, float]) -> KnownStates:
        """The converged states."""
        rows = np.flatnonzero(np.isfinite(self.h))
        pose = self.found.pose.take(rows)
        return KnownStates(pose, self.S[rows], strain_of(pose, sides))

    def raised(self, rows: Index, new: Equilibrium, work: Array, branch: str) -> Largest:
        """With the better of the states known and `new` under the loads `rows`, each once; their work is `work`."""
        works = [list(known) for known in self.works]
        for row, value in zip(rows, work, strict=True):
            if np.isfinite(value) and all(abs(value - other) > GAIN for other in works[row]):
                works[row] = sorted([*works[row], float(value)])
        up = np.flatnonzero(work > self.h[rows] + GAIN)
        h, names = self.h.copy(), self.branch.copy()
        h[rows[up]], names[rows[up]] = work[up], branch
        return Largest(self.S, self.found.put(rows[up], new.take(up)), h, names, works)

    def raised_by_all(self, rows: Index, new: Equilibrium, work: Array, branch: str) -> Largest:
        """The same for loads that may occur several times in `rows`."""
        best = self
        for row in np.unique(rows):
            tries = np.flatnonzero(rows == row)
            for k in tries[np.argsort(work[tries])]:
                best = best.raised(rows[k : k + 1], new.take(np.array([k])), work[k : k + 1], branch)
        return best


def largest(
    S: Array,
    equations: Equations,
    sides: tuple[float, float],
    options: DirectOptions,
    known: KnownStates | None = None,
    company: KnownStates | None = None,
) -> Largest:
    """The states of largest work under the dead loads S (n, 3) of unit trace, weave axes.

    From the slack pose first; then from random admissible poses; then from the states of the nearest loads, those of
    `known` included; then, where a state of another load does more work, from that state, until none does. With
    options.branches = "first" the states reached from the slack pose are all. company: further known states, reached
    from the slack pose only.
    """
    found = solve_dead(S, equations, options)
    h = np.where(found.status == "converged", double_dot(S, strain_of(found.pose, sides)), -np.inf)
    best = Largest(S, found, h, np.full(len(S), "slack", dtype="<U16"), [[float(x)] * bool(x > -np.inf) for x in h])
    if options.branches == "first":
        return best
    images = equations.weave.has_images
    best = with_random_starts(best, S if known is None else np.concatenate([S, known.S]), equations, sides, options)
    states = best.states(sides)
    states = states.join([more for more in (known, company) if more is not None]).with_images(images)
    best = with_neighbours(best, states, equations, sides, options)
    return climbed(best, states.plus(best.states(sides).with_images(images)), equations, sides, options)


def climbed(
    best: Largest, states: KnownStates, equations: Equations, sides: tuple[float, float], options: DirectOptions
) -> Largest:
    """The best states after restarts from those of `states`, and of each other, that do more work, until none does."""
    images = equations.weave.has_images
    tried: set[tuple[int, int]] = set()
    for _ in range(ROUNDS):
        rows, source = better_states(best, states, tried)
        if not len(rows):
            return best
        for margin in MARGINS:
            start = states.pose.take(source)
            new = restart(best.S[rows], equations, start, margin, options)
            best = best.raised(rows, new, works_of(new, best.S[rows], sides), "restart")
            low = best.h[rows] < double_dot(best.S[rows], states.E[source]) - GAIN
            rows, source = rows[low], source[low]
            if not len(rows):
                break
        states = states.plus(best.states(sides).with_images(images))
    rows, _ = better_states(best, states, set())
    best.found.status[rows[np.isfinite(best.h[rows])]] = "below"
    return best


def with_neighbours(
    best: Largest, states: KnownStates, equations: Equations, sides: tuple[float, float], options: DirectOptions
) -> Largest:
    """The best states after restarts from those of near loads that belong to another branch."""
    rows, source = nearest_states(best, states, sides)
    if not len(rows):
        return best
    new = restart(best.S[rows], equations, states.pose.take(source), NEAR_MARGIN, options)
    return best.raised_by_all(rows, new, works_of(new, best.S[rows], sides), "neighbour")


def with_random_starts(
    best: Largest, near: Array, equations: Equations, sides: tuple[float, float], options: DirectOptions
) -> Largest:
    """The best states after random starts; a load has the fewer of them, the more of the loads `near` are about it."""
    about = (np.linalg.norm(disc(best.S)[:, None] - disc(near)[None], axis=2) < VICINITY).sum(axis=1)
    rows = np.repeat(np.arange(len(best.S)), -(-STARTS // np.maximum(about, 1)))
    start = random_poses(equations, len(rows))
    E = np.where(np.isfinite(best.h)[:, None], strain_of(best.found.pose, sides), -NO_WORK * IDENTITY)
    pick, new = follow_promising(best.S[rows], E[rows], equations, sides, options, start)
    rows = rows[pick]
    return best.raised_by_all(rows, new, works_of(new, best.S[rows], sides), "random")


def works_of(found: Equilibrium, S: Array, sides: tuple[float, float]) -> Array:
    """Work S:E (n,) of equilibria under the loads S (n, 3), -inf where they have not converged."""
    return np.where(found.status == "converged", double_dot(S, strain_of(found.pose, sides)), -np.inf)


def nearest_states(best: Largest, states: KnownStates, sides: tuple[float, float]) -> tuple[Index, Index]:
    """Pairs (k,) of a load and a state near it that is not of the same smooth branch as the load's own state."""
    distance = np.linalg.norm(disc(best.S)[:, None] - disc(states.S)[None], axis=2)
    own = strain_of(best.found.pose, sides)
    distance[np.abs(own[:, None] - states.E[None]).max(axis=2) < WORK_NOISE] = np.inf
    source = np.argsort(distance, axis=1, kind="stable")[:, :NEIGHBOURS].ravel()
    rows = np.repeat(np.arange(len(best.S)), len(source) // len(best.S))
    E = own[rows] - states.E[source]
    there, back = double_dot(best.S[rows], E), -double_dot(states.S[source], E)
    least, most = np.minimum(there, back), np.maximum(there, back)
    near = (distance[rows, source] < NEAR) & np.isfinite(best.h[rows])
    keep = near & (most > WORK_NOISE) & (least < SAME_BRANCH_RATIO * most)
    return rows[keep], source[keep]


def better_states(best: Largest, states: KnownStates, tried: set[tuple[int, int]]) -> tuple[Index, Index]:
    """Loads (k,) and, for each, the state of most work among those not tried that do more than h; notes them."""
    gain = (best.S * WEIGHT) @ states.E.T - np.maximum(best.h, -NO_WORK)[:, None]
    for row, column in tried:
        gain[row, column] = -np.inf
    rows = np.flatnonzero(gain.max(axis=1, initial=-np.inf) > GAIN)
    source = gain[rows].argmax(axis=1) if len(rows) else rows
    tried.update(zip(rows.tolist(), source.tolist(), strict=True))
    return rows, source
