"""One implicit step of a curtain in motion: the convex program of the static solver with the mass term added.

    minimise  |x - x_hat|^2_M / (2 (beta h)^2) + damping and drag - f.x + stored energy   over admissible x

Nodes of bodies with mass follow those of the curtain (`macro_fem.fem.supported`). Round obstacles and bodies enter by
tangent half-spaces, taken where the curtain would go, and found again at the answer until they no longer turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from homogenize import MembraneLaw
from macro_fem.fem.supported import SupportedFem
from macro_fem.motion.scheme import Difference
from macro_fem.solvers.central_path import solve_path
from macro_fem.solvers.cones import Cones
from macro_fem.solvers.inertia import Inertia, times
from macro_fem.solvers.path import PathOptions, PathResult, Terms
from macro_fem.solvers.walls import Walls
from rve.common import Array


@dataclass(frozen=True, eq=False)
class Forces:
    """What acts on the nodes (n, d) at the end of a step, N.

    dead: weight; live: other loads that do not depend on the velocity. drag: symmetric blocks C (n, d, d) in N s/mm of
    forces -C v that belong to `live`; damping (n,) or one for all: 1/s, of forces -damping M v.
    """

    dead: Array
    live: Array
    drag: Array | None = None
    damping: Array | float = 0.0


@dataclass(frozen=True, eq=False)
class Moving:
    """The discrete curtain that moves: masses (n,) in N s2/mm of all nodes, the law, its compliance (3, 3), its size in
    mm."""

    fem: SupportedFem
    law: MembraneLaw
    mass: Array
    compliance: Array
    size: float


Tangents = Callable[[Array], Walls | None]
"""Half-spaces of obstacles and bodies that touch them where they are closest to nodes at x (n, d)."""
ROUNDS, SETTLED = 8, 1e-4
"""How often tangent half-spaces are found anew at most, and reactions that may still turn, over all forces."""
GAP, FIRST_GAP = 1e-10, 1.0
"""Relative gap that a step is solved to, and that of its first state in energy scales."""


@dataclass(frozen=True, eq=False)
class Stepped:
    """The end of a step: positions x (n, d), the solver's record, its half-spaces."""

    x: Array
    result: PathResult
    walls: Walls | None

    @property
    def pushes(self) -> Array:
        """Forces of half-spaces on all nodes (n, d), N."""
        if self.walls is None:
            return np.zeros_like(self.x)
        return self.walls.nodal(self.result.wall_forces, len(self.x))


def solve_step(
    moving: Moving, change: Difference, forces: Forces, x: Array, cones: Cones | None, tangents: Tangents | None = None
) -> Stepped:
    """The end of a step from positions x (n, d), by the half-spaces `cones` of the step before."""
    fem, inertia = moving.fem, inertia_of(moving, change, forces)
    load = fem.gather(forces.dead + forces.live)
    path = PathOptions(gap=GAP, violation=1e-9, cones=cones, drawn=False, first_gap=FIRST_GAP)
    place, walls = x, None if tangents is None else tangents(x)
    for rounds in range(1, ROUNDS + 1):
        terms = Terms(moving.compliance, walls=walls, inertia=inertia)
        result = solve_path(fem, moving.law, load, fem.unknowns(place), moving.size, path, terms)
        place = fem.positions(result.z)
        if walls is None or tangents is None or not result.converged or rounds == ROUNDS:
            break
        anew = tangents(place)
        assert anew is not None
        turned = float(result.wall_forces @ np.linalg.norm(anew.normal - walls.normal, axis=1))
        turned /= float(np.abs(result.wall_forces).sum() + np.abs(load).sum() + inertia.force_scale)
        if turned < SETTLED:
            break
        walls, path = anew, replace(path, cones=result.cones)
    return Stepped(place, result, walls)


def inertia_of(moving: Moving, change: Difference, forces: Forces) -> Inertia:
    """The quadratic term of a step: W x_hat = M (X + beta h V) / (beta h)^2 + (damping M + C) X / (beta h)."""
    d, mass = change.X.shape[1], moving.mass
    m, b = mass / change.beta_h**2, 1.0 / change.beta_h
    resist = (b * forces.damping * mass)[:, None, None] * np.eye(d)
    if forces.drag is not None:
        resist = resist + b * forces.drag
    W = m[:, None, None] * np.eye(d) + resist
    aim = m[:, None] * change.x_hat + times(resist, change.X)
    x_hat: Array = np.linalg.solve(W, aim[:, :, None])[:, :, 0].astype(float)
    momentum = float((mass[:, None] * np.abs(change.V)).sum()) / change.beta_h
    kinetic = 0.5 * float((mass[:, None] * change.V**2).sum())
    return Inertia(moving.fem, W, x_hat, momentum, kinetic)
