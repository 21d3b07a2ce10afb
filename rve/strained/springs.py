"""Springs that pull a cell towards a given strain and, far more weakly, its rings towards a given arrangement.

They replace the line load in the equations. With lengths in r1 and D = E - E* the potential is

    W = 1/2 |D+|^2 fold + 1/2 |D-|^2 + 1/2 weak (sum |c_k - c_k*|^2 + sum |n_k - n_k*|^2),

D+, D-: excess and deficit relative to the target strain, D = D+ - D-, both positive semidefinite. Without contacts the
strain is E* and the rings are as in the given arrangement. With contacts the interior-point method finds the admissible
pose of least W: nearest in strain first, because `weak` is small.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rve.common.tensor import WEIGHT
from rve.common.types import Array
from rve.equilibrium.system import add_lattice_curvature
from rve.geometry.circles import cross, dot, tangent_frame
from rve.geometry.kinematics import lattice_strain
from rve.geometry.pose import Pose


@dataclass(frozen=True)
class Spring:
    """Springs of a weave with reference sides b_x, b_y (in r1); `fold` and `weak` as in the header.

    Rows of its load hold the strain E* (3), then for every class but the first the shares (i, j) of the lattice vectors
    in its centre, then the normal of every class (3 each).
    """

    sides: tuple[float, float]
    fold: float = 1.0
    weak: float = 1e-5

    def force(self, pose: Pose, T: Array, s: Array) -> tuple[Array, Array]:
        """See rve.equilibrium.system.CellLoad."""
        n, k = pose.normals.shape[:2]
        f, J = np.zeros((n, T.shape[2])), np.zeros((n, T.shape[2], T.shape[2]))
        self._strain_part(pose, s[:, :3], f, J)
        shares = s[:, 3 : 2 * k + 1].reshape(n, k - 1, 2)
        self._centre_part(pose, T, shares, f, J)
        self._tilt_part(pose, s[:, 2 * k + 1 :].reshape(n, k, 3), f, J)
        return f, J

    def size(self, f: Array, M: Array) -> Array:
        """See rve.equilibrium.system.CellLoad: residuals are measured against one unit of spring force."""
        return np.ones(len(f))

    def _strain_part(self, pose: Pose, target: Array, f: Array, J: Array) -> None:
        E, dE, ddE = lattice_strain(pose.lattice, self.sides)
        g, H = split_response(E - target, self.fold)
        f[:, :3] -= np.einsum("ni,nix->nx", WEIGHT * g, dE)
        stiffness = np.matmul(np.matmul(dE.transpose(0, 2, 1), WEIGHT[:, None] * H), dE)
        J[:, :3, :3] -= stiffness + np.einsum("ni,nixy->nxy", WEIGHT * g, ddE)

    def _centre_part(self, pose: Pose, T: Array, shares: Array, f: Array, J: Array) -> None:
        for ring in range(shares.shape[1]):
            i, j = shares[:, ring, :1], shares[:, ring, 1:]
            delta = pose.centres[:, ring + 1] - i * pose.a1 - j * pose.a2
            B = -(i[..., None] * T[:, 0:2] + j[..., None] * T[:, 2:4])
            rows = slice(3 + 2 * ring, 5 + 2 * ring)
            B[:, :, rows] += np.eye(2)
            f -= self.weak * np.einsum("ni,nix->nx", delta, B)
            J -= self.weak * np.matmul(B.transpose(0, 2, 1), B)
            add_lattice_curvature(J, self.weak * np.concatenate([i * delta, j * delta], axis=1))

    def _tilt_part(self, pose: Pose, target: Array, f: Array, J: Array) -> None:
        k = pose.normals.shape[1]
        e1, e2 = tangent_frame(pose.normals)
        along = dot(pose.normals, target)
        for ring in range(k):
            for axis, e in ((0, e1), (1, e2)):
                column = 2 * k + 1 + 2 * ring + axis
                f[:, column] += self.weak * dot(cross(e[:, ring], pose.normals[:, ring]), target[:, ring])
                J[:, column, column] -= self.weak * along[:, ring]


def split_response(D: Array, fold: float) -> tuple[Array, Array]:
    """Gradient (n, 3) of fold/2 |D+|^2 + 1/2 |D-|^2 with respect to the tensor D, and its derivative (n, 3, 3).

    Both in tensor components, D = triples (11, 12, 22); principal values > 0 of D weigh `fold`, the others 1.
    """
    mean, half = 0.5 * (D[:, 0] + D[:, 2]), 0.5 * (D[:, 0] - D[:, 2])
    radius = np.hypot(half, D[:, 1])
    safe = np.maximum(radius, 1e-300)
    c, s = np.where(radius > 0.0, half / safe, 1.0), np.where(radius > 0.0, D[:, 1] / safe, 0.0)
    d1, d2 = mean + radius, mean - radius
    w1, w2 = np.where(d1 > 0.0, fold, 1.0), np.where(d2 > 0.0, fold, 1.0)
    P1 = 0.5 * np.stack([1.0 + c, s, 1.0 - c], axis=1)
    P2 = 0.5 * np.stack([1.0 - c, -s, 1.0 + c], axis=1)
    Q = np.stack([-s, c, s], axis=1) / np.sqrt(2.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        shear = np.where(radius > 1e-14, (w1 * d1 - w2 * d2) / (2.0 * radius), 0.5 * (w1 + w2))
    gradient = (w1 * d1)[:, None] * P1 + (w2 * d2)[:, None] * P2
    H = sum((w[:, None, None] * P[:, :, None]) * (WEIGHT * P)[:, None, :] for w, P in ((w1, P1), (w2, P2), (shear, Q)))
    return gradient, np.asarray(H)
