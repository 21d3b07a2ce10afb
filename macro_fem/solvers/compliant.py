"""The interior-point iteration for an elastic curtain with a given list of half-spaces.

The elastic law is ideal locking with a compliance D behind it: Psi(E) = min over e of e:D^-1:e / 2 with E - e inside.
So the elastic curtain is the rigid one with a strain e of its own at every point and one quadratic term,

    minimise  -l.z + sum w e:D^-1:e / 2   subject to   S_i:(E(F_q(z)) - e_q) <= h_i   at every point q,

with no stiff wall on the way. With S = L L^T, c^2 = 2 h + tr S, D = R R^T W (W weights the shear component by two),
e = R eps and n = R^T W S . eps / c a half-space is the second-order cone

    (c + n, n, F L):   (c + n)^2 - n^2 - |F L|^2 = 2 (h + S:e - S:E),

which for D = 0 is the cone (c, F L) of `macro_fem.solvers.cone_program`. Predictor, corrector and scaling are those of
that module; the strains are eliminated point by point, so that every step is one factorisation with the pattern of the
elements.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from macro_fem.solvers import soc
from macro_fem.solvers.cone_program import Fem, Iteration, symmetric_roots, times_root
from macro_fem.solvers.cones import Cones
from macro_fem.solvers.soc import Vectors
from rve.common.types import Array

WEIGHT = np.array([1.0, 2.0, 1.0])
BOUNDARY = 0.98
"""Part of the way to the boundary of the cones that a step may go."""
REACH = 4.0
"""No point of an admissible state is farther than this many sizes from its place in another one."""


@dataclass(frozen=True)
class Program:
    """The problem with its half-spaces: roots L (nc, 3), radii c (nc,), N = R^T W S / c (nc, 3), the scale in N mm."""

    fem: Fem
    load: Array
    cones: Cones
    L: Array
    c: Array
    N: Array
    scale: float
    total: float

    @property
    def w(self) -> Array:
        """Reference area of the point of each cone (nc,)."""
        return self.fem.weight[self.cones.point]

    def map(self, F: Array, eps: Array) -> Vectors:
        """(n, n, F L) of every cone: what the unknowns do to it."""
        point = self.cones.point
        n = soc.row_dot(self.N, eps[point])
        return Vectors(n, np.column_stack([n, times_root(F[point], self.L)]))

    def slack(self, z: Array, eps: Array) -> Vectors:
        """The primal cone vectors that the unknowns ask for."""
        v = self.map(self.fem.gradient(z), eps)
        return Vectors(self.c + v.head, v.tail)

    def pull(self, y: Vectors) -> tuple[Array, Array]:
        """The transpose of `map`: sums over the cones of each point, for F (nq, d, 2) and for eps (nq, 3)."""
        force = times_root(y.tail[:, 1:].reshape(len(y.tail), -1, 2), self.L)
        strain = (y.head + y.tail[:, 0])[:, None] * self.N
        return self.cones.sum(force).reshape(len(self.cones.first), -1, 2), self.cones.sum(strain)

    def stress(self, y: Vectors) -> Array:
        """S = sum of (y_0 + y_1) S_i / c at every point (nq, 3)."""
        return self.cones.stress((y.head + y.tail[:, 0]) / self.c)


def make_program(fem: Fem, load: Array, cones: Cones, compliance: Array, scale: float, total: float) -> Program:
    """The program of a list of half-spaces for a compliance (3, 3) in tensor components, which may be singular."""
    values, vectors = np.linalg.eigh(compliance / WEIGHT)
    R = vectors * np.sqrt(np.maximum(values, 0.0))
    c = np.sqrt(2.0 * cones.size)
    return Program(fem, load, cones, symmetric_roots(cones.S), c, (cones.S * WEIGHT) @ R / c[:, None], scale, total)


@dataclass(frozen=True)
class State:
    """Free unknowns z, elastic strains eps (nq, 3), primal cone vectors s, dual ones y."""

    z: Array
    eps: Array
    s: Vectors
    y: Vectors


@dataclass(frozen=True)
class Measure:
    """How far a state is from the answer.

    Residuals of equilibrium (n,), of the strains (nq, 3) and of the cones; and relative to the energy scale the gap
    sum w s.y, the unbalanced forces times one size, the largest cone residual relative to c, and the strains' misfit.
    """

    r_x: Array
    r_e: Array
    r_s: Vectors
    gap: float
    unbalanced: float
    outside: float
    strain: float

    @property
    def error(self) -> float:
        """The largest of the four."""
        return max(self.gap, self.unbalanced, self.outside, self.strain)


def measure(program: Program, state: State) -> Measure:
    """The residuals and the gap of a state, recomputed from its unknowns."""
    force, strain = program.pull(state.y)
    r_x = program.load + program.fem.force(force)
    r_e = strain - state.eps
    r_s = state.s - program.slack(state.z, state.eps)
    return Measure(
        r_x,
        r_e,
        r_s,
        gap=float((program.w * state.s.dot(state.y)).sum()) / program.scale,
        unbalanced=float(np.abs(r_x).sum()) / program.total,
        outside=float(np.sqrt((r_s.dot(r_s) / program.c**2).max())),
        strain=float(np.sqrt((program.fem.weight * soc.row_dot(r_e, r_e)).sum() / program.scale)),
    )


def least_potential(program: Program, state: State, now: Measure) -> float:
    """A lower bound of -l.z + sum w e:D^-1:e / 2 over all states within REACH sizes of this one, N mm: the dual value.

    Forces that do not balance count with what they can do over that distance.
    """
    F0 = program.fem.gradient(np.zeros_like(state.z))
    fixed = program.map(F0, np.zeros_like(state.eps))
    locked = state.y.head * program.c + soc.row_dot(state.y.tail, fixed.tail)
    strain = program.pull(state.y)[1]
    dual = -float((program.w * locked).sum()) - 0.5 * float(program.fem.weight @ soc.row_dot(strain, strain))
    return dual - float(now.r_x @ state.z) - REACH * now.unbalanced * program.scale


class _Newton:
    """Newton's matrix in the scaling of a state, factorised; directions for different aims share it."""

    def __init__(self, program: Program, state: State, now: Measure) -> None:
        self.program, self.now = program, now
        self.W = soc.scaling(state.s, state.y)
        self.point = self.W.apply(state.y)
        cones = program.cones
        d = (state.s.tail.shape[1] - 1) // 2
        inv2 = 1.0 / self.W.eta**2
        w = self.W.w
        w1L = times_root(w.tail[:, 1:].reshape(-1, d, 2), program.L)
        # W^-2 seen through `map`: eta^-2 (2 q q^T + |F L|^2), the squares of the two n cancel.
        q = np.column_stack([(w.head - w.tail[:, 0])[:, None] * program.N, -w1L])
        H = np.ascontiguousarray(cones.sum_of_squares(q, 2.0 * inv2))
        S = cones.stress(inv2)
        for a in range(3, 3 + 2 * d, 2):
            H[:, a, a] += S[:, 0]
            H[:, a, a + 1] += S[:, 1]
            H[:, a + 1, a] += S[:, 1]
            H[:, a + 1, a + 1] += S[:, 2]
        H[:, range(3), range(3)] += 1.0
        # By Cholesky's factor, for an explicit inverse would lose the square of its digits; rows are L^-1 [couple | .].
        self.root: Array = np.asarray(np.linalg.cholesky(H[:, :3, :3]))
        self.couple: Array = np.asarray(np.linalg.solve(self.root, H[:, :3, 3:]))
        A = H[:, 3:, 3:] - self.couple.swapaxes(1, 2) @ self.couple
        self.solve = program.fem.factorize(A.reshape(-1, d, 2, d, 2))

    def direction(self, aim: Vectors, keep: float) -> tuple[Array, Array, Vectors, Vectors]:
        """Changes of z, eps, s, y to point o (W dy + W^-1 ds) = aim with residuals reduced to the part `keep`."""
        program, W, now = self.program, self.W, self.now
        r_s = now.r_s * (1.0 - keep)
        aimed = W.undo(soc.divide(self.point, aim))
        force, strain = program.pull(aimed + W.undo(W.undo(r_s)))
        half = _solved(self.root, strain + (1.0 - keep) * now.r_e)
        back = _times(self.couple.swapaxes(1, 2), half).reshape(force.shape)
        dz = self.solve((1.0 - keep) * now.r_x + program.fem.force(force - back))
        dF = program.fem.gradient_change(dz)
        deps = _solved(self.root.swapaxes(1, 2), half - _times(self.couple, dF.reshape(len(dF), -1)))
        ds = program.map(dF, deps) - r_s
        return dz, deps, ds, aimed - W.undo(W.undo(ds))


