"""From a solved curtain to its rings: a curtain in memory or in files in, a `RingField` out.

The weave's lattice has its origin at the middle of the curtain, so that a symmetric curtain gets symmetric rings. A
ring goes to the deformed place x(X) of its lattice point and tilts as in the localized pose of the cell that it lies
in, turned with the curtain: by R of the polar decomposition F = R U of the deformation gradient. In the plane R is the
nearest rotation, which never turns a cell over. In space F is 3 x 2, the columns of R are the images of the sheet's own
axes, orthogonal, and their cross product is the normal of the sheet.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import rve
from macro_fem.fem.cells import mean_at_corners, signed_areas
from macro_fem.judged import Disks, Nearby
from macro_fem.output.pictures import Pictures
from macro_fem.rings.curtain import Curtain, Sites, curtain_file, read_curtain
from macro_fem.rings.field import RECORD, RingField, WorstCell
from rve.common import Array, Index, InputError, JsonObject, check_out_job, checked, read_entry, tell
from rve.common.tensor import WEIGHT, double_dot
from rve.geometry import cauchy_of, deformation_gradient, padded
from rve.placed import (
    NearestPoses,
    axes_of_weave,
    cell_forces,
    fit_rings,
    largest_forces,
    locked_arrangements,
    nearest_poses,
    offsets,
    reference_shares,
)

NARROW = 1e-3
"""A triangle drawn together to less than this part of its length takes its normal from its neighbours."""


@checked
def localize(
    curtain: Curtain | str | Path, window: tuple[float, ...] | None = None, max_rings: int = 100_000
) -> RingField:
    """Every ring of a solved curtain, or those in a window x0, y0, x1, y1 (mm, before deformation): place, tilt, gaps,
    links and contact forces.

    `curtain`: that of an answer (`answer.rings()` calls this), or the folder that `macro_fem run` wrote, or its
    curtain.vtu. max_rings: more are refused, because their files grow by 0.5 kB each. InputError in one sentence for
    files that are no curtain or not of one run, unknown rings, a window that is no rectangle or has no rings, or too
    many of them. NotConverged if no locked state is found.
    """
    began = time.perf_counter()
    window = read_entry({"window": window}, "window", tuple[float, float, float, float] | None)
    if window is not None and not (np.isfinite(window).all() and window[0] < window[2] and window[1] < window[3]):
        raise InputError(f"window = {window}: must be x0, y0, x1, y1 in mm with x0 < x1 and y0 < y1")
    curtain = curtain if isinstance(curtain, Curtain) else read_curtain(curtain)
    info = curtain.told.info(curtain.source)
    cell = info.cell()
    locked = locked_arrangements(cell, sides_mm=info.sides_mm)
    axes = axes_of_weave(cell, curtain.told.hang_deg)
    tell("rings in their cells")
    sites = find_sites(curtain, cell, locked.sides, axes, window)
    if not len(sites.X):
        where = "" if window is None else f"--window = {','.join(f'{x:g}' for x in window)}: "
        raise InputError(f"{where}not one ring of {curtain.source} lies there")
    if len(sites.X) > max_rings:
        what = f"{len(sites.X)} rings are more than --max-rings = {max_rings}"
        raise InputError(f"{curtain.source}: {what}; ask for a --window")

    used, row = np.unique(sites.triangle, return_inverse=True)
    S = in_weave(over_a_cell(curtain, used, cell.r1**2 * float(np.prod(locked.sides))), axes)
    states = nearest_poses(in_weave(curtain.E[used], axes), cell, locked)
    work, own = S * WEIGHT @ locked.E.T, double_dot(S, states.E)
    # S loads the rings where it does most work; poses may be slack across it, or of a triangle that bears another S
    taut = np.where((own > work.max(axis=1))[:, None], states.E, locked.E[work.argmax(axis=1)])
    loads = cauchy_of(S, taut)
    tell(f"{len(sites.X)} rings in their places")
    centre, normal = place_rings(curtain, sites, states, row, cell, axes)
    tell(f"contact forces of {len(used)} cells")
    force = largest_forces(loads, cell)[row, sites.index[:, 0]]
    most = int(np.argmax(curtain.line_load[used]))
    turn = turns(curtain, used[[most]], taut[[most]], axes)[0]
    worst = WorstCell(int(used[most]), str(states.status[most]), cell_forces(loads[most], cell), turn)
    fit = fit_rings(sites.index, centre, normal, cell)
    wall_s = round(time.perf_counter() - began, 3)
    return RingField(curtain, cell, sites, centre, normal, states, row, fit, force, worst, wall_s)


def run_localize(path: Path, out: Path, window: tuple[float, ...] | None, max_rings: int, **files: Any) -> JsonObject:
    """`localize` and `RingField.save` into `out`, `files` as there; the summary. What the picture needs and what `out`
    would overwrite is checked before anything is solved."""
    inputs = [curtain_file(path)]
    Pictures(files["picture"] or files["render"], html=files["html"], stem="rings").check(in_space=True)
    check_out_job(out, RECORD, inputs)
    return localize(path, window, max_rings).save(out, inputs=inputs, **files)


def over_a_cell(curtain: Curtain, triangles: Index, area: float) -> Array:
    """S (n, 3) in triangles (n,) of a curtain, the mean over the `area` (mm2) of a cell of the weave around those that
    are smaller: beside held points S grows with every refinement, what rings take does not."""
    disks, S = Disks(curtain.X, curtain.triangles, area), curtain.S[triangles]
    near = Nearby(disks, curtain.S, curtain.line_load)
    for k in np.flatnonzero(np.abs(signed_areas(disks.corners[triangles])) < area):
        S[k] = near.mean(disks.middle[triangles[k]])
    return S


def in_weave(triples: Array, axes: Array) -> Array:
    """Tensors (n, 3) of the curtain in the weave's own axes; `axes` (2, 2) leads from the weave to the curtain."""
    turned = axes.T @ triples[:, [[0, 1], [1, 2]]] @ axes
    return np.stack([turned[:, 0, 0], turned[:, 0, 1], turned[:, 1, 1]], axis=1)


