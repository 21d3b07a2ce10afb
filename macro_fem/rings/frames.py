"""How the rings of a cell are turned with the curtain: frames from the polar decomposition of its deformation gradient.

F is 2 x 2 in a plane curtain and 3 x 2 in space, F = R U with the stretch U. In space the columns of R are the images
of the sheet's own axes, orthogonal, and their cross product is the normal of the sheet. In the plane R is the nearest
rotation, which never turns a cell over.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from macro_fem.fem.cells import mean_at_corners, signed_areas
from macro_fem.rings.curtain import Curtain
from rve import deformation_gradient
from rve.common.types import Array

NARROW = 1e-3
"""A triangle drawn together to less than this part of its length takes its normal from its neighbours."""


def deformation(curtain: Curtain) -> Array:
    """Deformation gradient (t, d, 2) of every triangle, in the axes of the curtain; d = 2 in the plane, 3 in space."""
    before, after = curtain.X[curtain.triangles], curtain.x[curtain.triangles]
    dX = np.stack([before[:, 1] - before[:, 0], before[:, 2] - before[:, 0]], axis=2)
    dx = np.stack([after[:, 1] - after[:, 0], after[:, 2] - after[:, 0]], axis=2)
    return np.asarray(dx @ np.linalg.inv(dX))


def rotation_angle(F: Array) -> Array:
    """Angle (n,) of the rotation nearest to F (n, 2, 2): tan = (F21 - F12) / (F11 + F22)."""
    return np.arctan2(F[:, 1, 0] - F[:, 0, 1], F[:, 0, 0] + F[:, 1, 1])


def turns(curtain: Curtain, triangle: NDArray[np.intp], E: Array, axes: Array) -> Array:
    """Matrices (n, 3, 3) that carry poses of strain E (n, 3), in the weave's axes and the frame of the rotation rule
    (5), into the axes of the curtain, along with the triangles (n,).

    axes (2, 2) leads from the weave to the curtain; where it is a reflection, so are the matrices.
    """
    to_curtain = in_space(axes)
    return np.asarray(
        to_curtain
        @ _frames(curtain, triangle, axes)
        @ about_normal(rotation_angle(deformation_gradient(E))).transpose(0, 2, 1)
    )


def in_space(plane: Array) -> Array:
    """A matrix (2, 2) of the plane as one of space (3, 3) that leaves the normal alone."""
    full = np.eye(3)
    full[:2, :2] = plane
    return full


def about_normal(angle: Array) -> Array:
    """Rotations (n, 3, 3) about the third axis by angles (n,)."""
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.stack([np.stack([c, -s, zero], 1), np.stack([s, c, zero], 1), np.stack([zero, zero, one], 1)], 1)


def _frames(curtain: Curtain, triangle: NDArray[np.intp], axes: Array) -> Array:
    """Rotations R (n, 3, 3) of the triangles, seen from the weave's axes."""
    F = deformation(curtain)
    if F.shape[1] == 2:
        return about_normal(rotation_angle(axes.T @ F[triangle] @ axes))
    R = polar(F, _normals(curtain))[triangle]
    first_two = in_space(axes).T @ R @ axes
    return np.concatenate([first_two, np.cross(first_two[:, :, 0], first_two[:, :, 1])[:, :, None]], axis=2)


def polar(F: Array, normal: Array) -> Array:
    """The matrices R (n, 3, 2) with orthonormal columns nearest to F (n, 3, 2).

    Where F is narrower than `NARROW` the second direction of R is not its own: there R is normal to `normal` (n, 3).

    >>> R = polar(np.array([[[0.0, 0.0], [2.0, 0.0], [0.0, 3.0]]]), np.array([[1.0, 0.0, 0.0]]))
    >>> np.abs(np.round(R[0], 12)).tolist()
    [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
    """
    U, size, Vt = np.linalg.svd(F, full_matrices=False)
    narrow = np.flatnonzero(size[:, 1] <= NARROW * size[:, 0])
    if len(narrow):
        u = U[narrow, :, 0]
        second = np.cross(normal[narrow], u) * np.linalg.det(Vt[narrow])[:, None]
        length = np.linalg.norm(second, axis=1)
        along = length <= 1e-9  # the neighbours' normal is along the line: any direction across it will do
        if along.any():
            second[along] = np.cross(u[along], np.eye(3)[np.argmin(np.abs(u[along]), axis=1)])
            length[along] = np.linalg.norm(second[along], axis=1)
        U[narrow, :, 1] = second / length[:, None]
    return np.asarray(U @ Vt)


def _normals(curtain: Curtain) -> Array:
    """Normals (t, 3) of the triangles, averaged over their neighbours by the area of the triangles."""
    corners = curtain.x[curtain.triangles]
    own = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    own *= np.sign(signed_areas(curtain.X[curtain.triangles]))[:, None]
    each = np.repeat(own[:, None], 3, axis=1)
    around = mean_at_corners(curtain.triangles, each)[curtain.triangles].mean(axis=1)
    return np.asarray(around / np.maximum(np.linalg.norm(around, axis=1, keepdims=True), 1e-300))
