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

from homogenize.laws.lookup import Envelope, envelope_of
from homogenize.laws.protocol import Response
from rve.common.errors import NotConverged
from rve.common.tensor import WEIGHT
from rve.common.types import Array

Index = NDArray[np.intp]

TOLERANCE = 1e-13
"""A half-space counts as violated above this strain; rounding of S:E is a few 1e-16."""
DEGENERATE = 1e-9
"""Normals that span less than this share of the volume of orthogonal ones count as dependent."""
MAX_ROUNDS = 300
BLOCK = 8192
FEW = 60
"""Up to this many half-spaces are all looked at; more get a map (see `lookup`)."""
UPDATES = ((3,), (0, 3), (1, 3), (2, 3), (0, 1, 3), (0, 2, 3), (1, 2, 3))


class ProjectionError(NotConverged):
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
class Polyhedron:
    """Half-spaces S (m, 3), h (m,) prepared for projection in a metric.

    `rows` (4, m) holds n and -h of n.y <= h; `size` (m,) = n.n; `one` (m, 3, 3) the tangent where a half-space acts
    alone; `envelope` finds the most violated half-space without looking at all of them, None where there are few.
    """

    S: Array
    h: Array
    metric: Metric
    rows: Array
    size: Array
    one: Array
    envelope: Envelope | None

    def worst(self, E: Array) -> tuple[Index, Array]:
        """Most violated half-space and its S:E - h at E (3, n), each (n,)."""
        if self.envelope is not None:
            return self.envelope.highest(E)
        excess = E.T @ (self.S * WEIGHT).T - self.h
        index = excess.argmax(axis=1)
        return index, excess[np.arange(len(index)), index]


def polyhedron_of(S: Array, h: Array, stiffness: Array, box: Array | None = None) -> Polyhedron:
    """Half-spaces S (m, 3), h (m,) in the metric of a stiffness (3, 3); `box` as in `lookup.envelope_of`."""
    metric = metric_of(stiffness)
    rows = np.ascontiguousarray(np.vstack([metric.inverse.T @ (S * WEIGHT).T, -h]))
    size = _dot(rows, rows)
    one = S[:, :, None] * (S * WEIGHT)[:, None, :] / size[:, None, None]
    envelope = envelope_of(S, h, box) if box is not None and len(h) > FEW else None
    return Polyhedron(S, h, metric, rows, size, one, envelope)


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


def project(E: Array, body: Polyhedron) -> Active:
    """Active half-spaces, multipliers and shift of the closest points to E (3, n).

    ProjectionError if the iteration does not end.
    """
    y = body.metric.R @ E
    worst, excess = body.worst(E)
    factor = np.maximum(excess, 0.0) / body.size.take(worst)
    shift = factor * body.rows[:3].take(worst, axis=1)
    none = np.zeros_like(factor)
    active = Active(np.stack([worst] * 3), np.stack([factor, none, none]), shift)
    best = active.energy()
    todo = np.flatnonzero(excess > TOLERANCE)
    for _ in range(MAX_ROUNDS):
        last = active.index[:, todo]
        worst, excess = body.worst(E[:, todo] - body.metric.inverse @ active.shift[:, todo])
        out = np.flatnonzero((excess > TOLERANCE) & ((worst != last[0]) | (active.factor[0, todo] == 0.0)))
        todo = todo[out]
        if not todo.size:
            return active
        trial = _choose(y[:, todo], body, np.vstack([active.index[:, todo], worst[None, out]]), active.factor[:, todo])
        energy = trial.energy()
        grows = np.flatnonzero(energy > best[todo])  # no growth: the excess is rounding
        todo = todo[grows]
        best[todo] = energy[grows]
        active.index[:, todo] = trial.index[:, grows]
        active.factor[:, todo] = trial.factor[:, grows]
        active.shift[:, todo] = trial.shift[:, grows]
    raise ProjectionError(f"{len(todo)} closest points not found in {MAX_ROUNDS} rounds: use fewer, more distinct rows")


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _cross(a: Array, b: Array) -> Array:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _choose(y: Array, body: Polyhedron, index: Index, old: Array) -> Active:
    """The best of the subsets of index (4, n) that hold the last one: largest dual energy with multipliers >= 0.

    `old` (3, n) are the multipliers of the first three; idle ones take no part.
    """
    n = index.shape[1]
    N = [body.rows[:3].take(column, axis=1) for column in index]
    v = [_dot(N[k], y) + body.rows[3].take(index[k]) for k in range(4)]
    idle = [old[k] == 0.0 for k in range(3)]
    best, chosen = np.zeros(n), np.zeros(n, np.intp)
    factor, shift = np.zeros((4, n)), np.zeros((3, n))
    for number, subset in enumerate(UPDATES):
        dual, s, solvable = _dual_basis([N[a] for a in subset], [v[a] for a in subset])
        trial = [_dot(vector, s) for vector in dual]
        for a, x in zip(subset, trial, strict=True):
            solvable &= x >= 0.0
            if a < 3:
                solvable &= ~idle[a]
        energy = 0.5 * _dot(s, s)
        better = np.flatnonzero(solvable & (energy > best))
        best[better], chosen[better], shift[:, better] = energy[better], number, s[:, better]
        factor[:, better] = 0.0
        for a, x in zip(subset, trial, strict=True):
            factor[a, better] = x[better]
    picks = np.array([(*subset, *[a for a in range(4) if a not in subset])[:3] for subset in UPDATES])
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


def respond(E: Array, body: Polyhedron) -> Response:
    """Elastic answer at E (n, 3) beyond the half-spaces, block by block."""
    n = len(E)
    energy, S, C, E_star = np.empty(n), np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3))
    for start in range(0, n, BLOCK):
        part = slice(start, start + BLOCK)
        columns = np.ascontiguousarray(E[part].T)
        active = project(columns, body)
        energy[part] = active.energy()
        S[part] = (body.metric.R.T @ active.shift / WEIGHT[:, None]).T
        E_star[part] = (columns - body.metric.inverse @ active.shift).T
        C[part] = body.one.take(active.index[0], axis=0)
        C[start + np.flatnonzero(active.factor[0] == 0.0)] = 0.0
        several = np.flatnonzero(active.factor[1] + active.factor[2] > 0.0)
        C[start + several] = _tangent(active.index[:, several], active.factor[:, several], body)
    return Response(energy, S, C, E_star)


def _tangent(index: Index, factor: Array, body: Polyhedron) -> Array:
    """dS/dE (n, 3, 3): the stiffness seen through the span of the active normals, by Gram-Schmidt."""
    P = np.zeros((3, 3, index.shape[1]))
    basis: list[Array] = []
    for k in range(3):
        u = body.rows[:3].take(index[k], axis=1) * (factor[k] > 0.0)
        for _ in range(2 if k else 0):  # twice is enough
            for b in basis:
                u = u - _dot(b, u) * b
        length = np.sqrt(_dot(u, u))
        u = u / np.where(length > 0.0, length, 1.0)
        basis.append(u)
        P += u[:, None] * u[None, :]
    R = body.metric.R
    Q = np.tensordot(R.T, np.tensordot(R.T, P, axes=(1, 0)), axes=(1, 1))
    return np.asarray(Q.transpose(2, 0, 1) / WEIGHT[:, None])
