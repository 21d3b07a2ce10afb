"""A Newton step of a finite mesh: equations, direction, line search.

Forces and matrix are exact, symmetric and sparse, with one block per pair of rings. The unknowns of a ring are its
centre (3) and two tilts about the axes of its tangent frame, `BLOCK` = 5 numbers. A gap depends on d = x_b - x_a (3)
and on the tilts theta_a, theta_b (2 each) of its pair, `PAIR` = 7 numbers, in which the blocks of pairs are kept.

A large mesh always has a few rings with negative curvature and a few contacts that would close at the beginning of a
step. At a small mu only these are changed, so that all others keep their exact equations and the step its length.

A change of k weights in a matrix A with a factor takes k more solutions in place of another factor: by Woodbury's
formula (A + U C U^T)^-1 b = x - Y (C^-1 + U^T Y)^-1 U^T x with x = A^-1 b and Y = A^-1 U.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.optimize import nnls

from rve.common import Array, Flags, Index
from rve.common.factor import Factorizer, Solve
from rve.finite.contacts import (
    MeshContacts,
    find_rows,
    is_passage_safe,
    links_intact,
    safe_fractions,
    track_gaps,
)
from rve.finite.problem import BLOCK, Iterate, ScaledProblem
from rve.finite.walls import wall_derivatives
from rve.finite.wide import NO_WIDE
from rve.geometry.contacts import distance_gradient, distance_hessian
from rve.geometry.ring_pair import Minima, tangent_frame

PAIR = 7
METRIC = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.5])
"""Weights (7,) of the squares of d, theta_a, theta_b in the damping of a pair."""
_CHUNK = 2048
"""Pairs whose blocks are made together: they stay in the cache of a processor."""


@dataclass(frozen=True, eq=False)
class Step:
    """A Newton step: q (n, 5) of the rings, linear changes of gaps (m,) and forces (m,), safe fraction (p,) of the step
    for each pair, slope of the barrier function, stiffness (m,) of contacts, solver with its matrix (u, u)."""

    q: Array
    dgap: Array
    dforce: Array
    safe: Array
    slope: float
    stiff: Array
    solve: Solve


class NewtonSystem:
    """The Newton equations of an iterate.

    start: the iterate; iterate: the same with its damping, local, convex and extra, which are increased until the step
    is acceptable; stiff (m,): stiffness of contacts; push (u,): right-hand side; barrier: the barrier function;
    is_moving: whether supports are not yet at their places; trials, factors, failed: counts.

    The matrix for the u motions of the problem is S^T (blocks + weights) S. S (7 f + 5 n, u) maps motions to the
    coordinates of the f coupled pairs and to all unknowns; R maps them to the m gaps as well.
    """

    def __init__(self, iterate: Iterate, problem: ScaledProblem, G: Array, factorize: Factorizer) -> None:
        con, mu, most = iterate.contacts, iterate.contact_mu, float(iterate.mu.max())
        self.start = self.iterate = iterate
        self.problem, self.con, self._G, self._factorize = problem, con, G, factorize
        self.method = problem.method.step
        self.stiff = (iterate.force + mu / con.reach) / con.gap
        self._blocks = blocks(con, G, self.stiff, iterate.force)
        self._missing = np.full_like(self._blocks, np.nan)
        way = problem.way_left(con.pose)
        far = float(np.sqrt((way**2).sum(axis=1)).max(initial=0.0))
        self.is_moving = far > 0.0
        self._held = np.pad(way * min(1.0, self.method.travel / max(far, 1e-300)), ((0, 0), (0, BLOCK - 3)))
        # Damping is relative to the force of a pair: pairs near supports need more of it.
        carried = np.bincount(con.minima.pair, iterate.force, minlength=len(con.key))
        self._scale = np.maximum(carried, 0.1 * con.pair_max(iterate.mu) * np.isin(con.key, problem.keys))
        self.barrier = problem.barrier(con, iterate.mu)
        self._coupled = np.flatnonzero((con.count > 0) | (self._scale > 0.0))  # others have no block
        unit = np.broadcast_to(np.eye(PAIR), (len(self._coupled), PAIR, PAIR))
        pairs, gaps = rows_of(con, self._coupled, unit), rows_of(con, con.minima.pair, G[:, None])
        pairs.eliminate_zeros()
        self._S, self._R_gaps = sparse.vstack([pairs @ problem.motions, problem.motions], "csr"), gaps @ problem.motions
        self._S_T, self._R = self._S.T.tocsr(), sparse.vstack([self._S, self._R_gaps], "csr")
        self._held_moves, self._held_gaps = np.append(pairs @ self._held.ravel(), self._held), gaps @ self._held.ravel()
        _, pull, self._soft = problem.springs(con.pose, most)
        pull[:, :3] += problem.force
        self.push = self._R_gaps.T @ (mu * (1.0 / con.gap - 1.0 / con.reach)) + problem.motions.T @ pull.ravel()
        self.trials = self.factors = self.failed = self._turns = 0
        self._factor: Solve
        self._last: Iterate
        self._solutions: dict[int, Array]

    @property
    def is_swinging(self) -> bool:
        """Whether turns of single rings are limited."""
        return self.problem.wide and self._is_fine

    @property
    def _is_fine(self) -> bool:
        """Whether mu is so small that single contacts and rings are treated one by one."""
        return float(self.iterate.mu.max()) < self.problem.method.ring_mu

    def step(self) -> Step | None:
        """The step of the damped equations, with less negative curvature where their matrix is not positive definite.

        Pairs and contacts that would make the step short are stiffened. None if no damping is enough.
        """
        con, iterate = self.con, self.start
        swings: list[tuple[Array, Array]] = []
        while True:
            solve, push = self._solver()
            if solve is None:
                if self.iterate.damping > 1e8:
                    return None
                continue
            y = solve(push)
            q = self._held + (self.problem.motions @ y).reshape(self._held.shape)
            dgap = self._R_gaps @ y + self._held_gaps
            if self._limit_turns(q, swings):
                continue
            safe = safe_fractions(con, q)
            if self._turns >= self.method.turns or not self._stiffen_limiting(safe, dgap):
                break
        stiff = self.stiff + self.iterate.extra
        dforce = (iterate.contact_mu * (1.0 - con.gap / con.reach) - iterate.force * con.gap) / con.gap - stiff * dgap
        return Step(q, dgap, dforce, safe, -float(self.push @ y), stiff, solve)

    def _limit_turns(self, q: Array, swings: list[tuple[Array, Array]]) -> bool:
        """Stiffen the tilts of single rings that turn farther than they may; whether there are some.

        Between two taut contacts next to nothing turns a joining ring back. The inverse of its turn is linear in its
        stiffness, for which the last of `swings`, stiffness and turn (n,) of all rings, has a second point.
        """
        stiff, turn, most = self.iterate.swing, norm_of_tilts(q), self.iterate.turn
        far = (turn > 1.5 * most) & self.is_swinging
        if not far.any() or len(swings) > self.method.turns:
            return False
        new = np.maximum(stiff, 1e-8) * turn / most
        if swings:
            with np.errstate(divide="ignore", invalid="ignore"):
                slope = (1.0 / turn - 1.0 / swings[-1][1]) / (stiff - swings[-1][0])
                known = slope > 0.0
                secant = stiff + (1.0 / most - 1.0 / turn) / slope
            new = np.where(known, np.clip(secant, 1.5 * stiff, 1e4 * np.maximum(stiff, 1e-8)), new)
        swings.append((stiff, turn))
        self.iterate = replace(self.iterate, swing=np.where(far, new, stiff))
        return True

    def answer(self, step: Step, force: Array) -> Array:
        """Displacements (n, 5) of the rings by the matrix of a step under contact forces (m,)."""
        return np.asarray(self.problem.motions @ step.solve(self._R_gaps.T @ force)).reshape(-1, BLOCK)

    def _solver(self) -> tuple[Solve | None, Array]:
        """A solver with the matrix, None if it is not positive definite, and the right-hand side (u,).

        The last factor is used again if few weights have grown since.
        """
        weight = self._weights(self.iterate)
        if self.factors > self.failed and not self.is_moving and np.array_equal(self.iterate.convex, self._last.convex):
            added = weight - self._weights(self._last)
            rows = np.flatnonzero(added)
            if len(rows) <= self.method.rank:
                return self._stiffened(rows, added[rows]), self.push
        stiff = block_diagonal(self._pairs(), weight[: len(self._held_moves)])
        push = self.push - self._S_T @ (stiff @ self._held_moves)
        factor = self._factorize((self._S_T @ (stiff @ self._S)).tocsc())
        self.factors += 1
        if not callable(factor):
            self.failed += 1
            self._convexify(self.problem.motions[:, factor].nonzero()[0] // BLOCK)
            return None, push
        self._factor, self._last, self._solutions = factor, self.iterate, {}
        return factor, push

    def _columns(self, rows: Index) -> Array:
        """A^-1 R^T (u, k) of rows (k,) of R, where A is the matrix of the last factor; each is solved for once."""
        new = np.setdiff1d(rows, [*self._solutions])
        if len(new):
            self._solutions |= zip(new.tolist(), self._factor(self._R[new].T.toarray()).T, strict=True)
        return np.stack([self._solutions[row] for row in rows.tolist()], axis=1)

    def _stiffened(self, rows: Index, weight: Array) -> Solve:
        """A solver with A + R^T diag(weight) R of rows (k,) of R, A as in `_columns`."""
        solve, R = self._factor, self._R[rows]
        if not len(rows):
            return solve
        Y = self._columns(rows)
        small = np.diag(1.0 / weight) + R @ Y

        def solve_updated(push: Array) -> Array:
            x = solve(push)
            return x - Y @ np.linalg.solve(small, R @ x)

        return solve_updated

    def _weights(self, iterate: Iterate) -> Array:
        """The weights (7 f + 5 n + m,) of the rows of R."""
        damped = np.outer((self._scale * (iterate.damping + iterate.local))[self._coupled], METRIC)
        soft = self._soft + np.outer(iterate.swing, [0.0, 0.0, 0.0, 1.0, 1.0])
        soft = soft.ravel() + self.method.regularisation + 1e-6 * iterate.damping
        return np.concatenate([damped.ravel(), soft, iterate.extra])

    def _pairs(self) -> Array:
        """Blocks (f, 7, 7) of coupled pairs, with the extra stiffness and without a fraction of negative curvature."""
        convex, extra, out = self.iterate.convex, self.iterate.extra, self._blocks.copy()
        rows = np.flatnonzero(convex)
        new = rows[np.isnan(self._missing[rows, 0, 0])]
        self._missing[new] = negative_part(self._blocks[new])
        out[rows] += convex[rows, None, None] * self._missing[rows]
        rows = np.flatnonzero(extra)
        G = self._G[rows]
        np.add.at(out, self.con.minima.pair[rows], extra[rows, None, None] * G[:, :, None] * G[:, None, :])
        return out[self._coupled]

    def _convexify(self, rings: Index) -> None:
        """Leave out more of the negative curvature after a factor has failed at `rings`; damp if none is left.

        At a large mu folds form all over the mesh, and all pairs lose negative curvature until the factor exists. At a
        small mu only pairs near `rings` do, unless they are many.
        """
        con, iterate, coupled = self.con, self.iterate, self._coupled
        if iterate.convex.min() >= 1.0:
            self.iterate = replace(iterate, damping=max(1e-3, 5.0 * iterate.damping))
        elif not self._is_fine or np.mean(iterate.convex > 0.0) > self.method.many:
            self.iterate = replace(iterate, convex=np.minimum(1.0, np.maximum(0.2, 3.0 * iterate.convex)))
        else:
            near = np.zeros(len(con.pose.x), dtype=bool)
            near[rings] = True
            for _ in range(2 * self.failed):
                touched = coupled[near[con.a[coupled]] | near[con.b[coupled]]]
                near[con.a[touched]] = near[con.b[touched]] = True
            self.iterate = replace(iterate, convex=np.where(near[con.a] & near[con.b], 1.0, iterate.convex))

    def _stiffen_limiting(self, safe: Array, dgap: Array) -> bool:
        """Stiffen pairs and contacts that limit the step; whether there are some.

        safe (p,): safe fractions of the step; dgap (m,): change of the gaps. At a small mu few contacts are stiffened
        just enough to stay open.
        """
        iterate, last, short = self.iterate, self._last, self.method.short
        with np.errstate(divide="ignore", invalid="ignore"):
            open_ = np.where(dgap < 0.0, -self.con.gap / dgap, np.inf)
        nearest, tight = open_.min(initial=1.0), safe < short
        if not tight.any() and nearest > self.method.closing[-1]:
            return False
        if safe.min() < 0.1 and 0.0 < iterate.convex.max() < 1.0:
            self._turns += 2
            self.iterate = replace(iterate, convex=np.ones_like(iterate.convex))
            return True
        if self._is_fine and not (self.is_moving or tight.any() or (iterate.local > last.local).any()):
            for part in self.method.closing:
                rows = np.flatnonzero((open_ < part) | (iterate.extra > last.extra))
                if len(rows) <= self.method.rank:
                    self._turns += 1
                    self._stop(rows)
                    return True
        if not tight.any() and nearest > short:
            return False
        self._turns += 2
        local = np.where(tight, np.maximum(4.0 * iterate.local, 0.2), iterate.local)
        stiffer = self.stiff * np.minimum(0.7 / open_, 100.0)
        extra = np.where(open_ < 1.2 * short, iterate.extra + stiffer, iterate.extra)
        self.iterate = replace(iterate, local=local, extra=extra)
        return True

    def _stop(self, contacts: Index) -> None:
        """Stiffen contacts (k,) just enough that the step closes no more than a fraction of their gaps."""
        room, extra = self.method.closed * self.con.gap[contacts], self._last.extra.copy()
        R, Y = self._R_gaps[contacts], self._columns(len(self._held_moves) + contacts)
        extra[contacts] += forces_that_stop(R @ Y, -room - R @ self._factor(self.push)) / room
        self.iterate = replace(self.iterate, extra=extra)


def forces_that_stop(S: Array, missing: Array) -> Array:
    """Forces f >= 0 (k,) that keep gaps open: S f >= missing, f (S f - missing) = 0, S (k, k) positive semidefinite.

    They are a nonnegative least-squares problem with a square root of S.
    """
    scale = 1.0 / np.sqrt(np.diag(S))
    values, vectors = np.linalg.eigh(0.5 * (S + S.T) * scale[:, None] * scale)
    root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))  # two contacts side by side are the same but for rounding
    try:
        force = nnls(root[:, None] * vectors.T, vectors.T @ (scale * missing) / root)[0]
    except RuntimeError:  # nnls cycles between such contacts: each force alone is enough
        force = np.maximum(scale * missing, 0.0)
    return np.asarray(scale * force)


def line_search(system: NewtonSystem, step: Step, *, is_last: bool) -> tuple[MeshContacts | None, float]:
    """Contacts after the longest acceptable fraction of a step, and the fraction.

    None if pairs whose gaps would close were damped instead, for another step; not if it `is_last`.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        closing = np.where(step.dgap < 0.0, -system.method.farthest * system.con.gap / step.dgap, 1.0)
    length = min(1.0, float(step.safe.min()), float(closing.min(initial=1.0)))
    new, iterate = None, system.iterate
    while length > 1e-9:
        new, closed = _try_fraction(system, step, length)
        if new is not None:
            break
        if len(closed) and not is_last:
            # All pairs are damped if one that closes was not near before.
            rows = find_rows(system.con.key, closed)
            near, local, damping = rows[rows >= 0], iterate.local.copy(), iterate.damping
            turn = length * norm_of_tilts(step.q)
            ends = np.union1d(system.con.a[near], system.con.b[near])
            ends = ends[turn[ends] > system.method.turned] if system.is_swinging else ends[:0]
            if len(ends):
                most = iterate.turn.copy()
                most[ends] = np.minimum(most[ends], 0.25 * turn[ends])
                system.iterate = replace(iterate, turn=most)
                return None, 0.0
            local[near] = np.maximum(30.0 * local[near], 5.0)
            if len(near) < len(closed):
                damping = max(4.0 * damping, 1e-2)
            system.iterate = replace(iterate, local=local, damping=damping)
            return None, 0.0
        length *= 0.5
    # That of wide contacts grows to 1 / gap, and must have gone before the residual counts as stagnant.
    fade = 0.1 if system.problem.wide else 0.4
    local = np.where(step.safe < 0.5, np.maximum(2.0 * iterate.local, 0.1), fade * iterate.local)
    system.iterate = replace(iterate, local=np.where(local < 1e-3, 0.0, local))
    return new, length


