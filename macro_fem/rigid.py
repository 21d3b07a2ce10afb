"""The rigid curtain by ideal locking: an interior-point method in rounds, each with the half-spaces found missing.

    minimise  -l.z   over z   subject to   S:E(F_q(z)) <= h(S)   for every tensile S, at every point q

Each round solves the cone program of `macro_fem.interior` for the half-spaces known so far, from a start inside, and
asks the law at every point for the half-space that is violated most. Half-spaces contain the law's set, so the dual
value of any round is a lower bound for the whole law; the primal value becomes an upper bound when the answer is drawn
back, by the least amount, towards a state known to be inside the law. Early rounds are solved loosely.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from homogenize.law import Array, MembraneLaw
from macro_fem import soc
from macro_fem.cones import Cones, first_cones, law_cut, only, with_cuts
from macro_fem.interior import (
    Fem,
    InteriorOptions,
    Iteration,
    Measure,
    Program,
    State,
    first_state,
    follow,
    lifted,
    make_program,
)
from macro_fem.soc import Vectors

REACH = 4.0
"""No point of one admissible state is farther from its place in another than this many sizes: twice the stretch."""
ROUNDING = 1e-6
"""An iteration that rounding stops is accepted below this relative error, which is reported."""
FIRST_GAP = 10.0
"""Gap of the first state in energy scales: the first round on 8,000 cells took 37, 32, 22, 29 steps from 0.1 to 100."""
NO_LOAD = 1e-6
"""N/mm2: sets the energy scale of a curtain without load."""
LOOSE = 0.2
"""A round is solved to this part of the violation that the one before left: more would be thrown away."""
PRUNED_ROUNDS = 4
"""After these first rounds idle half-spaces are dropped; not later, lest rounds go in circles."""
IDLE = 0.03
"""A half-space is idle below this part of a point's load and above this relative distance."""
FLAT = 0.05
"""A unit-trace S with a determinant below this (1/4 is the roundest) does not hold a point on its own."""
KEPT_LIFT = 0.1
"""Part of the central path's dual vector that is added to one that is kept from the round before."""
LEAST_SHARE = 1e-5
"""A new round begins at least this part of the way back to the start: closer to the boundary steps get stuck."""
INSIDE = 1e-3
"""Relative slack from which a state counts as well inside the law, so that rounds may start from it."""


@dataclass(frozen=True)
class RigidOptions:
    """When to stop. `gap` is relative to the energy scale, total load times size, and holds for unbalanced forces too.

    `violation` (relative to h + tr S/2) is what the last round may leave before the answer is drawn back inside.
    `cones` are half-spaces to begin with instead of the law's own few, say those of a curtain on the same triangles.
    """

    gap: float = 1e-9
    violation: float = 1e-8
    max_iterations: int = 400
    max_rounds: int = 40
    cones: Cones | None = None


@dataclass(frozen=True)
class RigidResult:
    """Free unknowns z, stress and multipliers of the rigid curtain, with a status and the numbers that prove it.

    `primal` is -l.z, an upper bound of the least potential of this discretisation, `dual` a lower bound of it, N mm,
    without the constant that supports add. P (nq, d, 2) is the equilibrated stress in N per mm of reference length,
    y_tail (nc, 2 d) its parts, P = -sum of y L; S (nq, 3) the tensile second Piola-Kirchhoff line load sum of lam_i
    S_i with P = F S at the exact answer.
    """

    status: str
    message: str
    z: Array
    lam: Array
    y_tail: Array
    cones: Cones
    P: Array
    S: Array
    primal: float
    dual: float
    residual: float
    iterations: int
    rounds: int
    history: tuple[Iteration, ...] = field(repr=False)

    @property
    def converged(self) -> bool:
        """Whether the gap was closed."""
        return self.status == "converged"


STATUSES = {
    "converged": "the gap between upper and lower bound is closed",
    "infeasible": "the supports are farther apart than the mesh can stretch: its rings would have to give at least "
    "{excess:.3g} % beyond locking; move the supports together or use a smaller gather",
    "iterations": "stopped after {n} iterations with a relative error of {error:.1e}: raise solver.max_iterations",
    "stalled": "rounding leaves no progress at a relative error of {error:.1e}: ask for a wider solver.tolerance",
}
"""One status per way to end, each with what happened and what to try."""


def solve_rigid(
    fem: Fem, law: MembraneLaw, load: Array, start: Array, size: float, options: RigidOptions = RigidOptions()
) -> RigidResult:
    """The rigid curtain under the generalised forces `load` (n,), N, from unknowns `start` (n,).

    `size` (mm) is the extent of the curtain: with the total load it makes the energy scale. Any start will do; one that
    is well inside the law lets later rounds begin near the end of the one before and makes the primal value a bound.
    """
    total = float(np.abs(load).sum()) or float(fem.weight.sum()) * NO_LOAD
    cones = first_cones(law, len(fem.weight)) if options.cones is None else options.cones
    program = make_program(fem, load, cones, total * size, total)
    inner = start if _law_slack(law, fem.gradient(start)) > INSIDE else None
    state, tolerance = first_state(program, start, FIRST_GAP), 1e-2
    history: list[Iteration] = []
    for number in range(1, options.max_rounds + 1):
        left = options.max_iterations - len(history)
        state, now, status, lines = follow(program, state, InteriorOptions(tolerance, tolerance, left))
        history += lines
        if status == "stalled" and now.error > max(tolerance, ROUNDING) and number > 1:
            cold = first_state(program, start, FIRST_GAP)
            left = max(0, options.max_iterations - len(history))
            state, now, status, lines = follow(program, cold, InteriorOptions(tolerance, tolerance, left))
            history += lines
        if status not in ("converged", "stalled") or (status == "stalled" and now.error > 0.1):
            break
        S, h, violation = _violated(law, fem.gradient(state.z))
        if violation.max() < options.violation and (tolerance <= options.gap or status == "stalled"):
            break
        new = np.flatnonzero(violation > 0.3 * options.violation)
        is_last = violation.max() < options.violation
        tolerance = options.gap if is_last else float(np.clip(LOOSE * violation.max(), options.gap, tolerance))
        if number <= PRUNED_ROUNDS:
            program, state = _pruned(program, state)
        if len(new):
            program, state = _extended(program, state, new, S, h, inner, float(violation.max()))
    else:
        status = "iterations"
    if status == "stalled" and now.error < ROUNDING:
        status = "converged"
    return _result(program, law, state, now, status, inner, number, history)


