"""The curtain of a law: one interior-point path on which missing half-spaces join, for rigid and elastic curtains.

    minimise  -l.z + stored energy   subject to   S:(E(F_q(z)) - D S_q) <= h(S)   for every tensile S, at every point q

The iteration is that of `macro_fem.solvers.cone_program`, for a handful of half-spaces per point. Before every step the
law is asked for the half-spaces that it would violate (`macro_fem.solvers.cone_step`); if they shorten it much, it
is found anew with them. Half-spaces contain the law's set, so the dual value is a lower bound for the whole law at
every step; the primal value of a rigid curtain becomes an upper bound when the answer is drawn back, by the least
amount, towards a state inside the law.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from homogenize import MembraneLaw
from macro_fem.fem.supported import SupportedFem
from macro_fem.solvers import soc
from macro_fem.solvers.cone_program import ConeState, Measure, Program, compliance_root, find_first_state, measure
from macro_fem.solvers.cone_step import STEP, advance, find_nearest, find_step, join, prune
from macro_fem.solvers.cones import all_cuts, first_cones, green_strain, least_slack
from macro_fem.solvers.path import PATH, RIGID_TERMS, PathOptions, PathResult, Terms
from macro_fem.solvers.status import FREE, Evidence, Reach, load_scale
from macro_fem.solvers.walls import WallRows, Walls
from rve.common import Array, tell
from rve.common.tensor import IDENTITY, WEIGHT


@dataclass(frozen=True)
class StopOptions:
    """When a path that gets no nearer ends, and how its answer is drawn inside."""

    settled: float = 1e-2
    """Stagnation is checked only below this error; earlier, gap and residuals fall alternately."""
    patience: int = 30
    """Steps below `STOP.settled` without a new least error or half-space after which rounding stops the iteration. At
    half as many one in twenty of huge point loads on elastic rings ended so that goes on."""
    good: float = 0.5
    """A step is found anew with the half-spaces in its way if they leave less than this part of it,"""
    anew: int = 2
    """but no more often than this in a row. More costs factorisations, less short steps."""
    inside: float = 1e-3
    """Relative margin in the law from which the answer is drawn back to a state. Larger: earlier, farther states."""
    most_drawn: float = 1e-3
    """Longest part of the way to that state that the answer is drawn. More would hide a wrong answer."""


STOP = StopOptions()


@dataclass(frozen=True)
class _Place:
    """Where a path is: program, state, its errors; the interior margin of z in the law, -inf where it is not known."""

    program: Program
    state: ConeState
    now: Measure
    interior_margin: float

    @classmethod
    def at(cls, program: Program, state: ConeState, interior_margin: float = -np.inf) -> _Place:
        """The measured place of a state."""
        return cls(program, state, measure(program, state), interior_margin)

    @cached_property
    def tau(self) -> Array | None:
        """The least plastic work (nq,) in N/mm with which z is admissible, with what elastic strings store; None where
        rings do not flow."""
        if (flow := self.program.flow) is None:
            return None
        tau, *e = (find_flow(self.program, self.state.z, law) for law in flow.laws)
        return tau + 0.5 * sum(one**2 for one in e) if e else tau

    @cached_property
    def primal(self) -> float:
        """-l.z plus the stored energy or plastic work, N mm; where a limit is asked for, scale times an upper bound."""
        program, z = self.program, self.state.z
        if self.tau is not None:
            work, by_load = float(program.fem.disc.weight @ self.tau), float(program.load @ z)
            return work / max(by_load, 1e-300) * program.scale if program.is_limit else work - by_load
        stored = 0.5 * float((self.program.fem.disc.weight * soc.row_dot(self.state.eps, self.state.eps)).sum())
        moving = 0.0 if self.program.inertia is None else self.program.inertia.energy(self.state.z)
        return stored - float(self.program.load @ self.state.z) + moving

    @property
    def lower(self) -> float:
        """The dual value, N mm, lowered by what unbalanced forces could do over the curtain's size."""
        return self.now.lower * self.program.scale

    @property
    def violation(self) -> float:
        """Largest relative violation of the whole law, or of half-spaces on nodes; negative inside."""
        program, z = self.program, self.state.z
        E = program.locked(program.fem.gradient(z), self.state.eps)
        return -min(least_slack(program.law, E), float(program.rows.slack(z).min(initial=np.inf)))

    @property
    def evidence(self) -> Evidence:
        """The errors of this place as an answer."""
        gap, drawn = (self.primal - self.lower) / self.program.scale, self.now.drawn
        return Evidence(gap / drawn, self.now.unbalanced / drawn, self.violation, drawn)


