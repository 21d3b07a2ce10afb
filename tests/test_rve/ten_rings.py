"""One step of the paper's scheme with all ten rings and every bilateral constraint: the reference of `rve.simulation`.

Each ring has six velocities. Constraints: all centres stay in the plane, ring 1 in its place, rings of one class on
parallelograms and with equal rotation (4), and the rotation rule (5). Dense matrices, one case; the complementarity
problem by non-negative least squares (Lawson and Hanson, scipy.optimize.nnls). It shares the distance of two circles
with the periodic form, and nothing else: neither pair lists, reduction, mass matrices nor contact solver.

Units: mm, kg, s.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, null_space, solve_triangular
from scipy.optimize import nnls

from rve.common import Array
from rve.geometry import FOUR_IN_ONE, Minima, are_linked, distance_gradient, distance_hessian, local_minima
from rve.simulation import ROUND_OFF, SimulationOptions

WIRE, R1, DENSITY = 0.1, 5.0, 7.85e-6
"""r2/r1, r1 in mm, density in kg/mm3."""
KIND, SHIFT = FOUR_IN_ONE.rings[:, 0], FOUR_IN_ONE.rings[:, 1:]
"""Class (n,) and lattice shift (n, 2) of every ring."""
N = len(KIND)
SHIFTS = ((0, 0), (1, 0), (0, 1), (1, 1))
ONE, TWO, THREE, FOUR = (int(np.flatnonzero((FOUR_IN_ONE.rings == (0, *one)).all(axis=1))[0]) for one in SHIFTS)
"""Numbers of the rings 1, 2, 3, 4 of the paper's Fig. 1."""


@dataclass(frozen=True)
class TenRings:
    """Centres (n, 3) in mm, normals (n, 3), velocities (n, 6) of every ring."""

    centres: Array
    normals: Array
    v: Array

    @property
    def sides(self) -> tuple[Array, Array]:
        """From ring 1 to the rings 2 and 3, (3,) each."""
        return self.centres[TWO] - self.centres[ONE], self.centres[THREE] - self.centres[ONE]


@dataclass(frozen=True)
class Step:
    """The rings after a step, R of eq. (9), the rise of the energy in kg mm2/s2, and whether it is short enough."""

    rings: TenRings
    R: float
    rise: float
    is_allowed: bool


def bilateral(rings: TenRings) -> Array:
    """Jacobian B (m, 6 n) of all bilateral constraints on the velocities; redundant rows are kept."""
    rows = []

    def row(*entries: tuple[int, int, float]) -> None:
        line = np.zeros((N, 6))
        for ring, component, factor in entries:
            line[ring, component] += factor
        rows.append(line.ravel())

    first = {int(k): int(np.flatnonzero((k == KIND) & (SHIFT == 0).all(axis=1))[0]) for k in np.unique(KIND)}
    for ring in range(N):
        row((ring, 2, 1.0))  # support along z
        base, (i, j) = first[int(KIND[ring])], SHIFT[ring]
        for x in range(2):  # parallelograms: x_ring = x_base + i (x2 - x1) + j (x3 - x1)
            row((ring, x, 1.0), (base, x, -1.0), (TWO, x, -i), (THREE, x, -j), (ONE, x, float(i + j)))
        for x in range(3, 6):
            row((ring, x, 1.0), (base, x, -1.0))
    row((ONE, 0, 1.0))
    row((ONE, 1, 1.0))
    a1, a2 = rings.sides  # rotation rule (5), y2 y3 = x2 x3, differentiated
    row((TWO, 1, a2[1]), (THREE, 1, a1[1]), (TWO, 0, -a2[0]), (THREE, 0, -a1[0]))
    return np.array(rows)


def mass_matrix(rings: TenRings) -> Array:
    """Mass matrix (6 n, 6 n) with the inertia tensors of the tori in space."""
    r2 = WIRE * R1
    m = DENSITY * 2.0 * np.pi**2 * R1 * r2**2
    across, along = m * (0.5 * R1**2 + 0.625 * r2**2), m * (R1**2 + 0.75 * r2**2)
    M = np.zeros((6 * N, 6 * N))
    for ring, normal in enumerate(rings.normals):
        at = 6 * ring
        M[at : at + 3, at : at + 3] = m * np.eye(3)
        M[at + 3 : at + 6, at + 3 : at + 6] = across * np.eye(3) + (along - across) * np.outer(normal, normal)
    return M


