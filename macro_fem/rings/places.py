"""Every ring of a curtain: which lattice points lie in it, where its rings go, and how they fit their neighbours.

The weave's lattice has its origin at the middle of the curtain, so that a symmetric curtain gets symmetric rings. A
ring goes to the deformed place x(X) of its lattice point and tilts as in the localized pose of the cell that it lies
in, turned with the curtain: by R of the polar decomposition F = R U of the deformation gradient. In the plane R is the
nearest rotation, which never turns a cell over. In space F is 3 x 2, the columns of R are the images of the sheet's own
axes, orthogonal, and their cross product is the normal of the sheet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from macro_fem.fem.cells import cross, mean_at_corners, padded, signed_areas
from macro_fem.rings.curtain import Curtain
from rve import Cell, NearestPoses, deformation_gradient, offsets, reference_shares
from rve.common import Array, Index, Rows

NARROW = 1e-3
"""A triangle drawn together to less than this part of its length takes its normal from its neighbours."""


@dataclass(frozen=True)
class Sites(Rows):
    """Where rings belong: index (n, 3) = class, i, j; X (n, 2) in mm before; triangle (n,) around them."""

    index: Index
    X: Array
    triangle: Index


def find_sites(
    curtain: Curtain, cell: Cell, sides: tuple[float, float], axes: Array, window: tuple[float, ...] | None = None
) -> Sites:
    """Lattice points of all classes inside the undeformed curtain, or inside a window x0, y0, x1, y1 of it.

    sides: b_x, b_y in r1 in the weave's own axes. A point on the edge of two triangles belongs to one of them.
    """
    middle, step = 0.5 * (curtain.X.min(axis=0) + curtain.X.max(axis=0)), cell.r1 * np.array(sides)
    # axes is orthogonal, so that it is its own inverse from the right
    corners = ((curtain.X - middle) @ axes / step)[curtain.triangles]
    parts = []
    for ring, share in enumerate(reference_shares(cell)):
        triangle, ij = _inside(corners - share)
        index, X = np.column_stack([np.full(len(ij), ring), ij]), ((ij + share) * step) @ axes.T + middle
        parts.append(Sites(index, X, triangle))
    sites = parts[0].join(parts[1:])
    if window is None:
        return sites
    x0, y0, x1, y1 = window
    x, y = sites.X.T
    return sites.take((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1))


def _inside(corners: Array) -> tuple[Index, Index]:
    """Triangle (n,) and whole-number point (n, 2) for all whole-number points in triangles with corners (t, 3, 2); of
    several triangles the first."""
    from shapely import STRtree, points, polygons

    (low_i, low_j), (high_i, high_j) = np.floor(corners.min(axis=(0, 1))), np.ceil(corners.max(axis=(0, 1)))
    i, j = np.meshgrid(np.arange(low_i, high_i + 1), np.arange(low_j, high_j + 1), indexing="ij")
    ij = np.column_stack([i.ravel(), j.ravel()])
    found = STRtree(polygons(corners)).query(points(ij), predicate="dwithin", distance=1e-9)
    point, triangle = found[:, np.lexsort(found[::-1])]
    first = np.unique(point, return_index=True)[1]
    return triangle[first], ij[point[first]].astype(int)


def _barycentric(corners: Array, point: Array) -> Array:
    """Barycentric coordinates (n, 3) of points (n, 2) in triangles (n, 3, 2)."""
    e1, e2, d = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], point - corners[:, 0]
    b, c = cross(d, e2) / cross(e1, e2), cross(e1, d) / cross(e1, e2)
    return np.stack([1.0 - b - c, b, c], axis=1)


def place_rings(
    curtain: Curtain, sites: Sites, states: NearestPoses, row: Index, cell: Cell, axes: Array
) -> tuple[Array, Array]:
    """Centres (n, 3) in mm and unit normals (n, 3) of the rings of the sites, in the axes of the curtain; row (n,) is
    the pose of each in `states`, in weave axes."""
    turn, ring = turns(curtain, sites.triangle, states.E[row], axes), sites.index[:, 0]
    corners = curtain.triangles[sites.triangle]
    centre = np.einsum("nk,nkx->nx", _barycentric(curtain.X[corners], sites.X), padded(curtain.x)[corners])
    centre = centre + np.einsum("nxy,ny->nx", turn[:, :, :2], offsets(states.pose, cell)[row, ring])
    return centre, np.einsum("nxy,ny->nx", turn, states.pose.normals[row, ring])


def turns(curtain: Curtain, triangle: Index, E: Array, axes: Array) -> Array:
    """Matrices (n, 3, 3) that carry poses of strain E (n, 3), in the weave's axes and the frame of the rotation rule
    (5), into the axes of the curtain, along with the triangles (n,).

    axes (2, 2) leads from the weave to the curtain; where it is a reflection, so are the matrices.
    """
    before, after = curtain.X[curtain.triangles], curtain.x[curtain.triangles]
    dX, dx = ((one[:, 1:] - one[:, :1]).transpose(0, 2, 1) for one in (before, after))
    F = np.asarray(dx @ np.linalg.inv(dX))  # the deformation gradient (t, d, 2) in the axes of the curtain
    to_curtain = np.eye(3)
    to_curtain[:2, :2] = axes
    if F.shape[1] == 2:
        frames = about_normal(axes.T @ F[triangle] @ axes)
    else:
        two = to_curtain.T @ polar(F, _normals(curtain))[triangle] @ axes
        frames = np.concatenate([two, np.cross(two[:, :, 0], two[:, :, 1])[:, :, None]], axis=2)
    return np.asarray(to_curtain @ frames @ about_normal(deformation_gradient(E)).transpose(0, 2, 1))


def about_normal(F: Array) -> Array:
    """The rotations (n, 3, 3) about the third axis that are nearest to F (n, 2, 2) in the plane."""
    angle = np.arctan2(F[:, 1, 0] - F[:, 0, 1], F[:, 0, 0] + F[:, 1, 1])
    return np.asarray(Rotation.from_euler("z", angle[:, None]).as_matrix())


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
