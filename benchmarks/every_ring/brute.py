"""Distances and links of circles by brute force, without `rve`: samples, golden section, linking integrals."""

from typing import Any

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


def minima(
    d: Array, n_a: Array, n_b: Array, samples: int = 360, rounds: int = 45
) -> tuple[NDArray[np.intp], Array, Array]:
    """All local minima of the distance of points on unit circles A to unit circles B, (n, 3) each: pair, angle on A,
    distance. `samples` by golden section; a flat pair, as near everywhere, has one.
    """
    e1, e2 = frames(n_a)

    def distance(rows: Any, angle: Array) -> Array:
        point = np.cos(angle)[..., None] * e1[rows][:, None] + np.sin(angle)[..., None] * e2[rows][:, None]
        return to_circle(point, d[rows][:, None], n_b[rows][:, None], 1.0)

    t = 2.0 * np.pi / samples * np.arange(samples)
    f = distance(slice(None), np.tile(t, (len(d), 1)))
    row, column = np.nonzero((f < np.roll(f, 1, axis=1)) & (f <= np.roll(f, -1, axis=1)))
    flat = np.setdiff1d(np.arange(len(f)), row)
    row, column = np.concatenate([row, flat]), np.concatenate([column, np.zeros(len(flat), np.intp)])
    low, high = t[column, None] - t[1] * (rounds > 0), t[column, None] + t[1] * (rounds > 0)
    for _ in range(rounds):
        left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        falls = distance(row, left) > distance(row, right)
        low, high = np.where(falls, left, low), np.where(falls, high, right)
    angle = 0.5 * (low + high)
    return row, angle[:, 0], distance(row, angle)[:, 0]


def minima_of(centre: Array, normal: Array, pairs: NDArray[np.intp]) -> tuple[NDArray[np.intp], Array, Array]:
    """`minima` of pairs (m, 2) of placed circles, lengths in their radius."""
    a, b = pairs.T
    return minima(centre[b] - centre[a], normal[a], normal[b])


def near_pairs(centre: Array, limit: float) -> NDArray[np.intp]:
    """Pairs (m, 2) a < b of centres nearer than `limit`."""
    far = np.linalg.norm(centre[:, None] - centre[None], axis=2)
    return np.argwhere(np.triu(far < limit, 1))


def least_gap(centre: Array, normal: Array, r1: float, r2: float) -> float:
    """The smallest gap of all rings."""
    found = minima_of(centre / r1, normal, near_pairs(centre, 2.0 * r1 + 4.0 * r2))
    return r1 * float(found[2].min()) - 2.0 * r2


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
