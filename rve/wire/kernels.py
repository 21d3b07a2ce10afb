"""Internal forces and flexibility of a closed circular ring under point forces: exact for the curved beam.

A point force is a Fourier series along the ring; every order n >= 2 is self-balanced, and the sums are closed. The
rigid part of a force is spread over the ring in the orders 0 and 1 and drops out where the forces of a ring balance.
Forces (..., 3) are in the local axes r, t, z of their point; section forces are ordered as in `rve.wire.section`.
"""

import numpy as np

from rve.common import Array
from rve.wire.section import Section


def sums(phi: Array) -> tuple[Array, Array, Array, Array]:
    """The sums over n >= 2 behind section forces, at angles phi of any shape, x = n^2 - 1: cos(n phi)/x,
    n sin(n phi)/x, sin(n phi)/(n x), sin(n phi)/n. The second and the last jump at phi = 0: given is the value from
    above.

    >>> n = np.arange(2, 100_000)
    >>> bool(abs(sums(np.array(1.0))[0] - np.sum(np.cos(n) / (n**2 - 1.0))) < 1e-9)
    True
    """
    phi = np.mod(phi, 2.0 * np.pi)
    c, s, y = np.cos(phi), np.sin(phi), np.pi - phi
    sin_x, sin_n = 0.5 * y * c - 0.25 * s, 0.5 * y - s
    return 0.5 + 0.25 * c - 0.5 * y * s, sin_x, sin_x - sin_n, sin_n


