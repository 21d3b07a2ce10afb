"""Load directions of a table as points of the disc, and what is known between them, by triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, Delaunay, QhullError

from rve.common import Array, Flags, InputError
from rve.common.tensor import IDENTITY, disc, eigenvalues, mirror, trace


@dataclass(frozen=True)
class DirectionOptions:
    """Numbers of loads in the disc of directions."""

    same: float = 1e-9
    """Loads in the disc closer than this are one load."""
    flat: float = 1e-12
    """Twice the area in the disc below which a triangle holds no load."""
    folds: int = 5
    """Parts in which loads are left out, to learn how wrong what is known between the others is there."""
    rim_step_deg: float = 45.0
    """Loads of rank one farther apart than this in the disc (half of it in space) leave the rim between them
    unknown."""
    on_rim: float = 1e-6
    """Distance in the disc up to which loads are of rank one, or one load where rounding keeps them apart."""
    beyond: float = 1e-3
    """Distance in the disc by which a load may lie beyond the hull and still count as one in it."""
    chunk: int = 500
    """Loads looked up together: 15 MB for the triangles of 190 rows."""


DIRECTIONS = DirectionOptions()


@dataclass(frozen=True, eq=False)
class Directions:
    """Load directions as points of the disc, and the triangles between them; with their mirror images if `is_mirrored`.

    slope (2, 3, t), level (3, t): the weights of each triangle's corners at a point x are x slope + level; rows (t, 3):
    the loads at its corners; hull (k, 3): the half-planes around all; limits (j, 3): see `limits_of`.
    """

    slope: Array
    level: Array
    rows: NDArray[np.intp]
    hull: Array
    limits: Array
    is_mirrored: bool

    @staticmethod
    def of(S: Array, cauchy: Array, is_mirrored: bool) -> Directions:
        """Those of loads S (n, 3) of unit trace and their Cauchy loads (n, 3); InputError unless they surround the
        equibiaxial load."""
        if is_mirrored:
            S, cauchy = np.vstack([S, mirror(S)]), np.vstack([cauchy, mirror(cauchy)])
        first = each_once(disc(S))
        x, s = disc(S[first]), disc(cauchy[first] / trace(cauchy[first])[:, None])
        try:
            triangles, hull = Delaunay(s).simplices, ConvexHull(x).equations
        except (QhullError, ValueError) as error:
            raise InputError("strengths need loads that differ in angle and ratio; these lie on one line") from error
        if hull[:, 2].max() >= 0.0:
            raise InputError("strengths need loads on all sides of the equibiaxial one")
        sides = np.swapaxes(x[triangles[:, :2]] - x[triangles[:, 2:]], 1, 2)
        good = np.abs(np.linalg.det(sides)) > DIRECTIONS.flat
        triangles = triangles[good]
        two = np.linalg.inv(sides[good])
        slope = np.concatenate([two, -two.sum(axis=1, keepdims=True)], axis=1)
        level = np.array([0.0, 0.0, 1.0]) - np.einsum("tij,tj->ti", slope, x[triangles[:, 2]])
        rows = first[triangles] % (len(S) // (1 + is_mirrored))
        known = limits_of(S, cauchy)
        return Directions(slope.transpose(2, 1, 0).copy(), level.T.copy(), rows, hull, known, is_mirrored)

    def at(self, S: Array) -> tuple[NDArray[np.intp], Array]:
        """LockedRows (m, 3) around each load S (m, 3) of unit trace, and their weights (m, 3), which sum to 1.

        A load outside of the hull is drawn towards the equibiaxial one until it lies on it. In a weave that is its own
        mirror image a load and its image have the same weights, though triangles between points on a square may not be
        mirror images.
        """
        x = disc(S)
        if self.is_mirrored:
            x[:, 1] = np.abs(x[:, 1])
        x = x / np.maximum(self._reach(x).max(axis=1), 1.0)[:, None]
        rows, weights = np.empty((len(x), 3), dtype=np.intp), np.empty((len(x), 3))
        for start in range(0, len(x), DIRECTIONS.chunk):
            part = slice(start, start + DIRECTIONS.chunk)
            three = x[part, :1, None] * self.slope[0] + x[part, 1:, None] * self.slope[1] + self.level
            best = three.min(axis=1).argmax(axis=1)
            inside = np.maximum(np.take_along_axis(three, best[:, None, None], axis=2)[..., 0], 0.0)
            rows[part], weights[part] = self.rows[best], inside / inside.sum(axis=1, keepdims=True)
        return rows, weights

    def extrapolates(self, S: Array) -> Flags:
        """Whether there are no loads around those of S (m, 3), of unit trace, (m,)."""
        return beyond(self.limits, S)

    def _reach(self, x: Array) -> Array:
        """How far points x (m, 2) of the disc lie towards each half-plane of the hull, (m, k), which is at 1."""
        return np.asarray(x @ self.hull[:, :2].T / -self.hull[:, 2])


def limits_of(S: Array, cauchy: Array) -> Array:
    """The half-planes (k, 3) of the hull of loads S (n, 3) of unit trace in the disc beyond which no load is known.

    The rim between neighbours of rank one is known. They are neighbours as Cauchy loads (n, 3), which lie on a grid,
    while S crowds where the cell locks far from its reference, and is the same for several of them where one chain
    bears all.
    """
    x, s = disc(S), disc(cauchy / trace(cauchy)[:, None])
    hull, known = ConvexHull(x), []
    for ends in x[hull.simplices]:
        one, other = (s[np.hypot(*(x - end).T) < DIRECTIONS.on_rim] for end in ends)
        is_close = (one @ other.T).max() > np.cos(np.radians(DIRECTIONS.rim_step_deg))
        known.append(is_close and np.hypot(*ends.T).min() > 1.0 - DIRECTIONS.on_rim)
    return np.asarray(hull.equations[~np.array(known)])


def beyond(limits: Array, S: Array) -> Flags:
    """Whether loads S (m, 3) of unit trace lie beyond the `limits_of` others, (m,)."""
    return np.asarray((disc(S) @ limits[:, :2].T + limits[:, 2]).max(axis=1, initial=0.0) > DIRECTIONS.beyond)


def each_once(x: Array, is_mirrored: bool = False) -> NDArray[np.intp]:
    """Numbers (k,) in turn of the different ones among points (n, 2) of the disc; of mirror images one if asked for."""
    x = np.column_stack([x[:, 0], np.abs(x[:, 1])]) if is_mirrored else x
    return np.sort(np.unique(np.round(x / DIRECTIONS.same), axis=0, return_index=True)[1])


def tensile_part(S: Array) -> Array:
    """Line loads S (n, 3) with compressive principal values set to zero.

    >>> tensile_part(np.array([[3.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))
    array([[3. , 0. , 0. ],
           [0.5, 0.5, 0.5]])
    """
    low, high = eigenvalues(S)
    top, bottom = np.maximum(high, 0.0), np.maximum(low, 0.0)
    share = (top - bottom) / np.where(high > low, high - low, 1.0)
    return np.asarray(share[:, None] * S + (bottom - share * low)[:, None] * IDENTITY)


def hull_of(S: Array, is_mirrored: bool) -> Array:
    """Corners (k, 2) in the disc of the hull of loads S (n, 3), mirror images included, in turn.

    InputError for fewer than four loads, and loads on one line.
    """
    x = disc(np.vstack([S, mirror(S[np.abs(S[:, 1]) > DIRECTIONS.same])]) if is_mirrored else S)
    few = len(each_once(x)) < 4
    if few or np.linalg.matrix_rank(x - x[0], DIRECTIONS.same) < 2:
        what = "are fewer than four" if few else "lie on one line"
        raise InputError(f"the rows' loads {what}: a law needs loads that differ in angle and in ratio")
    return np.asarray(x[ConvexHull(x).vertices])


def folds_of(S: Array, is_mirrored: bool) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Numbers of loads that are left out together, and of those that stay, DIRECTIONS.folds times; none if the loads
    are too few. Of loads that are the same, or mirror images, the first stands for all. Each is left out once with its
    neighbours kept; corners of the hull of all stay in, they span it."""
    once = each_once(disc(S), is_mirrored)
    if len(once) < 2 * DIRECTIONS.folds:
        return []
    inner = once[np.abs(disc(S[once])[:, None] - hull_of(S, is_mirrored)).max(axis=2).min(axis=1) > 1e-7]
    if len(inner) < 2 * DIRECTIONS.folds:
        return []
    return [
        (inner[fold :: DIRECTIONS.folds], np.setdiff1d(once, inner[fold :: DIRECTIONS.folds]))
        for fold in range(DIRECTIONS.folds)
    ]
