"""Newton steps down one potential: tangent, regularised factor, line search, record; the path is `newton`'s."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse

from macro_fem.fem.assembly import Array, Pattern, gradient, sparsity, stiffness, tied_pattern
from macro_fem.fem.linear import Factor, LinearSolver, NotPositiveDefiniteError, analyze, rigid_motions
from macro_fem.fem.membrane import Membrane, State, evaluate, tangent
from macro_fem.solvers.newton_records import LoadStep, NewtonOptions, NewtonRecord, NewtonStatus
from macro_fem.solvers.softened import CompliantLaw, SoftenedLaw

MAX_TRIALS = 20
"""Calls of the law in one line search; the best fall found counts. More only burns time where round-off rules."""


@dataclass(eq=False)
class Work:
    """What one call of `solve` builds once and counts on the way; never leaves the solver.

    `membrane` has the law of the present stage: the true one, or a softened one between `soften` and `harden`.
    """

    true: Membrane
    membrane: Membrane
    options: NewtonOptions
    pattern: Pattern  # of the free components, or with ties of all
    solver: LinearSolver
    spring: Array  # data of L, the unit spring in every displacement gradient
    share: Array  # root of the area around each node (n_nodes,), about the force of a unit stress on it
    tied: tuple[Pattern, sparse.csr_matrix] | None = None  # see `assembly.tied_pattern`
    stiffest: float = 0.0  # largest trace of the law's tangent seen so far, N/mm
    caution: float = 1.0  # factor on eps, from how short the steps were
    history: list[NewtonRecord] = field(default_factory=list)
    factorizations: int = 0
    evaluations: int = 0
    assembly_s: float = 0.0
    linear_s: float = 0.0

    @staticmethod
    def of(membrane: Membrane, options: NewtonOptions) -> Work:
        begin = time.perf_counter()
        disc = membrane.disc
        tie = membrane.tie
        pattern = sparsity(disc, membrane.d, np.ones_like(membrane.fixed) if tie is not None else ~membrane.fixed)
        tied = None if tie is None else tied_pattern(pattern, tie)
        if tied is None:
            solver = analyze(pattern, options.linear, rigid_motions(pattern, disc.nodes))
        else:
            solver = analyze(tied[0], options.linear)
        unit = np.zeros((membrane.d, 2, membrane.d, 2, disc.n_points))
        for i, j in np.ndindex(membrane.d, 2):
            unit[i, j, i, j] = 1.0
        spring = stiffness(disc, pattern, np.moveaxis(unit, -1, 0))
        if tied is not None:
            spring = tied[1] @ pattern.full(spring).data
        size = np.sqrt(np.bincount(disc.cell_dofs.ravel(), np.repeat(_cell_area(membrane), disc.cell_dofs.shape[1])))
        work = Work(membrane, membrane, options, pattern, solver, spring, size, tied)
        work.assembly_s = time.perf_counter() - begin
        return work

    def soften(self, law: CompliantLaw, softness: float, S0: Array) -> None:
        """Go on with the true law's compliance times `softness`, remembering the stress S0."""
        self.membrane = replace(self.true, law=SoftenedLaw(law, softness, S0))
        self.stiffest, self.caution = 0.0, 1.0

    def harden(self) -> None:
        """Go on with the true law."""
        self.membrane = self.true
        self.stiffest, self.caution = 0.0, 1.0

    def line_load(self, load: LoadStep, state: State | None = None) -> float:
        """The size of line loads to compare eps with, N/mm: what the dead force needs, or what the state bears if more.

        A sheet without either gets 1: any value serves when there is nothing to carry.
        """
        disc = self.membrane.disc
        area = float(disc.weight.sum())
        size = float(np.linalg.norm(disc.nodes.max(axis=0) - disc.nodes.min(axis=0)))
        needed = abs(load.force) * float(np.abs(self.membrane.force).sum()) * size / area
        S = None if state is None else state.response.S
        borne = 0.0 if S is None else float(disc.weight @ (np.abs(S[:, 0]) + np.abs(S[:, 2]))) / area
        return max(needed, borne) or 1.0

    def evaluate(self, u: Array) -> State:
        begin = time.perf_counter()
        with np.errstate(all="ignore"):  # a trial step may leave the law's domain; `is_finite` tells
            state = evaluate(self.membrane, u)
        self.evaluations += 1
        self.assembly_s += time.perf_counter() - begin
        return state

    def tangent(self, state: State) -> tuple[Array, Array]:
        """The tangent at the points and the data of its matrix."""
        begin = time.perf_counter()
        response = state.response
        trace = response.C[:, 0, 0] + response.C[:, 1, 1] + response.C[:, 2, 2]
        self.stiffest = max(self.stiffest, float(trace.max()))
        A = tangent(state.F, response.S, response.C)
        data = stiffness(self.membrane.disc, self.pattern, A)
        if self.tied is not None:
            data = self.tied[1] @ self.pattern.full(data).data
        self.assembly_s += time.perf_counter() - begin
        return A, data

    def factorize(self, data: Array, eps: float) -> tuple[Factor, float] | None:
        """A factor of K + eps L and the eps that made it definite; None if none did."""
        begin = time.perf_counter()
        try:
            for _ in range(14):
                self.factorizations += 1
                try:
                    return self.solver.factorize(data + eps * self.spring), eps
                except NotPositiveDefiniteError:
                    eps = max(10.0 * eps, 1e-9 * (self.stiffest or 1.0))
            return None
        finally:
            self.linear_s += time.perf_counter() - begin

    def solve(self, factor: Factor, force: Array) -> tuple[Array, float] | None:
        """The displacement (n_nodes, d), zero at the supports, of the nodal forces, and the relative linear residual.

        None if conjugate gradients met a direction without stiffness.
        """
        begin = time.perf_counter()
        try:
            solution = factor.solve(self.gather(force))
        except NotPositiveDefiniteError:
            return None
        finally:
            self.linear_s += time.perf_counter() - begin
        return self._spread(solution.x), solution.residual

    def gather(self, nodal: Array) -> Array:
        """The generalised forces (n,) of nodal forces (n_nodes, d) on the unknowns."""
        tie = self.membrane.tie
        return nodal.ravel()[self.pattern.free] if tie is None else np.asarray(tie.T @ nodal.ravel())

    def _spread(self, x: Array) -> Array:
        p = np.zeros(self.membrane.fixed.size)
        if self.membrane.tie is None:
            p[self.pattern.free] = x
        else:
            p = self.membrane.tie @ x
        return p.reshape(self.membrane.fixed.shape)


