"""Triangulated solids for pictures: spheres, cylinders, boxes, arrows, a person.

A solid is points (p, 3) in mm and triangles (t, 3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rve.common.types import Array

Solid = tuple[Array, NDArray[np.intp]]

PERSON_MM = 1750.0
"""Height of the figure that shows the scale."""


def turned_profile(start: Array, end: Array, profile: Array, count: int = 24) -> Solid:
    """The solid around the axis from `start` to `end` (3,) with `profile` (k, 2): share of the axis, radius in mm.

    >>> points, triangles = turned_profile(np.zeros(3), np.array([0.0, 9.0, 0.0]), np.array([[0, 1], [1, 1]]), 8)
    >>> points.shape, triangles.shape, float(points[:, 1].max())
    ((16, 3), (16, 3), 9.0)
    """
    start, along = np.asarray(start, float), np.asarray(end, float) - np.asarray(start, float)
    e3 = along / np.linalg.norm(along)
    side = np.eye(3)[np.argmin(np.abs(e3))]
    e1 = np.cross(e3, side)
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(e3, e1)
    t = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    out = np.cos(t)[:, None] * e1 + np.sin(t)[:, None] * e2
    points = start + profile[:, :1, None] * along + profile[:, 1:, None] * out
    here = np.arange(len(profile) - 1)[:, None] * count + np.arange(count)
    right = np.roll(here, -1, axis=1)
    triangles = np.concatenate(
        [np.stack([here, right, right + count], -1), np.stack([here, right + count, here + count], -1)]
    )
    return points.reshape(-1, 3), triangles.reshape(-1, 3)


def cylinder(start: Array, end: Array, radius: float, count: int = 48) -> Solid:
    """A closed cylinder."""
    return turned_profile(start, end, np.array([[0.0, 0.0], [0.0, radius], [1.0, radius], [1.0, 0.0]]), count)


def sphere(centre: Array, radius: float, count: int = 24) -> Solid:
    """A sphere."""
    angle = np.linspace(0.0, np.pi, max(count // 2, 4) + 1)
    profile = np.column_stack([0.5 - 0.5 * np.cos(angle), radius * np.sin(angle)])
    pole = np.array([0.0, radius, 0.0])
    return turned_profile(np.asarray(centre, float) - pole, np.asarray(centre, float) + pole, profile, count)


def capsule(start: Array, end: Array, radii: tuple[float, float], count: int = 16) -> Solid:
    """A round-ended limb from `start` to `end` with a radius at each."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    length, angle = float(np.linalg.norm(end - start)), np.linspace(0.0, 0.5 * np.pi, 6)
    first = np.column_stack([-radii[0] * np.cos(angle), radii[0] * np.sin(angle)])
    last = np.column_stack([length + radii[1] * np.sin(angle), radii[1] * np.cos(angle)])
    profile = np.concatenate([first, last])
    profile[:, 0] /= length
    return turned_profile(start, end, profile, count)


def box(low: Array, high: Array) -> Solid:
    """A box with faces along the axes; faces share no points, so that edges stay sharp."""
    unit = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)
    faces = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [3, 7, 6, 2], [0, 4, 7, 3], [1, 2, 6, 5]])
    points = np.asarray(low, float) + unit[faces.ravel()] * (np.asarray(high, float) - np.asarray(low, float))
    return points, quads_cut(np.arange(24).reshape(6, 4))


def rounded_box(low: Array, high: Array, radius: float) -> Solid:
    """A box with faces along the axes whose edges and corners have a radius: eight parts of a sphere, pulled apart."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    radius = min(radius, 0.499 * float((high - low).min()))
    quarter = np.linspace(0.0, 0.5 * np.pi, 7)
    around = (0.5 * np.pi * np.arange(4)[:, None] + quarter).ravel()  # ends of quarters twice: faces lie between them
    height = np.concatenate([quarter - 0.5 * np.pi, quarter])
    side = np.repeat(np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]), 7, axis=0)
    sign = np.stack(np.broadcast_arrays(side[:, 0], np.repeat([-1.0, 1.0], 7)[:, None], side[:, 1]), axis=-1)
    c, s = np.cos(height)[:, None], np.sin(height)[:, None]
    out = np.stack(np.broadcast_arrays(c * np.cos(around), s, c * np.sin(around)), axis=-1)
    points = 0.5 * (low + high) + sign * (0.5 * (high - low) - radius) + radius * out
    count = len(around)
    here = np.arange(len(height) - 1)[:, None] * count + np.arange(count)
    right = np.roll(here, -1, axis=1)
    sides = np.stack([here, here + count, right + count, right], axis=-1).reshape(-1, 4)
    corners = np.array([0, 7, 14, 21])
    ends = np.stack([corners, (len(height) - 1) * count + corners[::-1]])
    return points.reshape(-1, 3), quads_cut(np.concatenate([sides, ends]))


def rectangle(centre: Array, first: Array, second: Array) -> Solid:
    """A plane rectangle with half sides `first` and `second` (3,)."""
    corners = np.array([-first - second, first - second, first + second, second - first])
    return np.asarray(centre, float) + corners, quads_cut(np.arange(4)[None])


def quads_cut(quads: NDArray[np.intp]) -> NDArray[np.intp]:
    """Quadrilaterals (n, 4) cut into triangles (2 n, 3)."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def arrow(tail: Array, vector: Array, thickness: float) -> Solid:
    """An arrow from `tail` along `vector` (3,), its shaft `thickness` mm thick."""
    length = float(np.linalg.norm(vector))
    head = min(0.4, 5.0 * thickness / length)
    shaft, tip = 0.5 * thickness, 1.6 * thickness
    profile = np.array([[0.0, 0.0], [0.0, shaft], [1.0 - head, shaft], [1.0 - head, tip], [1.0, 0.0]])
    return turned_profile(tail, np.asarray(tail, float) + vector, profile, 12)


def person(foot: Array, height: float = PERSON_MM) -> list[Solid]:
    """A standing person of `height` mm with the feet at `foot` (3,), facing the viewer."""
    foot = np.asarray(foot, float)

    def at(x: float, y: float) -> Array:
        return foot + height * np.array([x, y, 0.0])

    limbs = [
        *((at(s * 0.05, 0.03), at(s * 0.048, 0.27), (0.022, 0.032)) for s in (-1, 1)),
        *((at(s * 0.048, 0.27), at(s * 0.05, 0.47), (0.032, 0.047)) for s in (-1, 1)),
        (at(0.0, 0.49), at(0.0, 0.60), (0.082, 0.070)),
        (at(0.0, 0.60), at(0.0, 0.745), (0.070, 0.088)),
        (at(0.0, 0.80), at(0.0, 0.86), (0.034, 0.032)),
        *((at(s * 0.095, 0.79), at(s * 0.135, 0.61), (0.030, 0.022)) for s in (-1, 1)),
        *((at(s * 0.135, 0.61), at(s * 0.150, 0.42), (0.022, 0.018)) for s in (-1, 1)),
    ]
    solids = [capsule(start, end, (a * height, b * height)) for start, end, (a, b) in limbs]
    points, triangles = sphere(np.zeros(3), 1.0)
    head = at(0.0, 0.935) + points * height * np.array([0.048, 0.065, 0.055])
    return [*solids, (head, triangles)]
