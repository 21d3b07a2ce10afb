"""The paper's scheme with all ten rings and every bilateral constraint: the reference of `rve.paper.stewart_trinkle`.

Each ring has six velocities. Constraints: all centres stay in the plane, ring 1 in its place, rings of one class on
parallelograms and with equal rotation (4), and the rotation rule (5). One case at a time, dense matrices, the
complementarity problem by non-negative least squares (Lawson and Hanson, scipy.optimize.nnls). It shares the distance
of two circles with the periodic form, and nothing else: neither pair lists, reduction, mass matrices nor contact
solver.

Units: mm, kg, s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, null_space, solve_triangular
from scipy.optimize import nnls

from rve.common.types import Array
from rve.geometry.circles import Minima, are_linked, local_minima
from rve.geometry.distance import distance_gradient, distance_hessian
from rve.geometry.pose import Pose, start_pose
from rve.geometry.weave import Weave
from rve.paper.dynamics import StewartTrinkleOptions
from rve.paper.stewart_trinkle import ROUND_OFF


@dataclass(frozen=True)
class TenRings:
    """Centres (n, 3) in mm, normals (n, 3), velocities (n, 6) of every ring; next time step h; time; R of eq. (9).

    steps, rejected: accepted steps so far, and those tried with too large h.
    """

    centres: Array
    normals: Array
    v: Array
    h: float
    time: float = 0.0
    R: float = np.inf
    rejected: int = 0
    steps: int = 0


def shifts(weave: Weave) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Class (n,) and lattice shift (n, 2) of every ring."""
    return weave.rings[:, 0], weave.rings[:, 1:]


def start(weave: Weave, options: StewartTrinkleOptions) -> TenRings:
    """All rings at rest in the slack pose."""
    kind, shift = shifts(weave)
    pose = start_pose(weave, 1)
    plane = pose.centres[0, kind] + shift @ np.stack([pose.a1[0], pose.a2[0]])
    centres = options.r1_mm * np.column_stack([plane, np.zeros(len(kind))])
    return TenRings(centres, pose.normals[0, kind], np.zeros((len(kind), 6)), options.h_max)


def _ring(weave: Weave, kind: int, i: int, j: int) -> int:
    return int(np.flatnonzero((weave.rings == (kind, i, j)).all(axis=1))[0])


def corners(rings: TenRings, weave: Weave) -> tuple[int, int, int, int]:
    """Numbers of the rings 1, 2, 3, 4 of the paper's Fig. 1."""
    return tuple(_ring(weave, 0, i, j) for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)))  # type: ignore[return-value]


def bilateral(rings: TenRings, weave: Weave) -> Array:
    """Jacobian B (m, 6 n) of all bilateral constraints on the velocities; redundant rows are kept."""
    kind, shift = shifts(weave)
    n = len(kind)
    one, two, three, _ = corners(rings, weave)
    rows = []

    def row(*entries: tuple[int, int, float]) -> None:
        line = np.zeros((n, 6))
        for ring, component, factor in entries:
            line[ring, component] += factor
        rows.append(line.ravel())

    first = {int(k): int(np.flatnonzero((kind == k) & (shift == 0).all(axis=1))[0]) for k in np.unique(kind)}
    for ring in range(n):
        row((ring, 2, 1.0))  # support along z
        base = first[int(kind[ring])]
        i, j = shift[ring]
        for x in range(2):  # parallelograms: x_ring = x_base + i (x2 - x1) + j (x3 - x1)
            row((ring, x, 1.0), (base, x, -1.0), (two, x, -i), (three, x, -j), (one, x, float(i + j)))
        for x in range(3, 6):
            row((ring, x, 1.0), (base, x, -1.0))
    row((one, 0, 1.0))
    row((one, 1, 1.0))
    # Rotation rule (5), y2 y3 = x2 x3, differentiated.
    a1, a2 = rings.centres[two] - rings.centres[one], rings.centres[three] - rings.centres[one]
    row((two, 1, a2[1]), (three, 1, a1[1]), (two, 0, -a2[0]), (three, 0, -a1[0]))
    return np.array(rows)


