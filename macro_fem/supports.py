"""Supports of a scene as held components of nodes, with the checks that need no solver.

A support holds some components of some nodes at given positions. Everything that is certain to fail is found here:
supports that contradict each other, pieces of the curtain that nothing holds, loads along a direction that slides.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from homogenize.law import Array, InputError
from macro_fem.assembly import Discretization
from macro_fem.fem import SupportedFem
from macro_fem.mesh import CurtainMesh, components
from macro_fem.scene import Bar, Corners, Edge, Hooks, Point, Rail, Scene, Support, Top

HELD = {"both": (True, True), "x": (True, False), "y": (False, True)}


@dataclass(frozen=True, eq=False)
class Held:
    """What one support holds: `nodes` (k,), `mask` (k, d) of components and their `positions` (k, d)."""

    name: str
    nodes: np.ndarray
    mask: np.ndarray
    positions: Array


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
    if name not in mesh.edges:
        raise InputError(f"{where} = {name!r}: the curtain has no such edge, only {', '.join(sorted(mesh.edges))}")
    ends = mesh.mesh.p[:, mesh.mesh.facets[:, mesh.edges[name]]]
    candidates = np.concatenate([ends[:, 0].T, ends[:, 1].T, ends.mean(axis=1).T])
    distance, node = cKDTree(disc.nodes).query(candidates)
    nodes = np.unique(node[distance < 1e-9 * mesh.size])
    return nodes[np.lexsort((disc.nodes[nodes, 1], disc.nodes[nodes, 0]))]


def build_supports(scene: Scene, mesh: CurtainMesh, disc: Discretization, factor: float = 1.0) -> Supports:
    """The supports of a scene with prescribed moves scaled by `factor` (load steps)."""
    held = tuple(_held(item, scene, mesh, disc, factor) for item in scene.support)
    mask = np.zeros((disc.n_nodes, 2), bool)
    positions = disc.nodes.copy()
    owner = np.full((disc.n_nodes, 2), -1)
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
                f"{'xy'[axis]} = {positions[node, axis]:g} and {target[node, axis]:g} mm"
            )
        positions = np.where(here, target, positions)
        mask |= here
        owner = np.where(here, number, owner)
    supports = Supports(held, mask, positions, np.zeros_like(mask))
    bars = [bar for bar in scene.load.bar if bar.straight]
    return replace(supports, tie=_straight_bars(bars, scene, mesh, disc, mask)) if bars else supports


def _held(item: Support, scene: Scene, mesh: CurtainMesh, disc: Discretization, factor: float) -> Held:
    """The nodes, components and positions of one support."""
    X = disc.nodes
    match item:
        case Corners():
            nodes, name = _top_corners(scene, mesh, disc), "corners"
            target = _gathered(X[nodes], item.gather, mesh) + factor * np.array(item.move)
            mask = np.ones((len(nodes), 2), bool)
        case Top():
            nodes, name = edge_nodes(mesh, disc, "top", f"{scene.source}: [support] kind = 'top' needs edge"), "top"
            target = _gathered(X[nodes], item.gather, mesh) + factor * np.array(item.move)
            mask = np.ones((len(nodes), 2), bool)
        case Rail():
            nodes, name = edge_nodes(mesh, disc, "top", f"{scene.source}: [support] kind = 'rail' needs edge"), "rail"
            target, mask = X[nodes], np.tile([False, True], (len(nodes), 1))
        case Hooks():
            nodes, name = _hook_nodes(item, scene, mesh, disc), "hooks"
            target = _gathered(X[nodes], item.gather, mesh)
            mask = np.tile([not item.sliding, True], (len(nodes), 1))
        case Edge():
            nodes = edge_nodes(mesh, disc, item.edge, f"{scene.source}: [support] edge")
            name = f"edge {item.edge}"
            centre = 0.5 * (X[nodes].min(axis=0) + X[nodes].max(axis=0))
            target = centre + item.gather * (X[nodes] - centre) + factor * np.array(item.move)
            mask = np.tile(HELD[item.held], (len(nodes), 1))
        case Point():
            nodes = _nearest(item.at, mesh, disc, f"{scene.source}: [support] (point) at")
            name = f"point ({item.at[0]:g}, {item.at[1]:g})"
            target, mask = X[nodes] + factor * np.array(item.move), np.array([HELD[item.held]])
    return Held(name, nodes, mask, target)


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


def _hook_nodes(item: Hooks, scene: Scene, mesh: CurtainMesh, disc: Discretization) -> np.ndarray:
    """The nodes of the top edge nearest to equally spaced hooks, the outermost ones at its ends."""
    where = f"{scene.source}: [support] kind = 'hooks' needs edge"
    if disc.element == "CR":
        raise InputError(f"{scene.source}: [support] kind = 'hooks': element 'CR' has no nodes at hooks, use 'P1'")
    nodes = edge_nodes(mesh, disc, "top", where)
    x = disc.nodes[nodes, 0]
    length = float(np.ptp(x))
    if item.pitch > length:
        raise InputError(f"{scene.source}: [support] pitch = {item.pitch:g}: is wider than the top edge, {length:g} mm")
    count = min(length / item.pitch, 1e9)
    chosen = nodes[:0]
    if count < len(x):  # before the places are made
        places = np.linspace(x[0], x[-1], round(count) + 1)
        chosen = np.unique(cKDTree(x[:, None]).query(places[:, None])[1])
    if len(chosen) < round(count) + 1:
        raise InputError(
            f"{scene.source}: [support] pitch = {item.pitch:g}: is finer than the mesh, whose nodes on the top edge "
            f"are {length / max(1, len(x) - 1):g} mm apart; use more cells"
        )
    return nodes[chosen]


def _nearest(at: tuple[float, float], mesh: CurtainMesh, disc: Discretization, where: str) -> np.ndarray:
    distance, node = cKDTree(disc.nodes).query(np.array(at))
    longest = float(np.linalg.norm(np.diff(mesh.mesh.p[:, mesh.mesh.facets], axis=1), axis=0).max())
    if distance > longest:
        raise InputError(f"{where} = {list(at)}: is {distance:g} mm away from the curtain")
    return np.array([int(node)])


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
    both = sparse.kron(T, sparse.eye(2), format="csc")
    free = ~mask & ~tied[:, None]
    return both[:, free.ravel()]


def pin_sliding(supports: Supports, mesh: CurtainMesh, disc: Discretization, force: Array, source: object) -> Supports:
    """Pins one component of every piece of the curtain that can slide along x or y as a whole.

    InputError if a piece hangs on nothing, or if the load `force` (n_nodes, 2) would push it along for ever.
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
            raise InputError(f"{source}: [support]: {what}, it would fall for ever")
        for axis in np.flatnonzero(~held):
            push = float(force[nodes, axis].sum())
            if abs(push) > 1e-9 * total:
                raise InputError(
                    f"{source}: [load]: nothing carries the force of {push:.6g} N along {'xy'[axis]}, in which the "
                    f"supports let the piece around ({x:g}, {y:g}) slide"
                )
            other = nodes[supports.mask[nodes, 1 - axis]]
            middle = other[np.argmin(np.abs(disc.nodes[other, axis] - disc.nodes[other, axis].mean()))]
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
