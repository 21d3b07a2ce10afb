"""Periodic cells whose rings may leave the plane: the largest work S:E by sequential quadratic programming.

Each step solves a quadratic program: the second-order gain of work under the linearised gaps of all minima within
reach, no coordinate moving by more than a trust region, with the curvature of loaded contacts. Lengths are in r1.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from rve.geometry.circles import Minima, are_linked, distance_gradient, distance_hessian, local_minima, tangent_frame
from rve.geometry.weave import Weave

Array = NDArray[np.float64]
REACH = 0.3
PENALTY = 50.0
"""Work that a unit of overlap costs in the merit; contact forces of a load of unit trace are far smaller."""


@dataclass(frozen=True, eq=False)
class SpaceCell:
    """A cell in units of r1: lattice (3,) = x2, y3, tan gamma; centres (K, 3); unit normals (K, 3)."""

    weave: Weave
    wire: float
    lattice: Array
    centres: Array
    normals: Array

    def moved(self, q: Array) -> "SpaceCell":
        """After a step q (3 + 5 K): lattice, centres, two tilts of each ring."""
        k = len(self.centres)
        e1, e2 = tangent_frame(self.normals)
        tilt = q[3 + 3 * k :].reshape(k, 2)
        omega = tilt[:, :1] * e1 + tilt[:, 1:] * e2
        angle = np.linalg.norm(omega, axis=1)[:, None]
        n = np.cos(angle) * self.normals + np.sinc(angle / np.pi) * np.cross(omega, self.normals)
        n /= np.linalg.norm(n, axis=1)[:, None]
        centres = self.centres + q[3 : 3 + 3 * k].reshape(k, 3)
        return replace(self, lattice=self.lattice + q[:3], centres=centres, normals=n)

    def offsets(self) -> Array:
        """Centre of ring b seen from ring a, of every pair (p, 3)."""
        a, b, i, j = self.weave.pairs.T
        x2, y3, t = self.lattice
        d = self.centres[b] - self.centres[a]
        d[:, 0] += i * x2 + j * t * y3
        d[:, 1] += i * t * x2 + j * y3
        return np.asarray(d)

    def minima(self) -> Minima:
        """All local minima of all pairs within reach."""
        a, b = self.weave.pairs[:, :2].T
        return local_minima(self.offsets(), self.normals[a], self.normals[b], 1.0, reach=2.0 * self.wire + REACH)

    def links_intact(self) -> bool:
        """Whether exactly the pairs of the weave interlink."""
        a, b = self.weave.pairs[:, :2].T
        linked = are_linked(self.offsets(), self.normals[a], self.normals[b], 1.0)
        return bool((linked == self.weave.linked).all())

    def gradient(self, minima: Minima) -> Array:
        """Derivative (m, 3 + 5 K) of the distances."""
        return np.einsum("mk,mki->mi", distance_gradient(minima), self.maps(minima))

    def maps(self, minima: Minima) -> Array:
        """Derivative (m, 9, 3 + 5 K) of (d, theta_a, theta_b) of each minimum by the coordinates."""
        k = len(self.centres)
        a, b, i, j = self.weave.pairs[minima.pair].T
        x2, y3, t = self.lattice
        m, rows = len(a), np.arange(len(a))
        B = np.zeros((m, 9, 3 + 5 * k))
        B[:, 0, 0], B[:, 1, 0] = i, i * t
        B[:, 0, 1], B[:, 1, 1] = j * t, j
        B[:, 0, 2], B[:, 1, 2] = j * y3, i * x2
        frame = np.stack(tangent_frame(self.normals), axis=2)
        for ring, first, sign in ((a, 3, -1.0), (b, 6, 1.0)):
            for x in range(3):
                B[rows, x, 3 + 3 * ring + x] += sign
                for y in range(2):
                    B[rows, first + x, 3 + 3 * k + 2 * ring + y] = frame[ring, x, y]
        return B

    def curvature(self, minima: Minima, force: Array, S: Array, sides: Array) -> Array:
        """Minus the second derivative of work + force . gap, (3 + 5 K, 3 + 5 K), its negative part left out."""
        n = 3 + 5 * len(self.centres)
        H = np.zeros((n, n))
        x2, y3, t = self.lattice
        full = np.array([[S[0], S[1]], [S[1], S[2]]]) / np.outer(sides, sides)
        # F = (x2, t y3; t x2, y3): minus the second derivative of the work, bilinear terms included
        A = np.array([[1, 0, 0], [t, 0, x2], [0, t, y3], [0, 1, 0]])  # F11, F21, F12, F22 by (x2, y3, t)
        whole = np.kron(full, np.eye(2))
        H[:3, :3] = -A.T @ whole @ A
        push = whole @ np.array([x2, t * x2, t * y3, y3])
        H[0, 2] -= push[1]
        H[2, 0] -= push[1]
        H[1, 2] -= push[2]
        H[2, 1] -= push[2]
        loaded = np.flatnonzero(force > 1e-9)
        some = minima.take(loaded)
        a, b, i, j = self.weave.pairs[some.pair].T
        B = self.maps(some)
        D = distance_hessian(some, self.normals[a], self.normals[b], 1.0)
        H -= np.einsum("m,mki,mkl,mlj->ij", force[loaded], B, D, B, optimize=True)
        pull = force[loaded, None] * some.normal
        for row, on in ((0, (i * pull[:, 1]).sum()), (1, (j * pull[:, 0]).sum())):
            H[row, 2] -= on
            H[2, row] -= on
        values, vectors = np.linalg.eigh(H)
        return np.asarray((vectors * np.maximum(values, 1e-9)) @ vectors.T)

    def work(self, S: Array, sides: Array) -> tuple[float, Array]:
        """S:E and its derivative by the lattice (3,); sides (2,) of the reference cell."""
        x2, y3, t = self.lattice
        F = np.array([[x2, t * y3], [t * x2, y3]]) / sides
        full = np.array([[S[0], S[1]], [S[1], S[2]]])
        FS = F @ full / sides
        slope = [FS[0, 0] + t * FS[1, 0], t * FS[0, 1] + FS[1, 1], y3 * FS[0, 1] + x2 * FS[1, 0]]
        return 0.5 * float(np.einsum("ij,ik,jk->", full, F.T, F.T) - np.trace(full)), np.array(slope)


@dataclass(frozen=True, eq=False)
class Climbed:
    """The cell of largest work that was reached, its work, overlap, how far centres are from one plane, steps, and the
    last trust region."""

    cell: SpaceCell
    work: float
    overlap: float
    depth: float
    steps: int
    radius: float


def climb(
    cell: SpaceCell, S: Array, sides: Array, *, steps: int = 300, end: float = 1e-7, stride: float = 0.75
) -> Climbed:
    """From an admissible cell to a local maximum of S:E; ends where steps are shorter than `end`."""
    wire = cell.wire
    radius = widest = stride * wire
    minima = cell.minima()
    work, slope = cell.work(S, sides)
    overlap, force, count = _overlap(minima, wire), np.zeros(len(minima.pair)), 0
    while count < steps and radius > end:
        count += 1
        H, G = cell.curvature(minima, force, S, sides), cell.gradient(minima)
        gap = minima.distance - 2.0 * wire
        q, own, gain = _programme(H, G, slope, gap, radius)
        if gain < 1e-13:
            break
        for turn in range(2):
            trial = cell.moved(q)
            found = trial.minima()
            new, new_slope = trial.work(S, sides)
            left = _overlap(found, wire)
            rise = (new - PENALTY * left) - (work - PENALTY * overlap)
            good = rise > 0.1 * gain and trial.links_intact()
            if good or turn or len(found.pair) != len(minima.pair):
                break
            q = _programme(H, G, slope, found.distance - 2.0 * wire - G @ q, radius)[0]
        if good:
            radius = min(2.0 * radius, widest) if rise > 0.5 * gain else radius
            heir = _heirs(minima, found)
            force = np.append(own, 0.0)[heir]
            cell, minima, work, slope, overlap = trial, found, new, new_slope, left
        else:
            radius, force = 0.4 * min(radius, float(np.abs(q).max())), own
    return Climbed(cell, work, overlap, float(np.ptp(cell.centres[:, 2])), count, radius)


def _overlap(minima: Minima, wire: float) -> float:
    return float(np.maximum(2.0 * wire - minima.distance, 0.0).max(initial=0.0))


def _heirs(old: Minima, new: Minima) -> NDArray[np.intp]:
    """The nearest old minimum of the same pair for each new one, -1 where there is none."""
    same = new.pair[:, None] == old.pair[None]
    far = np.linalg.norm(new.rho_a[:, None] - old.rho_a[None], axis=2) + np.where(same, 0.0, 1e9)
    if not far.shape[1]:
        return np.full(len(new.pair), -1)
    best = far.argmin(axis=1)
    return np.where(far.min(axis=1) < 1e8, best, -1)


def _programme(H: Array, G: Array, slope: Array, gap: Array, radius: float) -> tuple[Array, Array, float]:
    """Step, contact forces (m,) and forecast rise of the merit from the quadratic program; lattice first."""
    import clarabel

    n, m = len(H), len(gap)
    free = np.r_[0:3, 6:n]  # ring 0 stays where it is
    P = np.zeros((len(free) + 1,) * 2)
    P[:-1, :-1] = H[np.ix_(free, free)]
    cost = np.zeros(len(P))
    cost[:3], cost[-1] = -slope, PENALTY
    box = np.eye(len(P))
    A = np.concatenate([np.column_stack([-G[:, free], -np.ones(m)]), box[:-1], -box])
    b = np.concatenate([gap, np.full(len(free), radius), np.full(len(free), radius), [0.0]])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.NonnegativeConeT(len(b))]
    solved = clarabel.DefaultSolver(csc_matrix(np.triu(P)), cost, csc_matrix(A), b, cones, settings).solve()
    q = np.zeros(n)
    x = np.array(solved.x)
    q[free] = np.clip(x[:-1], -radius, radius)
    before = float(np.maximum(-gap, 0.0).max(initial=0.0))
    rise = float(slope @ q[:3]) - 0.5 * float(q @ H @ q) + PENALTY * (before - max(0.0, float(x[-1])))
    return q, np.array(solved.z)[:m], rise