def mass_matrix(rings: TenRings, wire: float, options: StewartTrinkleOptions) -> Array:
    """Mass matrix (6 n, 6 n) with the inertia tensors of the tori in space."""
    r1, r2 = options.r1_mm, wire * options.r1_mm
    m = options.density * 2.0 * np.pi**2 * r1 * r2**2
    across, along = m * (0.5 * r1**2 + 0.625 * r2**2), m * (r1**2 + 0.75 * r2**2)
    M = np.zeros((6 * len(rings.normals),) * 2)
    for ring, normal in enumerate(rings.normals):
        at = 6 * ring
        M[at : at + 3, at : at + 3] = m * np.eye(3)
        M[at + 3 : at + 6, at + 3 : at + 6] = across * np.eye(3) + (along - across) * np.outer(normal, normal)
    return M


def gyroscopic(rings: TenRings, M: Array) -> Array:
    """Gyroscopic torques -w x I w as a force vector (6 n,)."""
    out = np.zeros(rings.v.shape)
    for ring, w in enumerate(rings.v[:, 3:]):
        block = slice(6 * ring + 3, 6 * ring + 6)
        out[ring, 3:] = -np.cross(w, M[block, block] @ w)
    return out.ravel()


def corner_forces(rings: TenRings, weave: Weave, s: Array) -> Array:
    """Forces (6 n,) of the line load s (3,) in kg/s2 on the rings 1-4: half of each side goes to its two ends (Fig.
    4)."""
    one, two, three, four = corners(rings, weave)
    a1, a2 = rings.centres[two] - rings.centres[one], rings.centres[three] - rings.centres[one]
    load = np.array([[s[0], s[1]], [s[1], s[2]]])
    right, top = load @ np.array([a2[1], -a2[0]]), load @ np.array([-a1[1], a1[0]])
    out = np.zeros((len(rings.centres), 6))
    for ring, force in ((one, -right - top), (two, right - top), (three, top - right), (four, right + top)):
        out[ring, :2] = 0.5 * force
    return out.ravel()


@dataclass(frozen=True)
class PairContacts:
    """Contacts of all pairs of rings: ring numbers (c, 2), gaps (c,) in mm, gradients N (c, 6 n), minima."""

    pair: NDArray[np.intp]
    gap: Array
    N: Array
    minima: Minima
    links: NDArray[np.bool_]


def find(rings: TenRings, wire: float, options: StewartTrinkleOptions) -> PairContacts:
    """Contacts between any two of the rings, nearer than the reach of the options, and which pairs interlink."""
    n, r1 = len(rings.centres), options.r1_mm
    a, b = np.triu_indices(n, 1)
    d = rings.centres[b] - rings.centres[a]
    limit = (2.0 * wire + options.reach) * r1
    found = local_minima(d, rings.normals[a], rings.normals[b], r1, reach=limit)
    gradient = distance_gradient(found)
    N = np.zeros((len(found.pair), n, 6))
    pair = np.stack([a[found.pair], b[found.pair]], axis=1)
    line = np.arange(len(pair))
    N[line, pair[:, 0], :3], N[line, pair[:, 1], :3] = -gradient[:, :3], gradient[:, :3]
    N[line, pair[:, 0], 3:], N[line, pair[:, 1], 3:] = gradient[:, 3:6], gradient[:, 6:]
    links = are_linked(d, rings.normals[a], rings.normals[b], r1)
    return PairContacts(pair, found.distance - 2.0 * wire * r1, N.reshape(len(pair), 6 * n), found, links)