@dataclass(frozen=True, eq=False)
class Balance:
    """A state under a load: residual (n_nodes, d), zero at supports; potential; relative norm and its tolerance.

    The norm is that of the generalised forces on the unknowns, `Work.gather(residual)`.
    """

    residual: Array
    potential: float
    relative: float
    tolerance: float


def balance_of(work: Work, state: State, load: LoadStep) -> Balance:
    """What does not balance at a state under a load step, and how much of that round-off may explain."""
    force = load.force * work.membrane.force
    r = state.internal - force
    r[work.membrane.fixed] = 0.0
    work_done = force * state.u
    scale = max(float(np.linalg.norm(force)), float(np.linalg.norm(state.internal))) or 1.0
    # Strains are known to a few units of round-off, stresses to that times the stiffness of the law.
    floor = 8.0 * np.finfo(float).eps * work.stiffest * float(np.linalg.norm(work.share))
    return Balance(
        residual=r,
        potential=state.stored - float(work_done.sum()),
        relative=float(np.linalg.norm(work.gather(r))) / scale,
        tolerance=work.options.rtol + floor / scale,
    )


@dataclass(frozen=True)
class Stage:
    """A load step with `softness` times the law's compliance, to be balanced to `rtol`."""

    number: int
    load: LoadStep
    softness: float
    rtol: float


def descend(work: Work, stage: Stage, state: State, count: int, limit: int) -> tuple[NewtonStatus, State, int]:
    """Newton steps until the forces of a stage balance, or the count of the load step's iterations hits the limit."""
    if not state.is_finite:
        return NewtonStatus.NOT_FINITE, state, count
    balance = balance_of(work, state, stage.load)
    idle, least = 0, balance.relative
    while balance.relative > balance.tolerance - work.options.rtol + stage.rtol:
        if idle == work.options.idle_steps:
            return _stalled(balance), state, count
        if count >= limit:
            return NewtonStatus.ITERATION_LIMIT, state, count
        outcome = _iterate(work, stage, count, state, balance)
        if isinstance(outcome, NewtonStatus):
            return outcome, state, count
        last, (state, after) = state, outcome
        is_idle = not _has_fallen(work, stage.load, last, state) and after.relative > 0.9 * least
        idle = idle + 1 if is_idle else 0
        least = min(least, after.relative)
        balance = after
        count += 1
    return NewtonStatus.CONVERGED, state, count


def _has_fallen(work: Work, load: LoadStep, before: State, after: State) -> bool:
    """Whether the potential fell by more than round-off; term by term, for the work would swallow what is stored."""
    fall = before.stored - after.stored + load.force * float((work.membrane.force * (after.u - before.u)).sum())
    return fall > 1e-13 * (abs(before.stored) + abs(after.stored))


def _noise(work: Work, state: State) -> float:
    """Round-off of the stored energy: of its sum, and of strains of order one, which a stiff law makes much of."""
    borne = float(work.membrane.disc.weight @ np.abs(state.response.S).sum(axis=1))
    return 1e-13 * abs(state.stored) + 2.0 * float(np.finfo(float).eps) * borne