def norm_of_tilts(q: Array) -> Array:
    """Angles (n,) by which rings turn in a step q (n, 5)."""
    return np.asarray(np.hypot(q[:, 3], q[:, 4]))


def _try_fraction(system: NewtonSystem, step: Step, length: float) -> tuple[MeshContacts | None, Index]:
    """Contacts after a fraction of a step, None if it is not acceptable, and keys of the pairs whose gaps would close.

    Gaps smaller than their linear forecast are corrected with the factor of the step.
    """
    con, problem = system.con, system.problem
    q, forecast = length * step.q, con.gap + length * step.dgap
    before = np.minimum(con.deepest, con.reach)
    least = system.method.least * before[con.minima.pair]
    closed: Index = con.key[:0]
    for turn in range(system.method.corrections):
        system.trials += 1
        pose = con.pose.moved(q)
        gap = track_gaps(con, pose)
        last, closed = closed, np.unique(con.key[con.minima.pair[gap < least]])
        if not len(closed):
            break
        if turn and len(closed) >= len(last):
            return None, closed
        q = q + system.answer(step, -step.stiff * np.minimum(gap - forecast, 0.0))
    else:
        return None, closed
    new = problem.find(pose, con.reach, con)
    row = find_rows(con.key, new.key)
    closed = new.key[new.deepest < system.method.least * np.where(row >= 0, before[row], con.reach)]
    is_good = not len(closed) and is_passage_safe(con, new, q) and links_intact(new, problem.keys)
    is_good = is_good and (system.is_moving or _decreases(system, new, length * step.slope))
    return new if is_good else None, closed


