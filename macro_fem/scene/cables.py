"""Edges that lie on curves and lines in space, and slide on straight ones in any direction: cables, sloping rails.

A node that slides on a line along the unit vector e is at x = x_held + e s with one unknown s: a column of T. On a line
along an axis the component is simply free, and needs no column. A node on two lines that cross, or on a line and held
as a whole by another support, is held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from homogenize import MembraneLaw
from macro_fem.fem.discretization import Discretization
from macro_fem.fem.rotated import largest_stretch
from macro_fem.scene.meshing.edges import paths
from macro_fem.scene.meshing.mesh import CurtainMesh
from macro_fem.scene.schema import Scene
from macro_fem.scene.tables import Track
from macro_fem.scene.tracks import Curve, track_curve, track_places
from rve.common.errors import InputError
from rve.common.types import Array

PARALLEL = 1e-9
"""Unit vectors that differ by less than this are one direction."""


@dataclass(frozen=True, eq=False)
class Sliding:
    """Nodes (m,) that slide along unit vectors `direction` (m, d)."""

    nodes: np.ndarray
    direction: Array

    def columns(self, n_nodes: int) -> sparse.csc_matrix:
        """The columns (n_nodes * d, m) of T that these nodes have."""
        m, d = self.direction.shape
        rows = d * self.nodes[:, None] + np.arange(d)
        entries = (self.direction.ravel(), (rows.ravel(), np.repeat(np.arange(m), d)))
        return sparse.coo_matrix(entries, shape=(n_nodes * d, m)).tocsc()

    def tied(self, tie: sparse.csc_matrix | None, free: np.ndarray) -> sparse.csc_matrix:
        """T with these columns at its end; without `tie` the components `free` (n_nodes, d) are the first ones."""
        if tie is None:
            own = np.flatnonzero(free)
            tie = sparse.csc_matrix((np.ones(len(own)), (own, np.arange(len(own)))), shape=(free.size, len(own)))
        return sparse.hstack([tie, self.columns(len(free))]).tocsc()

    def without(self, number: int) -> Sliding:
        """The same without one of the nodes."""
        return Sliding(np.delete(self.nodes, number), np.delete(self.direction, number, axis=0))

    def common(self, nodes: np.ndarray) -> Array | None:
        """The direction (d,) in which all of these nodes slide; None if they have no single one, or some do not slide.

        >>> one = Sliding(np.array([3, 5]), np.array([[0.6, 0.8, 0.0], [-0.6, -0.8, 0.0]]))
        >>> one.common(np.array([5, 3])).tolist()
        [0.6, 0.8, 0.0]
        """
        own = np.isin(self.nodes, nodes)
        if own.sum() != len(nodes) or not own.any():
            return None
        directions = self.direction[own]
        aligned = np.abs(np.abs(directions @ directions[0]) - 1.0) < PARALLEL
        return directions[0] if aligned.all() else None


def sliding_nodes(lines: list[tuple[np.ndarray, Array]], whole: np.ndarray) -> Sliding:
    """The nodes that slide: those of lines (nodes (k,), unit vector (d,)) that lie on no second, crossing one.

    Nodes held as a `whole` (n_nodes,) do not slide.
    """
    way = np.zeros((len(whole), len(lines[0][1])))
    fixed = whole.copy()
    for nodes, e in lines:
        before = way[nodes]
        fixed[nodes] |= before.any(axis=1) & (np.abs(before @ e) < 1.0 - PARALLEL)
        way[nodes] = e
    free = np.flatnonzero(way.any(axis=1) & ~fixed)
    return Sliding(free, way[free])


def unit_direction(way: Array) -> Array:
    """The unit vector along a vector (d,); an axis exactly where it is along one."""
    e = way / np.linalg.norm(way)
    axis = int(np.argmax(np.abs(e)))
    return np.eye(len(e))[axis] if 1.0 - abs(e[axis]) < PARALLEL**2 else e


def sloping(direction: Array) -> bool:
    """Whether a unit vector is along no axis."""
    return bool(np.count_nonzero(direction) > 1)


def edge_line(mesh: CurtainMesh, name: str, where: str) -> tuple[np.ndarray, Array]:
    """Corner numbers (k,) of the mesh along a named edge from its left or lower end, and the distances (k,) from there.

    InputError, which begins with `where`, if the edge is no single open line.
    """
    points = mesh.mesh.p.T
    pairs = mesh.mesh.facets[:, mesh.edge(name, where)].T
    lines = paths(map(tuple, pairs), points)
    if len(lines) != 1 or lines[0][0] == lines[0][-1]:
        what = "closed" if len(lines) == 1 else f"made of {len(lines)} pieces"
        raise InputError(f"{where} = {name!r}: is {what}, but a track or line needs an edge that is one open line")
    steps = np.linalg.norm(np.diff(points[lines[0]], axis=0), axis=1)
    return lines[0], np.concatenate([[0.0], np.cumsum(steps)])


def placed_along(mesh: CurtainMesh, disc: Discretization, line: np.ndarray, places: Array) -> tuple[np.ndarray, Array]:
    """Nodes (n,) on a line of corners (k,) and their places (n, 3), of given places (k, 3) of the corners.

    Nodes between two corners are half way between their places.
    """
    points = mesh.mesh.p.T[line]
    candidates = np.concatenate([points, 0.5 * (points[1:] + points[:-1])])
    targets = np.concatenate([places, 0.5 * (places[1:] + places[:-1])])
    distance, node = cKDTree(disc.nodes).query(candidates)
    there = distance < 1e-9 * mesh.size
    nodes, first = np.unique(node[there], return_index=True)
    return nodes, targets[there][first]


def track_of(item: Track, mesh: CurtainMesh, where: str) -> tuple[np.ndarray, Array, Curve]:
    """Corners (k,) of the mesh along the top edge, their distances (k,) from its left end, and the track."""
    line, s = edge_line(mesh, "top", f"{where} needs edge")
    x, y = mesh.mesh.p[:, line]
    return line, s, track_curve(item, s[-1], 0.5 * float(x.min() + x.max()), float(y.max()), where)


def check_tracks(scene: Scene, mesh: CurtainMesh, law: MembraneLaw) -> None:
    """InputError for a track between two points of which the top edge would be longer than the law lets it be."""
    for number, item in enumerate(scene.support):
        if not isinstance(item, Track):
            continue
        where = f"{scene.source}: [support] (track)"
        line, s, curve = track_of(item, mesh, where)
        at = s if item.pitch is None else np.linspace(0.0, s[-1], len(mesh.hooks[number]))
        steps = np.diff(s) * largest_stretch(law, np.diff(mesh.mesh.p[:, line].T, axis=0))
        longest = np.diff(np.interp(at, s, np.concatenate([[0.0], np.cumsum(steps)])))
        apart = np.linalg.norm(np.diff(track_places(item, curve, at, s[-1]), axis=0), axis=1)
        worst = int(np.argmax(apart / longest))
        if apart[worst] > longest[worst] * (1.0 + 1e-9):
            raise InputError(
                f"{where}: a track of {curve.length:g} mm is too long for the mesh: it stretches the top edge of "
                f"{s[-1]:g} mm by {100.0 * (apart[worst] / np.diff(at)[worst] - 1.0):.3g} %, and the rings lock at "
                f"{100.0 * (longest[worst] / np.diff(at)[worst] - 1.0):.3g} %"
            )
