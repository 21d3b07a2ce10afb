"""The interior-point iteration for curtains with a given list of cones, with a bound at every step.

    minimise  -l.z   subject to   (c_i, F_q(z) L_i) in the second-order cone,   S_i = L_i L_i^T,  c_i^2 = 2 h_i + tr S_i

Dual vectors y_i = (y0, y1) per reference area make the stress P_q = -sum_i y1_i L_i, in equilibrium when l = B^T (w P).
Mehrotra's predictor and corrector in Nesterov and Todd's scaling (see `soc`), from any start: primal and dual residual
need not vanish before the end, as in CVXOPT's conelp. Every Newton matrix has the pattern of the finite elements,

    H = B^T w sum_i L_i [W_i^-2]_11 L_i B.

For equilibrated P the dual value -sum w (y0 c + y1:(F_0 L)), F_0 the part of F that supports impose, bounds -l.z from
below for every admissible z. When it exceeds what -l.z can be, there is no admissible z: the certificate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from homogenize.law import Array
from macro_fem import soc
from macro_fem.cones import Cones
from macro_fem.soc import Vectors


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


SETTLED = 1e-2
"""Only below this error must every few steps make progress: far from the answer gap and residuals take turns."""
LIFT = 0.1
"""Least relative distance from the boundary of a cone at which an iteration begins."""


@dataclass(frozen=True)
class InteriorOptions:
    """When to stop and how boldly to step.

    `gap` and `residual` are relative to the energy scale of the problem, total load times size. `boundary` is the
    fraction of the way to the boundary of the cones that a step may go.
    """

    gap: float = 1e-9
    residual: float = 1e-9
    max_iterations: int = 100
    boundary: float = 0.98
    patience: int = 15


@dataclass(frozen=True)
class Iteration:
    """One line of the history: relative gap, residuals of equilibrium and of the cones, step lengths, cones."""

    gap: float
    unbalanced: float
    outside: float
    step_primal: float
    step_dual: float
    cones: int


@dataclass(frozen=True)
class State:
    """Free unknowns z, primal cone vectors s (lengths), dual ones y (N/mm)."""

    z: Array
    s: Vectors
    y: Vectors


@dataclass(frozen=True)
class Program:
    """The problem with its cones: load (n,), roots L (nc, 3) of the half-spaces, radii c, the scale in N mm."""

    fem: Fem
    load: Array
    cones: Cones
    L: Array
    c: Array
    scale: float
    total: float

    @property
    def w(self) -> Array:
        """Reference area of the point of each cone (nc,)."""
        return self.fem.weight[self.cones.point]

    def tails(self, F: Array) -> Array:
        """F L of every cone, flat (nc, 2 d)."""
        return times_root(F[self.cones.point], self.L)

    def stress(self, tail: Array) -> Array:
        """sum of y1 L over the cones of each point (nq, d, 2); minus the stress P."""
        parts = self.cones.sum(times_root(tail.reshape(len(tail), -1, 2), self.L))
        return parts.reshape(len(parts), -1, 2)

    def slack(self, z: Array) -> Vectors:
        """(c, F L): the primal cone vectors that z asks for."""
        return Vectors(self.c, self.tails(self.fem.gradient(z)))


def make_program(fem: Fem, load: Array, cones: Cones, scale: float, total: float) -> Program:
    """The program of a list of half-spaces."""
    return Program(fem, load, cones, symmetric_roots(cones.S), np.sqrt(2.0 * cones.size), scale, total)


def times_root(F: Array, L: Array) -> Array:
    """F L of each cone, flat (n, 2 d), for F (n, d, 2) and symmetric L (n, 3) as triples."""
    out = np.empty(F.shape)
    for a in range(F.shape[1]):
        np.multiply(F[:, a, 0], L[:, 0], out=out[:, a, 0])
        out[:, a, 0] += F[:, a, 1] * L[:, 1]
        np.multiply(F[:, a, 0], L[:, 1], out=out[:, a, 1])
        out[:, a, 1] += F[:, a, 1] * L[:, 2]
    return out.reshape(len(F), -1)


def _sum_of_squares(cones: Cones, v: Array, weight: Array) -> Array:
    """Sum over the cones of each point of weight v v^T, (nq, m, m) for v (nc, m); the lower half is computed once."""
    m = v.shape[1]
    out = np.empty((len(cones.first), m, m))
    for i in range(m):
        scaled = weight * v[:, i]
        for j in range(i + 1):
            out[:, i, j] = out[:, j, i] = cones.sum(scaled * v[:, j])
    return out


def symmetric_roots(S: Array) -> Array:
    """Symmetric L with L L = S as triples (n, 3), for positive semidefinite triples S (n, 3), also of rank one."""
    det = np.sqrt(np.maximum(S[:, 0] * S[:, 2] - S[:, 1] ** 2, 0.0))
    size = np.sqrt(S[:, 0] + S[:, 2] + 2.0 * det)
    return np.stack([S[:, 0] + det, S[:, 1], S[:, 2] + det], axis=-1) / size[:, None]


@dataclass(frozen=True)
class Measure:
    """How far a state is from the answer, relative to the energy scale.

    `gap`: sum of w s.y; `unbalanced`: forces, times one size; `outside`: largest cone residual relative to c;
    `dual`: dual value over the scale; `error`: their sum.
    """

    gap: float
    unbalanced: float
    outside: float
    dual: float

    @property
    def error(self) -> float:
        return self.gap + self.unbalanced + self.outside


def measure(program: Program, state: State) -> Measure:
    """The residuals and the gap of a state, recomputed from z and y."""
    fem, w = program.fem, program.w
    r_x = program.load + fem.force(program.stress(state.y.tail))
    wanted = program.slack(state.z)
    outside = state.s - wanted
    F0 = program.tails(fem.gradient(np.zeros_like(state.z)))
    dual = -float((w * (state.y.head * program.c + soc.row_dot(state.y.tail, F0))).sum())
    return Measure(
        gap=float((w * state.s.dot(state.y)).sum()) / program.scale,
        unbalanced=float(np.abs(r_x).sum()) / program.total,
        outside=float(np.sqrt((outside.dot(outside) / program.c**2).max())),
        dual=dual / program.scale,
    )


@dataclass(frozen=True)
class _Direction:
    dz: Array
    ds: Vectors
    dy: Vectors


class _Newton:
    """Newton's matrix in the scaling of a state, factorised; directions for different aims share it."""

    def __init__(self, program: Program, state: State) -> None:
        self.program, self.state = program, state
        self.W = soc.scaling(state.s, state.y)
        self.point = self.W.apply(state.y)
        cones = program.cones
        d = state.s.tail.shape[1] // 2
        inv2 = 1.0 / self.W.eta**2
        w1L = times_root(self.W.w.tail.reshape(-1, d, 2), program.L)
        A = _sum_of_squares(cones, w1L, 2.0 * inv2).reshape(-1, d, 2, d, 2)
        S = cones.stress(inv2)
        for a in range(d):
            A[:, a, 0, a, 0] += S[:, 0]
            A[:, a, 0, a, 1] += S[:, 1]
            A[:, a, 1, a, 0] += S[:, 1]
            A[:, a, 1, a, 1] += S[:, 2]
        self.solve = program.fem.factorize(A)
        self.r_x = program.load + program.fem.force(program.stress(state.y.tail))
        self.r_s = state.s - program.slack(state.z)

    def direction(self, aim: Vectors, keep: float) -> _Direction:
        """The step to point o (W dy + W^-1 ds) = aim with residuals reduced to the part `keep`."""
        program, W = self.program, self.W
        r_s = self.r_s * (1.0 - keep)
        aimed = W.undo(soc.divide(self.point, aim))
        dual_part = aimed.tail + W.undo_twice_tail(r_s)
        rhs = (1.0 - keep) * self.r_x + program.fem.force(program.stress(dual_part))
        dz = self.solve(rhs)
        dF = program.tails(program.fem.gradient_change(dz))
        ds = Vectors(-r_s.head, dF - r_s.tail)
        return _Direction(dz, ds, aimed - W.undo(W.undo(ds)))


