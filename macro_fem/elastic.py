"""The elastic curtain: interior points find which half-spaces are taut, Newton's method finishes on the law itself.

Newton's method alone meets a kink wherever a point changes its half-spaces, and the more the stiffer the rings and the
finer the mesh. The interior-point iteration of `macro_fem.compliant` passes them by, whatever the mesh and the
compliance. It works in rounds, each with the half-spaces that the law finds missing; when none is missed by more than a
small part of the elastic strain, Newton's method is in its region of quadratic convergence and needs a handful of
steps, whose energy, residual and bound are those of the law.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np

from homogenize.law import Array, MembraneLaw
from macro_fem import newton, soc
from macro_fem.assembly import deformation_gradient
from macro_fem.compliant import REACH, Program, State, follow, least_potential, make_program, measure
from macro_fem.cones import Cones, first_cones, green_strain, only, steadied, times_triple, with_cuts
from macro_fem.interior import Iteration
from macro_fem.soc import Vectors
from macro_fem.solution import CurtainSolution, Problem, gathered_start, spread_allowance, spread_tension, unit_tensors
from macro_fem.status import FREE, Accuracy, Reach, load_scale

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
POLISH = 40
"""Steps of Newton's method: it takes a handful, or kinks of what hangs slack keep it busy for nothing."""
IDLE_STEPS = 3
"""Its steps in a row without progress after which the interior-point answer is as good."""
CERTIFIED = 1e-7
"""Relative gap, unbalanced forces and violation below which the interior-point answer is one."""
BALANCED = 1e-7
"""Unbalanced forces over the loads below which the answer of Newton's method is one."""
STOPS = {
    newton.NewtonStatus.CONVERGED: "closed",
    newton.NewtonStatus.ITERATION_LIMIT: "iterations",
    newton.NewtonStatus.ROUND_OFF: "stalled",
    newton.NewtonStatus.STALLED: "stalled",
    newton.NewtonStatus.NOT_CONVEX: "not_convex",
    newton.NewtonStatus.NOT_FINITE: "not_finite",
}
"""Why Newton's method stopped, in the words of `macro_fem.status`."""


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
    problem: Problem, load: Array, options: ElasticOptions = ElasticOptions(), cones: Cones | None = None
) -> Approach:
    """The elastic curtain under generalised forces `load` (n,) up to half-spaces missed by `options.violation`.

    `cones` are half-spaces to begin with instead of the law's own few.
    """
    fem, law = problem.fem, problem.law
    total = load_scale(load, fem.weight)
    known = first_cones(law, len(fem.weight)) if cones is None else cones
    program = make_program(fem, load, known, law.compliance, total * problem.mesh.size, total)
    state = _first_state(program, fem.unknowns(gathered_start(problem)))
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


def solve_elastic(problem: Problem, reach: Reach = FREE, cones: Cones | None = None) -> CurtainSolution:
    """The elastic curtain of a discrete problem; `cones` are half-spaces to begin with.

    `reach` tells how far apart the supports are. Out of reach by more than the loads themselves stretch the rings ends
    as "infeasible": an answer would be the elasticity of rings drawn beyond what the law was made for.
    """
    begin = time.perf_counter()
    most = problem.scene.solver.max_iterations
    tension = spread_tension(problem)
    load = problem.fem.gather(problem.force) + problem.fem.force(tension * unit_tensors(problem))
    if reach.is_out and reach.excess < elastic_stretch(problem):
        reach = replace(reach, upper=1.0)
    options = ElasticOptions(max_iterations=0 if reach.is_out else most)
    found = approach(problem, load, options, cones)
    answer = replace(_certified(problem, found, load, tension), reach=reach)
    if not reach.is_out and len(found.history) < most:
        polished = replace(_polished(problem, found, min(POLISH, most - len(found.history))), reach=reach)
        history = (*found.history, *polished.history)
        answer = replace(_better(answer, polished), history=history, iterations=len(history))
    return replace(answer, wall_s=time.perf_counter() - begin)


def _better(certified: CurtainSolution, polished: CurtainSolution) -> CurtainSolution:
    """Newton's answer, unless the interior-point one is good enough and balances better."""
    is_answer = certified.asked.is_met(certified.evidence)
    is_polished = polished.asked.is_met(polished.evidence)
    return certified if is_answer and not (is_polished and polished.residual <= certified.residual) else polished


def elastic_stretch(problem: Problem) -> float:
    """About how far the loads of a scene stretch its rings: load times size over area, times the mean compliance."""
    line_load = float(np.abs(problem.force).sum()) * problem.mesh.size / float(problem.disc.weight.sum())
    return line_load * float(np.trace(problem.law.compliance)) / 3.0


def _certified(problem: Problem, found: Approach, load: Array, tension: float) -> CurtainSolution:
    """The interior-point answer with its own bound, valid for the load without the spread tension too."""
    fem = problem.fem
    x, F = fem.positions(found.z), fem.gradient(found.z)
    stored = float(problem.disc.weight @ problem.law.response(green_strain(F)).energy)
    gap = stored - float(load @ found.z) - found.lower
    primal = stored - float((problem.force * (x - problem.disc.nodes)).sum())
    allowance = 2.0 * spread_allowance(problem, tension)
    scale = load_scale(problem.force, problem.disc.weight) * problem.mesh.size
    return CurtainSolution(
        problem=problem,
        stop="closed" if found.status == "converged" else found.status,
        asked=Accuracy(CERTIFIED + 2.0 * allowance / scale, CERTIFIED, CERTIFIED),
        x=x,
        F=F,
        P=found.P,
        S=found.S,
        primal=primal,
        dual=primal - gap - allowance,
        iterations=len(found.history),
        wall_s=0.0,
        elastic=True,
        history=found.history,
        tension=tension,
    )


def _polished(problem: Problem, found: Approach, most: int) -> CurtainSolution:
    """At most `most` steps of Newton's method on the law itself, from the interior-point answer.

    The dual value is the potential less the bound that convexity puts on its error.
    """
    supports, nodes = problem.supports, problem.disc.nodes
    fixed = supports.mask | supports.pinned
    membrane = newton.Membrane(
        problem.disc, problem.law, fixed, supports.positions - nodes, problem.force, supports.tie
    )
    options = newton.NewtonOptions(max_iterations=most, soften_after=most, idle_steps=IDLE_STEPS)
    answer = newton.solve(membrane, options, start=problem.fem.positions(found.z) - nodes)
    last = answer.steps[-1]
    F = deformation_gradient(problem.disc, last.u)
    S = problem.law.response(green_strain(F)).S
    return CurtainSolution(
        problem=problem,
        stop=STOPS[last.status],
        asked=Accuracy(REACH * BALANCED, BALANCED, CERTIFIED),
        x=nodes + last.u,
        F=F,
        P=times_triple(F, S),
        S=S,
        primal=last.potential,
        dual=last.potential - last.energy_bound,
        iterations=answer.statistics.iterations,
        wall_s=0.0,
        elastic=True,
        history=answer.history,
    )