def squares(phi: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
    """The sums over n >= 2 behind the flexibility, at angles phi of any shape, x = n^2 - 1, all continuous:
    cos(n phi)/x^2, n^2 cos(n phi)/x^2, cos(n phi)/(n x)^2, n sin(n phi)/x^2, sin(n phi)/(n x^2), cos(n phi)/n^2.

    >>> n = np.arange(2, 1000)
    >>> bool(abs(squares(np.array(0.0))[0] - np.sum(1.0 / (n**2 - 1.0) ** 2)) < 1e-9)
    True
    """
    cos_x, sin_x, _, sin_n = sums(phi)
    phi = np.mod(phi, 2.0 * np.pi)
    c, s, y = np.cos(phi), np.sin(phi), np.pi - phi
    cos_n = 0.25 * y**2 - np.pi**2 / 12.0 - c
    cos = -0.5 - (3.0 / 16.0 + np.pi**2 / 24.0) * c + 0.25 * y * s + 0.125 * y**2 * c
    sin_up = (1.0 / 16.0 - np.pi**2 / 24.0) * s + 0.125 * y**2 * s
    return cos, cos_x + cos, cos_n - cos_x + cos, sin_up, sin_n - sin_x + sin_up, cos_n


def _low_orders(section: Section) -> tuple[float, float, float, float]:
    """The self-balanced orders 0 and 1 of a unit force, 0 for bending alone: uniform M_z with the uniform N = 1/(2 pi)
    of a radial force, amplitude of V_r in order 1, and the parts of the flexibility of both orders.
    """
    s, R, W = section, section.radius, 0.5 / np.pi
    moment = -s.coupling / s.bending * W
    stiff = s.axial + s.shear + s.bending * R**2 - 2.0 * s.coupling * R
    shear = -W * (s.axial - s.coupling * R) / stiff
    energy_0 = s.axial * W**2 + 2.0 * s.coupling * W * moment + s.bending * moment**2
    N = shear + W
    energy_1 = s.axial * N**2 + s.shear * shear**2 + s.bending * (R * shear) ** 2 - 2.0 * s.coupling * R * shear * N
    return moment, shear, 2.0 * np.pi * R * energy_0, np.pi * R * energy_1


def internal_forces(phi: Array, forces: Array, at: Array, section: Section, joint: Array | None = None) -> Array:
    """Section forces (..., k, 6) at the angles at (..., k) under forces (..., m, 3) at the angles phi (..., m).

    Forces that do not balance are balanced by a load spread over the ring. At a point force V_r, V_z and N are
    those just ahead of it. joint (...): the angle at which a butted ring is open, its ends free; None for a welded one.

    >>> thin = Section(radius=10.0, bending=1.0, out_of_plane=1.0, torsion=1.3)
    >>> pull = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    >>> at_load = internal_forces(np.array([0.0, np.pi]), pull, np.array([0.0]), thin)[0]
    >>> float((at_load[5] * np.pi / 10.0).round(12))
    1.0
    """
    R, (moment, shear, _, _) = section.radius, _low_orders(section)
    W = 0.5 / np.pi
    angle = at[..., :, None] - phi[..., None, :]
    c, s, (cos_x, sin_x, sin_nx, sin_n) = np.cos(angle), np.sin(angle), sums(angle)
    radial, along, axial = (forces[..., None, :, i] for i in range(3))
    N1 = shear + W
    V_r = radial * (shear * s - sin_x / np.pi) + along * (shear * c + cos_x / np.pi)
    N = radial * (W + N1 * c - cos_x / np.pi) + along * (-N1 * s - sin_x / np.pi)
    V_z, M_r, M_t = axial * (-sin_n / np.pi), axial * (-R / np.pi * cos_x), axial * (R / np.pi * sin_nx)
    M_z = radial * (moment - R * shear * c + R / np.pi * cos_x) + along * (R * shear * s + R / np.pi * sin_nx)
    closed = np.stack([q.sum(axis=-1) for q in (V_r, N, V_z, M_r, M_t, M_z)], axis=-1)
    if joint is None:
        return closed
    at_joint = internal_forces(phi, forces, joint[..., None], section)[..., 0, :]
    x = -np.linalg.solve(self_stress(joint, R), at_joint[..., None])[..., 0]
    return np.asarray(closed + np.einsum("...kij,...j->...ki", self_stress(at, R), x))


def flexibility(phi: Array, directions: Array, section: Section, joint: Array | None = None) -> Array:
    """Flexibility (..., m, m) in mm/N between points of a ring: displacements along `directions` per force along them.

    phi (..., m), directions (..., m, 3) in local axes, joint as in `internal_forces`. Symmetric and positive
    semidefinite; exact for forces that balance, half of lam C lam is their strain energy.

    >>> thin = Section(radius=10.0, bending=1e-3, out_of_plane=1e-3, torsion=1.3e-3)
    >>> out = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    >>> opening = flexibility(np.array([0.0, np.pi]), out, thin).sum()
    >>> float((opening / (np.pi / 4.0 - 2.0 / np.pi)).round(12))  # F R^3/(E I) = 1
    1.0
    """
    R, s = section.radius, section
    angle = phi[..., :, None] - phi[..., None, :]
    cos, cos_up, cos_down, sin_up, sin_down, cos_n = squares(angle)
    _, _, energy_0, energy_1 = _low_orders(section)
    bend, mixed = s.bending * R**2, s.coupling * R
    rr = R / np.pi * ((s.axial + bend - 2.0 * mixed) * cos + s.shear * cos_up)
    tt = R / np.pi * (s.axial * cos_up + s.shear * cos + bend * cos_down - 2.0 * mixed * cos)
    rt = R / np.pi * ((s.axial + s.shear - mixed) * sin_up + (bend - mixed) * sin_down)
    zz = R / np.pi * (R**2 * (s.out_of_plane * cos + s.torsion * cos_down) + s.shear * cos_n)
    rr = rr + energy_0 + energy_1 * np.cos(angle)
    tt = tt + energy_1 * np.cos(angle)
    rt = rt - energy_1 * np.sin(angle)
    r, t, z = (directions[..., i] for i in range(3))
    out = r[..., :, None] * rr * r[..., None, :] + t[..., :, None] * tt * t[..., None, :]
    cross = r[..., :, None] * rt * t[..., None, :]
    out = out + z[..., :, None] * zz * z[..., None, :] + cross + np.swapaxes(cross, -1, -2)
    if joint is None:
        return np.asarray(out)
    eight = 0.25 * np.pi * np.arange(8.0)  # products of states hold at most cos 2 phi: eight points integrate exactly
    H = self_stress(eight, R)
    F = np.einsum("kai,ab,kbj->ij", H, section_matrix(section), H) * 2.0 * np.pi * R / 8.0
    # Amplitudes (..., 6, m) of the self-stress states that free the section at the joint of every unit force.
    unit = np.eye(phi.shape[-1])[..., None] * directions[..., None, :, :]
    q = internal_forces(phi[..., None, :], unit, joint[..., None, None], section)[..., 0, :]
    X = -np.linalg.solve(self_stress(joint, R), np.swapaxes(q, -1, -2))
    return np.asarray(out + np.einsum("...ak,ab,...bl->...kl", X, F, X))


def self_stress(at: Array, radius: float) -> Array:
    """The six states (..., 6, 6), last axis, of section forces that balance without load, at angles (...): a constant
    force P along x, y, z and a constant moment about x, y, z; M = M_0 - x cross P.
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
    """Flexibility (6, 6) of one mm of wire, in the order of the section forces."""
    s = section
    S = np.diag([s.shear, s.axial, s.shear, s.out_of_plane, s.torsion, s.bending])
    S[1, 5] = S[5, 1] = s.coupling
    return S
