"""Supports, and where they hold the mesh: nodes on edges, at points and hooks, their places, and lines to slide on.

A node that slides on a line along the unit vector e is at x = x_held + e s with one unknown s: a column of T. On a line
along an axis the component is simply free, and needs no column. A node on two lines that cross, or on a line and held
as a whole by another support, is held.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from macro_fem.fem.cells import in_space_of
from macro_fem.fem.discretization import Discretization
from macro_fem.scene.meshing.edges import UPRIGHT, Line, facets_along, paths
from macro_fem.scene.tables import NO_MOVE, Time, Timed
from rve.common import Array, InputError

if TYPE_CHECKING:
    from macro_fem.scene.meshing.mesh import CurtainMesh
    from macro_fem.scene.scene import Scene

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


@dataclass(frozen=True, eq=False)
class Held:
    """What one support holds: `nodes` (k,), `mask` (k, d) of components and their `positions` (k, d).

    `facets` (m,): the facets of the mesh that are held as a whole; none for corners, hooks, runners and points.
    `slide` (d,): the direction, along no axis, in which all nodes slide freely from their positions; None if they do
    not. A direction along an axis is a component that is not in the mask. `track` (m, 3): points of the curve on which
    they hang, None without one.
    """

    name: str
    nodes: np.ndarray
    mask: np.ndarray
    positions: Array
    facets: np.ndarray = field(default_factory=NONE.copy, repr=False)
    slide: Array | None = None
    track: Array | None = field(default=None, repr=False)

    def components(self, shape: tuple[int, ...]) -> np.ndarray:
        """Whether it holds each component of all nodes, of this shape (n_nodes, d)."""
        held = np.zeros(shape, bool)
        held[self.nodes] = self.mask
        return held


@dataclass(frozen=True, eq=False)
class Site:
    """The mesh and its discretization for support `number` of a scene, after `factor` of its move."""

    number: int
    scene: Scene
    mesh: CurtainMesh
    disc: Discretization
    factor: float


@dataclass(frozen=True, kw_only=True)
class Support(Timed):
    """What holds the curtain; in motion until `release`, s, where `history` scales `move` and `drawn`."""

    kinds: ClassVar[dict[str, type[Any]]] = {}
    table = "support"
    edge_needed: ClassVar[str | None] = "top"
    one: ClassVar[str] = "point"
    """What results call one of the points that it holds."""
    release: Time | None = field(default=None, repr=False)

    def hold(self, site: Site) -> Held:
        """The nodes, components and positions that it holds at a site.

        InputError if it asks for what has no effect, or for nodes that the mesh has not.
        """
        raise NotImplementedError

    def _held(
        self, site: Site, name: str, nodes: np.ndarray, target: Array, held: str = "both", facets: np.ndarray = NONE
    ) -> Held:
        """The nodes (k,) held at places `target` (k, 2), moved; InputError for a gather that moves none of them."""
        scene, X, gather = site.scene, site.disc.nodes[nodes], getattr(self, "gather", 1.0)
        mask = np.tile([held == "both" or axis in held for axis in "xyz"[: scene.d]], (len(nodes), 1))
        if gather != 1.0 and np.abs((target - X)[mask[:, :2]]).max(initial=0.0) <= 1e-9 * site.mesh.size:
            scene.refuse(f"[support] gather = {gather:g}: has no effect on {name}, which it holds as it is")
        move = site.factor * scene.vector(getattr(self, "move", NO_MOVE))
        return Held(name, nodes, mask, in_space_of(target, scene.d) + move, facets)

    def _narrowed(self, site: Site, nodes: np.ndarray) -> Array:
        """Places (k, 2) of nodes of the top edge, narrowed by `gather` about the middle of the curtain."""
        X, x, gather = site.disc.nodes[nodes], site.mesh.mesh.p[0], getattr(self, "gather", 1.0)
        middle = 0.5 * (x.min() + x.max())
        return np.stack([middle + gather * (X[:, 0] - middle), X[:, 1]], axis=-1)


class Hanging(Support):
    """A support that may hold single points of the top edge, evenly spaced by its `pitch` or `count`."""

    pitch: float | None
    count: int | None

    def check(self) -> None:
        if self.pitch is not None and self.count is not None:
            self.refuse(f"count = {self.count}: is not used together with pitch")

    @property
    def has_hooks(self) -> bool:
        """Whether it holds single points."""
        return self.pitch is not None or self.count is not None

    def spaces(self, length: float) -> int:
        """How many spaces between hooks fit an open line of this length, mm: the number nearest to `pitch`."""
        if self.count is not None:
            return self.count - 1
        assert self.pitch is not None
        return round(min(length / self.pitch, 1e9))

    def hook_places(self, lines: list[Line], where: str) -> tuple[Array, list[float]]:
        """Places (k, 2) of hooks, even from end to end of the lines of the top edge; the longest line and pitch, mm.

        InputError for a pitch that is longer than the edge, or finer than its facets.
        """
        found, fitted = [], []
        named = f"{where} count = {self.count}:" if self.pitch is None else f"{where} pitch = {self.pitch:g}:"
        for line in lines:
            length, sides = float(line.arc[-1]), len(line.arc) - 1
            if self.pitch is not None and self.pitch > length * (1.0 + 1e-9):
                raise InputError(f"{named} is wider than the top edge, {length:g} mm")
            number = self.spaces(length) + (1 if line.is_closed and self.count is not None else 0)
            if number > sides:
                raise InputError(
                    f"{named} is finer than the mesh, whose nodes on the top edge are {length / sides:g} mm apart; "
                    "use more cells"
                )
            fitted.append((length, length / number))
            found.append(line.at(np.linspace(0.0, length, number + 1)[: number if line.is_closed else None]))
        return np.concatenate(found), np.max(fitted, axis=0).tolist()


def edge_nodes(mesh: CurtainMesh, disc: Discretization, name: str) -> np.ndarray:
    """Node numbers on the named edge, ordered along it for straight ones."""
    nodes = np.unique(facet_nodes(mesh, disc, mesh.edges[name]))
    return nodes[in_order(disc.nodes[nodes])]


def facet_nodes(mesh: CurtainMesh, disc: Discretization, facets: np.ndarray) -> np.ndarray:
    """Node numbers (2, k) at the ends of facets (k,), of P2 (3, k) with the middles; of the hybrid element see
    `macro_fem.bounds.equilibrated`."""
    if disc.element == "equilibrium":
        return np.stack([2 * facets, 2 * facets + 1])
    ends = mesh.mesh.facets[:, facets]
    return np.vstack([ends, mesh.mesh.p.shape[1] + facets]) if disc.element == "P2" else ends


def in_order(X: Array) -> np.ndarray:
    """The order (k,) of points X (k, 2) on a straight line, from its left end, or of an upright one from the lower.

    >>> in_order(np.array([[1e-10, 0.0], [0.0, 1.0], [-2e-10, 2.0]])).tolist()
    [0, 1, 2]
    """
    width, height = np.ptp(X, axis=0)
    return np.lexsort(X.T if width < UPRIGHT * height else X.T[::-1])


def point_node(at: tuple[float, float], disc: Discretization) -> np.ndarray:
    """The number (1,) of the node at a point."""
    return np.array([np.argmin(np.linalg.norm(disc.nodes - np.array(at), axis=1))])


@dataclass(frozen=True, eq=False)
class Curve:
    """A track: a `plan` of points [x, z], or an arc of `radius` and `angle` (radians, signed) with its ends at z = 0.

    length and height (y) in mm. The arc is symmetric about x = middle; it bulges towards the viewer if angle > 0.
    """

    length: float
    height: float
    plan: Line | None = None
    radius: float = 0.0
    angle: float = 0.0
    middle: float = 0.0

    def at(self, s: Array) -> Array:
        """Places (n, 3) at the distances s (n,) from the start, measured along the track, mm.

        >>> Curve(np.pi * 100.0, 50.0, radius=100.0, angle=np.pi).at(np.array([50.0 * np.pi])).round(9).tolist()
        [[0.0, 50.0, 100.0]]
        """
        if self.plan is None:
            turn = (s / self.length - 0.5) * abs(self.angle)
            x = self.middle + self.radius * np.sin(turn)
            z = math.copysign(self.radius, self.angle) * (np.cos(turn) - math.cos(0.5 * self.angle))
        else:
            x, z = self.plan.at(s).T
        return np.stack([x, np.full(len(s), self.height), z], axis=-1)


def edge_line(mesh: CurtainMesh, name: str, where: str) -> Line:
    """The corners of the mesh along a named edge, from its left or lower end.

    InputError, which begins with `where`, if the edge is no single open line.
    """
    lines = paths(mesh.mesh.facets[:, mesh.edges[name]].T, mesh.mesh.p.T)
    if len(lines) != 1 or lines[0].is_closed:
        what = "closed" if len(lines) == 1 else f"made of {len(lines)} pieces"
        raise InputError(f"{where} = {name!r}: is {what}, but a track or line needs an edge that is one open line")
    return lines[0]


def placed_along(site: Site, nodes: np.ndarray, places: Array) -> tuple[np.ndarray, Array]:
    """Nodes (n,) on a line of corners `nodes` (k,) at `places` (k, 3), and their places (n, 3), half way between."""
    mesh = site.mesh.mesh
    if site.disc.element == "P2":
        nodes = np.concatenate([nodes, mesh.p.shape[1] + facets_along(mesh, nodes)])
        places = np.concatenate([places, 0.5 * (places[1:] + places[:-1])])
    order = np.argsort(nodes)
    return nodes[order], places[order]


def sliding_nodes(lines: list[tuple[np.ndarray, Array]], whole: np.ndarray, d: int) -> Sliding:
    """The nodes of lines (nodes (k,), unit vector (d,)), but those on two that cross and those held as a `whole`."""
    way = np.zeros((len(whole), d))
    fixed = whole.copy()
    for nodes, e in lines:
        before = way[nodes]
        fixed[nodes] |= before.any(axis=1) & (np.abs(before @ e) < 1.0 - PARALLEL)
        way[nodes] = e
    free = np.flatnonzero(way.any(axis=1) & ~fixed)
    return Sliding(free, way[free])


def sloping(direction: Array) -> bool:
    """Whether a unit vector is along no axis."""
    return bool(np.count_nonzero(np.abs(direction) > PARALLEL) > 1)
