"""The elastic curtain: interior points find which half-spaces are taut, Newton's method finishes on the law itself.

Newton's method alone meets a kink wherever a point changes its half-spaces, and the more the stiffer the rings and the
finer the mesh. The interior-point iteration of `macro_fem.solvers.compliant` passes them by, whatever the mesh and the
compliance. It works in rounds, each with the half-spaces that the law finds missing; when none is missed by more than a
small part of the elastic strain, Newton's method is in its region of quadratic convergence and needs a handful of
steps, whose energy, residual and bound are those of the law.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from homogenize import MembraneLaw
from macro_fem.solvers import soc
from macro_fem.solvers.compliant import Program, State, follow, least_potential, make_program, measure
from macro_fem.solvers.cone_program import Fem, Iteration
from macro_fem.solvers.cones import Cones, first_cones, green_strain, only, steadied, with_cuts
from macro_fem.solvers.soc import Vectors
from macro_fem.solvers.status import load_scale
from rve.common.types import Array

FIRST_GAP = 10.0
"""Gap of the first state in energy scales."""
FIRST_TOLERANCE = 1e-2
"""Error to which the first round is solved; later ones as the violation falls."""
LOOSE = 0.5
"""A round is solved to this part of the violation that the one before left: more would be thrown away."""
LEAST_SHARE = 1e-5
"""A new round begins at least this far inside the cones: closer to the boundary steps get stuck."""
KEPT_LIFT = 0.1
"""Part of the central path's dual vector that is added to one that is kept from the round before."""
AROUND = 2.0
"""Half-spaces are asked for up to this many violations around a strain: that is how far the next round will move it."""
LOADED = 1e-3
"""Only points that bear this part of the greatest load get a half-space for their own direction of stress."""
PRUNED_ROUNDS = 4
"""After these first rounds idle half-spaces are dropped; not later, lest rounds go in circles."""
IDLE = 0.03
"""A half-space is idle below this part of a point's load and beyond this relative distance."""


@dataclass(frozen=True)
class ElasticOptions:
    """When the rounds end: `violation` relative to h + tr S / 2, `max_iterations` of all rounds, `max_rounds`."""

    violation: float = 1e-8
    max_iterations: int = 400
    max_rounds: int = 40


@dataclass(frozen=True)
class Approach:
    """Where the rounds ended: unknowns z (n,), stresses P (nq, d, 2) and S (nq, 3), a status as in `compliant.follow`.

    `lower` bounds the potential -l.z + stored energy from below, N mm; `unbalanced` forces are relative to the load.
    """

    z: Array
    P: Array
    S: Array
    status: str
    lower: float
    unbalanced: float
    rounds: int
    history: tuple[Iteration, ...] = field(repr=False)


def approach(
    fem: Fem,
    law: MembraneLaw,
    load: Array,
    start: Array,
    size: float,
    options: ElasticOptions = ElasticOptions(),
    cones: Cones | None = None,
) -> Approach:
    """The elastic curtain under generalised forces `load` (n,), N, up to half-spaces missed by `options.violation`.

    `start` (n,) are the first unknowns, `size` (mm) is the extent of the curtain; with the total load it makes the
    energy scale. `cones` are half-spaces to begin with instead of the law's own few.
    """
    total = load_scale(load, fem.weight)
    known = first_cones(law, len(fem.weight)) if cones is None else cones
    program = make_program(fem, load, known, law.compliance, total * size, total)
    state = _first_state(program, start)
    tolerance = FIRST_TOLERANCE
    history: list[Iteration] = []
    for number in range(1, options.max_rounds + 1):
        state, now, status, lines = follow(program, state, tolerance, options.max_iterations - len(history))
        history += lines
        if status not in ("converged", "stalled"):
            break
        E = green_strain(fem.gradient(state.z))
        S = program.stress(state.y)
        violation = _violation(law, E - S @ law.compliance.T)
        if violation.max() < options.violation and (tolerance <= options.violation or status == "stalled"):
            break
        tolerance = float(np.clip(LOOSE * violation.max(), options.violation, tolerance))
        new = missing(law, E - S @ law.compliance.T, S, violation, options.violation)
        if number <= PRUNED_ROUNDS:
            program, state = _pruned(program, state)
        program, state = _extended(program, state, new, law.compliance, float(violation.max()))
    else:
        status, now = "iterations", measure(program, state)
    return Approach(
        z=state.z,
        P=-program.pull(state.y)[0],
        S=program.stress(state.y),
        status=status,
        lower=least_potential(program, state, now),
        unbalanced=now.unbalanced,
        rounds=number,
        history=tuple(history),
    )