def step_lengths(state: State, step: _Direction, boundary: float) -> tuple[float, float]:
    """How far s and y may go, at most 1."""
    primal = min(1.0, boundary * soc.largest_step(state.s, step.ds))
    dual = min(1.0, boundary * soc.largest_step(state.y, step.dy))
    return primal, dual


def advance(program: Program, state: State, options: InteriorOptions) -> tuple[State, float, float]:
    """One predictor-corrector step and its primal and dual lengths; lengths 0 if rounding leaves no step."""
    try:
        newton = _Newton(program, state)
    except ArithmeticError:  # no pivot order works: double precision is exhausted
        return state, 0.0, 0.0
    w, unit = program.w, Vectors(np.ones(len(program.c)), np.zeros_like(state.s.tail))
    mu = float((w * state.s.dot(state.y)).sum() / w.sum())
    square = soc.product(newton.point, newton.point)
    affine = newton.direction(square * -1.0, 0.0)
    reach = min(step_lengths(state, affine, 1.0))
    sigma = (1.0 - reach) ** 3
    second = soc.product(newton.W.undo(affine.ds), newton.W.apply(affine.dy))
    aim = unit * (sigma * mu) - square - second
    step = newton.direction(aim, sigma)
    if not (np.all(np.isfinite(step.dz)) and np.all(np.isfinite(step.dy.head))):
        return state, 0.0, 0.0
    primal, dual = step_lengths(state, step, options.boundary)
    s, y = state.s + step.ds * primal, state.y + step.dy * dual
    if not (s.margin().min() > 0.0 and y.margin().min() > 0.0):
        return state, 0.0, 0.0
    return State(state.z + primal * step.dz, s, y), primal, dual