def _decreases(system: NewtonSystem, new: MeshContacts, slope: float) -> bool:
    """Whether the barrier function decreases sufficiently (Armijo), to rounding.

    Of pairs whose contacts have changed in number or kind only the deepest contact counts, and by mu less.
    """

    def beyond_deepest(con: MeshContacts) -> Array:
        total = np.bincount(con.minima.pair, con.barrier(con.gap), minlength=len(con.key))
        return np.asarray(total - con.barrier(con.deepest))

    old, mu = system.con, system.iterate.mu
    row = find_rows(old.key, new.key)
    is_other = np.isin(new.key, old.wide_keys) != np.isin(new.key, new.wide_keys)
    changed = (row >= 0) & ((old.count[row] != new.count) | is_other) & (old.count[row] > 0) & (new.count > 0)
    excess = (beyond_deepest(new) - beyond_deepest(old)[row])[changed]
    after = system.problem.barrier(new, mu) - float(new.pair_max(mu)[changed] @ (excess + is_other[changed]))
    return after <= system.barrier + 1e-4 * slope + 1e-11 * (1.0 + abs(system.barrier))


def gradients(con: MeshContacts) -> Array:
    """Derivative (m, 7) of each gap with respect to d, theta_a, theta_b of its pair."""
    out = _point_gradients(con, con.minima)
    if con.pose.walls:
        out[con.at_wall] = _wall_derivatives(con, np.flatnonzero(con.at_wall))[0]
    shares = con.wide.shares(con.gap)[:, None]
    out[con.wide.rows] = con.wide.sums(shares * _point_gradients(con, con.wide.points))
    return out


