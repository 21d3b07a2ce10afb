"""The equilibrium equations of the periodic cell and their exact derivatives, batched over load cases.

    r = f(q) + G(q)^T lam = 0,    gap(q) >= 0,    lam >= 0,    lam gap = 0.

Lengths are in units of r1 and forces in units of s r1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rve.common import Array, Rows
from rve.common.cell_fields import gyration_radius
from rve.geometry.contacts import CellContacts, distance_forms, find_contacts
from rve.geometry.pose import Pose, moved, pair_maps, place_maps, reduction, turns_of
from rve.geometry.weave import Weave

REACH = 0.6
"""Contacts with a larger gap, in r1, are ignored; a step moves rings by less."""
_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])


@dataclass(frozen=True)
class System(Rows):
    """Equations of n poses with m coordinates and c contact slots: residual r and load f (n, m); J (n, m, m):
    derivative of r; G (n, c, m): gap gradients; M (n, m, m): mass matrix of the rings for unit density, which weighs
    the residual (eq. 9); size (n,): the force it is measured against.
    """

    r: Array
    f: Array
    J: Array
    G: Array
    M: Array
    size: Array

    @property
    def weighted_residual(self) -> Array:
        """R of eq. (9) on the static system, (n,), without unit."""
        return weighted_size(self.r, self.M) / self.size


def weighted_size(f: Array, M: Array) -> Array:
    """Size (n,) of generalised forces f (n, m) weighed by the mass matrices M (n, m, m), as in eq. (9)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ni,ni->n", f, np.linalg.solve(M, f[..., None])[..., 0]), 0.0)))


Force = Callable[[Pose, Array, Array], tuple[Array, Array]]
"""What pulls at a cell: force (n, m) on the reduced coordinates and its derivative (n, m, m), of a pose, its
`reduction` T, and one row of numbers per case whose meaning is the load's own."""


def cauchy_load(pose: Pose, T: Array, s: Array) -> tuple[Array, Array]:
    """The `Force` of the Cauchy line loads s (n, 3)."""
    return on_coordinates(lattice_load(pose, s)[1], pose, T)


def on_coordinates(K: Array, pose: Pose, T: Array) -> tuple[Array, Array]:
    """Generalised force (n, m) on the reduced coordinates, and its derivative, of the forces K (a1, a2), K (n, 4, 4),
    on the lattice vectors; T is reduction(pose)."""
    on_lattice, Ta = np.einsum("nij,nj->ni", K, np.concatenate([pose.a1, pose.a2], axis=1)), T[:, :4]
    J = np.matmul(np.matmul(Ta.transpose(0, 2, 1), K), Ta)
    add_lattice_curvature(J, on_lattice)
    return np.einsum("ni,nij->nj", on_lattice, Ta), J


def add_lattice_curvature(J: Array, on_lattice: Array) -> None:
    """Adds to J (n, m, m) what forces (n, 4) on (a1, a2) do where a1y = t x2 and a2x = t y3 are bilinear."""
    for row, component in ((0, 1), (1, 2)):
        J[:, row, 2] += on_lattice[:, component]
        J[:, 2, row] += on_lattice[:, component]


def lattice_load(pose: Pose, s: Array) -> tuple[Array, Array]:
    """Force (n, 4) of the Cauchy line load s (n, 3) on the lattice vectors of the *current* cell, s.(a2y, -a2x) on a1
    and s.(-a1y, a1x) on a2, and its derivative (n, 4, 4), which is unsymmetric."""
    full = np.stack([s[:, [0, 1]], s[:, [1, 2]]], axis=1)
    K = np.zeros((len(s), 4, 4))
    K[:, :2, 2:] = full @ _TURN
    K[:, 2:, :2] = -(full @ _TURN)
    return np.einsum("nij,nj->ni", K, np.concatenate([pose.a1, pose.a2], axis=1)), K


def mass_matrix(weave: Weave, wire: float) -> Array:
    """Mass matrix of the generalised velocities, (m_full, m_full), the first ring's mass and radius being 1; how rings
    resist a spin about their axes weighs no coordinate."""
    way, mass = place_maps(weave, weave.rings), weave.masses
    M = np.einsum("r,rxi,rxj->ij", mass[weave.rings[:, 0]], way, way)
    for ring in weave.rings[:, 0]:
        turns, gyration = turns_of(weave, ring), gyration_radius(weave.radii[ring], wire * weave.wires[ring])
        M[turns, turns] += mass[ring] * gyration**2 * np.eye(3)
    return np.asarray(M)


