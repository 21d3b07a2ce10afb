"""The half-spaces of a law that a program does not know yet: found where they matter, joined without leaving the path.

A law has thousands of half-spaces, a point needs a handful. Were all of them known, an interior-point iteration would
stay inside all; so a step that would leave the law is shortened, and the half-spaces in its way are taken in where the
iteration still is inside them, with the dual vectors that the central path would have given them. Nothing starts anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from macro_fem.solvers import soc
from macro_fem.solvers.cone_program import ConeState, Measure, Program, mean_product
from macro_fem.solvers.cone_step import ConeStep
from macro_fem.solvers.cones import all_cuts, keep_steady, only, with_cuts
from macro_fem.solvers.options import BOUNDARY, IDLE, LIFT, NEAR, ROUNDED, SHARE, STRAY
from macro_fem.solvers.soc import Vectors
from rve.common.types import Array


@dataclass(frozen=True)
class NearestHalfSpaces:
    """The law's nearest half-space S (nq, 3), h (nq,) at each point, by how much it is violated, and if it is missing.

    violation (nq,) is (S:E - h) / (h + tr S / 2) for the locked strain E, negative inside; is_missing (nq,) marks
    points where it is not among the program's and is violated or much nearer than those; extra (nq,) as in `Cones`.
    """

    S: Array
    h: Array
    violation: Array
    is_missing: np.ndarray
    extra: Array | None = None


def find_nearest(program: Program, E: Array, wanted: Vectors) -> NearestHalfSpaces:
    """What the law knows better than the program at locked strains E (nq, 3), where the cones ask for `wanted`."""
    nearest_one = all_cuts(program.law, E)
    S, h, slack = nearest_one.S, nearest_one.h, -nearest_one.violation
    trace = S[:, 0] + S[:, 2]
    cones = program.cones
    known = 0.5 * (soc.row_dot(wanted.tail, wanted.tail) - wanted.head**2) / (cones.S[:, 0] + cones.S[:, 2])
    nearest = np.maximum.reduceat(known, cones.first)
    over = -slack / trace
    is_unknown = over > nearest + 1e-12 * (1.0 + np.abs(nearest))
    is_missing = is_unknown & ((over > 0.0) | (over > NEAR * nearest))
    return NearestHalfSpaces(S, h, -slack / (h + 0.5 * trace), is_missing, nearest_one.extra)


def drop_stray(program: Program, now: Measure, found: NearestHalfSpaces) -> NearestHalfSpaces:
    """`found` without points whose own cones are still far from their place: first those are to be met, or refuted."""
    if now.outside < STRAY:
        return found
    stray = np.sqrt(now.r_s.dot(now.r_s)) / program.c
    is_at_rest = np.maximum.reduceat(stray, program.cones.first) < STRAY
    return replace(found, is_missing=found.is_missing & is_at_rest)


@dataclass(frozen=True)
class Joined:
    """A program with half-spaces added and its state; order (nc + k,): where each cone was, k new ones at the end."""

    program: Program
    state: ConeState
    order: np.ndarray
    old: int

    @property
    def fresh(self) -> np.ndarray:
        """Places of the new cones (k,)."""
        return np.flatnonzero(self.order >= self.old)


def join(program: Program, state: ConeState, found: NearestHalfSpaces) -> Joined:
    """The program with all missing half-spaces, at the same unknowns.

    Dual vectors are those of the central path for the distance at hand. Where that is small or negative the cone vector
    is lifted, so that the half-space does not take more than `SHARE` of what its point carries; all dual
    vectors of the point are then lowered together until it carries what it did, which unbalances forces least.
    """
    new = np.flatnonzero(found.is_missing)
    extra = None if found.extra is None else found.extra[new]
    cones, order = with_cuts(program.cones, new, found.S[new], found.h[new], extra)
    wider = replace(program, cones=cones)
    old = len(program.c)
    fresh = np.flatnonzero(order >= old)
    mu = mean_product(program, state)
    load = program.cones.sum(program.carried(state.y) * program.c)[new]
    c = wider.c[fresh]
    s = wider.slack(state.z, state.eps, fresh)
    s = s.lifted(np.clip(0.5 * mu / (SHARE * load), ROUNDED, LIFT) * c)
    y = soc.inverse(s, mu)
    eased = np.ones(len(cones.first))
    eased[new] = 1.0 / (1.0 + program.carried(y) * c / load)
    factor = eased[cones.point]
    dual = _merged(state.y, y, order)
    dual = Vectors(dual.head * factor, dual.tail * factor[:, None])
    return Joined(wider, replace(state, s=_merged(state.s, s, order), y=dual), order, old)


def _merged(a: Vectors, b: Vectors, order: np.ndarray) -> Vectors:
    return Vectors(
        np.concatenate([a.head, b.head]).take(order), np.concatenate([a.tail.T, b.tail.T], axis=1).take(order, axis=1).T
    )


def widen(step: ConeStep, into: Joined) -> ConeStep:
    """The step for the wider program: the old changes, of the new cones the primal part alone, and lengths for both."""
    fresh, program, state = into.fresh, into.program, into.state
    d_wanted = program.map(program.fem.gradient_change(step.dz), step.deps, fresh)
    s = _chosen(state.s, fresh)
    ds = d_wanted - (s - program.slack(state.z, state.eps, fresh)) * (1.0 - step.keep)
    none = Vectors(np.zeros(len(fresh)), np.zeros_like(ds.tail))
    dy = _merged(step.dy, none, into.order)
    primal = min(step.primal, BOUNDARY * soc.largest_step(s, ds))
    dual = min(step.dual, BOUNDARY * soc.largest_step(state.y, dy))
    if program.lead:
        primal = dual = min(primal, dual)
    return replace(
        step,
        ds=_merged(step.ds, ds, into.order),
        dy=dy,
        d_wanted=_merged(step.d_wanted, d_wanted, into.order),
        primal=primal,
        dual=dual,
    )


def prune(program: Program, state: ConeState) -> tuple[Program, ConeState]:
    """The program without half-spaces that are far away and carry next to nothing: the law tells if they are missed."""
    distance = state.s.margin() / program.c
    load = program.carried(state.y) * program.c
    cones = program.cones
    keep = keep_steady(cones, (load > IDLE * cones.sum(load)[cones.point]) | (distance < IDLE))
    which = np.flatnonzero(keep)
    few = replace(program, cones=only(cones, keep))
    return few, replace(state, s=_chosen(state.s, which), y=_chosen(state.y, which))


def _chosen(v: Vectors, which: np.ndarray) -> Vectors:
    return Vectors(v.head.take(which), v.tail.T.take(which, axis=1).T)
