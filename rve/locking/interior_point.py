"""Direct equilibrium of the periodic cell: a primal-dual interior-point Newton method, batched over load cases.

Each case follows the central path lam_i gap_i = mu as mu -> 0 from one slack pose, with the exact unsymmetric Jacobian
of `system`. Gaps stay positive and links intact in every accepted step, so rings never pass through each other. A trust
radius per case limits steps where the curvature of merging contacts is unbounded. Converged cases leave the batch.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from rve.common import Array, Flags, Index, Rows, Typed, tell
from rve.geometry.cell import Cell
from rve.geometry.contacts import CellContacts
from rve.geometry.pose import Pose, start_pose
from rve.locking.steps import Valley, accept_step, admitted_share, carry_forces, newton_direction
from rve.locking.system import Equations, System

LARGEST_STEP = 0.15
"""Largest change of a coordinate per iteration, in r1 or radians."""
SLOW = (0.5, 0.7)
"""Factors on mu of the attempts after the first; 0.5 solves most loads that stall, 0.3 fewer, 0.7 some of the rest."""


@dataclass(frozen=True)
class DirectOptions(Typed):
    """Options of the direct solver; lengths in units of r1, forces in units of s r1. InputError for senseless values.

    tolerance: weighted residual R at which a case has converged; the default leaves two digits to the paper's 1e-9.
    mu_start, mu_end: first and final complementarity lam gap; loaded gaps end at mu_end / lam, about 1e-12 mm.
    shrink, power: each stage lowers mu to the lesser of shrink mu and mu^power; larger `shrink` is slower and safer.
    max_iterations: per case and attempt; attempts after the first get four times as many.
    attempts: tries per case; those after the first lower mu slowly.
    patience: iterations without progress after which mu is lowered off the central path.
    corrections: second-order corrections of a step, which follow curved valleys (`rve.locking.steps`).
    branches: "largest" looks for the locked state of largest work wherever several coexist, "first" keeps the one
    reached from the slack pose.
    reference: the cell that strains refer to, "side-by-side" or "locked" (`rve.solve.reference_sides`).
    """

    tolerance: Annotated[float, Meta(gt=0.0, le=1.0)] = 1e-11
    mu_start: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.03
    mu_end: Annotated[float, Meta(gt=0.0, le=1.0)] = 1e-13
    shrink: Annotated[float, Meta(gt=0.0, le=0.99)] = 0.1
    power: Annotated[float, Meta(ge=1.0, le=10.0)] = 1.5
    max_iterations: Annotated[int, Meta(ge=0, le=1_000_000)] = 150
    attempts: Annotated[int, Meta(ge=1, le=100)] = 3
    patience: Annotated[int, Meta(ge=1, le=1_000_000)] = 20
    corrections: Annotated[int, Meta(ge=0, le=10)] = 0
    branches: Literal["largest", "first"] = "largest"
    reference: Literal["side-by-side", "locked"] = "side-by-side"


@dataclass(frozen=True)
class Equilibrium(Rows):
    """Locked poses of n load cases in r1 and how they were found: lam (n, p, SLOTS), contact forces in s r1; contacts:
    where they act; R (n,): weighted residual; iterations (n,) over all attempts; status (n,): name of the outcome;
    last: where the iteration of a case ended, converged or not.
    """

    pose: Pose
    lam: Array
    contacts: CellContacts
    R: Array
    iterations: Index
    status: NDArray[np.str_]
    attempts: Index
    last: Pose


@dataclass(frozen=True)
class LockedStates(Rows):
    """Locked states of n load cases: s (n, 3), Cauchy line loads in weave axes; unique (n,): False where the load
    leaves the strain free; cell: the mesh, whose weave lists the pairs of rings; beside: rows (k,) in which several
    states coexist, the shares (k,) of their other states, and as many of these, under the Cauchy loads that they carry
    in their own poses.
    """

    found: Equilibrium
    s: Array
    unique: Flags
    cell: Cell
    beside: tuple[tuple[Index, Array, LockedStates], ...] = ()

    @property
    def pose(self) -> Pose:
        """Poses in units of r1."""
        return self.found.pose


@dataclass(frozen=True)
class PathState(Rows):
    """Cases still in the batch: row in the result, load, their equations, path parameter mu; best and last merit;
    stall: iterations without progress; radius: trust radius.
    """

    row: Index
    s: Array
    pose: Pose
    contacts: CellContacts
    lam: Array
    system: System
    mu: Array
    best: Array
    last: Array
    stall: Index
    radius: Array
    R: Array
    iterations: Index


def measure_merit(state: PathState) -> tuple[Array, Array, Array]:
    """Weighted residual R, largest distance from the central path, and the merit that joins both, each (n,)."""
    product = state.lam * np.where(state.contacts.present, state.contacts.gap, 0.0)
    off = np.where(state.contacts.present, np.abs(product - state.mu[:, None, None]), 0.0).reshape(len(state.row), -1)
    R = state.system.weighted_residual
    return R, off.max(axis=1), np.sqrt(R**2 + (off**2).sum(axis=1))


def iterate(state: PathState, equations: Equations, options: DirectOptions) -> PathState:
    """One interior-point iteration for every case of the batch."""
    n, con, mu = len(state.row), state.contacts, state.mu[:, None, None]
    present = con.present.reshape(n, -1)
    gap = np.where(present, con.gap.reshape(n, -1), 1.0)
    lam = state.lam.reshape(n, -1)
    dq, dlam = newton_direction(state.system, gap, lam, state.mu, present, state.radius)
    valley = Valley.of(state.system, con, gap, lam, options.corrections) if options.corrections else None
    # As far towards the walls as mu is to fall: of a step that is halved instead, gaps keep half.
    share = admitted_share((1.0 - np.minimum(0.01, mu[:, 0])) * gap, np.matmul(state.system.G, dq[..., None])[..., 0])
    dq *= np.minimum(share, state.radius / np.maximum(np.abs(dq).max(axis=1), 1e-300))[:, None]
    floor = np.minimum(0.01 * con.min_gap, 0.1 * state.mu)
    pose, contacts = accept_step(state.pose, con, dq, floor, equations, valley)
    dlam *= admitted_share(0.99 * lam, dlam)[:, None]
    lam = carry_forces(con, (lam + dlam).reshape(state.lam.shape), contacts, state.mu)
    centre = mu / np.where(contacts.present, np.maximum(contacts.gap, 1e-16), 1.0)
    lam = np.where(contacts.present, np.clip(lam, 1e-8 * centre, 1e8 * centre), 0.0)
    system = equations.assemble(pose, contacts, lam, state.s)
    return replace(state, pose=pose, contacts=contacts, lam=lam, system=system)


def update_path(state: PathState, off: Array, merit: Array, options: DirectOptions) -> PathState:
    """The state with its path parameter, trust radius and counters updated."""
    better, improved = merit < state.last, merit < 0.9 * state.best
    stall = np.where(improved, 0, state.stall + 1)
    on_path = (10.0 * state.mu > state.R) & (off < 0.9 * state.mu)
    # A barrier centre may not exist right where contacts merge: go on to the next mu after `patience` idle iterations.
    fresh = (on_path & (state.mu > options.mu_end)) | (stall >= options.patience)
    idle = min(2.0 * options.shrink, 1.0 - 0.5 * (1.0 - options.shrink)) * state.mu
    mu = np.where(on_path, np.minimum(options.shrink * state.mu, state.mu**options.power), idle)
    radius = np.where(better, 2.0 * state.radius, np.where(stall >= 3, 0.4 * state.radius, state.radius))
    return replace(
        state,
        mu=np.maximum(np.where(fresh, mu, state.mu), options.mu_end),
        best=np.where(fresh, np.inf, np.where(improved, merit, state.best)),
        last=np.where(fresh, np.inf, merit),
        stall=np.where(fresh, 0, stall),
        radius=np.clip(np.where(fresh, LARGEST_STEP, radius), 1e-7, LARGEST_STEP),
        iterations=state.iterations + 1,
    )


def iterate_to_end(state: PathState, equations: Equations, options: DirectOptions) -> tuple[list[PathState], PathState]:
    """Iterate until every case has converged or the iterations are used up: converged cases, and the others."""
    finished: list[PathState] = []
    cases, begun = len(state.row), time.monotonic()
    for iteration in range(options.max_iterations + 1):
        R, off, merit = measure_merit(state)
        state = replace(state, R=R)
        go = ~((options.tolerance > R) & (state.mu <= options.mu_end) & (off < 10.0 * options.mu_end))
        if not go.all():
            finished.append(state.take(~go))
            state, off, merit = state.take(go), off[go], merit[go]
        if not len(state.row) or iteration == options.max_iterations:
            break
        tell(f"{len(state.row)} of {cases} loads under way", cases - len(state.row), cases, begun)
        state = iterate(update_path(state, off, merit, options), equations, options)
    return finished, state


def solve_equilibrium(
    s: Array,
    equations: Equations,
    options: DirectOptions = DirectOptions(),
    start: Pose | None = None,
    made: int = 0,
) -> Equilibrium:
    """Locked poses under the load of the equations, s being its rows: by default Cauchy line loads (n, 3), principal
    values >= 0, any size.

    Starts from the slack pose of the weave, or from `start` (n poses with positive gaps). A case that does not converge
    has status "stalled" and keeps its start pose with R = nan; nothing is raised. Attempts after the first start from
    disturbed poses, the same for every case and batch; mu falls slowly there, so that cells which move far along a
    narrow valley are not left behind on its wall. `made` attempts have been made before and are not made again.

    >>> from rve.geometry.kinematics import cauchy_line_load
    >>> from rve.geometry.weave import FOUR_IN_ONE
    >>> found = solve_equilibrium(cauchy_line_load([0.0], [90.0]), Equations.of(FOUR_IN_ONE, 0.1))
    >>> (5 * found.pose.lattice[0, :2]).round(6)
    array([11.     , 12.64607])
    """
    s = unit_loads(s) if equations.is_relative else s
    first = start if start is not None else start_pose(equations.weave, len(s))
    contacts = equations.contacts(first)
    nan, iterations = np.full(len(s), np.nan), np.zeros(len(s), dtype=int)
    stalled = np.full(len(s), "stalled", dtype="<U16")
    tries = np.full(len(s), options.attempts)
    found = Equilibrium(first, np.zeros(contacts.gap.shape), contacts, nan, iterations, stalled, tries, first)
    left, tuned = np.arange(len(s)), options
    for attempt in range(made, options.attempts):
        pose, here = first.take(left), contacts.take(left)
        if attempt > 0:
            tuned = replace(options, shrink=SLOW[(attempt - 1) % len(SLOW)], power=1.0)
            tuned = replace(tuned, max_iterations=4 * options.max_iterations)
            shift = 0.03 * np.random.default_rng(attempt).uniform(-1.0, 1.0, (1, equations.modes.shape[1]))
            pose = equations.moved(pose, np.repeat(shift, len(left), axis=0))
            here = equations.contacts(pose)
        # On the central path as far as forces can be.
        n = len(left)
        mu, inf = np.full(n, options.mu_start), np.full(n, np.inf)
        lam = np.where(here.present, mu[:, None, None] / np.maximum(here.gap, 1e-9), 0.0)
        radius, stall = np.full(n, LARGEST_STEP), np.zeros(n, dtype=int)
        system = equations.assemble(pose, here, lam, s[left])
        state = PathState(left, s[left], pose, here, lam, system, mu, inf, inf, stall, radius, inf, iterations)
        finished, rest = iterate_to_end(state, equations, tuned)
        for part in finished:
            tries, status = np.full(len(part.row), attempt + 1), np.full(len(part.row), "converged", dtype="<U16")
            done = Equilibrium(part.pose, part.lam, part.contacts, part.R, part.iterations, status, tries, part.pose)
            found = found.put(part.row, done)
        left, iterations = rest.row, rest.iterations
        found = replace(found, last=found.last.put(left, rest.pose))
        if not len(left):
            return found
    total = found.iterations.copy()
    total[left] = iterations
    return replace(found, iterations=total)


def unit_loads(s: Array) -> Array:
    """Line loads (n, 3) scaled to size 1: only their direction counts."""
    return np.asarray(s / np.sqrt(s[:, :1] ** 2 + 2.0 * s[:, 1:2] ** 2 + s[:, 2:] ** 2))
