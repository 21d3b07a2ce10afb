"""Newton's method on the energy of an elastic sheet, from a displacement that is nearly the answer.

Regularised semi-smooth Newton with a line search on the total potential of `macro_fem.fem.membrane`. For a tensile,
convex law the potential is convex (docs/explanation/elastic.md), so that every step that lowers it leads to the one
minimum.

Slack. Where the law is slack its tangent is zero. The matrix that is factorized is K + eps L. L is the stiffness of a
unit spring in every displacement gradient, and eps is proportional to the residual (Li, Fukushima, Qi and Yamashita,
Comput. Optim. Appl. 28, 2004). Energy and residual do not contain eps.

Kinks. The tangent jumps between taut, wrinkled and slack. The line search accepts a step if the potential falls and the
slope along the step has lost half of its size, so that a jump behind the first half of the step is seen.

Error. Convexity bounds the effect of the final residual r: Pi(u) - min Pi <= sum |r_i| |u_i - u*_i|. The reported
`energy_bound` takes the diagonal of the box around the reference and the deformed sheet for |u_i - u*_i|.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from macro_fem.fem.assembly import gradient
from macro_fem.fem.linear import NotPositiveDefiniteError
from macro_fem.fem.membrane import ElasticLaw, State, evaluate, tangent
from macro_fem.fem.supported import SupportedFem
from rve.common.progress import tell, way
from rve.common.types import Array
from rve.common.values import Options, number, whole

MAX_TRIALS = 20
"""Calls of the law in one line search. More of them are spent where rounding hides the fall of the potential."""
MAX_SHIFTS = 14
"""Factorizations tried with a tenfold eps each before the tangent counts as not convex."""
NEARLY_BALANCED = 1e-5
"""Relative residual below which a step that does not descend is the effect of rounding, not of a wrong tangent."""


@dataclass(frozen=True)
class NewtonOptions(Options):
    """When to stop and how to step.

    rtol: residual of the free unknowns over the larger of applied and internal nodal forces, all in the 2-norm. What
    round-off in the strains allows is added and reported. max_gradient_step: largest change of F at any point in one
    step; smaller: more steps from a slack start, larger: steps beyond the size of the curtain. regularisation: eps over
    the typical line load of the sheet at a relative residual of 1; smaller: longer steps that the line search cuts,
    larger: slower convergence. idle_steps: steps in a row, with neither a fall of the potential beyond round-off nor a
    new least residual, that end the search.
    """

    rtol: float = number(1e-9, above=0.0, most=1.0)
    max_iterations: int = whole(1000, least=0, most=1_000_000)
    max_gradient_step: float = number(1.0, above=0.0, most=1e6)
    regularisation: float = number(0.3, above=0.0, most=1e6)
    idle_steps: int = whole(15, least=0, most=1_000_000)


@dataclass(frozen=True)
class NewtonRecord:
    """One iteration: the state it started from and the step it took.

    potential, N mm; residual, relative (see `NewtonOptions.rtol`); length of the step that the line search took;
    evaluations of the law in it; eps, N/mm; factorizations until the matrix was definite.
    """

    potential: float
    residual: float
    length: float
    evaluations: int
    eps: float
    factorizations: int


@dataclass(frozen=True, eq=False)
class NewtonResult:
    """Where the iteration ended: u (n_nodes, d), mm; potential and stored energy, N mm; the bound on its error, N mm.

    stop: why it ended, a key of `macro_fem.solvers.status.WHY`. residual and tolerance: relative, both as used.
    energy_bound holds for convex laws. With "not_finite" u is the start, energies and residual are infinite.
    """

    u: Array
    stop: str
    potential: float
    stored: float
    energy_bound: float
    residual: float
    tolerance: float
    history: tuple[NewtonRecord, ...] = field(repr=False)


def solve(
    fem: SupportedFem, law: ElasticLaw, force: Array, start: Array, options: NewtonOptions = NewtonOptions()
) -> NewtonResult:
    """The equilibrium of an elastic sheet under dead nodal forces `force` (n_nodes, d), N.

    start (n_nodes, d): the first displacement, mm. ValueError if it does not obey the supports.

    A strip hung by its top edge, 2 mm high, stretched by its weight:

    >>> import skfem
    >>> from homogenize import diagonal_net
    >>> from macro_fem.fem.assembly import load_vector
    >>> from macro_fem.fem.discretization import discretize
    >>> disc = discretize(skfem.MeshTri.init_tensor(np.linspace(0, 1, 3), np.linspace(0, 2, 5)), "P1")
    >>> free = np.repeat(disc.nodes[:, 1] < 2.0, 2)
    >>> fem = SupportedFem(disc, np.where(free.reshape(-1, 2), 0.0, disc.nodes), free)
    >>> weight = load_vector(disc, np.array([0.0, -1e-3]))
    >>> solve(fem, diagonal_net(1.0, 1.0), weight, np.zeros_like(weight)).stop
    'closed'
    """
    if not np.allclose((fem.reference + start)[fem.held], fem.x_held[fem.held], rtol=0.0, atol=1e-9 * fem.size):
        raise ValueError("the displacement to start with does not obey the supports")
    descent = _Descent(fem, law, force, options)
    state = descent.evaluate(np.array(start, dtype=float))
    if not state.is_finite:
        return NewtonResult(state.u, "not_finite", np.inf, np.inf, np.inf, np.inf, options.rtol, ())
    stop, state = descent.run(state)
    balance = descent.balance(state)
    bound = _bounding_diagonal(fem, state.u) * float(np.abs(fem.gather(balance.residual)).sum())
    return NewtonResult(
        u=state.u,
        stop=stop,
        potential=balance.potential,
        stored=state.stored,
        energy_bound=bound,
        residual=balance.relative,
        tolerance=balance.tolerance,
        history=tuple(descent.history),
    )


@dataclass(frozen=True, eq=False)
class _Balance:
    """Residual nodal forces (n_nodes, d), potential, and the relative residual of the unknowns with its tolerance."""

    residual: Array
    potential: float
    relative: float
    tolerance: float


class _Descent:
    """One call of `solve`: what is made once, what the steps leave behind, and the records of the steps."""

    def __init__(self, fem: SupportedFem, law: ElasticLaw, force: Array, options: NewtonOptions) -> None:
        self.fem, self.law, self.force, self.options = fem, law, force, options
        disc, d = fem.disc, fem.d
        unit = np.eye(2 * d).reshape(d, 2, d, 2)
        self.spring = fem.matrix_data(np.broadcast_to(unit, (disc.n_points, d, 2, d, 2)))  # of L
        around = np.bincount(disc.cell_dofs.ravel(), np.repeat(disc.cell_area, disc.cell_dofs.shape[1]))
        self.share = float(np.linalg.norm(np.sqrt(around)))  # about the nodal forces of a unit stress
        self.stiffest = 0.0  # largest trace of the law's tangent so far, N/mm
        self.caution = 1.0  # factor on eps, larger after short steps
        self.evaluations = 0
        self.history: list[NewtonRecord] = []

    def run(self, state: State) -> tuple[str, State]:
        """Steps until the forces balance; why they ended and the last state."""
        balance = self.balance(state)
        idle, least = 0, balance.relative
        first = balance.relative
        while balance.relative > balance.tolerance:
            tell(f"Newton's method, step {len(self.history) + 1}", way(first, balance.relative, balance.tolerance))
            if idle == self.options.idle_steps:
                return "stalled", state
            if len(self.history) >= self.options.max_iterations:
                return "iterations", state
            outcome = self._step(state, balance)
            if isinstance(outcome, str):
                return outcome, state
            last, (state, balance) = state, outcome
            is_idle = not self._has_fallen(last, state) and balance.relative > 0.9 * least
            idle = idle + 1 if is_idle else 0
            least = min(least, balance.relative)
        return "closed", state

    def evaluate(self, u: Array) -> State:
        """The state at u, counted."""
        self.evaluations += 1
        with np.errstate(all="ignore"):  # a trial step may leave the law's domain; `is_finite` tells
            return evaluate(self.fem.disc, self.law, u)

    def balance(self, state: State) -> _Balance:
        """The forces that do not balance at a state, and how much of them round-off may explain."""
        r = state.internal - self.force
        scale = max(float(np.linalg.norm(self.force)), float(np.linalg.norm(state.internal))) or 1.0
        # Strains are known to a few units of round-off, stresses to that times the stiffness of the law.
        floor = 8.0 * np.finfo(float).eps * self.stiffest * self.share
        return _Balance(
            residual=r,
            potential=state.stored - float((self.force * state.u).sum()),
            relative=float(np.linalg.norm(self.fem.gather(r))) / scale,
            tolerance=self.options.rtol + floor / scale,
        )

    def _step(self, state: State, balance: _Balance) -> tuple[State, _Balance] | str:
        """One Newton step with its record, or why there is none."""
        before = self.evaluations
        response = state.response
        trace = response.C[:, 0, 0] + response.C[:, 1, 1] + response.C[:, 2, 2]
        self.stiffest = max(self.stiffest, float(trace.max()))
        data = self.fem.matrix_data(tangent(state.F, response.S, response.C))
        share = self.options.regularisation * self.caution * min(balance.relative, 1.0)
        found = self._direction(data, max(share * self._line_load(state), 1e-13 * self.stiffest), balance.residual)
        if found is None:
            return "not_convex"
        p, eps, factorizations = found
        if not float((balance.residual * p).sum()) < 0.0:
            return "stalled" if balance.relative < NEARLY_BALANCED else "not_convex"
        taken = self._line_search(state, balance, p)
        if taken is None:
            return "stalled"
        length, after, balance_after = taken
        # Short steps mean that the model reaches too far, mostly where slack cells move freely: hold them more.
        self.caution *= 4.0 if length < 0.03 else 0.25 if length > 0.2 else 1.0
        self.caution = float(np.clip(self.caution, 1.0, 1e3))
        calls = self.evaluations - before
        self.history.append(NewtonRecord(balance.potential, balance.relative, length, calls, eps, factorizations))
        return after, balance_after

    def _direction(self, data: Array, eps: float, residual: Array) -> tuple[Array, float, int] | None:
        """-(K + eps L)^-1 r as (n_nodes, d), the eps that made it definite and the tries; None if none did."""
        for tries in range(1, MAX_SHIFTS + 1):
            try:
                solve_linear = self.fem.solver.factorize(data + eps * self.spring)
            except NotPositiveDefiniteError:
                eps = max(10.0 * eps, 1e-9 * (self.stiffest or 1.0))
                continue
            return self.fem.spread(solve_linear(self.fem.gather(-residual))), eps, tries
        return None

    def _line_load(self, state: State) -> float:
        """The size of line loads to compare eps with, N/mm: what the force needs, or what the state bears if more.

        1 for a sheet without either: any value serves when there is nothing to carry.
        """
        disc = self.fem.disc
        area = float(disc.weight.sum())
        needed = float(np.abs(self.force).sum()) * self.fem.size / area
        S = state.response.S
        borne = float(disc.weight @ (np.abs(S[:, 0]) + np.abs(S[:, 2]))) / area
        return max(needed, borne) or 1.0

    def _has_fallen(self, before: State, after: State) -> bool:
        """Whether the potential fell by more than round-off. Term by term, because the work can hide it."""
        fall = before.stored - after.stored + float((self.force * (after.u - before.u)).sum())
        return fall > 1e-13 * (abs(before.stored) + abs(after.stored))

    def _noise(self, state: State) -> float:
        """Round-off of the stored energy: of its sum, and of strains of order one times the stress."""
        borne = float(self.fem.disc.weight @ np.abs(state.response.S).sum(axis=1))
        return 1e-13 * abs(state.stored) + 2.0 * float(np.finfo(float).eps) * borne

    def _line_search(self, state: State, balance: _Balance, p: Array) -> tuple[float, State, _Balance] | None:
        """A step length at which the potential has fallen and its slope has at most half its size; None without a fall.

        The slope is bracketed and interpolated linearly, kept away from the ends of the bracket (convex potentials have
        one root). If the slope does not get that small, the largest fall found counts.
        """
        slope_0 = float((balance.residual * p).sum())
        largest = float(np.sqrt((gradient(self.fem.disc, p) ** 2).sum(axis=(1, 2)).max()))
        cap = self.options.max_gradient_step / largest if largest > 0.0 else 1.0
        gain = float((self.force * p).sum())
        low, slope_low = 0.0, 2.0 * slope_0
        high, slope_high = np.inf, np.inf
        t = min(1.0, cap)
        best: tuple[float, State, _Balance] | None = None
        least = np.inf
        for _ in range(MAX_TRIALS):
            trial = self.evaluate(state.u + t * p)
            there = self.balance(trial)
            slope = float((there.residual * p).sum())
            rise = trial.stored - state.stored - t * gain  # term by term, as in `_has_fallen`
            noise = self._noise(trial) + self._noise(state)
            is_lower = trial.is_finite and rise <= 1e-4 * t * slope_0 + noise
            if is_lower and rise < least:
                best, least = (t, trial, there), rise
            if is_lower and (abs(slope) <= 0.5 * abs(slope_0) or (slope < 0.0 and t >= min(cap, 64.0))):
                return t, trial, there
            if is_lower and slope < 0.0:
                low, slope_low, slope_high = t, slope, 0.5 * slope_high
            else:
                # Halving the other end's slope (the Illinois rule) keeps a kink from holding it.
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


def _bounding_diagonal(fem: SupportedFem, u: Array) -> float:
    """Diagonal of the box around the reference and the deformed sheet, mm."""
    both = np.concatenate([fem.reference + u, fem.reference])
    return float(np.linalg.norm(both.max(axis=0) - both.min(axis=0)))
