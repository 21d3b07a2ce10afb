"""One cone program for rigid and elastic curtains, and the interior-point step that solves it.

The elastic law is ideal locking with a compliance D behind it: Psi(E) = min over e of e:D^-1:e / 2 with E - e inside.
With D = R R^T W (W, `rve.common.tensor.WEIGHT`, weights the shear component by two) and e = R eps the curtain is

    minimise  -l.z + sum w eps.eps / 2   subject to   S_i:(E(F_q(z)) - R eps_q) <= h_i   at every point q,

D = 0 is the rigid curtain: R has no columns and there is no eps. Rings that give by direction (`homogenize.GivingLaw`)
have one more component tau of eps, S_i:(E - R e) - g_i tau <= h_i. With S = L L^T, c^2 = 2 h + tr S and
n = (R^T W S . e + g tau)/c every half-space is a second-order cone,

    (c + n, n, F L):   (c + n)^2 - n^2 - |F L|^2 = 2 (h + c n - S:E),      (c, F L) for D = 0.

The dual vectors y per reference area make the stress P_q = -sum_i y_FL L_i, in equilibrium when l = B^T (w P), and the
strains eps_q = sum_i (y_0 + y_n) N_i, N = (R^T W S, g) / c. Mehrotra's predictor and corrector in Nesterov and Todd's
scaling (see `soc`), from any start: residuals need not vanish before the end, as in CVXOPT's conelp. The strains are
eliminated point by point, so that every Newton matrix has the pattern of the finite elements.

The dual value -sum w (y_0 c + y_FL:(F_0 L)) - sum w |eps(y)|^2 / 2, F_0 the part of F that supports impose, bounds the
potential from below for every admissible z. A rigid curtain whose dual value exceeds every potential has no admissible
state: the certificate. F is d x 2, d = 2 or 3.

Half-spaces on the nodes themselves, s = A z + b0 >= 0 (`walls`), are further cones of dimension one with dual variables
u and areas v: they add A^T (v u) to the balance of forces, -sum v u b0 to the dual value and A^T (v u / s) A, blocks on
the diagonal, to Newton's matrix.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from macro_fem.solvers import soc
from macro_fem.solvers.cones import Cones, green_strain, root_row, symmetric_roots, times_root
from macro_fem.solvers.options import STEPS, StepOptions
from macro_fem.solvers.soc import Vectors
from macro_fem.solvers.strains import Strains
from macro_fem.solvers.walls import NO_ROWS, Rows, longest
from rve.common.tensor import WEIGHT
from rve.common.types import Array

REACH = 4.0
"""No point of an admissible state is farther than this many sizes from its place in another one: twice the stretch."""


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

    def factorize(self, tangent: Array, nodal: Array | None = None) -> Callable[[Array], Array]:
        """A solver of (B^T (w A) B + M) x = b for tangents A (nq, d, 2, d, 2) in N/mm and nodal blocks M."""
        ...


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
    """Free unknowns z, strains eps (nq, k), primal cone vectors s (lengths), dual ones y (N/mm); slacks t (m,) and dual
    variables u (m,), N/mm, of half-spaces on nodes."""

    z: Array
    eps: Array
    s: Vectors
    y: Vectors
    t: Array
    u: Array


@dataclass(frozen=True)
class Program:
    """The problem with its cones: load (n,), roots L (nc, 3) of the half-spaces, radii c, the scale in N mm.

    R (3, k) is the root of the compliance, N (nc, k) what the strains eps do to each cone, both without columns for a
    rigid curtain; N has one more for tau where the cones have `extra`. w (nc,) is the reference area of the point of
    each cone; `rows` are half-spaces on nodes. Arrays over the cones keep every component contiguous.
    """

    fem: Fem
    load: Array
    cones: Cones
    R: Array
    scale: float
    total: float
    rows: Rows = NO_ROWS

    @cached_property
    def L(self) -> Array:
        """Symmetric roots of the half-spaces as triples (nc, 3)."""
        return symmetric_roots(self.cones.S)

    @cached_property
    def c(self) -> Array:
        """Radii (nc,)."""
        return np.sqrt(2.0 * self.cones.size)

    @cached_property
    def N(self) -> Array:
        """R^T W S / c (nc, k), and g / c beside them where rings give by direction."""
        N = (self.cones.S * WEIGHT) @ self.R
        N = N if self.cones.extra is None else np.column_stack([N, self.cones.extra])
        return np.asarray(N / self.c[:, None])

    @cached_property
    def w(self) -> Array:
        """Reference area of the point of each cone (nc,), mm2."""
        return self.fem.weight[self.cones.point]

    @cached_property
    def area(self) -> float:
        """Sum of the areas of all cones, mm2."""
        return float(self.w.sum()) + float(self.rows.v.sum())

    @property
    def lead(self) -> int:
        """Components of a cone's tail before F L: 1 for n, 0 in a rigid curtain."""
        return min(1, self.R.shape[1])

    def map(self, F: Array, eps: Array, which: np.ndarray | slice = slice(None)) -> Vectors:
        """(n, n, F L) of every cone, or of some: what the unknowns F (nq, d, 2), eps (nq, k) do to it."""
        point, L, lead = self.cones.point[which], self.L[which], self.lead
        out = np.empty((lead + 2 * F.shape[1], len(point)))
        for a in range(F.shape[1]):
            root_row(F[:, a, 0].take(point), F[:, a, 1].take(point), L, out[lead + 2 * a : lead + 2 * a + 2])
        if not lead:
            return Vectors(np.zeros(len(point)), out.T)
        out[0] = soc.row_dot(self.N[which], eps[point])
        return Vectors(out[0], out.T)

    def slack(self, z: Array, eps: Array, which: np.ndarray | slice = slice(None)) -> Vectors:
        """(c + n, n, F L): the primal cone vectors that the unknowns ask for."""
        v = self.map(self.fem.gradient(z), eps, which)
        return Vectors(self.c[which] + v.head, v.tail)

    def pull(self, y: Vectors) -> tuple[Array, Array]:
        """The transpose of `map`, summed over the cones of each point: minus the stress P (nq, d, 2), eps (nq, k)."""
        parts = times_root(y.tail[:, self.lead :].reshape(len(y.tail), -1, 2), self.L)
        summed = np.stack([self.cones.sum(column) for column in parts.T]).T
        strain = [self.cones.sum(self.carried(y) * column) for column in self.N.T]
        return summed.reshape(len(summed), -1, 2), np.array(strain).reshape(len(strain), len(summed)).T

    def carried(self, y: Vectors) -> Array:
        """y_0 + y_n (nc,): c times the multiplier lam of each half-space, whose stress is lam S."""
        return y.head + y.tail[:, 0] if self.lead else y.head

    def locked(self, F: Array, eps: Array) -> Array:
        """E - R eps (nq, 3): the strain that the half-spaces limit; tau beside it where there is one, (nq, 4)."""
        k = self.R.shape[1]
        E = green_strain(F) - eps[:, :k] @ self.R.T
        return E if self.cones.extra is None else np.column_stack([E, eps[:, k]])