def advance(program: Program, state: State, now: Measure) -> tuple[State, float]:
    """One predictor-corrector step and its length; 0 if rounding leaves no step."""
    try:
        newton = _Newton(program, state, now)
    except ArithmeticError:  # no pivot order works: double precision is exhausted
        return state, 0.0
    w, unit = program.w, Vectors(np.ones(len(program.c)), np.zeros_like(state.s.tail))
    mu = float((w * state.s.dot(state.y)).sum() / w.sum())
    square = soc.product(newton.point, newton.point)
    _, _, ds, dy = newton.direction(square * -1.0, 0.0)
    sigma = (1.0 - _length(state, ds, dy, 1.0)) ** 3
    second = soc.product(newton.W.undo(ds), newton.W.apply(dy))
    dz, deps, ds, dy = newton.direction(unit * (sigma * mu) - square - second, sigma)
    if not (np.all(np.isfinite(dz)) and np.all(np.isfinite(dy.head))):
        return state, 0.0
    # The quadratic term ties strains to stresses, so that both take the same length.
    t = _length(state, ds, dy, BOUNDARY)
    s, y = state.s + ds * t, state.y + dy * t
    if not (s.margin().min() > 0.0 and y.margin().min() > 0.0):
        return state, 0.0
    return State(state.z + t * dz, state.eps + t * deps, s, y), t


def follow(program: Program, state: State, tolerance: float, most: int) -> tuple[State, Measure, str, list[Iteration]]:
    """At most `most` steps to an error below `tolerance`: "converged", "iterations" or "stalled"."""
    history: list[Iteration] = []
    now = measure(program, state)
    best, best_state, waited = now, state, 0
    while now.error > tolerance:
        if len(history) >= most:
            return best_state, best, "iterations", history
        state, t = advance(program, state, now)
        history.append(Iteration(now.gap, now.unbalanced, now.outside, t, t, len(program.c)))
        now = measure(program, state)
        waited += 1
        if now.error < best.error:
            best, best_state, waited = now, state, 0
        if t == 0.0 or waited > PATIENCE:
            return best_state, best, "stalled", history
    return state, now, "converged", history


PATIENCE = 15
"""Steps in a row without a new least error after which rounding is said to rule."""


def _length(state: State, ds: Vectors, dy: Vectors, boundary: float) -> float:
    reach = min(soc.largest_step(state.s, ds), soc.largest_step(state.y, dy))
    return min(1.0, boundary * reach)


def _times(A: Array, x: Array) -> Array:
    return np.einsum("nij,nj->ni", A, x)


def _solved(A: Array, b: Array) -> Array:
    return np.asarray(np.linalg.solve(A, b[:, :, None]))[:, :, 0]
