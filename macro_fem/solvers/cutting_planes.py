"""The half-spaces of a law that a program does not know yet: found where they matter, joined without leaving the path.

A law has thousands of half-spaces, a point needs a handful. A step that would leave the law is shortened, and the
half-spaces in its way are taken in where the iteration still is inside them, with the dual vectors that the central
path would have given them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from homogenize import Cut
from macro_fem.solvers import soc
from macro_fem.solvers.cone_program import LIFT, ConeState, Measure, Program, mean_product
from macro_fem.solvers.cone_step import BOUNDARY, ConeStep, limited
from macro_fem.solvers.cones import all_cuts, with_cuts
from macro_fem.solvers.soc import Vectors
from rve.common import Array
from rve.common.tensor import trace

NEAR = 0.9
"""A missing half-space joins when it is nearer than this part of the distance to the nearest known one. Larger parts
add more, smaller ones late, so that steps are cut short."""
SHARE = 0.3
"""A violated half-space enters with at most this part of the load of its point. Larger shares unbalance more."""
ROUNDED = 1e-13
"""Least relative distance from the boundary that double precision can tell from none."""
STRAY = 1e-2
"""A point gets no half-spaces while a cone vector of its own is off by more than this part of its radius."""
IDLE = 0.03
"""A half-space is idle below this part of its point's load and above this relative distance. Larger values drop more,
some of which have to join again."""
FLAT = 0.05
"""A unit-trace S with a determinant below this (1/4 is the roundest) does not hold a point on its own."""


@dataclass(frozen=True)
class Nearest:
    """The law's nearest half-space at each point, by how much it is violated, and if it is missing.

    violation (nq,) is (S:E - h) / (h + tr S / 2) for the locked strain E, negative inside; missing (k,) are the points
    where it is not among the program's and is violated or much nearer than those.
    """

    cut: Cut
    violation: Array
    missing: np.ndarray


def find_nearest(program: Program, now: Measure, E: Array, wanted: Vectors) -> Nearest:
    """What the law knows better than the program at locked strains E (nq, 3), where the cones ask for `wanted`: nothing
    at points whose own cones are still far from their place.
    """
    cones, cut = program.cones, all_cuts(program.law, E)
    size = trace(cut.S)
    known = 0.5 * (soc.row_dot(wanted.tail, wanted.tail) - wanted.head**2) / trace(cones.S)
    nearest = np.maximum.reduceat(known, cones.first)
    over = cut.violation / size
    is_missing = over > nearest + 1e-12 * (1.0 + np.abs(nearest))
    is_missing &= (over > 0.0) | (over > NEAR * nearest)
    if now.outside >= STRAY:
        stray = np.sqrt(now.r_s.dot(now.r_s)) / program.c
        is_missing &= np.maximum.reduceat(stray, cones.first) < STRAY
    return Nearest(cut, cut.violation / (cut.h + 0.5 * size), np.flatnonzero(is_missing))


@dataclass(frozen=True)
class Joined:
    """A program with half-spaces added, and its state. order (nc + k,): where each cone was, new ones at the end; fresh
    (k,): places of these."""

    program: Program
    state: ConeState
    order: np.ndarray
    fresh: np.ndarray


def join(program: Program, state: ConeState, found: Nearest) -> Joined:
    """The program with all missing half-spaces, at the same unknowns.

    Dual vectors are those of the central path for the distance at hand. Where that is small or negative the cone vector
    is lifted, so that the half-space takes no more than `SHARE` of what its point carries; all dual vectors of the
    point are then lowered together until it carries what it did, which unbalances forces least.
    """
    new = found.missing
    cones, order = with_cuts(program.cones, new, found.cut.take(new))
    wider = replace(program, cones=cones)
    fresh = np.flatnonzero(order >= len(program.c))
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
    return Joined(wider, replace(state, s=_merged(state.s, s, order), y=dual), order, fresh)


def _merged(a: Vectors, b: Vectors, order: np.ndarray) -> Vectors:
    return Vectors(
        np.concatenate([a.head, b.head]).take(order), np.concatenate([a.tail.T, b.tail.T], axis=1).take(order, axis=1).T
    )


def widen(step: ConeStep, into: Joined) -> ConeStep:
    """The step for the wider program: the old changes, of the new cones the primal part alone, and lengths for both."""
    fresh, order, program, state = into.fresh, into.order, into.program, into.state
    d_wanted = program.map(program.fem.gradient_change(step.dz), step.deps, fresh)
    ds = d_wanted - (_chosen(state.s, fresh) - program.slack(state.z, state.eps, fresh)) * (1.0 - step.keep)
    new = zip((step.ds, step.dy, step.d_wanted), (ds, ds * 0.0, d_wanted), strict=True)
    ds, dy, d_wanted = (_merged(old, more, order) for old, more in new)
    return limited(program, state, replace(step, ds=ds, dy=dy, d_wanted=d_wanted), BOUNDARY)


def prune(program: Program, state: ConeState) -> tuple[Program, ConeState]:
    """The program without half-spaces that are far away and carry next to nothing: the law tells if they are missed.

    Newton's matrix stays definite: every point keeps one well-conditioned S, or all.
    """
    cones = program.cones
    load = program.carried(state.y) * program.c
    keep = (load > IDLE * cones.sum(load)[cones.point]) | (state.s.margin() / program.c < IDLE)
    det = cones.S[:, 0] * cones.S[:, 2] - cones.S[:, 1] ** 2
    roundest = np.maximum.reduceat(det, cones.first)[cones.point]
    which = np.flatnonzero(keep | (det >= roundest) | (roundest < FLAT))
    few = replace(program, cones=cones.pick(which, cones.point[which], len(cones.first)))
    return few, replace(state, s=_chosen(state.s, which), y=_chosen(state.y, which))


def _chosen(v: Vectors, which: np.ndarray) -> Vectors:
    return Vectors(v.head.take(which), v.tail.T.take(which, axis=1).T)