def make_program(
    fem: Fem, load: Array, cones: Cones, scale: float, total: float, compliance: Array, rows: Rows = NO_ROWS
) -> Program:
    """The program of a list of half-spaces; compliance (3, 3) in tensor components, zero for a rigid curtain."""
    values, vectors = np.linalg.eigh(compliance / WEIGHT)
    is_soft = values > 1e-15 * max(values.max(), 1e-300)
    return Program(fem, load, cones, vectors[:, is_soft] * np.sqrt(values[is_soft]), scale, total, rows)


@dataclass(frozen=True)
class Measure:
    """How far a state is from the answer, relative to the energy scale, and the residuals themselves.

    `gap`: sum of w s.y; `unbalanced`: forces, times one size; `outside`: largest cone residual relative to c; `strain`:
    misfit of the strains; `error`: the largest of these. `lower`: a bound of the potential from below over all states
    within REACH sizes of this one, `dual` the same without what unbalanced forces could do. `wanted` are the cone
    vectors that the unknowns ask for; r_x (n,), r_e (nq, k), r_s, r_t (m,): residuals of equilibrium, strains, cones,
    half-spaces on nodes.
    """

    gap: float
    unbalanced: float
    outside: float
    strain: float
    dual: float
    lower: float
    wanted: Vectors
    r_x: Array
    r_e: Array
    r_s: Vectors
    r_t: Array

    @property
    def error(self) -> float:
        return max(self.gap, self.unbalanced, self.outside, self.strain)


