"""Forces on a curtain as arrows of pictures: their places and sizes, few of an edge, names and colours."""

import numpy as np

from macro_fem.curtain import CurtainState
from macro_fem.fem.assembly import load_vector
from macro_fem.judged import spot_loads
from macro_fem.scene.loads import wind_per_area
from macro_fem.scene.meshing.mesh import point_node
from macro_fem.scene.tables import Wind, in_3d
from rve.common import Array
from rve.geometry import padded


def pulls(solution: CurtainState) -> tuple[Array, Array]:
    """Places (k, 3) and forces (k, 3) of supports: those at points, and those of edges summed up."""
    points = [held.nodes for held in solution.problem.supports.held if not len(held.facets)]
    return _summed_up(solution, solution.reactions, *points)


def pushes(solution: CurtainState) -> tuple[Array, Array]:
    """Places (k, 3) and forces (k, 3) of obstacles on the curtain, summed up."""
    return _summed_up(solution, solution.pushed.sum(axis=0))


def point_loads(solution: CurtainState) -> tuple[Array, Array]:
    """Places (k, 3) and forces (k, 3) of the loads at points and on patches."""
    problem, nodal = solution.problem, np.zeros((len(solution.x), 3))
    for _, load in spot_loads(problem.scene):
        nodal[point_node(load.at, problem.disc)] += problem.factor * np.array(in_3d(load.force))
    return _summed_up(solution, nodal, np.flatnonzero(nodal.any(axis=1)))


def winds(solution: CurtainState) -> tuple[Array, Array]:
    """Places (k, 3) and forces (k, 3) of wind, summed up."""
    problem, scene = solution.problem, solution.problem.scene
    nodal = solution.blown.copy()
    for wind in (one for one in scene.of(Wind) if not one.is_shaped):
        nodal += problem.factor * load_vector(problem.disc, wind_per_area(wind, scene, None))
    return _summed_up(solution, nodal)


def _summed_up(solution: CurtainState, forces: Array, *points: np.ndarray) -> tuple[Array, Array]:
    """Places and sizes of nodal forces (n_nodes, d): each of the `points`, and of other nodes the sums of groups."""
    x, forces = padded(solution.x), padded(forces)
    size, single = np.linalg.norm(forces, axis=1) + 1e-300, np.unique(np.concatenate([np.zeros(0, int), *points]))
    others = np.setdiff1d(np.flatnonzero(size > 1e-6 * size.max()), single)
    # Forces of an edge, of all obstacles and of wind are summed up into this many arrows, a power of two.
    groups = [*single[:, None], *halved(x, others, 16)] if forces.any() else []
    at = [np.average(x[nodes], axis=0, weights=size[nodes]) for nodes in groups]
    return np.reshape(at, (-1, 3)), np.reshape([forces[nodes].sum(axis=0) for nodes in groups], (-1, 3))


FORCES = (
    ("force of supports", "#d7263d", pulls, 1),
    ("force of obstacles", "#e07b00", pushes, 1),
    ("load at a point", "#7b2cbf", point_loads, 1),
    ("wind", "#3a86ff", winds, -1),
)
"""Names, colours, and places with forces of the arrows, which begin there, or end there where the last number is -1."""


def halved(x: Array, nodes: np.ndarray, most: int) -> list[np.ndarray]:
    """The nodes, of places x (n, 3), in at most `most` groups: halved along the longest extent again and again, of
    extents that are much the same along the first, so that mirrored parts are cut alike.

    >>> [part.tolist() for part in halved(np.array([[3.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]]), np.arange(3), 2)]
    [[1], [2, 0]]
    """
    if most < 2 or len(nodes) < 2:
        return [nodes] if len(nodes) else []
    extent = np.ptp(x[nodes], axis=0)
    order = nodes[np.argsort(x[nodes, np.argmax(extent >= 0.8 * extent.max())], kind="stable")]
    first, half = most // 2, len(order) // 2
    return [*halved(x, order[:half], first), *halved(x, order[half:], most - first)]
