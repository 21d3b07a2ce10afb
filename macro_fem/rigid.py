"""The rigid curtain by an interior-point method on its displacements: the default solver of ideal locking.

    minimise  -l.z   over z   subject to   g_qi(z) = h_i - S_i:E(F_q(z)) >= 0   at every point q,  z the free unknowns

A convex program with quadratic constraints. Its Lagrangian is stationary where l = B^T (w F S), S_q = sum_i lam_qi S_i:
the equilibrium of the tensile stress S, so multipliers are line loads. The primal-dual path lam g = mu is followed by
Newton steps with Mehrotra's predictor and corrector (S. Mehrotra, doi 10.1137/0802028; M. H. Wright,
doi 10.1137/1034115); every Newton matrix has the pattern of the finite elements:

    H = B^T w [ S (x) I  +  sum_i (lam_i / g_i) (F S_i)(F S_i)^T ] B.

Iterates stay strictly inside the law: a half-space of the law joins a point as soon as it is the nearest by a margin,
so no outer rounds are needed and the sum of w lam g bounds the error against the whole law, not against a few planes.

A start that is not inside is mended by a first phase: minimise t subject to g_i + t c_i^2/2 >= 0, with the same steps
and t as one more unknown. If the least t is positive its multipliers prove that no admissible state exists.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from homogenize.law import Array, MembraneLaw
from macro_fem.cones import Cones, ddot, first_cones, law_cut, times_triple, with_cuts


class Fem(Protocol):
    """What the solver needs of a discretised curtain: linear maps between free unknowns and deformation gradients."""

    @property
    def weight(self) -> Array:
        """Reference area of each point (nq,), mm2."""
        ...

    def gradient(self, z: Array) -> Array:
        """F (nq, d, 2) of the free unknowns z (n,), supports included."""
        ...

    def gradient_change(self, dz: Array) -> Array:
        """B dz (nq, d, 2)."""
        ...

    def force(self, P: Array) -> Array:
        """B^T (w P) (n,), the nodal forces of a stress P (nq, d, 2) in N/mm."""
        ...

    def factorize(self, tangent: Array) -> Callable[[Array], Array]:
        """A solver of B^T (w A) B x = b for tangents A (nq, d, 2, d, 2) in N/mm."""
        ...


LEAST_STEP = 1e-10
REACH = 4.0
"""No point of one admissible state is farther from its place in another than this many sizes: twice the stretch."""
PATIENCE = 12
"""Iterations without a smaller error after which rounding is taken to rule."""
ROUNDING = 1e-7
"""A stalled iteration is accepted below this relative error (gap and residual), which it states."""
NO_LOAD = 1e-6
"""N/mm2: sets the energy scale of a curtain without load."""


@dataclass(frozen=True)
class RigidOptions:
    """When to stop and how boldly to step.

    `gap` is relative to the scale of the problem (largest load times size) and is usually met last; `residual` is the
    largest unbalanced force relative to the largest load. `boundary` is the fraction of the way to the nearest
    constraint that a step may go. `max_iterations` is about three times what any tested curtain needed.
    """

    gap: float = 1e-9
    residual: float = 1e-8
    max_iterations: int = 150
    boundary: float = 0.995
    cut_margin: float = 0.7
    relax: float = 1e-10


@dataclass(frozen=True)
class Iteration:
    """One line of the history: barrier parameter, gap and residual (relative), step length, half-spaces, phase."""

    phase: int
    mu: float
    gap: float
    residual: float
    step: float
    cones: int
    t: float


@dataclass(frozen=True)
class RigidResult:
    """Free unknowns z, multipliers and stress of the rigid curtain, with a status and the numbers that prove it.

    `primal` is -l.z (an upper bound of the least potential), `dual` a lower bound of it, both N mm and without the
    constant that supports add. S (nq, 3) in N/mm is the second Piola-Kirchhoff line load. `relaxed` is the relative
    amount by which cones were widened (0 unless the supports leave no slack at all).
    """

    status: str
    message: str
    z: Array
    lam: Array
    cones: Cones
    S: Array
    primal: float
    dual: float
    residual: float
    iterations: int
    relaxed: float
    history: tuple[Iteration, ...] = field(repr=False)

    @property
    def converged(self) -> bool:
        return self.status == "converged"


STATUSES = {
    "converged": "the gap between upper and lower bound is closed",
    "infeasible": "the supports are farther apart than the mesh can stretch: the least stretch beyond locking is "
    "{t:.3g} of the chain length; move the supports together or use a smaller gather",
    "iterations": "stopped after {n} iterations with a relative gap of {gap:.1e}: raise solver.max_iterations",
    "stalled": "no further progress is possible in double precision at a relative gap of {gap:.1e}; "
    "ask for a wider solver.tolerance",
}
"""One status per way to end, each with what happened and what to try."""


@dataclass(frozen=True)
class _State:
    """Where the iteration stands: unknowns, deformation, slacks, multipliers, the widening t of the first phase."""

    z: Array
    F: Array
    cones: Cones
    g: Array
    lam: Array
    t: float


@dataclass(frozen=True)
class _Step:
    dz: Array
    dF: Array
    dg: Array  # full change of slack at step 1, the quadratic part included
    curve: Array  # quadratic part of dg, <= 0
    dlam: Array
    dt: float


def _slack(cones: Cones, F: Array, t: float) -> Array:
    return cones.slack(F) + t * cones.size


class _Newton:
    """The factorised Newton matrix at a state, with t as a bordering unknown in the first phase."""

    def __init__(self, fem: Fem, load: Array, state: _State, free_t: bool) -> None:
        self.fem, self.load, self.state, self.free_t = fem, load, state, free_t
        cones = state.cones
        self.w = fem.weight[cones.point]
        self.pull = cones.pull(state.F)
        self.ratio = state.lam / state.g
        d = state.F.shape[1]
        flat = self.pull.reshape(len(cones), 2 * d)
        scaled = flat * self.ratio[:, None]
        A = cones.sum(scaled[:, :, None] * flat[:, None, :]).reshape(-1, d, 2, d, 2)
        S = cones.stress(state.lam)
        for a in range(d):
            A[:, a, 0, a, 0] += S[:, 0]
            A[:, a, 0, a, 1] += S[:, 1]
            A[:, a, 1, a, 0] += S[:, 1]
            A[:, a, 1, a, 1] += S[:, 2]
        self.solve = fem.factorize(A)
        if free_t:
            weighted = self.ratio * cones.size
            self.border = -fem.force(cones.sum(weighted[:, None, None] * self.pull))
            self.corner = float((self.w * weighted) @ cones.size)
            self.bordered = self.solve(self.border)

    def direction(self, target: Array, twist: Array | None, curve: Array | None) -> _Step:
        """The step towards lam g = target, given second-order terms of a predictor.

        twist (nq, d, 2): sum of dlam dF S of the predictor; curve (nc,): quadratic part of its slack change.
        """
        state, cones = self.state, self.state.cones
        aim = target / state.g
        if curve is not None:
            aim = aim - self.ratio * curve
        P = cones.sum(aim[:, None, None] * self.pull)
        if twist is not None:
            P = P + twist
        rhs = self.load - self.fem.force(P)
        dz, dt = self.solve(rhs), 0.0
        if self.free_t:
            rhs_t = float((self.w * aim) @ cones.size) - 1.0
            dt = (rhs_t - float(self.border @ dz)) / (self.corner - float(self.border @ self.bordered))
            dz = dz - dt * self.bordered
        dF = self.fem.gradient_change(dz)
        dF_point = dF[cones.point]
        linear = -ddot(self.pull, dF_point) + dt * cones.size
        quadratic = -0.5 * ddot(times_triple(dF_point, cones.S), dF_point)
        dlam = aim - state.lam - self.ratio * linear
        return _Step(dz, dF, linear + quadratic, quadratic, dlam, dt)


def _largest_step(state: _State, step: _Step, w_boundary: float) -> tuple[float, float]:
    """How far z and lam may go: the first zero of any slack (a quadratic) and of any multiplier, times the fraction."""
    a, b, g = -step.curve, step.dg - step.curve, state.g  # slack along the step: g + b s - a s^2, a >= 0
    root = np.sqrt(b * b + 4.0 * a * g)
    denominator = root - b  # the positive root is 2 g / (root - b)
    with np.errstate(divide="ignore"):
        primal = float(np.min(np.where(denominator > 0.0, 2.0 * g / denominator, np.inf), initial=np.inf))
        shrink = step.dlam < 0.0
        dual = float(np.min(-state.lam[shrink] / step.dlam[shrink], initial=np.inf))
    return min(1.0, w_boundary * primal), min(1.0, w_boundary * dual)


def _predictor_corrector(newton: _Newton, mu: float, w_boundary: float) -> _Step:
    """Mehrotra's step: an affine one to see how far mu can fall, then the centred one with second-order terms."""
    state = newton.state
    affine = newton.direction(np.zeros_like(state.g), None, None)
    reach = min(_largest_step(state, affine, w_boundary))
    sigma = max((1.0 - reach) ** 3, 1e-4)
    lam_change = affine.dlam * affine.dg
    # an affine step that would leave the cones at once has misleading second-order terms: damp them by its length
    twist = state.cones.sum(affine.dlam[:, None, None] * times_triple(affine.dF[state.cones.point], state.cones.S))
    weight = reach**2
    return newton.direction(sigma * mu - weight * lam_change, weight * twist, weight * affine.curve)


