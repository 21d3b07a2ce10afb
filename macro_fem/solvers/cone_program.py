"""One cone program for rigid and elastic curtains; `cone_step` has the interior-point step that solves it.

The elastic law is ideal locking with a compliance D behind it: Psi(E) = min over e of e:D^-1:e / 2 with E - e inside.
With D = R R^T W (W, `rve.common.tensor.WEIGHT`, weights the shear component by two) and e = R eps the curtain is

    minimise  -l.z + sum w eps.eps / 2   subject to   S_i:(E(F_q(z)) - R eps_q) <= h_i   at every point q,

D = 0 is the rigid curtain: R has no columns and there is no eps. Rings that give by direction (`GivingLaw`)
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

Half-spaces on places of the curtain, s = A z + b0 >= 0 (`walls`), are further cones of dimension one with dual
variables u and areas v: they add A^T (v u) to the balance of forces, -sum v u b0 to the dual value and A^T (v u / s) A
to Newton's matrix.

Rings that flow (`PlasticLaw`) are rigid ones whose cones are widened by tau >= 0 at each point, at the cost w tau in
place of w eps.eps / 2:

    (c + N tau, F L),   sum of y_0 N + v = 1,   tau v = mu.

Cones of elastic strings are (c + N e, F L) at the cost w e^2 / 2, so that e = sum of y_0 N; eps is (tau, e).

Their limit is the least sum of w tau over l.z with c = 0 and supports at rest at 0: the multiplier of l.z = scale is
the factor f on the load, `ConeState.factor`, and Newton's matrix has one more row and column.

A step of motion adds (x - x_hat).W (x - x_hat) / 2 over the nodes to what is minimised (`Inertia`).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from homogenize import MembraneLaw
from macro_fem.fem.supported import SupportedFem
from macro_fem.solvers import soc
from macro_fem.solvers.cones import Cones, green_strain, symmetric_roots, times_root
from macro_fem.solvers.path import Flow, Inertia
from macro_fem.solvers.soc import Vectors
from macro_fem.solvers.walls import WallRows
from rve.common import Array
from rve.common.tensor import IDENTITY, WEIGHT

REACH = 4.0
"""No point of an admissible state is farther than this many sizes from its place in another one."""
LIFT = 0.1
"""Least relative distance from a cone's boundary at the start. Larger: larger residuals; smaller: short first steps."""


@dataclass(frozen=True)
class ConeState:
    """Free unknowns z, strains eps (nq, k), primal cone vectors s (lengths), dual ones y (N/mm); slacks t (m,) and dual
    variables u (m,), N/mm, of half-spaces on nodes. Of rings that flow eps begins with tau, N/mm, and v (nq, 1) is its
    dual variable, else (nq, 0); factor: on the load."""

    z: Array
    eps: Array
    s: Vectors
    y: Vectors
    t: Array
    u: Array
    v: Array
    factor: float = 1.0

    @property
    def tau(self) -> Array:
        """That of rings which flow (nq, 1), else (nq, 0)."""
        return self.eps[:, : self.v.shape[1]]

    @property
    def is_inside(self) -> bool:
        """Whether all cone vectors are inside their cones: rounding may put one on the boundary."""
        flows = min(self.tau.min(initial=np.inf), self.v.min(initial=np.inf))
        is_in_rows = min(self.t.min(initial=np.inf), self.u.min(initial=np.inf), flows) > 0.0
        return bool(self.s.margin().min() > 0.0 and self.y.margin().min() > 0.0 and is_in_rows)


