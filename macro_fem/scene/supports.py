"""Supports of a scene as held components of nodes, with the checks that need no solver.

A support holds some components of some nodes at given positions. Scenes that must fail are refused here:
supports that contradict each other, pieces of the curtain that nothing holds, loads along a direction that slides.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from macro_fem.fem.discretization import Discretization
from macro_fem.fem.space import in_space_of
from macro_fem.fem.supported import SupportedFem
from macro_fem.scene.cables import Sliding, edge_line, placed_along, sliding_nodes, sloping, track_of, unit_direction
from macro_fem.scene.meshing.mesh import CurtainMesh, components
from macro_fem.scene.schema import Scene
from macro_fem.scene.tables import NO_MOVE, Bar, Corners, Edge, Hooks, Point, Rail, Top, Track, Vector, in_3d
from macro_fem.scene.tracks import track_places
from rve.common.errors import InputError
from rve.common.types import Array


def held_axes(held: str, d: int) -> tuple[bool, ...]:
    """Which of d components a support holds: "both" are all.

    >>> held_axes("both", 3), held_axes("yz", 3), held_axes("yz", 2)
    ((True, True, True), (False, True, True), (False, True))
    """
    return tuple(held == "both" or axis in held for axis in "xyz"[:d])


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
    facets: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64), repr=False)
    slide: Array | None = None


@dataclass(frozen=True, eq=False)
class Supports:
    """All supports of a scene on a discretisation: components held (n_nodes, d), where, by which, and ties T.

    `pinned` holds components (n_nodes, d) that only remove a free sliding and carry no force. `sliding`: nodes on
    sloping lines, the last columns of T; the mask has all their components.
    """

    held: tuple[Held, ...]
    mask: np.ndarray
    positions: Array
    pinned: np.ndarray
    tie: sparse.csc_matrix | None = field(default=None, repr=False)
    sliding: Sliding | None = field(default=None, repr=False)

    def fem(self, disc: Discretization, method: str = "auto") -> SupportedFem:
        """The discretisation with these supports; `method` of `macro_fem.fem.linear` factorizes its matrices."""
        fixed = self.mask | self.pinned
        return SupportedFem(disc, np.where(fixed, self.positions, 0.0), ~fixed.ravel(), self.tie, method)


def edge_nodes(mesh: CurtainMesh, disc: Discretization, name: str, where: str) -> np.ndarray:
    """Node numbers on the named edge, ordered along it for straight ones; InputError if there is no such edge."""
    ends = mesh.mesh.p[:, mesh.mesh.facets[:, mesh.edge(name, where)]]
    candidates = np.concatenate([ends[:, 0].T, ends[:, 1].T, ends.mean(axis=1).T])
    distance, node = cKDTree(disc.nodes).query(candidates)
    nodes = np.unique(node[distance < 1e-9 * mesh.size])
    return nodes[np.lexsort((disc.nodes[nodes, 1], disc.nodes[nodes, 0]))]


def build_supports(scene: Scene, mesh: CurtainMesh, disc: Discretization, factor: float = 1.0) -> Supports:
    """The supports of a scene with prescribed moves scaled by `factor` (load steps)."""
    held = tuple(_held(number, scene, mesh, disc, factor) for number in range(len(scene.support)))
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
    supports = Supports(held, mask, positions, np.zeros_like(mask))
    bars = [bar for bar in scene.load.bar if bar.straight]
    if bars:
        supports = replace(supports, tie=_straight_bars(bars, scene, mesh, disc, mask))
    lines = [(one.nodes, one.slide) for one in held if one.slide is not None]
    return with_sliding(supports, lines, _held_as_a_whole(held, disc, scene.source)) if lines else supports


def with_sliding(supports: Supports, lines: list[tuple[np.ndarray, Array]], whole: np.ndarray) -> Supports:
    """The supports with columns of T for nodes (k,) that slide along unit vectors (d,), except those held as a `whole`
    (n_nodes,)."""
    sliding = sliding_nodes(lines, whole)
    tie = sliding.tied(supports.tie, ~supports.mask)
    return replace(supports, tie=tie, sliding=sliding)


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


def _held(number: int, scene: Scene, mesh: CurtainMesh, disc: Discretization, factor: float) -> Held:
    """The nodes, components and positions of one support; InputError if it asks for what has no effect."""
    X, item, source, d = disc.nodes, scene.support[number], scene.source, scene.d
    if isinstance(item, Track):
        return _on_track(number, item, scene, mesh, disc)
    if isinstance(item, Edge) and item.along is not None:
        return _on_line(item, item.along, scene, mesh, disc, factor)
    facets = np.zeros(0, np.int64)
    gather, held = 1.0, "both"
    match item:
        case Corners():
            nodes, name = _top_corners(scene, mesh, disc), "corners"
            gather = item.gather
        case Top() | Rail():
            name = "top" if isinstance(item, Top) else "rail"
            where = f"{source}: [support] kind = '{name}' needs edge"
            nodes, facets = edge_nodes(mesh, disc, "top", where), mesh.edge("top", where)
            gather, held = (item.gather, "both") if isinstance(item, Top) else (1.0, "yz")
        case Hooks():
            nodes, name = _hook_nodes(number, item, scene, mesh, disc), "hooks"
            gather, held = item.gather, "yz" if item.sliding else "both"
        case Edge():
            where = f"{source}: [support] edge"
            nodes, facets = edge_nodes(mesh, disc, item.edge, where), mesh.edge(item.edge, where)
            name, gather, held = f"edge {item.edge}", item.gather, item.held
        case Point():
            nodes = point_node(item.at, disc, f"{source}: [support] (point)")
            name = f"point ({item.at[0]:g}, {item.at[1]:g})"
            held = item.held
    target = _gathered_edge(X[nodes], gather) if isinstance(item, Edge) else _gathered(X[nodes], gather, mesh)
    mask = np.tile(held_axes(held, d), (len(nodes), 1))
    if gather != 1.0 and np.abs((target - X[nodes])[mask[:, :2]]).max(initial=0.0) <= 1e-9 * mesh.size:
        raise InputError(f"{source}: [support] gather = {gather:g}: has no effect on {name}, which it holds as it is")
    move = np.array(in_3d(getattr(item, "move", NO_MOVE))[:d])
    return Held(name, nodes, mask, in_space_of(target, d) + factor * move, facets)


def _on_track(number: int, item: Track, scene: Scene, mesh: CurtainMesh, disc: Discretization) -> Held:
    """The top edge on its track: as a whole, or at its runners."""
    where = f"{scene.source}: [support] (track)"
    line, s, curve = track_of(item, mesh, where)
    if item.pitch is None:
        nodes, places = placed_along(mesh, disc, line, track_places(item, curve, s, s[-1]))
        facets = mesh.edges["top"]
    else:
        nodes, facets = _runner_nodes(mesh.hooks[number], where, disc), np.zeros(0, np.int64)
        places = track_places(item, curve, np.linspace(0.0, s[-1], len(nodes)), s[-1])
    return Held("track", nodes, np.ones(places.shape, bool), places, facets)


def _on_line(
    item: Edge, along: tuple[Vector, Vector], scene: Scene, mesh: CurtainMesh, disc: Discretization, factor: float
) -> Held:
    """A named edge on a straight line in space, evenly between the two points, held or free to slide."""
    d = scene.d
    line, s = edge_line(mesh, item.edge, f"{scene.source}: [support] edge")
    first, last = (np.array(point[:d]) for point in along)
    nodes, places = placed_along(mesh, disc, line, first + (s / s[-1])[:, None] * (last - first))
    e = unit_direction(last - first)
    mask = np.ones(places.shape, bool)
    if item.sliding and not sloping(e):
        mask[:, e != 0.0] = False
    slide = e if item.sliding and sloping(e) else None
    move = factor * np.array(in_3d(item.move)[:d])
    return Held(f"edge {item.edge}", nodes, mask, places + move, mesh.edges[item.edge], slide)


def _gathered_edge(X: Array, gather: float) -> Array:
    """Positions X (k, 2) of an edge narrowed about the middle of its bounding box."""
    centre = 0.5 * (X.min(axis=0) + X.max(axis=0))
    return np.asarray(centre + gather * (X - centre))


def _gathered(X: Array, gather: float, mesh: CurtainMesh) -> Array:
    """Positions X (k, 2) of the top edge narrowed about the middle of the curtain."""
    middle = 0.5 * (mesh.mesh.p[0].min() + mesh.mesh.p[0].max())
    return np.stack([middle + gather * (X[:, 0] - middle), X[:, 1]], axis=-1)


def _top_corners(scene: Scene, mesh: CurtainMesh, disc: Discretization) -> np.ndarray:
    where = f"{scene.source}: [support] kind = 'corners' needs edge"
    if disc.element == "CR":
        raise InputError(f"{scene.source}: [support] kind = 'corners': element 'CR' has no nodes at corners, use 'P1'")
    nodes = edge_nodes(mesh, disc, "top", where)
    return nodes[[0, -1]]


def _hook_nodes(number: int, item: Hooks, scene: Scene, mesh: CurtainMesh, disc: Discretization) -> np.ndarray:
    """The nodes at the hooks of support `number`."""
    where = f"{scene.source}: [support] kind = 'hooks' needs edge"
    if disc.element == "CR":
        raise InputError(f"{scene.source}: [support] kind = 'hooks': element 'CR' has no nodes at hooks, use 'P1'")
    mesh.edge("top", where)
    return _runner_nodes(mesh.hooks[number], f"{scene.source}: [support] (hooks, pitch = {item.pitch:g})", disc)


def _runner_nodes(places: Array, where: str, disc: Discretization) -> np.ndarray:
    return np.concatenate([point_node((float(x), float(y)), disc, where) for x, y in places])


def point_node(at: tuple[float, float], disc: Discretization, where: str) -> np.ndarray:
    """The number (1,) of the node at a point; InputError, which tells the nearest one, if there is none."""
    if disc.element == "CR":
        raise InputError(f"{where} at = {list(at)}: element 'CR' has no nodes at points, use 'P1'")
    distance = np.linalg.norm(disc.nodes - np.array(at), axis=1)
    node = int(np.argmin(distance))
    if distance[node] > 1e-9 * float(np.hypot(*np.ptp(disc.nodes, axis=0))):
        x, y = disc.nodes[node]
        raise InputError(f"{where} at = {list(at)}: the mesh has no node there, the nearest one is at ({x:g}, {y:g})")
    return np.array([node])


def _straight_bars(
    bars: list[Bar], scene: Scene, mesh: CurtainMesh, disc: Discretization, mask: np.ndarray
) -> sparse.csc_matrix:
    """T that keeps the nodes of every bar on a line; InputError for bars on bent or held edges."""
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
    return straight_ties(lines, disc.nodes, mask)


def straight_ties(lines: list[np.ndarray], X: Array, mask: np.ndarray) -> sparse.csc_matrix:
    """T that puts the nodes of each line between its first and its last: x = (1 - s) x_first + s x_last."""
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
    T = sparse.coo_matrix(
        (
            np.concatenate([np.ones(len(own)), *values]),
            (np.concatenate([own, *rows]), np.concatenate([own, *columns])),
        ),
        shape=(n, n),
    ).tocsc()
    both = sparse.kron(T, sparse.eye(mask.shape[1]), format="csc")
    free = ~mask & ~tied[:, None]
    return both[:, free.ravel()]


def pin_sliding(supports: Supports, disc: Discretization, force: Array, source: object) -> Supports:
    """Pins one component of every piece of the curtain that can slide along x, y or z as a whole.

    InputError for a piece that nothing holds, and for a load `force` (n_nodes, d) along a free sliding.
    """
    number, label = components(disc.cell_dofs, disc.n_nodes)
    pinned = np.zeros_like(supports.mask)
    total = float(np.abs(force).sum())
    for piece in range(number):
        nodes = np.flatnonzero(label == piece)
        held = supports.mask[nodes].any(axis=0)
        x, y = disc.nodes[nodes].mean(axis=0)
        if not held.any():
            what = "nothing holds the curtain" if number == 1 else f"nothing holds the piece around ({x:g}, {y:g})"
            raise InputError(f"{source}: [support]: {what}, so that it falls")
        for axis in np.flatnonzero(~held):
            push = float(force[nodes, axis].sum())
            if abs(push) > 1e-9 * total:
                raise InputError(
                    f"{source}: [load]: nothing carries the force of {push:.6g} N along {'xyz'[axis]}, in which the "
                    f"supports let the piece around ({x:g}, {y:g}) slide"
                )
            other = nodes[supports.mask[nodes].any(axis=1)]
            along = disc.nodes[other, axis % 2]
            middle = other[np.argmin(np.abs(along - along.mean()))]
            pinned[middle, axis] = True
        if supports.sliding is not None:
            supports = _pin_on_line(supports, supports.sliding, nodes, disc, force, source)
    if supports.tie is not None and pinned.any():
        kept = ~(supports.mask | pinned).ravel()
        masters = _tie_masters(supports)
        tie = supports.tie[:, np.flatnonzero((masters < 0) | kept[masters])]
        return replace(supports, pinned=pinned, tie=tie)
    return replace(supports, pinned=pinned)


def _pin_on_line(
    supports: Supports, sliding: Sliding, nodes: np.ndarray, disc: Discretization, force: Array, source: object
) -> Supports:
    """The supports, with one node fixed where the piece (k,) of the curtain can slide along its sloping lines."""
    here = np.flatnonzero(np.isin(sliding.nodes, nodes))
    way = sliding.common(sliding.nodes[here])
    others = np.setdiff1d(nodes, sliding.nodes[here])
    if way is None or way[supports.mask[others].any(axis=0)].any():
        return supports
    push = float(force[nodes].sum(axis=0) @ way)
    if abs(push) > 1e-9 * float(np.abs(force).sum()):
        x, y = disc.nodes[nodes].mean(axis=0)
        raise InputError(
            f"{source}: [load]: nothing carries the force of {push:.6g} N along {np.round(way, 6).tolist()}, in which "
            f"the supports let the piece around ({x:g}, {y:g}) slide"
        )
    assert supports.tie is not None
    X = disc.nodes[sliding.nodes[here]]
    middle = int(here[np.argmin(np.linalg.norm(X - X.mean(axis=0), axis=1))])
    column = supports.tie.shape[1] - len(sliding.nodes) + middle
    tie = supports.tie[:, np.delete(np.arange(supports.tie.shape[1]), column)]
    return replace(supports, tie=tie, sliding=sliding.without(middle))


def _tie_masters(supports: Supports) -> np.ndarray:
    """The flat number of the component that each column of T stands for: the row in which it is the only entry, 1.

    -1 for nodes on sloping lines.
    """
    tie = supports.tie
    assert tie is not None
    rows = tie.tocsr()
    single = np.flatnonzero(np.diff(rows.indptr) == 1)
    masters = np.full(tie.shape[1], -1)
    column = rows.indices[rows.indptr[single]]
    value = rows.data[rows.indptr[single]]
    masters[column[value == 1.0]] = single[value == 1.0]
    return masters