def _average_mu(state: _State, weight: Array) -> float:
    w = weight[state.cones.point]
    return float((w * state.lam * state.g).sum() / w.sum())


def _add_cuts(state: _State, law: MembraneLaw, mu: float, margin: float) -> _State:
    """`state` with the law's nearest half-space at points where it is nearer than `margin` times the nearest one kept.

    Slacks are compared relative to their sizes. New multipliers start on the central path, mu / g.
    """
    S, h, g = law_cut(law, state.F)
    nearest = np.minimum.reduceat(state.g / state.cones.size, state.cones.first)
    new = np.flatnonzero(g / (h + 0.5 * (S[:, 0] + S[:, 2])) + state.t < margin * nearest)
    if len(new) == 0:
        return state
    cones, order = with_cuts(state.cones, new, S[new], h[new])
    is_new = order >= len(state.cones)
    g_all = _slack(cones, state.F, state.t)
    lam = np.concatenate([state.lam, np.zeros(len(new))])[order]
    lam[is_new] = mu / g_all[is_new]
    return replace(state, cones=cones, g=g_all, lam=lam)


def _gap(state: _State, weight: Array) -> float:
    return float((weight[state.cones.point] * state.lam * state.g).sum())


def _moved(state: _State, step: _Step, alpha: float, alpha_dual: float, fem: Fem) -> _State:
    z, t = state.z + alpha * step.dz, state.t + alpha * step.dt
    F = fem.gradient(z)
    return _State(z, F, state.cones, _slack(state.cones, F, t), state.lam + alpha_dual * step.dlam, t)


