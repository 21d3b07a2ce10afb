"""The elastic curtain of a discrete problem: interior points first, then Newton's method on the law itself."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from macro_fem.fem.assembly import deformation_gradient
from macro_fem.solution import CurtainSolution, Problem, gathered_start, spread_allowance, spread_tension, unit_tensors
from macro_fem.solvers import newton
from macro_fem.solvers.compliant import REACH
from macro_fem.solvers.cones import Cones, green_strain, times_triple
from macro_fem.solvers.elastic import Approach, ElasticOptions, approach
from macro_fem.solvers.status import FREE, Accuracy, Reach, load_scale
from rve.common.types import Array

POLISH = 40
"""Steps of Newton's method: it takes a handful, or kinks of what hangs slack keep it busy for nothing."""
IDLE_STEPS = 3
"""Its steps in a row without progress after which the interior-point answer is as good."""
CERTIFIED = 1e-7
"""Relative gap, unbalanced forces and violation below which the interior-point answer is one."""
BALANCED = 1e-7
"""Unbalanced forces over the loads below which the answer of Newton's method is one."""


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
    start = problem.fem.unknowns(gathered_start(problem))
    found = approach(problem.fem, problem.law, load, start, problem.mesh.size, options, cones)
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
    fem, nodes = problem.fem, problem.disc.nodes
    options = newton.NewtonOptions(max_iterations=most, idle_steps=IDLE_STEPS)
    answer = newton.solve(fem, problem.law, problem.force, fem.positions(found.z) - nodes, options)
    F = deformation_gradient(problem.disc, answer.u)
    S = problem.law.response(green_strain(F)).S
    return CurtainSolution(
        problem=problem,
        stop=answer.stop,
        asked=Accuracy(REACH * BALANCED, BALANCED, CERTIFIED),
        x=nodes + answer.u,
        F=F,
        P=times_triple(F, S),
        S=S,
        primal=answer.potential,
        dual=answer.potential - answer.energy_bound,
        iterations=len(answer.history),
        wall_s=0.0,
        elastic=True,
        history=answer.history,
    )
