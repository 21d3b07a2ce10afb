"""A Newton step of a finite mesh: exact where it can be, convex and stiffer where it has to be.

A large mesh always has a few rings with negative curvature and a few contacts that would close at the beginning of a
step. At a small mu only these are changed, so that all others keep their exact equations and the step its length.
"""

from __future__ import annotations

import numpy as np

from rve.common.types import Array
from rve.finite.equations import BLOCK, PAIR, add_metric, blocks, lacking, metric, pair_vectors, spread, times
from rve.finite.factor import Factorizer, Solve
from rve.finite.iterate import Linear, State, Step, Work, barrier, springs
from rve.finite.passage import safe_parts
from rve.finite.records import FiniteOptions, Task
from rve.finite.system import Factored, Pattern, forces_that_stop
from rve.finite.touching import Index, Touching

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


def linearized(state: State, task: Task, G: Array, options: FiniteOptions) -> Linear:
    """The equations of an iterate whose gaps have the gradients G (m, 7)."""
    con, gap, mu, reach = state.touching, state.touching.gap, state.mu, options.reach
    stiff = (state.force + mu / reach) / gap
    rhs = spread(con, G, mu * (1.0 / gap - 1.0 / reach), len(task.force))
    rhs[:, :3] += task.force
    _, pull, soft = springs(state.placed, task, mu)
    rhs += pull
    soft += _SOFT
    K = blocks(state.placed, con, G, stiff, state.force, _IDLE * mu)
    way = np.where(task.held, task.at - state.placed.x, 0.0)
    far = float(np.sqrt((way**2).sum(axis=1)).max(initial=0.0))
    held = np.zeros((len(way), BLOCK))
    held[:, :3] = way * min(1.0, _WAY / max(far, 1e-300))
    # Damping is measured in the force that a pair carries: pairs near supports need more of it.
    carried = np.bincount(con.minima.pair, state.force, minlength=len(con.key))
    heavy = np.maximum(carried, 0.1 * mu * np.isin(con.key, task.keys))
    value = barrier(state.placed, con, task, mu, reach)
    felt = (con.count > 0) | (heavy > 0.0)  # pairs without contact stay out of the pattern
    pattern = Pattern.of(con, felt, task.free, task.tie)
    return Linear(G, stiff, K, pattern, soft, np.where(task.free, rhs, 0.0), held, heavy, value, mu, far > 0.0)


def newton(
    state: State, task: Task, line: Linear, options: FiniteOptions, factorize: Factorizer, work: Work
) -> Step | None:
    """The step of the damped equations, with less negative curvature where their matrix is not positive definite.

    Where few pairs would make the step short, they are made stiffer.
    """
    con, n, gap = state.touching, len(task.force), state.touching.gap
    while True:
        solve, push = _solver(con, line, factorize, work, n)
        if solve is None:
            if work.damping > 1e8:
                return None
            continue
        q = solve(push) + line.held
        dgap = (line.G * pair_vectors(con, q)[con.minima.pair]).sum(axis=1)
        safe = safe_parts(state.placed, con, q, task.wire, options.reach)
        if work.turns >= _TURNS or not _is_short(con, line, safe, dgap, work):
            break
    stiff = line.stiff + work.extra
    dforce = (state.mu * (1.0 - gap / options.reach) - state.force * gap) / gap - stiff * dgap
    return Step(q, dgap, dforce, safe, -float((line.rhs * q).sum()), stiff, solve)


def _solver(con: Touching, line: Linear, factorize: Factorizer, work: Work, n: int) -> tuple[Solve | None, Array]:
    """A function that solves with the matrix, None where it is not positive definite, and the right-hand side (n, 5).

    The last factor serves again where a few pairs have been made stiffer since.
    """
    last = work.last
    if last is not None and not line.is_moving and last.is_of(work):
        rows = np.flatnonzero(work.extra > last.extra)
        tight = np.flatnonzero(line.heavy * work.local > line.heavy * last.local)
        if len(rows) + PAIR * len(tight) <= _RANK:
            damped = (line.heavy * (work.local - last.local))[tight]
            names = np.concatenate([rows, (len(con.gap) + PAIR * tight[:, None] + np.arange(PAIR)).ravel()])
            weight = np.concatenate([(work.extra - last.extra)[rows], np.outer(damped, metric()).ravel()])
            return last.stiffened(names, weight), line.rhs
    pairs = _pairs(con, line, work)
    push = line.rhs - times(con, pairs, line.held, n) if line.is_moving else line.rhs
    factor = factorize(line.pattern.matrix(pairs, line.soft + 1e-6 * work.damping))
    work.factors += 1
    if not callable(factor):
        work.failed += 1
        _convexify(con, line, line.pattern.rings(factor), work, n)
        return None, push
    work.last = Factored(line.pattern.solver(factor), con, line.G, work, n)
    return work.last.solve, push


