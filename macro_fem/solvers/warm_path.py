"""A step of motion from where the last one ended: an interior-point method in slacks, with the inertia's W.

    minimise  phi = (x - x_hat).W (x - x_hat) / 2 - l.z + sum w eps.eps / 2
    subject to   g_i = h_i + a_i.eps_q - S_i:E(F_q(z)) >= 0   and   b = A z + b0 >= 0

is the program of `macro_fem.solvers.cone_program`, whose half-spaces are here no cones but concave functions: slacks s
and multipliers lam are numbers, so that a step of Newton costs half of one in cones. It solves

    s = g,   t = b,   s lam = mu,   t u = mu,
    W (x_hat - x) + l - B^T (w F sum lam S) + A^T (v u) = 0,   eps = sum lam a

with the matrix W + B^T w (sum lam S + sum (lam / s) F S (F S)^T) B + A^T (v u / t) A, strains eliminated point by
point. It begins at the multipliers of the last step and gives up where it gets no nearer: then
`macro_fem.solvers.central_path` takes its place. With forces r that do not balance and strains r_e that do not fit

    phi - sum w lam g - sum v u b - r.(T^T W T)^-1 r / 2 - sum w r_e.r_e / 2

is nowhere above the least potential, as the Lagrangian is convex, with W in z and w in eps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from homogenize import MembraneLaw
from macro_fem.fem.supported import SupportedFem
from macro_fem.solvers import soc
from macro_fem.solvers.central_path import make_program, solve_path
from macro_fem.solvers.cone_program import LIFT, Program
from macro_fem.solvers.cone_step import STEP
from macro_fem.solvers.cones import add_stress, all_cuts, times_root, with_cuts
from macro_fem.solvers.path import PathOptions, PathResult, Terms
from macro_fem.solvers.status import ROUNDING, Evidence
from macro_fem.solvers.walls import longest
from rve.common import Array
from rve.common.tensor import WEIGHT, trace


@dataclass(frozen=True)
class WarmOptions:
    """Numbers of the path in slacks."""

    cold_gap: float = 1e-2
    least_gap: float = 1e-4
    of_start: float = 0.1
    """First relative gap without multipliers of a step before, and least one with them, where it is this part of that
    of the start, up to the former. Smaller: steps end at half-spaces that the start violates."""
    far: float = 1e-2
    """Half-spaces with a slack above this and no multiplier wait until the law names them again; slacks of violated
    ones are not lifted further. Larger: more of them in every step; smaller: more that join late."""
    idle: float = 1e-6
    """A multiplier below this part of its point's counts as none."""
    most_steps: int = 40
    """Steps after which cones are tried: few take more than 30 of them and end."""
    patience: int = 3
    """Steps that bring forces no nearer to balance, the rest being solved, after which rounding ends the path."""


WARM = WarmOptions()


@dataclass(frozen=True)
class _State:
    """Unknowns z (n,), strains eps (nq, k), slacks s and multipliers lam (nc,) of half-spaces of the law, t and u (m,)
    of those on points; or their changes."""

    z: Array
    eps: Array
    s: Array
    lam: Array
    t: Array
    u: Array

    def moved(self, change: _State, primal: float, dual: float) -> _State:
        lengths = {"lam": dual, "u": dual}
        return _State(*(one + lengths.get(name, primal) * vars(change)[name] for name, one in vars(self).items()))

    def longest(self, change: _State, part: float) -> tuple[float, float]:
        """Lengths, at most 1, of this part of the way to where a slack, and a multiplier, vanishes."""
        slacks = min(longest(self.s, change.s), longest(self.t, change.t))
        return min(1.0, part * slacks), min(1.0, part * min(longest(self.lam, change.lam), longest(self.u, change.u)))

    def products(self, program: Program) -> float:
        """sum w s lam + sum v t u, N mm."""
        return float(program.w @ (self.s * self.lam)) + float(program.rows.v @ (self.t * self.u))


def solve_step_path(
    fem: SupportedFem, law: MembraneLaw, load: Array, start: Array, size: float, options: PathOptions, terms: Terms
) -> PathResult:
    """What `solve_path` returns of a step of motion, by slacks, or by cones where these do not end."""
    program, lam = make_program(fem, law, load, size, options, terms)
    pushes = options.pushes
    u = None if pushes is None else (pushes[program.rows.is_row] * size / program.rows.v)
    return _solve_slacks(program, start, lam, u, options) or solve_path(fem, law, load, start, size, options, terms)


