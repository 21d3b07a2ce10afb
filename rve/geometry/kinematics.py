"""Line loads and strains of a plane membrane: equations (1)-(5) and (11) of the paper.

Symmetric tensors are triples (11, 12, 22) on the last axis; the leading axis is the load case.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import cosdg, sindg

from rve.common import Array
from rve.common.tensor import IDENTITY, eigenvalues


def cauchy_line_load(alpha_deg: ArrayLike, beta_deg: ArrayLike) -> Array:
    """Cauchy line load s of unit size, (n, 3), eq. (3): s1 = cos(beta), s2 = sin(beta), principal axis 1 at alpha.

    Multiples of 90 degrees are exact: no round-off shear, no round-off compression.

    >>> cauchy_line_load([0.0, 2.0**200 * 360.0], [90.0, 90.0])
    array([[0., 0., 1.],
           [0., 0., 1.]])
    """
    # Within one turn, since huge angles have no cosine in degrees.
    alpha, beta = (np.fmod(np.asarray(angle, dtype=float), 360.0) for angle in (alpha_deg, beta_deg))
    ca, sa, s1, s2 = cosdg(alpha), sindg(alpha), cosdg(beta), sindg(beta)
    s = np.stack([ca**2 * s1 + sa**2 * s2, ca * sa * (s1 - s2), sa**2 * s1 + ca**2 * s2], axis=-1)
    return s + 0.0  # no negative zeros in tables


def load_angles(s: Array) -> tuple[Array, Array, Array]:
    """Angles alpha, beta in degrees and size (n,) of line loads s (n, 3); compressive components are set to zero.

    beta lies between 0 and 45 degrees: the first principal load is the larger one. The size has the unit of the loads.

    >>> alpha, beta, size = load_angles(2.0 * cauchy_line_load([30.0, -45.0], [20.0, 0.0]))
    >>> alpha.round(9).tolist(), beta.round(9).tolist(), size.round(9).tolist()
    ([30.0, -45.0], [20.0, 0.0], [2.0, 2.0])
    """
    s2, s1 = (np.maximum(value, 0.0) for value in eigenvalues(s))
    alpha = 0.5 * np.degrees(np.arctan2(s[:, 1], 0.5 * (s[:, 0] - s[:, 2])))
    return alpha, np.degrees(np.arctan2(s2, s1)), np.hypot(s1, s2)


def green_lagrange(F: Array) -> Array:
    """Green-Lagrange strain (n, 3) of deformation gradients F (n, 2, 2), eq. (2)."""
    C = np.matmul(F.transpose(0, 2, 1), F)
    return np.asarray(0.5 * (_triples(C) - IDENTITY))


def _triples(A: Array) -> Array:
    """Components 11, 12, 22 (n, 3) of symmetric tensors (n, 2, 2)."""
    return np.asarray(A.reshape(-1, 4)[:, [0, 1, 3]])


def _tensors(a: Array) -> Array:
    """Symmetric tensors (n, 2, 2) of triples (n, 3)."""
    return np.asarray(a[:, [0, 1, 1, 2]].reshape(-1, 2, 2))


def deformation_gradient(E: Array) -> Array:
    """Deformation gradient F (n, 2, 2) of strains E (n, 3) under the rotation rule (5), tan(gamma) = y2/x2 = x3/y3.

    The rule makes F = [[u, t v], [t u, v]], hence sin(2 gamma) = C12 / sqrt(C11 C22) with C = I + 2E. Raises ValueError
    where I + 2E is not positive definite.

    >>> deformation_gradient(np.array([[0.625, 0.0, 0.0]])).round(12)
    array([[[1.5, 0. ],
            [0. , 1. ]]])
    """
    c11, c12, c22 = 1.0 + 2.0 * E[:, 0], 2.0 * E[:, 1], 1.0 + 2.0 * E[:, 2]
    if np.any(~((c11 > 0.0) & (c22 > 0.0) & (c12**2 < c11 * c22))):
        raise ValueError("the strain squeezes the cell to nothing: I + 2E must be positive definite")
    length1, length2 = np.sqrt(c11), np.sqrt(c22)
    gamma = 0.5 * np.arcsin(c12 / (length1 * length2))
    c, s = np.cos(gamma), np.sin(gamma)
    return np.stack([np.stack([length1 * c, length2 * s], 1), np.stack([length1 * s, length2 * c], 1)], 1)


def second_pk(F: Array, s: Array) -> Array:
    """Second Piola-Kirchhoff line load S = J F^-1 s F^-T, (n, 3), of Cauchy line loads s (n, 3)."""
    # J F^-1 = adj F, so S = adj(F) s adj(F)^T / J
    adjoint = F[:, ::-1, ::-1].transpose(0, 2, 1) * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return _triples(adjoint @ _tensors(s) @ adjoint.transpose(0, 2, 1) / np.linalg.det(F)[:, None, None])


def cauchy_of(S: Array, E: Array) -> Array:
    """Cauchy line loads s = F S F^T / J (n, 3) of second Piola-Kirchhoff line loads S (n, 3) at strains E (n, 3), in
    the frame of the rotation rule (5): the inverse of `second_pk`."""
    F = deformation_gradient(E)
    return _triples(F @ _tensors(S) @ F.transpose(0, 2, 1) / np.linalg.det(F)[:, None, None])


def load_directions(S: Array, E: Array) -> tuple[Array, Array]:
    """Angles alpha in (-45, 45] and beta in [0, 90] degrees (n,) of the Cauchy loads of S (n, 3) at strains E (n, 3),
    to 1e-6 degrees; alpha is 0 where beta is 45, as all are one load.

    >>> load_directions(np.array([[0.0, 0.0, 3.0], [1.0, 1e-9, 1.0]]), np.zeros((2, 3)))
    (array([0., 0.]), array([90., 45.]))
    """
    alpha, beta, _ = (np.round(one, 6) for one in load_angles(cauchy_of(S, E)))
    turns = np.where(alpha > 45.0, -90.0, np.where(alpha <= -45.0, 90.0, 0.0))
    return np.where(beta == 45.0, 0.0, alpha + turns) + 0.0, np.where(turns != 0.0, 90.0 - beta, beta)


def lattice_strain(lattice: Array, sides: tuple[float, float]) -> tuple[Array, Array]:
    """Green-Lagrange strain (n, 3) of lattices x2, y3, t (n, 3), and its derivative (n, 3, 3).

    F = [[u, t v], [t u, v]] with u = x2/b_x, v = y3/b_y.
    """
    bx, by = sides
    u, v, t = lattice[:, 0] / bx, lattice[:, 1] / by, lattice[:, 2]
    square, d = 1.0 + t**2, np.zeros((len(t), 3, 3))
    d[:, 0, 0], d[:, 0, 2] = u * square / bx, u**2 * t
    d[:, 1, 0], d[:, 1, 1], d[:, 1, 2] = t * v / bx, t * u / by, u * v
    d[:, 2, 1], d[:, 2, 2] = v * square / by, v**2 * t
    return np.stack([0.5 * (u**2 * square - 1.0), t * u * v, 0.5 * (v**2 * square - 1.0)], axis=1), d
