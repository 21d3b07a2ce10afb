"""Cells of a plane mesh: areas, sense, averages at corners; plane vectors in space, where x points to the right, y up,
z towards the viewer."""

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from rve.common import Array
from rve.common.records import Index


def cross(u: Array, v: Array) -> Array:
    """The cross product (...) of plane vectors (..., 2)."""
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])


def signed_areas(corners: Array) -> Array:
    """Areas (...) of polygons with corners (..., k, 2) in order, positive if counterclockwise."""
    away = corners - corners[..., :1, :]  # from a corner: far from the origin digits cancel
    return np.asarray(0.5 * cross(away, np.roll(away, -1, axis=-2)).sum(axis=-1))


def counterclockwise(points: Array, cells: Index) -> Index:
    """The cells (m, 3 or 4), those that are clockwise turned round."""
    return np.where(signed_areas(points[cells])[:, None] < 0.0, cells[:, ::-1], cells)


def mean_at_corners(cells: Index, values: Array, weight: Array | None = None) -> Array:
    """The mean at each corner (p, ...) of the values (c, ...) of the cells (c, k) that meet there.

    weight (c,) of the cells, None for equal ones; p is the largest corner number plus one.

    >>> mean_at_corners(np.array([[0, 1], [1, 2]]), np.array([1.0, 3.0]))
    array([1., 2., 3.])
    """
    share, k = np.ones(len(cells)) if weight is None else weight, cells.shape[1]
    cell = np.repeat(np.arange(len(cells)), k)
    sums = sparse.csr_matrix((np.repeat(share, k), (cells.ravel(), cell)))
    total = np.maximum(sums @ np.ones(len(cells)), 1e-300)
    means = (sums @ values.reshape(len(cells), -1)) / total[:, None]
    return np.asarray(means.reshape(len(total), *values.shape[1:]))


def recovered(cells: Index, values: Array, area: Array) -> Array:
    """Cell values (c, ...) averaged over the cells at each corner, then over the corners of each cell: stresses of
    locked cells are right on average only, as equilibrium does not decide how neighbours share a load.
    """
    return np.asarray(mean_at_corners(cells, values, area)[cells].mean(axis=1))


def components(cells: Index, n_nodes: int) -> tuple[int, Index]:
    """How many connected pieces the cells, or links, (n_cells, n_local) form, and the piece of each node (n_nodes,)."""
    row = np.repeat(cells[:, 0], cells.shape[1])
    graph = sparse.coo_matrix((np.ones(len(row)), (row, cells.ravel())), shape=(n_nodes, n_nodes))
    number, label = connected_components(graph, directed=False)
    return int(number), label
