"""The largest work of a load: locked states from several starts, and the best of them.

A dead second Piola-Kirchhoff line load S has the potential S:E per unit of reference area. Its locked states are the
stationary points of S:E over the admissible poses, and the support function h(S) = max S:E is the largest of them. The
derivative of the load is symmetric, and E is quadratic in the lattice vectors, so it does not depend on the pose.

Every locked state is an admissible pose, so it is a start for every other load: a restart from a state that does more
work than the one known so far climbs from there. The slack pose of a weave has the symmetry of `symmetry`, and paths
from it keep that symmetry though a state without it may do more work: random admissible poses are starts as well. What
remains assumed is that the starts together reach the largest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from rve.common.records import Index, Rows
from rve.common.tensor import IDENTITY, WEIGHT, disc, double_dot, mirror
from rve.common.types import Array
from rve.equilibrium.interior_point import NEVER, DirectOptions, Equilibrium, follow, unit_loads
from rve.equilibrium.system import Equations, on_coordinates, weighted_size
from rve.geometry.contacts import parallel_clearance
from rve.geometry.pose import Pose, mirrored, moved, start_pose, strain_of

GAIN = 1e-9
"""Work at unit trace of S by which a state must exceed another to count as a better one; round-off leaves 1e-12."""
MARGINS = (1e-4, 1e-6)
"""Gaps of a restart in r1, tried in turn. Wider ones converge faster, but may slide into a state of less work."""
TOLERANCE = 1e-10
"""Residual of restarts: states on the verge of giving way converge linearly in the last digits."""
NEAR_MARGIN = 1e-3
"""Gaps of restarts from near loads: they need not climb from where they start."""
FELT = 1e-7
"""Works that differ by less tell branches apart no more; see KINSHIP."""
NEIGHBOURS, NEAR = 8, 0.25
"""The locked states of so many loads nearest to a load are compared with its own, up to this distance in the disc of
loads of unit trace."""
KINSHIP = 0.5
"""Two states i, j of one smooth branch lose about the same work under each other's load: S_i:(E_i - E_j) and
S_j:(E_j - E_i) agree to second order in the distance. Where one is less than this share of the other, i is restarted
from j. A tenth of the pairs is, and at r1/r2 = 50 all that lead to a state of more work are among them."""
ROUNDS = 6
"""Rounds of restarts at most; a load that is still below a known state then has the status "below"."""
VICINITY = 0.15
"""Distance in the disc of loads up to which the states found from random starts are shared."""
STARTS = 16
"""Random starts of the loads of one vicinity together; docs/theory.md, 4 has the hit rate."""
WALK, STRIDE = 20, 0.12
"""Steps of a random walk from the slack pose, and the largest of them in r1 and radians."""
SPARE = 1e-3
"""Gaps in r1 that random poses keep."""
NONE = 1e6
"""Minus this stands for the work of a load for which no state is known."""
PROBE, ALIKE = 1e-4, 5e-3
"""Complementarity mu at which a path is compared with the state that is known, and the difference of strains up to
which it leads there."""
PROMISE = 0.5
"""Contacts by which the work on a path must be nearer to that of the known state than a path to equal work would be."""


@dataclass(frozen=True)
class DeadLoad:
    """The dead loads S (n, 3), in weave axes, on a reference cell with sides (b1, b2) in r1.

    The potential of a cell is b1 b2 S:E, so the force on a1 is b1 b2 (S11 a1/b1^2 + S12 a2/(b1 b2)).
    """

    sides: tuple[float, float]

    def force(self, pose: Pose, T: Array, s: Array) -> tuple[Array, Array]:
        """See Load."""
        b1, b2 = self.sides
        K = np.zeros((len(s), 4, 4))
        for x in range(2):
            K[:, x, x] = s[:, 0] * b2 / b1
            K[:, x, 2 + x] = K[:, 2 + x, x] = s[:, 1]
            K[:, 2 + x, 2 + x] = s[:, 2] * b1 / b2
        return on_coordinates(K, pose, T)

    def size(self, f: Array, M: Array) -> Array:
        """See Load."""
        return weighted_size(f, M)


def solve_dead(S: Array, equations: Equations, options: DirectOptions, start: Pose | None = None) -> Equilibrium:
    """Locked states under the dead loads S (n, 3) from the slack pose of the weave, or from `start` (n poses with
    positive gaps); equations with a `DeadLoad`.

    The force of a dead load grows with the stretch, so mu falls slowly from the first attempt on: by 3/10 all but a few
    of the loads converge, by 1/10 a third of them stall at r1/r2 = 50.
    """
    first = replace(options, attempts=1, shrink=0.3, power=1.0, max_iterations=options.max_iterations + 50)
    found = follow(unit_loads(S), equations, first, start)
    left = np.flatnonzero(found.status != "converged")
    if len(left) and options.attempts > 1:
        slower = replace(first, shrink=0.5, rejection=NEVER)
        again = follow(unit_loads(S[left]), equations, slower, None if start is None else start.take(left))
        found = found.put(left, replace(again, attempts=again.attempts + 1))
    return found


def opened(pose: Pose, equations: Equations, margin: float, reach: float) -> Pose:
    """The poses with all gaps raised to about `margin` (in r1) by the shortest motions that do so to first order.

    Locked rings touch, and an interior point needs room. Motions are found by Lawson and Hanson's least distance
    programming. A pose that cannot be opened is left as it is.
    """
    for _ in range(6):
        contacts = equations.contacts(pose, reach)
        tight = np.flatnonzero(contacts.min_gap < 0.5 * margin)
        if not len(tight):
            break
        none = np.zeros(contacts.gap.shape)
        G = equations.assemble(pose, contacts, none, np.ones((len(none), 3))).G
        dq = np.zeros((len(G), G.shape[2]))
        for i in tight:
            gap = contacts.gap[i].ravel()
            near = gap < 10.0 * margin
            A = np.vstack([G[i][near].T, margin - gap[near]])
            b = np.append(np.zeros(G.shape[2]), 1.0)
            r = A @ nnls(A, b)[0] - b
            dq[i] = np.clip(r[:-1] / -r[-1], -0.1, 0.1) if r[-1] < -1e-12 else 0.0
        pose = moved(pose, equations.displacement(dq, pose))
    return pose


def restarted(loads: Array, equations: Equations, start: Pose, margin: float, options: DirectOptions) -> Equilibrium:
    """Locked states under `loads` (n, 3) from the locked poses `start`, whose gaps are first opened to `margin`."""
    near = replace(options, attempts=1, mu_start=margin, shrink=0.3, power=1.0)
    near = replace(near, tolerance=max(options.tolerance, TOLERANCE), max_iterations=min(90, options.max_iterations))
    return follow(unit_loads(loads), equations, near, opened(start, equations, margin, options.reach))


@dataclass(frozen=True)
class States(Rows):
    """Locked poses of any loads, (m,), their loads S and strains E (m, 3) in weave axes: starts for other loads."""

    pose: Pose
    S: Array
    E: Array

    def __len__(self) -> int:
        return len(self.E)

    def plus(self, other: States) -> States:
        """These states, then the others."""
        return self.join([other])

    def with_images(self, is_mirrored: bool) -> States:
        """These states and, for a weave that is its own mirror image, what a mirror shows of them."""
        return self.plus(States(mirrored(self.pose), mirror(self.S), mirror(self.E))) if is_mirrored else self


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

    def states(self, sides: tuple[float, float]) -> States:
        """The converged states."""
        rows = np.flatnonzero(np.isfinite(self.h))
        pose = self.found.pose.take(rows)
        return States(pose, self.S[rows], strain_of(pose, sides))

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
    known: States | None = None,
    company: States | None = None,
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
    images = equations.weave.is_mirrored and equations.weave.classes == 2
    best = with_random_starts(best, S if known is None else np.concatenate([S, known.S]), equations, sides, options)
    states = best.states(sides)
    states = states.join([more for more in (known, company) if more is not None]).with_images(images)
    best = with_neighbours(best, states, equations, sides, options)
    states = states.plus(best.states(sides).with_images(images))
    tried: set[tuple[int, int]] = set()
    for _ in range(ROUNDS):
        rows, source = better_states(best, states, tried)
        if not len(rows):
            return best
        for margin in MARGINS:
            start = states.pose.take(source)
            new = restarted(S[rows], equations, start, margin, options)
            best = best.raised(rows, new, works_of(new, S[rows], sides), "restart")
            low = best.h[rows] < double_dot(S[rows], states.E[source]) - GAIN
            rows, source = rows[low], source[low]
            if not len(rows):
                break
        states = states.plus(best.states(sides).with_images(images))
    rows, _ = better_states(best, states, set())
    best.found.status[rows[np.isfinite(best.h[rows])]] = "below"
    return best


def with_neighbours(
    best: Largest, states: States, equations: Equations, sides: tuple[float, float], options: DirectOptions
) -> Largest:
    """The best states after restarts from those of near loads that belong to another branch."""
    rows, source = nearest_states(best, states, sides)
    if not len(rows):
        return best
    new = restarted(best.S[rows], equations, states.pose.take(source), NEAR_MARGIN, options)
    return best.raised_by_all(rows, new, works_of(new, best.S[rows], sides), "neighbour")


def with_random_starts(
    best: Largest, near: Array, equations: Equations, sides: tuple[float, float], options: DirectOptions
) -> Largest:
    """The best states after random starts; a load has the fewer of them, the more of the loads `near` are about it."""
    about = (np.linalg.norm(disc(best.S)[:, None] - disc(near)[None], axis=2) < VICINITY).sum(axis=1)
    rows = np.repeat(np.arange(len(best.S)), -(-STARTS // np.maximum(about, 1)))
    start = random_poses(equations, len(rows))
    E = np.where(np.isfinite(best.h)[:, None], strain_of(best.found.pose, sides), -NONE * IDENTITY)
    pick, new = promising(best.S[rows], E[rows], equations, sides, options, start)
    rows = rows[pick]
    return best.raised_by_all(rows, new, works_of(new, best.S[rows], sides), "random")


def promising(
    S: Array, E: Array, equations: Equations, sides: tuple[float, float], options: DirectOptions, start: Pose | None
) -> tuple[Index, Equilibrium]:
    """Cases whose paths under the dead loads S (n, 3) of unit trace promise more work than the strains E, and their
    ends.

    Paths are followed to mu = `PROBE` from the slack pose or from `start`, and to the end where they promise more: on a
    path every loaded contact (lam > gap) takes mu from the work at the end, to first order.
    """
    once = replace(options, attempts=1)
    path = solve_dead(S, equations, replace(once, mu_end=PROBE, tolerance=PROBE), start)
    short = E - strain_of(path.pose, sides)
    far = np.abs(short).max(axis=1) > ALIKE
    loaded = ((path.lam > path.contacts.gap) & path.contacts.present).sum(axis=(1, 2))
    missing = sides[0] * sides[1] * double_dot(unit_loads(S), short) / PROBE
    pick = np.flatnonzero(far & (missing < loaded - PROMISE) & (path.status == "converged"))
    found = path.take(pick)
    if len(pick):
        found = solve_dead(S[pick], equations, replace(once, mu_start=PROBE), found.pose)
    return pick, found


def random_poses(equations: Equations, count: int) -> Pose:
    """Admissible poses (count,) that random walks of seeded steps reach from the slack pose, the same in every call.

    They are `STARTS` poses in turn. Steps that would make rings overlap or pass through each other are left out.
    """
    rng, pose = np.random.default_rng(0), start_pose(equations.weave, STARTS)
    shape, stride = (STARTS, equations.modes.shape[1]), np.full((STARTS, 1), STRIDE)
    drift = rng.uniform(-1.0, 1.0, shape)
    for _ in range(WALK):
        step = stride * (0.4 * drift + 0.6 * rng.uniform(-1.0, 1.0, shape))
        there = moved(pose, equations.displacement(step, pose))
        contacts = equations.contacts(there, STRIDE)
        good = contacts.links_intact & (contacts.min_gap > SPARE)
        good &= parallel_clearance(pose, there, equations.weave, equations.wire) > 0.0
        rows = np.flatnonzero(good)
        pose = pose.put(rows, there.take(rows))
        stride = np.where(good[:, None], np.minimum(1.5 * stride, STRIDE), 0.5 * stride)
        drift = np.where(good[:, None], drift, rng.uniform(-1.0, 1.0, shape))
    return pose.take(np.arange(count) % STARTS)


def works_of(found: Equilibrium, S: Array, sides: tuple[float, float]) -> Array:
    """Work S:E (n,) of equilibria under the loads S (n, 3), -inf where they have not converged."""
    return np.where(found.status == "converged", double_dot(S, strain_of(found.pose, sides)), -np.inf)


def nearest_states(best: Largest, states: States, sides: tuple[float, float]) -> tuple[Index, Index]:
    """Pairs (k,) of a load and a state near it that is not of the same smooth branch as the load's own state."""
    distance = np.linalg.norm(disc(best.S)[:, None] - disc(states.S)[None], axis=2)
    own = strain_of(best.found.pose, sides)
    distance[np.abs(own[:, None] - states.E[None]).max(axis=2) < FELT] = np.inf
    source = np.argsort(distance, axis=1, kind="stable")[:, :NEIGHBOURS].ravel()
    rows = np.repeat(np.arange(len(best.S)), len(source) // len(best.S))
    E = own[rows] - states.E[source]
    there, back = double_dot(best.S[rows], E), -double_dot(states.S[source], E)
    least, most = np.minimum(there, back), np.maximum(there, back)
    near = (distance[rows, source] < NEAR) & np.isfinite(best.h[rows])
    keep = near & (most > FELT) & (least < KINSHIP * most)
    return rows[keep], source[keep]


def better_states(best: Largest, states: States, tried: set[tuple[int, int]]) -> tuple[Index, Index]:
    """Loads (k,) and, for each, the state of most work among those not tried that do more than h; notes them."""
    gain = (best.S * WEIGHT) @ states.E.T - np.maximum(best.h, -NONE)[:, None]
    for row, column in tried:
        gain[row, column] = -np.inf
    rows = np.flatnonzero(gain.max(axis=1, initial=-np.inf) > GAIN)
    source = gain[rows].argmax(axis=1) if len(rows) else rows
    tried.update(zip(rows.tolist(), source.tolist(), strict=True))
    return rows, source
