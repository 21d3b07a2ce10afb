"""Bodies that a curtain stays outside of, and how they and supports move into place.

Which side of a body a node is on is decided before the first round: by the last load step, or by where the sheet starts
([start], or the curtain without bodies), pushed along by the bodies as they move into place.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from macro_fem.curtain.problem import CurtainProblem, tangent_walls
from macro_fem.curtain.solution import CurtainSolution
from macro_fem.fem.discretization import FINE
from macro_fem.scene.obstacles import PlacedObstacle
from macro_fem.solvers.walls import Walls
from rve.common import Array, part_of


@dataclass(frozen=True)
class ContactOptions:
    """Numbers of the way on which supports and bodies move into place."""

    strides: int = 40
    """Parts into which a move of bodies is cut while they push nodes along. More follow round bodies better."""
    pace: float = 0.5
    """Largest move of a body at once, over half its least width. Larger ones may leave nodes beside it."""
    shortest: float = 1.0 / 32
    """Least part of the way of supports and bodies that is tried at once before the curtain counts as blocked."""


CONTACT = ContactOptions()

Solve = Callable[[CurtainProblem, CurtainSolution | None], CurtainSolution]
"""The solver of a convex problem, from a curtain before."""


class Watch:
    """How deep points of the mesh, a third of half a body's least width apart, have been inside it, over that half.

    Cells at held nodes are left out, as supports take these along.
    """

    def __init__(self, problem: CurtainProblem, deepest: float) -> None:
        disc, half = problem.disc, min([body.obstacle.breadth for body in problem.bodies], default=np.inf)
        fine = max(FINE, math.ceil(3.0 * problem.mesh.longest_side / half))
        lattice = disc.lattice_of(fine)
        self.lattice = lattice[np.flatnonzero(abs(lattice) @ problem.fem.held.any(axis=1) == 0.0)]
        self.deepest = deepest

    def look(self, bodies: Sequence[PlacedObstacle], before: Array, after: Array) -> None:
        """Look at straight ways between two shapes (n_nodes, d)."""
        start, end = self.lattice @ before, self.lattice @ after
        for body in bodies:
            half = body.obstacle.breadth
            self.deepest = body.deepest(start, end, self.deepest * half) / half


def approach(
    problem: CurtainProblem,
    first: CurtainSolution,
    wind: Array,
    start: CurtainSolution | None,
    solve: Solve,
    watch: Watch,
) -> tuple[list[Walls], CurtainSolution]:
    """The first tangent half-spaces and the curtain in them, after supports and bodies have moved into place: in as
    large strides as leave a state in the half-spaces found before. After `CONTACT.shortest` the curtain says it is
    blocked."""
    held = np.where(problem.fem.held, first.x, 0.0)
    before = 0.0 if start is None else start.problem.factor
    # the part of their moves that no body should exceed at once: farther, and it may pass between nodes
    parts = [one.obstacle.breadth / max(float(np.linalg.norm(one.obstacle.move)), 1e-300) for one in problem.bodies]
    stride = max(
        CONTACT.shortest, min([1.0, *(CONTACT.pace * part / max(problem.factor - before, 1e-300) for part in parts)])
    )
    done, x, last = 0.0, first.x, start
    while True:
        part = min(1.0, done + stride)
        factors = (before + done * (problem.factor - before), before + part * (problem.factor - before))
        bodies = tuple(replace(one, factor=factors[1]) for one in problem.bodies)
        fem = problem.fem.moved((1.0 - part) * held + part * problem.fem.x_held) if part < 1.0 else problem.fem
        pushed, here = _push_out(problem, x, *factors, watch), replace(problem, fem=fem, bodies=bodies)
        tangents = [tangent_walls(body, fem, pushed) for body in bodies]
        with part_of(f"moving into place, {100.0 * done:.0f} % done"):
            found = solve(pose(here, tangents, wind), last)
        if found.status == "infeasible" and stride > CONTACT.shortest:
            stride *= 0.5
            continue
        watch.look(bodies, pushed, found.x)
        if found.status == "infeasible" or part == 1.0:
            return tangents, found
        done, x, last = part, found.x, found


def pose(problem: CurtainProblem, tangents: list[Walls], wind: Array) -> CurtainProblem:
    """The convex problem with tangent half-spaces and dead wind (n_points, d) in N/mm2."""
    walls = Walls.joined([problem.walls, *tangents])
    return replace(problem, bodies=(), winds=(), wind=wind if problem.winds else None, walls=walls)


def _push_out(problem: CurtainProblem, x: Array, before: float, after: float, watch: Watch) -> Array:
    """Places (n_nodes, d) after bodies, from one share of their moves to another, have pushed the nodes they meet."""
    for factor in np.linspace(before, after, CONTACT.strides + 1)[1:]:
        for body in problem.bodies:
            if any(body.obstacle.move):
                here = replace(body, factor=float(factor))
                x = x + np.maximum(-here.gap(x), 0.0)[:, None] * here.normal(x)
                watch.look([here], x, x)
    return x
