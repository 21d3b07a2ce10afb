"""Which load directions to ask the rings for: those whose stresses widen the interval most, apart from each other."""

import numpy as np
from scipy.spatial import cKDTree

from rve.common import Array

DIGITS = 9
"""Digits of a direction: nearer ones are one question."""
BIN, RIM = 0.02, 0.02
"""Width in the disc within which stresses count as one direction; directions nearer to the rim than this are asked on
it first: wrinkled meshes carry loads of rank one."""
APART = 0.5
"""A question keeps this part of its distance to the nearest known direction free of other questions of its round."""
SAME = 1e-4
"""Directions nearer to each other than this are one."""


def rounded(x: Array) -> Array:
    """Directions (n, 2) with DIGITS digits, inside the disc.

    >>> rounded(np.array([[0.6, 0.8000000001], [0.1234567891, 0.0]])).tolist()
    [[0.6, 0.8], [0.123456789, 0.0]]
    """
    x = np.round(x, DIGITS) + 0.0
    size = np.hypot(x[:, 0], x[:, 1])
    return np.asarray(np.where(size[:, None] > 1.0, x / np.maximum(size, 1.0)[:, None], x))


def first_directions(is_mirrored: bool) -> Array:
    """Directions (n, 2) to begin with: the centre, some half-way to the rim, and most on it, where meshes wrinkle.

    Of a mesh that is its own mirror image, x2 -> -x2, one half is enough.
    """
    points = [np.zeros((1, 2))]
    for radius, half in ((0.6, 3), (1.0, 6)):
        angle = np.pi * np.arange(half + 1 if is_mirrored else 2 * half) / half
        points.append(radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    return rounded(np.vstack(points))


def widest(x: Array, part: Array, known: Array, most: int, is_mirrored: bool) -> Array:
    """At most `most` directions (n, 2) to ask for, given stresses at x (m, 2) with their parts (m,) of the interval.

    known (k, 2): directions asked before. Of a mesh that is its own mirror image those with x2 >= 0 stand for all.
    """
    there = part > 0.0
    x, part = x[there], part[there]
    if is_mirrored:
        x, known = _folded(x), _folded(known)
    square = np.unique(np.floor(x / BIN).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
    weight = np.asarray(np.bincount(square, part), float)
    centre = np.column_stack([np.bincount(square, part * one) / weight for one in x.T])
    chosen = list[tuple[Array, float]]()
    for i in np.argsort(-weight, kind="stable"):
        point = _placed(centre[i], known)
        free = APART * _least_distance(point, known)
        is_near = any(np.hypot(*(one - point)) < max(radius, free) for one, radius in chosen)
        if free >= APART * SAME and not is_near and len(chosen) < most:
            chosen.append((point, free))
    return np.array([point for point, _ in chosen]).reshape(-1, 2)


def between(known: Array, most: int, is_mirrored: bool) -> Array:
    """At most `most` directions (n, 2) that are farthest from all known ones, for want of stresses."""
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 33), np.linspace(-1, 1, 33)), axis=-1).reshape(-1, 2)
    angle = np.pi * np.arange(96) / 48.0
    grid = np.vstack([np.column_stack([np.cos(angle), np.sin(angle)]), grid[np.hypot(*grid.T) < 1.0]])
    grid = grid[grid[:, 1] >= 0.0] if is_mirrored else grid
    known = _folded(known) if is_mirrored else known
    chosen: list[Array] = []
    for _ in range(most):
        distance = cKDTree(np.vstack([known, *chosen])).query(grid)[0]
        chosen.append(grid[distance.argmax()][None])
    return np.vstack(chosen)


def _folded(x: Array) -> Array:
    return np.column_stack([x[:, 0], np.abs(x[:, 1])])


def _placed(x: Array, known: Array) -> Array:
    """The direction itself, or the nearest one on the rim if that is near and was not asked before."""
    size = float(np.hypot(*x))
    if size < 1.0 - RIM:
        return x
    rim = x / size
    return rim if _least_distance(rim, known) > max(SAME, 1.0 - size) else x


def _least_distance(x: Array, known: Array) -> float:
    return float(np.hypot(*(known - x).T).min()) if len(known) else np.inf
