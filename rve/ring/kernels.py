"""Internal forces and flexibility of a closed circular ring under point forces: exact for the curved beam.

A point force is a Fourier series along the ring. Every order n >= 2 is self-balanced and decides its own section
forces by equilibrium alone; the sums are closed (`rve.ring.series`). The rigid part of a force (resultant and moment)
is spread over the ring in the orders 0 and 1 and drops out where all forces of a ring balance. Forces (..., 3) are in
the local axes r, t, z of their point; angles are in radians; section forces are ordered as in `rve.ring.section`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rve.common.types import Array
from rve.ring.section import Section
from rve.ring.series import squares, sums

_W = 0.5 / np.pi


class LowOrders(NamedTuple):
    """The self-balanced orders 0 and 1 of a unit force. moment: uniform M_z that goes with the uniform N = 1/(2 pi)
    of a radial force. shear: amplitude of V_r in order 1. energy_0, energy_1: their parts of the flexibility."""

    moment: float
    shear: float
    energy_0: float
    energy_1: float


def low_orders(section: Section) -> LowOrders:
    """Orders 0 and 1, where the section forces follow from the least strain energy; 0 for bending alone."""
    s, R = section, section.radius
    moment = -s.coupling / s.bending * _W
    stiff = s.axial + s.shear + s.bending * R**2 - 2.0 * s.coupling * R
    shear = -_W * (s.axial - s.coupling * R) / stiff
    energy_0 = s.axial * _W**2 + 2.0 * s.coupling * _W * moment + s.bending * moment**2
    N = shear + _W
    energy_1 = s.axial * N**2 + s.shear * shear**2 + s.bending * (R * shear) ** 2 - 2.0 * s.coupling * R * shear * N
    return LowOrders(moment, shear, 2.0 * np.pi * R * energy_0, np.pi * R * energy_1)


def internal_forces(phi: Array, forces: Array, at: Array, section: Section) -> Array:
    """Section forces (..., k, 6) at the angles at (..., k) under forces (..., m, 3) at the angles phi (..., m).

    Leading axes are rings and load cases. Where the forces of a ring do not balance, what is missing is spread over it.
    At a point force V_r, V_z and N are those just ahead of it.

    >>> thin = Section(radius=10.0, bending=1.0, out_of_plane=1.0, torsion=1.3)
    >>> pull = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    >>> at_load = internal_forces(np.array([0.0, np.pi]), pull, np.array([0.0]), thin)[0]
    >>> float((at_load[5] * np.pi / 10.0).round(12))
    1.0
    """
    R, low = section.radius, low_orders(section)
    angle = at[..., :, None] - phi[..., None, :]
    c, s, series = np.cos(angle), np.sin(angle), sums(angle)
    radial, along, axial = (forces[..., None, :, i] for i in range(3))

    def total(*terms: Array) -> Array:
        return np.asarray(sum(terms)).sum(axis=-1)

    one, N1 = low.shear, low.shear + _W
    V_r = total(radial * (one * s - series.sin_x / np.pi), along * (one * c + series.cos_x / np.pi))
    N = total(radial * (_W + N1 * c - series.cos_x / np.pi), along * (-N1 * s - series.sin_x / np.pi))
    V_z = total(axial * (-series.sin_n / np.pi))
    M_r = total(axial * (-R / np.pi * series.cos_x))
    M_t = total(axial * (R / np.pi * series.sin_nx))
    M_z = total(
        radial * (low.moment - R * one * c + R / np.pi * series.cos_x),
        along * (R * one * s + R / np.pi * series.sin_nx),
    )
    return np.stack([V_r, N, V_z, M_r, M_t, M_z], axis=-1)


def flexibility(phi: Array, directions: Array, section: Section) -> Array:
    """Flexibility (..., m, m) in mm/N between points of a ring: displacements along `directions` per force along them.

    phi (..., m), directions (..., m, 3) in local axes. Symmetric and positive semidefinite; exact for forces that
    balance, half of lam C lam is their strain energy.

    >>> thin = Section(radius=10.0, bending=1e-3, out_of_plane=1e-3, torsion=1.3e-3)
    >>> out = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    >>> opening = flexibility(np.array([0.0, np.pi]), out, thin).sum()
    >>> float((opening / (np.pi / 4.0 - 2.0 / np.pi)).round(12))  # F R^3/(E I) = 1
    1.0
    """
    R, s = section.radius, section
    angle = phi[..., :, None] - phi[..., None, :]
    cos, cos_up, cos_down, sin_up, sin_down, cos_n = squares(angle)
    low = low_orders(section)
    bend, mixed = s.bending * R**2, s.coupling * R
    rr = R / np.pi * ((s.axial + bend - 2.0 * mixed) * cos + s.shear * cos_up)
    tt = R / np.pi * (s.axial * cos_up + s.shear * cos + bend * cos_down - 2.0 * mixed * cos)
    rt = R / np.pi * ((s.axial + s.shear - mixed) * sin_up + (bend - mixed) * sin_down)
    zz = R / np.pi * (R**2 * (s.out_of_plane * cos + s.torsion * cos_down) + s.shear * cos_n)
    rr = rr + low.energy_0 + low.energy_1 * np.cos(angle)
    tt = tt + low.energy_1 * np.cos(angle)
    rt = rt - low.energy_1 * np.sin(angle)
    r, t, z = (directions[..., i] for i in range(3))
    out = r[..., :, None] * rr * r[..., None, :] + t[..., :, None] * tt * t[..., None, :]
    out = out + z[..., :, None] * zz * z[..., None, :]
    cross = r[..., :, None] * rt * t[..., None, :]
    return np.asarray(out + cross + np.swapaxes(cross, -1, -2))


def self_stress(at: Array, radius: float) -> Array:
    """The six states (..., 6, 6) of section forces that balance without load, at angles (...): last axis is the state.

    States are a constant force along x, y, z and a constant moment about x, y, z; M = M_0 - x cross P.
    """
    c, s = np.cos(at), np.sin(at)
    H = np.zeros((*np.shape(at), 6, 6))
    H[..., 0, 0], H[..., 0, 1] = c, s
    H[..., 1, 0], H[..., 1, 1] = -s, c
    H[..., 2, 2] = 1.0
    H[..., 3, 3], H[..., 3, 4] = c, s
    H[..., 4, 2], H[..., 4, 3], H[..., 4, 4] = radius, -s, c
    H[..., 5, 0], H[..., 5, 1], H[..., 5, 5] = radius * s, -radius * c, 1.0
    return H


def section_matrix(section: Section) -> Array:
    """What one mm of wire gives, (6, 6), in the order of the section forces."""
    s = section
    S = np.diag([s.shear, s.axial, s.shear, s.out_of_plane, s.torsion, s.bending])
    S[1, 5] = S[5, 1] = s.coupling
    return S


def _closing(phi: Array, directions: Array, joint: Array, section: Section) -> Array:
    """Amplitudes (..., 6, m) of the self-stress states that free the section at `joint` (...) of every unit force."""
    unit = np.eye(phi.shape[-1])[..., None] * directions[..., None, :, :]  # (..., m, m, 3)
    q = internal_forces(phi[..., None, :], unit, np.asarray(joint)[..., None, None], section)[..., 0, :]
    return np.asarray(-np.linalg.solve(self_stress(np.asarray(joint), section.radius), np.swapaxes(q, -1, -2)))


def opened_forces(phi: Array, forces: Array, at: Array, joint: Array, section: Section) -> Array:
    """Section forces (..., k, 6) as in `internal_forces` of a butted ring, open at the angle `joint` (...).

    The ends of the wire are free: the joint carries no moment and no force. Ends that press on each other would carry
    more.
    """
    joint = np.asarray(joint, float)
    closed = internal_forces(phi, forces, at, section)
    there = internal_forces(phi, forces, joint[..., None], section)[..., 0, :]
    x = -np.linalg.solve(self_stress(joint, section.radius), there[..., None])[..., 0]
    return closed + np.einsum("...kij,...j->...ki", self_stress(at, section.radius), x)


def opened_flexibility(phi: Array, directions: Array, joint: Array, section: Section) -> Array:
    """Flexibility (..., m, m) as in `flexibility` of a butted ring, open at the angle `joint` (...)."""
    angles = 0.25 * np.pi * np.arange(8.0)  # products of states hold at most cos 2 phi: eight points integrate exactly
    H = self_stress(np.asarray(angles, float), section.radius)
    F = np.einsum("kai,ab,kbj->ij", H, section_matrix(section), H) * 2.0 * np.pi * section.radius / 8.0
    X = _closing(phi, directions, joint, section)
    return flexibility(phi, directions, section) + np.einsum("...ak,ab,...bl->...kl", X, F, X)