def find_sites(
    curtain: Curtain, cell: rve.Cell, sides: tuple[float, float], axes: Array, window: tuple[float, ...] | None = None
) -> Sites:
    """Lattice points of all classes inside the undeformed curtain, or inside a window x0, y0, x1, y1 of it.

    sides: b_x, b_y in r1 in the weave's own axes. A point on the edge of two triangles belongs to one of them.
    """
    from shapely import STRtree, points, polygons

    middle, step = 0.5 * (curtain.X.min(axis=0) + curtain.X.max(axis=0)), cell.r1 * np.array(sides)
    # axes is orthogonal, so that it is its own inverse from the right
    corners, shares = ((curtain.X - middle) @ axes / step)[curtain.triangles], reference_shares(cell)
    low = np.floor(corners.min(axis=(0, 1)) - shares.max(axis=0)).astype(int)
    high = np.ceil(corners.max(axis=(0, 1)) - shares.min(axis=0)).astype(int) + 1
    ranges = np.arange(len(shares)), *map(np.arange, low, high)
    index = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 3)
    place = index[:, 1:] + shares[index[:, 0]]
    found = STRtree(polygons(corners)).query(points(place), predicate="dwithin", distance=1e-9)
    ring, triangle = found[:, np.lexsort(found[::-1])]
    ring, first = np.unique(ring, return_index=True)
    sites = Sites(index[ring], (place[ring] * step) @ axes.T + middle, triangle[first])
    if window is None:
        return sites
    x0, y0, x1, y1 = window
    x, y = sites.X.T
    return sites.take((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1))


def place_rings(
    curtain: Curtain, sites: Sites, states: NearestPoses, row: Index, cell: rve.Cell, axes: Array
) -> tuple[Array, Array]:
    """Centres (n, 3) in mm and unit normals (n, 3) of the rings of the sites, in the axes of the curtain; row (n,) is
    the pose of each in `states`, in weave axes."""
    turn, ring = turns(curtain, sites.triangle, states.E[row], axes), sites.index[:, 0]
    corner = curtain.triangles[sites.triangle, 0]
    away = np.einsum("nxX,nX->nx", curtain.F[sites.triangle], sites.X - curtain.X[corner])
    centre = padded(curtain.x[corner] + away) + np.einsum("nxy,ny->nx", turn, offsets(states.pose, cell)[row, ring])
    return centre, np.einsum("nxy,ny->nx", turn, states.pose.normals[row, ring])


def turns(curtain: Curtain, triangle: Index, E: Array, axes: Array) -> Array:
    """Matrices (n, 3, 3) that carry poses of strain E (n, 3), in the weave's axes and the frame of the rotation rule
    (5), into the axes of the curtain, along with the triangles (n,).

    axes (2, 2) leads from the weave to the curtain; where it is a reflection, so are the matrices.
    """
    F, to_curtain = curtain.F, np.eye(3)
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
    own = np.abs(signed_areas(curtain.X[curtain.triangles]))[:, None] * np.cross(curtain.F[:, :, 0], curtain.F[:, :, 1])
    around = mean_at_corners(curtain.triangles, own)[curtain.triangles].mean(axis=1)
    return np.asarray(around / np.maximum(np.linalg.norm(around, axis=1, keepdims=True), 1e-300))
