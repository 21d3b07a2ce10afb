"""The largest work of a dead load, h(S) = max S:E over the locked states: a global search by restarts.

A locked state is an admissible pose, hence a start for every other load. `sample_states` locks the cell under loads all
over the disc of loads, from random poses. It depends on the cell alone, and `search` asks it about any load: a row of a
table and a load by itself are compared with the same states. A locked state of the primitive cell need not be a maximum
in a larger one: starts there are its motions of negative stiffness, and a small disturbance of all rings at random.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rve.common import Array, Index, Rows
from rve.common.tensor import WEIGHT, double_dot, eigenvalues, from_disc, mirror
from rve.geometry.cell import Cell
from rve.geometry.pose import Pose, mirrored, strain_of, tiled
from rve.locking.dead_load import RESTART, LoadedCell, random_poses, restart, solve_dead, ways_down
from rve.locking.interior_point import DirectOptions, Equilibrium, solve_equilibrium, unit_loads
from rve.locking.limits import balanced
from rve.locking.system import Equations


@dataclass(frozen=True)
class SearchOptions:
    """Numbers of the search."""

    gain: float = 1e-9
    """Work at unit trace of S by which a state must exceed another to count as a better one; round-off leaves 1e-12."""
    sample: int = 48
    """Loads of the sample, a third of them of rank one; half of them for weaves with images. With more, narrower basins
    are found, and a single load takes longer."""
    rough: float = 1e-5
    """Path parameter and residual at which the states of the sample end: starts as good as exact ones, in less time."""
    thick: float = 1.0 / 12.0
    """r2/r1 from which on the search is quick: there loads have one state, but for some near rank one. Larger: tables
    of thick wires take half as long again."""
    starts: int = 3
    """States of the sample from which a load of thin wire is restarted; a quick search takes one. More find narrower
    basins, in as much more time."""
    quick: int = 35
    """Most iterations of a state of a thick cell's sample: slower loads are left out of it."""
    narrow: float = 0.1
    """Ratio of principal loads below which a quick search restarts a load that has a state."""
    rounds: int = 6
    """Rounds of restarts at most; a load that is still below a known state then has the status "below"."""
    modes: int = 3
    """How many of the motions that give way are followed, the softest ones."""
    disturbed: float = 0.2
    """Largest displacement of a start at random, in radii of the wire: none passes another."""


SEARCH = SearchOptions()


@dataclass(frozen=True)
class KnownStates(Rows):
    """Locked poses of any loads, (m,), their loads S and strains E (m, 3) in weave axes: starts for other loads."""

    pose: Pose
    S: Array
    E: Array

    @staticmethod
    def of(mesh: LoadedCell, pose: Pose, S: Array) -> KnownStates:
        """Poses locked under the loads S (n, 3), and, for a weave that is its own mirror image, their images."""
        states = KnownStates(pose, S, strain_of(pose, mesh.sides))
        if not mesh.dead.weave.has_images:
            return states
        return states.join([KnownStates(mirrored(pose, mesh.dead.weave), mirror(S), mirror(states.E))])

    def works(self, S: Array) -> Array:
        """S:E of every state under each of the loads S (n, 3), (n, m)."""
        return np.asarray((S * WEIGHT) @ self.E.T)