def measure(program: Program, state: State) -> Measure:
    """The residuals and the gap of a state, recomputed from its unknowns and y."""
    fem, w, scale, rows = program.fem, program.w, program.scale, program.rows
    sum_of_parts, strain = program.pull(state.y)
    r_x = program.load + fem.force(sum_of_parts) + rows.force(state.u)
    r_e = strain - state.eps
    wanted = program.slack(state.z, state.eps)
    r_s, r_t = state.s - wanted, state.t - rows.slack(state.z)
    zero = np.zeros_like(state.z)
    held = fem.gradient(zero)
    dual = -float((w * state.y.head * program.c).sum())
    dual -= float((fem.weight * (sum_of_parts * held).sum(axis=(1, 2))).sum())
    dual -= 0.5 * float((fem.weight * soc.row_dot(strain, strain)).sum())
    dual -= float((rows.v * state.u * rows.slack(zero)).sum())
    unbalanced = float(np.abs(r_x).sum()) / program.total
    return Measure(
        gap=_products(program, state) / scale,
        unbalanced=unbalanced,
        outside=max(float(np.sqrt((r_s.dot(r_s) / program.c**2).max())), float(np.abs(r_t).max(initial=0.0))),
        strain=float(np.sqrt((fem.weight * soc.row_dot(r_e, r_e)).sum() / scale)),
        dual=dual / scale,
        lower=(dual - float((r_x * state.z).sum())) / scale - REACH * unbalanced,
        wanted=wanted,
        r_x=r_x,
        r_e=r_e,
        r_s=r_s,
        r_t=r_t,
    )


@dataclass(frozen=True)
class Step:
    """Changes of the unknowns, the cone vectors and what is asked of them; lengths at most 1; the share of residuals
    kept."""

    dz: Array
    deps: Array
    ds: Vectors
    dy: Vectors
    d_wanted: Vectors
    dt: Array
    du: Array
    keep: float
    primal: float = 0.0
    dual: float = 0.0


class _Newton:
    """Newton's matrix in the scaling of a state, factorised; directions for different aims share it."""

    def __init__(self, program: Program, state: State, now: Measure) -> None:
        self.program, self.state, self.now = program, state, now
        self.W = soc.scaling(state.s, state.y)
        self.point = self.W.apply(state.y)
        cones, w, k = program.cones, self.W.w, program.N.shape[1]
        d = (w.tail.shape[1] - program.lead) // 2
        inv2 = 1.0 / self.W.eta**2
        # W^-2 seen through `map` is eta^-2 (2 q q^T + |F L|^2): the squares of the two n cancel.
        q = times_root(w.tail[:, program.lead :].reshape(-1, d, 2), program.L)
        if k:
            q = np.column_stack([(w.tail[:, 0] - w.head)[:, None] * program.N, q])
        H = cones.sum_of_squares(q, 2.0 * inv2)
        S = cones.stress(inv2)
        for a in range(k, k + 2 * d, 2):
            H[:, a, a] += S[:, 0]
            H[:, a, a + 1] += S[:, 1]
            H[:, a + 1, a] += S[:, 1]
            H[:, a + 1, a + 1] += S[:, 2]
        self.strains = Strains(H, k) if k else None
        A = H if self.strains is None else self.strains.reduced
        self.solve = program.fem.factorize(A.reshape(-1, d, 2, d, 2), program.rows.blocks(state.u / state.t))

    def direction(self, aim: Vectors, row_aim: Array, keep: float) -> tuple[Step, Vectors, Vectors]:
        """The step to point o (W dy + W^-1 ds) = aim and u dt + t du = row_aim with residuals reduced to the part
        `keep`, W^-1 ds and W dy."""
        program, W, now, rows = self.program, self.W, self.now, self.program.rows
        t, u, r_t = self.state.t, self.state.u, now.r_t * (1.0 - keep)
        r_s = now.r_s * (1.0 - keep)
        both = soc.divide(self.point, aim)
        aimed = W.undo(both)
        force, strain = program.pull(aimed + W.undo_twice(r_s))
        half = strain + (1.0 - keep) * now.r_e
        if self.strains is not None:
            half = self.strains.half(half)
            force = force - self.strains.onto_gradient(half, force.shape)
        dz = self.solve((1.0 - keep) * now.r_x + program.fem.force(force) + rows.force((row_aim + u * r_t) / t))
        dF = program.fem.gradient_change(dz)
        deps = half if self.strains is None else self.strains.whole(half, dF)
        d_wanted = program.map(dF, deps)
        ds = d_wanted - r_s
        scaled = W.undo(ds)
        dt = rows.change(dz) - r_t
        du = (row_aim - u * dt) / t
        return Step(dz, deps, ds, aimed - W.undo(scaled), d_wanted, dt, du, keep), scaled, both - scaled