def _turned(normals: Array, omega: Array) -> Array:
    """Normals after the rotation vectors omega (n, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(omega, axis=1, keepdims=True)
    axis = omega / np.where(angle > 0.0, angle, 1.0)
    along = (axis * normals).sum(axis=1, keepdims=True)
    return np.cos(angle) * normals + np.sin(angle) * np.cross(axis, normals) + (1.0 - np.cos(angle)) * along * axis


def _moved(rings: TenRings, weave: Weave, v: Array, h: float) -> TenRings:
    """Positions after h v. The linearised rule (5) leaves an error of order h^2, which is put right at once: x2, y3 and
    t = tan(gamma) move with their velocities, and every ring keeps its place in the lattice.
    """
    shift = weave.rings[:, 1:]
    one, two, three, _ = corners(rings, weave)
    a1, a2 = rings.centres[two] - rings.centres[one], rings.centres[three] - rings.centres[one]
    t = a1[1] / a1[0]
    x2, y3 = a1[0] + h * v[two, 0], a2[1] + h * v[three, 1]
    t_new = t + h * (v[two, 1] - t * v[two, 0]) / a1[0]
    centres = rings.centres + h * v[:, :3]
    lattice = np.array([[x2, t_new * x2], [t_new * y3, y3]])
    drift = lattice - np.stack([centres[two] - centres[one], centres[three] - centres[one]])[:, :2]
    centres[:, :2] += shift @ drift
    return replace(rings, centres=centres, normals=_turned(rings.normals, h * v[:, 3:]), v=v)


def _curvature(found: PairContacts, rings: TenRings, basis: Array, M: Array, options: StewartTrinkleOptions) -> Array:
    """Positive part of -sum lam d2gap on the velocities of `basis`; see `stewart_trinkle.geometric_stiffness`."""
    n = len(rings.normals)
    normals = rings.normals[found.pair[:, 0]], rings.normals[found.pair[:, 1]]
    H = distance_hessian(found.minima, *normals, options.r1_mm)
    bend = np.zeros((basis.shape[1],) * 2)
    for (a, b), gap, hessian in zip(found.pair, found.gap, H, strict=True):
        L = np.zeros((9, n, 6))
        for x in range(3):
            L[x, a, x], L[x, b, x], L[3 + x, a, 3 + x], L[6 + x, b, 3 + x] = -1.0, 1.0, 1.0, 1.0
        LB = L.reshape(9, -1) @ basis
        bend -= max(-options.stiffness * gap, 0.0) * LB.T @ hessian @ LB
    mass = basis.T @ M @ basis
    value, vector = eigh(0.5 * (bend + bend.T), mass)
    root = mass @ vector * np.sqrt(np.maximum(value, 0.0))
    return root @ root.T


def _free_velocities(rings: TenRings, weave: Weave) -> tuple[Array, int]:
    """Orthonormal basis (6 n, m) of the velocities that all constraints allow, and how many of the first have no spin.

    The spins come last: no force turns a torus about its own axis.
    """
    B = bilateral(rings, weave)
    n = len(rings.normals)
    spin = np.zeros((n, n, 6))
    spin[np.arange(n), np.arange(n), 3:] = rings.normals
    still = null_space(np.concatenate([B, spin.reshape(n, -1)]), rcond=1e-10)
    spinning = null_space(np.concatenate([B, still.T]), rcond=1e-10)
    return np.concatenate([still, spinning], axis=1), still.shape[1]


def _complementarity(A: Array, b: Array, N: Array, gap: Array, k: float) -> Array:
    """Displacement w of the step: A w = b + N^T lam, 0 <= lam _|_ gap + N w + lam/k >= 0.

    Non-negative least squares: with Q = 1/k + N A^-1 N^T = L L^T the forces minimise |L^T lam + L^-1 (gap + N A^-1 b)|.
    """
    free = np.asarray(np.linalg.solve(A, b))
    if not len(gap):
        return free
    AN = np.linalg.solve(A, N.T)
    L = np.linalg.cholesky(np.eye(len(gap)) / k + N @ AN)
    lam, _ = nnls(L.T, -solve_triangular(L, gap + N @ free, lower=True))
    return np.asarray(free + AN @ lam)


def _energy(rings: TenRings, found: PairContacts, M: Array, options: StewartTrinkleOptions) -> float:
    """Kinetic energy and energy of the penetrations."""
    v = rings.v.ravel()
    return float(0.5 * v @ M @ v + 0.5 * options.stiffness * (np.minimum(found.gap, 0.0) ** 2).sum())


def advanced(
    rings: TenRings, s: Array, weave: Weave, wire: float, options: StewartTrinkleOptions
) -> tuple[TenRings, float]:
    """One accepted step under the unit line load s (3,), and the rise of the energy in kg mm2/s2.

    Raises RuntimeError when the step falls below h_min.
    """
    n = len(rings.centres)
    M = mass_matrix(rings, wire, options)
    D = np.diag(np.tile([options.damping] * 3 + [options.rotational_damping] * 3, n))
    basis, still = _free_velocities(rings, weave)
    f = corner_forces(rings, weave, options.load * s)
    found = find(rings, wire, options)
    energy = _energy(rings, found, M, options)
    bend = np.zeros((basis.shape[1],) * 2)
    if options.curvature:
        bend[:still, :still] = _curvature(found, rings, basis[:, :still], M, options)
    v0, h, rejected = rings.v.ravel(), rings.h, rings.rejected
    while h >= options.h_min:
        A = basis.T @ (M / h**2 + D / h) @ basis + bend
        b = basis.T @ (M @ v0 / h + f + gyroscopic(rings, M))
        w = basis @ _complementarity(A, b, found.N @ basis, found.gap, options.stiffness)
        v = w / h
        new = _moved(rings, weave, v.reshape(n, 6), h)
        after = find(new, wire, options)
        work = f @ np.column_stack([new.centres - rings.centres, np.zeros((n, 3))]).ravel()
        rise = _energy(new, after, mass_matrix(new, wire, options), options) - energy - work
        way = np.linalg.norm(w.reshape(n, 2, 3), axis=2) / np.array([options.r1_mm, 1.0])
        near = way.max() <= options.largest_move
        if near and rise <= ROUND_OFF * options.load * options.r1_mm**2 and (after.links == found.links).all():
            r = M @ (v - v0) / h + D @ v
            R = float(np.sqrt((r @ np.linalg.solve(M, r)) / (f @ np.linalg.solve(M, f))))
            following = min(options.h_max, options.restore * h)
            count = rings.steps + 1
            return replace(new, h=following, time=rings.time + h, R=R, rejected=rejected, steps=count), float(rise)
        h, rejected = 0.5 * h, rejected + 1
    raise RuntimeError("the time step fell below h_min before the energy fell; allow a smaller h_min")


def settled(s: Array, weave: Weave, wire: float, options: StewartTrinkleOptions) -> TenRings:
    """The ten rings at rest under the unit line load s (3,), or where they are after `max_steps`; R tells.

    Raises RuntimeError when a step falls below h_min.
    """
    rings = start(weave, options)
    for _ in range(options.max_steps):
        if options.tolerance > rings.R:
            break
        rings, _ = advanced(rings, s, weave, wire, options)
    return rings


def pose_of(rings: TenRings, weave: Weave, options: StewartTrinkleOptions) -> Pose:
    """The periodic pose (one case) of ten rings."""
    one, two, three, _ = corners(rings, weave)
    x = (rings.centres[:, :2] - rings.centres[one, :2]) / options.r1_mm
    first = [_ring(weave, kind, 0, 0) for kind in range(weave.classes)]
    lattice = np.array([x[two, 0], x[three, 1], x[two, 1] / x[two, 0]])
    return Pose(lattice[None], x[first][None], rings.normals[first][None])
