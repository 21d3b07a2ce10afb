"""Slack poses: the pose of a pattern in which rings clear each other most, half of which is the thickest wire."""

from collections.abc import Sequence

import numpy as np

from rve.common import Array, Flags, Index
from rve.geometry.contacts import distance_gradient, find_contacts
from rve.geometry.pattern import Pattern, padded
from rve.geometry.pose import Pose, moved, pair_maps, reduction, start_pose

LARGEST_STEP, LEAST_STEP = 0.05, 1e-11
"""Of a coordinate in r1 or radians: the first step, and the one below which the pose has settled."""
Ring = tuple[int, int, int]
Link = tuple[int, int, int, int]


def loosen(pattern: Pattern, modes: Array | None = None) -> tuple[Pose, float]:
    """The pose (n = 1) of largest clearance near the start pose with the same links, and r1/r2 of the thickest wire.

    Sequential linear programming: the least distance of centre circles, over the share of both wires in it, rises in
    every step, so that no ring passes another. modes (m, k): motions that are left, by default all.
    """
    from scipy.optimize import linprog

    maps, share, far = pair_maps(pattern), 0.5 * pattern.pair_wires, 1.2 * float(pattern.radii.max())
    ways = np.eye(pattern.coordinates) if modes is None else modes
    pose, radius, count = start_pose(pattern, 1), LARGEST_STEP, ways.shape[1]

    def measure(pose: Pose) -> tuple[Array, Array, float, bool]:
        """Distances (k,), their gradients (k, count), the least distance over its share, and whether links hold."""
        contacts = find_contacts(pose, pattern, 0.0, far)
        minima = contacts.minima
        G = np.matmul(np.matmul(distance_gradient(minima)[:, None], maps[minima.pair]), reduction(pose)[0])[:, 0]
        part = share[minima.pair]
        clearance = float((minima.distance / part).min(initial=np.inf))
        return minima.distance / part, G @ ways / part[:, None], clearance, bool(contacts.links_intact[0])

    room, G, best, _ = measure(pose)
    for _ in range(600):
        size = min(radius, 0.5 * best)
        rows, bounds = np.column_stack([-G, np.ones(len(G))]), [(-1.0, 1.0)] * count + [(0.0, None)]
        # In units of the step, since a linear program is solved to an absolute error.
        found = linprog(np.append(np.zeros(count), -1.0), A_ub=rows, b_ub=(room - best) / size, bounds=bounds)
        if found.status == 0 and found.x[-1] < max(1e-9, 1e-13 / size):
            break
        trial = moved(pose, size * (ways @ found.x[:count])[None]) if found.status == 0 else pose
        there = measure(trial)
        if there[3] and there[2] > best:
            pose, (room, G, best, _), radius = trial, there, 1.5 * radius
        else:
            radius = 0.4 * size
        if radius < LEAST_STEP:
            break
    return pose, 2.0 / best


def thickest(pattern: Pattern, pose: Pose) -> float:
    """r1/r2 of the thickest wire that a pose (n = 1) has room for."""
    minima = find_contacts(pose, pattern, 0.0, 1.2 * float(pattern.radii.max())).minima
    return float(1.0 / (minima.distance / pattern.pair_wires[minima.pair]).min())


def near_pairs(lattice: Array, centres: Array, limit: Array) -> Index:
    """Pairs (m, 4), each once, of class and shift whose centres are nearer than limit (K, K); lattice (2, 2): a1, a2;
    centres (K, 3). Lengths are in any unit."""
    most = float(limit.max()) + float(np.ptp(centres[:, :2], axis=0).sum())
    i, j = np.ceil(most * np.linalg.norm(np.linalg.inv(lattice), axis=0)).astype(int)
    grid = np.stack(np.meshgrid(np.arange(-i, i + 1), np.arange(-j, j + 1), indexing="ij"), axis=-1).reshape(-1, 2)
    pairs = []
    for a in range(len(centres)):
        for b in range(a, len(centres)):
            d = np.repeat((centres[b] - centres[a])[None], len(grid), axis=0)
            d[:, :2] += grid @ lattice
            near = (d**2).sum(axis=1) < limit[a, b] ** 2
            once = near if a < b else near & ((grid[:, 0] > 0) | ((grid[:, 0] == 0) & (grid[:, 1] > 0)))
            pairs.append(np.column_stack([np.full((once.sum(), 2), (a, b)), grid[once]]))
    return np.concatenate(pairs)


def once(link: Sequence[int]) -> Link:
    """A link as it is named from either ring."""
    a, b, i, j = (int(x) for x in link)
    return min((a, b, i, j), (b, a, -i, -j))


def matched(pattern: Pattern, other: Pattern, signs: Array, shift: Array, tolerance: float = 0.35) -> list[Ring] | None:
    """The rings of `other` that rings (k, 0, 0) of a pattern come to lie on by x -> signs x + shift (2 or 3,) in their
    start poses, None if links or sizes differ. Rings may lie `tolerance` times their radius beside each other."""
    pose, rings = start_pose(other, 1), []
    lattice, centres, normals = np.stack([pose.a1[0], pose.a2[0]]), padded(pose.centres[0]), pose.normals[0]
    there = padded(pattern.start_centres) * signs + padded(shift)
    for k, normal in enumerate(pattern.start_normals * signs):
        off = there[k] - centres
        whole = np.round(off[:, :2] @ np.linalg.inv(lattice))
        off[:, :2] -= whole @ lattice
        apart = np.linalg.norm(off, axis=1) / other.radii + 2.0 * (1.0 - np.abs(normals @ normal))
        same = np.isclose(other.radii, pattern.radii[k]) & np.isclose(other.wires, pattern.wires[k])
        apart[~same] = np.inf
        ring = int(apart.argmin())
        if not apart[ring] < tolerance:
            return None
        rings.append((ring, int(whole[ring, 0]), int(whole[ring, 1])))
    if len({ring[0] for ring in rings}) < len(rings):
        return None
    image = set()
    for a, b, i, j in pattern.pairs[pattern.linked].tolist():
        (k, ki, kj), (m, mi, mj) = rings[a], rings[b]
        image.add(once((k, m, mi + int(signs[0]) * i - ki, mj + int(signs[1]) * j - kj)))
    return rings if image == {once(link) for link in other.pairs[other.linked]} else None


def flags_of(pairs: Index, links: set[Link]) -> Flags:
    """Which of the pairs (m, 4) are links."""
    return np.array([once(pair) in links for pair in pairs], dtype=bool)