def _first_state(program: Program, z: Array) -> State:
    eps = np.zeros((len(program.fem.weight), 3))
    s = program.slack(z, eps).lifted(0.1 * program.c)
    return State(z, eps, s, soc.inverse(s, FIRST_GAP * program.scale / float(program.w.sum())))


def _violation(law: MembraneLaw, E: Array) -> Array:
    """By how much of h + tr S / 2 each E (n, 3) violates the law; tr S = 1."""
    cut = law.cut(E)
    return np.asarray(cut.violation / (cut.h + 0.5))


def missing(law: MembraneLaw, E: Array, S: Array, violation: Array, least: float) -> tuple[np.ndarray, Array, Array]:
    """Half-spaces to add: points (k,), S (k, 3), h (k,), each once, for locked strains E (n, 3) and stresses S (n, 3).

    At every violated point the worst one and those around, in the six directions of strain, as far as the next round
    may move the point; at loaded points the one along their own stress, which makes the dual value exact there.
    """
    prim = np.flatnonzero(violation > 0.3 * least)
    points, normals, heights = [], [], []
    for direction in np.vstack([np.zeros((1, 3)), np.eye(3), -np.eye(3)]):
        cut = law.cut(E[prim] + AROUND * violation[prim, None] * direction)
        points.append(prim)
        normals.append(cut.S)
        heights.append(cut.h)
    size = S[:, 0] + S[:, 2]
    own = prim[size[prim] > LOADED * size.max(initial=0.0)]
    points.append(own)
    normals.append(S[own] / size[own, None])
    heights.append(law.support(normals[-1]))
    point, normal, height = np.concatenate(points), np.vstack(normals), np.concatenate(heights)
    _, once = np.unique(np.column_stack([point, np.round(normal, 12)]), axis=0, return_index=True)
    return point[once], normal[once], height[once]


def _pruned(program: Program, state: State) -> tuple[Program, State]:
    """The program without half-spaces that are far away and carry next to nothing: the law tells if they are missed."""
    cones = program.cones
    load = (state.y.head + state.y.tail[:, 0]) * program.c
    keep = load > IDLE * np.add.reduceat(load, cones.first)[cones.point]
    keep = steadied(cones, keep | (state.s.margin() / program.c < IDLE))
    few = replace(program, cones=only(cones, keep), L=program.L[keep], c=program.c[keep], N=program.N[keep])
    return few, State(state.z, state.eps, _rows(state.s, keep), _rows(state.y, keep))


def _rows(v: Vectors, keep: np.ndarray) -> Vectors:
    return Vectors(v.head[keep], v.tail[keep])


def _extended(
    program: Program, state: State, new: tuple[np.ndarray, Array, Array], compliance: Array, violation: float
) -> tuple[Program, State]:
    """The program with half-spaces added and a start for it: z kept, cone vectors lifted by more than the violation."""
    point, S, h = new
    cones, order = with_cuts(program.cones, point, S, h)
    wider = make_program(program.fem, program.load, cones, compliance, program.scale, program.total)
    share = float(np.clip(5.0 * violation, LEAST_SHARE, 0.5))
    s = wider.slack(state.z, state.eps).lifted(share * wider.c)
    central = soc.inverse(s, share * program.scale / float(wider.w.sum()))
    head = np.concatenate([state.y.head, np.zeros(len(point))])[order]
    tail = np.concatenate([state.y.tail, np.zeros((len(point), state.y.tail.shape[1]))])[order]
    part = np.where(order < len(state.y.head), KEPT_LIFT, 1.0)
    y = Vectors(head + part * central.head, tail + part[:, None] * central.tail)
    return wider, State(state.z, state.eps, s, y)