def step_lengths(program: Program, state: State, step: Step, boundary: float) -> tuple[float, float]:
    """How far s and y may go, at most 1; equally far where strains tie them together."""
    primal = min(1.0, boundary * soc.largest_step(state.s, step.ds), boundary * longest(state.t, step.dt))
    dual = min(1.0, boundary * soc.largest_step(state.y, step.dy), boundary * longest(state.u, step.du))
    return (min(primal, dual),) * 2 if program.lead else (primal, dual)


def mean_product(program: Program, state: State) -> float:
    """mu: the mean of s.y over the cones, N/mm."""
    return _products(program, state) / program.area


def _products(program: Program, state: State) -> float:
    """Sum of all s.y times their areas, N mm."""
    return float((program.w * state.s.dot(state.y)).sum()) + float((program.rows.v * state.t * state.u).sum())


def search(
    program: Program,
    state: State,
    now: Measure,
    least_gap: float,
    *,
    corrector: bool = True,
    boundary: float = StepOptions.boundary,
) -> Step | None:
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
    row_square = state.t * state.u
    affine, scaled_ds, scaled_dy = newton.direction(square * -1.0, -row_square, 0.0)
    reach = min(step_lengths(program, state, affine, 1.0))
    sigma = (1.0 - reach) ** 3
    second = soc.product(scaled_ds, scaled_dy) * float(corrector)
    aim = max(sigma * mu, min(mu, least_gap * program.scale / program.area))
    row_aim = aim - row_square - affine.dt * affine.du * float(corrector)
    step, _, _ = newton.direction(unit * aim - square - second, row_aim, sigma)
    if not (np.all(np.isfinite(step.dz)) and np.all(np.isfinite(step.dy.head))):
        return None
    primal, dual = step_lengths(program, state, step, boundary)
    return replace(step, primal=primal, dual=dual)


def moved(state: State, step: Step) -> State:
    """The state after a step."""
    return State(
        state.z + step.primal * step.dz,
        state.eps + step.primal * step.deps,
        state.s + step.ds * step.primal,
        state.y + step.dy * step.dual,
        state.t + step.primal * step.dt,
        state.u + step.dual * step.du,
    )


def is_inside(state: State) -> bool:
    """Whether all cone vectors are inside their cones: rounding may put one on the boundary."""
    is_in_rows = min(state.t.min(initial=np.inf), state.u.min(initial=np.inf)) > 0.0
    return bool(state.s.margin().min() > 0.0 and state.y.margin().min() > 0.0 and is_in_rows)


def first_state(program: Program, z: Array, options: StepOptions = STEPS) -> State:
    """A state at z on the central path of the first gap; cone vectors of violated cones are lifted inside."""
    eps = np.zeros((len(program.fem.weight), program.N.shape[1]))
    s = program.slack(z, eps).lifted(options.lift * program.c)
    t = np.maximum(program.rows.slack(z), options.lift)
    mu = options.first_gap * program.scale / program.area
    return State(z, eps, s, soc.inverse(s, mu), t, mu / t)


def is_certificate(program: Program, now: Measure) -> bool:
    """Whether y proves that no admissible z exists: its dual value is large against load and unbalanced forces."""
    if program.lead or now.outside == 0.0 or now.dual <= 0.0:
        return False
    stress_only = float(np.abs(now.r_x - program.load).sum()) / program.total
    return stress_only < 1e-6 * now.dual
