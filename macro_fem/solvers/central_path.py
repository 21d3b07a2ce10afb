"""The curtain of a law: one interior-point path on which missing half-spaces join, for rigid and elastic curtains.

    minimise  -l.z + stored energy   subject to   S:(E(F_q(z)) - D S_q) <= h(S)   for every tensile S, at every point q

The iteration is that of `macro_fem.solvers.cone_program`, for a handful of half-spaces per point. Before every step the
law is asked for the half-spaces that it would violate (`macro_fem.solvers.cutting_planes`); if they shorten it much, it
is found anew with them. Half-spaces contain the law's set, so the dual value is a lower bound for the whole law at
every step; the primal value of a rigid curtain becomes an upper bound when the answer is drawn back, by the least
amount, towards a state inside the law.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from homogenize import MembraneLaw
from macro_fem.fem.supported import SupportedFem
from macro_fem.solvers import soc
from macro_fem.solvers.cone_program import (
    Fem,
    Iteration,
    Measure,
    Program,
    State,
    first_state,
    is_certificate,
    is_inside,
    make_program,
    measure,
)
from macro_fem.solvers.cone_step import moved, search
from macro_fem.solvers.cones import Cones, first_cones, least_slack
from macro_fem.solvers.cutting_planes import at_rest, find, joined, pruned, widened
from macro_fem.solvers.options import PATH, PathOptions
from macro_fem.solvers.status import FREE, Accuracy, Evidence, Judged, Reach, Verdict, judged, load_scale
from macro_fem.solvers.walls import NO_ROWS, Walls, all_forces, rows_of
from rve.common.progress import tell, way
from rve.common.types import Array

RIGID = np.zeros((3, 3))
"""The compliance of a rigid curtain."""


@dataclass(frozen=True)
class PathResult(Judged):
    """Free unknowns z, stress and multipliers of a curtain, with the numbers from which its status follows.

    `stop` is why the solver stopped, `evidence` the errors of the answer, `asked` what they must not exceed. `primal`
    is -l.z plus the stored energy, an upper bound of the least potential of this discretisation where the law is
    obeyed, `dual` a lower bound of it, N mm, without the constant that supports add. P (nq, d, 2) is the equilibrated
    stress in N per mm of reference length, y_tail (nc, 2 d) its parts, P = -sum of y L; S (nq, 3) the tensile second
    Piola-Kirchhoff line load sum of lam_i S_i with P = F S at the exact answer. wall_forces (m,), N: the reaction of
    each half-space on a node.
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
    wall_forces: Array = field(default_factory=lambda: np.zeros(0), repr=False)

    @cached_property
    def verdict(self) -> Verdict:
        """Status and message, from the numbers."""
        return judged(self.stop, self.evidence, self.asked, self.iterations, self.reach)

    @property
    def converged(self) -> bool:
        """Whether the gap was closed."""
        return self.status == "converged"


@dataclass(frozen=True)
class _Place:
    """Where a path is: program, state, its errors; how much room z leaves in the law, -inf where it is not known."""

    program: Program
    state: State
    now: Measure
    room: float = -np.inf

    @property
    def primal(self) -> float:
        """-l.z plus the stored energy, N mm."""
        stored = 0.5 * float((self.program.fem.weight * soc.row_dot(self.state.eps, self.state.eps)).sum())
        return stored - float(self.program.load @ self.state.z)

    @property
    def lower(self) -> float:
        """The dual value, N mm, lowered by what unbalanced forces could do over the curtain's size."""
        return self.now.lower * self.program.scale

    def violation(self, law: MembraneLaw) -> float:
        """Largest relative violation of the whole law, or of half-spaces on nodes; negative inside."""
        F = self.program.fem.gradient(self.state.z)
        rows = self.program.rows.slack(self.state.z)
        return -min(least_slack(law, self.program.locked(F, self.state.eps)), float(rows.min(initial=np.inf)))

    def evidence(self, law: MembraneLaw) -> Evidence:
        """The errors of this place as an answer."""
        gap = (self.primal - self.lower) / self.program.scale
        return Evidence(gap, self.now.unbalanced, self.violation(law))