def _stalled(balance: Balance) -> NewtonStatus:
    return NewtonStatus.ROUND_OFF if balance.relative < 1e-5 else NewtonStatus.STALLED


def _iterate(
    work: Work, stage: Stage, count: int, state: State, balance: Balance
) -> tuple[State, Balance] | NewtonStatus:
    """One Newton step with its record, or why there is none."""
    before = (work.assembly_s, work.linear_s, work.evaluations)
    _, data = work.tangent(state)
    share = work.options.regularisation * work.caution * min(balance.relative, 1.0)
    eps = share * work.line_load(stage.load, state)
    factored = work.factorize(data, max(eps, 1e-13 * work.stiffest))
    if factored is None:
        return NewtonStatus.NOT_CONVEX
    factor, eps = factored
    solved = work.solve(factor, -balance.residual)
    if solved is None:
        return NewtonStatus.NOT_CONVEX
    p, linear_residual = solved
    slope = float((balance.residual * p).sum())
    if not slope < 0.0:
        return _stalled(balance) if balance.relative < 1e-5 else NewtonStatus.NOT_CONVEX
    found = _line_search(work, stage.load, state, balance, p)
    if found is None:
        return _stalled(balance)
    length, state_next, balance_next = found
    # Short steps mean that the model reaches too far, mostly where slack cells move freely: hold them more.
    work.caution *= 4.0 if length < 0.03 else 0.25 if length > 0.2 else 1.0
    work.caution = float(np.clip(work.caution, 1.0, 1e3))
    work.history.append(
        NewtonRecord(
            load_step=stage.number,
            iteration=count,
            softness=stage.softness,
            potential=balance.potential,
            residual=balance.relative,
            length=length,
            evaluations=work.evaluations - before[2],
            eps=eps,
            slack=_slack_share(work.membrane, state),
            assembly_s=work.assembly_s - before[0],
            linear_s=work.linear_s - before[1],
            linear_residual=linear_residual,
        )
    )
    return state_next, balance_next


def _line_search(
    work: Work, load: LoadStep, state: State, balance: Balance, p: Array
) -> tuple[float, State, Balance] | None:
    """A step length at which the potential has fallen and its slope has at most half its size; None if none is found.

    The slope is bracketed and interpolated linearly, kept away from the ends of the bracket (convex potentials have one
    root). The best fall found counts if the slope does not get that small.
    """
    slope_0 = float((balance.residual * p).sum())
    largest = float(np.sqrt((gradient(work.membrane.disc, p) ** 2).sum(axis=(1, 2)).max()))
    cap = work.options.max_gradient_step / largest if largest > 0.0 else 1.0
    gain = load.force * float((work.membrane.force * p).sum())
    low, slope_low = 0.0, 2.0 * slope_0
    high, slope_high = np.inf, np.inf
    t = min(1.0, cap)
    best: tuple[float, State, Balance] | None = None
    least = np.inf
    for _ in range(MAX_TRIALS):
        trial = work.evaluate(state.u + t * p)
        there = balance_of(work, trial, load)
        slope = float((there.residual * p).sum())
        # Term by term: the work of the load would swallow what a stiff sheet stores.
        rise = trial.stored - state.stored - t * gain
        noise = _noise(work, trial) + _noise(work, state)
        is_lower = trial.is_finite and rise <= 1e-4 * t * slope_0 + noise
        if is_lower and rise < least:
            best, least = (t, trial, there), rise
        if is_lower and (abs(slope) <= 0.5 * abs(slope_0) or (slope < 0.0 and t >= min(cap, 64.0))):
            return t, trial, there
        if is_lower and slope < 0.0:
            low, slope_low, slope_high = t, slope, 0.5 * slope_high
        else:
            # Halving the other end's slope (the Illinois rule) keeps a kink from holding it for ever.
            high, slope_high, slope_low = t, slope if trial.is_finite else np.inf, 0.5 * slope_low
        if np.isinf(high):
            t = min(2.0 * t, cap)
            continue
        share = 0.5
        if np.isfinite(slope_high) and slope_high > 0.0:
            share = float(np.clip(slope_low / (slope_low - slope_high), 0.1, 0.9))
        t = low + share * (high - low)
        if high - low <= 1e-12 * high:
            break
    return best


def _cell_area(membrane: Membrane) -> Array:
    return np.asarray(membrane.disc.weight.reshape(membrane.disc.n_quad, -1).sum(axis=0))


def _slack_share(membrane: Membrane, state: State) -> float:
    weight = membrane.disc.weight
    return float(weight[state.response.energy <= 0.0].sum() / weight.sum())
