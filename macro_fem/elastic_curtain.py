"""Newton's method on the law itself, from the answer of the cone program."""

from __future__ import annotations

from dataclasses import dataclass, replace

from macro_fem.fem.assembly import deformation_gradient
from macro_fem.fem.membrane import first_piola
from macro_fem.solution import CurtainSolution
from macro_fem.solvers import newton
from macro_fem.solvers.cone_program import REACH
from macro_fem.solvers.cones import green_strain
from macro_fem.solvers.status import Accuracy
from rve.common.types import Array
from rve.common.values import Options, number, whole


@dataclass(frozen=True)
class PolishOptions(Options):
    """When Newton's method stops; InputError for values that make no sense."""

    steps: int = whole(40, least=1, most=10_000)
    """Maximum steps. Some are enough from a good start; kinks in slack regions can stall it for ever."""
    idle_steps: int = whole(3, least=1, most=1000)
    """Steps in a row without progress that end it. More rarely find a way out."""
    balanced: float = number(1e-7, above=0.0, most=1.0)
    """Unbalanced forces over the loads below which its answer is one."""


POLISH = PolishOptions()
"""The defaults."""


def polished(found: CurtainSolution, most: int, options: PolishOptions = POLISH) -> CurtainSolution:
    """At most `most` more steps on the elastic law itself, from the answer `found`; `found` if they balance less.

    For laws whose response is not exactly ideal locking with a compliance, such as nets whose fibres lie in one line.
    The dual value is the potential less the bound that convexity puts on its error.
    """
    problem, nodes = found.problem, found.problem.fem.reference
    how = newton.NewtonOptions(max_iterations=min(options.steps, most), idle_steps=options.idle_steps)
    answer = newton.solve(problem.fem, problem.elastic_law, problem.force, found.displacement, how)
    F: Array = deformation_gradient(problem.disc, answer.u)
    S = problem.elastic_law.response(green_strain(F)).S
    history = (*found.history, *answer.history)
    better = replace(
        found,
        stop=answer.stop,
        asked=Accuracy(REACH * options.balanced, options.balanced, options.balanced),
        x=nodes + answer.u,
        F=F,
        P=first_piola(F, S),
        S=S,
        primal=answer.potential,
        dual=answer.potential - answer.energy_bound,
        iterations=len(history),
        cones=None,
        history=history,
    )
    is_better = better.asked.is_met(better.evidence) or better.residual < found.residual
    return better if is_better else replace(found, iterations=len(history), history=history)