def solve_path(
    fem: Fem,
    law: MembraneLaw,
    load: Array,
    start: Array,
    size: float,
    options: PathOptions = PATH,
    *,
    compliance: Array = RIGID,
    guide: Array | None = None,
    walls: Walls | None = None,
) -> PathResult:
    """The curtain under the generalised forces `load` (n,), N, from unknowns `start` (n,); rigid without a compliance.

    `size` (mm) is the extent of the curtain: with the total load it makes the energy scale. Any start will do; one that
    is well inside the law keeps the path inside and makes the primal value a bound. `compliance` (3, 3) is in mm/N and
    tensor components, such as `law.compliance`. `guide` (n,), N, are small forces that act until the gap is
    `options.released`: they give a shape to what the load leaves without one. `walls`: half-spaces on nodes; then fem
    is a `SupportedFem`.
    """
    total = load_scale(load, fem.weight)
    cones = first_cones(law, len(fem.weight)) if options.cones is None else options.cones
    guided = load if guide is None else load + guide
    rows = NO_ROWS if walls is None else rows_of(cast(SupportedFem, fem), walls, size)
    program = make_program(fem, guided, cones, total * size, total, compliance, rows)
    first = _measured(program, first_state(program, start, options.steps))
    place, inner, stop, history = _followed(first, law, load, options)
    found = _result(_under(load, place), law, stop, inner, history, options)
    if walls is None:
        return found
    return replace(found, wall_forces=all_forces(walls, cast(SupportedFem, fem), rows, place.state.u))


def _followed(
    place: _Place, law: MembraneLaw, load: Array, options: PathOptions
) -> tuple[_Place, _Place, str, list[Iteration]]:
    """Where the path from a place ends, the roomiest place near it, why it ends there, and its steps."""
    inner, best = replace(place, room=-place.violation(law)), place
    prunes, history = list(options.cuts.pruned_at), list[Iteration]()
    waited, held, first = 0, 0, place.now.gap
    while (stop := _stop(place, law, inner, load, options, len(history))) is None:
        if waited > options.steps.patience:
            return best, inner, "stalled", history
        tell(f"curtain of {len(place.program.fem.weight)} points", way(first, place.now.gap, options.gap))
        taken = _taken(place, law, options, may_wait=held < options.cuts.anew)
        if taken is None:
            return best, inner, "stalled", history
        now, known = place.now, len(place.program.c)
        program, state = taken.program, taken.state
        history.append(Iteration(now.gap, now.unbalanced, now.outside, taken.primal, taken.dual, len(program.c)))
        held = 0 if taken.dual > 0.0 else held + 1
        if prunes and now.gap < prunes[0]:
            program, state = pruned(program, state, options.cuts.idle)
            del prunes[0]
        if not is_inside(state):
            return best, inner, "stalled", history
        place = _measured(program, state, taken.room)
        if place.room > inner.room and inner.room < options.inside:
            inner = place
        waited += place.now.error < options.steps.settled and len(program.c) == known
        is_released = program.load is not load and place.now.gap < max(options.released, options.gap)
        if is_released:
            place = _under(load, place)
        if is_released or place.now.error < best.now.error:
            best, waited = place, 0
    return best if stop == "iterations" else place, inner, stop, history


def _under(load: Array, place: _Place) -> _Place:
    """The place measured for the load, without a guide."""
    program = place.program
    return place if program.load is load else _measured(replace(program, load=load), place.state, place.room)


def _measured(program: Program, state: State, room: float = -np.inf) -> _Place:
    return _Place(program, state, measure(program, state), room)


@dataclass(frozen=True)
class _Taken:
    """Program and state after a step of these lengths; `room` of the new z in the law, -inf where it is not known."""

    program: Program
    state: State
    primal: float
    dual: float
    room: float