@dataclass(frozen=True)
class Equations:
    """What does not change during a solve: weave, wire = r2/r1, pair maps, mass matrix, the modes that may move, load.

    modes (m, k): motions as combinations of the m reduced coordinates; the identity leaves all of them free.
    is_relative: s are line loads, of which only the directions count, and residuals are measured against them, not
    against 1.
    """

    weave: Weave
    wire: float
    maps: Array
    mass: Array
    modes: Array
    load: Force = cauchy_load
    is_relative: bool = True

    @staticmethod
    def of(weave: Weave, wire: float, modes: Array | None = None, load: Force = cauchy_load) -> Equations:
        """Equations of a weave with wire radius r2/r1; by default all coordinates are free and a line load pulls."""
        free = np.eye(weave.coordinates) if modes is None else modes
        return Equations(weave, wire, pair_maps(weave), mass_matrix(weave, wire), free, load)

    def contacts(self, pose: Pose) -> CellContacts:
        """Every contact of these poses whose gap is below `REACH`."""
        return find_contacts(pose, self.weave, self.wire, REACH)

    @property
    def thinnest(self) -> float:
        """Radius of the thinnest wire in r1."""
        return self.wire * float(self.weave.wires.min())

    def moved(self, pose: Pose, y: Array) -> Pose:
        """The pose after a step of the mode amplitudes y (n, k)."""
        return moved(pose, np.matmul(self.modes, y[..., None])[..., 0])

    def gap_derivatives(self, pose: Pose, contacts: CellContacts, T: Array, lam: Array) -> tuple[Array, Array]:
        """Gap gradients G (n, c, m) on the reduced coordinates, 0 in empty slots, and the sum (n, m, m) of the second
        derivatives of gaps times their forces lam (n, p, SLOTS); T is reduction(pose)."""
        (n, p, slots), full, minima = contacts.present.shape, T.shape[1], contacts.minima
        case, pair = np.divmod(minima.pair, p)
        na, nb = (pose.normals[case, ring] for ring in self.weave.pairs[pair, :2].T)
        X, weight = distance_forms(minima, na, nb)
        X = np.matmul(X, self.maps[pair])
        G = np.zeros((n, p, slots, full))
        G[contacts.present] = X[:, 0]
        # Rows of the contacts of every case, none of which has more of them than this.
        place = np.arange(len(case)) - np.searchsorted(case, np.arange(n))[case]
        rows, bent = np.zeros((2, n, place.max(initial=-1) + 1, 6, full))
        rows[case, place] = X[:, 1:]
        bent[case, place] = (lam[contacts.present][:, None] * weight)[..., None] * X[:, 1:]
        rows, bent = (of.reshape(n, of.shape[1] * 6, full) for of in (rows, bent))
        bend = np.matmul(rows.transpose(0, 2, 1), bent)
        return np.matmul(G.reshape(n, p * slots, full), T), np.matmul(np.matmul(T.transpose(0, 2, 1), bend), T)

    def assemble(self, pose: Pose, contacts: CellContacts, lam: Array, s: Array) -> System:
        """Residual, derivatives and gradients at a pose for contact forces lam (n, p, SLOTS) and loads s (n, ...)."""
        n, T = len(s), reduction(pose)
        f, J = self.load(pose, T, s)
        G, bend = self.gap_derivatives(pose, contacts, T, lam)
        r, J = f + np.matmul(lam.reshape(n, 1, G.shape[1]), G)[:, 0], J + bend
        # Shares of contact forces in the force on a1 and a2.
        flat = np.einsum("nps,npsx->npx", lam, contacts.normal[..., :2])
        shares = [np.einsum("npx,p->nx", flat, shift) for shift in self.weave.pairs[:, 2:].T]
        add_lattice_curvature(J, np.concatenate(shares, axis=1))

        M = np.matmul(np.matmul(T.transpose(0, 2, 1), self.mass), T)
        B, Bt = self.modes, self.modes.T
        f, M, J = np.matmul(Bt, f[..., None])[..., 0], Bt @ M @ B, Bt @ J @ B
        size = weighted_size(f, M) if self.is_relative else np.ones(n)
        return System(np.matmul(Bt, r[..., None])[..., 0], f, J, G @ B, M, size)
