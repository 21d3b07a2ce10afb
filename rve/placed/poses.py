"""The admissible pose of the cell at a given strain that is nearest to the locked poses.

Offset and tilts of the rings are as near as contacts allow to an arrangement q*(E*) that is interpolated between locked
states (Shepard, weights 1/distance^4 in strain). Springs replace the line load in the equations of `equilibrium`, with
the potential (lengths in r1, D = E - E* = D+ - D-, both positive semidefinite)

    W = 1/2 |D+|^2 fold + 1/2 |D-|^2 + 1/2 weak (sum |c_k - c_k*|^2 + sum |n_k - n_k*|^2).

Gaps stay positive and links intact in every iterate, so that every pose is admissible, converged or not.

The rings cannot always have the strain E*. It may lie outside what rings reach in tension, because the law has an error
or is elastic: `short`. And a curtain may be drawn together further than rings can be in a plane. There it hangs in
folds, E* = E - fold with a positive semidefinite fold, and the flat pose E with the least fold is given: `fold`.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rve.common import Array, ByValue, Flags, NotConverged, Rows, checked, part_of
from rve.common.tensor import WEIGHT, dyad, eigenvalues
from rve.directions import product
from rve.geometry.cell import Cell, weave_sides
from rve.geometry.kinematics import lattice_strain
from rve.geometry.pattern import padded
from rve.geometry.pose import Pose, mirrored
from rve.geometry.ring_pair import cross, dot, tangent_frame
from rve.locking.dead_load import DeadLoad
from rve.locking.interior_point import DirectOptions, solve_equilibrium
from rve.locking.system import Equations, add_lattice_curvature
from rve.placed.fit import shares
from rve.solve import locked_block, reference_sides

_BLOCK = 2048
"""Strains solved together: larger blocks take more memory, smaller ones more time."""
POSE_MEANINGS = {
    "met": "the rings have the strain of the curtain, within the tolerance",
    "beyond": "the curtain is stretched further than rigid rings reach; the nearest pose is drawn",
    "folded": "the curtain is drawn together further than rings can be in a plane; it hangs in folds there",
    "stalled": "the springs did not settle; an admissible pose from on the way is drawn",
}
"""Statuses of poses, and what they mean."""


@dataclass(frozen=True)
class PoseOptions:
    """Numbers of the nearest poses.

    tolerance: strain by which a pose with status "met" may miss its target; the error of laws is 4e-4. alpha_deg,
    beta_deg: loads of the locked states that arrangements are interpolated between; more take time once a curtain.
    stages: each from the pose of the one before, weights of a fold and of the arrangement relative to a deficit of
    strain, first and last complementarity. Stiff springs come first: with weak ones, or fewer stages, some cells lock.
    """

    tolerance: float = 1e-3
    alpha_deg: tuple[float, ...] = (-45.0, -30.0, -15.0, 0.0, 15.0, 30.0)
    beta_deg: tuple[float, ...] = (2.0, 10.0, 20.0, 30.0, 45.0, 60.0, 70.0, 80.0, 88.0)
    stages: tuple[tuple[float, float, float, float], ...] = (
        (1e-2, 3e-1, 3e-2, 1e-3),
        (1e-2, 1e-2, 1e-3, 1e-5),
        (1e-2, 1e-4, 1e-5, 1e-7),
        (1e-3, 1e-5, 1e-7, 1e-9),
        (1e-3, 1e-6, 1e-9, 1e-11),
    )


OPTIONS = PoseOptions()


@dataclass(frozen=True, eq=False)
class LockedArrangements(ByValue):
    """Locked poses of a cell, their strains E (m, 3), and the reference sides in r1 of the strain, in weave axes."""

    pose: Pose
    E: Array
    sides: tuple[float, float]

    def arrangement(self, E: Array) -> Array:
        """Rows (n, 3 + 3 (K - 1) + 3 K) of springs that pull to strains E (n, 3) and the arrangement at them: E*, the
        shares (i, j) of the lattice vectors and the height of every class but the first, the normal of every class."""
        square = (self.E[None] - E[:, None]) ** 2 @ WEIGHT
        weight = 1.0 / (square + 1e-16) ** 2
        weight /= weight.sum(axis=1, keepdims=True)
        place = np.concatenate([shares(self.pose), padded(self.pose.centres)[..., 2:]], axis=2)
        share = np.einsum("nm,mkx->nkx", weight, place[:, 1:])
        normal = np.einsum("nm,mkx->nkx", weight, self.pose.normals)
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
        return np.concatenate([E, share.reshape(len(E), -1), normal.reshape(len(E), -1)], axis=1)


@dataclass(frozen=True, eq=False)
class NearestPoses(Rows):
    """Admissible poses at n strains, in weave axes.

    pose: in units of r1; E (n, 3): the strain of the rings; short, fold (n,): what they lack of the target and what
    they have beyond it, largest principal value of each; gap_mm (n,): smallest gap, >= 0; status (n,): `POSE_MEANINGS`.
    """

    pose: Pose
    E: Array
    short: Array
    fold: Array
    gap_mm: Array
    status: NDArray[np.str_]
    solves: int


@checked
def locked_arrangements(
    cell: Cell, options: PoseOptions = OPTIONS, sides_mm: tuple[float, float] | None = None
) -> LockedArrangements:
    """Locked states under loads in all directions, to interpolate between; NotConverged if none is found.

    sides_mm: b_x, b_y of the reference cell that strains refer to; by default that of rings side by side.
    """
    loads = product(np.array(options.alpha_deg), np.array(options.beta_deg))
    equilibrium = locked_block(*loads, replace(cell, grain="y"), DirectOptions()).found
    good = np.flatnonzero(equilibrium.status == "converged")
    if not len(good):
        raise NotConverged(f"r1 = {cell.r1:g}, r2 = {cell.r2:g}: no locked state was found to compare the rings with")
    sides = weave_sides(cell, reference_sides(cell, DirectOptions()) if sides_mm is None else sides_mm)
    pose = equilibrium.pose.take(good)
    return LockedArrangements(pose, lattice_strain(pose.lattice, sides)[0], sides)


@checked
def nearest_poses(
    E: Array, cell: Cell, states: LockedArrangements | None = None, options: PoseOptions = OPTIONS
) -> NearestPoses:
    """Admissible poses of the cell nearest to the strains E (n, 3), in weave axes; states: as of `locked_arrangements`.

    >>> poses = nearest_poses(np.array([[0.0, 0.0, 0.0], [0.75, 0.0, -0.5]]), Cell())
    >>> poses.status.tolist(), bool(poses.gap_mm.min() >= 0.0)
    (['met', 'folded'], True)
    """
    states = states or locked_arrangements(cell, options)
    E = np.asarray(E, dtype=float).reshape(-1, 3)
    # A symmetric curtain has every strain twice: a mirrored weave is solved for E12 >= 0 only.
    flip = (E[:, 1] < 0.0) & cell.weave.has_images
    upright = np.where(flip[:, None], E * np.array([1.0, -1.0, 1.0]), E)
    _, first, back = np.unique(np.round(upright, 6), axis=0, return_index=True, return_inverse=True)
    targets = upright[first]
    blocks = []
    for i in range(0, len(targets), _BLOCK):
        with part_of(f"rings in strain {i + 1} of {len(targets)}"):
            blocks.append(_follow_stages(targets[i : i + _BLOCK], cell, states, options))
    poses, gaps, flags = zip(*blocks, strict=True)
    pose, gap, is_settled = poses[0].join(poses[1:]), np.concatenate(gaps), np.concatenate(flags)
    rings = lattice_strain(pose.lattice, states.sides)[0]
    low, high = eigenvalues(rings - targets)
    short, fold = np.maximum(-low, 0.0), np.maximum(high, 0.0)
    far = np.where(fold > options.tolerance, "folded", "beyond")
    is_met = np.maximum(short, fold) <= options.tolerance
    status = np.where(is_met, "met", np.where(is_settled, far, "stalled"))
    out = NearestPoses(pose, rings, short, fold, cell.r1 * gap, status, len(targets)).take(back.ravel())
    rows = np.flatnonzero(flip)
    if not len(rows):
        return out
    out.E[rows, 1] *= -1.0
    return replace(out, pose=out.pose.put(rows, mirrored(out.pose.take(rows), cell.weave)))


def _follow_stages(E: Array, cell: Cell, states: LockedArrangements, options: PoseOptions) -> tuple[Pose, Array, Flags]:
    """Poses of a block of strains, their smallest gaps, and whether one of the last three stages has converged.

    At the limit of admissible strains the end of the path may be degenerate. A stage that stalls keeps its start.
    """
    rows, count = states.arrangement(E), len(options.stages)
    start, good = None, np.zeros(len(E), dtype=bool)
    for stage, (fold, weak, first, last) in enumerate(options.stages):
        springs = Spring(states.sides, fold, weak)
        equations = replace(Equations.of(cell.weave, cell.wire, load=springs), is_relative=False)
        quick = DirectOptions(tolerance=max(last, 1e-9), mu_start=first, mu_end=last, attempts=1, max_iterations=50)
        with part_of(f"stage {stage + 1} of {count}"):
            end = solve_equilibrium(rows, equations, quick, start)
        start = end.pose
        if stage >= count - 3:
            good |= end.status == "converged"
    return end.pose, equations.contacts(end.pose).min_gap, good


@dataclass(frozen=True)
class Spring:
    """Springs of a weave with reference sides b_x, b_y (in r1); `fold` and `weak` as in the header of the module. Rows
    of its load are those of `LockedArrangements.arrangement`."""

    sides: tuple[float, float]
    fold: float = 1.0
    weak: float = 1e-5

    def __call__(self, pose: Pose, T: Array, s: Array) -> tuple[Array, Array]:
        """The `rve.locking.system.Force`."""
        n, k, dims = pose.centres.shape
        E, dE = lattice_strain(pose.lattice, self.sides)
        g, H = split_response(E - s[:, :3], self.fold)
        f, J = DeadLoad(self.sides)(pose, T, -g / np.prod(self.sides))
        J[:, :3, :3] -= np.matmul(np.matmul(dE.transpose(0, 2, 1), WEIGHT[:, None] * H), dE)
        for ring in range(k - 1):
            i, j, height = (s[:, 3 + 3 * ring + axis, None] for axis in range(3))
            start = np.concatenate([i * pose.a1 + j * pose.a2, height], axis=1)
            delta = pose.centres[:, ring + 1] - start[:, :dims]
            B = np.zeros((n, dims, T.shape[2]))
            B[:, :2] = -(i[..., None] * T[:, 0:2] + j[..., None] * T[:, 2:4])
            B[:, :, 3 + dims * ring : 3 + dims * (ring + 1)] += np.eye(dims)
            f -= self.weak * np.einsum("ni,nix->nx", delta, B)
            J -= self.weak * np.matmul(B.transpose(0, 2, 1), B)
            add_lattice_curvature(J, self.weak * np.concatenate([i * delta[:, :2], j * delta[:, :2]], axis=1))
        target = s[:, 3 * k :].reshape(n, k, 3)
        along, diagonal = dot(pose.normals, target), np.einsum("nii->ni", J)
        for axis, e in enumerate(tangent_frame(pose.normals)):
            columns = slice(T.shape[2] - 2 * k + axis, None, 2)
            f[:, columns] += self.weak * dot(cross(e, pose.normals), target)
            diagonal[:, columns] -= self.weak * along
        return f, J


def split_response(D: Array, fold: float) -> tuple[Array, Array]:
    """Gradient (n, 3) of fold/2 |D+|^2 + 1/2 |D-|^2 with respect to the tensor D, and its derivative (n, 3, 3).

    Both in tensor components, D = triples (11, 12, 22); principal values > 0 of D weigh `fold`, the others 1.
    """
    values, vectors = np.linalg.eigh(D[:, [[0, 1], [1, 2]]])
    v, w = np.swapaxes(vectors, 1, 2), np.where(values > 0.0, fold, 1.0)
    P, Q = dyad(v), dyad(v.sum(axis=1)) - dyad(v[:, 0]) - dyad(v[:, 1])
    apart = values[:, 1] - values[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = (w * values)[:, 1] - (w * values)[:, 0]
        shear = np.where(apart > 1e-14, rate / apart, w.mean(axis=1))
    parts = np.concatenate([P, Q[:, None] / np.sqrt(2.0)], axis=1)
    H = np.einsum("nk,nki,nkj->nij", np.column_stack([w, shear]), parts, WEIGHT * parts)
    return np.einsum("nk,nki->ni", w * values, P), H
