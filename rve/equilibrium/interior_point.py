"""Direct equilibrium of the periodic cell: a primal-dual interior-point Newton method, batched over load cases.

Each case follows the central path lam_i gap_i = mu as mu -> 0 from one slack pose, with the exact unsymmetric Jacobian
of `system`. Gaps stay positive and links intact in every accepted step, so rings never pass through each other. A trust
radius per case limits steps where the curvature of merging contacts is unbounded. Converged cases leave the batch.
Cases that stall are tried again from disturbed start poses and with a slower decrease of mu.

Contact search (`rve.geometry.circles`) must find both minima of a merging pair even when they are 0.001 rad apart, and
must not count the saddle between them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rve.common.progress import tell, way
from rve.common.records import Flags, Index, Rows
from rve.common.types import Array
from rve.common.values import Options, choice, number, whole
from rve.equilibrium.system import Equations, System
from rve.geometry.contacts import Contacts, parallel_clearance
from rve.geometry.pose import Pose, moved, start_pose

SLOW = (0.5, 0.7)
"""Factors on mu of the attempts after the first; 0.5 solves most loads that stall, 0.3 fewer, 0.7 some of the rest."""
NEVER = 1e300
"""Value of `DirectOptions.rejection` that rejects no step."""


@dataclass(frozen=True)
class DirectOptions(Options):
    """Options of the direct solver; lengths in units of r1, forces in units of s r1. InputError for senseless values.

    tolerance: weighted residual R at which a case has converged; the default leaves two digits to the paper's 1e-9.
    mu_start, mu_end: first and final complementarity lam gap; loaded gaps end at mu_end / lam, about 1e-12 mm.
    shrink, power: each stage lowers mu to the lesser of shrink mu and mu^power; larger `shrink` is slower and safer.
    reach: contacts with a larger gap are ignored; a step moves rings by less.
    step: largest coordinate change per iteration (r1 or radians).
    max_iterations: per case and attempt; attempts after the first get four times as many.
    attempts: tries per case; those after the first lower mu slowly.
    patience: iterations without progress after which mu is lowered off the central path.
    rejection: a step that multiplies the merit by more than this is taken back.
    curvature_below: mu below which contact curvature is in the Jacobian; 1 is always. Smaller values take more
    iterations (docs/reports/omissions.md).
    branches: "largest" looks for the locked state of largest work wherever several coexist, "first" keeps the one
    reached from the slack pose.
    reference: the cell that strains refer to, "side-by-side" or "locked" (`rve.solve.reference_sides`).
    """

    tolerance: float = number(1e-11, above=0.0, most=1.0)
    mu_start: float = number(0.03, above=0.0, most=1.0)
    mu_end: float = number(1e-13, above=0.0, most=1.0)
    shrink: float = number(0.1, above=0.0, most=0.99)
    power: float = number(1.5, least=1.0, most=10.0)
    reach: float = number(0.6, above=0.0, most=10.0)
    step: float = number(0.15, above=0.0, most=0.5)
    max_iterations: int = whole(150, least=0, most=1_000_000)
    attempts: int = whole(3, least=1, most=100)
    patience: int = whole(20, least=1, most=1_000_000)
    rejection: float = number(3.0, least=1.0, most=NEVER)
    curvature_below: float = number(1.0, least=0.0, most=1.0)
    branches: str = choice("largest", "first", default="largest")
    reference: str = choice("side-by-side", "locked", default="side-by-side")


@dataclass(frozen=True)
class Equilibrium(Rows):
    """Locked poses of a batch of load cases and how they were found.

    pose: n poses in units of r1; lam (n, p, SLOTS): contact forces in units of s r1; contacts: where they act;
    R (n,): weighted residual; iterations (n,): Newton iterations over all attempts; status (n,): name of the outcome;
    attempts (n,): tries that were needed.
    """

    pose: Pose
    lam: Array
    contacts: Contacts
    R: Array
    iterations: Index
    status: NDArray[np.str_]
    attempts: Index


@dataclass(frozen=True)
class _State(Rows):
    """Cases still in the batch: row numbers, loads, poses, contacts, forces, path parameter, progress of the iteration.

    best, last: merit; stall: iterations without progress; radius: trust radius; moved: length of the last step.
    """

    row: Index
    s: Array
    pose: Pose
    contacts: Contacts
    lam: Array
    mu: Array
    best: Array
    last: Array
    stall: Index
    radius: Array
    moved: Array
    R: Array
    iterations: Index


def carry_forces(old: Contacts, lam: Array, new: Contacts, mu: Array) -> Array:
    """Contact forces for new contacts: the force of a pair of rings is handed on in full.

    Contacts that have one nearest successor each keep their forces. Where minima merge, split, appear or vanish, the
    force of the pair is shared out as on the central path, in proportion to 1/gap. New pairs start at mu/gap.
    """
    share = np.where(new.present, 1.0 / np.maximum(new.gap, 1e-14), 0.0)
    between = new.rho[:, :, :, None] - old.rho[:, :, None, :]
    distance = np.sqrt(np.einsum("npijx,npijx->npij", between, between))
    distance = np.where(new.present[..., None] & old.present[:, :, None, :], distance, np.inf)
    heir = distance.argmin(axis=2)
    slots = np.arange(distance.shape[2])[:, None]
    gives = (slots == heir[:, :, None, :]) & old.present[:, :, None, :]
    one_to_one = (gives.sum(axis=3) == new.present).all(axis=2)[..., None]
    total = lam.sum(axis=2, keepdims=True)
    shared = total * share / np.maximum(share.sum(axis=2, keepdims=True), 1e-300)
    kept = (gives * lam[:, :, None, :]).sum(axis=3)
    out = np.where(one_to_one, kept, np.where(total > 0.0, shared, mu[:, None, None] * share))
    return np.where(new.present, np.maximum(out, 1e-16), 0.0)


def newton_direction(
    system: System, gap: Array, lam: Array, mu: Array, present: Flags, step: Array
) -> tuple[Array, Array]:
    """Primal-dual Newton step (dq (n, m), dlam (n, c)) for r = 0, lam gap = mu, no longer than `step`.

    Eliminating dlam leaves K dq = r + G^T (mu - lam gap)/gap with K = -J + G^T diag(lam/gap) G. Where the symmetric
    part of K is indefinite, or the step too long, a multiple of the identity is added.
    """
    n, m = system.r.shape
    target = np.where(present, (mu[:, None] - lam * gap) / gap, 0.0)
    ratio = np.where(present, lam / gap, 0.0)
    Gt = system.G.transpose(0, 2, 1)
    K = -system.J + np.matmul(Gt * ratio[:, None, :], system.G)
    rhs = system.r + np.matmul(Gt, target[..., None])[..., 0]
    broken = ~(np.isfinite(K).all(axis=(1, 2)) & np.isfinite(rhs).all(axis=1))
    K[broken], rhs[broken] = np.eye(m), 0.0  # no step: the case stalls and is tried again from another start
    lowest = np.linalg.eigvalsh(0.5 * (K + K.transpose(0, 2, 1)))[:, 0]
    noise = 1e-15 * np.abs(K).max(axis=(1, 2))
    shift = np.where(lowest <= noise, 1.2 * np.abs(lowest) + np.maximum(1e-10, noise), 0.0)
    dq = np.zeros((n, m))
    todo = np.arange(n)
    for _ in range(14):
        shifted = K[todo] + shift[todo, None, None] * np.eye(m)
        dq[todo] = np.linalg.solve(shifted, rhs[todo, :, None])[..., 0]
        todo = todo[np.abs(dq[todo]).max(axis=1) > step[todo]]
        if not len(todo):
            break
        first = 0.017 / step[todo] * np.linalg.norm(rhs[todo], axis=1)
        shift[todo] = np.maximum(first, 2.5 * shift[todo])
    return dq, np.where(present, target - ratio * np.matmul(system.G, dq[..., None])[..., 0], 0.0)


def _accepted_step(
    state: _State, dq: Array, equations: Equations, options: DirectOptions
) -> tuple[Pose, Contacts, Array]:
    """The pose after the longest of the steps 1, 1/2, 1/4 ... that keeps gaps positive and links intact."""
    length = np.minimum(1.0, state.radius / np.maximum(np.abs(dq).max(axis=1), 1e-300))
    floor = 0.01 * state.contacts.min_gap

    def look(rows: Index) -> tuple[Pose, Contacts, Flags]:
        here = state.pose.take(rows)
        pose = moved(here, equations.displacement(length[rows, None] * dq[rows], here))
        contacts = equations.contacts(pose, options.reach)
        apart = np.ones(len(rows), dtype=bool)
        long = np.flatnonzero(length[rows] * np.abs(dq[rows]).max(axis=1) > 0.2 * equations.wire)
        if len(long):  # shorter steps cannot carry a ring through a wire
            way = parallel_clearance(here.take(long), pose.take(long), equations.weave, equations.wire)
            apart[long] = way > -equations.wire
        return pose, contacts, contacts.links_intact & (contacts.min_gap >= floor[rows]) & apart

    pose, contacts, good = look(np.arange(len(dq)))
    bad = np.flatnonzero(~good)
    for _ in range(30):
        if not len(bad):
            break
        length[bad] *= 0.5
        part, found, good = look(bad)
        pose, contacts = pose.put(bad, part), contacts.put(bad, found)
        bad = bad[~good]
    if len(bad):
        length[bad] = 0.0
        pose = pose.put(bad, state.pose.take(bad))
        contacts = contacts.put(bad, state.contacts.take(bad))
    return pose, contacts, length


def _measure(state: _State, system: System) -> tuple[Array, Array, Array]:
    """Weighted residual R, largest distance from the central path, and the merit that joins both, each (n,)."""
    product = state.lam * np.where(state.contacts.present, state.contacts.gap, 0.0)
    off = np.where(state.contacts.present, np.abs(product - state.mu[:, None, None]), 0.0).reshape(len(state.row), -1)
    R = system.weighted_residual
    return R, off.max(axis=1), np.sqrt(R**2 + (off**2).sum(axis=1))


def _followed(state: _State, off: Array, merit: Array, options: DirectOptions) -> _State:
    """The state with its path parameter, trust radius and counters updated."""
    better = merit < state.last
    improved = merit < 0.9 * state.best
    stall = np.where(improved, 0, state.stall + 1)
    on_path = (10.0 * state.mu > state.R) & (off < 0.9 * state.mu)
    # A barrier centre may not exist right where contacts merge: go on to the next mu after `patience` idle iterations.
    stuck = stall >= options.patience
    less = np.minimum(options.shrink * state.mu, state.mu**options.power)
    idle = min(2.0 * options.shrink, 1.0 - 0.5 * (1.0 - options.shrink))
    mu = np.where(on_path, less, np.where(stuck, idle * state.mu, state.mu))
    mu = np.maximum(mu, options.mu_end)
    fresh = on_path | stuck
    radius = np.where(better, 2.0 * state.radius, np.where(stall >= 3, 0.4 * state.radius, state.radius))
    radius = np.where(fresh, options.step, radius)
    return replace(
        state,
        mu=mu,
        best=np.where(fresh, np.inf, np.where(improved, merit, state.best)),
        last=np.where(fresh, np.inf, merit),
        stall=np.where(fresh, 0, stall),
        radius=np.clip(radius, 1e-7, options.step),
        iterations=state.iterations + 1,
    )


def _advanced(state: _State, equations: Equations, options: DirectOptions, system: System) -> _State:
    """One interior-point iteration for every case of the batch."""
    n = len(state.row)
    con = state.contacts
    present = con.present.reshape(n, -1)
    gap = np.where(present, con.gap.reshape(n, -1), 1.0)
    lam = state.lam.reshape(n, -1)
    dq, dlam = newton_direction(system, gap, lam, state.mu, present, state.radius)
    pose, contacts, length = _accepted_step(state, dq, equations, options)
    with np.errstate(divide="ignore", invalid="ignore"):
        longest = np.where(dlam < 0.0, -0.99 * lam / dlam, np.inf).min(axis=1)
    lam = (lam + np.minimum(longest, 1.0)[:, None] * dlam).reshape(state.lam.shape)
    lam = carry_forces(con, lam, contacts, state.mu)
    centre = state.mu[:, None, None] / np.where(contacts.present, np.maximum(contacts.gap, 1e-16), 1.0)
    lam = np.where(contacts.present, np.clip(lam, 1e-8 * centre, 1e8 * centre), 0.0)
    moved = length * np.abs(dq).max(axis=1)
    return replace(state, pose=pose, contacts=contacts, lam=lam, moved=moved)


def _run(state: _State, equations: Equations, options: DirectOptions) -> tuple[list[_State], _State]:
    """Iterate until every case has converged or the iterations are used up: converged cases, and the others."""
    finished: list[_State] = []
    anchor, anchor_system, cases = state, None, len(state.row)
    for iteration in range(options.max_iterations + 1):
        curved = state.mu <= options.curvature_below
        system = equations.assemble(state.pose, state.contacts, state.lam, state.s, curved)
        R, off, merit = _measure(state, system)
        if anchor_system is not None:
            worse = merit > options.rejection * state.last
            if worse.any():
                rows = np.flatnonzero(worse)
                radius = np.maximum(0.3 * np.minimum(state.radius, state.moved), 1e-7)
                state = state.put(rows, replace(anchor, radius=radius).take(rows))
                system = system.put(rows, anchor_system.take(rows))
                R, off, merit = _measure(state, system)
                state = replace(state, last=np.where(worse, merit, state.last))
        state = replace(state, R=R)
        done = (options.tolerance > R) & (state.mu <= options.mu_end) & (off < 10.0 * options.mu_end)
        if done.any():
            finished.append(state.take(done))
            go = ~done
            state, system, off, merit = state.take(go), system.take(go), off[go], merit[go]
        if not len(state.row) or iteration == options.max_iterations:
            break
        here = way(options.mu_start, float(np.median(state.mu)), options.mu_end) or 0.0
        tell(f"{cases} loads of rings", 1.0 - (1.0 - here) * len(state.row) / cases)
        state = _followed(state, off, merit, options)
        anchor, anchor_system = state, system
        state = _advanced(state, equations, options, system)
    return finished, state


def _attempt(options: DirectOptions, attempt: int) -> DirectOptions:
    """Options of an attempt: after the first, mu falls slowly and no step is taken back.

    A load that is nearly uniaxial, or a pull along the grain of thin wire, moves the cell far along a narrow valley
    while mu falls. If mu falls by a factor of ten or more, the cell is left behind on the wall of the valley and
    stalls there.
    """
    if attempt == 0:
        return options
    shrink = SLOW[(attempt - 1) % len(SLOW)]
    return replace(options, shrink=shrink, power=1.0, rejection=NEVER, max_iterations=4 * options.max_iterations)


def _disturbed(pose: Pose, equations: Equations, seed: int, amount: float) -> Pose:
    """Start poses shifted by seeded random numbers of size `amount`, the same for every case and batch."""
    shift = amount * np.random.default_rng(seed).uniform(-1.0, 1.0, equations.modes.shape[1])
    return moved(pose, equations.displacement(np.tile(shift, (len(pose.lattice), 1)), pose))


def solve_equilibrium(
    s: Array, equations: Equations, options: DirectOptions = DirectOptions(), start: Pose | None = None
) -> Equilibrium:
    """Locked poses under the Cauchy line loads s (n, 3), principal values >= 0, any size.

    Starts from the slack pose of the weave, or from `start` (n poses with positive gaps). A case that does not converge
    has status "stalled" and keeps its start pose with R = nan; nothing is raised.

    >>> from rve.geometry.kinematics import cauchy_line_load
    >>> from rve.geometry.weave import FOUR_IN_ONE
    >>> found = solve_equilibrium(cauchy_line_load([0.0], [90.0]), Equations.of(FOUR_IN_ONE, 0.1))
    >>> (5 * found.pose.lattice[0, :2]).round(6)
    array([11.     , 12.64607])
    """
    return follow(unit_loads(s), equations, options, start)


def unit_loads(s: Array) -> Array:
    """Line loads (n, 3) scaled to size 1: only their direction counts."""
    return np.asarray(s / np.sqrt(s[:, :1] ** 2 + 2.0 * s[:, 1:2] ** 2 + s[:, 2:] ** 2))


def follow(
    s: Array, equations: Equations, options: DirectOptions = DirectOptions(), start: Pose | None = None
) -> Equilibrium:
    """Equilibria under the load of the equations, `s` being its rows; see `solve_equilibrium`."""
    first = start if start is not None else start_pose(equations.weave, len(s))
    contacts = equations.contacts(first, options.reach)
    nan, none = np.full(len(s), np.nan), np.zeros(len(s), dtype=int)
    stalled = np.full(len(s), "stalled", dtype="<U16")
    found = Equilibrium(first, np.zeros(contacts.gap.shape), contacts, nan, none, stalled, none + options.attempts)
    left, iterations = np.arange(len(s)), none
    for attempt in range(options.attempts):
        tuned = _attempt(options, attempt)
        pose = first.take(left)
        if attempt > 0:
            pose = _disturbed(pose, equations, attempt, 0.03)
        state = _started(left, s[left], pose, iterations, equations, tuned)
        finished, rest = _run(state, equations, tuned)
        for part in finished:
            tries = np.full(len(part.row), attempt + 1)
            status = np.full(len(part.row), "converged", dtype="<U16")
            done = Equilibrium(part.pose, part.lam, part.contacts, part.R, part.iterations, status, tries)
            found = found.put(part.row, done)
        left, iterations = rest.row, rest.iterations
        if not len(left):
            return found
    total = found.iterations.copy()
    total[left] = iterations
    return replace(found, iterations=total)


def _started(
    row: Index, s: Array, pose: Pose, iterations: Index, equations: Equations, options: DirectOptions
) -> _State:
    """The state of cases at the start of an attempt, on the central path as far as forces can be."""
    contacts = equations.contacts(pose, options.reach)
    mu, inf, zero = np.full(len(row), options.mu_start), np.full(len(row), np.inf), np.zeros(len(row))
    lam = np.where(contacts.present, mu[:, None, None] / np.maximum(contacts.gap, 1e-9), 0.0)
    radius = np.full(len(row), options.step)
    return _State(row, s, pose, contacts, lam, mu, inf, inf, zero.astype(int), radius, zero, inf, iterations)
