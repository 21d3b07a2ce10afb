"""The locking constraints of a curtain: per quadrature point a few half-spaces S:E <= h, each one a second-order cone.

S:E(F) <= h with E = (F^T F - I)/2 and S = L L^T reads ||F L||_F <= sqrt(2 h + tr S): convex in F for every d. The slack

    g = h - S:E(F) = (c^2 - ||F L||_F^2) / 2,   c^2 = 2 h + tr S

is concave in F with gradient -F S. Points carry different numbers of half-spaces, so these are kept as one flat list.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from homogenize import Cut, HalfSpaces, MembraneLaw
from rve.common.tensor import IDENTITY
from rve.common.types import Array

LAW_CHUNK = 20_000
"""Points per call of `law.cut`: keeps its (points, half-spaces) table inside some 100 MB."""

FLAT = 0.05
"""A unit-trace S with a determinant below this (1/4 is the roundest) does not hold a point on its own."""


@dataclass(frozen=True)
class Cones:
    """Half-spaces of all points: `point` (nc,) ascending, S (nc, 3), h (nc,), `first` (nq,) where each point begins.

    Every point has at least one half-space. extra (nc,): by how much each is widened per unit of tau where rings give
    by direction (`homogenize.GivingLaw`), else None.
    """

    point: np.ndarray
    S: Array
    h: Array
    first: np.ndarray
    extra: Array | None = None

    def __len__(self) -> int:
        return len(self.h)

    @property
    def size(self) -> Array:
        """c^2 / 2 = h + tr S / 2 (nc,): the slack at F = 0, the natural unit of a slack."""
        return self.h + 0.5 * (self.S[:, 0] + self.S[:, 2])

    def sum(self, values: Array) -> Array:
        """Sums over the half-spaces of each point: (nc, ...) to (nq, ...)."""
        return np.add.reduceat(values, self.first, axis=0)

    def sum_of_squares(self, v: Array, weight: Array) -> Array:
        """Sums of weight v v^T over the half-spaces of each point, (nq, m, m) for v (nc, m); one half is computed."""
        m = v.shape[1]
        out = np.empty((m, m, len(self.first)))
        for i in range(m):
            scaled = weight * v[:, i]
            for j in range(i + 1):
                out[i, j] = out[j, i] = self.sum(scaled * v[:, j])
        return out.transpose(2, 0, 1)

    def stress(self, lam: Array) -> Array:
        """S_q = sum of lam_i S_i (nq, 3)."""
        return np.stack([self.sum(lam * self.S[:, k]) for k in range(3)], axis=-1)


def green_strain(F: Array) -> Array:
    """E = (F^T F - I)/2 as triples (n, 3) for F (n, d, 2)."""
    a, b = F[:, :, 0], F[:, :, 1]
    return 0.5 * (np.stack([(a * a).sum(1), (a * b).sum(1), (b * b).sum(1)], axis=-1) - IDENTITY)


def times_root(F: Array, L: Array) -> Array:
    """F L of each cone, flat (n, 2 d), for F (n, d, 2) and symmetric L (n, 3) as triples."""
    out = np.empty((2 * F.shape[1], len(F)))
    for a in range(F.shape[1]):
        root_row(F[:, a, 0], F[:, a, 1], L, out[2 * a : 2 * a + 2])
    return out.T


def root_row(x: Array, y: Array, L: Array, out: Array) -> None:
    """(x, y) L of each cone into out (2, n)."""
    np.multiply(x, L[:, 0], out=out[0])
    out[0] += y * L[:, 1]
    np.multiply(x, L[:, 1], out=out[1])
    out[1] += y * L[:, 2]


def symmetric_roots(S: Array) -> Array:
    """Symmetric L with L L = S as triples (n, 3), for positive semidefinite triples S (n, 3), also of rank one."""
    det = np.sqrt(np.maximum(S[:, 0] * S[:, 2] - S[:, 1] ** 2, 0.0))
    size = np.sqrt(S[:, 0] + S[:, 2] + 2.0 * det)
    return np.stack([(S[:, 0] + det) / size, S[:, 1] / size, (S[:, 2] + det) / size]).T


def first_cones(law: MembraneLaw, n_points: int) -> Cones:
    """The half-spaces the law starts with, at each of `n_points` points."""
    return same_cones(law.half_spaces(), n_points)


def same_cones(start: HalfSpaces, n_points: int) -> Cones:
    """The same half-spaces at each of `n_points` points."""
    m = len(start.h)
    return Cones(
        np.repeat(np.arange(n_points), m),
        np.tile(start.S, (n_points, 1)),
        np.tile(start.h, n_points),
        np.arange(n_points) * m,
        None if start.extra is None else np.tile(start.extra, n_points),
    )


def with_cuts(
    cones: Cones, point: np.ndarray, S: Array, h: Array, extra: Array | None = None
) -> tuple[Cones, np.ndarray]:
    """`cones` and the half-spaces S (k, 3), h (k,) at `point` (k,); and where the old and new ones (nc + k,) come from.

    The second array orders per-half-space data of old ones followed by new ones.
    """
    n = len(cones)
    order = np.insert(np.arange(n), np.searchsorted(cones.point, point, side="right"), n + np.arange(len(point)))
    added = np.bincount(point, minlength=len(cones.first))
    return (
        Cones(
            np.concatenate([cones.point, point])[order],
            np.concatenate([cones.S, S])[order],
            np.concatenate([cones.h, h])[order],
            cones.first + np.cumsum(added) - added,
            None if cones.extra is None or extra is None else np.concatenate([cones.extra, extra])[order],
        ),
        order,
    )


def repeat_cones(cones: Cones, times: int) -> Cones:
    """The half-spaces of n points for `times` copies of these points, one copy after the other."""
    n, nc = len(cones.first), len(cones)
    copies = np.arange(times)[:, None]
    return Cones(
        (cones.point + n * copies).ravel(),
        np.tile(cones.S, (times, 1)),
        np.tile(cones.h, times),
        (cones.first + nc * copies).ravel(),
        None if cones.extra is None else np.tile(cones.extra, times),
    )


def take_from(cones: Cones, source: np.ndarray) -> Cones:
    """For each new point the half-spaces of point `source` (n,) of the old ones."""
    count = np.bincount(cones.point, minlength=len(cones.first))[source]
    first = np.cumsum(count) - count
    point = np.repeat(np.arange(len(source)), count)
    old = np.repeat(cones.first[source], count) + np.arange(len(point)) - first[point]
    return Cones(point, cones.S[old], cones.h[old], first, None if cones.extra is None else cones.extra[old])


def with_support(cones: Cones, law: MembraneLaw) -> Cones:
    """The half-spaces of `law` with the same S as those of `cones`."""
    return replace(cones, h=law.support(cones.S))


def keep_steady(cones: Cones, keep: np.ndarray) -> np.ndarray:
    """`keep` (nc,) and what Newton's matrix needs to stay definite: at every point one well-conditioned S, or all."""
    det = cones.S[:, 0] * cones.S[:, 2] - cones.S[:, 1] ** 2
    roundest = np.maximum.reduceat(det, cones.first)[cones.point]
    return np.asarray(keep | (det >= roundest) | (roundest < FLAT))