def _solve_slacks(
    program: Program, z: Array, lam: Array | None, u: Array | None, options: PathOptions
) -> PathResult | None:
    """The answer of a program from unknowns z (n,) and multipliers lam (nc,) and u (m,); None where it is not found."""
    program, state = _first_state(program, z, lam, u)
    best, waited = np.inf, 0
    for steps in range(WARM.most_steps + 1):
        F = program.fem.gradient(state.z)
        program, state, g, violation = _join(program, state, program.locked(F, state.eps))
        newton = _SlackNewton(program, state, F, g)
        evidence = replace(newton.evidence, violation=max(violation, -float(newton.b.min(initial=np.inf))))
        products = state.products(program) / program.scale
        is_close = max(products, abs(evidence.gap)) < options.gap and evidence.violation < options.violation
        waited = waited + 1 if is_close and evidence.unbalanced >= best else 0
        best = min(best, evidence.unbalanced) if is_close else np.inf
        is_closed = is_close and evidence.unbalanced < options.gap
        if is_closed or (waited >= WARM.patience and best < ROUNDING):
            return newton.result("closed" if is_closed else "stalled", evidence, options, steps)
        if not evidence.is_finite or steps == WARM.most_steps:
            break
        try:
            state = newton.advance(options.least_gap * options.gap * program.scale / program.area)
        except (ArithmeticError, np.linalg.LinAlgError):
            break
    return None


def _slack(program: Program, E: Array) -> Array:
    """g (nc,) at locked strains E (nq, 3) or, with tau, (nq, 4)."""
    cones = program.cones
    g = cones.h - ((cones.S * WEIGHT) * E[cones.point, :3]).sum(axis=1)
    return np.asarray(g if cones.extra is None else g + cones.extra * E[cones.point, 3])


def _first_state(program: Program, z: Array, lam: Array | None, u: Array | None) -> tuple[Program, _State]:
    """The program without half-spaces that are far away, and a state at z: products of a first gap, which is that of
    the multipliers there."""
    cones, rows, is_cold = program.cones, program.rows, lam is None
    lam = np.zeros(len(cones)) if lam is None else lam
    u = np.zeros(rows.A.shape[0]) if u is None else u
    F, eps = program.fem.gradient(z), cones.sum(lam[:, None] * program.c[:, None] * program.N)
    E, b = program.locked(F, eps), rows.slack(z)
    g = _slack(program, E)
    gap = WARM.cold_gap
    if not is_cold:
        start = _State(z, eps, np.abs(g), lam, np.abs(b), u)
        off = _SlackNewton(program, start, F, g).off
        gap = min(gap, max(WARM.least_gap, WARM.of_start * (start.products(program) / program.scale + off)))
    mu = gap * program.scale / float(program.fem.disc.weight.sum())
    is_near = (lam > WARM.idle * cones.sum(lam)[cones.point]) | (g < WARM.far)
    which = np.flatnonzero(is_near | (g <= np.minimum.reduceat(g, cones.first)[cones.point]))
    program = replace(program, cones=cones.pick(which, cones.point[which], len(cones.first)))
    lam, g = lam[which], g[which]
    s = np.maximum(g, np.clip(mu / np.maximum(lam, 1e-300), 1e-9, WARM.far))
    t = np.maximum(b, np.minimum(mu / np.maximum(u, 1e-300), LIFT))
    return program, _State(z, eps, s, np.maximum(lam, mu / s), t, np.maximum(u, mu / t))


def _join(program: Program, state: _State, E: Array) -> tuple[Program, _State, Array, float]:
    """The program and state with the half-spaces of the law that are violated or nearer than others at locked strains
    E, slacks g (nc,), raising those of the state that are less, and the largest relative violation of the law."""
    cones, cut, g = program.cones, all_cuts(program.law, E), _slack(program, E)
    state = replace(state, s=np.maximum(state.s, g))
    nearest, found = np.minimum.reduceat(g, cones.first), -cut.violation
    is_new = found < nearest - STEP.rounded * (1.0 + np.abs(nearest))
    is_new &= (found < 0.0) | ((found < STEP.near * nearest) & (found < WARM.far))
    new, violation = np.flatnonzero(is_new), float((cut.violation / (cut.h + 0.5 * trace(cut.S))).max())
    if not len(new):
        return program, state, g, violation
    mu = state.products(program) / program.area
    load = np.maximum(STEP.share * cones.sum(state.lam)[new], 1e-300)
    s = np.maximum(found[new], np.clip(mu / load, STEP.rounded, WARM.far))
    wider, order = with_cuts(cones, new, cut.take(new))
    both = ((state.s, s), (state.lam, mu / s), (g, found[new]))
    s, lam, g = (np.concatenate(pair)[order] for pair in both)
    return replace(program, cones=wider), replace(state, s=s, lam=lam), g, violation