def _pruned(program: Program, state: State) -> tuple[Program, State]:
    """The program without half-spaces that are far away and carry next to nothing: the law tells if they are missed.

    At 20 half-spaces per point this makes later rounds three times as fast.
    """
    distance = state.s.margin() / program.c
    load = state.y.head * program.c
    first = program.cones.first
    keep = (load > IDLE * np.add.reduceat(load, first)[program.cones.point]) | (distance < IDLE)
    # one well-conditioned S, or else all of them, keeps Newton's matrix definite at every point
    S = program.cones.S
    det = S[:, 0] * S[:, 2] - S[:, 1] ** 2
    roundest = np.maximum.reduceat(det, first)[program.cones.point]
    keep |= (det >= roundest) | (roundest < FLAT)
    cones = only(program.cones, keep)
    few = make_program(program.fem, program.load, cones, program.scale, program.total)
    return few, State(state.z, _chosen(state.s, keep), _chosen(state.y, keep))


def _chosen(v: Vectors, keep: np.ndarray) -> Vectors:
    return Vectors(v.head[keep], v.tail[keep])


def _violated(law: MembraneLaw, F: Array) -> tuple[Array, Array, Array]:
    """The law's most violated half-space at each point and by how much of h + tr S / 2."""
    S, h, g = law_cut(law, F)
    return S, h, -g / (h + 0.5 * (S[:, 0] + S[:, 2]))


def _law_slack(law: MembraneLaw, F: Array) -> float:
    """The least relative slack of the whole law over all points; negative where F is not admissible."""
    return -float(_violated(law, F)[2].max())


def _extended(
    program: Program, state: State, new: np.ndarray, S: Array, h: Array, inner: Array | None, violation: float
) -> tuple[Program, State]:
    """The program with half-spaces added at the points `new`, and a start for it near the state.

    The start is drawn towards the inner state by more than the violation, so that it is inside all cones again; dual
    vectors are kept and lifted to the central path where they are too small for it.
    """
    cones, order = with_cuts(program.cones, new, S[new], h[new])
    wider = make_program(program.fem, program.load, cones, program.scale, program.total)
    share = float(np.clip(5.0 * violation, LEAST_SHARE, 0.5))
    if inner is None:
        z, s = state.z, lifted(wider.slack(state.z), share * wider.c)
    else:
        z, s, share = _drawn_back(wider, state.z, inner, share)
    central = soc.inverse(s, share * program.scale / float(wider.w.sum()))
    head = np.concatenate([state.y.head, np.zeros(len(new))])[order]
    tail = np.concatenate([state.y.tail, np.zeros((len(new), state.y.tail.shape[1]))])[order]
    part = np.where(order < len(state.y.head), KEPT_LIFT, 1.0)
    return wider, State(z, s, Vectors(head + part * central.head, tail + part[:, None] * central.tail))


def _drawn_back(program: Program, z: Array, inner: Array, share: float) -> tuple[Array, Vectors, float]:
    """z drawn towards the inner unknowns by at least `share`, so far that it is inside all cones."""
    while True:
        back = z + share * (inner - z)
        s = program.slack(back)
        if s.margin().min() > 0.0 or share >= 1.0:
            return back, lifted(s, LEAST_SHARE * program.c), share
        share = min(1.0, 2.0 * share)


def _drawn_inside(law: MembraneLaw, fem: Fem, z: Array, inner: Array | None) -> Array:
    """z, or the nearest point found on the way from z to the inner state that is inside the whole law."""
    if inner is None:
        return z
    share, slack = 0.0, _law_slack(law, fem.gradient(z))
    while slack < 0.0 and share < 1.0:
        share = min(1.0, max(1e-13, -0.5 * slack, 2.0 * share))
        slack = _law_slack(law, fem.gradient(z + share * (inner - z)))
    return z + share * (inner - z)


def _result(
    program: Program,
    law: MembraneLaw,
    state: State,
    now: Measure,
    status: str,
    inner: Array | None,
    rounds: int,
    history: list[Iteration],
) -> RigidResult:
    """The record; the dual value is lowered by what unbalanced forces could do over the curtain's size."""
    z = _drawn_inside(law, program.fem, state.z, inner) if status == "converged" else state.z
    lam = state.y.head / program.c
    bound_of_excess = now.dual * program.scale / float((program.w * state.y.head * program.c).sum())
    message = STATUSES[status].format(excess=100.0 * bound_of_excess, n=len(history), error=now.error)
    return RigidResult(
        status=status,
        message=message,
        z=z,
        lam=lam,
        y_tail=state.y.tail,
        cones=program.cones,
        P=-program.stress(state.y.tail),
        S=program.cones.stress(lam),
        primal=-float(program.load @ z),
        dual=(now.dual - REACH * now.unbalanced) * program.scale,
        residual=now.unbalanced,
        iterations=len(history),
        rounds=rounds,
        history=tuple(history),
    )
