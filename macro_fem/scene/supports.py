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
from macro_fem.scene.mesh import CurtainMesh, components
from macro_fem.scene.schema import Scene
from macro_fem.scene.tables import NO_MOVE, Bar, Corners, Edge, Hooks, Point, Rail, Top, in_3d
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

    `facets` (m,): the facets of the mesh that are held as a whole; none for corners, hooks and points.
    """

    name: str
    nodes: np.ndarray
    mask: np.ndarray
    positions: Array
    facets: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64), repr=False)


@dataclass(frozen=True, eq=False)
class Supports:
    """All supports of a scene on a discretisation: components held (n_nodes, d), where, by which, and ties T.

    `pinned` holds components (n_nodes, d) that only remove a free sliding and carry no force.
    """

    held: tuple[Held, ...]
    mask: np.ndarray
    positions: Array
    pinned: np.ndarray
    tie: sparse.csc_matrix | None = field(default=None, repr=False)

    def fem(self, disc: Discretization) -> SupportedFem:
        """The discretisation with these supports."""
        fixed = self.mask | self.pinned
        return SupportedFem(disc, np.where(fixed, self.positions, 0.0), ~fixed.ravel(), self.tie)


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
    for number, one in enumerate(held):
        here = np.zeros_like(mask)
        here[one.nodes] = one.mask
        target = np.zeros_like(positions)
        target[one.nodes] = one.positions
        clash = here & mask & (np.abs(target - positions) > 1e-9 * mesh.size)
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
    supports = Supports(held, mask, positions, np.zeros_like(mask))
    bars = [bar for bar in scene.load.bar if bar.straight]
    return replace(supports, tie=_straight_bars(bars, scene, mesh, disc, mask)) if bars else supports


def _held(number: int, scene: Scene, mesh: CurtainMesh, disc: Discretization, factor: float) -> Held:
    """The nodes, components and positions of one support; InputError if it asks for what has no effect."""
    X, item, source, d = disc.nodes, scene.support[number], scene.source, scene.d
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
    places = mesh.hooks[number]
    hook = f"{scene.source}: [support] (hooks, pitch = {item.pitch:g})"
    return np.concatenate([point_node((float(x), float(y)), disc, hook) for x, y in places])


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
    if supports.tie is not None and pinned.any():
        kept = ~(supports.mask | pinned).ravel()
        tie = supports.tie[:, np.flatnonzero(kept[_tie_masters(supports)])]
        return replace(supports, pinned=pinned, tie=tie)
    return replace(supports, pinned=pinned)


def _tie_masters(supports: Supports) -> np.ndarray:
    """The flat number of the component that each column of T stands for: the row in which it is the only entry, 1."""
    tie = supports.tie
    assert tie is not None
    rows = tie.tocsr()
    single = np.flatnonzero(np.diff(rows.indptr) == 1)
    masters = np.full(tie.shape[1], -1)
    column = rows.indices[rows.indptr[single]]
    value = rows.data[rows.indptr[single]]
    masters[column[value == 1.0]] = single[value == 1.0]
    return masters
