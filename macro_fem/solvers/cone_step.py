"""The interior-point step of the cone program, and the half-spaces of a law that join on its way.

A step is predictor and corrector in Nesterov and Todd's scaling. A law has thousands of half-spaces, a point needs a
handful: a step that would leave the law is shortened, and the half-spaces in its way are taken in where the iteration
still is inside them, with the dual vectors that the central path would have given them.
"""

from dataclasses import dataclass, replace

import numpy as np

from homogenize.laws import Cut
from macro_fem.solvers import soc
from macro_fem.solvers.cone_program import LIFT, ConeState, Measure, Program, mean_product
from macro_fem.solvers.cones import add_stress, all_cuts, times_root, with_cuts
from macro_fem.solvers.soc import Vectors
from macro_fem.solvers.walls import longest
from rve.common import Array
from rve.common.tensor import trace


@dataclass(frozen=True)
class StepOptions:
    """Numbers of a step."""

    boundary: float = 0.98
    """Part of the way to the boundary of the cones that a step may go. Closer to 1 the next steps become short."""
    near: float = 0.9
    """A missing half-space joins when it is nearer than this part of the distance to the nearest known one. Larger
    parts add more, smaller ones late, so that steps are cut short."""
    share: float = 0.3
    """A violated half-space enters with at most this part of the load of its point. Larger shares unbalance more."""
    ahead: float = 3.0
    """Unbalanced forces over the gap of a limit above which they are removed first. Where the gap is far ahead
    of them half-spaces that join keep them up, and steps end at the limit of rounding."""
    far_ahead: float = 1e3
    """The same of other curtains whose rings flow: at 3 steps double, and without it strings on fine meshes stall."""
    rounded: float = 1e-13
    """Least relative distance from the boundary that double precision can tell from none."""
    stray: float = 1e-2
    """A point gets no half-spaces while a cone vector of its own is off by more than this part of its radius."""
    idle: float = 0.03
    """A half-space is idle below this part of its point's load and above this relative distance. Larger values drop
    more, some of which have to join again."""
    flat: float = 0.05
    """A unit-trace S with a determinant below this (1/4 is the roundest) does not hold a point on its own."""


STEP = StepOptions()


@dataclass(frozen=True)
class ConeStep:
    """Changes of a state and of the cone vectors asked for, the share of residuals kept, lengths of at most 1."""

    dz: Array
    deps: Array
    ds: Vectors
    dy: Vectors
    d_wanted: Vectors
    dt: Array
    du: Array
    dv: Array
    keep: float
    df: float = 0.0
    primal: float = 0.0
    dual: float = 0.0


def _solve(A: Array, b: Array) -> Array:
    return np.asarray(np.linalg.solve(A, b[:, :, None]))[:, :, 0]


