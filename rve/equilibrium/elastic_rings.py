"""Rings that give: contact forces, compliance and strength of locked states, to first order in the load.

At the rigid pose a contact force lam_c presses on two rings, at one point of each and along the contact normal. C is
the dense flexibility between the contacts of a cell, the sum over its rings (`rve.ring`). Where more contacts touch
than balance can tell apart, the forces are those of least strain energy, lam C lam / 2, among all nonnegative ones in
balance. To first order S:D S = lam C lam / A_ref. Lengths are in r1, forces in s r1, and Young's modulus is 1, so that
compliances are to be divided by E r1, stresses by r1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from rve.common.records import Flags, Index, Rows
from rve.common.tensor import WEIGHT
from rve.common.types import Array
from rve.equilibrium.compliance import deformation
from rve.equilibrium.interior_point import Equilibrium
from rve.equilibrium.system import Equations, weighted_size
from rve.geometry.circles import cross, dot, tangent_frame
from rve.geometry.kinematics import second_pk
from rve.geometry.pose import Pose
from rve.ring.collapse import checked_sections, largest_factors, relative_moments
from rve.ring.kernels import flexibility, internal_forces, self_stress
from rve.ring.section import Ring
from rve.ring.stress import peak_stress

TOUCHING = 1e-6
"""Gap in r1 below which a contact may carry force; working contacts end at 1e-13 over their force."""
_LEAST_FORCE = 1e-7
"""Contacts with less of the largest force count as idle."""
_RANK = 1e-7
"""Singular values of the contact gradients below this share of the largest are zero: some forces balance themselves."""
_BLOCK = 256
"""Cases worked on together: some 150 MB."""
_SOFT = 1e-8
"""Stiffness in s r1^2 below which a motion is free."""


@dataclass(frozen=True)
class RingStates(Rows):
    """Elastic locked states of n cases.

    lam (n, p, SLOTS): contact forces in s r1, zero for idle contacts. locking, elastic (n, 3, 3): the parts of
    dE_i = D_ij dS_j under a unit line load: the bend of the locking surface, and what rings with E r1 = 1 give; nan
    where the strain is not unique. first_yield, collapse (n,): the yield stress, times r1, at which the unit load is
    that of first yield and of plastic collapse, nan if that is not found.
    """

    lam: Array
    locking: Array
    elastic: Array
    first_yield: Array
    collapse: Array


@dataclass(frozen=True)
class Ends(Rows):
    """Where contacts act on the rings of n cells: slot (n, c) of each contact, present (n, c); of its two ends, first
    all on ring a, then all on ring b: ring (n, 2c), angle phi (n, 2c), direction (n, 2c, 3) in the ring's local axes,
    zero for padding."""

    slot: Index
    present: Flags
    ring: Index
    phi: Array
    direction: Array

    def on(self, k: int) -> tuple[Array, Array, Index]:
        """Angles (n, e), directions (n, e, 3), contacts (n, e) of the ends on ring k; padding has no direction."""
        mine = (self.ring == k) & (self.direction != 0.0).any(axis=2)
        count = int(mine.sum(axis=1).max(initial=1))
        column = np.argsort(~mine, axis=1, kind="stable")[:, :count]
        there = np.take_along_axis(mine, column, axis=1)
        direction = np.take_along_axis(self.direction, column[..., None], axis=1) * there[..., None]
        return np.take_along_axis(self.phi, column, axis=1), direction, column % self.slot.shape[1]


def contact_ends(equations: Equations, found: Equilibrium) -> Ends:
    """The ends of all touching contacts of locked states."""
    contacts, n = found.contacts, len(found.lam)
    touching = (contacts.present & (contacts.gap < TOUCHING)).reshape(n, -1)
    count = int(touching.sum(axis=1).max(initial=1))
    slot = np.argsort(~touching, axis=1, kind="stable")[:, :count]
    present = np.take_along_axis(touching, slot, axis=1)
    where = np.zeros(contacts.present.size, dtype=int)
    where[contacts.present.ravel()] = np.arange(len(contacts.minima.pair))
    m = contacts.minima.take(where.reshape(n, -1)[np.arange(n)[:, None], slot].ravel())
    pair = slot // contacts.gap.shape[2]
    rings = equations.weave.pairs[pair][..., :2]
    parts = []
    for k, (rho, push) in enumerate(((m.rho_a, -m.normal), (m.rho_b, m.normal))):
        normal = found.pose.normals[np.arange(n)[:, None], rings[..., k]].reshape(-1, 3)
        phi, local = _in_ring(rho, push, normal)
        parts.append((phi.reshape(n, count), np.where(present[..., None], local.reshape(n, count, 3), 0.0)))
    phi, direction = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
    return Ends(slot, present, np.concatenate([rings[..., 0], rings[..., 1]], axis=1), phi, direction)


def _in_ring(rho: Array, push: Array, normal: Array) -> tuple[Array, Array]:
    """Angle (k,) of points rho on rings with these normals, and pushes (k, 3) in the local axes r, t, z there."""
    e1, e2 = tangent_frame(normal)
    radial = rho / np.sqrt(dot(rho, rho))[:, None]
    local = np.stack([dot(push, radial), dot(push, cross(normal, radial)), dot(push, normal)], axis=1)
    return np.arctan2(dot(rho, e2), dot(rho, e1)), local


def contact_flexibility(ends: Ends, ring: Ring) -> Array:
    """The flexibility C (n, c, c) between the contacts of each cell, by its rings of curved wire."""
    full = flexibility(ends.phi, ends.direction, ring.curved())
    full = full * (ends.ring[:, :, None] == ends.ring[:, None, :])
    c = ends.slot.shape[1]
    return np.asarray(full[:, :c, :c] + full[:, :c, c:] + full[:, c:, :c] + full[:, c:, c:])


@dataclass(frozen=True)
class DeadLoad:
    """Constant second Piola-Kirchhoff line loads, the rows of `s`: their work is A_ref S:E, so J is symmetric.

    reference: sides of the reference cell in r1.
    """

    reference: tuple[float, float]

    def force(self, pose: Pose, T: Array, s: Array) -> tuple[Array, Array]:
        """See `Load`."""
        n, m = len(s), T.shape[2]
        area = self.reference[0] * self.reference[1]
        f, J = np.zeros((n, m)), np.zeros((n, m, m))
        f[:, :3] = area * np.einsum("ni,nij->nj", s * WEIGHT, strain_gradient(pose, self.reference))
        x2, y3, t = pose.lattice.T
        b_x, b_y = self.reference
        S11, S12, S22 = area * s[:, 0] / b_x**2, 2.0 * area * s[:, 1] / (b_x * b_y), area * s[:, 2] / b_y**2
        J[:, 0, 0], J[:, 1, 1] = S11 * (1.0 + t**2), S22 * (1.0 + t**2)
        J[:, 2, 2] = S11 * x2**2 + S22 * y3**2
        J[:, 0, 1] = J[:, 1, 0] = S12 * t
        J[:, 0, 2] = J[:, 2, 0] = 2.0 * S11 * t * x2 + S12 * y3
        J[:, 1, 2] = J[:, 2, 1] = 2.0 * S22 * t * y3 + S12 * x2
        return f, J

    def size(self, f: Array, M: Array) -> Array:
        """See `Load`."""
        return weighted_size(f, M)


def strain_gradient(pose: Pose, reference: tuple[float, float]) -> Array:
    """Derivative (n, 3, 3) of E11, E12, E22 with respect to x2, y3, t."""
    b_x, b_y = reference
    x2, y3, t = pose.lattice.T
    B = np.zeros((len(x2), 3, 3))
    B[:, 0, 0], B[:, 0, 2] = x2 * (1.0 + t**2) / b_x**2, t * x2**2 / b_x**2
    B[:, 1, 0], B[:, 1, 1], B[:, 1, 2] = t * y3 / (b_x * b_y), t * x2 / (b_x * b_y), x2 * y3 / (b_x * b_y)
    B[:, 2, 1], B[:, 2, 2] = y3 * (1.0 + t**2) / b_y**2, t * y3**2 / b_y**2
    return B


def ring_states(
    equations: Equations, found: Equilibrium, s: Array, reference: tuple[float, float], poisson: float
) -> RingStates:
    """First-order elastic states and strength of the converged ones of the locked states `found` under loads s (n, 3).

    reference: sides of the reference cell in r1. Rows that have not converged have nan.
    """
    good = np.flatnonzero(found.status == "converged")
    states = RingStates(
        np.zeros(found.lam.shape), *(np.full((len(s), *shape), np.nan) for shape in ((3, 3), (3, 3), (), ()))
    )
    if not len(good):
        return states
    parts = [good[start : start + _BLOCK] for start in range(0, len(good), _BLOCK)]
    blocks = [_block(equations, found.take(rows), s[rows], reference, poisson) for rows in parts]
    return states.put(good, blocks[0].join(blocks[1:]))


def _block(
    equations: Equations, found: Equilibrium, s: Array, reference: tuple[float, float], poisson: float
) -> RingStates:
    """`ring_states` of locked states that have all converged."""
    ring, ends = Ring(1.0, equations.wire, 1.0, poisson), contact_ends(equations, found)
    cells = _cells(equations, found, s, reference, ends, contact_flexibility(ends, ring))
    lam, locking, elastic = _compliances(found, cells, ends)
    stress = np.zeros(len(s))
    for k in range(equations.weave.classes):
        phi, direction, contact = ends.on(k)
        stress = np.maximum(stress, peak_stress(phi, _at_ends(lam, contact) * direction, ring).stress)
    collapse = _collapse(cells, ends, lam, equations, ring)
    return RingStates(_spread(lam, ends, found), locking, elastic, stress, collapse)


@dataclass(frozen=True)
class _Cells:
    """Equations of n cells at the touching contacts of `Ends`: gradients G (n, c, m), load f (n, m), flexibility C
    (n, c, c), forces `start` (n, c) of the rigid solver, loads S (n, 3), strain gradient B (n, 3, 3), area in r1^2."""

    dead: Equations
    G: Array
    f: Array
    C: Array
    start: Array
    S: Array
    B: Array
    area: float


def _cells(
    equations: Equations, found: Equilibrium, s: Array, reference: tuple[float, float], ends: Ends, C: Array
) -> _Cells:
    S = second_pk(deformation(found.pose, reference), s)
    dead = replace(equations, load=DeadLoad(reference))
    system = dead.assemble(found.pose, found.contacts, found.lam, S)
    G = np.take_along_axis(system.G, ends.slot[..., None], axis=1)
    start = np.take_along_axis(found.lam.reshape(len(s), -1), ends.slot, axis=1)
    B = strain_gradient(found.pose, reference)
    return _Cells(dead, G, system.f, C, np.where(ends.present, start, 0.0), S, B, reference[0] * reference[1])


def _compliances(found: Equilibrium, cells: _Cells, ends: Ends) -> tuple[Array, Array, Array]:
    """Elastic contact forces (n, c) and both parts of D, (n, 3, 3) each."""
    n = len(cells.f)
    lam = np.zeros(ends.slot.shape)
    for i in range(n):
        rows = np.flatnonzero(ends.present[i])
        C = cells.C[i][np.ix_(rows, rows)]
        forces = elastic_forces(cells.G[i, rows], cells.f[i], C, cells.start[i, rows])
        lam[i, rows] = np.where(forces > _LEAST_FORCE * forces.max(initial=0.0), forces, 0.0)
    J = cells.dead.assemble(found.pose, found.contacts, _spread(lam, ends, found), cells.S).J
    locking, elastic = np.empty((n, 3, 3)), np.empty((n, 3, 3))
    for i in range(n):
        rows = np.flatnonzero(lam[i] > 0.0)
        locking[i], elastic[i] = _compliance(
            cells.G[i, rows], cells.C[i][np.ix_(rows, rows)], -J[i], cells.B[i], cells.area
        )
    return lam, locking, elastic


def _split(G: Array) -> tuple[Array, Array, Array, Array]:
    """U_r, sizes, V_r of contact gradients G (c, m), and U_0: the forces that balance themselves."""
    U, sizes, Vt = np.linalg.svd(G)
    rank = int(np.count_nonzero(sizes > _RANK * sizes.max(initial=0.0)))
    return U[:, :rank], sizes[:rank], Vt, U[:, rank:]


def _positive(K: Array) -> Array:
    """K with round-off added on its diagonal: contacts about to merge balance themselves with hardly a bend."""
    return np.asarray(K + 1e-13 * np.trace(K) * np.eye(len(K)))


def elastic_forces(G: Array, f: Array, C: Array, start: Array) -> Array:
    """Forces lam (c,) >= 0 with G^T lam = -f that make lam C lam least; `start` (c,) is one choice of them.

    G (c, m), f (m,), C (c, c). Balance leaves lam = p + N z; the least of a positive definite form in z under p + N z
    >= 0 is a least-distance problem, which nonnegative least squares solves exactly (Lawson and Hanson, ch. 23).

    >>> G = np.array([[1.0], [1.0]])
    >>> elastic_forces(G, np.array([-3.0]), np.diag([1.0, 2.0]), np.array([0.0, 3.0])).round(12)
    array([2., 1.])
    """
    U, sizes, Vt, N = _split(G)
    p = start - U @ (U.T @ start + (Vt[: len(sizes)] @ f) / sizes)
    if not N.shape[1]:
        return np.asarray(np.maximum(p, 0.0))
    L = np.linalg.cholesky(_positive(N.T @ C @ N))
    shift = np.linalg.solve(L, N.T @ C @ p)
    A = np.linalg.solve(L, N.T).T  # p + N z = p + A (y - shift) with y = L^T z + shift, and |y| is to be least
    h = A @ shift - p
    last = np.zeros(N.shape[1] + 1)
    last[-1] = 1.0
    E = np.vstack([A.T, h])
    r = E @ nnls(E, last)[0] - last
    y = -r[:-1] / r[-1] if abs(r[-1]) > 1e-12 else shift
    return np.asarray(np.maximum(p + A @ (y - shift), 0.0))


def _compliance(G: Array, C: Array, H: Array, B: Array, area: float) -> tuple[Array, Array]:
    """Both parts of D (3, 3) of one cell, nan where a free motion moves the lattice.

    Motions Z keep all loaded contacts closed. Under dS they move by Z (Z^T H Z)^-1 Z^T f' with f' = A_ref B^T W dS: the
    bend of the locking surface. The contact forces change by Lam dS, and the rings give Lam^T C Lam / A_ref.
    """
    U, sizes, Vt, N = _split(G)
    W = U - N @ np.linalg.solve(_positive(N.T @ C @ N), N.T @ C @ U) if N.shape[1] else U
    Z = Vt[len(sizes) :].T
    load = np.zeros((len(H), 3))
    load[:3] = area * B.T * WEIGHT
    stiffness, motions = np.linalg.eigh(0.5 * Z.T @ (H + H.T) @ Z)
    V = Z @ motions
    soft = stiffness < _SOFT
    if np.any(np.abs(V[:3, soft]) > 1e-6):
        return np.full((3, 3), np.nan), np.full((3, 3), np.nan)
    V, stiffness = V[:, ~soft], stiffness[~soft]
    dq = (V / stiffness) @ (V.T @ load)
    Lam = W @ ((Vt[: len(sizes)] @ (H @ dq - load)) / sizes[:, None])
    return B @ dq[:3], (Lam.T @ C @ Lam) / area / WEIGHT[:, None]


def _spread(lam: Array, ends: Ends, found: Equilibrium) -> Array:
    """Forces (n, c) in the slots of their contacts, (n, p, SLOTS)."""
    full = np.zeros((len(lam), found.lam[0].size))
    np.put_along_axis(full, ends.slot, lam, axis=1)
    return full.reshape(found.lam.shape)


def _at_ends(lam: Array, contact: Index) -> Array:
    return np.take_along_axis(lam, contact, axis=1)[..., None]


def _collapse(cells: _Cells, ends: Ends, lam: Array, equations: Equations, ring: Ring) -> Array:
    """Yield stress (n,) at which the load is that of plastic collapse: the contact forces are free within balance."""
    working = cells.start > 1e-6 * cells.start.max(axis=1, keepdims=True)
    free = [_split(G[rows])[3] for G, rows in zip(cells.G, working, strict=True)]
    width = np.array([N.shape[1] for N in free])
    out = np.empty(len(lam))
    given, chosen = np.flatnonzero(width == 0), np.flatnonzero(width > 0)
    if len(given):
        moments = _moments(ends.take(given), [lam[given]], equations, ring)
        out[given] = 1.0 / np.min([largest_factors(base[..., 0], held).factor for base, held in moments], axis=0)
    if len(chosen):
        change = np.zeros((len(chosen), lam.shape[1], width.max()))
        for row, i in enumerate(chosen):
            change[row, working[i], : width[i]] = free[i]
        start = np.where(working, cells.start, 0.0)[chosen]
        moments = _moments(ends.take(chosen), [start, *np.moveaxis(change, 2, 0)], equations, ring)
        out[chosen] = 1.0 / _factors(moments, start, change)
    return out


def _moments(ends: Ends, forces: list[Array], equations: Equations, ring: Ring) -> list[tuple[Array, Array]]:
    """For each class of rings the relative moments (n, k, 3, .) by each of the contact forces (n, c), and by the
    self-stresses of the ring."""
    found = []
    for k in range(equations.weave.classes):
        phi, direction, contact = ends.on(k)
        at = checked_sections(phi)
        loads = np.stack([_at_ends(lam, contact) * direction for lam in forces])
        q = np.moveaxis(internal_forces(phi, loads, at, ring.thin()), 0, -1)
        held = relative_moments(self_stress(at, ring.r1), ring.r2)
        found.append((relative_moments(q, ring.r2), held))
    return found


def _factors(moments: list[tuple[Array, Array]], start: Array, change: Array) -> Array:
    """Factors (n,) at collapse for unit yield stress where the contact forces mu start + change z >= 0 are chosen."""
    n, c, width = change.shape
    own = 6 * len(moments)
    base, free = [], []
    for k, (loaded, held) in enumerate(moments):
        columns = np.zeros((*held.shape[:3], own + width))
        columns[..., 6 * k : 6 * k + 6] = held
        columns[..., own:] = loaded[..., 1:]
        base.append(loaded[..., 0])
        free.append(columns)
    signs = np.zeros((n, c, 1 + own + width))
    signs[..., 0] = np.where(start > 0.0, start, 1.0)
    signs[..., 1 + own :] = change
    return largest_factors(np.concatenate(base, axis=1), np.concatenate(free, axis=1), signs).factor
