"""Forces of supports and obstacles on a curtain as arrows in space."""

from __future__ import annotations

import numpy as np

from macro_fem.fem.space import padded
from macro_fem.solution import CurtainSolution
from rve.common.types import Array

MOST_ARROWS = 14
"""Forces of a support along an edge, and of all obstacles, are summed up into this many arrows."""
LEAST_ARROW = 0.04
"""Forces below this part of the largest one have no arrow."""
LONGEST = 0.16
"""Length of the largest reaction's arrow over the size of the scene."""


def pushes(solution: CurtainSolution) -> tuple[Array, Array]:
    """Places (k, 3) and forces (k, 3) of obstacles on the curtain, summed up over patches of it."""
    walls = solution.problem.walls
    if walls is None or not len(solution.wall_forces):
        return np.zeros((0, 3)), np.zeros((0, 3))
    x = padded(solution.x)
    nodal = padded(walls.nodal(solution.wall_forces, len(x)))
    size = np.linalg.norm(nodal, axis=1)
    nodes = np.flatnonzero(size > 1e-6 * size.max(initial=0.0))
    found = [part for part in patches(x[nodes], MOST_ARROWS) if len(part)]
    if not found:
        return np.zeros((0, 3)), np.zeros((0, 3))
    groups = [nodes[part] for part in found]
    at = [np.average(x[group], axis=0, weights=size[group]) for group in groups]
    return np.stack(at), np.stack([nodal[group].sum(axis=0) for group in groups])


def patches(points: Array, most: int) -> list[np.ndarray]:
    """Numbers of points (n, 3) in at most `most` patches: the widest one is halved until there are so many.

    >>> [part.tolist() for part in patches(np.array([[3.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]]), 2)]
    [[1], [2, 0]]
    """
    parts = [np.arange(len(points))]
    while len(parts) < min(most, len(points)):
        widths = [float(np.ptp(points[part], axis=0).max(initial=0.0)) if len(part) else 0.0 for part in parts]
        part = parts.pop(int(np.argmax(widths)))
        axis = int(np.argmax(np.ptp(points[part], axis=0)))
        order = part[np.argsort(points[part, axis], kind="stable")]
        parts += [order[: len(order) // 2], order[len(order) // 2 :]]
    return parts


def pulls(solution: CurtainSolution) -> tuple[Array, Array]:
    """Places (k, 3) and forces (k, 3) of supports: those at points, and those of edges summed up by equal lengths."""
    x, forces = padded(solution.x), padded(solution.reactions)
    taken = np.zeros(len(x), bool)
    places, sums = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for held in solution.problem.supports.held:
        nodes = held.nodes[~taken[held.nodes]]
        taken[nodes] = True
        order = along_edge(solution.problem.disc.nodes[nodes])
        is_edge = len(held.facets) and len(nodes) > MOST_ARROWS
        at, force = x[nodes[order]], forces[nodes[order]]
        at, force = summed_up(at, force, MOST_ARROWS) if is_edge else (at, force)
        places.append(at)
        sums.append(force)
    return np.concatenate(places), np.concatenate(sums)


def along_edge(points: Array) -> np.ndarray:
    """Order (n,) of points (n, 2) along the edge they lie on: by angle around a rim, else along its longer extent.

    >>> along_edge(np.array([[3.0, 0.0], [1.0, 0.0], [2.0, 0.1]])).tolist()
    [1, 2, 0]
    """
    if not len(points):
        return np.zeros(0, int)
    away = points - points.mean(axis=0)
    angle = np.sort(np.arctan2(away[:, 1], away[:, 0]))
    is_rim = len(points) > 3 and float(np.diff(angle, append=angle[0] + 2.0 * np.pi).max()) < 0.5 * np.pi
    axis = int(np.argmax(np.ptp(points, axis=0)))
    return np.argsort(np.arctan2(away[:, 1], away[:, 0]) if is_rim else points[:, axis], kind="stable")


def summed_up(at: Array, force: Array, count: int) -> tuple[Array, Array]:
    """Places and forces (count, 3) of `count` equal lengths of a line with nodal forces `force` (n, 3) at `at` (n, 3).

    A nodal force is spread evenly over the length half-way to its neighbours, so that an even line load has equal sums.

    >>> at = np.linspace([0.0, 0.0, 0.0], [8.0, 0.0, 0.0], 9)
    >>> even = np.array([[0.0, 0.5, 0.0], *[[0.0, 1.0, 0.0]] * 7, [0.0, 0.5, 0.0]])
    >>> summed_up(at, even, 3)[1][:, 1].round(9).tolist()
    [2.666666667, 2.666666667, 2.666666667]
    """
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(at, axis=0), axis=1)))
    ends = np.concatenate([s[:1], 0.5 * (s[1:] + s[:-1]), s[-1:]])
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(force, axis=0)])
    edges = np.linspace(0.0, s[-1], count + 1)
    sums = np.diff(np.stack([np.interp(edges, ends, column) for column in total.T], axis=1), axis=0)
    middle = 0.5 * (edges[1:] + edges[:-1])
    return np.stack([np.interp(middle, s, column) for column in at.T], axis=1), sums
