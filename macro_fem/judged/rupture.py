"""Rings drawn to strings: the tension in their wire, and the live loads under which it breaks, as a band.

Published strings broke at 0.30 to 0.56 of twice the ultimate load of their wire, so what follows from them, factor on
the live loads, way, and energy, are intervals too (`rve.wire.rupture_stress`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from scipy.optimize import brentq

from homogenize.laws import PlasticLaw
from macro_fem.bounds.interval import bound
from macro_fem.curtain import CurtainProblem, CurtainSolution, solve_problem
from macro_fem.scene.loads import nodal_forces
from macro_fem.scene.moving import scaled
from macro_fem.scene.scene import Scene
from macro_fem.scene.tables import FACTORED, Bar, Load
from macro_fem.solvers.status import Status
from rve.common import Array, NotConverged, part_of
from rve.wire import rupture_stress

MOST_DOUBLED = 20
"""How often loads are doubled or halved at most to find those that break strings."""
ROUGH = 1e-3
"""Logarithm of a factor to which it is found: tension grows up to twice as fast as the load."""


@dataclass(frozen=True)
class Rupture:
    """Where strings break, as the least and the largest of: tension over the area of the wire; factor on the live
    loads; mean way of the loaded points along them from where they are drawn; plastic work until then, the least one
    that of the continuous curtain where the scene asks for bounds. As `Limit` has them.
    """

    rupture_stress_N_per_mm2: list[float]
    rupture_factor: list[float]
    way_at_rupture_mm: list[float]
    energy_until_rupture_N_mm: list[float]


def string_stress(solution: CurtainSolution) -> float | None:
    """The largest tension over the area of the wire, N/mm2; None where rings never are strings."""
    if (S := solution.inner.S_strings) is None:
        return None
    law = solution.problem.plastic_law
    assert isinstance(law.own, PlasticLaw)
    if law.own.strings is None:
        return None
    return float(law.own.strings.wire.collapse_at(law.in_weave(S)).max())


def live_way(solution: CurtainSolution) -> float | None:
    """The mean way in mm of the loaded points along the live loads, from where they are drawn; None without any."""
    live = _live_loads(solution.problem)
    size = float(np.linalg.norm(live, axis=1).sum())
    return float((live * solution.displacement).sum() / size) if size else None


def _live_loads(problem: CurtainProblem) -> Array:
    """The live loads (n_nodes, d) in N, whole."""
    scene, disc, cell = problem.scene, problem.exact, problem.law.cell
    return nodal_forces(scene, problem.mesh, disc, cell) - nodal_forces(scene, problem.mesh, disc, cell, 0.0)


def _times(scene: Scene, factor: float) -> Scene:
    """The scene with its live loads times a factor."""
    items = tuple(
        scaled(one, factor, FACTORED) if isinstance(one, Load) and not isinstance(one, Bar) else one
        for one in scene.items
    )
    return replace(scene, items=items)


def find_rupture(solution: CurtainSolution) -> Rupture | None:
    """Where strings break under the live loads of a solved curtain, moves as they are; None without live loads, strings
    or an ultimate stress. NotConverged where a curtain on the way is not solved, or no load breaks strings.
    """
    problem = solution.problem
    assert isinstance(problem.plastic_law.own, PlasticLaw)
    strings = problem.plastic_law.own.strings
    band = None if strings is None else rupture_stress(strings.wire.material)
    live = _live_loads(problem)
    if band is None or not live.any():
        return None

    @cache
    def at(log: float) -> CurtainSolution:
        factor = float(np.exp(log))
        with part_of(f"{problem.disc.n_cells} cells, {factor:.3g} times the live loads"):
            dead = problem.dead + (factor - problem.factor) * live
            found = solve_problem(replace(problem, scene=_times(problem.scene, factor), dead=dead), solution)
        if found.status != Status.CONVERGED:
            raise NotConverged(f"the curtain under {factor:.3g} times the live loads ends as {found.status}")
        return found

    def excess(log: float, limit: float) -> float:
        return (string_stress(at(log)) or 0.0) / limit - 1.0

    logs = sorted(_crossing(partial(excess, limit=limit)) for limit in band)
    first, last = map(at, logs)
    ways, energies = ([of(first) or 0.0, of(last) or 0.0] for of in (live_way, lambda one: one.plastic_work))
    if problem.scene.solver.is_bounded:
        is_known = np.allclose(_live_loads(first.problem), np.exp(logs[0]) * live)  # of loads of plugins it may not be
        energies[0] = max(0.0, energies[0] - bound(first).gap) if is_known else 0.0
    return Rupture(list(band), np.exp(logs).tolist(), ways, energies)


def _crossing(excess: Callable[[float], float]) -> float:
    """The logarithm of the factor at which a rising function is 0; NotConverged if it does not change its sign."""
    step = np.log(2.0) * (1.0 if excess(0.0) < 0.0 else -1.0)
    for k in range(MOST_DOUBLED):
        ends = k * step, (k + 1) * step
        if excess(ends[1]) * step >= 0.0:
            return float(brentq(excess, *ends, xtol=ROUGH))
    raise NotConverged("no live load breaks the strings, or the other loads alone do")