@dataclass(frozen=True)
class BestStates:
    """The best locked states under the loads S (n, 3) of unit trace: equilibria; h (n,), -inf where there is none;
    branch (n,): "slack" or "restart"; works: per load, ascending, S:E of all its states.
    """

    mesh: LoadedCell
    S: Array
    found: Equilibrium
    h: Array
    branch: NDArray[np.str_]
    works: list[list[float]]

    @staticmethod
    def none(mesh: LoadedCell, S: Array) -> BestStates:
        """No states yet: the slack pose is in their place."""
        found = solve_equilibrium(S, mesh.dead, replace(mesh.options, attempts=1, max_iterations=0))
        return BestStates.of(mesh, S, found, np.full(len(S), -np.inf))

    @staticmethod
    def of(mesh: LoadedCell, S: Array, found: Equilibrium, h: Array) -> BestStates:
        """These equilibria, which do the works h (n,)."""
        works = [[work] if np.isfinite(work) else [] for work in h.tolist()]
        return BestStates(mesh, S, found, h, np.full(len(S), "slack", dtype="<U16"), works)

    @property
    def states(self) -> KnownStates:
        """The states, with their images."""
        is_state = np.isfinite(self.h)
        return KnownStates.of(self.mesh, self.found.pose.take(is_state), self.S[is_state])

    def improved(self, rows: Index, new: Equilibrium, branch: str) -> BestStates:
        """With the best of these states and those of `new` under the loads `rows`, which may be several of one."""
        work = double_dot(self.S[rows], strain_of(new.pose, self.mesh.sides))
        h, names, works, best = self.h.copy(), self.branch.copy(), [*self.works], np.full(len(self.h), -1)
        for k in np.lexsort((work, rows)):
            row, value = rows[k], float(work[k])
            if new.status[k] != "converged":
                continue
            if all(abs(value - other) > SEARCH.gain for other in works[row]):
                works[row] = sorted([*works[row], value])
            if value > h[row] + SEARCH.gain:
                h[row], best[row] = value, k
        up = np.flatnonzero(best >= 0)
        names[up] = branch
        return replace(self, found=self.found.put(up, new.take(best[up])), h=h, branch=names, works=works)


def slack_states(S: Array, mesh: LoadedCell) -> BestStates:
    """The states under the dead loads S (n, 3) of unit trace that are reached from the slack pose."""
    found = solve_dead(S, mesh.dead, mesh.options)
    return BestStates.none(mesh, S).improved(np.arange(len(S)), found, "slack")


