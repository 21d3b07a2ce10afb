"""Supports of a scene as held components of nodes; what they contradict, leave to fall or let slide is refused.

A node that slides on a line along the unit vector e is at x = x_held + e s with one unknown s: a column of T. On a line
along an axis the component is simply free, and needs no column. A node on two lines that cross, or on a line and held
as a whole by another support, is held.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy import sparse

from macro_fem.fem.cells import components, cross
from macro_fem.fem.discretization import Discretization
from macro_fem.fem.supported import SupportedFem
from macro_fem.scene.meshing.edges import in_order
from macro_fem.scene.meshing.mesh import CurtainMesh, edge_nodes
from macro_fem.scene.obstacles import unit
from macro_fem.scene.scene import Scene
from macro_fem.scene.support_kinds import NONE, PARALLEL, Held, Support, sloping
from macro_fem.scene.tables import Bar
from rve.common import Array, InputError, shown
from rve.common.records import Index
from rve.geometry import padded


@dataclass(frozen=True, eq=False)
class Sliding:
    """SupportNodes (m,) that slide along unit vectors `direction` (m, d)."""

    nodes: Index
    direction: Array

    @classmethod
    def none(cls, d: int) -> Self:
        """No node."""
        return cls(NONE, np.zeros((0, d)))

    def along(self, force: Array) -> Array:
        """The components (m,) of nodal forces (n_nodes, d) along the directions."""
        return np.asarray((force[self.nodes] * self.direction).sum(axis=1))


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
        moves = ~np.isin(self.sliding.nodes, self.pins.nodes)
        nodes, direction = self.sliding.nodes[moves], self.sliding.direction[moves]
        if self.bars is None and not len(nodes):
            return None
        free = ~self.fixed
        n, d = free.shape
        own = sparse.eye(n * d, format="csc")
        if self.bars is not None:
            free &= (np.diff(self.bars.indptr) > 0)[:, None]
            own = sparse.kron(self.bars, sparse.eye(d), format="csc")
        rows = (d * nodes[:, None] + np.arange(d)).ravel()
        lines = sparse.csc_matrix((direction.ravel(), rows, d * np.arange(len(nodes) + 1)), shape=(n * d, len(nodes)))
        lines.eliminate_zeros()
        return sparse.hstack([own[:, free.ravel()], lines]).tocsc()

    def fem(self, disc: Discretization) -> SupportedFem:
        """The discretisation with these supports."""
        x_held = np.where(self.fixed, self.positions, padded(disc.nodes[:1], self.fixed.shape[1]))
        return SupportedFem(disc, x_held, ~self.fixed.ravel(), self.tie)

    def carried(self, force: Array) -> Array:
        """What supports can carry of nodal forces (n_nodes, d): held components, nothing along sloping lines."""
        out = np.where(self.mask, force, 0.0)
        nodes, way = self.sliding.nodes, self.sliding.direction
        out[nodes] -= (out[nodes] * way).sum(axis=1)[:, None] * way
        return out


def build_supports(
    scene: Scene, mesh: CurtainMesh, disc: Discretization, factor: float = 1.0, released: frozenset[int] = frozenset()
) -> Supports:
    """The supports of a scene with prescribed moves scaled by `factor` (load steps), without the numbers `released`.

    InputError for supports that contradict each other, and bars on bent or held edges.
    """
    held = tuple(
        _held(scene, number, mesh, disc, factor) for number in range(len(scene.support)) if number not in released
    )
    positions = padded(disc.nodes, scene.d)
    mask, ways = np.zeros(positions.shape, bool), np.zeros(positions.shape)
    stiff = mask.copy()
    lines_first = sorted(held, key=lambda one: one.slide is None)
    for number, one in enumerate(lines_first):
        here, target = np.zeros_like(mask), np.zeros_like(positions)
        here[one.nodes], target[one.nodes] = one.mask, one.positions
        away = np.where(here & mask, target - positions, 0.0)
        clash = np.abs(away - (away * ways).sum(axis=1)[:, None] * ways) > 1e-9 * mesh.size
        if clash.any():
            node, axis = np.argwhere(clash)[0]
            x, y = disc.nodes[node]
            before = reversed(lines_first[:number])
            other = next(other for other in before if other.mask[other.nodes == node, axis].any())
            scene.refuse(
                f"[support]: {other.name} and {one.name} hold the point ({x:g}, {y:g}) at different places, "
                f"{'xyz'[axis]} = {positions[node, axis]:g} and {target[node, axis]:g} mm"
            )
        positions = np.where(here, target, positions)
        mask |= here
        if one.slide is None:
            stiff |= here
        else:
            ways[one.nodes] = one.slide
    partly = np.flatnonzero(ways.any(axis=1) & stiff.any(axis=1) & ~stiff.all(axis=1))
    if len(partly):
        x, y = disc.nodes[partly[0]]
        scene.refuse(
            f"[support]: another support holds some components of the point ({x:g}, {y:g}), which slides on a sloping "
            "line; hold all of them there, or none"
        )
    lines = [(one.nodes, one.slide) for one in held if one.slide is not None]
    sliding = sliding_nodes(lines, np.asarray(stiff.all(axis=1)), scene.d)
    return Supports(held, mask, positions, sliding, Sliding.none(scene.d), straight_bars(scene, mesh, disc, mask))


def _held(scene: Scene, number: int, mesh: CurtainMesh, disc: Discretization, factor: float) -> Held:
    """What a support holds of a discretisation: of an edge also its facets, and of P2 their middles between ends."""
    item, places, d = scene.support[number], mesh.places[number], scene.d
    with scene.in_errors():
        held = item.hold(mesh.border, mesh.border.nodes(places.edge) if places.edge else places.nodes)
        _check_held(held, item, d)
    positions = held.positions[:, :d] + factor * scene.vector(item.move)
    slide, facets = None if held.slide is None else held.slide[:d], mesh.edges.get(places.edge, NONE)
    facets = facets[np.isin(mesh.mesh.facets[:, facets], held.nodes).all(axis=0)]
    held = replace(held, mask=held.mask[:, :d], positions=positions, slide=slide, facets=facets, number=number)
    if disc.element != "P2" or not len(facets):
        return held
    place = np.zeros(len(mesh.border.points), np.int64)
    place[held.nodes] = np.arange(len(held.nodes))
    ends = place[mesh.mesh.facets[:, held.facets]]
    nodes = np.concatenate([held.nodes, len(mesh.border.points) + held.facets])
    order = in_order(disc.nodes[nodes])
    mask = np.concatenate([held.mask, held.mask[ends[0]]])[order]
    positions = np.concatenate([held.positions, held.positions[ends].mean(axis=0)])[order]
    return replace(held, nodes=nodes[order], mask=mask, positions=positions)


def _check_held(held: Held, item: Support, d: int) -> None:
    """InputError for what `hold` of a support, which may be of a plugin, returns instead of held components."""
    if not isinstance(held, Held):
        what = f"not macro_fem.scene.Held: return self.held_at({item.kind!r}, border, nodes, border.points[nodes])"
        raise InputError(f"{item.where}: hold returns {shown(held)}, {what}")
    mask, positions = held.mask, held.positions
    if mask.shape != positions.shape or len(mask) != len(held.nodes) or mask.shape[1:] not in ((d,), (3,)):
        what = f"{len(held.nodes)} nodes, mask {mask.shape}, positions {positions.shape}"
        raise InputError(f"{item.where}: hold returns {what}; these are (k,), (k, 3) and (k, 3)")
    if not np.isfinite(positions[mask]).all():
        raise InputError(f"{item.where}: hold returns positions that are not finite")


def sliding_nodes(lines: list[tuple[Index, Array]], whole: np.ndarray, d: int) -> Sliding:
    """The nodes of lines (nodes (k,), unit vector (d,)), but those on two that cross and those held as a `whole`."""
    way = np.zeros((len(whole), d))
    fixed = whole.copy()
    for nodes, e in lines:
        before = way[nodes]
        fixed[nodes] |= before.any(axis=1) & (np.abs(before @ e) < 1.0 - PARALLEL)
        way[nodes] = e
    free = np.flatnonzero(way.any(axis=1) & ~fixed)
    return Sliding(free, way[free])


def straight_bars(scene: Scene, mesh: CurtainMesh, disc: Discretization, mask: np.ndarray) -> sparse.csc_matrix | None:
    """Weights (n, n) that put the nodes of straight bars between their ends, x = (1 - s) x_first + s x_last; None
    without bars. InputError for an edge that is bent, has components in the `mask` (n, d) of held ones, or two bars."""
    X, ties, tied = disc.nodes, sparse.eye(disc.n_nodes, format="lil"), np.zeros(disc.n_nodes, bool)
    for bar in (one for one in scene.of(Bar) if one.straight):
        nodes = edge_nodes(mesh, disc, bar.edge)
        if mask[nodes].any() or tied[nodes].any():
            scene.refuse(f"[load.bar] edge = {bar.edge!r}: is held, or has a second bar")
        off = X[nodes] - X[nodes[0]]
        if np.abs(cross(off, unit(off[-1])[:2])).max() > 1e-6 * mesh.size:
            scene.refuse(f"[load.bar] edge = {bar.edge!r}: is not straight, use straight = false")
        inner, s = nodes[1:-1], off[1:-1] @ off[-1] / (off[-1] @ off[-1])
        ties[inner, inner] = 0.0
        ties[inner, nodes[0]], ties[inner, nodes[-1]] = 1.0 - s, s
        tied[nodes] = True
    return ties.tocsc() if tied.any() else None


def pin_sliding(supports: Supports, disc: Discretization, force: Array, scene: Scene) -> Supports:
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
            scene.refuse(f"[support]: {what}, so that it falls")
        for way, at in _free_ways(supports, own, disc):
            push = float((force[own] @ way).sum())
            if abs(push) > 1e-9 * total:
                scene.refuse(
                    f"[load]: nothing carries the force of {push:.6g} N along {told(way)}, in which the supports let "
                    f"the piece around ({x:g}, {y:g}) slide"
                )
            nodes.append(at)
            ways.append(way)
    d = supports.mask.shape[1]
    return replace(supports, pins=Sliding(np.array(nodes, np.int64), np.array(ways, float).reshape(-1, d)))


def check_pins(pins: Sliding, force: Array, noise: float, scene: Scene, table: str) -> Array:
    """The forces (m,) in N that pins bear of nodal ones (n, d); InputError naming a table if one exceeds `noise`."""
    forces = pins.along(force)
    if np.abs(forces).max(initial=0.0) > noise:
        worst = int(np.abs(forces).argmax())
        scene.refuse(
            f"[{table}]: nothing carries the force of {-forces[worst]:.6g} N along {told(pins.direction[worst])}, "
            "in which the supports let the curtain slide: hold it there"
        )
    return forces


def told(way: Array) -> str:
    """A direction in words: the letter of an axis, else its components."""
    return str(np.round(way, 6).tolist()) if sloping(way) else "xyz"[int(np.argmax(np.abs(way)))]


def _free_ways(supports: Supports, nodes: np.ndarray, disc: Discretization) -> list[tuple[Array, int]]:
    """Unit vectors (d,) along which nothing holds a piece of nodes (k,), each with a held node in its middle."""
    X, sliding, held = disc.nodes, supports.sliding, nodes[supports.mask[nodes].any(axis=1)]
    on_line = np.isin(sliding.nodes, nodes)
    e = sliding.direction[on_line]
    against = np.diag(supports.mask[held].sum(axis=0)) - e.T @ e  # w.against.w: what the held nodes hold of a way w
    out = []
    for way in (*np.eye(len(against)), *e[:1]):
        if way @ against @ way < PARALLEL:
            at = sliding.nodes[on_line] if sloping(way) else held
            away = X[at] - X[at].mean(axis=0)
            away = away if sloping(way) else away[:, [int(way.argmax()) % 2]]
            out.append((way, int(at[np.linalg.norm(away, axis=1).argmin()])))
    return out
