"""The hybrid problem that belongs to a P1 curtain: supports, bars, tethers of points and walls of its elements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from macro_fem.bounds.equilibrated import (
    DualMesh,
    DualProblem,
    Tethers,
    dead_and_live,
    dual_mesh,
    edges_at_corner,
)
from macro_fem.fem.cells import in_space_of
from macro_fem.scene.sites import Held, Sliding, sliding_nodes
from macro_fem.scene.supports import Supports, pin_sliding, straight_ties
from macro_fem.scene.tables import Bar
from macro_fem.solution import CurtainSolution, slackened
from macro_fem.solvers.walls import Walls
from rve.common.types import Array


@dataclass(frozen=True)
class BoundOptions:
    """How the dual program is solved."""

    gap: float = 2e-5
    """Relative gap. Larger gaps weaken the bound; that of any mesh is far larger than the default."""
    violation: float = 5e-3
    """Violation of the law that may be left: a half-space left out weakens the bound, too."""
    inward: float = 0.05
    """How far the start is drawn from the P1 curtain to its slack start. On the curtain itself no cone has room left
    and the first steps get stuck; farther away more steps are needed."""


BOUND = BoundOptions()
"""The defaults."""


def dual_problem(solution: CurtainSolution, factor: float, options: BoundOptions = BOUND) -> DualProblem:
    """The hybrid problem that belongs to a P1 solution."""
    problem = solution.problem
    scene, mesh = problem.scene, problem.mesh
    dual = dual_mesh(mesh)
    force, cost = dead_and_live(scene, dual, problem.law, factor, problem.wind)
    d = problem.fem.d
    mask = np.zeros((dual.disc.n_nodes, d), bool)
    positions = in_space_of(dual.disc.nodes, d)
    near_point = slackened(solution, options.inward)
    tethers: list[tuple[np.ndarray, np.ndarray, Array]] = []
    at_points = [held for held in problem.supports.held if not len(held.facets)]
    for held in at_points:
        for node, component, centre in zip(held.nodes, held.mask, held.positions, strict=True):
            facet, near = edges_at_corner(dual, int(node))
            for end in range(2):
                mask[2 * facet + end] |= component
                positions[2 * facet + end] = near_point[dual.facets[end, facet]]
            tethers.append((facet, near, np.where(component, centre, np.nan) * np.ones((len(facet), 1))))
    whole: np.ndarray = np.asarray(mask.all(axis=1))
    lines: list[tuple[np.ndarray, Array]] = []
    for held in problem.supports.held:
        if len(held.facets):
            _hold_edge(dual, held, mask, positions)
            nodes = np.concatenate([2 * held.facets, 2 * held.facets + 1])
            if held.slide is None:
                whole[nodes] = mask[nodes].all(axis=1)
            else:
                lines.append((nodes, held.slide))
    none = Sliding.none(d)
    sliding = sliding_nodes(lines, whole) if lines else none
    supports = Supports(problem.supports.held, mask, positions, sliding, none, _bars(solution, dual))
    supports = pin_sliding(supports, dual.disc, force, scene.source)
    parts = [np.concatenate(part) for part in zip(*tethers, strict=True)] if tethers else []
    empty = Tethers(np.zeros(0, int), np.zeros(0, int), np.zeros((0, d)))
    fem, walls = supports.fem(dual.disc), _walls(problem.walls, dual)
    return DualProblem(dual, fem, force, Tethers(*parts) if parts else empty, cost, walls)


def _hold_edge(dual: DualMesh, held: Held, mask: np.ndarray, positions: Array) -> None:
    """Holds both ends of every facet of an edge support where the primal support holds the corners; in place."""
    number = np.full(dual.mesh.mesh.p.shape[1], -1)
    number[held.nodes] = np.arange(len(held.nodes))
    for end in range(2):
        which = number[dual.facets[end, held.facets]]
        node = 2 * held.facets + end
        positions[node] = np.where(held.mask[which], held.positions[which], positions[node])
        mask[node] |= held.mask[which]


def _walls(walls: Walls | None, dual: DualMesh) -> Walls | None:
    """The planes that the nodes of the primal problem stay inside of, for the mean of every triangle.

    Their pushes are even in every triangle. The law of the continuous curtain has them at all points, so that any such
    pushes give a lower bound.
    """
    if walls is None or not len(walls):
        return None
    planes = np.unique(np.column_stack([walls.normal, walls.offset]), axis=0)
    n_cells, first = dual.disc.n_cells, 2 * dual.facets.shape[1]
    node = np.tile(first + np.arange(n_cells), len(planes))
    return Walls(node, np.repeat(planes[:, :-1], n_cells, axis=0), np.repeat(planes[:, -1], n_cells))


def _bars(solution: CurtainSolution, dual: DualMesh) -> sparse.csc_matrix | None:
    """The straight bars' edges, kept on a line in the dual as they are in the primal problem."""
    lines = []
    X = dual.disc.nodes
    for bar in solution.problem.scene.of(Bar):
        if bar.straight:
            facets = dual.mesh.edge(bar.edge, "[load.bar] edge")
            nodes = np.concatenate([2 * facets, 2 * facets + 1])
            along = X[nodes] @ np.ptp(X[nodes], axis=0)
            lines.append(nodes[np.argsort(along, kind="stable")])
    return straight_ties(lines, X) if lines else None


def _at_dual_nodes(x: Array, dual: DualMesh) -> Array:
    """Nodal positions x of P1 at the unknowns of the dual (n_nodes, d)."""
    corners = x[dual.facets]  # (2, n_facets, d)
    middle = x[dual.mesh.mesh.t].mean(axis=0)
    return np.concatenate([corners.transpose(1, 0, 2).reshape(-1, x.shape[1]), middle])
