"""First and second derivative of the distance of two circles at a local minimum, exact; see `rve.geometry.circles`."""

from __future__ import annotations

import numpy as np

from rve.common import Array, Flags
from rve.geometry.circles import Minima, cross, dot


def distance_gradient(m: Minima) -> Array:
    """Derivative of the distance with respect to (d, theta_a, theta_b), (m, 9), by the envelope theorem.

    theta are rotation vectors of the rings in space: dD = u . dd - (rho_a x u) . dtheta_a + (rho_b x u) . dtheta_b.
    Units 1 and mm (per radian).
    """
    return np.concatenate([m.normal, -cross(m.rho_a, m.normal), cross(m.rho_b, m.normal)], axis=1)


def distance_hessian(m: Minima, n_a: Array, n_b: Array, r1: float, fixed: Flags | None = None) -> Array:
    """Second derivative of the distance with respect to (d, theta_a, theta_b), (m, 9, 9), exponential coordinates.

    n_a, n_b (m, 3) are the normals of the two rings of each minimum. With q = (d, theta) and the two angles phi that
    place the points, the implicit function theorem gives H = D_qq - D_qphi D_phiphi^-1 D_phiq. A minimum that is about
    to vanish (det D_phiphi -> 0) has an unbounded H; its determinant is kept above 1e-10 of its scale. Where `fixed`
    (m,) the point of ring a stays where it is on its ring and only that of ring b slides.
    """
    u, ra, rb, dist = m.normal, m.rho_a, m.rho_b, m.distance
    eye = np.eye(3)
    into = np.broadcast_to(eye, (len(dist), 3, 3))
    turns = (cross(eye, rho[:, None]).transpose(0, 2, 1) for rho in (-ra, rb))  # matrices of theta -> theta x rho
    W = np.concatenate([into, *turns], axis=2)
    uW = np.matmul(u[:, None, :], W)
    D_qq = (np.matmul(W.transpose(0, 2, 1), W) - uW.transpose(0, 2, 1) * uW) / dist[:, None, None]
    for block, rho, sign in ((slice(3, 6), ra, -1.0), (slice(6, 9), rb, 1.0)):
        outer = u[:, :, None] * rho[:, None, :]
        spin = 0.5 * (outer + outer.transpose(0, 2, 1)) - dot(u, rho)[:, None, None] * eye
        D_qq[:, block, block] += sign * spin
    ta, tb = cross(n_a, ra), cross(n_b, rb)
    w_phi = np.stack([-ta, tb], axis=2)  # dw/dphi_a, dw/dphi_b; both normal to u at a minimum
    D_qp = np.matmul(W.transpose(0, 2, 1), w_phi) / dist[:, None, None]
    D_qp[:, 3:6, 0] -= cross(ta, u)
    D_qp[:, 6:9, 1] += cross(tb, u)
    aa = r1**2 / dist + dot(u, ra)
    bb = r1**2 / dist - dot(u, rb)
    ab = -dot(ta, tb) / dist
    scale = (r1**2 / dist) ** 2
    det = np.maximum(aa * bb - ab**2, 1e-10 * scale)
    inverse = np.stack([np.stack([bb, -ab], 1), np.stack([-ab, aa], 1)], 1) / det[:, None, None]
    if fixed is not None:
        inverse[fixed] = 0.0
        inverse[fixed, 1, 1] = 1.0 / np.maximum(bb[fixed], 1e-10 * r1**2 / dist[fixed])
    return D_qq - np.matmul(np.matmul(D_qp, inverse), D_qp.transpose(0, 2, 1))
