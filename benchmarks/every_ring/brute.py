"""Distances and links of circles by brute force, without `rve`: samples, golden section, linking integrals."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def frames(normal: Array) -> tuple[Array, Array]:
    """Two unit vectors (n, 3) across each unit normal."""
    axis = np.eye(3)[np.abs(normal).argmin(axis=1)]
    e1 = np.cross(normal, axis)
    e1 /= np.linalg.norm(e1, axis=1)[:, None]
    return e1, np.cross(normal, e1)


def to_circle(point: Array, centre: Array, normal: Array, r1: float) -> Array:
    """Distance (...) of points to circles of radius r1."""
    w = point - centre
    height = (w * normal).sum(axis=-1)
    flat = np.sqrt(np.maximum((w * w).sum(axis=-1) - height**2, 0.0))
    return np.asarray(np.hypot(flat - r1, height))


def minima(centre: Array, normal: Array, pairs: NDArray[np.intp], r1: float, samples: int = 360) -> list[Array]:
    """All local minima of the distance of each pair of circles: rows (angle on the first circle, distance)."""
    e1, e2 = frames(normal)
    t = 2.0 * np.pi / samples * np.arange(samples)
    out = []
    for a, b in pairs:

        def distance(s: Array, a: int = a, b: int = b) -> Array:
            point = centre[a] + r1 * (np.cos(s)[:, None] * e1[a] + np.sin(s)[:, None] * e2[a])
            return to_circle(point, centre[b], normal[b], r1)

        f = distance(t)
        at = np.flatnonzero((f <= np.roll(f, 1)) & (f < np.roll(f, -1)))
        low, high = t[at] - t[1], t[at] + t[1]
        for _ in range(45):
            span = GOLDEN * (high - low)
            left, right = high - span, low + span
            falls = distance(left) < distance(right)
            low, high = np.where(falls, low, left), np.where(falls, right, high)
        angle = 0.5 * (low + high)
        out.append(np.column_stack([angle, distance(angle)]))
    return out


def near_pairs(centre: Array, limit: float) -> NDArray[np.intp]:
    """Pairs (m, 2) a < b of centres nearer than `limit`."""
    far = np.linalg.norm(centre[:, None] - centre[None], axis=2)
    return np.argwhere(np.triu(far < limit, 1))


def least_gap(centre: Array, normal: Array, r1: float, r2: float) -> float:
    """The smallest gap of all rings."""
    found = minima(centre, normal, near_pairs(centre, 2.0 * r1 + 4.0 * r2), r1)
    return min(float(rows[:, 1].min()) for rows in found if len(rows)) - 2.0 * r2


def linked_pairs(centre: Array, normal: Array, r1: float, samples: int = 200) -> set[tuple[int, int]]:
    """Pairs of circles with linking number other than 0, by Gauss's integral over both circles."""
    e1, e2 = frames(normal)
    t = 2.0 * np.pi / samples * np.arange(samples)
    c, s = np.cos(t)[:, None], np.sin(t)[:, None]
    step = 2.0 * np.pi / samples
    out = set()
    for a, b in near_pairs(centre, 2.0 * r1):
        rho_a, rho_b = (r1 * (c * e1[k] + s * e2[k]) for k in (a, b))
        tau_a, tau_b = (r1 * (c * e2[k] - s * e1[k]) for k in (a, b))
        w = (centre[a] + rho_a)[:, None] - (centre[b] + rho_b)[None]
        volume = (w * np.cross(tau_a[:, None], tau_b[None])).sum(axis=2)
        number = (volume / np.linalg.norm(w, axis=2) ** 3).sum() * step**2 / (4.0 * np.pi)
        if abs(number) > 0.5:
            out.add((int(a), int(b)))
    return out
