"""Polyhedra in strain space: closest points in the metric of a stiffness, vertices, support function.

Closest points are found for many points at once, by exact active sets.

With Q = W M symmetric positive definite, M the stiffness in tensor components and W = diag(1, 2, 1), the energy beyond
locking is 1/2 (E - E*).Q (E - E*). Q = R^T R turns strains into y = R E, where this is half the squared distance, and
half-spaces S_i:E <= h_i into n_i.y <= h_i. At most as many are active as y has components: three, or four where
half-spaces are widened by tau, S_i:E - g_i tau <= h_i (`homogenize.laws.giving`). Each round adds the half-space that
is violated most and keeps the best of the subsets that hold it; their dual energies are compared, which grow from
round to round, so no active set returns and the iteration ends.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from homogenize.laws.protocol import Response
from rve.common import Array, Index, InputError, NotConverged
from rve.common.tensor import WEIGHT, dyad, trace

BLOCK = 64
"""Points compared with all half-spaces at a time: few enough to stay in the cache, many enough to hide Python. They
share one buffer: fresh ones take five times as long."""


@dataclass(frozen=True)
class ProjectionOptions:
    """Numbers of the projection. tolerance: strain above which a half-space is violated, where rounding of S:E is a few
    1e-16. dependent: distance from the span of others at which a normal depends on them. max_rounds: limit of rounds,
    in each of which a half-space joins.
    """

    tolerance: float = 1e-13
    dependent: float = 1e-9
    max_rounds: int = 300


OPTIONS = ProjectionOptions()


class ProjectionError(NotConverged):
    """The iteration did not end: half-spaces almost repeat each other, or the stiffness is nearly singular."""


@dataclass(frozen=True, eq=False)
class Polyhedron:
    """Half-spaces planes.E <= h prepared for projection: planes (m, k), h (m,), R (k, k) of y = R E; k is 3, or 4 with
    tau.
    """

    planes: Array
    h: Array
    R: Array

    @cached_property
    def inverse(self) -> Array:
        """E = inverse y, (k, k)."""
        return np.asarray(np.linalg.inv(self.R))

    @cached_property
    def normals(self) -> Array:
        """n of n.y <= h, (m, k)."""
        return np.asarray(self.planes @ self.inverse)

    def worst(self, E: Array) -> tuple[Index, Array]:
        """Most violated half-space and its excess over h at E (n, k), each (n,)."""
        # Multiplications at a time at most: from twice as many on OpenBLAS wakes its threads, which beside another
        # program took ten times as long.
        rows = min(BLOCK, max(1, 2**18 // self._columns.size))
        index, excess, space = np.empty(len(E), np.intp), np.empty(len(E)), np.empty((rows, len(self.h)))
        E = np.column_stack([E, np.ones(len(E))])
        for start in range(0, len(E), rows):
            part = slice(start, start + rows)
            over = np.matmul(E[part], self._columns, out=space[: len(E[part])])
            index[part] = over.argmax(axis=1)
            excess[part] = over[np.arange(len(over)), index[part]]
        return index, excess

    @cached_property
    def _columns(self) -> Array:
        """planes and -h by columns (k + 1, m): times (E, 1) the excess over h."""
        return np.vstack([self.planes.T, -self.h])


def polyhedron_of(S: Array, h: Array, stiffness: Array, extra: Array | None = None) -> Polyhedron:
    """Half-spaces S (m, 3), h (m,), widened by extra (m,) per tau, in the metric of a stiffness (3, 3) in tensor
    components, W M symmetric positive definite.
    """
    R: Array = np.asarray(np.linalg.cholesky(WEIGHT[:, None] * stiffness).T)
    if extra is None:
        return Polyhedron(S * WEIGHT, h, R)
    four = np.eye(4)
    four[:3, :3] = R
    return Polyhedron(np.column_stack([S * WEIGHT, -extra]), h, four)


def respond(E: Array, body: Polyhedron) -> Response:
    """Elastic answer at E (n, 3) beyond the half-spaces; E_star is the strain of the closest point."""
    y = E @ body.R[:, :3].T
    shift, span = project(y, body)
    C = (body.R.T @ span @ body.R)[:, :3, :3] / WEIGHT[:, None]
    S = (shift @ body.R)[:, :3] / WEIGHT
    return Response(0.5 * (shift**2).sum(axis=1), S, C, ((y - shift) @ body.inverse.T)[:, :3])


def project(y: Array, body: Polyhedron, options: ProjectionOptions = OPTIONS) -> tuple[Array, Array]:
    """The way (n, k) from the closest points to y (n, k), and the projector (n, k, k) on the active normals.

    ProjectionError if the iteration does not end.
    """
    n, k = y.shape
    shift, span = np.zeros((n, k)), np.zeros((n, k, k))
    index, factor = np.zeros((n, k), np.intp), np.zeros((n, k))
    todo = np.arange(n)
    for _ in range(options.max_rounds):
        worst, excess = body.worst((y[todo] - shift[todo]) @ body.inverse.T)
        is_active = ((index[todo] == worst[:, None]) & (factor[todo] > 0.0)).any(axis=1)
        out = (excess > options.tolerance) & ~is_active
        todo, worst = todo[out], worst[out]
        if not todo.size:
            return shift, span
        best = _best_subset(y[todo], body, index[todo], factor[todo], worst, options.dependent)
        grows = (best[0] ** 2).sum(axis=1) > (shift[todo] ** 2).sum(axis=1)  # no growth: the excess is rounding
        todo = todo[grows]
        for array, values in zip((shift, span, index, factor), best, strict=True):
            array[todo] = values[grows]
    rounds = options.max_rounds
    raise ProjectionError(f"{len(todo)} closest points not found in {rounds} rounds: use fewer, more distinct rows")


def _best_subset(
    y: Array, body: Polyhedron, index: Index, old: Array, new: Index, dependent: float
) -> tuple[Array, Array, Index, Array]:
    """Shift, projector, half-spaces and multipliers of the best subset of index (n, k) that holds `new` (n,).

    `old` (n, k) are the multipliers of `index`; idle ones take no part.
    """
    n, k = y.shape
    shift, span = np.zeros((n, k)), np.zeros((n, k, k))
    best, factor, energy = np.repeat(new[:, None], k, axis=1), np.zeros((n, k)), np.zeros(n)
    for subset in (list(some) for size in range(k) for some in combinations(range(k), size)):
        rows = np.flatnonzero((old[:, subset] > 0.0).all(axis=1))
        if not len(rows):
            continue
        which = np.column_stack([index[rows][:, subset], new[rows]])
        N = body.normals[which].transpose(0, 2, 1)
        Q, R = np.linalg.qr(N)
        good = (np.abs(np.einsum("nkk->nk", R)) > dependent * np.linalg.norm(N, axis=1)).all(axis=1)
        R = np.where(good[:, None, None], R, np.eye(R.shape[1]))
        excess = np.einsum("nik,ni->nk", N, y[rows]) - body.h[which]
        across = np.linalg.solve(R.transpose(0, 2, 1), excess[:, :, None])
        multiplier = np.linalg.solve(R, across)[:, :, 0]
        s = (Q @ across)[:, :, 0]
        work = (s**2).sum(axis=1)
        good &= (multiplier >= 0.0).all(axis=1) & (work > energy[rows])
        to, size = rows[good], which.shape[1]
        shift[to], energy[to], span[to] = s[good], work[good], (Q @ Q.transpose(0, 2, 1))[good]
        best[to], factor[to] = new[to, None], 0.0
        best[to, :size], factor[to, :size] = which[good], multiplier[good]
    return shift, span, best, factor


def fibres(count: int) -> Array:
    """v v^T (count, 3) of unit vectors v at even angles over half a turn, from the first axis on."""
    angle = np.pi * np.arange(count) / count
    return dyad(np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def highest(S: Array, points: Array) -> Array:
    """max over points E_k (m, 3) of S:E_k for S (n, 3), (n,), in blocks that stay small."""
    weighted = np.ascontiguousarray((points * WEIGHT).T)
    return np.concatenate([(block @ weighted).max(axis=1) for block in np.array_split(S, len(S) // 4096 + 1)])


def outer_vertices(S: Array, h: Array, beyond: float = 0.0) -> Array:
    """Vertices (m, 3) of {S_i:E <= h_i, v.(I + 2E) v >= -2 beyond}: S (n, 3), h (n,)."""
    from scipy.spatial import HalfspaceIntersection, QhullError

    # Vectors v of v.(I + 2E) v >= 0, which every deformation obeys.
    V = fibres(180)
    normals = np.vstack([S * WEIGHT, -V * WEIGHT])
    limits = np.concatenate([h, 0.5 * trace(V) + beyond])
    inside = feasible_point(normals, limits)
    try:
        polyhedron = HalfspaceIntersection(np.column_stack([normals, -limits]), inside)
    except QhullError as error:
        raise InputError(f"the rows' half-spaces enclose no volume: {str(error).splitlines()[0]}") from error
    vertices = polyhedron.intersections
    if not np.isfinite(vertices).all():
        raise InputError("the rows' loads do not bound the strain under tension: add load directions to the table")
    return np.unique(np.round(vertices, 13), axis=0)


def feasible_point(normals: Array, limits: Array) -> Array:
    """Centre (3,) of the largest ball in {normals E <= limits}, as the half-space intersection needs it."""
    from scipy.optimize import linprog

    lengths = np.linalg.norm(normals, axis=1)
    ranges = [(None, None)] * 3 + [(0.0, None)]
    answer = linprog([0.0, 0.0, 0.0, -1.0], np.column_stack([normals, lengths]), limits, bounds=ranges)
    if answer.status == 3:
        raise InputError("the rows' loads do not bound the strain under tension: add load directions to the table")
    if answer.status != 0 or answer.x[3] <= 1e-9:
        raise InputError("the rows' half-spaces enclose no strain: the rows contradict each other")
    return np.asarray(answer.x[:3])