def _convexify(con: Touching, line: Linear, rings: Index, work: Work, n: int) -> None:
    """Leave out more of the negative curvature where a factor has failed at `rings`; damp where none is left.

    At a large mu folds form all over the mesh; later few rings are to blame, and the others keep their exact matrix.
    Where they are not few, all pairs lose negative curvature until the factor no longer fails.
    """
    if work.convex.min() >= 1.0:
        work.damping = max(1e-3, 5.0 * work.damping)
    elif line.mu >= _FINE or work.failed > _LOCAL or np.mean(work.convex > 0.0) > _MANY:
        work.convex = np.minimum(1.0, np.maximum(0.2, 3.0 * work.convex))
    else:
        near = np.zeros(n, dtype=bool)
        near[rings] = True
        for _ in range(2 * work.failed):
            touched = line.pattern.felt[near[con.a[line.pattern.felt]] | near[con.b[line.pattern.felt]]]
            near[con.a[touched]] = near[con.b[touched]] = True
        work.convex[near[con.a] & near[con.b]] = 1.0


def _pairs(con: Touching, line: Linear, work: Work) -> Array:
    """Blocks (p, 7, 7) of the matrix: exact, damped, with a part of their negative curvature left out."""
    out = line.blocks.copy()
    rows = np.flatnonzero(work.convex)
    if len(rows):
        if work.lacking is None:
            work.lacking = np.full_like(out, np.nan)
        new = rows[np.isnan(work.lacking[rows, 0, 0])]
        work.lacking[new] = lacking(line.blocks[new])
        out[rows] += work.convex[rows, None, None] * work.lacking[rows]
    add_metric(out, line.heavy * (work.damping + work.local))
    rows = np.flatnonzero(work.extra)
    if len(rows):
        G = line.G[rows]
        np.add.at(out, con.minima.pair[rows], work.extra[rows, None, None] * G[:, :, None] * G[:, None, :])
    return out


def _is_short(con: Touching, line: Linear, safe: Array, dgap: Array, work: Work) -> bool:
    """Whether some pairs or contacts would make the step, of safe parts (p,) and change of gaps (m,), short.

    They are stiffer then; few contacts at a small mu just so much that they stay open.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        open_ = np.where(dgap < 0.0, -con.gap / dgap, np.inf)
    last, nearest, tight = _made(work), open_.min(initial=1.0), safe < _SHORT
    if not tight.any() and nearest > _CLOSING[-1]:
        return False
    if safe.min() < 0.1 and 0.0 < work.convex.max() < 1.0:
        work.turns += 2
        work.convex[:] = 1.0
        return True
    if line.mu < _FINE and not (line.is_moving or tight.any() or (work.local > last.local).any()):
        for part in _CLOSING:
            rows = np.flatnonzero((open_ < part) | (work.extra > last.extra))
            if len(rows) <= _RANK:
                work.turns += 1
                _stop(con, line, rows, work)
                return True
    if not tight.any() and nearest > _SHORT:
        return False
    work.turns += 2
    work.local[tight] = np.maximum(4.0 * work.local[tight], 0.2)
    rows = np.flatnonzero(open_ < 1.2 * _SHORT)
    work.extra[rows] += line.stiff[rows] * np.minimum(0.7 / open_[rows], 100.0)
    return True


def _made(work: Work) -> Factored:
    assert work.last is not None, "a step has a factor"
    return work.last


def _stop(con: Touching, line: Linear, rows: Index, work: Work) -> None:
    """Stiffen contacts `rows` (k,) just so much that the step closes no more than a part of their gaps."""
    last = _made(work)
    U, Y = last.columns(rows)
    pull = (line.G[rows] * pair_vectors(con, last.solve(line.rhs))[con.minima.pair[rows]]).sum(axis=1)
    force = forces_that_stop(U.T @ Y, -_CLOSED * con.gap[rows] - pull)
    work.extra[rows] = last.extra[rows] + force / (_CLOSED * con.gap[rows])
