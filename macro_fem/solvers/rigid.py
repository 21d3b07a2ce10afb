"""The rigid curtain by ideal locking: one interior-point path on which missing half-spaces are taken in.

    minimise  -l.z   over z   subject to   S:E(F_q(z)) <= h(S)   for every tensile S, at every point q

The iteration is that of `macro_fem.solvers.cone_program`, for a handful of half-spaces per point. Before every step the
law is asked for the half-spaces that it would violate (`macro_fem.solvers.cutting_planes`); if they shorten it much, it
is found anew with them. Half-spaces contain the law's set, so the dual value is a lower bound for the whole law at
every step; the primal value becomes an upper bound when the answer is drawn back, by the least amount, towards a state
inside the law.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from homogenize import MembraneLaw
from macro_fem.solvers.cone_program import (
    Fem,
    Iteration,
    Measure,
    Program,
    State,
    Step,
    first_state,
    is_certificate,
    is_inside,
    make_program,
    measure,
    moved,
    search,
)
from macro_fem.solvers.cones import Cones, first_cones, green_strain, least_slack
from macro_fem.solvers.cutting_planes import at_rest, find, joined, pruned, widened
from macro_fem.solvers.status import FREE, Accuracy, Evidence, Judged, Reach, Verdict, judged, load_scale
from rve.common.types import Array

REACH = 4.0
"""No point of one admissible state is farther from its place in another than this many sizes: twice the stretch."""
COUNTED = 10.0
"""The reported gap counts unbalanced forces REACH times and what drawing the answer inside costs: it may be this many
times the gap that the path is asked for."""
FIRST_GAP = 10.0
"""Gap of the first state in energy scales: 0.1 to 100 take about as many steps."""
INSIDE = 1e-3
"""Relative room in the law from which a state is good enough to draw the answer back to; roomier ones replace less."""
DRAWN = 1e-3
"""Longest part of the way to the state inside that the answer is drawn."""
LEAST_GAP = 0.1
"""The path is not followed beyond this part of the gap that is asked for; what is left is to remove the residuals."""
PRUNED_AT = (1e-1, 1e-2, 1e-3)
"""Relative gaps at which idle half-spaces are dropped. Not later, lest the path goes in circles."""
GOOD = 0.5
"""A step is found anew with the half-spaces in its way if they leave less than this part of it,"""
ANEW = 2
"""but not more often than this in a row."""
SETTLED = 1e-2
"""Only below this error must every few steps make progress: far from the answer gap and residuals take turns."""
PATIENCE = 15
"""Steps without a new least error or half-space, since the last such error, after which rounding is said to rule."""


@dataclass(frozen=True)
class RigidOptions:
    """When to stop. `gap` is relative to the energy scale, total load times size, and holds for unbalanced forces too.

    `violation` (relative to h + tr S/2) is what the last step may leave before the answer is drawn back inside.
    `cones` are half-spaces to begin with instead of the law's own few, say those of a curtain on the same triangles;
    `drop_idle`: whether those that are far away are dropped on the way. `corrector`: whether steps are corrected to
    second order. `drawn`: whether the answer is drawn back inside; without, only its dual value is a bound. `enough`
    ends the path as soon as it is true of the unknowns z and the dual value.
    """

    gap: float = 1e-9
    violation: float = 1e-8
    max_iterations: int = 400
    cones: Cones | None = None
    drop_idle: bool = True
    corrector: bool = True
    drawn: bool = True
    enough: Callable[[Array, float], bool] | None = None

    @property
    def accuracy(self) -> Accuracy:
        """What the numbers of the answer must not exceed."""
        return Accuracy(COUNTED * self.gap, self.gap, self.violation)


@dataclass(frozen=True)
class RigidResult(Judged):
    """Free unknowns z, stress and multipliers of the rigid curtain, with the numbers from which its status follows.

    `stop` is why the solver stopped, `evidence` the errors of the answer, `asked` what they must not exceed. `primal`
    is -l.z, an upper bound of the least potential of this discretisation, `dual` a lower bound of it, N mm, without the
    constant that supports add. P (nq, d, 2) is the equilibrated stress in N per mm of reference length, y_tail
    (nc, 2 d) its parts, P = -sum of y L; S (nq, 3) the tensile second Piola-Kirchhoff line load sum of lam_i S_i with
    P = F S at the exact answer.
    """

    stop: str
    evidence: Evidence
    asked: Accuracy
    z: Array
    lam: Array
    y_tail: Array
    cones: Cones
    P: Array
    S: Array
    primal: float
    dual: float
    iterations: int
    history: tuple[Iteration, ...] = field(repr=False)
    reach: Reach = FREE

    @cached_property
    def verdict(self) -> Verdict:
        """Status and message, from the numbers."""
        return judged(self.stop, self.evidence, self.asked, self.iterations, self.reach)

    @property
    def residual(self) -> float:
        """Sum of the unbalanced forces over that of the loads."""
        return self.evidence.unbalanced

    @property
    def converged(self) -> bool:
        """Whether the gap was closed."""
        return self.status == "converged"


def solve_rigid(
    fem: Fem, law: MembraneLaw, load: Array, start: Array, size: float, options: RigidOptions = RigidOptions()
) -> RigidResult:
    """The rigid curtain under the generalised forces `load` (n,), N, from unknowns `start` (n,).

    `size` (mm) is the extent of the curtain: with the total load it makes the energy scale. Any start will do; one that
    is well inside the law keeps the path inside and makes the primal value a bound.
    """
    total = load_scale(load, fem.weight)
    cones = first_cones(law, len(fem.weight)) if options.cones is None else options.cones
    program = make_program(fem, load, cones, total * size, total)
    state = first_state(program, start, FIRST_GAP)
    now = measure(program, state)
    inner = _Inner(start, law_slack(law, fem.gradient(start)))
    best, waited, held, prunes, stop = (program, state, now), 0, 0, 0, "iterations"
    history: list[Iteration] = []
    while len(history) < options.max_iterations:
        if is_certificate(program, state, now):
            stop = "infeasible"
            break
        if _is_closed(now, options) and _is_answer(program, law, state, now, inner, options):
            stop = "closed"
            break
        if options.enough is not None and options.enough(state.z, _lower(program, now)):
            stop = "closed"
            break
        step = None
        if waited <= PATIENCE:
            step = search(program, state, now, LEAST_GAP * options.gap, corrector=options.corrector)
        if step is None or max(step.primal, step.dual) == 0.0:
            stop = "stalled"
            break
        known = len(program.c)
        taken = _taken(program, state, now, step, law, may_wait=held < ANEW)
        program, state = taken.program, taken.state
        history.append(Iteration(now.gap, now.unbalanced, now.outside, taken.primal, taken.dual, len(program.c)))
        held = 0 if taken.dual > 0.0 else held + 1
        if taken.room > inner.room and inner.room < INSIDE:
            inner = _Inner(state.z, taken.room)
        if options.drop_idle and prunes < len(PRUNED_AT) and now.gap < PRUNED_AT[prunes]:
            program, state = pruned(program, state)
            prunes += 1
        if not is_inside(state):
            stop = "stalled"
            break
        now = measure(program, state)
        waited += now.error < SETTLED and len(program.c) == known
        if now.error < best[2].error:
            best, waited = (program, state, now), 0
    if stop in ("stalled", "iterations"):
        program, state, now = best
    return _result(program, law, state, now, stop, inner, history, options)


@dataclass(frozen=True)
class _Inner:
    """Unknowns z and their room: the least relative slack of the whole law over all points."""

    z: Array
    room: float


@dataclass(frozen=True)
class _Taken:
    """Program and state after a step of these lengths; `room` of the new z in the law, -inf where it is not known."""

    program: Program
    state: State
    primal: float
    dual: float
    room: float


def _taken(program: Program, state: State, now: Measure, step: Step, law: MembraneLaw, may_wait: bool) -> _Taken:
    """The step as far as the law lets it go; or no step but the half-spaces in its way, if they spoil it."""
    F = program.fem.gradient(state.z + step.primal * step.dz)
    found = at_rest(program, now, find(program, law, F, now.tail + step.primal * step.d_tail))
    if not found.is_missing.any():
        return _Taken(program, moved(state, step), step.primal, step.dual, -float(found.violation.max()))
    into = joined(program, state, found)
    shorter = widened(step, into)
    if may_wait and shorter.primal < GOOD * step.primal:
        return _Taken(into.program, into.state, 0.0, 0.0, -np.inf)
    return _Taken(into.program, moved(into.state, shorter), shorter.primal, shorter.dual, -np.inf)


def _is_closed(now: Measure, options: RigidOptions) -> bool:
    return max(now.gap, now.unbalanced, now.outside) < options.gap


def _is_answer(
    program: Program, law: MembraneLaw, state: State, now: Measure, inner: _Inner, options: RigidOptions
) -> bool:
    """Whether the answer that would be given now is as good as asked; if not, smaller residuals make it so."""
    if -law_slack(law, program.fem.gradient(state.z)) >= options.violation:
        return False
    z = _answer(program, law, state, inner, options)
    return options.accuracy.is_met(_evidence(program, law, z, now))


def _answer(program: Program, law: MembraneLaw, state: State, inner: _Inner, options: RigidOptions) -> Array:
    return _drawn_inside(law, program.fem, state.z, inner) if options.drawn else state.z


def _evidence(program: Program, law: MembraneLaw, z: Array, now: Measure) -> Evidence:
    """The errors of an answer z with the stress that `now` was measured with."""
    gap = (-float(program.load @ z) - _lower(program, now)) / program.scale
    return Evidence(gap, now.unbalanced, -law_slack(law, program.fem.gradient(z)))


def _lower(program: Program, now: Measure) -> float:
    """The dual value, N mm, lowered by what unbalanced forces could do over the curtain's size."""
    return (now.dual - REACH * now.unbalanced) * program.scale