def _advance(
    state: _State, fem: Fem, law: MembraneLaw, load: Array, free_t: bool, opt: RigidOptions
) -> tuple[_State, float]:
    """One predictor-corrector step that stays strictly inside the law, and its length: 0 if no step does."""
    try:
        newton = _Newton(fem, load, state, free_t)
    except ArithmeticError:  # no pivot order works: double precision is exhausted
        return state, 0.0
    step = _predictor_corrector(newton, _average_mu(state, fem.weight), opt.boundary)
    if not (np.all(np.isfinite(step.dz)) and np.all(np.isfinite(step.dlam))):
        return state, 0.0
    alpha = min(_largest_step(state, step, opt.boundary))
    while alpha > LEAST_STEP:
        new = _moved(state, step, alpha, alpha, fem)
        if np.all(new.g > 0.0) and _law_slack(law, new.F) + new.t > 0.0:
            return _add_cuts(new, law, _average_mu(new, fem.weight), opt.cut_margin), alpha
        alpha *= 0.7
    return state, 0.0


def _law_slack(law: MembraneLaw, F: Array) -> float:
    """The least relative slack of the whole law over all points; negative where F is not admissible."""
    S, h, g = law_cut(law, F)
    return float((g / (h + 0.5 * (S[:, 0] + S[:, 2]))).min())


def _first_state(fem: Fem, law: MembraneLaw, z: Array) -> _State:
    """A state at z that is strictly inside after widening by t, with t = 0 if z is well inside itself."""
    F = fem.gradient(z)
    cones = first_cones(law, len(F))
    slack = min(float((cones.slack(F) / cones.size).min()), _law_slack(law, F))
    t = 0.0 if slack > 1e-3 else 0.1 + 1.1 * max(0.0, -slack)
    g = _slack(cones, F, t)
    return _add_cuts(_State(z, F, cones, g, np.ones(len(cones)), t), law, 1.0, 0.7)


def _centred(state: _State, mu: float) -> _State:
    return replace(state, lam=mu / state.g)


