"""The interior-point iteration for curtains with a given list of cones, with a bound at every step.

    minimise  -l.z   subject to   (c_i, F_q(z) L_i) in the second-order cone,   S_i = L_i L_i^T,  c_i^2 = 2 h_i + tr S_i

Dual vectors y_i = (y0, y1) per reference area make the stress P_q = -sum_i y1_i L_i, in equilibrium when l = B^T (w P).
Mehrotra's predictor and corrector in Nesterov and Todd's scaling (see `soc`), from any start: primal and dual residual
need not vanish before the end, as in CVXOPT's conelp. `macro_fem.solvers.rigid` takes the steps. Every Newton matrix
has the pattern of the finite elements,

    H = B^T w sum_i L_i [W_i^-2]_11 L_i B.

For equilibrated P the dual value -sum w (y0 c + y1:(F_0 L)), F_0 the part of F that supports impose, bounds -l.z from
below for every admissible z. When it exceeds what -l.z can be, there is no admissible z: the certificate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from macro_fem.solvers import soc
from macro_fem.solvers.cones import Cones
from macro_fem.solvers.soc import Vectors
from rve.common.types import Array


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


LIFT = 0.1
"""Least relative distance from the boundary of a cone at which an iteration begins."""
BOUNDARY = 0.98
"""Part of the way to the boundary of the cones that a step may go."""


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
    """The problem with its cones: load (n,), roots L (nc, 3) of the half-spaces, radii c, the scale in N mm.

    w (nc,) is the reference area of the point of each cone. Arrays over the cones keep every component contiguous.
    """

    fem: Fem
    load: Array
    cones: Cones
    L: Array
    c: Array
    w: Array
    scale: float
    total: float

    def tails(self, F: Array) -> Array:
        """F L of every cone, flat (nc, 2 d)."""
        return gathered_root(F, self.cones.point, self.L)

    def stress(self, tail: Array) -> Array:
        """sum of y1 L over the cones of each point (nq, d, 2); minus the stress P."""
        parts = times_root(tail.reshape(len(tail), -1, 2), self.L)
        summed = np.stack([self.cones.sum(column) for column in parts.T]).T
        return summed.reshape(len(summed), -1, 2)

    def slack(self, z: Array) -> Vectors:
        """(c, F L): the primal cone vectors that z asks for."""
        return Vectors(self.c, self.tails(self.fem.gradient(z)))


def make_program(fem: Fem, load: Array, cones: Cones, scale: float, total: float) -> Program:
    """The program of a list of half-spaces."""
    c, w = np.sqrt(2.0 * cones.size), fem.weight[cones.point]
    return Program(fem, load, cones, symmetric_roots(cones.S), c, w, scale, total)


def times_root(F: Array, L: Array) -> Array:
    """F L of each cone, flat (n, 2 d), for F (n, d, 2) and symmetric L (n, 3) as triples."""
    out = np.empty((2 * F.shape[1], len(F)))
    for a in range(F.shape[1]):
        _root_row(F[:, a, 0], F[:, a, 1], L, out[2 * a : 2 * a + 2])
    return out.T


def gathered_root(F: Array, point: np.ndarray, L: Array) -> Array:
    """`times_root` of F[point] and L (nc, 3) for F (nq, d, 2)."""
    out = np.empty((2 * F.shape[1], len(point)))
    for a in range(F.shape[1]):
        _root_row(F[:, a, 0].take(point), F[:, a, 1].take(point), L, out[2 * a : 2 * a + 2])
    return out.T


def _root_row(x: Array, y: Array, L: Array, out: Array) -> None:
    """(x, y) L of each cone into out (2, n)."""
    np.multiply(x, L[:, 0], out=out[0])
    out[0] += y * L[:, 1]
    np.multiply(x, L[:, 1], out=out[1])
    out[1] += y * L[:, 2]


def symmetric_roots(S: Array) -> Array:
    """Symmetric L with L L = S as triples (n, 3), for positive semidefinite triples S (n, 3), also of rank one."""
    det = np.sqrt(np.maximum(S[:, 0] * S[:, 2] - S[:, 1] ** 2, 0.0))
    size = np.sqrt(S[:, 0] + S[:, 2] + 2.0 * det)
    return np.stack([(S[:, 0] + det) / size, S[:, 1] / size, (S[:, 2] + det) / size]).T


@dataclass(frozen=True)
class Measure:
    """How far a state is from the answer, relative to the energy scale, and the residuals themselves.

    `gap`: sum of w s.y; `unbalanced`: forces, times one size; `outside`: largest cone residual relative to c;
    `dual`: dual value over the scale; `error`: the sum of the first three. tail (nc, 2 d) is F L, r_x (n,) and r_s the
    residuals of equilibrium and of the cones.
    """

    gap: float
    unbalanced: float
    outside: float
    dual: float
    tail: Array
    r_x: Array
    r_s: Vectors

    @property
    def error(self) -> float:
        return self.gap + self.unbalanced + self.outside


def measure(program: Program, state: State) -> Measure:
    """The residuals and the gap of a state, recomputed from z and y."""
    fem, w = program.fem, program.w
    sum_of_parts = program.stress(state.y.tail)
    r_x = program.load + fem.force(sum_of_parts)
    tail = program.tails(fem.gradient(state.z))
    r_s = Vectors(state.s.head - program.c, state.s.tail - tail)
    held = fem.gradient(np.zeros_like(state.z))
    dual = -float((w * state.y.head * program.c).sum())
    dual -= float((fem.weight * (sum_of_parts * held).sum(axis=(1, 2))).sum())
    return Measure(
        gap=float((w * state.s.dot(state.y)).sum()) / program.scale,
        unbalanced=float(np.abs(r_x).sum()) / program.total,
        outside=float(np.sqrt((r_s.dot(r_s) / program.c**2).max())),
        dual=dual / program.scale,
        tail=tail,
        r_x=r_x,
        r_s=r_s,
    )


@dataclass(frozen=True)
class Step:
    """Changes of the unknowns, the cone vectors and the tails F L; lengths at most 1; the share of residuals kept."""

    dz: Array
    ds: Vectors
    dy: Vectors
    d_tail: Array
    keep: float
    primal: float = 0.0
    dual: float = 0.0


class _Newton:
    """Newton's matrix in the scaling of a state, factorised; directions for different aims share it."""

    def __init__(self, program: Program, state: State, now: Measure) -> None:
        self.program, self.now = program, now
        self.W = soc.scaling(state.s, state.y)
        self.point = self.W.apply(state.y)
        cones = program.cones
        d = state.s.tail.shape[1] // 2
        inv2 = 1.0 / self.W.eta**2
        w1L = times_root(self.W.w.tail.reshape(-1, d, 2), program.L)
        A = cones.sum_of_squares(w1L, 2.0 * inv2).reshape(-1, d, 2, d, 2)
        S = cones.stress(inv2)
        for a in range(d):
            A[:, a, 0, a, 0] += S[:, 0]
            A[:, a, 0, a, 1] += S[:, 1]
            A[:, a, 1, a, 0] += S[:, 1]
            A[:, a, 1, a, 1] += S[:, 2]
        self.solve = program.fem.factorize(A)

    def direction(self, aim: Vectors, keep: float) -> Step:
        """The step to point o (W dy + W^-1 ds) = aim with residuals reduced to the part `keep`."""
        program, W, now = self.program, self.W, self.now
        r_s = now.r_s * (1.0 - keep)
        aimed = W.undo(soc.divide(self.point, aim))
        dual_part = aimed.tail + W.undo_twice_tail(r_s)
        rhs = (1.0 - keep) * now.r_x + program.fem.force(program.stress(dual_part))
        dz = self.solve(rhs)
        d_tail = program.tails(program.fem.gradient_change(dz))
        ds = Vectors(-r_s.head, d_tail - r_s.tail)
        return Step(dz, ds, aimed - W.undo(W.undo(ds)), d_tail, keep)