def law_slack(law: MembraneLaw, F: Array) -> float:
    """The least relative slack of the whole law over all points; negative where F is not admissible."""
    return least_slack(law, green_strain(F))


def _drawn_inside(law: MembraneLaw, fem: Fem, z: Array, inner: _Inner) -> Array:
    """z, or the nearest point found on the way from z to the inner state that is inside the whole law.

    z itself where that way is too long to be a correction of rounding: its violation is then reported.
    """
    if inner.room <= 0.0:
        return z
    share, slack = 0.0, law_slack(law, fem.gradient(z))
    while slack < 0.0:
        share = max(1e-13, -0.5 * slack, 2.0 * share)
        if share > DRAWN:
            return z
        slack = law_slack(law, fem.gradient(z + share * (inner.z - z)))
    return z + share * (inner.z - z)


def _result(
    program: Program,
    law: MembraneLaw,
    state: State,
    now: Measure,
    stop: str,
    inner: _Inner,
    history: list[Iteration],
    options: RigidOptions,
) -> RigidResult:
    """The record, its numbers those of the answer it holds."""
    z = state.z if stop == "infeasible" else _answer(program, law, state, inner, options)
    lam = state.y.head / program.c
    excess = now.dual * program.scale / float((program.w * state.y.head * program.c).sum())
    return RigidResult(
        stop=stop,
        evidence=_evidence(program, law, z, now),
        asked=options.accuracy,
        z=z,
        lam=lam,
        y_tail=state.y.tail,
        cones=program.cones,
        P=-program.stress(state.y.tail),
        S=program.cones.stress(lam),
        primal=-float(program.load @ z),
        dual=_lower(program, now),
        iterations=len(history),
        history=tuple(history),
        reach=Reach(0.0, 1.0 / (1.0 + excess)) if stop == "infeasible" else FREE,
    )


def unsolved(fem: Fem, law: MembraneLaw, z: Array) -> RigidResult:
    """What stands for an answer where supports are out of reach: unknowns z without stress."""
    cones = first_cones(law, len(fem.weight))
    P = 0.0 * fem.gradient(z)
    return RigidResult(
        stop="infeasible",
        evidence=Evidence(np.inf, np.inf, np.inf),
        asked=RigidOptions().accuracy,
        z=z,
        lam=np.zeros(len(cones)),
        y_tail=np.zeros((len(cones), 2 * P.shape[1])),
        cones=cones,
        P=P,
        S=np.zeros((len(P), 3)),
        primal=np.nan,
        dual=np.nan,
        iterations=0,
        history=(),
    )