def solve_path(
    fem: SupportedFem,
    law: MembraneLaw,
    load: Array,
    start: Array,
    size: float,
    options: PathOptions = PATH,
    terms: Terms = RIGID_TERMS,
) -> PathResult:
    """The curtain under the generalised forces `load` (n,), N, from unknowns `start` (n,); rigid without other `terms`.

    `size` (mm) is the extent of the curtain: with the total load it makes the energy scale. A start well inside the law
    keeps the path inside and makes the primal value a bound.
    """
    program, _ = make_program(fem, law, load, size, options, terms)
    first = _Place.at(program, find_first_state(program, start, options.first_gap))
    return _make_result(*_follow(first, options), options)


def make_program(
    fem: SupportedFem, law: MembraneLaw, load: Array, size: float, options: PathOptions, terms: Terms
) -> tuple[Program, Array | None]:
    """The program of `solve_path`, and the multipliers of its half-spaces where they are known."""
    loads, inertia = load_scale(load, fem.disc.weight), terms.inertia
    own, cones, lam = law.half_spaces(), options.cones, options.lam
    if cones is None or (cones.extra is None) != (own.extra is None):  # those of rigid rings do not widen
        cones, lam = first_cones(own, len(fem.disc.weight)), None
    program = Program(
        fem=fem,
        law=law,
        load=load,
        cones=cones,
        R=compliance_root(terms.compliance),
        scale=loads * size + (0.0 if inertia is None else inertia.energy_scale),
        total=loads + (0.0 if inertia is None else inertia.force_scale),
        rows=WallRows(fem, terms.walls or Walls.none(fem.x_held.shape), size),
        inertia=inertia,
        flow=terms.flow,
    )
    return program, lam


def _follow(place: _Place, options: PathOptions) -> tuple[_Place, str, _Place, int]:
    """Where the path from a place ends, why, the place near it with the largest margin, and how many steps."""
    inner, best = replace(place, interior_margin=-place.violation), place
    prunes, steps, waited, held = list(options.pruned_at), 0, 0, 0
    while (stop := _find_stop(place, inner, options, steps)) is None:
        points = len(place.program.fem.disc.weight)
        tell(f"curtain of {points} points, gap {place.now.gap:.0e} down to {options.gap:.0e}")
        after = None if waited > STOP.patience else _try_step(place, options, may_wait=held < STOP.anew)
        if after is None:
            return best, "stalled", inner, steps
        known, (program, state, is_moved, margin) = len(place.program.c), after
        steps, held = steps + 1, 0 if is_moved else held + 1
        # Where rings flow residuals fall behind the gap, and half-spaces that look idle would leave points to run away.
        if prunes and (place.now.gap if place.program.flow is None else place.now.error) < prunes[0]:
            program, state = prune(program, state)
            del prunes[0]
        if not state.is_inside:
            return best, "stalled", inner, steps
        place = _Place.at(program, state, margin)
        if place.interior_margin > inner.interior_margin and inner.interior_margin < STOP.inside:
            inner = place
        waited += place.now.error < STOP.settled and len(program.c) == known
        if place.now.error < best.now.error:
            best, waited = place, 0
    return best if stop == "iterations" else place, stop, inner, steps


def _try_step(place: _Place, options: PathOptions, *, may_wait: bool) -> tuple[Program, ConeState, bool, float] | None:
    """Program and state after the next step as far as the law lets it go, or no step but the half-spaces in its way, if
    they spoil it; whether the state has moved, and its interior margin. None where rounding leaves no step.
    """
    program, state, now = place.program, place.state, place.now
    step = find_step(program, state, now, options.least_gap * options.gap * now.drawn)
    if step is None or max(step.primal, step.dual) == 0.0:
        return None
    F = program.fem.gradient(state.z + step.primal * step.dz)
    E = program.locked(F, state.eps + step.primal * step.deps)
    if not np.isfinite(E).all():  # rings that flow without end
        return None
    violation, missing, cut = find_nearest(program, now, E, now.wanted + step.d_wanted * step.primal)
    if not len(missing):
        after = advance(state, step)
        margin = min(-float(violation.max()), float(program.rows.slack(after.z).min(initial=np.inf)))
        return program, after, step.dual > 0.0, margin
    program, state, shorter = join(program, state, step, missing, cut)
    if may_wait and shorter.primal < STOP.good * step.primal:
        return program, state, False, -np.inf
    return program, advance(state, shorter), shorter.dual > 0.0, -np.inf


