"""Elastic laws of reference problems with known answers: not ring meshes, but what tests and benchmarks compare with.

Both follow `ElasticLaw`: the part of `homogenize.laws.protocol.MembraneLaw` that the Newton solver needs. Symmetric
tensors are triples (11, 12, 22), the leading axis is the point; line loads and stiffnesses are in N/mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from homogenize import Response
from rve.common.types import Array


class ElasticLaw(Protocol):
    """Energy, stress and tangent at a strain: all that `macro_fem.solvers.newton` asks of a law."""

    def response(self, E: Array) -> Response:
        """Energy, stress and tangent of the elastic law at E (n, 3)."""
        ...


@dataclass(frozen=True)
class NeoHookeanSheet:
    """Incompressible neo-Hookean sheet in plane stress, W = mu/2 (tr C + 1/det C - 3) with C = I + 2E.

    mu: shear modulus times thickness, N/mm. The law resists compression, so its energy is not convex in the
    displacement: Newton finds a stationary state near its start.

    >>> law = NeoHookeanSheet(mu=2.0)
    >>> stretch = 1.5
    >>> E = 0.5 * np.array([[stretch**2 - 1.0, 0.0, 1.0 / stretch - 1.0]])  # free to contract
    >>> S = law.response(E).S[0]
    >>> bool(np.isclose(S[0] * stretch, 2.0 * (stretch - stretch**-2))), bool(abs(S[2]) < 1e-12)
    (True, True)
    """

    mu: float = 1.0

    def response(self, E: Array) -> Response:
        """S = mu (I - C^-1 / det C) and its derivative, in components of the cofactor of C."""
        a, b, c = 1.0 + 2.0 * E[:, 0], 2.0 * E[:, 1], 1.0 + 2.0 * E[:, 2]
        inverse = 1.0 / (a * c - b * b)
        once = self.mu * inverse * inverse
        four = 4.0 * once * inverse
        S = np.empty((3, len(a)))
        np.subtract(self.mu, once * c, out=S[0])
        np.multiply(once, b, out=S[1])
        np.subtract(self.mu, once * a, out=S[2])
        # d(det C) = (c, -2b, a) . dC for dC = 2 dE; S = mu (1, 0, 1) - once (c, -b, a).
        C = np.empty((3, 3, len(a)))
        fa, fb, fc = four * a, four * b, four * c
        np.multiply(fc, c, out=C[0, 0])
        np.multiply(fa, a, out=C[2, 2])
        np.multiply(fa, c, out=C[0, 2])
        C[0, 2] -= 2.0 * once
        C[2, 0] = C[0, 2]
        np.multiply(fc, -b, out=C[1, 0])
        np.multiply(fa, -b, out=C[1, 2])
        np.multiply(C[1, 0], 2.0, out=C[0, 1])
        np.multiply(C[1, 2], 2.0, out=C[2, 1])
        np.multiply(fb, 2.0 * b, out=C[1, 1])
        C[1, 1] += 2.0 * once
        energy = (0.5 * self.mu) * (a + c + inverse - 3.0)
        return Response(energy, S.T, np.moveaxis(C, -1, 0), E)


@dataclass(frozen=True)
class TensionFieldSheet:
    """Isotropic linear sheet that bears no compression: taut, wrinkled or slack (Mansfield's tension field).

    young: Young's modulus times thickness, N/mm; poisson in [0, 1). The energy is the relaxed one: convex, and in the
    wrinkled state young/2 times the square of the larger principal strain.

    >>> law = TensionFieldSheet(young=2.0, poisson=0.25)
    >>> S = law.response(np.array([[0.01, 0.0, -0.02], [-0.01, 0.0, -0.02]])).S  # pulled along x; slack
    >>> bool(np.allclose(S, [[0.02, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    True
    """

    young: float
    poisson: float

    @property
    def compliance(self) -> Array:
        """(3, 3) in tensor components, mm/N: E - E* = compliance S with the wrinkle strain E* <= 0."""
        return np.asarray(np.linalg.inv(self._plane()))

    def _plane(self) -> Array:
        nu = self.poisson
        stiffness = np.array([[1.0, 0.0, nu], [0.0, 1.0 - nu, 0.0], [nu, 0.0, 1.0]])
        return self.young / (1.0 - nu**2) * stiffness

    def response(self, E: Array) -> Response:
        """State by state: plane stress if e2 + poisson e1 > 0, uniaxial tension if only e1 > 0, nothing otherwise."""
        mean, half, shear = 0.5 * (E[:, 0] + E[:, 2]), 0.5 * (E[:, 0] - E[:, 2]), E[:, 1]
        radius = np.hypot(half, shear)
        e1, e2 = mean + radius, mean - radius
        is_taut = e2 + self.poisson * e1 > 0.0
        is_wrinkled = ~is_taut & (e1 > 0.0)
        plane = self._plane()
        # N = n n^T of the larger principal strain, T = sym(n m^T) with m across; a sheet with e1 = e2 is taut or slack,
        # so that the radius is not zero where it divides.
        safe = np.where(radius > 0.0, radius, 1.0)
        cos, sin = half / safe, shear / safe
        N = 0.5 * np.stack([1.0 + cos, sin, 1.0 - cos])
        T = 0.5 * np.stack([-sin, cos, sin])
        weight = np.array([1.0, 2.0, 1.0])
        turn = np.maximum(e1, 0.0) / safe
        C = N[:, None] * N[None] + turn * T[:, None] * T[None]
        C = np.where(is_wrinkled, self.young, 0.0) * C * weight[:, None]
        C += np.where(is_taut, 1.0, 0.0) * plane[:, :, None]
        S = np.where(is_taut[:, None], E @ plane.T, 0.0) + (self.young * np.where(is_wrinkled, e1, 0.0) * N).T
        energy = 0.5 * (S[:, 0] * E[:, 0] + 2.0 * S[:, 1] * E[:, 1] + S[:, 2] * E[:, 2])
        return Response(energy, S, np.moveaxis(C, -1, 0), E - S @ self.compliance.T)
