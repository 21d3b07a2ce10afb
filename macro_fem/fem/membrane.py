"""The elastic energy of a membrane: its value, its gradient (forces) and its second derivative (tangent).

Pi(u) = sum_p w_p psi(F_p) - f . u with psi(F) = Psi(E), E = (F^T F - I)/2. With S = dPsi/dE and C = dS/dE

    P = dpsi/dF = F S,    A = d2psi/dF2,  A_ij,kl = delta_ik S_jl + F_im C_mj,ln F_kn   (geometric + material),

the same in the plane (F 2 x 2) and in space (F 3 x 2). If Psi is convex and S positive semidefinite, Pi is convex.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from homogenize import Response
from macro_fem.fem.assembly import gradient, internal_force
from macro_fem.fem.discretization import Discretization
from rve.common.types import Array


class ElasticLaw(Protocol):
    """The part of `homogenize.MembraneLaw` that `macro_fem.solvers.newton` uses."""

    def response(self, E: Array) -> Response:
        """Energy, stress and tangent of the elastic law at E (n, 3)."""
        ...


@dataclass(frozen=True, eq=False)
class State:
    """A displacement u (n_nodes, d) and what follows from it.

    F (n_points, d, 2); response of the law at each point; stored: elastic energy, N mm; internal (n_nodes, d): nodal
    forces of the stress, N.
    """

    u: Array
    F: Array
    response: Response
    stored: float
    internal: Array

    @property
    def is_finite(self) -> bool:
        """Whether energy and forces are numbers: a law may have none where a cell is turned inside out."""
        return bool(np.isfinite(self.stored) and np.all(np.isfinite(self.internal)))


def evaluate(disc: Discretization, law: ElasticLaw, u: Array) -> State:
    """The state at the displacement u (n_nodes, d); one call of the law.

    A square of the diagonal net stores S:D:S / 2 where it is stretched beyond its limit, D = 1/2 mm/N:

    >>> import skfem
    >>> from homogenize import diagonal_net
    >>> from macro_fem.fem.discretization import discretize
    >>> disc = discretize(skfem.MeshQuad(), "Q1")
    >>> state = evaluate(disc, diagonal_net(1.1, 2.0), 0.2 * disc.nodes)
    >>> S = state.response.S[0]
    >>> bool(S[0] > 0.0), bool(np.isclose(state.stored, 0.5 * 0.5 * (S[0] ** 2 + 2.0 * S[1] ** 2 + S[2] ** 2)))
    (True, True)
    """
    G = gradient(disc, u)
    E = green_strain(G)
    F = G  # E is taken from the displacement gradient, which does not cancel at small strain; then G becomes F
    F[:, 0, 0] += 1.0
    F[:, 1, 1] += 1.0
    response = law.response(E)
    stored = float(disc.weight @ response.energy)
    return State(u, F, response, stored, internal_force(disc, first_piola(F, response.S)))


def green_strain(G: Array) -> Array:
    """E = (G + G^T + G^T G)/2 as triples (n, 3) from the displacement gradient G (n, d, 2)."""
    E = np.empty((3, len(G)))
    np.multiply(G[:, 0, 0], G[:, 0, 0], out=E[0])
    np.multiply(G[:, 0, 0], G[:, 0, 1], out=E[1])
    np.multiply(G[:, 0, 1], G[:, 0, 1], out=E[2])
    for i in range(1, G.shape[1]):
        E[0] += G[:, i, 0] * G[:, i, 0]
        E[1] += G[:, i, 0] * G[:, i, 1]
        E[2] += G[:, i, 1] * G[:, i, 1]
    E *= 0.5
    E[0] += G[:, 0, 0]
    E[1] += 0.5 * (G[:, 0, 1] + G[:, 1, 0])
    E[2] += G[:, 1, 1]
    return E.T


def first_piola(F: Array, S: Array) -> Array:
    """P = F S (n, d, 2) of F (n, d, 2) and the triples S (n, 3)."""
    d = F.shape[1]
    P = np.empty((d, 2, len(F)))
    for i in range(d):
        np.multiply(F[:, i, 0], S[:, 0], out=P[i, 0])
        P[i, 0] += F[:, i, 1] * S[:, 1]
        np.multiply(F[:, i, 0], S[:, 1], out=P[i, 1])
        P[i, 1] += F[:, i, 1] * S[:, 2]
    return np.moveaxis(P, -1, 0)


def tangent(F: Array, S: Array, C: Array) -> Array:
    """A (n, d, 2, d, 2) of F (n, d, 2), S (n, 3) and C (n, 3, 3) as in `Response`.

    Only the blocks A[:, i, :, k, :] with i >= k are filled, which is what `stiffness` reads; the others stay zero.
    """
    n, d, _ = F.shape
    A = np.zeros((d, 2, d, 2, n))
    voigt = ((0, 1), (1, 2))
    # C maps tensor triples, so its middle column holds both shear components: half of it is C_mj12.
    c = [[C[:, r, s] if s != 1 else 0.5 * C[:, r, 1] for s in range(3)] for r in range(3)]
    for i in range(d):
        FC = [[F[:, i, 0] * c[voigt[0][j]][s] + F[:, i, 1] * c[voigt[1][j]][s] for s in range(3)] for j in range(2)]
        for k in range(i + 1):
            for j in range(2):
                for l in range(j if i == k else 0, 2):
                    entry = A[i, j, k, l]
                    np.multiply(FC[j][voigt[l][0]], F[:, k, 0], out=entry)
                    entry += FC[j][voigt[l][1]] * F[:, k, 1]
                    if i == k:
                        entry += S[:, voigt[j][l]]
                        if j != l:
                            A[i, l, k, j] = entry
    return np.moveaxis(A, -1, 0)
