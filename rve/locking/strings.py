"""Rings drawn to strings: the strains of a mesh of inextensible loops, and the largest work there, h_strings.

Rings that have collapsed are loops as long as their centre circles, which tension lays into the plane of the sheet.
Let s = r2_a + r2_b of rings a and b that interlink, p the wire of b inside of a and p' that of a inside of b. Wires
touch at one point between both, and each runs about the other with the radius s. So, with the links of a ring in their
order along its wire,

    |p' - p| <= s,    closed polygon through the places p of a ring <= 2 pi (r1 - s).

These are second-order cones: the lattices, and F, that have such places are a convex set K2. Larger cells have no other
lattices, as the mean of their translates is a primitive cell. The work S:E = 1/2 (|F L|^2 - tr S), S = L L^T, is convex
in F. Newton's method with a logarithmic barrier climbs it from several lattices; each step takes the work's own
curvature where that leaves a maximum, else its slope alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rve.common import Array, ByValue, Flags, Index, JsonObject, NotConverged
from rve.common.tensor import double_dot, trace
from rve.geometry.cell import Cell, weave_axes, weave_sides
from rve.geometry.kinematics import green_lagrange
from rve.geometry.pose import pair_geometry, start_pose
from rve.geometry.ring_pair import tangent_frame
from rve.geometry.weave import Weave

SHARPNESS = np.array([1.0, 1e1, 1e2]), np.array([1e2, 1e3, 1e4]), np.array([1e5, 1e6, 1e7, 1e8, 1e9, 1e10])
"""Weights of the work against the barrier: along its slope at the start, on all climbs, and on those that are left. The
relative error is some 30 times the inverse of the last."""
_SIGNS = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class StringMesh(ByValue):
    """Loops of a weave, in r1. The unknowns y (m,): u, v, w of the lattice a1 = (u, 0), a2 = (v, w); p of the links but
    the first, whose p is at the origin; (p' - p) / s of the links; lengths t of the edges.

    links (l, 4): as `Pattern.pairs`; ring, link (e,): of each edge its polygon and the link that it begins at;
    corners (e, 2, m): where; cones (c, 3, m), heads (c,): t >= |edge| and 1 >= |p' - p| / s; thin (k,):
    radii of the rings' bends; lengths (k,) of their polygons.
    """

    links: Index
    ring: Index
    link: Index
    corners: Array
    cones: Array
    heads: Array
    thin: Array
    lengths: Array

    @staticmethod
    def of(weave: Weave, wire: float) -> StringMesh:
        """The loops of a weave of wire r2/r1. Of a ring that meets wires of several sizes the thinnest counts, which
        makes K2 too large by the difference."""
        links = weave.pairs[weave.linked]
        count, s = len(links), wire * weave.wires[links[:, :2]].sum(axis=1)
        m = 1 + 4 * count
        unit, tie = np.eye(m + 2 * count), np.zeros((count, 2, m + 2 * count))
        place = np.zeros((2, *tie.shape))  # of p and p', seen with the first and with the second ring in the first cell
        place[:, 1:] = unit[3 : 1 + 2 * count].reshape(1, count - 1, 2, -1)
        tie[:] = unit[1 + 2 * count : m].reshape(count, 2, -1)
        place[1] += s[:, None, None] * tie
        place[1, :, 0, :2] -= links[:, 2:]
        place[1, :, 1, 2] -= links[:, 3]
        at, edges = _order(weave), []
        for k in range(weave.classes):
            side, link = np.nonzero(np.equal(links[:, :2].T, k))
            turn = np.argsort(at[side, link])
            edges.append(np.stack([np.full(len(turn), k), side[turn], link[turn], np.roll(link[turn], -1)]))
        ring, side, link, _ = np.concatenate(edges, axis=1)
        corners = place[side, link]
        ends = np.concatenate([np.roll(corners[ring == k], -1, axis=0) for k in range(weave.classes)])
        cones = np.concatenate([unit[m:, None], ends - corners], axis=1)
        cones = np.concatenate([cones, np.concatenate([0.0 * tie[:, :1], tie], axis=1)])
        heads = np.repeat([0.0, 1.0], [len(ring), count])
        thin = np.array([s[link[ring == k]].min() for k in range(weave.classes)])
        return StringMesh(links, ring, link, corners, cones, heads, thin, 2.0 * np.pi * (weave.radii - thin))


def _order(weave: Weave) -> Array:
    """Angles (2, l) along the wires of the first and of the second ring at which they go through the other, slack."""
    d, n_a, n_b = (part[0, weave.linked] for part in pair_geometry(start_pose(weave, 1), weave))
    a, b = (radii[weave.linked] for radii in weave.pair_radii)
    angles = []
    for to, own, other, radius, inside in ((d, n_a, n_b, a, b), (-d, n_b, n_a, b, a)):
        e1, e2 = tangent_frame(own)
        x, y, c = (np.einsum("li,li->l", other, v) for v in (e1, e2, to))
        # The wire is in the other ring's plane where radius (x cos + y sin) = c, at one of both angles inside of it.
        mean, half = np.arctan2(y, x), np.arccos(np.clip(c / radius / np.hypot(x, y), -1.0, 1.0))
        one, two = (mean - half) % (2.0 * np.pi), (mean + half) % (2.0 * np.pi)
        point = radius[:, None] * (np.cos(one)[:, None] * e1 + np.sin(one)[:, None] * e2)
        angles.append(np.where(np.linalg.norm(point - to, axis=1) < inside, one, two))
    return np.array(angles)


@dataclass(frozen=True, eq=False)
class StringStates(ByValue):
    """States of largest work of the strings of a cell under n dead loads.

    h (n,): the work S:E in the unit of S; E (n, 3); y (n, m): see `StringMesh`; tension (n, k): of the loops in N for S
    in N/mm, spread evenly where balance leaves it open; turn (n, 2, 2): from the axes of y to
    those of the mesh, in which F is symmetric; mesh, cell: whose they are; area: of the reference cell, mm2.
    """

    cell: Cell
    mesh: StringMesh
    h: Array
    E: Array
    y: Array
    tension: Array
    turn: Array
    area: float

    def lattice(self, row: int) -> Array:
        """a1 and a2 (2, 2) in mm."""
        u, v, w = self.cell.r1 * self.y[row, :3]
        return np.asarray((np.array([[u, 0.0], [v, w]]) @ self.turn[row])[:, weave_axes(self.cell)])

    def corners(self, row: int) -> Array:
        """Places (e, 2) in mm of the wires about which the rings of the first cell run."""
        flat = self.mesh.corners @ self.y[row] @ self.turn[row]
        return np.asarray(self.cell.r1 * flat[:, weave_axes(self.cell)])

    def contacts(self, row: int) -> Array:
        """Where the wires of the links touch (l, 2) in mm, in that of the first ring of each in the first cell."""
        mesh, weave, count = self.mesh, self.cell.weave, len(self.mesh.links)
        z = self.y[row, 1 : 1 + 4 * count].reshape(2, count, 2).copy()
        z[0, 0] = 0.0
        way = weave.wires[mesh.links[:, 1], None] * self.cell.wire * z[1]
        return np.asarray(self.cell.r1 * ((z[0] + way) @ self.turn[row])[:, weave_axes(self.cell)])

    @property
    def stress(self) -> Array:
        """The largest tension over the wire's cross-section, (n,), in N/mm2 for S in N/mm."""
        return np.asarray((self.tension / self._section).max(axis=1))

    @property
    def give(self) -> Array:
        """The root of twice the energy per area of wires that stretch by T 2 pi r1/A, (n,): over that of Young's
        modulus in (mm/N)^0.5 for S in N/mm. Without friction the tension is the same all along a ring."""
        energy = self.tension**2 * (2.0 * np.pi * self.cell.r1 * self.cell.weave.radii / self._section)
        return np.asarray(np.sqrt(energy.sum(axis=1) / self.area))

    @property
    def _section(self) -> Array:
        """Cross-sections of the wires (k,), mm2."""
        return np.asarray(np.pi * (self.cell.r2 * self.cell.weave.wires) ** 2)

    def row(self, row: int) -> JsonObject:
        """A load's state as plain values: h_strings, strain, and of each ring the polygon, and whether it is tight."""
        mesh, corners, left = self.mesh, self.corners(row), _inside(self.mesh, self.y[row : row + 1])[2][0]
        loops = [
            {
                "ring": k + 1,
                "tension_N": float(self.tension[row, k]),
                "is_tight": bool(left[k] < 1e-6 * mesh.lengths[k]),
                "links": mesh.links[mesh.link[mesh.ring == k]].tolist(),
                "corners_mm": corners[mesh.ring == k].tolist(),
            }
            for k in range(len(mesh.lengths))
        ]
        E = dict(zip(("E11", "E12", "E22"), self.E[row].tolist(), strict=True))
        return {"h_strings": float(self.h[row]), "strings": E | {"loops": loops}}


def string_states(cell: Cell, S: Array, sides_mm: tuple[float, float], starts: int = 24) -> StringStates:
    """The largest work of strings under dead loads S (n, 3), positive semidefinite; sides of the reference cell.

    The maximum is sought from so many lattices: exact where one principal load is zero, else the largest that was
    found. NotConverged if no climb ends.
    """
    mesh, unit = StringMesh.of(cell.weave, cell.wire), (S / trace(S)[:, None])[:, weave_axes(cell)]
    b = np.array(weave_sides(cell, sides_mm))
    # F = [[u / b_x, v / b_y], [0, w / b_y]], so that |F L|^2 = y3 . M y3.
    M = np.zeros((len(unit), 3, 3))
    M[:, 0, 0], M[:, 1, 1], M[:, 2, 2] = unit[:, 0] / b[0] ** 2, unit[:, 2] / b[1] ** 2, unit[:, 2] / b[1] ** 2
    M[:, 0, 1] = M[:, 1, 0] = unit[:, 1] / b.prod()
    height, turn = np.arange(0.5, starts) / starts, np.pi * (1.0 + 5.0**0.5) * np.arange(starts)
    flat = np.sqrt(1.0 - height**2)
    first = np.stack([b[0] * height, b[1] * flat * np.cos(turn), b[1] * flat * np.sin(turn)], axis=1)
    pulls, per = np.einsum("nij,kj->nki", M, first), max(int(2e6 / mesh.cones.shape[2] ** 2 / starts), 1)  # 16 MB
    blocks = np.split(np.arange(len(unit)), range(per, len(unit), per))
    y = np.concatenate([_largest(mesh, M[rows], pulls[rows]) for rows in blocks])
    F = np.zeros((len(y), 2, 2))
    F[:, 0, 0], F[:, 0, 1], F[:, 1, 1] = y[:, 0] / b[0], y[:, 1] / b[1], y[:, 2] / b[1]
    E = green_lagrange(F)[:, weave_axes(cell)]
    turn, _, right = np.linalg.svd(F)
    # At the end of the path a multiplier times what is left of its constraint is 1 over the sharpness.
    pull = trace(S)[:, None] * b.prod() * cell.r1 / (SHARPNESS[-1][-1] * _inside(mesh, y)[2])
    area = float(b.prod()) * cell.r1**2
    return StringStates(cell, mesh, double_dot(S, E), E, y, pull, turn @ right, area)


def _largest(mesh: StringMesh, M: Array, pulls: Array) -> Array:
    """The states y (n, m) of largest y3 . M y3, climbed to from those drawn along `pulls` (n, k, 3)."""
    n, k, _ = pulls.shape
    load, pull = np.repeat(np.arange(n), k), pulls.reshape(-1, 3)
    pull = pull / np.linalg.norm(pull, axis=1)[:, None]
    y, still = _slack(mesh, n * k), np.zeros((n * k, 3, 3))
    y, _ = _climb(mesh, y, still, pull, SHARPNESS[0])
    near = 0.02  # climbs so near to each other go on as one, those so far below the best one end
    for part in SHARPNESS[1:]:
        y, good = _climb(mesh, y, M[load], 0.0 * pull[load], part)
        work = np.where(good, np.einsum("ni,nij,nj->n", y[:, :3], M[load], y[:, :3]), -np.inf)
        best = np.full(n, -np.inf)
        np.maximum.at(best, load, work)
        high = work > (1.0 - near) * best[load]
        _, kept = np.unique(np.column_stack([load, np.round(y[:, :3] / near)])[high], axis=0, return_index=True)
        kept = np.flatnonzero(high)[kept]
        y, load, work = y[kept], load[kept], work[kept]
    order = np.lexsort((-work, load))
    if not np.array_equal(np.unique(load), np.arange(n)):
        raise NotConverged("the strings of this weave: no climb to the largest work has ended")
    return y[order[np.unique(load[order], return_index=True)[1]]]


def _slack(mesh: StringMesh, count: int) -> Array:
    """All places at one point, `count` times: a state inside of every cone."""
    y = np.zeros((count, mesh.cones.shape[2]))
    y[:, -len(mesh.ring) :] = 0.5 * (mesh.lengths / np.bincount(mesh.ring))[mesh.ring]
    return y


def _climb(mesh: StringMesh, y: Array, M: Array, pull: Array, sharpness: Array) -> tuple[Array, Flags]:
    """The states y (n, m) of largest work y3 . M y3 / 2 + pull . y3, y3 the lattice, and whether they are such."""
    y, good = y.copy(), np.zeros(len(y), dtype=bool)
    for sharp in sharpness:
        go, good = np.arange(len(y)), np.zeros(len(y), dtype=bool)
        for _ in range(60):  # ten are usual
            at, work = y[go], (sharp * M[go], sharp * pull[go])
            step, decrement = _newton(mesh, at, *work)
            length, left, before = np.ones(len(go)), np.arange(len(go)), _merit(mesh, at, *work)
            while len(left) and length.min() > 1e-12:
                after = _merit(mesh, at[left] + length[left, None] * step[left], work[0][left], work[1][left])
                enough = before[left] - 0.1 * length[left] * decrement[left] + 1e-9 * np.abs(before[left])
                left = left[~(after <= enough)]
                length[left] *= 0.5
            y[go] = at + length[:, None] * step
            good[go] = decrement < 1e-3
            go = go[~good[go]]
            if not len(go):
                break
    return y, good


def _inside(mesh: StringMesh, y: Array) -> tuple[Array, Array, Array]:
    """The cones' vectors (n, c, 3), head^2 - |rest|^2 of them (n, c), and what is left of the lengths (n, k)."""
    s = (y @ mesh.cones.reshape(-1, y.shape[1]).T).reshape(len(y), -1, 3)
    s[..., 0] += mesh.heads
    rest = np.hypot(s[..., 1], s[..., 2])
    used = y[:, -len(mesh.ring) :] @ (mesh.ring[:, None] == np.arange(len(mesh.lengths)))
    return s, np.where(s[..., 0] > 0.0, s[..., 0] - rest, -1.0) * (s[..., 0] + rest), mesh.lengths - used


def _merit(mesh: StringMesh, y: Array, M: Array, pull: Array) -> Array:
    """The barrier less the work, (n,); infinite outside."""
    _, inside, left = _inside(mesh, y)
    holds = (inside.min(axis=1) > 0.0) & (left.min(axis=1) > 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        barrier = -np.log(inside).sum(axis=1) - np.log(left).sum(axis=1)
    work = 0.5 * np.einsum("ni,nij,nj->n", y[:, :3], M, y[:, :3]) + (pull * y[:, :3]).sum(axis=1)
    return np.where(holds, barrier - work, np.inf)


def _newton(mesh: StringMesh, y: Array, M: Array, pull: Array) -> tuple[Array, Array]:
    """Newton's step (n, m) on the merit and its decrement (n,)."""
    n, m = y.shape
    s, inside, left = _inside(mesh, y)
    Q = mesh.cones.reshape(-1, m)
    slope = -2.0 * _SIGNS * s / inside[..., None]
    bend = slope[..., :, None] * slope[..., None, :] - 2.0 * np.diag(_SIGNS) / inside[..., None, None]
    H = np.matmul(Q.T, np.einsum("ncij,cjm->ncim", bend, mesh.cones).reshape(n, -1, m))
    gradient = slope.reshape(n, -1) @ Q
    shares = (mesh.ring == np.arange(len(mesh.lengths))[:, None]) / left[..., None]
    gradient[:, -len(mesh.ring) :] += shares.sum(axis=1)
    H[:, -len(mesh.ring) :, -len(mesh.ring) :] += np.matmul(shares.transpose(0, 2, 1), shares)
    gradient[:, :3] -= np.einsum("nij,nj->ni", M, y[:, :3]) + pull
    scale = 1.0 / np.sqrt(np.einsum("nii->ni", H))
    H = H * scale[:, :, None] * scale[:, None, :]
    np.einsum("nii->ni", H)[...] += 1e-13  # loads with one principal value leave H singular
    own = M * scale[:, :3, None] * scale[:, None, :3]
    others = np.linalg.solve(H[:, 3:, 3:], H[:, 3:, :3])
    of_lattice = H[:, :3, :3] - np.matmul(H[:, :3, 3:], others) - own
    is_maximum = np.linalg.eigvalsh(of_lattice)[:, 0] > 0.0
    H[:, :3, :3] -= np.where(is_maximum[:, None, None], own, 0.0)
    step = -scale * np.linalg.solve(H, (scale * gradient)[..., None])[..., 0]
    return step, -(gradient * step).sum(axis=1)