def gyroscopic(rings: TenRings, M: Array) -> Array:
    """Gyroscopic torques -w x I w as a force vector (6 n,)."""
    out = np.zeros((N, 6))
    for ring, w in enumerate(rings.v[:, 3:]):
        block = slice(6 * ring + 3, 6 * ring + 6)
        out[ring, 3:] = -np.cross(w, M[block, block] @ w)
    return out.ravel()


def corner_forces(rings: TenRings, s: Array) -> Array:
    """Forces (6 n,) of the line load s (3,) in kg/s2 on rings 1-4: half of each side goes to its two ends (Fig. 4)."""
    a1, a2 = rings.sides
    load = np.array([[s[0], s[1]], [s[1], s[2]]])
    right, top = load @ np.array([a2[1], -a2[0]]), load @ np.array([-a1[1], a1[0]])
    out = np.zeros((N, 6))
    for ring, force in ((ONE, -right - top), (TWO, right - top), (THREE, top - right), (FOUR, right + top)):
        out[ring, :2] = 0.5 * force
    return out.ravel()


@dataclass(frozen=True)
class PairContacts:
    """Contacts of all pairs: ring numbers (c, 2), gaps (c,) in mm, gradients N (c, 6 n), minima in r1; links."""

    pair: NDArray[np.intp]
    gap: Array
    N: Array
    minima: Minima
    links: NDArray[np.bool_]


def units() -> Array:
    """r1 in mm of the offset, 1 of both turns (9,): what the coordinates of a distance have as unit."""
    return np.repeat([R1, 1.0, 1.0], 3)


def find(rings: TenRings, options: SimulationOptions) -> PairContacts:
    """Contacts between any two of the rings, nearer than the reach of the options, and which pairs interlink."""
    a, b = np.triu_indices(N, 1)
    circles = (rings.centres[b] - rings.centres[a]) / R1, rings.normals[a], rings.normals[b]
    found = local_minima(*circles, reach=2.0 * WIRE + options.reach)
    gradient, line = R1 * distance_gradient(found) / units(), np.arange(len(found.pair))
    slope, pair = np.zeros((len(line), N, 6)), np.stack([a[found.pair], b[found.pair]], axis=1)
    slope[line, pair[:, 0], :3], slope[line, pair[:, 1], :3] = -gradient[:, :3], gradient[:, :3]
    slope[line, pair[:, 0], 3:], slope[line, pair[:, 1], 3:] = gradient[:, 3:6], gradient[:, 6:]
    gap = R1 * (found.distance - 2.0 * WIRE)
    return PairContacts(pair, gap, slope.reshape(len(line), 6 * N), found, are_linked(*circles))


