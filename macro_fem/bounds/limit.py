"""The limit of a curtain whose rings flow: the largest factor on all of its loads with which it has an answer.

It is a cone program of its own (`macro_fem.solvers.cone_program`), whose dual variables are stresses in balance with
the factored load and within strength, and whose unknowns are the way on which rings flow under it:

    f  =  min over z of  sum of w tau(F(z)) / l.z,    tau(F) = max over the law of |F L| / N,    supports at 0.

In P1 and in P2 with tau at the corners F is linear and tau convex, so that this is an upper bound of the factor of the
continuous curtain; the hybrid element of `macro_fem.bounds.equilibrated` gives a lower one: its stresses are linear,
and so within strength where they are at the corners. Around held and loaded points the mesh does not flow
(`macro_fem.curtain.problem.strength_at_points`).
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from macro_fem.bounds.equilibrated import dual_disc, dual_problem
from macro_fem.bounds.interval import admissible_problem, error_map, mark
from macro_fem.curtain import CurtainProblem, make_problem, strength_at_points
from macro_fem.fem.supported import SupportedFem
from macro_fem.scene.meshing.mesh import refine
from macro_fem.solvers.central_path import solve_path
from macro_fem.solvers.path import Flow, PathOptions, PathResult, Terms
from macro_fem.solvers.status import load_scale
from macro_fem.solvers.walls import Walls
from rve.common import Array, part_of

PATH_OF_LIMITS = PathOptions(gap=1e-6, violation=1e-5, drawn=False)
"""How limits are solved. Larger gaps widen their interval."""
MARGIN = 1e-5
"""Part by which factors are lowered: nearer to the limit shapes grow so far that they are not found."""


@dataclass(frozen=True, eq=False)
class CurtainLimit:
    """Bounds of the limit of a curtain on one mesh, factors on all loads; inf without loads. factor: that of the mesh,
    no more than `upper`; error (n_cells,): share of each triangle in upper - lower; status of the solvers; is_coarse:
    whether cells at held or loaded points are too large for a lower bound, which is 0 then; the problem it is that of.
    """

    factor: float
    lower: float
    upper: float
    error: Array
    status: str
    is_coarse: bool
    problem: CurtainProblem
    wall_s: float

    @property
    def is_passed(self) -> bool:
        """Whether a mechanism proves that the loads as they are have no answer."""
        return self.upper < 1.0


def limit_path(
    problem: CurtainProblem, fem: SupportedFem, force: Array, walls: Walls, options: PathOptions = PATH_OF_LIMITS
) -> PathResult:
    """The limit of a discretisation under nodal forces (n_nodes, d): `dual` and `primal` over load times size bound
    it."""
    at_rest = fem.moved(np.zeros_like(fem.x_held))
    load, law = fem.gather(force), problem.plastic_law.parts(is_limit=True)[0]
    flow = Flow(strength_at_points(problem, fem.disc), (law,), is_limit=True)
    terms = Terms(walls=replace(walls, offset=0.0 * walls.offset), flow=flow)
    return solve_path(at_rest, law, load, np.zeros(fem.n), problem.mesh.size, options, terms)


def curtain_limit(problem: CurtainProblem) -> CurtainLimit:
    """The limit of a problem in P1, or of one in P2 with the law at the corners of triangles, and its bounds.

    The lower bound is 0 where cells at held or loaded points reach beyond the disk of one cell of the weave: the hybrid
    element takes forces at points by the edges there.
    """
    begin, disc, mesh, load = time.perf_counter(), problem.disc, problem.mesh, problem.fem.gather(problem.force)
    if not load.any():
        return CurtainLimit(np.inf, np.inf, np.inf, np.zeros(disc.n_cells), "converged", False, problem, 0.0)
    flat = problem
    if disc.element != "P1":
        scene = replace(problem.scene, mesh=replace(problem.scene.mesh, element="P1"))
        flat = make_problem(scene, problem.law.own, mesh, problem.factor)
    hybrid = dual_disc(mesh)
    dual = dual_problem(flat, np.zeros((hybrid.n_nodes, problem.fem.d)))
    above = limit_path(problem, problem.fem, problem.force, problem.walls)
    below = limit_path(problem, dual.fem, dual.force, dual.walls)
    assert above.tau is not None
    scale, scale_below = (load_scale(one, disc.weight) * mesh.size for one in (load, dual.fem.gather(dual.force)))
    sides = mesh.sides[np.append(dual.facet, np.flatnonzero(dual.load_cost)).astype(int)]
    is_coarse = bool(np.hypot(*sides.T).max(initial=0.0) > problem.disk_of_cell)
    F, tau = problem.fem.gradient_change(above.z), above.tau
    if disc.n_quad == 1:
        F, tau = np.tile(F, (3, 1, 1)), np.tile(tau, 3)
    way = float(load @ above.z)  # 0 where the path stopped before anything moved: no mechanism is known
    factor, lower = (1.0 - MARGIN) * above.dual / scale, (1.0 - MARGIN) * below.dual / scale_below
    return CurtainLimit(
        factor=max(0.0, factor),
        lower=0.0 if is_coarse else max(0.0, min(lower, factor)),
        upper=above.primal / scale if way else np.inf,
        error=error_map(F / (way or 1.0), dual, replace(below, psi=tau / (way or 1.0))),
        status=above.status if is_coarse or above.status != "converged" else below.status,
        is_coarse=is_coarse,
        problem=problem,
        wall_s=time.perf_counter() - begin,
    )


def limit_levels(problem: CurtainProblem) -> Iterator[CurtainLimit]:
    """The limit of a problem and those on `solver.adapt` refinements of its mesh, where its bounds differ."""
    scene, law = problem.scene, problem.law.own
    for number in range(scene.solver.adapt + 1):
        with part_of(f"{problem.disc.n_cells} cells, limit"):
            limit = curtain_limit(problem)
        yield limit
        # Relative width of the interval at which meshes are refined no more.
        if limit.upper - limit.lower <= 1e-4 * limit.upper:
            return
        if number < scene.solver.adapt:
            mesh = refine(problem.mesh, mark(limit.error))
            problem = admissible_problem(scene, law, mesh, problem.factor)