class _Newton:
    """Newton's matrix in the scaling of a state, factorised, for directions to different aims.

    Strains are eliminated point by point, by Cholesky's factor: an inverse would lose the square of its digits.
    """

    def __init__(self, program: Program, state: ConeState, now: Measure) -> None:
        self.program, self.state, self.now = program, state, now
        self.W = soc.scaling(state.s, state.y)
        self.point = self.W.apply(state.y)
        cones, w, k = program.cones, self.W.w, program.N.shape[1]
        d = (w.tail.shape[1] - program.lead) // 2
        inv2 = 1.0 / self.W.eta**2
        # W^-2 seen through `map` is eta^-2 (2 q q^T + |F L|^2): the squares of the two n cancel.
        q = times_root(w.tail[:, program.lead :].reshape(-1, d, 2), program.L)
        first = w.tail[:, : program.lead].sum(axis=1) - w.head
        q = np.column_stack([first[:, None] * program.N, q]) if k else q
        H = cones.sum_of_squares(q, 2.0 * inv2)
        add_stress(H[:, k:, k:], cones.stress(inv2))
        if k:
            H, rest = np.ascontiguousarray(H), np.ones_like(state.eps)
            rest[:, : state.v.shape[1]] = state.v / state.tau
            H[:, range(k), range(k)] += rest
            if program.flow is not None:  # without n in the tail its square does not cancel
                square = np.stack([cones.sum(inv2 * column**2) for column in program.N.T], axis=1)
                H[:, range(k), range(k)] -= square
        self.root: Array = np.asarray(np.linalg.cholesky(H[:, :k, :k]))
        self.couple: Array = np.asarray(np.linalg.solve(self.root, H[:, :k, k:]))
        A = H[:, k:, k:] - self.couple.swapaxes(1, 2) @ self.couple if k else H
        if program.flow is not None:  # tau = -t dF taken into each cone: the difference would lose twice the digits
            t = [H[:, i, k:] / H[:, i, i, None] for i in range(k)]  # no cone has both tau and e
            A = cones.sum_of_squares(q[:, k:] - sum(q[:, i, None] * t[i][cones.point] for i in range(k)), 2.0 * inv2)
            add_stress(A, cones.stress(inv2))
            for i in range(k):
                A += (rest - square)[:, i, None, None] * t[i][:, :, None] * t[i][:, None, :]
        self.solve = program.fem.factorize(A.reshape(-1, d, 2, d, 2), program.added(state.u / state.t))
        self.by_load = self.solve(program.load) if program.is_limit else None

    def direction(
        self, aim: Vectors, row_aim: Array, flow_aim: Array, keep: float
    ) -> tuple[ConeStep, Vectors, Vectors]:
        """The step to point o (W dy + W^-1 ds) = aim, u dt + t du = row_aim and v deps + eps dv = flow_aim with
        residuals reduced to the part `keep`, W^-1 ds and W dy."""
        program, W, now, rows, state = self.program, self.W, self.now, self.program.rows, self.state
        t, u, r_t, flows = self.state.t, self.state.u, now.r_t * (1.0 - keep), state.v.shape[1]
        r_s = now.r_s * (1.0 - keep)
        both = soc.divide(self.point, aim)
        aimed = W.undo(both)
        force, strain = program.pull(aimed + W.undo_twice(r_s))
        strain += (1.0 - keep) * now.r_e
        strain[:, :flows] += flow_aim / state.tau
        half = _solve(self.root, strain)
        force = force - np.einsum("nij,ni->nj", self.couple, half).reshape(force.shape)
        dz = self.solve((1.0 - keep) * now.r_x + program.fem.force(force) + rows.force((row_aim + u * r_t) / t))
        df = 0.0
        if self.by_load is not None:
            df = ((1.0 - keep) * now.r_f - float(program.load @ dz)) / float(program.load @ self.by_load)
            dz = dz + df * self.by_load
        dF = program.fem.gradient_change(dz)
        moved = np.einsum("nij,nj->ni", self.couple, dF.reshape(len(dF), -1))
        deps = _solve(self.root.swapaxes(1, 2), half - moved)
        d_wanted = program.map(dF, deps)
        ds = d_wanted - r_s
        scaled = W.undo(ds)
        dt = rows.A @ dz - r_t
        du = (row_aim - u * dt) / t
        dv = (flow_aim - state.v * deps[:, :flows]) / state.tau
        return ConeStep(dz, deps, ds, aimed - W.undo(scaled), d_wanted, dt, du, dv, keep, df), scaled, both - scaled


def limited(program: Program, state: ConeState, step: ConeStep, boundary: float) -> ConeStep:
    """The step with lengths, at most 1, of this part of the way to the boundary; equal where strains tie s and y."""
    primal = min(1.0, boundary * soc.largest_step(state.s, step.ds), boundary * longest(state.t, step.dt))
    dual = min(1.0, boundary * soc.largest_step(state.y, step.dy), boundary * longest(state.u, step.du))
    if program.flow is not None:
        primal = min(primal, boundary * longest(state.tau, step.deps[:, : state.v.shape[1]]))
        dual = min(dual, boundary * longest(state.v, step.dv))
    both = min(primal, dual)
    return replace(step, primal=both, dual=both) if program.lead else replace(step, primal=primal, dual=dual)


def find_step(program: Program, state: ConeState, now: Measure, least_gap: float) -> ConeStep | None:
    """A predictor-corrector step and its lengths; None if rounding leaves none.

    The aim is no closer than `least_gap`, relative to the scale: Newton's matrix loses its digits to smaller ones.
    """
    try:
        newton = _Newton(program, state, now)
    except (ArithmeticError, np.linalg.LinAlgError):  # no pivot order works: double precision is exhausted
        return None
    unit = Vectors(np.ones(len(program.c)), np.zeros_like(state.s.tail))
    mu = mean_product(program, state)
    square = soc.product(newton.point, newton.point)
    row_square, flow_square = state.t * state.u, state.tau * state.v
    affine, scaled_ds, scaled_dy = newton.direction(square * -1.0, -row_square, -flow_square, 0.0)
    affine = limited(program, state, affine, 1.0)
    sigma = (1.0 - min(affine.primal, affine.dual)) ** 3
    second = soc.product(scaled_ds, scaled_dy)
    aim = max(sigma * mu, min(mu, least_gap * program.scale / program.area))
    ahead = STEP.ahead if program.is_limit else max(STEP.ahead, STEP.far_ahead / now.drawn)
    if program.flow is not None and max(now.unbalanced, now.strain) > ahead * now.gap:
        aim = mu
    row_aim = aim - row_square - affine.dt * affine.du
    flow_aim = aim - flow_square - affine.deps[:, : state.v.shape[1]] * affine.dv
    step, _, _ = newton.direction(unit * aim - square - second, row_aim, flow_aim, sigma)
    if not (np.all(np.isfinite(step.dz)) and np.all(np.isfinite(step.dy.head))):
        return None
    return limited(program, state, step, STEP.boundary)


