"""Compliance and strength of cells from their elastic rings: contact forces, stiffness, first yield, collapse.

All are of first order in the load. C is the dense flexibility between the contacts of a cell, the sum over its rings.
Lengths are in r1, forces in s r1, and Young's modulus is 1: compliances are to be divided by E r1, stresses by r1.
`with_rings` makes columns of a table of them, in mm and N.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from rve.common import Array, Flags, Index, InputError, Rows, checked, tell
from rve.common.cell_fields import Joint
from rve.common.tensor import WEIGHT, trace
from rve.geometry.cell import Cell, weave_axes, weave_sides
from rve.geometry.kinematics import lattice_strain, second_pk
from rve.geometry.pattern import supercell
from rve.geometry.pose import deformation, tiled
from rve.geometry.ring_pair import cross, dot, tangent_frame
from rve.locking.dead_load import DeadLoad
from rve.locking.interior_point import DirectOptions, Equilibrium, LockedStates
from rve.locking.limits import SOFT, TOUCHING, shortest, touching
from rve.locking.system import Equations
from rve.solve import locked_states, reference_cell
from rve.table import StrainTable
from rve.wire.kernels import flexibility
from rve.wire.section import Ring
from rve.wire.strength import largest_factors, peak_stress, relative_moments

_ZERO = 1e-7
"""Share of the largest below which a contact force, or a singular value of the contact gradients, counts as zero."""
_BLOCK = 256
"""Cases worked on together: some 150 MB."""


@checked
def with_rings(table: StrainTable, cell: Cell, joint: str = "welded") -> StrainTable:
    """The table with compliance and strength of its rings, of the cell's material.

    joint: "welded", "butted:ANGLE" (open at this angle in degrees around the ring from the grain) or "butted:worst" (at
    the worst angle for each load).

    compliance: dE/dS in mm/N at a line load of 1 N/mm, to first order: the bend of the locking surface and the elastic
    compliance of the rings; at s N/mm the bend is to be divided by s; the free part of a strain that is not unique is
    held. strength: see `StrainTable`. Where several states coexist the compliance is their mean by shares, the strength
    that of the state that yields, or collapses, first. Both are nan in rows that have not converged, and in rows of a
    table file whose state is not that from the slack pose. InputError for another cell. Docs: theory.md, 7.

    >>> from rve.solve import solve_table
    >>> table = with_rings(solve_table(Cell(), ([0.0], [90.0])), Cell())
    >>> table.strength.round(1)  # yield stress in N/mm2 per N/mm of line load along the grain
    array([[123.2,  59.4]])
    """
    material, closure = cell.material, Joint.of(joint)
    info = reference_cell(cell) if table.cell is None else replace(table.cell, material=material)
    metal = material if table.cell is None else table.cell.material or material
    for key, value, of_table in (
        ("weave", cell.weave.name, info.weave),
        ("grain", cell.grain, info.grain),
        ("r1_mm", cell.r1, info.r1_mm),
        ("r2_mm", cell.r2, info.r2_mm),
        ("density_kg_per_mm3", cell.density, metal.density_kg_per_mm3),
    ):
        if value != of_table:
            raise InputError(f"{key} = {value} of the cell: the table has {of_table}; give the table's cell")
    states, is_solved = table.states, table.converged
    if states is None:  # a table that was read: solved again, from the slack pose alone
        states = locked_states(table.alpha_deg, table.beta_deg, cell, DirectOptions())
        is_solved = is_solved if table.branch is None else is_solved & (table.branch == "slack")
    states = replace(states, found=replace(states.found, status=np.where(is_solved, states.found.status, "stalled")))

    def columns(states: LockedStates) -> tuple[Array, Array]:
        """Compliance (n, 2, 3, 3) in weave axes, of the bend at unit trace of S and of the rings; strength (n, 2)."""
        reference = weave_sides(states.cell, info.sides_mm)
        equations, S = (
            Equations.of(states.cell.weave, cell.wire),
            second_pk(deformation(states.pose, reference), states.s),
        )
        rings = ring_states(equations, states.found, states.s, reference, material.poisson, closure.angles_deg)
        size = trace(S)[:, None]
        parts = [rings.locking * size[..., None], rings.elastic / (material.young_N_per_mm2 * cell.r1)]
        return np.stack(parts, axis=1), np.stack([rings.first_yield, rings.collapse], axis=1) / (cell.r1 * size)

    first, strength = columns(states)
    parts = first.copy()
    for rows, share, others in states.beside:
        other, other_strength = columns(others)
        np.maximum.at(strength, rows, other_strength)
        np.add.at(parts, rows, share[:, None, None, None] * (other - first[rows]))
    bend, elastic = np.moveaxis(parts[..., weave_axes(cell), weave_axes(cell)], 1, 0)
    D = bend / trace(table.S)[:, None, None] + elastic
    return replace(table, compliance=D, strength=strength, origin=replace(table.origin, cell=info, joint=closure.name))


@dataclass(frozen=True)
class Ends(Rows):
    """Where contacts act on the rings of n cells: slot and present (n, c) of each contact; of its ends, first those on
    ring a, then those on ring b: ring (n, 2c), angle phi (n, 2c), direction (n, 2c, 3) in the ring's local axes, zero
    for padding. Of each ring (n, k), grain: the angle at which it is farthest along the grain, and sense: 1 where
    angles grow counterclockwise as seen from the front, else -1."""

    slot: Index
    present: Flags
    ring: Index
    phi: Array
    direction: Array
    grain: Array
    sense: Array

    def joints(self, angle_deg: float) -> Array:
        """The angles (n, k) of joints that are `angle_deg` degrees around each ring from the grain."""
        return np.asarray(self.grain + np.radians(angle_deg) * self.sense)

    def on(self, k: int) -> tuple[Array, Array, Index]:
        """Angles (n, e), directions (n, e, 3), contacts (n, e) of the ends on ring k; padding has no direction."""
        is_end = (self.ring == k) & (self.direction != 0.0).any(axis=2)
        count = int(is_end.sum(axis=1).max(initial=1))
        column = np.argsort(~is_end, axis=1, kind="stable")[:, :count]
        is_end = np.take_along_axis(is_end, column, axis=1)
        direction = np.take_along_axis(self.direction, column[..., None], axis=1) * is_end[..., None]
        return np.take_along_axis(self.phi, column, axis=1), direction, column % self.slot.shape[1]


def contact_ends(equations: Equations, equilibrium: Equilibrium) -> Ends:
    """The ends of all closed contacts of locked states."""
    contacts, n = equilibrium.contacts, len(equilibrium.lam)
    working = touching(contacts, TOUCHING).reshape(n, -1)
    slot = np.argsort(~working, axis=1, kind="stable")[:, : int(working.sum(axis=1).max(initial=1))]
    present = np.take_along_axis(working, slot, axis=1)

    def at(values: Array) -> Array:
        return np.where(present[..., None], np.take_along_axis(values.reshape(n, -1, 3), slot[..., None], axis=1), 0.0)

    push, rho = at(contacts.normal), np.concatenate([at(contacts.rho), at(contacts.rho_b)], axis=1)
    push = np.concatenate([-push, push], axis=1)
    ring = np.concatenate([equations.weave.pairs[slot // contacts.gap.shape[2], end] for end in (0, 1)], axis=1)
    normal = equilibrium.pose.normals[np.arange(n)[:, None], ring]
    e1, e2 = tangent_frame(normal)
    phi = np.arctan2(dot(rho, e2), dot(rho, e1))
    rho = rho / equations.weave.radii[ring][..., None]
    direction = np.stack([dot(push, rho), dot(push, cross(normal, rho)), dot(push, normal)], axis=2)
    e1, e2 = tangent_frame(equilibrium.pose.normals)
    grain, sense = np.arctan2(e2[..., 1], e1[..., 1]), np.copysign(1.0, equilibrium.pose.normals[..., 2])
    return Ends(slot, present, ring, phi, direction, grain, sense)


def contact_flexibility(ends: Ends, rings: Sequence[Ring], joint: Array | None = None) -> Array:
    """The flexibility C (n, c, c) between the contacts of each cell, by its curved rings (k), open at joint (n, k)."""
    full = np.zeros(1)
    for k, ring in enumerate(rings):
        direction = ends.direction * (ends.ring == k)[..., None]
        full = full + flexibility(ends.phi, direction, ring.curved(), None if joint is None else joint[:, k])
    c = ends.slot.shape[1]
    return np.asarray(full.reshape(len(full), 2, c, 2, c).sum(axis=(1, 3)))  # over both ends of each contact


@dataclass(frozen=True)
class RingStates(Rows):
    """Elastic locked states of n cases.

    lam (n, p, SLOTS): contact forces in s r1, zero for idle contacts. locking, elastic (n, 3, 3): the parts of dE_i =
    D_ij dS_j under a unit line load: the bend of the locking surface, and the compliance of rings with E r1 = 1; the
    free part of a strain that is not unique is held. first_yield, collapse (n,): yield stress times r1 at which the
    unit load is that of first yield and of plastic collapse, nan without convergence. energy (n,): lam C lam.
    """

    lam: Array
    locking: Array
    elastic: Array
    first_yield: Array
    collapse: Array
    energy: Array


def ring_states(
    equations: Equations,
    equilibrium: Equilibrium,
    s: Array,
    reference: tuple[float, float],
    poisson: float,
    angles_deg: tuple[float, ...] = (),
) -> RingStates:
    """First-order elastic states and strength of locked states under loads s (n, 3), nan for those not converged.

    reference: sides of the reference cell in r1. angles_deg: where butted rings may be open, from the grain: yield and
    collapse are those at the worst angle, forces and compliance those at the most compliant one.
    """
    space = supercell(equations.weave, 1, 1, "space")  # joints are not symmetric: forces must balance across the plane
    equations, equilibrium = (
        Equations.of(space, equations.wire),
        replace(equilibrium, pose=tiled(equilibrium.pose, space)),
    )
    good = np.flatnonzero(equilibrium.status == "converged")
    nan, tensor = np.full(len(s), np.nan), np.full((len(s), 3, 3), np.nan)
    states = RingStates(np.zeros(equilibrium.lam.shape), tensor, tensor, nan, nan, nan)
    wires = equations.wire * space.wires
    rings = [Ring(r1, r2, 1.0, poisson) for r1, r2 in zip(space.radii.tolist(), wires.tolist(), strict=True)]
    begun = time.monotonic()
    for start in range(0, len(good), _BLOCK):
        tell(f"wires of the rings under load {start + 1} of {len(good)}", start, len(good), begun)
        rows = good[start : start + _BLOCK]
        states = states.put(
            rows, _Cells(equations, equilibrium.take(rows), s[rows], reference, rings).states(angles_deg)
        )
    return states


class _Cells:
    """Converged locked cells and their equations at the closed contacts `ends`: gradients G (n, c, m), balanced forces
    `start` (n, c), strain gradient B (n, 3, 3); area in r1^2."""

    def __init__(
        self,
        equations: Equations,
        equilibrium: Equilibrium,
        s: Array,
        reference: tuple[float, float],
        rings: Sequence[Ring],
    ) -> None:
        self.equilibrium, self.rings, self.area = equilibrium, rings, reference[0] * reference[1]
        self.ends = ends = contact_ends(equations, equilibrium)
        self.S = second_pk(deformation(equilibrium.pose, reference), s)
        self.dead = replace(equations, load=DeadLoad(reference))
        system = self.dead.assemble(equilibrium.pose, equilibrium.contacts, equilibrium.lam, self.S)
        self.G = np.take_along_axis(system.G, ends.slot[..., None], axis=1)
        self.start = np.where(
            ends.present, np.take_along_axis(equilibrium.lam.reshape(len(s), -1), ends.slot, axis=1), 0.0
        )
        for row, is_closed, G, f in zip(self.start, ends.present, self.G, system.f, strict=True):
            row[is_closed] = balanced_forces(G[is_closed], f, row[is_closed])
        self.B = lattice_strain(equilibrium.pose.lattice, reference)[1]

    def states(self, angles_deg: tuple[float, ...]) -> RingStates:
        """The states of welded rings, or of butted ones: the worst of each angle of their joints."""
        joints = [self.ends.joints(angle) for angle in angles_deg]
        states = self._states_at(joints[0] if joints else None)
        for joint in joints[1:]:
            other = self._states_at(joint)
            stress = np.maximum(states.first_yield, other.first_yield)
            load = np.maximum(states.collapse, other.collapse)
            softer = np.flatnonzero(other.energy > states.energy)
            states = replace(states.put(softer, other.take(softer)), first_yield=stress, collapse=load)
        return states

    def _states_at(self, joint: Array | None) -> RingStates:
        """The states of rings that are open at the angles `joint` (n, k), or welded."""
        ends, equilibrium, G = self.ends, self.equilibrium, self.G
        C, n = contact_flexibility(ends, self.rings, joint), len(G)
        lam, stress = np.zeros(ends.slot.shape), np.zeros(n)
        for i in range(n):
            rows = np.flatnonzero(ends.present[i])
            forces = elastic_forces(G[i, rows], C[i][np.ix_(rows, rows)], self.start[i, rows])
            lam[i, rows] = np.where(forces > _ZERO * forces.max(initial=0.0), forces, 0.0)
        full = np.zeros((n, equilibrium.lam[0].size))
        np.put_along_axis(full, ends.slot, lam, axis=1)
        J = self.dead.assemble(equilibrium.pose, equilibrium.contacts, full.reshape(equilibrium.lam.shape), self.S).J
        locking, elastic = np.empty((n, 3, 3)), np.empty((n, 3, 3))
        for i in range(n):
            rows = np.flatnonzero(lam[i] > 0.0)
            locking[i], elastic[i] = _compliance(G[i, rows], C[i][np.ix_(rows, rows)], -J[i], self.B[i], self.area)
        for k, ring in enumerate(self.rings):
            phi, direction, contact = ends.on(k)
            forces = np.take_along_axis(lam, contact, axis=1)[..., None] * direction
            stress = np.maximum(stress, peak_stress(phi, forces, ring, None if joint is None else joint[:, k])[0])
        energy, collapse = np.einsum("nc,ncd,nd->n", lam, C, lam), self._collapse(lam, joint)
        return RingStates(full.reshape(equilibrium.lam.shape), locking, elastic, stress, collapse, energy)

    def _collapse(self, lam: Array, joint: Array | None) -> Array:
        """Yield stress (n,) at which the load is that of plastic collapse: contact forces are free within balance."""
        start = 0.5 * (self.start + lam)  # parallel chains share a load that a single one may carry
        working = start > 1e-6 * start.max(axis=1, keepdims=True)
        free = [_split(G[rows])[3] for G, rows in zip(self.G, working, strict=True)]
        width = np.array([N.shape[1] for N in free])
        out = np.empty(len(lam))
        given, chosen = np.flatnonzero(width == 0), np.flatnonzero(width > 0)
        if len(given):
            moments = self._moments(given, lam[given, :, None], joint)
            out[given] = 1.0 / np.min([largest_factors(base[..., 0], held)[0] for base, held in moments], axis=0)
        if len(chosen):
            change = np.zeros((len(chosen), lam.shape[1], width.max()))
            for row, i in enumerate(chosen):
                change[row, working[i], : width[i]] = free[i]
            start = np.where(working, start, 0.0)[chosen]
            moments = self._moments(chosen, np.concatenate([start[..., None], change], axis=2), joint)
            out[chosen] = 1.0 / _factors(moments, start, change)
        return out

    def _moments(self, rows: Index, lam: Array, joint: Array | None) -> list[tuple[Array, Array]]:
        """For each class of rings of cells `rows` (n,) the relative moments (n, k, 3, w) by contact forces (n, c, w)
        and (n, k, 3, .) by the self-stresses of the ring."""
        moments, ends = [], self.ends.take(rows)
        for k, ring in enumerate(self.rings):
            phi, direction, contact = ends.on(k)
            loads = np.moveaxis(np.take_along_axis(lam, contact[..., None], axis=1), 2, 0)[..., None] * direction
            base, free = relative_moments(phi, loads, ring, None if joint is None else joint[rows, k])
            moments.append((np.moveaxis(base, 0, -1), free))
        return moments


def _split(G: Array) -> tuple[Array, Array, Array, Array]:
    """U_r, sizes, V of contact gradients G (c, m), and U_0: the forces that balance themselves."""
    U, sizes, Vt = np.linalg.svd(G)
    rank = int(np.count_nonzero(sizes > _ZERO * sizes.max(initial=0.0)))
    return U[:, :rank], sizes[:rank], Vt, U[:, rank:]


def _positive(K: Array) -> Array:
    """K with round-off added on its diagonal: contacts about to merge balance themselves with hardly a bend."""
    return np.asarray(K + 1e-13 * np.trace(K) * np.eye(len(K)))


def balanced_forces(G: Array, f: Array, start: Array) -> Array:
    """Forces (c,) >= 0 with G^T lam = -f: the nearest to `start` (c,) where these are none below 0."""
    U, sizes, Vt, _ = _split(G)
    p = start - U @ (U.T @ start + (Vt[: len(sizes)] @ f) / sizes)
    return np.maximum(p, 0.0) if p.min(initial=0.0) > -1e-6 else nnls(G.T, -f)[0]


def elastic_forces(G: Array, C: Array, start: Array) -> Array:
    """Forces lam (c,) >= 0 that balance what `start` (c,) >= 0 does, G^T lam = G^T start, and make lam C lam least.

    G (c, m), C (c, c). Balance leaves lam = start + N z >= 0: a least-distance problem (Lawson and Hanson, ch. 23).

    >>> elastic_forces(np.array([[1.0], [1.0]]), np.diag([1.0, 2.0]), np.array([0.0, 3.0])).round(12)
    array([2., 1.])
    """
    N = _split(G)[3]
    if not N.shape[1]:
        return start
    N[np.abs(N) < 1e-12] = 0.0  # round-off would lead to a huge z
    L = np.linalg.cholesky(_positive(N.T @ C @ N))
    shift = np.linalg.solve(L, N.T @ C @ start)
    size = np.linalg.norm(shift) or 1.0  # in which |y| is 1 at most
    A = np.linalg.solve(L, N.T).T  # N z = A (size y - shift) with size y = L^T z + shift, |y| is to be least
    y = shortest(size * A, A @ shift - start)
    return np.asarray(np.maximum(start if y is None else start + A @ (size * y - shift), 0.0))


def _compliance(G: Array, C: Array, H: Array, B: Array, area: float) -> tuple[Array, Array]:
    """Both parts of D (3, 3) of one cell.

    Motions Z keep all loaded contacts closed. Under dS they move by Z (Z^T H Z)^-1 Z^T f' with f' = A_ref B^T W dS: the
    bend of the locking surface. Forces change by Lam dS, and the rings give Lam^T C Lam / A_ref. Motions without
    stiffness, in which the load does no work, are held.
    """
    U, sizes, Vt, N = _split(G)
    W = U - N @ np.linalg.solve(_positive(N.T @ C @ N), N.T @ C @ U) if N.shape[1] else U
    Z = Vt[len(sizes) :].T
    load = np.pad(area * B.T * WEIGHT, ((0, len(H) - 3), (0, 0)))
    stiffness, motions = np.linalg.eigh(0.5 * Z.T @ (H + H.T) @ Z)
    stiff = stiffness >= SOFT
    V, stiffness = Z @ motions[:, stiff], stiffness[stiff]
    dq = (V / stiffness) @ (V.T @ load)
    Lam = W @ ((Vt[: len(sizes)] @ (H @ dq - load)) / sizes[:, None])
    return B @ dq[:3], (Lam.T @ C @ Lam) / area / WEIGHT[:, None]


def _factors(moments: list[tuple[Array, Array]], start: Array, change: Array) -> Array:
    """Factors (n,) at collapse for unit yield stress where the contact forces mu start + change z >= 0 are chosen."""
    each, count, free = moments[0][1].shape[-1], len(moments), []
    for k, (loaded, held) in enumerate(moments):
        others = (0, 0), (0, 0), (0, 0), (each * k, each * (count - 1 - k))
        free.append(np.concatenate([np.pad(held, others), loaded[..., 1:]], axis=3))
    no_sign = np.zeros((*start.shape, each * count))
    signs = np.concatenate([np.where(start > 0.0, start, 1.0)[..., None], no_sign, change], axis=2)
    base = np.concatenate([loaded[..., 0] for loaded, _ in moments], axis=1)
    return largest_factors(base, np.concatenate(free, axis=1), signs)[0]