def _taken(place: _Place, law: MembraneLaw, options: PathOptions, *, may_wait: bool) -> _Taken | None:
    """The next step as far as the law lets it go; or no step but the half-spaces in its way, if they spoil it.

    None where rounding leaves no step.
    """
    program, state, now, cuts = place.program, place.state, place.now, options.cuts
    boundary, least_gap = options.steps.boundary, options.steps.least_gap * options.gap
    step = search(program, state, now, least_gap, corrector=options.corrector, boundary=boundary)
    if step is None or max(step.primal, step.dual) == 0.0:
        return None
    F = program.fem.gradient(state.z + step.primal * step.dz)
    E = program.locked(F, state.eps + step.primal * step.deps)
    found = at_rest(program, now, find(program, law, E, now.wanted + step.d_wanted * step.primal, cuts), cuts)
    if not found.is_missing.any():
        after = moved(state, step)
        room = min(-float(found.violation.max()), float(program.rows.slack(after.z).min(initial=np.inf)))
        return _Taken(program, after, step.primal, step.dual, room)
    into = joined(program, state, found, cuts, options.steps.lift)
    shorter = widened(step, into, boundary)
    if may_wait and shorter.primal < cuts.good * step.primal:
        return _Taken(into.program, into.state, 0.0, 0.0, -np.inf)
    return _Taken(into.program, moved(into.state, shorter), shorter.primal, shorter.dual, -np.inf)


def _stop(place: _Place, law: MembraneLaw, inner: _Place, load: Array, options: PathOptions, steps: int) -> str | None:
    """Why the path ends at a place after so many steps; None where it goes on, as it does while a guide acts.

    An answer whose own numbers are not yet as good as asked is no end: smaller residuals make it so.
    """
    if is_certificate(place.program, place.now):
        return "blocked" if len(place.state.u) else "infeasible"
    is_free = place.program.load is load
    is_close = is_free and place.now.error < options.gap and place.violation(law) < options.violation
    if is_close and options.accuracy.is_met(_answer(place, law, inner, options).evidence(law)):
        return "closed"
    if options.enough is not None and options.enough(place.state.z, place.lower):
        return "closed"
    return "iterations" if steps >= options.max_iterations else None


def _answer(place: _Place, law: MembraneLaw, inner: _Place, options: PathOptions) -> _Place:
    """A rigid place drawn towards the inner one by the least amount found that brings it inside the whole law.

    The place itself where that way is too long to be a correction of rounding: its violation is then reported.
    """
    if not options.drawn or place.program.lead or inner.room <= 0.0:
        return place
    share, near = 0.0, place
    while (outside := near.violation(law)) > 0.0:
        share = max(1e-13, 0.5 * outside, 2.0 * share)
        if share > options.most_drawn:
            return place
        z = place.state.z + share * (inner.state.z - place.state.z)
        near = replace(place, state=replace(place.state, z=z))
    return near


def _result(
    place: _Place, law: MembraneLaw, stop: str, inner: _Place, history: list[Iteration], options: PathOptions
) -> PathResult:
    """The record, its numbers those of the answer it holds."""
    answer = place if stop in ("infeasible", "blocked") else _answer(place, law, inner, options)
    program, y = place.program, place.state.y
    lam = program.carried(y) / program.c
    excess = place.now.dual * program.scale / float((program.w * y.head * program.c).sum())
    return PathResult(
        stop=stop,
        evidence=answer.evidence(law),
        asked=options.accuracy,
        z=answer.state.z,
        lam=lam,
        y_tail=y.tail[:, program.lead :],
        cones=program.cones,
        P=-program.pull(y)[0],
        S=program.cones.stress(lam),
        primal=answer.primal,
        dual=answer.lower,
        iterations=len(history),
        history=tuple(history),
        reach=Reach(0.0, 1.0 / (1.0 + excess)) if stop == "infeasible" else FREE,
    )


def unsolved(fem: Fem, law: MembraneLaw, z: Array) -> PathResult:
    """What stands for an answer where supports are out of reach: unknowns z without stress."""
    cones = first_cones(law, len(fem.weight))
    P = 0.0 * fem.gradient(z)
    return PathResult(
        stop="infeasible",
        evidence=Evidence(np.inf, np.inf, np.inf),
        asked=PATH.accuracy,
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
