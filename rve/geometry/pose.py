"""The pose of a periodic cell in units of r1, and its coordinates.

Generalised velocities of K classes: a1 (2), a2 (2), c_1 .. c_{K-1} (2 each), omega_0 .. omega_{K-1} (3 each). Reduced
ones: x2, y3, t = tan gamma; centres; two tilts per ring, 9 for K = 2: the rotation rule (5) has removed one, and the
spin of a torus about its axis is none. Centres have three components where the weave leaves them free across the plane.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from rve.common import Array, Index, Rows
from rve.geometry.kinematics import green_lagrange
from rve.geometry.pattern import Pattern, padded
from rve.geometry.ring_pair import dot, tangent_frame, turned


@dataclass(frozen=True)
class Pose(Rows):
    """Positions of n cells in units of r1: lattice (n, 3) = x2, y3, t; centres (n, K, 2 or 3); normals (n, K, 3)."""

    lattice: Array
    centres: Array
    normals: Array

    @property
    def a1(self) -> Array:
        """First lattice vector (x2, t x2), (n, 2)."""
        return np.stack([self.lattice[:, 0], self.lattice[:, 2] * self.lattice[:, 0]], axis=1)

    @property
    def a2(self) -> Array:
        """Second lattice vector (t y3, y3), (n, 2)."""
        return np.stack([self.lattice[:, 2] * self.lattice[:, 1], self.lattice[:, 1]], axis=1)


def start_pose(weave: Pattern, count: int) -> Pose:
    """The slack pose of largest clearance, `count` times."""
    parts = weave.start_lattice, weave.start_centres, weave.start_normals
    return Pose(*(np.repeat(part[None], count, axis=0) for part in parts))


def moved(pose: Pose, v: Array) -> Pose:
    """The pose after the reduced displacement v (n, m): centres add, normals turn by the exponential map."""
    n, k = pose.normals.shape[:2]
    centres = pose.centres.copy()
    tilts = v.shape[1] - 2 * k
    centres[:, 1:] += v[:, 3:tilts].reshape(centres[:, 1:].shape)
    return Pose(pose.lattice + v[:, :3], centres, turned(pose.normals, v[:, tilts:].reshape(n, k, 2)))


def mirrored(pose: Pose, weave: Pattern) -> Pose:
    """The poses of a mirrored weave seen in its mirror, with the same rings linked; see `Pattern.images`."""
    k, i, j = weave.images.T
    sign = np.sign(dot(weave.start_normals * weave.mirror, weave.start_normals[k]))
    seen = Pose(pose.lattice * [1.0, 1.0, -1.0], pose.centres.copy(), pose.normals.copy())
    seen.normals[:, k] = pose.normals * weave.mirror * sign[:, None]
    shift = i[:, None] * seen.a1[:, None] + j[:, None] * seen.a2[:, None]
    seen.centres[:, k] = pose.centres * weave.mirror[: pose.centres.shape[2]]
    seen.centres[:, k, :2] -= shift
    seen.centres[...] -= seen.centres[:, :1].copy()
    return seen


def tiled(pose: Pose, weave: Pattern) -> Pose:
    """The poses of a cell, of one row of it, or of its primitive cell as poses of `weave`, which has all its cells."""
    times = weave.classes // pose.centres.shape[1]
    ny = min(times, weave.repeat[1])
    cells = [(ix, iy) for iy in range(ny) for ix in range(times // ny)]
    places = [pose.centres[..., :2] + (ix * pose.a1 + iy * pose.a2)[:, None] for ix, iy in cells]
    heights = np.tile(pose.centres[..., 2:], (1, len(cells), 1))
    centres = np.concatenate([np.concatenate(places, axis=1), heights], axis=2)
    centres = padded(centres) if weave.centres == "space" else centres
    return Pose(pose.lattice * [times // ny, ny, 1.0], centres, np.tile(pose.normals, (1, len(cells), 1)))


def deformation(pose: Pose, sides: tuple[float, float]) -> Array:
    """Deformation gradients (n, 2, 2) of the poses, eq. (1), for a reference cell with these sides in r1."""
    return np.stack([pose.a1 / sides[0], pose.a2 / sides[1]], axis=2)


def strain_of(pose: Pose, sides: tuple[float, float]) -> Array:
    """Green-Lagrange strain (n, 3) of the poses, in weave axes, for a reference cell with these sides in r1."""
    return green_lagrange(deformation(pose, sides))


def mirror_modes(weave: Pattern) -> Array:
    """Motions (m, k) that keep the mirror image of the cell, `Pattern.images`: of 4-in-1 both sides, rows along y with
    rings in their share of the cell along x, tilts about x.
    """
    (k, dims), m, (x2, y3, _) = weave.start_centres.shape, weave.coordinates, weave.start_lattice
    tilts = m - 2 * k
    image, sign = np.zeros((m, m)), float(weave.mirror.prod())
    image[[0, 1, 2], [0, 1, 2]] = 1.0, 1.0, -1.0
    place, a1, a2 = np.zeros((k, dims, m)), np.zeros((2, m)), np.zeros((2, m))
    a1[[0, 1], [0, 2]], a2[[1, 0], [1, 2]] = (1.0, -x2), (1.0, -y3)  # at the start, which is upright
    frames = np.stack(tangent_frame(weave.start_normals), axis=2)
    for ring, (other, i, j) in enumerate(weave.images):
        place[other, :2] = -i * a1 - j * a2
        if ring:
            place[other, :, 3 + dims * (ring - 1) : 3 + dims * ring] += np.diag(weave.mirror[:dims])
        turn = slice(tilts + 2 * ring, tilts + 2 * ring + 2), slice(tilts + 2 * other, tilts + 2 * other + 2)
        image[turn[1], turn[0]] = sign * (frames[other].T * weave.mirror) @ frames[ring]
    image[3:tilts] = (place - place[0])[1:].reshape(-1, m)
    kept = 0.5 * (np.eye(m) + image)
    _, sizes, pivot = qr(kept, pivoting=True)
    return np.asarray(kept[:, np.sort(pivot[: np.count_nonzero(np.abs(np.diag(sizes)) > 1e-9)])])


def reduction(pose: Pose) -> Array:
    """Matrix T (n, m_full, m) from reduced to generalised velocities."""
    n, k = pose.normals.shape[:2]
    places = (k - 1) * pose.centres.shape[2]
    T = np.zeros((n, 4 + places + 3 * k, 3 + places + 2 * k))
    x2, y3, t = pose.lattice.T
    T[:, 0, 0], T[:, 1, 0], T[:, 1, 2] = 1.0, t, x2
    T[:, 3, 1], T[:, 2, 1], T[:, 2, 2] = 1.0, t, y3
    T[:, 4 : 4 + places, 3 : 3 + places] = np.eye(places)
    e1, e2 = tangent_frame(pose.normals)
    for i in range(k):
        rows = slice(4 + places + 3 * i, 7 + places + 3 * i)
        T[:, rows, 3 + places + 2 * i] = e1[:, i]
        T[:, rows, 4 + places + 2 * i] = e2[:, i]
    return T


def place_maps(weave: Pattern, rings: Index) -> Array:
    """Matrices (n, 2 or 3, m_full) from generalised velocities to those of the centres of rings (n, 3): class, i, j."""
    k, dims = weave.start_centres.shape
    maps = np.zeros((len(rings), dims, 4 + dims * (k - 1) + 3 * k))
    for own, (ring, i, j) in zip(maps, rings, strict=True):
        own[:2, :2], own[:2, 2:4] = i * np.eye(2), j * np.eye(2)
        if ring > 0:
            own[:, 4 + dims * (ring - 1) : 4 + dims * ring] = np.eye(dims)
    return maps


def turns_of(weave: Pattern, ring: int) -> slice:
    """Where the rotation of a ring is among the generalised velocities."""
    k, dims = weave.start_centres.shape
    first = 4 + dims * (k - 1) + 3 * ring
    return slice(first, first + 3)


def pair_maps(weave: Pattern) -> Array:
    """Matrices L (p, 9, m_full) from generalised velocities to (d, theta_a, theta_b) of each pair of rings."""
    first, there = weave.pairs[:, :1], place_maps(weave, weave.pairs[:, 1:])
    L = np.zeros((len(first), 9, there.shape[2]))
    L[:, : there.shape[1]] = there - place_maps(weave, np.pad(first, ((0, 0), (0, 2))))
    for own, (a, b, _, _) in zip(L, weave.pairs, strict=True):
        own[3:6, turns_of(weave, a)] = own[6:, turns_of(weave, b)] = np.eye(3)
    return L


def pair_geometry(pose: Pose, weave: Pattern) -> tuple[Array, Array, Array]:
    """Offset d and the two normals of every pair, each (n, p, 3)."""
    a, b, i, j = weave.pairs.T
    d = np.zeros((len(pose.lattice), len(weave.pairs), 3))
    d[..., : pose.centres.shape[2]] = pose.centres[:, b] - pose.centres[:, a]
    d[..., :2] += i[:, None] * pose.a1[:, None] + j[:, None] * pose.a2[:, None]
    return d, pose.normals[:, a], pose.normals[:, b]