def _find_stop(place: _Place, inner: _Place, options: PathOptions, steps: int) -> str | None:
    """Why the path ends at a place after so many steps; None where it goes on, as it does while the answer's own
    numbers are not as good as asked.
    """
    now, program = place.now, place.program
    is_dual = not program.lead and program.flow is None and now.outside != 0.0 and now.dual > 0.0
    if is_dual and float(np.abs(now.r_y).sum()) / program.total < 1e-6 * now.dual:  # y proves that there is no z
        return "blocked" if len(place.state.u) else "infeasible"
    is_close = now.error < options.gap * now.drawn and place.violation < options.violation
    if is_close and _draw_inside(place, inner, options).evidence.meets(options.accuracy):
        return "closed"
    if options.enough is not None and options.enough(place.state.z, place.lower):
        return "closed"
    return "iterations" if steps >= options.max_iterations else None


def _draw_inside(place: _Place, inner: _Place, options: PathOptions) -> _Place:
    """A rigid place drawn towards the inner one by the least amount found that brings it inside the whole law; the
    place itself where that is more than a correction of rounding.
    """
    if not options.drawn or place.program.lead or place.program.flow or inner.interior_margin <= 0.0:
        return place
    share, near = 0.0, place
    while (outside := near.violation) > 0.0:
        share = max(1e-13, 0.5 * outside, 2.0 * share)
        if share > STOP.most_drawn:
            return place
        z = place.state.z + share * (inner.state.z - place.state.z)
        near = replace(place, state=replace(place.state, z=z))
    return near


def _make_result(place: _Place, stop: str, inner: _Place, steps: int, options: PathOptions) -> PathResult:
    """The record, its numbers those of the answer it holds."""
    answer = place if stop in ("infeasible", "blocked") else _draw_inside(place, inner, options)
    program, y = place.program, place.state.y
    tail = y.tail[:, program.lead :]
    excess = place.now.dual * program.scale / float((program.w * y.head * program.c).sum())
    head = place.state.s.head if program.flow else program.c
    lam, (pulled, strain) = program.carried(y) / head, program.pull(y)
    stored = 0.5 * (strain[:, 1:] ** 2).sum(axis=1) if program.flow else 0.0
    return PathResult(
        stop=stop,
        evidence=answer.evidence,
        asked=options.accuracy,
        z=answer.state.z,
        S=program.cones.stress(lam),
        psi=program.cones.sum(program.c * np.sqrt(soc.row_dot(tail, tail))) + stored,
        cones=program.cones,
        P=-pulled,
        primal=answer.primal,
        dual=answer.lower,
        iterations=steps,
        reach=Reach(0.0, 1.0 / (1.0 + excess)) if stop == "infeasible" else FREE,
        wall_forces=program.rows.reactions(place.state.u),
        tau=answer.tau,
        lam=lam,
        S_strings=_of_strings(program, place.state) if program.flow else None,
    )


def _of_strings(program: Program, state: ConeState) -> Array:
    """S (nq, 3) under which strings that stretch no more have the tensions that they have."""
    longer = soc.row_dot(program.N[:, 1:], state.eps[program.cones.point, 1:])
    return program.cones.stress(program.carried(state.y) / (state.s.head - longer) * (program.N[:, 0] == 0.0))


def find_flow(program: Program, z: Array, law: MembraneLaw) -> Array:
    """The least tau (nq,) with which |F L| <= offset + N tau holds for the whole law, one of those of the flow."""
    assert program.flow is not None
    F, tau = program.fem.gradient(z), np.zeros(len(program.fem.disc.weight))
    C = 2.0 * green_strain(F) + IDENTITY
    for _ in range(STOP.patience):
        cut = all_cuts(law, program.locked(F, tau[:, None]))
        assert cut.extra is not None
        radius = np.sqrt(np.maximum((cut.S * WEIGHT * C).sum(axis=1), 0.0))
        beyond = radius - np.sqrt(2.0 * cut.h + 1.0) * (not program.is_limit)
        beyond[beyond < STEP.rounded * radius] = 0.0  # work of rounding, which is more than that of the smallest loads
        asked = np.maximum(tau, beyond / cut.extra[:, 0] * program.flow.strength)
        if not (asked > tau * (1.0 + 1e-12)).any():
            break
        tau = asked
    return tau
