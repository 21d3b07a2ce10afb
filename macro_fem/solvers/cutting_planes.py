"""The half-spaces of a law that a program does not know yet: found where they matter, joined without leaving the path.

A law has thousands of half-spaces, a point needs a handful. Were all of them known, an interior-point iteration would
stay inside all; so a step that would leave the law is shortened, and the half-spaces in its way are taken in where the
iteration still is inside them, with the dual vectors that the central path would have given them. Nothing starts anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from homogenize import MembraneLaw
from macro_fem.solvers import soc
from macro_fem.solvers.cone_program import (
    BOUNDARY,
    LIFT,
    Measure,
    Program,
    State,
    Step,
    gathered_root,
    make_program,
    mean_product,
)
from macro_fem.solvers.cones import law_cut, only, steadied, with_cuts
from macro_fem.solvers.soc import Vectors
from rve.common.types import Array

NEAR = 0.9
"""A missing half-space is taken in when it is nearer than this part of the distance to the nearest known one."""
SHARE = 0.3
"""A half-space that is violated enters with at most this part of the load that its point carries."""
ROUNDED = 1e-13
"""Least relative distance from the boundary that double precision can tell from none."""
STRAY = 1e-2
"""A point asks for no more half-spaces while a cone vector of its own is off by more than this part of its radius."""
IDLE = 0.03
"""A half-space is idle below this part of a point's load and above this relative distance."""


@dataclass(frozen=True)
class Found:
    """The law's nearest half-space S (nq, 3), h (nq,) at each point, by how much it is violated, and if it is missing.

    violation (nq,) is (S:E - h) / (h + tr S / 2), negative inside; is_missing (nq,) marks points where it is not among
    the program's and is violated or much nearer than those.
    """

    S: Array
    h: Array
    violation: Array
    is_missing: np.ndarray


def find(program: Program, law: MembraneLaw, F: Array, tail: Array) -> Found:
    """What the law knows better than the program at F (nq, d, 2), tail (nc, 2 d) = F L."""
    S, h, slack = law_cut(law, F)
    trace = S[:, 0] + S[:, 2]
    cones = program.cones
    known = 0.5 * (soc.row_dot(tail, tail) - program.c**2) / (cones.S[:, 0] + cones.S[:, 2])
    nearest = np.maximum.reduceat(known, cones.first)
    over = -slack / trace
    is_unknown = over > nearest + 1e-12 * (1.0 + np.abs(nearest))
    return Found(S, h, -slack / (h + 0.5 * trace), is_unknown & ((over > 0.0) | (over > NEAR * nearest)))


def at_rest(program: Program, now: Measure, found: Found) -> Found:
    """`found` without points whose own cones are still far from their place: first those are to be met, or refuted."""
    if now.outside < STRAY:
        return found
    stray = np.sqrt(now.r_s.dot(now.r_s)) / program.c
    return replace(found, is_missing=found.is_missing & (np.maximum.reduceat(stray, program.cones.first) < STRAY))


@dataclass(frozen=True)
class Joined:
    """A program with half-spaces added and its state; order (nc + k,): where each cone was, k new ones at the end."""

    program: Program
    state: State
    order: np.ndarray
    old: int

    @property
    def fresh(self) -> np.ndarray:
        """Places of the new cones (k,)."""
        return np.flatnonzero(self.order >= self.old)


def joined(program: Program, state: State, found: Found) -> Joined:
    """The program with all missing half-spaces, at the same unknowns.

    Dual vectors are those of the central path for the distance at hand. Where that is small or negative the cone vector
    is lifted, so that the half-space does not take more than SHARE of what its point carries; all dual vectors of the
    point are then lowered together until it carries what it did, which unbalances forces least.
    """
    new = np.flatnonzero(found.is_missing)
    cones, order = with_cuts(program.cones, new, found.S[new], found.h[new])
    wider = make_program(program.fem, program.load, cones, program.scale, program.total)
    old = len(program.c)
    fresh = np.flatnonzero(order >= old)
    mu = mean_product(program, state)
    load = program.cones.sum(state.y.head * program.c)[new]
    c = wider.c[fresh]
    tail = gathered_root(program.fem.gradient(state.z), cones.point[fresh], wider.L[fresh])
    s = Vectors(c, tail).lifted(np.clip(0.5 * mu / (SHARE * load), ROUNDED, LIFT) * c)
    y = soc.inverse(s, mu)
    eased = np.ones(len(cones.first))
    eased[new] = 1.0 / (1.0 + y.head * c / load)
    factor = eased[cones.point]
    dual = _merged(state.y, y, order)
    dual = Vectors(dual.head * factor, dual.tail * factor[:, None])
    return Joined(wider, State(state.z, _merged(state.s, s, order), dual), order, old)


def _merged(a: Vectors, b: Vectors, order: np.ndarray) -> Vectors:
    return Vectors(
        np.concatenate([a.head, b.head]).take(order), np.concatenate([a.tail.T, b.tail.T], axis=1).take(order, axis=1).T
    )


def widened(step: Step, into: Joined) -> Step:
    """The step for the wider program: the old changes, of the new cones the primal part alone, and lengths for both."""
    fresh, program, state = into.fresh, into.program, into.state
    point, L = program.cones.point[fresh], program.L[fresh]
    d_tail = gathered_root(program.fem.gradient_change(step.dz), point, L)
    wanted = Vectors(program.c[fresh], gathered_root(program.fem.gradient(state.z), point, L))
    s = _chosen(state.s, fresh)
    left = (s - wanted) * (1.0 - step.keep)
    ds = Vectors(-left.head, d_tail - left.tail)
    none = Vectors(np.zeros(len(fresh)), np.zeros_like(d_tail))
    dy = _merged(step.dy, none, into.order)
    return Step(
        dz=step.dz,
        ds=_merged(step.ds, ds, into.order),
        dy=dy,
        d_tail=_merged(Vectors(step.ds.head, step.d_tail), Vectors(ds.head, d_tail), into.order).tail,
        keep=step.keep,
        primal=min(step.primal, BOUNDARY * soc.largest_step(s, ds)),
        dual=min(step.dual, BOUNDARY * soc.largest_step(state.y, dy)),
    )


def pruned(program: Program, state: State) -> tuple[Program, State]:
    """The program without half-spaces that are far away and carry next to nothing: the law tells if they are missed."""
    distance = state.s.margin() / program.c
    load = state.y.head * program.c
    cones = program.cones
    keep = steadied(cones, (load > IDLE * cones.sum(load)[cones.point]) | (distance < IDLE))
    few = make_program(program.fem, program.load, only(cones, keep), program.scale, program.total)
    which = np.flatnonzero(keep)
    return few, State(state.z, _chosen(state.s, which), _chosen(state.y, which))


def _chosen(v: Vectors, which: np.ndarray) -> Vectors:
    return Vectors(v.head.take(which), v.tail.T.take(which, axis=1).T)