def turned(normals: Array, omega: Array) -> Array:
    """Normals after the rotation vectors omega (n, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(omega, axis=1, keepdims=True)
    axis = omega / np.where(angle > 0.0, angle, 1.0)
    along = (axis * normals).sum(axis=1, keepdims=True)
    return np.cos(angle) * normals + np.sin(angle) * np.cross(axis, normals) + (1.0 - np.cos(angle)) * along * axis


def moved(rings: TenRings, v: Array, h: float) -> TenRings:
    """Positions after h v. The linearised rule (5) leaves an error of order h^2, which is put right at once: x2, y3 and
    t = tan(gamma) move with their velocities, and every ring keeps its place in the lattice.
    """
    a1, a2 = rings.sides
    t = a1[1] / a1[0]
    x2, y3 = a1[0] + h * v[TWO, 0], a2[1] + h * v[THREE, 1]
    t_new = t + h * (v[TWO, 1] - t * v[TWO, 0]) / a1[0]
    centres = rings.centres + h * v[:, :3]
    lattice = np.array([[x2, t_new * x2], [t_new * y3, y3]])
    centres[:, :2] += SHIFT @ (lattice - np.stack([centres[TWO] - centres[ONE], centres[THREE] - centres[ONE]])[:, :2])
    return TenRings(centres, turned(rings.normals, h * v[:, 3:]), v)


def curvature(found: PairContacts, rings: TenRings, basis: Array, M: Array, options: SimulationOptions) -> Array:
    """Positive part of -sum lam d2gap on the velocities of `basis`; see `stewart_trinkle.geometric_stiffness`."""
    normals = rings.normals[found.pair[:, 0]], rings.normals[found.pair[:, 1]]
    H = R1 * distance_hessian(found.minima, *normals) / np.outer(units(), units())
    bend = np.zeros((basis.shape[1],) * 2)
    for (a, b), gap, hessian in zip(found.pair, found.gap, H, strict=True):
        L = np.zeros((9, N, 6))
        for x in range(3):
            L[x, a, x], L[x, b, x], L[3 + x, a, 3 + x], L[6 + x, b, 3 + x] = -1.0, 1.0, 1.0, 1.0
        LB = L.reshape(9, -1) @ basis
        bend -= max(-options.stiffness * gap, 0.0) * LB.T @ hessian @ LB
    mass = basis.T @ M @ basis
    value, vector = eigh(0.5 * (bend + bend.T), mass)
    root = mass @ vector * np.sqrt(np.maximum(value, 0.0))
    return root @ root.T


def free_velocities(rings: TenRings) -> tuple[Array, int]:
    """Orthonormal basis (6 n, m) of the velocities that all constraints allow, and how many of the first have no spin.

    The spins come last: no force turns a torus about its own axis.
    """
    B = bilateral(rings)
    spin = np.zeros((N, N, 6))
    spin[np.arange(N), np.arange(N), 3:] = rings.normals
    still = null_space(np.concatenate([B, spin.reshape(N, -1)]), rcond=1e-10)
    spinning = null_space(np.concatenate([B, still.T]), rcond=1e-10)
    return np.concatenate([still, spinning], axis=1), still.shape[1]


def complementarity(A: Array, b: Array, slope: Array, gap: Array, k: float) -> Array:
    """Displacement w of the step: A w = b + N^T lam, 0 <= lam _|_ gap + N w + lam/k >= 0.

    Non-negative least squares: with Q = 1/k + N A^-1 N^T = L L^T the forces minimise |L^T lam + L^-1 (gap + N A^-1 b)|.
    """
    free = np.asarray(np.linalg.solve(A, b))
    if not len(gap):
        return free
    AN = np.linalg.solve(A, slope.T)
    L = np.linalg.cholesky(np.eye(len(gap)) / k + slope @ AN)
    lam, _ = nnls(L.T, -solve_triangular(L, gap + slope @ free, lower=True))
    return np.asarray(free + AN @ lam)


def energy(rings: TenRings, found: PairContacts, options: SimulationOptions) -> float:
    """Kinetic energy and energy of the penetrations."""
    v = rings.v.ravel()
    kinetic = 0.5 * v @ mass_matrix(rings) @ v
    return float(kinetic + 0.5 * options.stiffness * (np.minimum(found.gap, 0.0) ** 2).sum())


def advanced(rings: TenRings, s: Array, h: float, options: SimulationOptions) -> Step:
    """One step of h seconds under the unit line load s (3,)."""
    M, f, found = mass_matrix(rings), corner_forces(rings, options.load * s), find(rings, options)
    D = np.diag(np.tile([options.damping] * 3 + [options.rotational_damping * options.damping * R1**2] * 3, N))
    basis, still = free_velocities(rings)
    bend = np.zeros((basis.shape[1],) * 2)
    if options.curvature:
        bend[:still, :still] = curvature(found, rings, basis[:, :still], M, options)
    v0 = rings.v.ravel()
    A = basis.T @ (M / h**2 + D / h) @ basis + bend
    b = basis.T @ (M @ v0 / h + f + gyroscopic(rings, M))
    w = basis @ complementarity(A, b, found.N @ basis, found.gap, options.stiffness)
    v = w / h
    new = moved(rings, v.reshape(N, 6), h)
    after = find(new, options)
    work = f @ np.column_stack([new.centres - rings.centres, np.zeros((N, 3))]).ravel()
    rise = energy(new, after, options) - energy(rings, found, options) - work
    way = np.linalg.norm(w.reshape(N, 2, 3), axis=2) / np.array([R1, 1.0])
    short = way.max() <= options.largest_move and rise <= ROUND_OFF * options.load * R1**2
    r = M @ (v - v0) / h + D @ v
    R = float(np.sqrt((r @ np.linalg.solve(M, r)) / (f @ np.linalg.solve(M, f))))
    return Step(new, R, float(rise), bool(short and (after.links == found.links).all()))