@dataclass(frozen=True)
class Program:
    """The problem with its cones, and the law that knows more of them: load (n,), N; R (3, k), the root of the
    compliance, without columns for a rigid curtain; scale, N mm, and total, N, of residuals; half-spaces `rows` on
    points. Arrays over the cones keep every component contiguous.
    """

    fem: SupportedFem
    law: MembraneLaw
    load: Array
    cones: Cones
    R: Array
    scale: float
    total: float
    rows: WallRows
    inertia: Inertia | None = None
    flow: Flow | None = None

    @property
    def is_limit(self) -> bool:
        """Whether the largest factor on the load is asked for."""
        return self.flow is not None and self.flow.is_limit

    @cached_property
    def offset(self) -> Array:
        """What cones are wide without tau (nc,): c, or 0 where a limit is asked for."""
        return self.c * (not self.is_limit)

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
        """What the strains eps do to each cone: R^T W S / c (nc, k), and g / c beside them where rings give by
        direction; of rings that flow N (nc, 1), and that of elastic strings beside it, (nc, 2)."""
        if self.flow is not None:
            assert self.cones.extra is not None
            return np.asarray(self.cones.extra / self.flow.strength[self.cones.point, None])
        N = (self.cones.S * WEIGHT) @ self.R
        N = N if self.cones.extra is None else np.column_stack([N, self.cones.extra])
        return np.asarray(N / self.c[:, None])

    @cached_property
    def w(self) -> Array:
        """Reference area of the point of each cone (nc,), mm2."""
        return np.asarray(self.fem.disc.weight[self.cones.point])

    @cached_property
    def area(self) -> float:
        """Sum of the areas of all cones, mm2."""
        flowing = 0.0 if self.flow is None else float(self.fem.disc.weight.sum())
        return float(self.w.sum()) + float(self.rows.v.sum()) + flowing

    def added(self, weight: Array) -> sparse.csc_matrix | None:
        """What half-spaces on points, of these weights (m,), and inertia add to Newton's matrix (n, n), if any."""
        parts = [self.rows.added(weight)] if len(weight) else []
        parts += [] if self.inertia is None else [self.inertia.matrix]
        return sum(parts) if parts else None

    @property
    def lead(self) -> int:
        """Components of a cone's tail before F L: 1 for n, 0 in a rigid curtain."""
        return int(min(1, self.R.shape[1]))

    def map(self, F: Array, eps: Array, which: np.ndarray | slice = slice(None)) -> Vectors:
        """(n, n, F L) of every cone, or of some: what the unknowns F (nq, d, 2), eps (nq, k) do to it."""
        point = self.cones.point[which]
        head, FL = soc.row_dot(self.N[which], eps[point]), times_root(F, self.L[which], point)
        return Vectors(head, np.concatenate([head[None], FL.T]).T if self.lead else FL)

    def slack(self, z: Array, eps: Array, which: np.ndarray | slice = slice(None)) -> Vectors:
        """(c + n, n, F L): the primal cone vectors that the unknowns ask for."""
        v = self.map(self.fem.gradient(z), eps, which)
        return Vectors(self.offset[which] + v.head, v.tail)

    def pull(self, y: Vectors) -> tuple[Array, Array]:
        """The transpose of `map`, summed over the cones of each point: minus the stress P (nq, d, 2), eps (nq, k)."""
        parts = times_root(y.tail[:, self.lead :].reshape(len(y.tail), -1, 2), self.L)
        summed = np.stack([self.cones.sum(column) for column in parts.T]).T
        strain = [self.cones.sum(self.carried(y) * column) for column in self.N.T]
        return summed.reshape(len(summed), -1, 2), np.array(strain).reshape(len(strain), len(summed)).T

    def carried(self, y: Vectors) -> Array:
        """y_0 + y_n (nc,): c times the multiplier lam of each half-space, whose stress is lam S."""
        return np.asarray(y.head + y.tail[:, : self.lead].sum(axis=1))

    def locked(self, F: Array, eps: Array) -> Array:
        """E - R eps (nq, 3): the strain that the half-spaces limit; tau beside it where there is one, (nq, 4); see
        `PlasticLaw` for rings that flow."""
        if self.flow is not None:
            wider = (eps / self.flow.strength[:, None]).T
            E = green_strain(F) + 0.5 * IDENTITY * self.is_limit
            return np.column_stack([E, *(part for x in wider for part in (x * (not self.is_limit), 0.5 * x**2))])
        k = self.R.shape[1]
        E = green_strain(F) - eps[:, :k] @ self.R.T
        return E if self.cones.extra is None else np.column_stack([E, eps[:, k]])


def compliance_root(compliance: Array) -> Array:
    """R (3, k) with R R^T W = compliance (3, 3) in tensor components; without columns for a rigid curtain."""
    values, vectors = np.linalg.eigh(compliance / WEIGHT)
    is_soft = values > 1e-15 * max(values.max(), 1e-300)
    return np.asarray(vectors[:, is_soft] * np.sqrt(values[is_soft]))


