"""A Newton step of a finite mesh: exact where it can be, convex and stiffer where it has to be.

A large mesh always has a few rings with negative curvature and a few contacts that would close at the beginning of a
step. At a small mu only these are changed, so that all others keep their exact equations and the step its length.

A change of rank k in a matrix A with a factor needs k more solutions instead of another factor: by Woodbury's formula
(A + U C U^T)^-1 b = x - Y (C^-1 + U^T Y)^-1 U^T x with x = A^-1 b and Y = A^-1 U.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.optimize import nnls

from rve.common import Array, Index
from rve.common.factor import Factorizer, Solve
from rve.finite.equations import METRIC, PAIR, Pattern, blocks, lacking, pair_vectors, spread, times
from rve.finite.task import BLOCK, State, Task
from rve.finite.touching import Touching, safe_parts

_WAY = 3.0
"""Largest way of a held ring in one iteration, in r1."""
_SOFT = 1e-10
"""Stiffness of every coordinate: rings that nothing touches stay where they are."""
_IDLE = 1e-6
"""Contacts with less force than this part of mu do without curvature."""
_TURNS = 6
"""Times contacts are stiffened before a step is taken; those with another factor count twice."""
_SHORT = 0.3
"""Part of a step that counts as short."""
_RANK = 64
"""Largest rank of what is added to a matrix without another factor."""
_CLOSING = (1.0, 0.75, 0.5)
"""Contacts that close before these parts of a step are stiffened, the fewer the more there are."""
_FINE = 1e-4
"""mu below which single contacts and single rings are to blame for short steps and negative curvature."""
_LOCAL = 4
"""Times a factor may fail before negative curvature is left out everywhere."""
_MANY = 0.5
"""Part of the pairs with less negative curvature from which on failures are not told apart."""
_CLOSED = 0.8
"""Part of its gap that such a contact may close."""


@dataclass(frozen=True, eq=False)
class Step:
    """A Newton step q (n, 5), forecast of the gaps and forces, part (p,) that is safe, slope of the barrier function
    along it, stiffness of contacts, and a function that solves with its matrix."""

    q: Array
    dgap: Array
    dforce: Array
    safe: Array
    slope: float
    stiff: Array
    solve: Solve


@dataclass
class Added:
    """What is on top of the exact matrix: damping, local, convex as in `State`, stiffness `extra` (m,) of contacts."""

    damping: float
    local: Array
    convex: Array
    extra: Array


class Iteration:
    """The equations of an iterate, and its Newton step.

    G (m, 7): gradients of the gaps; stiff (m,): stiffness of contacts; rhs (n, 5): right-hand side, 0 for what is not
    free; barrier: its function here; is_moving: whether held rings are on their way; added: what the matrix has on top
    of the exact one, which is raised until the step is good; trials, factors, failed: counts.
    """

    def __init__(self, state: State, task: Task, G: Array, factorize: Factorizer) -> None:
        con, mu, most = state.touching, state.contact_mu, float(state.mu.max())
        self.state, self.task, self.con, self.G, self._factorize = state, task, con, G, factorize
        self.stiff = (state.force + mu / con.reach) / con.gap
        _, pull, self._soft = task.springs(con.placed, most)
        self._soft += _SOFT
        rhs = spread(con, G, mu * (1.0 / con.gap - 1.0 / con.reach))
        rhs[:, :3] += task.force
        self.rhs = np.where(task.free, rhs + pull, 0.0)
        self._blocks = blocks(con, G, self.stiff, state.force, _IDLE * mu)
        self._lacking = np.full_like(self._blocks, np.nan)
        way = task.way_left(con.placed)
        far = float(np.sqrt((way**2).sum(axis=1)).max(initial=0.0))
        self.is_moving = far > 0.0
        self._held = np.zeros_like(rhs)
        self._held[:, :3] = way * min(1.0, _WAY / max(far, 1e-300))
        # Damping is measured in the force that a pair carries: pairs near supports need more of it.
        carried = np.bincount(con.minima.pair, state.force, minlength=len(con.key))
        self._heavy = np.maximum(carried, 0.1 * con.greater(state.mu) * np.isin(con.key, task.keys))
        self.barrier = task.barrier(con, state.mu)
        felt = (con.count > 0) | (self._heavy > 0.0)  # pairs without contact stay out of the pattern
        self._pattern = Pattern.of(con, felt, task.free, task.tie)
        self.added = Added(state.damping, state.local.copy(), state.convex.copy(), np.zeros(len(con.gap)))
        self.trials = self.factors = self.failed = self._turns = 0
        self._factored: Factored
        self._last: Added

    def step(self) -> Step | None:
        """The step of the damped equations, with less negative curvature where their matrix is not positive definite.

        Where few pairs would make the step short, they are made stiffer. None where no damping is enough.
        """
        con, state = self.con, self.state
        while True:
            solve, push = self._solver()
            if solve is None:
                if self.added.damping > 1e8:
                    return None
                continue
            q = solve(push) + self._held
            dgap = self._closing(q)
            safe = safe_parts(con, q)
            if self._turns >= _TURNS or not self._is_short(safe, dgap):
                break
        stiff = self.stiff + self.added.extra
        dforce = (state.contact_mu * (1.0 - con.gap / con.reach) - state.force * con.gap) / con.gap - stiff * dgap
        return Step(q, dgap, dforce, safe, -float((self.rhs * q).sum()), stiff, solve)

    def _closing(self, q: Array) -> Array:
        """Change (m,) of the gaps in a step, to first order."""
        return np.asarray((self.G * pair_vectors(self.con, q)[self.con.minima.pair]).sum(axis=1))

    def _solver(self) -> tuple[Solve | None, Array]:
        """A function that solves with the matrix, None where it is not positive definite, and the right-hand side.

        The last factor serves again where a few pairs have been made stiffer since.
        """
        con, added = self.con, self.added
        if self.factors > self.failed and not self.is_moving:
            last = self._last
            rows = np.flatnonzero(added.extra > last.extra)
            tight = np.flatnonzero(self._heavy * added.local > self._heavy * last.local)
            is_same = last.damping == added.damping and np.array_equal(last.convex, added.convex)
            if is_same and len(rows) + PAIR * len(tight) <= _RANK:
                damped = (self._heavy * (added.local - last.local))[tight]
                names = np.concatenate([rows, (len(con.gap) + PAIR * tight[:, None] + np.arange(PAIR)).ravel()])
                weight = np.concatenate([(added.extra - last.extra)[rows], np.outer(damped, METRIC).ravel()])
                return self._factored.stiffened(names, weight), self.rhs
        pairs = self._pairs()
        push = self.rhs - times(con, pairs, self._held) if self.is_moving else self.rhs
        factor = self._factorize(self._pattern.matrix(pairs, self._soft + 1e-6 * added.damping))
        self.factors += 1
        if not callable(factor):
            self.failed += 1
            self._convexify(self._pattern.rings(factor))
            return None, push
        self._factored = Factored(self._pattern.solver(factor), con, self.G)
        self._last = replace(added, local=added.local.copy(), convex=added.convex.copy(), extra=added.extra.copy())
        return self._factored.solve, push

    def _convexify(self, rings: Index) -> None:
        """Leave out more of the negative curvature where a factor has failed at `rings`; damp where none is left.

        At a large mu folds form all over the mesh; later few rings are to blame, and the others keep their exact
        matrix. Where they are not few, all pairs lose negative curvature until the factor no longer fails.
        """
        con, added, felt = self.con, self.added, self._pattern.felt
        if added.convex.min() >= 1.0:
            added.damping = max(1e-3, 5.0 * added.damping)
        elif self.state.mu.max() >= _FINE or self.failed > _LOCAL or np.mean(added.convex > 0.0) > _MANY:
            added.convex = np.minimum(1.0, np.maximum(0.2, 3.0 * added.convex))
        else:
            near = np.zeros(len(con.placed.x), dtype=bool)
            near[rings] = True
            for _ in range(2 * self.failed):
                touched = felt[near[con.a[felt]] | near[con.b[felt]]]
                near[con.a[touched]] = near[con.b[touched]] = True
            added.convex[near[con.a] & near[con.b]] = 1.0

    def _pairs(self) -> Array:
        """Blocks (p, 7, 7) of the matrix: exact, damped, with a part of their negative curvature left out."""
        out, added = self._blocks.copy(), self.added
        rows = np.flatnonzero(added.convex)
        new = rows[np.isnan(self._lacking[rows, 0, 0])]
        self._lacking[new] = lacking(self._blocks[new])
        out[rows] += added.convex[rows, None, None] * self._lacking[rows]
        np.einsum("pkk->pk", out)[...] += np.outer(self._heavy * (added.damping + added.local), METRIC)
        rows = np.flatnonzero(added.extra)
        G = self.G[rows]
        np.add.at(out, self.con.minima.pair[rows], added.extra[rows, None, None] * G[:, :, None] * G[:, None, :])
        return out

    def _is_short(self, safe: Array, dgap: Array) -> bool:
        """Whether some pairs or contacts would make the step, of safe parts (p,) and change of gaps (m,), short.

        They are stiffer then; few contacts at a small mu just so much that they stay open.
        """
        added, last = self.added, self._last
        with np.errstate(divide="ignore", invalid="ignore"):
            open_ = np.where(dgap < 0.0, -self.con.gap / dgap, np.inf)
        nearest, tight = open_.min(initial=1.0), safe < _SHORT
        if not tight.any() and nearest > _CLOSING[-1]:
            return False
        if safe.min() < 0.1 and 0.0 < added.convex.max() < 1.0:
            self._turns += 2
            added.convex[:] = 1.0
            return True
        if self.state.mu.max() < _FINE and not (self.is_moving or tight.any() or (added.local > last.local).any()):
            for part in _CLOSING:
                rows = np.flatnonzero((open_ < part) | (added.extra > last.extra))
                if len(rows) <= _RANK:
                    self._turns += 1
                    self._stop(rows)
                    return True
        if not tight.any() and nearest > _SHORT:
            return False
        self._turns += 2
        added.local[tight] = np.maximum(4.0 * added.local[tight], 0.2)
        rows = np.flatnonzero(open_ < 1.2 * _SHORT)
        added.extra[rows] += self.stiff[rows] * np.minimum(0.7 / open_[rows], 100.0)
        return True

    def _stop(self, rows: Index) -> None:
        """Stiffen contacts `rows` (k,) just so much that the step closes no more than a part of their gaps."""
        U, Y = self._factored.columns(rows)
        room = _CLOSED * self.con.gap[rows]
        force = forces_that_stop(U.T @ Y, -room - self._closing(self._factored.solve(self.rhs))[rows])
        self.added.extra[rows] = self._last.extra[rows] + force / room


class Factored:
    """A factor of the matrix of a step and how it serves for stiffer contacts and pairs.

    Columns of U are told by names: i < m is the gradient of contact i, m + 7 p + k the coordinate k of pair p.
    """

    def __init__(self, solve: Solve, con: Touching, G: Array) -> None:
        self.solve = solve
        self._con, self._G, self._n = con, G, len(con.placed.x)
        self._names: Index = np.zeros(0, dtype=np.intp)
        self._Y = np.zeros((BLOCK * self._n, 0))

    def columns(self, names: Index) -> tuple[sparse.csc_matrix, Array]:
        """U (5 n, k), sparse, and Y = A^-1 U, each column of which is found once."""
        new = np.setdiff1d(names, self._names)
        if len(new):
            right = self._vectors(new).toarray().reshape(self._n, BLOCK, len(new))
            self._Y = np.concatenate([self._Y, self.solve(right).reshape(-1, len(new))], axis=1)
            self._names = np.concatenate([self._names, new])
        order = np.argsort(self._names)
        return self._vectors(names), self._Y[:, order[np.searchsorted(self._names[order], names)]]

    def _vectors(self, names: Index) -> sparse.csc_matrix:
        con, m = self._con, len(self._G)
        is_contact = names < m
        component = np.where(is_contact, 0, names - m)
        pair = np.where(is_contact, con.minima.pair[np.where(is_contact, names, 0)], component // PAIR)
        v = np.where(is_contact[:, None], self._G[np.where(is_contact, names, 0)], np.eye(PAIR)[component % PAIR])
        a, b, along = BLOCK * con.a[pair, None], BLOCK * con.b[pair, None], np.arange(BLOCK)
        rows = np.concatenate([a + along, b + along], axis=1)
        values = np.concatenate([-v[:, :3], v[:, 3:5], v[:, :3], v[:, 5:]], axis=1)
        first = np.arange(len(names) + 1) * 2 * BLOCK
        return sparse.csc_matrix((values.ravel(), rows.ravel(), first), shape=(BLOCK * self._n, len(names)))

    def stiffened(self, names: Index, weight: Array) -> Solve:
        """A function that solves with A + U diag(weight) U^T, right-hand sides (n, 5); weight (k,) > 0."""
        if not len(names):
            return self.solve
        U, Y = self.columns(names)
        small = np.diag(1.0 / weight) + U.T @ Y

        def solved(push: Array) -> Array:
            x = self.solve(push)
            return x - (Y @ np.linalg.solve(small, U.T @ x.ravel())).reshape(x.shape)

        return solved


def forces_that_stop(S: Array, missing: Array) -> Array:
    """f >= 0 (k,) with S f >= missing and f (S f - missing) = 0, S (k, k) positive semidefinite: what keeps gaps open.

    They are the least squares with f >= 0 of a square root of S.
    """
    scale = 1.0 / np.sqrt(np.diag(S))
    values, vectors = np.linalg.eigh(0.5 * (S + S.T) * scale[:, None] * scale)
    root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))  # two contacts side by side are the same but for rounding
    try:
        force = nnls(root[:, None] * vectors.T, vectors.T @ (scale * missing) / root)[0]
    except RuntimeError:  # its limit of iterations, in cycles between such contacts: each force by itself is enough
        force = np.maximum(scale * missing, 0.0)
    return np.asarray(scale * force)
