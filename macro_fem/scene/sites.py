"""Where supports hold the mesh: nodes on edges, at points and hooks, their places, and lines on which they slide.

A node that slides on a line along the unit vector e is at x = x_held + e s with one unknown s: a column of T. On a line
along an axis the component is simply free, and needs no column. A node on two lines that cross, or on a line and held
as a whole by another support, is held.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from macro_fem.fem.cells import in_space_of
from macro_fem.fem.discretization import Discretization
from macro_fem.scene.meshing.edges import paths
from macro_fem.scene.tables import NO_MOVE, Support, in_3d
from rve.common import Array, InputError

if TYPE_CHECKING:
    from macro_fem.scene.meshing.mesh import CurtainMesh
    from macro_fem.scene.schema import Scene


NONE = np.zeros(0, np.int64)
PARALLEL = 1e-9
"""Unit vectors that differ by less than this are one direction."""


@dataclass(frozen=True, eq=False)
class Sliding:
    """Nodes (m,) that slide along unit vectors `direction` (m, d)."""

    nodes: np.ndarray
    direction: Array

    @classmethod
    def none(cls, d: int) -> Sliding:
        """No node."""
        return cls(NONE, np.zeros((0, d)))

    def along(self, force: Array) -> Array:
        """The components (m,) of nodal forces (n_nodes, d) along the directions."""
        return np.asarray((force[self.nodes] * self.direction).sum(axis=1))

    def common(self, nodes: np.ndarray) -> Array | None:
        """The direction (d,) in which all of these nodes slide; None if they have no single one, or some do not slide.

        >>> one = Sliding(np.array([3, 5]), np.array([[0.6, 0.8, 0.0], [-0.6, -0.8, 0.0]]))
        >>> one.common(np.array([5, 3])).tolist()
        [0.6, 0.8, 0.0]
        """
        directions = self.direction[np.isin(self.nodes, nodes)]
        if not len(nodes) or len(directions) != len(nodes):
            return None
        aligned = np.abs(np.abs(directions @ directions[0]) - 1.0) < PARALLEL
        return directions[0] if aligned.all() else None


@dataclass(frozen=True, eq=False)
class Held:
    """What one support holds: `nodes` (k,), `mask` (k, d) of components and their `positions` (k, d).

    `facets` (m,): the facets of the mesh that are held as a whole; none for corners, hooks, runners and points.
    `slide` (d,): the direction, along no axis, in which all nodes slide freely from their positions; None if they do
    not. A direction along an axis is a component that is not in the mask.
    """

    name: str
    nodes: np.ndarray
    mask: np.ndarray
    positions: Array
    facets: np.ndarray = field(default_factory=NONE.copy, repr=False)
    slide: Array | None = None


@dataclass(frozen=True, eq=False)
class Site:
    """The mesh and its discretization for one support, `number` in the scene."""

    number: int
    item: Support
    scene: Scene
    mesh: CurtainMesh
    disc: Discretization

    @property
    def where(self) -> str:
        """File and support, for messages."""
        return f"{self.scene.source}: {self.item.where}"

    @property
    def move(self) -> Array:
        """The move of the support (d,), mm."""
        return np.array(in_3d(getattr(self.item, "move", NO_MOVE))[: self.scene.d])

    def edge(self, name: str, where: str = "needs edge") -> tuple[np.ndarray, np.ndarray]:
        """Nodes (k,) and facets (m,) of a named edge; InputError if there is no such edge."""
        where = f"{self.where} {where}"
        return edge_nodes(self.mesh, self.disc, name, where), self.mesh.edge(name, where)

    def hooks(self) -> np.ndarray:
        """The nodes (k,) at hooks: corners of the mesh are the first nodes of every element."""
        self.mesh.edge("top", f"{self.where} needs edge")
        return self.mesh.hooks[self.number].nodes

    def held(
        self, name: str, nodes: np.ndarray, target: Array, factor: float, held: str = "both", facets: np.ndarray = NONE
    ) -> Held:
        """The nodes (k,) held at places `target` (k, 2), moved; InputError for a gather that moves none of them."""
        X, gather = self.disc.nodes[nodes], getattr(self.item, "gather", 1.0)
        mask = np.tile([held == "both" or axis in held for axis in "xyz"[: self.scene.d]], (len(nodes), 1))
        if gather != 1.0 and np.abs((target - X)[mask[:, :2]]).max(initial=0.0) <= 1e-9 * self.mesh.size:
            raise InputError(
                f"{self.scene.source}: [support] gather = {gather:g}: has no effect on {name}, which it holds as it is"
            )
        return Held(name, nodes, mask, in_space_of(target, self.scene.d) + factor * self.move, facets)

    def gathered(self, nodes: np.ndarray, gather: float) -> Array:
        """Places (k, 2) of nodes of the top edge, narrowed about the middle of the curtain."""
        X, x = self.disc.nodes[nodes], self.mesh.mesh.p[0]
        middle = 0.5 * (x.min() + x.max())
        return np.stack([middle + gather * (X[:, 0] - middle), X[:, 1]], axis=-1)


def edge_nodes(mesh: CurtainMesh, disc: Discretization, name: str, where: str) -> np.ndarray:
    """Node numbers on the named edge, ordered along it for straight ones; InputError if there is no such edge."""
    facets = mesh.edge(name, where)
    nodes = np.unique(mesh.mesh.facets[:, facets])
    if disc.element == "P2":  # corners come first, then the middles of facets
        nodes = np.concatenate([nodes, mesh.mesh.p.shape[1] + facets])
    return nodes[np.lexsort((disc.nodes[nodes, 1], disc.nodes[nodes, 0]))]


def point_node(at: tuple[float, float], disc: Discretization) -> np.ndarray:
    """The number (1,) of the node at a point."""
    return np.array([np.argmin(np.linalg.norm(disc.nodes - np.array(at), axis=1))])


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


def placed_along(site: Site, line: np.ndarray, places: Array) -> tuple[np.ndarray, Array]:
    """Nodes (n,) on a line of corners (k,) and their places (n, 3), of given places (k, 3) of the corners.

    Nodes between two corners are half way between their places.
    """
    points = site.mesh.mesh.p.T[line]
    candidates = np.concatenate([points, 0.5 * (points[1:] + points[:-1])])
    targets = np.concatenate([places, 0.5 * (places[1:] + places[:-1])])
    distance, node = cKDTree(site.disc.nodes).query(candidates)
    there = distance < 1e-9 * site.mesh.size
    nodes, first = np.unique(node[there], return_index=True)
    return nodes, targets[there][first]


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