def _point_gradients(con: MeshContacts, points: Minima) -> Array:
    """Derivative (k, 7) of distances at points of rings by the coordinates of their pairs."""
    g, pair = distance_gradient(points), points.pair
    frame = np.stack(tangent_frame(con.pose.normal), axis=2)
    tilt_a = (g[:, 3:6, None] * frame[con.a[pair]]).sum(axis=1)
    return np.concatenate([g[:, :3], tilt_a, (g[:, 6:9, None] * frame[con.b[pair]]).sum(axis=1)], axis=1)


def spread_out(iterate: Iterate, dforce: Array, dgap: Array, q: Array) -> Iterate:
    """The iterate with wide contacts at their points, and forces after linear changes of forces, gaps (m,) and places
    q (n, 5): the share of a point grows by p + 1 times what g grows more than the gap there."""
    con, force, wide = iterate.contacts, iterate.force, iterate.contacts.wide
    row, points = wide.contact, wide.points
    dpoint = rows_of(con, points.pair, _point_gradients(con, points)[:, None]) @ q.ravel()
    change = dforce[row] / force[row] + (wide.power + 1) * (dgap[row] / con.gap[row] - dpoint / wide.gap)
    out = force[row] * wide.shares(con.gap) * (1.0 + change)
    keep, plain = out > 1e-13, ~con.is_wide
    minima = con.minima.take(plain).join([points.take(keep)])
    order = np.argsort(minima.pair, kind="stable")
    fixed = np.append(con.fixed[plain], np.ones(keep.sum(), dtype=bool))[order]
    gap, force = np.append(con.gap[plain], wide.gap[keep])[order], np.append((force + dforce)[plain], out[keep])[order]
    new = replace(con, minima=minima.take(order), fixed=fixed, gap=gap, wide=NO_WIDE)
    return replace(iterate, contacts=new, force=force, extra=np.zeros(len(force)))