def advance(state: ConeState, step: ConeStep) -> ConeState:
    """The state after a step."""
    return ConeState(
        state.z + step.primal * step.dz,
        state.eps + step.primal * step.deps,
        state.s + step.ds * step.primal,
        state.y + step.dy * step.dual,
        state.t + step.primal * step.dt,
        state.u + step.dual * step.du,
        state.v + step.dual * step.dv,
        state.factor + step.dual * step.df,
    )


def find_nearest(program: Program, now: Measure, E: Array, wanted: Vectors) -> tuple[Array, np.ndarray, Cut]:
    """By how much locked strains E (nq, 3) violate the law's nearest half-spaces, (S:E - h) / (h + tr S / 2) (nq,),
    negative inside; the points (k,) where these are missing, and those half-spaces: not among the program's, and
    violated or much nearer than what its cones ask for, `wanted`. None is missing where cones are far from their place.
    """
    cones, cut = program.cones, all_cuts(program.law, E)
    size = trace(cut.S)
    known = 0.5 * (soc.row_dot(wanted.tail, wanted.tail) - wanted.head**2) / trace(cones.S)
    nearest = np.maximum.reduceat(known, cones.first)
    over = cut.violation / size
    is_missing = over > nearest + 1e-12 * (1.0 + np.abs(nearest))
    is_missing &= (over > 0.0) | (over > STEP.near * nearest)
    if now.outside >= STEP.stray:
        stray = np.sqrt(now.r_s.dot(now.r_s)) / program.c
        is_missing &= np.maximum.reduceat(stray, cones.first) < STEP.stray
    return cut.violation / (cut.h + 0.5 * size), np.flatnonzero(is_missing), cut.take(is_missing)


def join(
    program: Program, state: ConeState, step: ConeStep, new: np.ndarray, cut: Cut
) -> tuple[Program, ConeState, ConeStep]:
    """The program with half-spaces `cut` at the points `new` (k,), its state at the same unknowns, and the step with
    new lengths, its changes kept and of the new cones the primal part alone.

    Dual vectors are those of the central path for the distance at hand. Where that is small or negative the cone vector
    is lifted, so that the half-space takes no more than `STEP.share` of what its point carries; all dual vectors of the
    point are then lowered together until it carries what it did, which unbalances forces least.
    """
    cones, order = with_cuts(program.cones, new, cut)
    wider = replace(program, cones=cones)
    fresh = np.flatnonzero(order >= len(program.c))
    mu = mean_product(program, state)
    load = program.cones.sum(program.carried(state.y) * program.c)[new]
    c = wider.c[fresh]
    asked = wider.slack(state.z, state.eps, fresh)
    s = asked.lifted(np.clip(0.5 * mu / (STEP.share * load), STEP.rounded, LIFT) * c)
    y = soc.inverse(s, mu)
    eased = np.ones(len(cones.first))
    eased[new] = 1.0 / (1.0 + program.carried(y) * c / load)
    factor = eased[cones.point]
    dual = _merged(state.y, y, order)
    dual = Vectors(dual.head * factor, dual.tail * factor[:, None])
    state = replace(state, s=_merged(state.s, s, order), y=dual)
    d_wanted = wider.map(wider.fem.gradient_change(step.dz), step.deps, fresh)
    ds = d_wanted - (s - asked) * (1.0 - step.keep)
    more = zip((step.ds, step.dy, step.d_wanted), (ds, ds * 0.0, d_wanted), strict=True)
    ds, dy, d_wanted = (_merged(old, one, order) for old, one in more)
    return wider, state, limited(wider, state, replace(step, ds=ds, dy=dy, d_wanted=d_wanted), STEP.boundary)


def _merged(a: Vectors, b: Vectors, order: np.ndarray) -> Vectors:
    return Vectors(
        np.concatenate([a.head, b.head]).take(order), np.concatenate([a.tail.T, b.tail.T], axis=1).take(order, axis=1).T
    )


def prune(program: Program, state: ConeState) -> tuple[Program, ConeState]:
    """The program without half-spaces that are far away and carry next to nothing: the law tells if they are missed.

    Newton's matrix stays definite: every point keeps one well-conditioned S, or all.
    """
    cones = program.cones
    load = program.carried(state.y) * program.c
    keep = (load > STEP.idle * cones.sum(load)[cones.point]) | (state.s.margin() / program.c < STEP.idle)
    det = cones.S[:, 0] * cones.S[:, 2] - cones.S[:, 1] ** 2
    roundest = np.maximum.reduceat(det, cones.first)[cones.point]
    which = np.flatnonzero(keep | (det >= roundest) | (roundest < STEP.flat))
    few = replace(program, cones=cones.pick(which, cones.point[which], len(cones.first)))
    return few, replace(state, s=_chosen(state.s, which), y=_chosen(state.y, which))


def _chosen(v: Vectors, which: np.ndarray) -> Vectors:
    return Vectors(v.head.take(which), v.tail.T.take(which, axis=1).T)