def first_state(program: Program, z: Array, gap: float) -> State:
    """A state at z on the central path of relative gap `gap`; cone vectors of violated cones are lifted inside."""
    s = lifted(program.slack(z), LIFT * program.c)
    return State(z, s, soc.inverse(s, gap * program.scale / float(program.w.sum())))


def lifted(s: Vectors, least: Array) -> Vectors:
    """s with heads raised where they are less than `least` (n,) inside their cones."""
    return Vectors(np.maximum(s.head, np.sqrt(soc.row_dot(s.tail, s.tail)) + least), s.tail)


def follow(program: Program, state: State, options: InteriorOptions) -> tuple[State, Measure, str, list[Iteration]]:
    """Steps until gap and residuals are small: "converged", "infeasible", "iterations" or "stalled"; the best state."""
    history: list[Iteration] = []
    best, best_state, waited = measure(program, state), state, 0
    now = best
    for _ in range(options.max_iterations):
        if now.gap < options.gap and now.unbalanced < options.residual and now.outside < options.residual:
            return state, now, "converged", history
        if is_certificate(program, state, now):
            return state, now, "infeasible", history
        state, primal, dual = advance(program, state, options)
        history.append(Iteration(now.gap, now.unbalanced, now.outside, primal, dual, len(program.c)))
        now = measure(program, state)
        waited += now.error < SETTLED
        if now.error < best.error:
            best, best_state, waited = now, state, 0
        if max(primal, dual) == 0.0 or waited > options.patience:
            return best_state, best, "stalled", history
    return best_state, best, "iterations", history


def is_certificate(program: Program, state: State, now: Measure) -> bool:
    """Whether y proves that no admissible z exists: its dual value is large against load and unbalanced forces."""
    if now.outside == 0.0 or now.dual <= 0.0:
        return False
    stress_only = float(np.abs(program.fem.force(program.stress(state.y.tail))).sum()) / program.total
    return stress_only < 1e-6 * now.dual