def _unbalanced(fem: Fem, load: Array, state: _State) -> Array:
    """Load minus internal force (n,)."""
    return load - fem.force(times_triple(state.F, state.cones.stress(state.lam)))


def _phase_one(
    fem: Fem, law: MembraneLaw, state: _State, opt: RigidOptions, history: list[Iteration]
) -> tuple[_State, str]:
    """Minimises t until the state is inside the law: status "inside", "relaxed", "infeasible" or "stalled"."""
    no_load = np.zeros_like(state.z)
    w = fem.weight[state.cones.point]
    state = _centred(state, 1.0 / float((w * state.cones.size / state.g).sum()))
    for _ in range(opt.max_iterations):
        gap = _gap(state, fem.weight)
        residual = float(np.abs(_unbalanced(fem, no_load, state)).sum())
        if state.t < -0.05 or (state.t < 0.0 and gap < 0.3 * -state.t):
            return replace(state, t=0.0, g=_slack(state.cones, state.F, 0.0)), "inside"
        least_t = state.t - gap - residual * float(np.abs(state.z).max(initial=0.0))
        if least_t > 1e-9:
            return state, "infeasible"
        if state.t < 0.5 * opt.relax and gap < 0.1 * opt.relax:
            return replace(state, t=opt.relax, g=_slack(state.cones, state.F, opt.relax)), "relaxed"
        state, step = _advance(state, fem, law, no_load, True, opt)
        history.append(Iteration(1, _average_mu(state, fem.weight), gap, residual, step, len(state.cones), state.t))
        if step == 0.0:
            return state, "stalled"
    return state, "iterations"


def solve_rigid(
    fem: Fem, law: MembraneLaw, load: Array, start: Array, size: float, opt: RigidOptions = RigidOptions()
) -> RigidResult:
    """The rigid curtain under the generalised forces `load` (n,), N, from unknowns `start` (n,).

    `size` (mm) is the extent of the curtain: with the total load it makes the energy scale that `opt.gap` and the
    residual refer to. The start may violate the law; the first phase then looks for a state that does not.
    """
    history: list[Iteration] = []
    state = _first_state(fem, law, start)
    verdict = "inside"
    if state.t > 0.0:
        state, verdict = _phase_one(fem, law, state, opt, history)
    if verdict in ("infeasible", "iterations", "stalled"):
        return _result(fem, load, state, verdict, np.nan, np.nan, history)
    total = float(np.abs(load).sum()) or float(fem.weight.sum()) * NO_LOAD
    scale = total * size
    state = _centred(state, scale / float((fem.weight[state.cones.point]).sum()))
    status, since_best, best = "iterations", 0, (np.inf, state)
    for _ in range(opt.max_iterations):
        gap = _gap(state, fem.weight) / scale
        residual = float(np.abs(_unbalanced(fem, load, state)).sum()) / total
        error = gap + residual
        if error < best[0]:
            best, since_best = (error, state), 0
        since_best += 1
        if gap < opt.gap and residual < opt.residual:
            status = "converged"
            break
        state, step = _advance(state, fem, law, load, False, opt)
        history.append(Iteration(2, _average_mu(state, fem.weight), gap, residual, step, len(state.cones), state.t))
        if step == 0.0 or since_best > PATIENCE:
            status = "stalled"
            break
    error, state = best
    if status == "stalled" and error < ROUNDING:
        status = "converged"
    return _result(fem, load, state, status, scale, total, history)


def _result(
    fem: Fem, load: Array, state: _State, status: str, scale: float, total: float, history: list[Iteration]
) -> RigidResult:
    """The record, with the dual value lowered by what the unbalanced forces could do over the curtain's size."""
    gap, unbalanced = _gap(state, fem.weight), float(np.abs(_unbalanced(fem, load, state)).sum())
    primal = -float(load @ state.z)
    solved = np.isfinite(scale)
    dual = primal - gap - REACH * unbalanced * scale / total if solved else np.nan
    return RigidResult(
        status=status,
        message=STATUSES[status].format(t=0.5 * state.t, n=len(history), gap=gap / scale if solved else gap),
        z=state.z,
        lam=state.lam,
        cones=state.cones,
        S=state.cones.stress(state.lam),
        primal=primal,
        dual=dual,
        residual=unbalanced / total if solved else np.nan,
        iterations=len(history),
        relaxed=state.t if solved else 0.0,
        history=tuple(history),
    )
