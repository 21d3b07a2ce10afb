"""A Newton step of a finite mesh: exact where it can be, convex and stiffer where it has to be.

A large mesh always has a few rings with negative curvature and a few contacts that would close at the beginning of a
step. At a small mu only these are changed, so that all others keep their exact equations and the step its length.

A change of k weights in a matrix A with a factor needs k more solutions instead of another factor: by Woodbury's
formula (A + U C U^T)^-1 b = x - Y (C^-1 + U^T Y)^-1 U^T x with x = A^-1 b and Y = A^-1 U.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.optimize import nnls

from rve.common import Array, Index
from rve.common.factor import Factorizer, Solve
from rve.finite.equations import METRIC, PAIR, block_diagonal, blocks, lacking, rows_of
from rve.finite.passage import safe_parts
from rve.finite.task import BLOCK, State, Task

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
    along it, stiffness of contacts, and a function that solves with its matrix for the u motions of the task."""

    q: Array
    dgap: Array
    dforce: Array
    safe: Array
    slope: float
    stiff: Array
    solve: Solve


class Iteration:
    """The equations of an iterate, and its Newton step.

    start, state: the iterate, and the same with what is raised until the step is good: damping, local, convex, extra;
    stiff (m,): stiffness of contacts; push (u,): right-hand side; barrier: its function here; is_moving: whether held
    rings are on their way; trials, factors, failed: counts.

    The matrix for the u motions of the task is S^T (blocks + weights) S. S (7 f + 5 n, u) leads from motions to the
    coordinates of the f pairs that are felt and to all unknowns; R to the m gaps as well, whose extra stiffness is one
    of pairs.
    """

    def __init__(self, state: State, task: Task, G: Array, factorize: Factorizer) -> None:
        con, mu, most = state.touching, state.contact_mu, float(state.mu.max())
        self.start, self.state, self.task, self.con, self._G, self._factorize = state, state, task, con, G, factorize
        self.stiff = (state.force + mu / con.reach) / con.gap
        self._blocks = blocks(con, G, self.stiff, state.force, _IDLE * mu)
        self._lacking = np.full_like(self._blocks, np.nan)
        way = task.way_left(con.placed)
        far = float(np.sqrt((way**2).sum(axis=1)).max(initial=0.0))
        self.is_moving = far > 0.0
        self._held = np.pad(way * min(1.0, _WAY / max(far, 1e-300)), ((0, 0), (0, BLOCK - 3)))
        # Damping is measured in the force that a pair carries: pairs near supports need more of it.
        carried = np.bincount(con.minima.pair, state.force, minlength=len(con.key))
        self._heavy = np.maximum(carried, 0.1 * con.greater(state.mu) * np.isin(con.key, task.keys))
        self.barrier = task.barrier(con, state.mu)
        self._felt = np.flatnonzero((con.count > 0) | (self._heavy > 0.0))  # the others stay out of the matrix
        unit = np.broadcast_to(np.eye(PAIR), (len(self._felt), PAIR, PAIR))
        pairs, gaps = rows_of(con, self._felt, unit), rows_of(con, con.minima.pair, G[:, None])
        pairs.eliminate_zeros()
        self._S, self._R_gaps = sparse.vstack([pairs @ task.motions, task.motions], "csr"), gaps @ task.motions
        self._S_T, self._R = self._S.T.tocsr(), sparse.vstack([self._S, self._R_gaps], "csr")
        self._moved, self._closed = np.append(pairs @ self._held.ravel(), self._held), gaps @ self._held.ravel()
        _, pull, self._soft = task.springs(con.placed, most)
        pull[:, :3] += task.force
        self.push = self._R_gaps.T @ (mu * (1.0 / con.gap - 1.0 / con.reach)) + task.motions.T @ pull.ravel()
        self.trials = self.factors = self.failed = self._turns = 0
        self._factor: Solve
        self._last: State
        self._answers: dict[int, Array]

    def step(self) -> Step | None:
        """The step of the damped equations, with less negative curvature where their matrix is not positive definite.

        Where few pairs would make the step short, they are made stiffer. None where no damping is enough.
        """
        con, state = self.con, self.start
        while True:
            solve, push = self._solver()
            if solve is None:
                if self.state.damping > 1e8:
                    return None
                continue
            y = solve(push)
            q = self._held + (self.task.motions @ y).reshape(self._held.shape)
            dgap = self._R_gaps @ y + self._closed
            safe = safe_parts(con, q)
            if self._turns >= _TURNS or not self._is_short(safe, dgap):
                break
        stiff = self.stiff + self.state.extra
        dforce = (state.contact_mu * (1.0 - con.gap / con.reach) - state.force * con.gap) / con.gap - stiff * dgap
        return Step(q, dgap, dforce, safe, -float(self.push @ y), stiff, solve)

    def answer(self, step: Step, force: Array) -> Array:
        """How rings move (n, 5) by the matrix of a step under contact forces (m,)."""
        return np.asarray(self.task.motions @ step.solve(self._R_gaps.T @ force)).reshape(-1, BLOCK)

    def _solver(self) -> tuple[Solve | None, Array]:
        """A function that solves with the matrix, None where it is not positive definite, and the right-hand side (u,).

        The last factor serves again where few weights have grown since.
        """
        weight = self._weights(self.state)
        if self.factors > self.failed and not self.is_moving and np.array_equal(self.state.convex, self._last.convex):
            added = weight - self._weights(self._last)
            rows = np.flatnonzero(added)
            if len(rows) <= _RANK:
                return self._stiffened(rows, added[rows]), self.push
        stiff = block_diagonal(self._pairs(), weight[: len(self._moved)])
        push = self.push - self._S_T @ (stiff @ self._moved)
        factor = self._factorize((self._S_T @ (stiff @ self._S)).tocsc())
        self.factors += 1
        if not callable(factor):
            self.failed += 1
            self._convexify(self.task.motions[:, factor].nonzero()[0] // BLOCK)
            return None, push
        self._factor, self._last, self._answers = factor, self.state, {}
        return factor, push

    def _columns(self, rows: Index) -> Array:
        """A^-1 R^T (u, k) of rows of R, each found once, where A is the matrix that has the last factor."""
        new = np.setdiff1d(rows, [*self._answers])
        if len(new):
            self._answers |= zip(new.tolist(), self._factor(self._R[new].T.toarray()).T, strict=True)
        return np.stack([self._answers[row] for row in rows.tolist()], axis=1)

    def _stiffened(self, rows: Index, weight: Array) -> Solve:
        """A function that solves with A + R^T diag(weight) R of rows (k,) of R, A as in `_columns`."""
        solve, own = self._factor, self._R[rows]
        if not len(rows):
            return solve
        Y = self._columns(rows)
        small = np.diag(1.0 / weight) + own @ Y

        def solved(push: Array) -> Array:
            x = solve(push)
            return x - Y @ np.linalg.solve(small, own @ x)

        return solved

    def _weights(self, state: State) -> Array:
        """The weights (7 f + 5 n + m,) of the rows of R."""
        damped = np.outer((self._heavy * (state.damping + state.local))[self._felt], METRIC)
        soft = self._soft.ravel() + _SOFT + 1e-6 * state.damping
        return np.concatenate([damped.ravel(), soft, state.extra])

    def _pairs(self) -> Array:
        """Blocks (f, 7, 7) of the matrix with the extra stiffness, and a part of their negative curvature left out."""
        convex, extra, out = self.state.convex, self.state.extra, self._blocks.copy()
        rows = np.flatnonzero(convex)
        new = rows[np.isnan(self._lacking[rows, 0, 0])]
        self._lacking[new] = lacking(self._blocks[new])
        out[rows] += convex[rows, None, None] * self._lacking[rows]
        rows = np.flatnonzero(extra)
        G = self._G[rows]
        np.add.at(out, self.con.minima.pair[rows], extra[rows, None, None] * G[:, :, None] * G[:, None, :])
        return out[self._felt]

    def _convexify(self, rings: Index) -> None:
        """Leave out more of the negative curvature where a factor has failed at `rings`; damp where none is left.

        At a large mu folds form all over the mesh; later few rings are to blame, and the others keep their exact
        matrix. Where they are not few, all pairs lose negative curvature until the factor no longer fails.
        """
        con, state, felt = self.con, self.state, self._felt
        if state.convex.min() >= 1.0:
            self.state = replace(state, damping=max(1e-3, 5.0 * state.damping))
        elif state.mu.max() >= _FINE or self.failed > _LOCAL or np.mean(state.convex > 0.0) > _MANY:
            self.state = replace(state, convex=np.minimum(1.0, np.maximum(0.2, 3.0 * state.convex)))
        else:
            near = np.zeros(len(con.placed.x), dtype=bool)
            near[rings] = True
            for _ in range(2 * self.failed):
                touched = felt[near[con.a[felt]] | near[con.b[felt]]]
                near[con.a[touched]] = near[con.b[touched]] = True
            self.state = replace(state, convex=np.where(near[con.a] & near[con.b], 1.0, state.convex))

    def _is_short(self, safe: Array, dgap: Array) -> bool:
        """Whether some pairs or contacts would make the step, of safe parts (p,) and change of gaps (m,), short.

        They are stiffer then; few contacts at a small mu just so much that they stay open.
        """
        state, last = self.state, self._last
        with np.errstate(divide="ignore", invalid="ignore"):
            open_ = np.where(dgap < 0.0, -self.con.gap / dgap, np.inf)
        nearest, tight = open_.min(initial=1.0), safe < _SHORT
        if not tight.any() and nearest > _CLOSING[-1]:
            return False
        if safe.min() < 0.1 and 0.0 < state.convex.max() < 1.0:
            self._turns += 2
            self.state = replace(state, convex=np.ones_like(state.convex))
            return True
        if state.mu.max() < _FINE and not (self.is_moving or tight.any() or (state.local > last.local).any()):
            for part in _CLOSING:
                rows = np.flatnonzero((open_ < part) | (state.extra > last.extra))
                if len(rows) <= _RANK:
                    self._turns += 1
                    self._stop(rows)
                    return True
        if not tight.any() and nearest > _SHORT:
            return False
        self._turns += 2
        local = np.where(tight, np.maximum(4.0 * state.local, 0.2), state.local)
        stiffer = self.stiff * np.minimum(0.7 / open_, 100.0)
        extra = np.where(open_ < 1.2 * _SHORT, state.extra + stiffer, state.extra)
        self.state = replace(state, local=local, extra=extra)
        return True

    def _stop(self, contacts: Index) -> None:
        """Stiffen contacts (k,) just so much that the step closes no more than a part of their gaps."""
        room, extra = _CLOSED * self.con.gap[contacts], self._last.extra.copy()
        R, Y = self._R_gaps[contacts], self._columns(len(self._moved) + contacts)
        extra[contacts] += forces_that_stop(R @ Y, -room - R @ self._factor(self.push)) / room
        self.state = replace(self.state, extra=extra)


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
