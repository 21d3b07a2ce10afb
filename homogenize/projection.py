"""Closest point of a polyhedron in the metric of a stiffness: many points at once, exact active sets.

With Q = W M symmetric positive definite, M the stiffness in tensor components and W = diag(1, 2, 1), the energy beyond
locking is 1/2 (E - E*).Q (E - E*). Q = R^T R turns strains into y = R E, where this is half the squared distance, and
half-spaces S_i:E <= h_i into n_i.y <= h_i. At most three are active. Each round adds the half-space that is violated
most and keeps the best of the subsets that hold it; their dual energies are compared, which grow from round to round,
so no active set returns and the iteration ends.

The kernels work on component arrays of one block of points that stays in the cache.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from homogenize.protocol import Array, Response
from homogenize.tensor import WEIGHT

Index = NDArray[np.intp]

TOLERANCE = 1e-13
"""A half-space counts as violated above this strain; rounding of S:E is a few 1e-16."""
DEGENERATE = 1e-9
"""Normals that span less than this share of the volume of orthogonal ones count as dependent."""
MAX_ROUNDS = 300
BLOCK = 1024
STARTS = ((0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2))
UPDATES = ((3,), (0, 3), (1, 3), (2, 3), (0, 1, 3), (0, 2, 3), (1, 2, 3))


class ProjectionError(RuntimeError):
    """The iteration did not end: half-spaces almost repeat each other, or the stiffness is nearly singular."""


@dataclass(frozen=True, eq=False)
class Metric:
    """y = R E with R (3, 3): E.Q E = y.y for the symmetric Q = W M."""

    R: Array
    inverse: Array


def metric_of(stiffness: Array) -> Metric:
    """The metric of a stiffness M (3, 3) in tensor components, W M symmetric positive definite."""
    R: Array = np.asarray(np.linalg.cholesky(WEIGHT[:, None] * stiffness).T)
    return Metric(R, np.asarray(np.linalg.inv(R)))


@dataclass(frozen=True, eq=False)
class Planes:
    """Half-spaces n_i.y <= h_i in metric coordinates: `rows` (4, m) holds n and -h, one column each."""

    rows: Array

    def excess(self, y: Array) -> Array:
        """n_i.y - h_i for y (3, n), (n, m)."""
        return y.T @ self.rows[:3] + self.rows[3]


def planes_of(S: Array, h: Array, metric: Metric) -> Planes:
    """The half-spaces S (m, 3), h (m,) in metric coordinates."""
    return Planes(np.ascontiguousarray(np.vstack([metric.inverse.T @ (S * WEIGHT).T, -h])))


@dataclass(frozen=True, eq=False)
class Active:
    """Up to three half-spaces per point: number `index` (3, n), multiplier `factor` (3, n), zero for an idle one.

    `shift` (3, n) is the sum of multiplier times normal: the way from the closest point to the point.
    """

    index: Index
    factor: Array
    shift: Array

    def energy(self) -> Array:
        """Dual energy, half the squared length of the shift, (n,)."""
        return 0.5 * _dot(self.shift, self.shift)


def project(y: Array, planes: Planes, guess: Index | None = None) -> Active:
    """Active half-spaces, multipliers and shift of the closest points to y (3, n); `guess` (3, n) starts the search.

    ProjectionError if the iteration does not end.
    """
    n = y.shape[1]
    active = Active(np.zeros((3, n), np.intp), np.zeros((3, n)), np.zeros((3, n)))
    if guess is not None:
        active = _choose(y, planes, guess, STARTS)
    best = active.energy()
    todo, point = np.arange(n), y - active.shift
    for _ in range(MAX_ROUNDS):
        excess = planes.excess(point)
        worst = excess.argmax(axis=1)
        out = np.flatnonzero(excess[np.arange(len(worst)), worst] > TOLERANCE)
        todo, worst = todo[out], worst[out]
        if not todo.size:
            return active
        trial = _choose(y[:, todo], planes, np.vstack([active.index[:, todo], worst[None]]), UPDATES)
        energy = trial.energy()
        grows = np.flatnonzero(energy > best[todo])  # no growth: the excess is rounding
        todo = todo[grows]
        best[todo] = energy[grows]
        active.index[:, todo] = trial.index[:, grows]
        active.factor[:, todo] = trial.factor[:, grows]
        active.shift[:, todo] = trial.shift[:, grows]
        point = y[:, todo] - active.shift[:, todo]
    raise ProjectionError(f"{len(todo)} closest points not found in {MAX_ROUNDS} rounds: use fewer, more distinct rows")


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _cross(a: Array, b: Array) -> Array:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _choose(y: Array, planes: Planes, index: Index, subsets: tuple[tuple[int, ...], ...]) -> Active:
    """The best of the subsets of the half-spaces index (k, n): largest dual energy with multipliers >= 0."""
    slots, n = index.shape
    N = [planes.rows[:3, column] for column in index]
    v = [_dot(N[k], y) + planes.rows[3, index[k]] for k in range(slots)]
    best, chosen = np.zeros(n), np.zeros(n, np.intp)
    factor, shift = np.zeros((slots, n)), np.zeros((3, n))
    for number, subset in enumerate(subsets):
        dual, s, solvable = _dual_basis([N[a] for a in subset], [v[a] for a in subset])
        trial = [_dot(vector, s) for vector in dual]
        for x in trial:
            solvable &= x >= 0.0
        energy = 0.5 * _dot(s, s)
        better = np.flatnonzero(solvable & (energy > best))
        best[better], chosen[better], shift[:, better] = energy[better], number, s[:, better]
        factor[:, better] = 0.0
        for a, x in zip(subset, trial, strict=True):
            factor[a, better] = x[better]
    picks = np.array([(*subset, *[a for a in range(slots) if a not in subset])[:3] for subset in subsets])
    pick, points = picks[chosen].T, np.arange(n)
    return Active(index[pick, points], factor[pick, points], shift)


def _dual_basis(N: list[Array], v: list[Array]) -> tuple[list[Array], Array, NDArray[np.bool_]]:
    """Vectors dual to one to three normals (3, n) in their span, the shift s with n_k.s = v_k, and whether they exist.

    Vector products keep the digits that the Gram matrix of nearly parallel normals would square away.
    """
    if len(N) == 1:
        size = _dot(N[0], N[0])
        dual = [N[0] / size]
        solvable = v[0] > 0.0
    elif len(N) == 2:
        c = _cross(N[0], N[1])
        size = _dot(c, c)
        solvable = size > DEGENERATE**2 * _dot(N[0], N[0]) * _dot(N[1], N[1])
        c = c / np.where(solvable, size, 1.0)
        dual = [_cross(N[1], c), _cross(c, N[0])]
    else:
        dual = [_cross(N[1], N[2]), _cross(N[2], N[0]), _cross(N[0], N[1])]
        det = _dot(N[0], dual[0])
        scale = _dot(N[0], N[0]) * _dot(N[1], N[1]) * _dot(N[2], N[2])
        solvable = det * det > DEGENERATE**2 * scale
        det = np.where(solvable, det, 1.0)
        dual = [vector / det for vector in dual]
    s = v[0] * dual[0]
    for x, vector in zip(v[1:], dual[1:], strict=True):
        s = s + x * vector
    return dual, s, solvable


def respond(E: Array, planes: Planes, metric: Metric, guess: Index | None = None) -> Response:
    """Elastic answer at E (n, 3) beyond the half-spaces, block by block; `guess` (3, n) as in `project`."""
    n = len(E)
    energy, S, C, E_star = np.empty(n), np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3))
    for start in range(0, n, BLOCK):
        part = slice(start, start + BLOCK)
        y = metric.R @ E[part].T
        active = project(y, planes, None if guess is None else guess[:, part])
        shift = active.shift
        energy[part] = active.energy()
        S[part] = ((metric.R.T @ shift) / WEIGHT[:, None]).T
        E_star[part] = (metric.inverse @ (y - shift)).T
        C[part] = _tangent(active, planes, metric)
    return Response(energy, S, C, E_star)


def _tangent(active: Active, planes: Planes, metric: Metric) -> Array:
    """dS/dE (n, 3, 3): the stiffness seen through the span of the active normals, by Gram-Schmidt."""
    n = active.index.shape[1]
    P = np.zeros((3, 3, n))
    basis: list[Array] = []
    for k in range(3):
        u = planes.rows[:3, active.index[k]] * (active.factor[k] > 0.0)
        for _ in range(2 if k else 0):  # twice is enough
            for b in basis:
                u = u - (b[0] * u[0] + b[1] * u[1] + b[2] * u[2]) * b
        length = np.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
        u = u / np.where(length > 0.0, length, 1.0)
        basis.append(u)
        for i in range(3):
            for j in range(3):
                P[i, j] += u[i] * u[j]
    Q = np.einsum("ki,lj,kln->nij", metric.R, metric.R, P, optimize=True)
    return Q / WEIGHT[:, None]
