"""Bounds on the locked strain under a Cauchy load that follow from the rows of a table alone, whatever law is fitted.

Write C = I + 2E = l C0 with the shape C0 = [[cosh w / m, sinh w], [sinh w, m cosh w]], det C0 = 1, and the size l. The
deformation gradient of l C0 is that of C0 times sqrt(l), so the direction S of the second Piola-Kirchhoff load (unit
trace) depends on the shape alone. For a strain E locked under S, with rows S_i, E_i, h_i = S_i:E_i of one convex set,

    S:E >= S:E_j for all rows, so  l >= (1 + 2 max_j S:E_j) / (S:C0),
    S_i:E <= h_i for all rows, so  l <= min_i (1 + 2 h_i) / (S_i:C0).

Shapes for which the second limit is below the first do not occur under this load. The others form a region of the plane
(log m, w). It is found by halving rectangles; the bounds are the extremes of E over the rectangles that are left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homogenize.fitting.row_tests import normality
from homogenize.laws.rows import LockedRows, with_mirror
from rve.common import Array, Rows
from rve.common.tensor import IDENTITY, WEIGHT, double_dot, trace
from rve.geometry import deformation_gradient, second_pk

STAR = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
CORNERS = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])


@dataclass(frozen=True)
class BoundOptions:
    """Numbers of the search for bounds."""

    largest: float = 4.0
    """Shapes with |log m| and |w| up to this are searched; cells beyond are 50 times longer than wide, or sheared
    flat."""
    first: int = 40
    """Rectangles along each axis at the start; fewer may miss a small region."""
    resolution: float = 0.02
    """Halving ends when rectangles are this share of the region; the bounds are wider than the region by about as
    much."""
    smallest: float = 1e-7
    """Regions smaller than this are points."""
    margin: float = 2.0
    """Factor on the change of log(upper / lower limit of l) that is seen inside a rectangle; a larger one keeps
    more."""
    round_off: float = 1e-10
    """Excess below zero that is still kept."""


OPTIONS = BoundOptions()


@dataclass(frozen=True, eq=False)
class _Known:
    """Rows and mirror images: weighted loads S (k, 3), `top` (k,) = 1 + 2 h, weighted strains E (j, 3), and `slack`,
    the amount by which the rows contradict each other. Fewer rows give wider bounds, never wrong ones."""

    S: Array
    top: Array
    E: Array
    slack: float

    def sizes(self, shape: Array, s: Array) -> _Sizes:
        """Sizes of cells of these shapes (n, 2) under the load s (3,)."""
        m, cosh = np.exp(shape[:, 0]), np.cosh(shape[:, 1])
        C0 = np.stack([cosh / m, np.sinh(shape[:, 1]), cosh * m], axis=1)
        S = second_pk(deformation_gradient(0.5 * (C0 - IDENTITY)), np.broadcast_to(s, (len(C0), 3)))
        S = S / trace(S)[:, None]
        work, limit = S @ self.E.T, self.top / (C0 @ self.S.T)
        least = (1.0 + 2.0 * (work.max(axis=1) - self.slack)) / double_dot(S, C0)
        return _Sizes(C0, np.maximum(least, 1e-300), limit.min(axis=1), work, limit)

    def near(self, seen: _Sizes, reach: float) -> _Known:
        """The rows whose limit of the size is within a factor exp(reach) of the closest one at some of the shapes."""
        outer = (seen.limit <= np.exp(reach) * seen.most[:, None]).any(axis=0)
        least = 1.0 + 2.0 * seen.work
        inner = (least >= np.exp(-reach) * least.max(axis=1, keepdims=True)).any(axis=0)
        return _Known(self.S[outer], self.top[outer], self.E[inner], self.slack)


@dataclass(frozen=True, eq=False)
class _Sizes(Rows):
    """Shapes C0 (n, 3), their least and largest size l (n,); per row S:E_j (n, j) and the largest size (n, k)."""

    C0: Array
    least: Array
    most: Array
    work: Array
    limit: Array

    def excess(self) -> Array:
        """log of the largest over the least size, (n,): negative where the shape does not occur."""
        return np.asarray(np.log(self.most / self.least))


def strain_bounds(rows: LockedRows, s: Array) -> tuple[Array, Array]:
    """Least and largest components (n, 3) each of the locked strain under the Cauchy loads s (n, 3), from the rows of a
    table and their mirror images; nan where no strain is left.

    They hold if the locked strains lie on one convex set; rows that contradict each other by some strain widen them by
    as much. Under a load of rank one they hold all strains that the rows allow, down to cells drawn to a line.
    """
    both = with_mirror(rows)
    slack = -normality(rows).slack
    known = _Known(both.S * WEIGHT, 1.0 + 2.0 * (both.h + slack), both.E * WEIGHT, slack)
    ends = np.array([_bounds_under(load, known) for load in np.asarray(s, float)]).reshape(-1, 2, 3)
    return ends[:, 0], ends[:, 1]


def _bounds_under(s: Array, known: _Known) -> tuple[Array, Array]:
    """Least and largest strain components (3,) under the load s (3,), by halving rectangles of the plane of shapes."""
    half = np.full(2, OPTIONS.largest / OPTIONS.first)
    ticks = (2.0 * np.arange(OPTIONS.first) + 1.0 - OPTIONS.first) * half[0]
    x = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 2)
    while True:
        seen = [known.sizes(x + way * half, s) for way in STAR]
        change = OPTIONS.margin * _change(seen)
        keep = seen[0].excess() + change >= -OPTIONS.round_off
        if not keep.any():
            return np.full(3, np.nan), np.full(3, np.nan)
        x, known = x[keep], known.near(seen[0].take(keep), 2.0 * change[keep].max())
        coarse = half > np.maximum(OPTIONS.resolution * (np.ptp(x, axis=0) + 2.0 * half), OPTIONS.smallest)
        if not coarse.any():
            return _extremes([known.sizes(x + way * half, s) for way in CORNERS])
        half = np.where(coarse, 0.5 * half, half)
        parts = CORNERS if coarse.all() else np.where(coarse, CORNERS[:2], 0.0)
        x = (x[:, None] + half * parts).reshape(-1, 2)


def _change(seen: list[_Sizes]) -> Array:
    """Change of the excess from the middle of rectangles to their edges, (n,), seen at the points of `STAR`."""
    middle, right, left, up, down = (one.excess() for one in seen)
    along = np.maximum(abs(right - middle), abs(left - middle))
    return np.asarray(along + np.maximum(abs(up - middle), abs(down - middle)))


def _extremes(corners: list[_Sizes]) -> tuple[Array, Array]:
    """Least and largest strain components (3,) over the corners of rectangles."""
    sizes = [(size[:, None] * one.C0) for one in corners for size in (np.minimum(one.least, one.most), one.most)]
    E = 0.5 * (np.array(sizes) - IDENTITY)
    return E.min(axis=(0, 1)), E.max(axis=(0, 1))