def _wall_derivatives(con: MeshContacts, rows: Index) -> tuple[Array, Array]:
    """First and second derivatives of the gaps of contacts `rows`, all with half-spaces or balls."""
    pair = con.minima.pair[rows]
    return wall_derivatives(*con.pose.at_walls(con.a[pair], con.b[pair], con.wire))


def rows_of(con: MeshContacts, pair: Index, v: Array) -> sparse.csr_matrix:
    """Derivatives (k r, 5 n) by all unknowns, from derivatives v (k, r, 7) by the coordinates of pairs `pair` (k,)."""
    by_a = np.concatenate([-v[..., :3], v[..., 3:5]], axis=2)
    by_b = np.concatenate([v[..., :3], v[..., 5:]], axis=2)
    values = np.stack([by_a, by_b], axis=1).reshape(-1, v.shape[1], BLOCK)
    columns = np.stack([con.a[pair], con.b[pair]], axis=1).ravel()
    shape = len(pair) * v.shape[1], BLOCK * len(con.pose.x)
    return sparse.bsr_matrix((values, columns, 2 * np.arange(len(pair) + 1)), shape=shape).tocsr()


def spread(con: MeshContacts, G: Array, force: Array) -> Array:
    """Generalised forces (n, 5) of contact forces (m,): sum of G^T force."""
    return np.asarray(rows_of(con, con.minima.pair, G[:, None]).T @ force).reshape(-1, BLOCK)


