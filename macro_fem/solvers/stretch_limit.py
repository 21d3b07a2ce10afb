"""How much farther apart the supports could be, and curtains whose supports are as far apart as the mesh can stretch.

With the supported positions multiplied by a factor t, positions t x_held + T z, the largest factor is a cone program,

    maximise  t   over z, t   subject to   S:E(F(z, t)) <= h(S)   for every tensile S, at every point,

whose constraints are slack at z = 0, t = 0. t* > 1: the load over t* - 1 bounds multipliers. t* < 1: the supports are
out of reach, and a self-stress proves it (`docs/theory.md`, section 5). t* = 1: any multiple of the self-stress may be
added, and no interior point exists. So the law is relaxed by a relative stretch g: F / (1 + g) meets it, the curtain
x / (1 + g) hangs from supports drawn together by as much.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from homogenize import MembraneLaw
from macro_fem.fem.supported import SupportedFem
from macro_fem.solvers.central_path import solve_path
from macro_fem.solvers.cones import green_strain, least_slack
from macro_fem.solvers.path import PathOptions, PathResult
from macro_fem.solvers.status import AT_LIMIT, FREE, Reach
from macro_fem.solvers.walls import Walls
from rve.common import Array


@dataclass(frozen=True)
class ReachOptions:
    """Numbers of curtains at the stretch limit."""

    relaxations: tuple[float, ...] = (AT_LIMIT, 1e-3)
    """Relative stretches tried in turn: the answer is off by its square root, multipliers are its inverse."""
    least_gap: float = 1e-7
    """Least gap asked for there: double precision leaves no less beside so large multipliers."""
    gap: float = 1e-6
    """Accuracy of the factor. It must stay below AT_LIMIT; smaller values cost steps and decide nothing."""
    sure: float = 2.0
    """The search for the factor ends early once it exceeds 1 by this many times AT_LIMIT. Larger ones search longer."""
    most_cuts: int = 20


REACH = ReachOptions()

Solve = Callable[[SupportedFem, Array, PathOptions, Walls], PathResult]
"""A rigid solver of a discretisation from unknowns (n,), outside of half-spaces on nodes."""


def reach_of(fem: SupportedFem, law: MembraneLaw, start: Array, size: float) -> Reach:
    """How much farther apart the supports of a curtain of extent `size` (mm) could be; cheap where the unknowns `start`
    are slack everywhere.
    """
    far = 1.0 + REACH.sure * AT_LIMIT
    lower = _stretchable(law, fem.gradient(start), 1.0)
    if lower > far:
        return Reach(lower, np.inf)
    wider = movable(fem, size)
    if wider is None:
        return FREE
    load = np.zeros(wider.n)
    load[-1] = 1.0

    def bounds(z: Array, dual: float) -> Reach:
        return Reach(_stretchable(law, wider.gradient(z), float(z[-1]) / size), max(0.0, -dual / size))

    options = PathOptions(REACH.gap, REACH.gap, drawn=False, enough=lambda z, dual: bounds(z, dual).lower > far)
    result = solve_path(wider, law, load, np.zeros(wider.n), size, options)
    return bounds(result.z, result.dual)


def _stretchable(law: MembraneLaw, F: Array, factor: float) -> float:
    """`factor` times the largest t with t F (n, 2, 2) in the law, 0 for a factor below 0. Each half-space met lowers t
    to where |t F L|^2 = c^2: the one with the least slack at a small F need not be the first that t F fills.
    """
    t = 1.0
    for _ in range(REACH.most_cuts if factor > 0.0 else 0):
        slack = least_slack(law, green_strain(t * F))
        t /= float(np.sqrt(1.0 - min(slack, 1.0 - 1e-9)))
        if abs(slack) < 1e-12:
            break
    return t * max(0.0, factor)


def movable(fem: SupportedFem, size: float) -> SupportedFem | None:
    """The discretisation with one more unknown, `size` mm times the factor on held positions, which count from their
    mean; None if nothing is held apart.
    """
    held = ~fem.free.reshape(fem.x_held.shape)
    centre = np.where(held, fem.x_held, 0.0).sum(axis=0) / np.maximum(held.sum(axis=0), 1)
    apart = np.where(held, fem.x_held - centre, 0.0)
    if np.abs(apart).max() < 1e-12 * size:
        return None
    column = sparse.csc_matrix(apart.reshape(-1, 1) / size)
    return replace(fem, x_held=np.zeros_like(apart), tie=sparse.hstack([fem.T, column]).tocsc())


def solve_at_stretch_limit(
    solve: Solve, fem: SupportedFem, start: Array, options: PathOptions, reach: Reach, walls: Walls
) -> tuple[PathResult, float]:
    """The answer for a law relaxed by a little more than the supports are out of reach, with its own bounds, and the
    relaxation; the last one tried if none converges.
    """
    loose = replace(options, gap=max(REACH.least_gap, options.gap))
    for more in REACH.relaxations:
        relaxation = max(0.0, 1.0 / reach.lower - 1.0) + more
        nearer = fem.moved(fem.x_held / (1.0 + relaxation))
        near_walls = replace(walls, offset=walls.offset / (1.0 + relaxation))
        result = solve(nearer, start / (1.0 + relaxation), loose, near_walls)
        if result.status == "converged":
            break
    scale = 1.0 + relaxation
    return replace(result, z=scale * result.z, primal=scale * result.primal, dual=scale * result.dual), relaxation
