"""The locking constraints of a curtain: per quadrature point a few half-spaces S:E <= h, each one a second-order cone.

S:E(F) <= h with E = (F^T F - I)/2 and S = L L^T reads ||F L||_F <= sqrt(2 h + tr S): convex in F for every d. The slack

    g = h - S:E(F) = (c^2 - ||F L||_F^2) / 2,   c^2 = 2 h + tr S

is concave in F with gradient -F S. Points carry different numbers of half-spaces, so these are kept as one flat list.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homogenize import MembraneLaw
from homogenize.laws import Cut, HalfSpaces
from rve.common import Array
from rve.common.tensor import IDENTITY, trace

LAW_CHUNK = 20_000
"""Points per call of `law.cut`: keeps its (points, half-spaces) table inside some 100 MB."""


@dataclass(frozen=True)
class Cones:
    """Half-spaces of all points, one or more of each: `point` (nc,) ascending, S (nc, 3), h (nc,), `first` (nq,) where
    each point begins; extra (nc,) or (nc, k): by how much each is widened per unit of tau (`GivingLaw`), or None.
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
        return self.h + 0.5 * trace(self.S)

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

    def pick(self, old: np.ndarray, point: np.ndarray, n_points: int) -> Cones:
        """The half-spaces `old` (n,) at `point` (n,), ascending, of `n_points` points that have one each at least."""
        extra = None if self.extra is None else self.extra[old]
        return Cones(point, self.S[old], self.h[old], np.searchsorted(point, np.arange(n_points)), extra)

    def stress(self, lam: Array) -> Array:
        """S_q = sum of lam_i S_i (nq, 3)."""
        return np.stack([self.sum(lam * self.S[:, k]) for k in range(3)], axis=-1)


def green_strain(F: Array) -> Array:
    """E = (F^T F - I)/2 as triples (n, 3) for F (n, d, 2)."""
    a, b = F[:, :, 0], F[:, :, 1]
    return np.asarray(0.5 * (np.stack([(a * a).sum(1), (a * b).sum(1), (b * b).sum(1)], axis=-1) - IDENTITY))


def times_root(F: Array, L: Array, which: np.ndarray | slice = slice(None)) -> Array:
    """F L of each cone, flat (n, 2 d), for F (nq, d, 2) at the points `which` (n,) and symmetric triples L (n, 3)."""
    out = np.empty((F.shape[1], 2, len(L)))  # filled row by row: whole arrays between the sums take eight times as long
    for row, (x, y) in zip(out, F.transpose(1, 2, 0), strict=True):
        x, y = x[which], y[which]
        for k in range(2):
            np.multiply(x, L[:, k], out=row[k])
            row[k] += y * L[:, k + 1]
    return out.reshape(-1, len(L)).T


def add_stress(H: Array, S: Array) -> None:
    """Add S (n, 3) to the blocks (n, 2 d, 2 d) of dF: the stiffness of stresses that turn with F."""
    for i in range(0, H.shape[1], 2):
        H[:, i, i] += S[:, 0]
        H[:, i, i + 1] += S[:, 1]
        H[:, i + 1, i] += S[:, 1]
        H[:, i + 1, i + 1] += S[:, 2]


def symmetric_roots(S: Array) -> Array:
    """Symmetric L with L L = S as triples (n, 3), for positive semidefinite triples S (n, 3), also of rank one."""
    det = np.sqrt(np.maximum(S[:, 0] * S[:, 2] - S[:, 1] ** 2, 0.0))
    size = np.sqrt(S[:, 0] + S[:, 2] + 2.0 * det)
    return np.stack([(S[:, 0] + det) / size, S[:, 1] / size, (S[:, 2] + det) / size]).T


def first_cones(start: HalfSpaces, n_points: int) -> Cones:
    """The same half-spaces at each of `n_points` points."""
    one = Cones(np.zeros(len(start.h), int), start.S, start.h, np.zeros(1, int), start.extra)
    return take_from(one, np.zeros(n_points, int))


def with_cuts(cones: Cones, point: np.ndarray, cut: Cut) -> tuple[Cones, np.ndarray]:
    """`cones` and a half-space of `cut` at each `point` (k,); the order (nc + k,) of old ones followed by new ones."""
    n = len(cones)
    order = np.insert(np.arange(n), np.searchsorted(cones.point, point, side="right"), n + np.arange(len(point)))
    extra = None if cut.extra is None else np.concatenate([cones.extra, cut.extra])
    S, h = np.concatenate([cones.S, cut.S]), np.concatenate([cones.h, cut.h])
    both = Cones(np.concatenate([cones.point, point]), S, h, cones.first, extra)
    return both.pick(order, both.point[order], len(cones.first)), order


def take_from(cones: Cones, source: np.ndarray) -> Cones:
    """For each new point the half-spaces of point `source` (n,) of the old ones."""
    count = np.bincount(cones.point, minlength=len(cones.first))[source]
    point = np.repeat(np.arange(len(source)), count)
    old = np.repeat(cones.first[source] - (np.cumsum(count) - count), count) + np.arange(len(point))
    return cones.pick(old, point, len(source))


def all_cuts(law: MembraneLaw, E: Array) -> Cut:
    """The half-space of the law nearest to (or most violated by) each E (n, 3), or (n, 4) with tau."""
    first, *others = [law.cut(E[i : i + LAW_CHUNK]) for i in range(0, len(E), LAW_CHUNK)]
    return first.join(others)


def least_slack(law: MembraneLaw, E: Array) -> float:
    """The least slack of the law over all strains E (n, 3), over h + tr S / 2; negative where one is not admissible."""
    cut = all_cuts(law, E)
    return float((-cut.violation / (cut.h + 0.5 * trace(cut.S))).min())