def step_lengths(state: State, step: Step, boundary: float) -> tuple[float, float]:
    """How far s and y may go, at most 1."""
    primal = min(1.0, boundary * soc.largest_step(state.s, step.ds))
    dual = min(1.0, boundary * soc.largest_step(state.y, step.dy))
    return primal, dual


def mean_product(program: Program, state: State) -> float:
    """mu: the mean of s.y over the cones, N/mm."""
    return float((program.w * state.s.dot(state.y)).sum() / program.w.sum())


def search(program: Program, state: State, now: Measure, least_gap: float, *, corrector: bool = True) -> Step | None:
    """A predictor-corrector step and its lengths; None if rounding leaves none.

    The aim is no closer than `least_gap` (relative to the scale): with gaps far below the residuals Newton's matrix
    would lose its digits to them, and steps get stuck. Without the second-order term of the `corrector` it is a plain
    Newton step towards the same aim.
    """
    try:
        newton = _Newton(program, state, now)
    except ArithmeticError:  # no pivot order works: double precision is exhausted
        return None
    unit = Vectors(np.ones(len(program.c)), np.zeros_like(state.s.tail))
    mu = mean_product(program, state)
    square = soc.product(newton.point, newton.point)
    affine = newton.direction(square * -1.0, 0.0)
    reach = min(step_lengths(state, affine, 1.0))
    sigma = (1.0 - reach) ** 3
    second = soc.product(newton.W.undo(affine.ds), newton.W.apply(affine.dy)) * float(corrector)
    least = min(mu, least_gap * program.scale / float(program.w.sum()))
    step = newton.direction(unit * max(sigma * mu, least) - square - second, sigma)
    if not (np.all(np.isfinite(step.dz)) and np.all(np.isfinite(step.dy.head))):
        return None
    primal, dual = step_lengths(state, step, BOUNDARY)
    return replace(step, primal=primal, dual=dual)


def moved(state: State, step: Step) -> State:
    """The state after a step."""
    return State(state.z + step.primal * step.dz, state.s + step.ds * step.primal, state.y + step.dy * step.dual)


def is_inside(state: State) -> bool:
    """Whether all cone vectors are inside their cones: rounding may put one on the boundary."""
    return bool(state.s.margin().min() > 0.0 and state.y.margin().min() > 0.0)


def first_state(program: Program, z: Array, gap: float) -> State:
    """A state at z on the central path of relative gap `gap`; cone vectors of violated cones are lifted inside."""
    s = program.slack(z).lifted(LIFT * program.c)
    return State(z, s, soc.inverse(s, gap * program.scale / float(program.w.sum())))


def is_certificate(program: Program, state: State, now: Measure) -> bool:
    """Whether y proves that no admissible z exists: its dual value is large against load and unbalanced forces."""
    if now.outside == 0.0 or now.dual <= 0.0:
        return False
    stress_only = float(np.abs(now.r_x - program.load).sum()) / program.total
    return stress_only < 1e-6 * now.dual