def block_diagonal(pairs: Array, weight: Array) -> sparse.csr_matrix:
    """The matrix (k, k) with blocks (p, 7, 7) on the first part of its diagonal, plus diag(weight) of weights (k,)."""
    rows, end = np.arange(len(pairs) + 1), PAIR * len(pairs)
    out = sparse.bsr_matrix((pairs, rows[:-1], rows), shape=(end, end)).tocsr()
    out.resize(len(weight), len(weight))
    return out + sparse.diags(weight, format="csr")


def blocks(con: MeshContacts, G: Array, stiff: Array, force: Array) -> Array:
    """Blocks (p, 7, 7) of the pairs: sum of stiff G G^T - force d2(gap).

    Of wide contacts d2(g) = sum share_k (d2(gap_k) - (p+1) gap_k (r_k - r)(r_k - r)^T), r_k = d(gap_k) / gap_k, where r
    = dg/g is the mean of r_k weighted with share_k gap_k.
    """
    first = np.searchsorted(con.minima.pair, np.arange(len(con.key) + 1))
    out = np.zeros((len(con.key), PAIR, PAIR))
    frame, wide = np.stack(tangent_frame(con.pose.normal), axis=2), con.is_wide
    for part in range(0, len(con.key), _CHUNK):
        ends = first[part : part + _CHUNK + 1]
        rows = np.arange(ends[0], ends[-1])
        per = (stiff[rows, None] * G[rows])[:, :, None] * G[rows, None, :]
        curved = np.flatnonzero(force[rows] * ~wide[rows])
        per[curved] -= force[rows[curved], None, None] * _curvatures(con, rows[curved], frame)
        add = sparse.csr_matrix((np.ones(len(rows)), rows - ends[0], ends - ends[0]), shape=(len(ends) - 1, len(rows)))
        out[part : part + _CHUNK] = (add @ per.reshape(-1, PAIR**2)).reshape(-1, PAIR, PAIR)
    at, points = con.wide, con.wide.points
    weight = force[at.contact] * at.shares(con.gap)
    rate = _point_gradients(con, points) / at.gap[:, None] - (G / con.gap[:, None])[at.contact]
    bent = (at.power + 1) * at.gap[:, None, None] * rate[:, :, None] * rate[:, None, :]
    bent -= _point_curvatures(con, points, frame, np.ones(len(at.gap), dtype=bool))
    out[con.minima.pair[at.rows]] += at.sums(weight[:, None, None] * bent)
    return out


