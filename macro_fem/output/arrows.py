"""Forces on a solved curtain as arrows: of supports, of obstacles, and loads at points."""

from __future__ import annotations

import numpy as np

from macro_fem.fem.cells import padded
from macro_fem.scene.sites import point_node
from macro_fem.scene.tables import PatchLoad, PointLoad, in_3d
from macro_fem.solution import CurtainSolution
from rve.common import Array

LOAD = "#7b2cbf"
MOST_ARROWS = 14
"""Forces of a support along an edge, and of all obstacles, are summed up into this many arrows."""


def pulls(solution: CurtainSolution) -> tuple[Array, Array]:
    """Places (k, 3) and forces (k, 3) of supports: those at points, and those of edges summed up."""
    groups: list[np.ndarray] = []
    taken = np.zeros(len(solution.x), bool)
    for held in solution.problem.supports.held:
        nodes = held.nodes[~taken[held.nodes]]
        taken[nodes] = True
        groups += halved(padded(solution.x), nodes, MOST_ARROWS if len(held.facets) else len(nodes))
    return _summed_up(solution, solution.reactions, groups)


def pushes(solution: CurtainSolution) -> tuple[Array, Array]:
    """Places (k, 3) and forces (k, 3) of obstacles on the curtain, summed up."""
    size = np.linalg.norm(solution.pushes, axis=1)
    nodes = np.flatnonzero(size > 1e-6 * size.max(initial=0.0))
    return _summed_up(solution, solution.pushes, halved(padded(solution.x), nodes, MOST_ARROWS))


def point_loads(solution: CurtainSolution) -> tuple[Array, Array]:
    """Places (k, 3) and forces (k, 3) of the loads at points and on patches."""
    problem = solution.problem
    loads: tuple[PointLoad | PatchLoad, ...] = (*problem.scene.of(PointLoad), *problem.scene.of(PatchLoad))
    nodes = [int(point_node(one.at, problem.disc)[0]) for one in loads]
    forces = np.reshape([in_3d(one.force) for one in loads], (-1, 3))
    return padded(solution.x)[nodes], problem.factor * forces


def halved(x: Array, nodes: np.ndarray, most: int) -> list[np.ndarray]:
    """The nodes, of places x (n, 3), in at most `most` groups: halved along the longer extent again and again.

    >>> [part.tolist() for part in halved(np.array([[3.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]]), np.arange(3), 2)]
    [[1], [2, 0]]
    """
    if most < 2 or len(nodes) < 2:
        return [nodes] if len(nodes) else []
    order = nodes[np.argsort(x[nodes, np.ptp(x[nodes], axis=0).argmax()], kind="stable")]
    first, half = most // 2, len(order) // 2
    return [*halved(x, order[:half], first), *halved(x, order[half:], most - first)]


def _summed_up(solution: CurtainSolution, forces: Array, groups: list[np.ndarray]) -> tuple[Array, Array]:
    """The middle and the sum of the nodal forces (n_nodes, d) of each group."""
    x, forces = padded(solution.x), padded(forces)
    size = np.linalg.norm(forces, axis=1) + 1e-300
    at = [np.average(x[nodes], axis=0, weights=size[nodes]) for nodes in groups]
    return np.reshape(at, (-1, 3)), np.reshape([forces[nodes].sum(axis=0) for nodes in groups], (-1, 3))


FORCES = (
    ("force of supports", "#d7263d", pulls),
    ("force of obstacles", "#e07b00", pushes),
    ("load at a point", LOAD, point_loads),
)
"""Names, colours, and places with forces of the arrows."""