class _SlackNewton:
    """Residuals of a state at F (nq, d, 2) with slacks g (nc,), and the step from there."""

    def __init__(self, program: Program, state: _State, F: Array, g: Array) -> None:
        self.program, self.state = program, state
        cones, rows, fem, inertia = program.cones, program.rows, program.fem, program.inertia
        assert inertia is not None
        self.a = program.c[:, None] * program.N
        self.b = rows.slack(state.z)
        self.S = cones.stress(state.lam)
        self.P = times_root(F, self.S).reshape(F.shape)
        self.q = np.column_stack([-self.a, times_root(F, cones.S, cones.point)])
        self.r = program.load + inertia.force(state.z) - fem.force(self.P) + rows.force(state.u)
        self.r_e = cones.sum(state.lam[:, None] * self.a) - state.eps
        self.r_s, self.r_t = g - state.s, self.b - state.t
        self.over = float(program.w @ (state.lam * g)) + float(rows.v @ (state.u * self.b))

    @property
    def off(self) -> float:
        """What unbalanced forces and strains that do not fit can gain, over the scale."""
        program = self.program
        assert program.inertia is not None
        strained = 0.5 * float(program.fem.disc.weight @ soc.row_dot(self.r_e, self.r_e))
        return (program.inertia.deficit(self.r) + strained) / program.scale

    @property
    def evidence(self) -> Evidence:
        """Gap and unbalanced forces; without the violation."""
        unbalanced = float(np.abs(self.r).sum()) / self.program.total
        return Evidence(self.over / self.program.scale + self.off, unbalanced, np.inf)

    def advance(self, least: float) -> _State:
        """The state after a predictor and corrector to products of `least` N/mm or more."""
        program, state, cones = self.program, self.state, self.program.cones
        k, d = self.a.shape[1], program.fem.d
        H = np.ascontiguousarray(cones.sum_of_squares(self.q, state.lam / state.s))
        add_stress(H[:, k:, k:], self.S)
        H[:, range(k), range(k)] += 1.0
        self.own, self.couple = H[:, :k, :k], H[:, :k, k:]
        A = H[:, k:, k:] - self.couple.swapaxes(1, 2) @ np.linalg.solve(self.own, self.couple) if k else H
        self.solve = program.fem.factorize(A.reshape(-1, d, 2, d, 2), program.added(state.u / state.t))
        aim, row_aim = -state.s * state.lam, -state.t * state.u
        affine = self.direction(aim, row_aim)
        mu = state.products(program) / program.area
        wanted = max((1.0 - min(state.longest(affine, 1.0))) ** 3 * mu, min(mu, least))
        step = self.direction(wanted + aim - affine.s * affine.lam, wanted + row_aim - affine.t * affine.u)
        primal, dual = state.longest(step, STEP.boundary)
        return state.moved(step, *(2 * [min(primal, dual)] if k else (primal, dual)))

    def direction(self, aim: Array, row_aim: Array) -> _State:
        """The step to s dlam + lam ds = aim and t du + u dt = row_aim without residuals."""
        program, state, k = self.program, self.state, self.a.shape[1]
        fem, rows, cones = program.fem, program.rows, program.cones
        beta, row_beta = (aim - state.lam * self.r_s) / state.s, (row_aim - state.u * self.r_t) / state.t
        pulled = np.stack([cones.sum(beta * column) for column in self.q.T], axis=1)
        force = pulled[:, k:]
        if k:
            strain = np.linalg.solve(self.own, (self.r_e - pulled[:, :k])[:, :, None])
            force = force + (self.couple.swapaxes(1, 2) @ strain)[:, :, 0]
        dz = self.solve(self.r - fem.force(force.reshape(self.P.shape)) + rows.force(row_beta))
        change = fem.gradient_change(dz).reshape(len(force), -1)
        deps = state.eps
        if k:
            deps = (strain - np.linalg.solve(self.own, self.couple @ change[:, :, None]))[:, :, 0]
            change = np.column_stack([deps, change])
        ds = self.r_s - soc.row_dot(self.q, change[cones.point])
        dt = rows.A @ dz + self.r_t
        return _State(dz, deps, ds, (aim - state.lam * ds) / state.s, dt, (row_aim - state.u * dt) / state.t)

    def result(self, stop: str, evidence: Evidence, options: PathOptions, steps: int) -> PathResult:
        """The record of the state."""
        program, state, cones = self.program, self.state, self.program.cones
        assert program.inertia is not None
        stored = 0.5 * float(program.fem.disc.weight @ soc.row_dot(state.eps, state.eps))
        primal = stored - float(program.load @ state.z) + program.inertia.energy(state.z)
        tail = times_root(program.fem.gradient(state.z), program.L, cones.point)
        return PathResult(
            stop=stop,
            evidence=evidence,
            asked=options.accuracy,
            z=state.z,
            S=self.S,
            psi=cones.sum(program.c * state.lam * np.sqrt(soc.row_dot(tail, tail))),
            cones=cones,
            lam=state.lam,
            P=self.P,
            primal=primal,
            dual=primal - evidence.gap * program.scale,
            iterations=steps,
            wall_forces=program.rows.reactions(state.u),
        )