def only(cones: Cones, keep: np.ndarray) -> Cones:
    """The half-spaces marked by `keep` (nc,); every point must retain one."""
    point = cones.point[keep]
    first = np.searchsorted(point, np.arange(len(cones.first)))
    return Cones(point, cones.S[keep], cones.h[keep], first, None if cones.extra is None else cones.extra[keep])


def all_cuts(law: MembraneLaw, E: Array) -> Cut:
    """The half-space of the law nearest to (or most violated by) each E (n, 3), or (n, 4) with tau."""
    parts = [law.cut(E[i : i + LAW_CHUNK]) for i in range(0, len(E), LAW_CHUNK)]
    S, h, violation = (np.concatenate([getattr(part, name) for part in parts]) for name in ("S", "h", "violation"))
    extra = [part.extra for part in parts if part.extra is not None]
    return Cut(S, h, violation, np.concatenate(extra) if extra else None)


def law_cut(law: MembraneLaw, E: Array) -> tuple[Array, Array, Array]:
    """The half-space of the law nearest to (or most violated by) each E (n, 3): S (n, 3), h (n,), h - S:E (n,)."""
    found = all_cuts(law, E)
    return found.S, found.h, -found.violation


def least_slack(law: MembraneLaw, E: Array) -> float:
    """The least slack of the law over all strains E (n, 3), over h + tr S / 2; negative where one is not admissible."""
    S, h, slack = law_cut(law, E)
    return float((slack / (h + 0.5 * (S[:, 0] + S[:, 2]))).min())