@dataclass(frozen=True)
class Measure:
    """How far a state is from the answer, relative to the energy scale, and the residuals themselves.

    gap: sum of w s.y; unbalanced: forces, times one size; outside: largest cone residual relative to c; strain: misfit
    of the strains; error: the largest of these. lower: a bound of the potential from below over all states within REACH
    sizes of this one; dual: the same without what unbalanced forces could do. wanted: the cone vectors that the
    unknowns ask for. Residuals of equilibrium r_x (n,), strains r_e (nq, k), cones r_s, half-spaces on points r_t (m,),
    of l.z = scale where a limit is asked for r_f; r_y (n,): the forces of the dual variables alone. drawn, 1 or more:
    what accuracy is relative to, over the scale: of rings that flow the sum of stress times deformation, since supports
    may draw them harder than loads; of their limit the factor.
    """

    gap: float
    unbalanced: float
    outside: float
    strain: float
    dual: float
    lower: float
    wanted: Vectors
    r_x: Array
    r_y: Array
    r_e: Array
    r_s: Vectors
    r_t: Array
    r_f: float = 0.0
    drawn: float = 1.0

    @property
    def error(self) -> float:
        return max(self.gap, self.unbalanced, self.outside, self.strain)


def measure(program: Program, state: ConeState) -> Measure:
    """The residuals and the gap of a state, recomputed from its unknowns and y."""
    fem, w, scale, rows = program.fem, program.w, program.scale, program.rows
    sum_of_parts, strain = program.pull(state.y)
    r_y = fem.force(sum_of_parts) + rows.force(state.u)
    r_x, energy, below = state.factor * program.load + r_y, 0.0, None
    if program.inertia is not None:
        r_x = r_x + program.inertia.force(state.z)
        energy, below = program.inertia.energy(state.z), program.inertia.deficit(r_x)
    flows = state.v.shape[1]
    r_e = strain - np.column_stack([1.0 - state.v, state.eps[:, flows:]])
    r_f = scale - float(program.load @ state.z) if program.is_limit else 0.0
    wanted = program.slack(state.z, state.eps)
    r_s, r_t = state.s - wanted, state.t - rows.slack(state.z)
    zero = np.zeros_like(state.z)
    dual = -float((w * state.y.head * program.offset).sum()) + state.factor * scale * program.is_limit
    dual -= float((fem.disc.weight * (sum_of_parts * fem.gradient(zero)).sum(axis=(1, 2))).sum())
    dual -= 0.5 * float((fem.disc.weight * soc.row_dot(strain[:, flows:], strain[:, flows:])).sum())
    dual -= float((rows.v * state.u * rows.slack(zero)).sum())
    unbalanced = float(np.abs(r_x).sum()) / program.total
    lower = (dual - float(((state.factor * program.load + r_y) * state.z).sum()) + energy) / scale
    strained = float(np.sqrt((fem.disc.weight * soc.row_dot(r_e[:, flows:], r_e[:, flows:])).sum() / scale))
    drawn = 1.0
    if program.flow is not None:
        drawn = max(drawn, state.factor if program.is_limit else float((w * program.c) @ state.y.head) / scale)
        off = float(np.abs(r_e[:, :flows]).max()) + abs(r_f) / scale
        strained, lower = strained + off, lower - REACH * off
    return Measure(
        gap=mean_product(program, state) * program.area / scale,
        unbalanced=unbalanced,
        outside=max(float(np.sqrt((r_s.dot(r_s) / program.c**2).max())), float(np.abs(r_t).max(initial=0.0))),
        strain=strained,
        dual=dual / scale,
        lower=lower - (REACH * unbalanced if below is None else below / scale),
        wanted=wanted,
        r_x=r_x,
        r_y=r_y,
        r_e=r_e,
        r_s=r_s,
        r_t=r_t,
        r_f=r_f,
        drawn=drawn,
    )


def mean_product(program: Program, state: ConeState) -> float:
    """mu: the mean of s.y over the cones, N/mm."""
    products = float((program.w * state.s.dot(state.y)).sum()) + float((program.rows.v * state.t * state.u).sum())
    flowing = float((program.fem.disc.weight * soc.row_dot(state.tau, state.v)).sum())
    return (products + flowing) / program.area


def find_first_state(program: Program, z: Array, first_gap: float) -> ConeState:
    """A state at z on the central path of the first gap, or of stresses that make rings flow where these are larger;
    cone vectors of violated cones are lifted inside."""
    mu = first_gap * program.scale / program.area
    if program.flow is not None and not program.is_limit:  # as supports may draw them: else twice the steps
        mu = max(mu, len(program.cones.first) / float((program.N[:, 0] / program.c).sum()))
    v = np.ones((len(program.fem.disc.weight), 1 if program.flow is not None else 0))
    eps = np.column_stack([mu * v, np.zeros((len(v), program.N.shape[1] - v.shape[1]))])
    s = program.slack(z, eps).lifted(LIFT * program.c)
    t = np.maximum(program.rows.slack(z), LIFT)
    return ConeState(z, eps, s, soc.inverse(s, mu), t, mu / t, v, 0.0 if program.is_limit else 1.0)