@lru_cache(maxsize=8)
def sample_states(cell: Cell, sides_mm: tuple[float, float], options: DirectOptions) -> KnownStates:
    """Locked states of `SEARCH.sample` loads all over the disc of loads, weave axes, with their images.

    Each load starts from a random admissible pose of its own, since paths from the slack pose keep its symmetry. The
    states are rough: as admissible poses they bound the work of every load from below all the same.
    """
    mesh = LoadedCell.of(cell, sides_mm, options)
    count = SEARCH.sample // 2 if mesh.dead.weave.has_images else SEARCH.sample
    k = np.arange(count)
    radius, angle = np.minimum(np.sqrt(1.5 * (k + 0.5) / count), 1.0), np.pi * (3.0 - np.sqrt(5.0)) * k
    S = from_disc(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    rough = replace(hasty(mesh), attempts=1, power=1.0, shrink=0.3, mu_end=SEARCH.rough, tolerance=SEARCH.rough)
    found = solve_equilibrium(S, mesh.dead, rough, random_poses(mesh.dead, count))
    good = found.status == "converged"
    return KnownStates.of(mesh, found.pose.take(good), S[good])


def is_thick(mesh: LoadedCell) -> bool:
    """Whether the search of this cell is quick."""
    return mesh.cell.wire >= SEARCH.thick


def hasty(mesh: LoadedCell) -> DirectOptions:
    """The options of the cell; of a thick one with `SEARCH.quick` iterations at most."""
    most = mesh.options.max_iterations
    return replace(mesh.options, max_iterations=min(SEARCH.quick, most) if is_thick(mesh) else most)


def search(best: BestStates, sample: KnownStates, others: KnownStates | None = None) -> BestStates:
    """The states of largest work: better than `best` wherever restarts from those of `sample` or `others` lead to one.

    Every load, in a thick cell every one that is narrow or has no state, is restarted from those of the sample that do
    most work under it; a narrow one from the slack pose as well, of thin wire from a random one, on a long path; then
    all, as `climb` does, from those that do more than their own. A load that is still without a state starts from the
    slack pose.
    """
    mesh, S = best.mesh, best.S
    low, high = eigenvalues(S)
    is_narrow, quick = low < SEARCH.narrow * high, is_thick(mesh)
    rows = np.flatnonzero(is_narrow | ~np.isfinite(best.h) | (not quick))
    if len(sample.S) and len(rows):
        count = 1 if quick else SEARCH.starts
        first = sample.works(S[rows]).argsort(axis=1)[:, : -count - 1 : -1]
        each = np.repeat(rows, first.shape[1])
        new = restart(S[each], mesh.dead, sample.pose.take(first.ravel()), RESTART.near_margin, mesh.options)
        best = best.improved(each, new, "restart")
    long = np.flatnonzero(is_narrow)
    if len(long):
        start = None if quick else random_poses(mesh.dead, 1).take(np.zeros(len(long), dtype=int))
        new = solve_dead(S[long], mesh.dead, replace(mesh.options, attempts=1), start)
        best = best.improved(long, new, "restart")
    none = np.flatnonzero(~np.isfinite(best.h))
    if len(none):
        best = best.improved(none, slack_states(S[none], mesh).found, "slack")
    return climb(best, sample.join([] if others is None else [others]))


def climb(best: BestStates, states: KnownStates) -> BestStates:
    """The best states after restarts from those of `states`, and of each other, that do more work, until none does."""
    mesh, S = best.mesh, best.S
    tried = np.zeros((len(S), 0), dtype=bool)
    for _ in range(SEARCH.rounds):
        tried = np.pad(tried, ((0, 0), (0, len(states.S) - tried.shape[1])))
        gain = np.where(tried, -np.inf, states.works(S) - best.h[:, None])
        rows = np.flatnonzero((gain.max(axis=1, initial=-np.inf) > SEARCH.gain) & np.isfinite(best.h))
        if not len(rows):
            return best
        source = gain[rows].argmax(axis=1)
        tried[rows, source] = True
        for margin in RESTART.margins:
            new = restart(S[rows], mesh.dead, states.pose.take(source), margin, mesh.options)
            best = best.improved(rows, new, "restart")
            low = best.h[rows] < double_dot(S[rows], states.E[source]) - SEARCH.gain
            rows, source = rows[low], source[low]
            if not len(rows):
                break
        states = states.join([best.states])
    below = (states.works(S).max(axis=1, initial=-np.inf) > best.h + SEARCH.gain) & np.isfinite(best.h)
    status = np.where(below, "below", best.found.status).astype("<U16")
    return replace(best, found=replace(best.found, status=status))


def in_cell(found: Equilibrium, s: Array, equations: Equations) -> Equilibrium:
    """Locked states of the planar primitive cell under the loads s (n, 3), in the larger cell of `equations`."""
    made = balanced(tiled(found.pose, equations.weave), s, equations)
    return replace(made, iterations=found.iterations, status=found.status, attempts=found.attempts)


def states_beyond(pose: Pose, S: Array, mesh: LoadedCell) -> KnownStates:
    """States that do more work under the dead loads S (n, 3) of unit trace than these locked ones of a larger cell."""
    equations, s = mesh.dead, unit_loads(S)
    way = np.random.default_rng(0).uniform(-1.0, 1.0, (len(S), equations.modes.shape[1]))
    way[:, :3] = 0.0
    rows, ways = [np.arange(len(S))], [SEARCH.disturbed * equations.thinnest * way]
    giving, pushes = ways_down(balanced(pose, s, equations), s, equations, SEARCH.modes)
    row, way = np.concatenate([*rows, giving]), np.concatenate([*ways, pushes])
    here = pose.take(row)
    start = equations.moved(here, way)
    new = restart(S[row], equations, start, RESTART.near_margin, mesh.options)
    more = double_dot(S[row], strain_of(new.pose, mesh.sides) - strain_of(here, mesh.sides)) > SEARCH.gain
    more &= new.status == "converged"
    return KnownStates.of(mesh, new.pose.take(more), S[row[more]])


def search_beyond(planar: BestStates, known: KnownStates | None, mesh: LoadedCell) -> BestStates:
    """The largest work in the larger cell `mesh` that is reached from the states of the primitive cell."""
    best = replace(planar, mesh=mesh, found=in_cell(planar.found, unit_loads(planar.S), mesh.dead))
    states = best.states
    return climb(best, states.join([states_beyond(states.pose, states.S, mesh), *([] if known is None else [known])]))