def _curvatures(con: MeshContacts, rows: Index, frame: Array) -> Array:
    """Second derivatives (k, 7, 7) of the gaps of contacts `rows` (k,); frame (n, 3, 2) of each ring."""
    second = _point_curvatures(con, con.minima.take(rows), frame, con.fixed[rows])
    if con.pose.walls:
        at_wall = con.at_wall[rows]
        second[at_wall] = _wall_derivatives(con, rows[at_wall])[1]
    return second


def _point_curvatures(con: MeshContacts, points: Minima, frame: Array, fixed: Flags) -> Array:
    """Second derivatives (k, 7, 7) of distances at points, on ring a where `fixed` (k,), else at minima."""
    a, b, normal = con.a[points.pair], con.b[points.pair], con.pose.normal
    H = distance_hessian(points, normal[a], normal[b], fixed)
    B = np.zeros((len(a), 9, PAIR))
    B[:, [0, 1, 2], [0, 1, 2]] = 1.0
    B[:, 3:6, 3:5], B[:, 6:9, 5:7] = frame[a], frame[b]
    return np.asarray(np.matmul(B.transpose(0, 2, 1), np.matmul(H, B)))


def negative_part(pairs: Array) -> Array:
    """The least addition (p, 7, 7) that makes each block (p, 7, 7) positive semidefinite.

    Least in the unknowns of the two rings, where d has the length sqrt(2).
    """
    rows = np.flatnonzero(pairs.any(axis=(1, 2)))
    size = np.sqrt([2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0])
    values, vectors = np.linalg.eigh(pairs[rows] * (size[:, None] * size))
    vectors = vectors / size[:, None]
    out = np.zeros_like(pairs)
    out[rows] = np.matmul(vectors * np.maximum(-values, 0.0)[:, None, :], vectors.transpose(0, 2, 1))
    return out
