"""Supports of a scene as held components of nodes, with the checks that need no solver.

A support holds some components of some nodes at given positions. Scenes that must fail are refused here:
supports that contradict each other, pieces of the curtain that nothing holds, loads along a direction that slides.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from macro_fem.fem.cells import in_space_of
from macro_fem.fem.discretization import Discretization
from macro_fem.fem.supported import SupportedFem
from macro_fem.scene.cables import Sliding, sliding_nodes, sloping
from macro_fem.scene.meshing.mesh import CurtainMesh, components
from macro_fem.scene.schema import Scene
from macro_fem.scene.sites import Held, Site, edge_nodes
from macro_fem.scene.tables import Bar
from rve.common.errors import InputError
from rve.common.types import Array


@dataclass(frozen=True, eq=False)
class Supports:
    """All supports of a scene on a discretisation: components held (n_nodes, d), where, by which, and ties T.

    `sliding`: nodes on sloping lines; the mask has all their components. `pins`: one node for each direction in which
    nothing holds a piece of the curtain; they only remove that free sliding and carry no force. `bars` (n_nodes,
    n_nodes): weights of the nodes that straight bars tie others to, None without bars.
    """

    held: tuple[Held, ...]
    mask: np.ndarray
    positions: Array
    sliding: Sliding
    pins: Sliding
    bars: sparse.csc_matrix | None = field(default=None, repr=False)

    @cached_property
    def fixed(self) -> np.ndarray:
        """Components (n_nodes, d) that are no unknowns themselves: those held, those of pins, those of lines."""
        fixed = self.mask.copy()
        fixed[self.pins.nodes] |= self.pins.direction != 0.0
        return fixed

    @cached_property
    def tie(self) -> sparse.csc_matrix | None:
        """T (n_nodes * d, n_z) where bars or sloping lines need one: components of nodes first, lines last."""
        moving = self.sliding.without(self.pins.nodes)
        free = ~self.fixed
        if self.bars is None:
            return moving.tied(None, free) if len(moving.nodes) else None
        masters = free & (np.diff(self.bars.indptr) > 0)[:, None]
        both = sparse.kron(self.bars, sparse.eye(free.shape[1]), format="csc")
        return moving.tied(both[:, masters.ravel()], free)

    def fem(self, disc: Discretization) -> SupportedFem:
        """The discretisation with these supports."""
        x_held = np.where(self.fixed, self.positions, 0.0)
        return SupportedFem(disc, x_held, ~self.fixed.ravel(), self.tie)

    def carried(self, force: Array) -> Array:
        """What supports can carry of nodal forces (n_nodes, d): held components, nothing along sloping lines."""
        out = np.where(self.mask, force, 0.0)
        nodes, way = self.sliding.nodes, self.sliding.direction
        out[nodes] -= (out[nodes] * way).sum(axis=1)[:, None] * way
        return out


def build_supports(
    scene: Scene,
    mesh: CurtainMesh,
    disc: Discretization,
    factor: float = 1.0,
    released: frozenset[int] = frozenset(),
) -> Supports:
    """The supports of a scene with prescribed moves scaled by `factor` (load steps), without the numbers `released`."""
    items = [(number, item) for number, item in enumerate(scene.support) if number not in released]
    held = tuple(item.hold(Site(number, item, scene, mesh, disc), factor) for number, item in items)
    positions = in_space_of(disc.nodes, scene.d)
    mask = np.zeros(positions.shape, bool)
    owner = np.full(positions.shape, -1)
    ways = np.zeros(positions.shape)
    for number in sorted(range(len(held)), key=lambda k: held[k].slide is None):
        one = held[number]
        here = np.zeros_like(mask)
        here[one.nodes] = one.mask
        target = np.zeros_like(positions)
        target[one.nodes] = one.positions
        away = np.where(here & mask, target - positions, 0.0)
        clash = np.abs(away - (away * ways).sum(axis=1)[:, None] * ways) > 1e-9 * mesh.size
        if clash.any():
            node, axis = np.argwhere(clash)[0]
            x, y = disc.nodes[node]
            raise InputError(
                f"{scene.source}: [support]: {held[owner[node, axis]].name} and {one.name} hold the point "
                f"({x:g}, {y:g}) at different places, "
                f"{'xyz'[axis]} = {positions[node, axis]:g} and {target[node, axis]:g} mm"
            )
        positions = np.where(here, target, positions)
        mask |= here
        owner = np.where(here, number, owner)
        if one.slide is not None:
            ways[one.nodes] = one.slide
    lines = [(one.nodes, one.slide) for one in held if one.slide is not None]
    sliding = none = Sliding.none(scene.d)
    if lines:
        sliding = sliding_nodes(lines, _held_as_a_whole(held, disc, scene.source))
    straight = [bar for bar in scene.of(Bar) if bar.straight]
    bars = _straight_bars(straight, scene, mesh, disc, mask) if straight else None
    return Supports(held, mask, positions, sliding, none, bars)


def _held_as_a_whole(held: tuple[Held, ...], disc: Discretization, source: object) -> np.ndarray:
    """Nodes (n_nodes,) of which supports that do not slide hold all components; InputError if a sloping line slides
    where they hold some."""
    whole, on_line = np.zeros(disc.n_nodes, bool), np.zeros(disc.n_nodes, bool)
    for one in held:
        if one.slide is not None:
            on_line[one.nodes] = True
        else:
            whole[one.nodes] |= one.mask.all(axis=1)
    for one in held:
        part = one.nodes[on_line[one.nodes] & ~whole[one.nodes] & one.mask.any(axis=1)]
        if one.slide is None and len(part):
            x, y = disc.nodes[part[0]]
            raise InputError(
                f"{source}: [support]: {one.name} holds some components of the point ({x:g}, {y:g}), which slides on a "
                f"sloping line; hold all of them there, or none"
            )
    return whole


def _straight_bars(
    bars: list[Bar], scene: Scene, mesh: CurtainMesh, disc: Discretization, mask: np.ndarray
) -> sparse.csc_matrix:
    """Weights (n, n) that keep the nodes of every bar on a line; InputError for bars on bent or held edges."""
    lines: list[np.ndarray] = []
    for bar in bars:
        nodes = edge_nodes(mesh, disc, bar.edge, f"{scene.source}: [load.bar] edge")
        if mask[nodes].any() or any(np.isin(nodes, line).any() for line in lines):
            raise InputError(f"{scene.source}: [load.bar] edge = {bar.edge!r}: is held, or has a second bar")
        X = disc.nodes[nodes]
        along = X[-1] - X[0]
        s = (X - X[0]) @ along / (along @ along)
        if np.abs(X - X[0] - s[:, None] * along).max() > 1e-6 * mesh.size:
            raise InputError(f"{scene.source}: [load.bar] edge = {bar.edge!r}: is not straight, use straight = false")
        lines.append(nodes)
    return straight_ties(lines, disc.nodes)


def straight_ties(lines: list[np.ndarray], X: Array) -> sparse.csc_matrix:
    """Weights (n, n) that put the nodes of each line between its first and its last: x = (1 - s) x_first + s x_last.

    Columns of nodes in between are empty.
    """
    n = len(X)
    tied = np.zeros(n, bool)
    rows, columns, values = [], [], []
    for nodes in lines:
        along = X[nodes[-1]] - X[nodes[0]]
        s = (X[nodes] - X[nodes[0]]) @ along / (along @ along)
        for weight, end in ((1.0 - s[1:-1], nodes[0]), (s[1:-1], nodes[-1])):
            rows.append(nodes[1:-1])
            columns.append(np.full(len(nodes) - 2, end))
            values.append(weight)
        tied[nodes[1:-1]] = True
    own = np.flatnonzero(~tied)
    entries = (np.concatenate([own, *rows]), np.concatenate([own, *columns]))
    return sparse.coo_matrix((np.concatenate([np.ones(len(own)), *values]), entries), shape=(n, n)).tocsc()


def pin_sliding(supports: Supports, disc: Discretization, force: Array, source: object) -> Supports:
    """Pins one node along every direction in which a piece of the curtain can slide as a whole.

    InputError for a piece that nothing holds, and for a load `force` (n_nodes, d) along a free sliding.
    """
    number, label = components(disc.cell_dofs, disc.n_nodes)
    total = float(np.abs(force).sum())
    nodes, ways = list[int](), list[Array]()
    for piece in range(number):
        own = np.flatnonzero(label == piece)
        x, y = disc.nodes[own].mean(axis=0)
        if not supports.mask[own].any():
            what = "nothing holds the curtain" if number == 1 else f"nothing holds the piece around ({x:g}, {y:g})"
            raise InputError(f"{source}: [support]: {what}, so that it falls")
        for way, at in _free_ways(supports, own, disc):
            push = float((force[own] @ way).sum())
            if abs(push) > 1e-9 * total:
                raise InputError(
                    f"{source}: [load]: nothing carries the force of {push:.6g} N along {told(way)}, in which the "
                    f"supports let the piece around ({x:g}, {y:g}) slide"
                )
            nodes.append(at)
            ways.append(way)
    d = supports.mask.shape[1]
    return replace(supports, pins=Sliding(np.array(nodes, np.int64), np.array(ways, float).reshape(-1, d)))


def told(way: Array) -> str:
    """A direction in words: the letter of an axis, else its components."""
    return str(np.round(way, 6).tolist()) if sloping(way) else "xyz"[int(np.argmax(np.abs(way)))]


def _free_ways(supports: Supports, nodes: np.ndarray, disc: Discretization) -> list[tuple[Array, int]]:
    """Unit vectors (d,) along which nothing holds a piece of nodes (k,), each with a held node in its middle."""
    X, mask = disc.nodes, supports.mask
    held = mask[nodes].any(axis=0)
    at = nodes[mask[nodes].any(axis=1)]
    out = []
    for axis in np.flatnonzero(~held):
        along = X[at, axis % 2]
        out.append((np.eye(len(held))[axis], int(at[np.argmin(np.abs(along - along.mean()))])))
    on_line = nodes[np.isin(nodes, supports.sliding.nodes)]
    way = supports.sliding.common(on_line)
    if way is not None and not way[mask[np.setdiff1d(nodes, on_line)].any(axis=0)].any():
        out.append((way, int(on_line[np.argmin(np.linalg.norm(X[on_line] - X[on_line].mean(axis=0), axis=1))])))
    return out
