"""Sheets on rectangles and laws with known answers, which the tests of Newton's method compare with.

Symmetric tensors are triples (11, 12, 22), the leading axis is the point; line loads and stiffnesses are in N/mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import skfem

from homogenize import Response
from macro_fem.fem.discretization import discretize
from macro_fem.fem.membrane import evaluate
from macro_fem.fem.supported import SupportedFem
from rve.common.types import Array


def mesh_of(element, width, height, nx, ny):
    """A mesh of nx by ny cells of a rectangle, of quadrilaterals or triangles as the element needs."""
    mesh_type = skfem.MeshQuad if element[0] == "Q" else skfem.MeshTri
    return mesh_type.init_tensor(np.linspace(0, width, nx + 1), np.linspace(0, height, ny + 1))


def rectangle(element, width, height, nx, ny):
    """`mesh_of` as arrays."""
    return discretize(mesh_of(element, width, height, nx, ny), element)


def least_angle(p, t):
    """The smallest angle in degrees of triangles t (n, 3) of points p: the quality of a mesh."""
    edge = np.roll(p[t], -1, axis=1) - p[t]
    back = -np.roll(edge, 1, axis=1)
    cosine = (edge * back).sum(-1) / (np.linalg.norm(edge, axis=-1) * np.linalg.norm(back, axis=-1))
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)).min())


def held(disc, where, d=2):
    """A mask (n_nodes, d) of the nodes for whose coordinates x (2, n_nodes) `where` is true."""
    return np.repeat(where(disc.nodes.T)[:, None], d, axis=1)


def supported(disc, fixed, displacement):
    """The discretisation with the components `fixed` held at a displacement, both (n_nodes, d)."""
    X = np.column_stack([disc.nodes, np.zeros((disc.n_nodes, fixed.shape[1] - 2))])
    return SupportedFem(disc, np.where(fixed, X + displacement, 0.0), ~fixed.ravel())


def reactions(fem, law, u, force):
    """Forces of the supports on the sheet (n_nodes, d)."""
    return np.where(fem.held, evaluate(fem.disc, law, u).internal - force, 0.0)


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
