"""The locked strain under a Cauchy load direction: what a law says where the table has a row, or none.

The load follows the deformation: S = J F^-1 s F^-T with F from E by the rotation rule, so S and E are found together.
The pair (E, S), E on the surface and S normal to it, is parametrised by the strain X = E + A S outside (Minty): X moves
smoothly through vertices, where E stands still, and through flat faces, where S does. Newton solves S(X) = load(E(X)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from homogenize.fitting.rows import LockedRows, normality, with_mirror
from homogenize.laws.protocol import MembraneLaw
from homogenize.query.strain_bounds import strain_bounds
from rve.common.errors import InputError
from rve.common.progress import part_of, tell
from rve.common.records import Rows
from rve.common.tensor import IDENTITY, WEIGHT, disc, from_disc, trace
from rve.common.typed import Typed
from rve.common.types import Array

FLAT = 1e-6
"""C = I + 2E with a determinant or side below this is a cell drawn to a line: no load can be pulled back to it."""
RETRIES = (1.0, 3.0, 10.0)
"""Multiples of the offset with which a load that fails is approached on a path."""
SINGULAR = 1e-9
"""Singular values of the Jacobian below this share of the largest count as 0."""
INWARD = 5e-4
"""Loads of rank one are replaced by loads this far inside the tensile cone, because a polyhedral law misses the rim by
2.4e-4; the table also answers with the limit of beta."""
SAME_LOAD = 1e-9
"""A row answers for loads whose unit Cauchy loads differ by less in every component."""
FAR = 10.0
"""Multiple of the offset at which the first guess starts."""


@dataclass(frozen=True)
class StrainOptions(Typed):
    """How the strain under a load is found; InputError for values out of range.

    offset: length of X - E as a strain; a smaller one resolves sharp edges better, a larger one makes the surface
    smoother for Newton. tolerance: largest error of the load direction (unit trace). newton_steps: limit per load.
    path_steps: loads on the way from beta = 45 degrees to a load that fails at first. width: strains under one load
    that differ by more are not one strain; facets between rows are an order smaller.
    """

    offset: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.1
    tolerance: Annotated[float, Meta(ge=0.0, le=1.0)] = 1e-9
    newton_steps: Annotated[int, Meta(ge=1, le=100_000)] = 60
    path_steps: Annotated[int, Meta(ge=1, le=100_000)] = 18
    width: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.05


@dataclass(frozen=True, eq=False)
class LockedStrain:
    """E (n, 3), S (n, 3) of unit trace, `residual` (n,) of the load direction, `unique`, `status`, `iterations` (n,).

    E_min, E_max (n, 3): bounds of the rings' locked strain from the rows of the table, nan if there are no rows.
    status is "converged" or "no_convergence" (the residual says by how much: try a larger offset or more steps).
    unique is false where another strain carries the same load, and where the bounds are wider than the options' width.
    """

    E: Array
    E_min: Array
    E_max: Array
    S: Array
    residual: Array
    unique: NDArray[np.bool_]
    status: NDArray[np.str_]
    iterations: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class _Search:
    """What stays the same during a search: the law, its options, and the trace of S (N/mm) in X = E + A S."""

    law: MembraneLaw
    options: StrainOptions
    scale: float


@dataclass(frozen=True, eq=False)
class _Evaluation(Rows):
    """One evaluation at X (n, 3): surface strain, residual (n, 3) and its Jacobian (n, 3, 3)."""

    X: Array
    E: Array
    S: Array
    r: Array
    J: Array

    def size(self) -> Array:
        return np.abs(self.r).max(axis=1)


def locked_strain(
    law: MembraneLaw,
    alpha_deg: Array,
    beta_deg: Array,
    options: StrainOptions | None = None,
    rows: LockedRows | None = None,
) -> LockedStrain:
    """Locked strain and load under the principal angle alpha and the ratio angle beta, in degrees, arrays (n,).

    With the `rows` of the table behind the law the answer has bounds (a tenth of a second per load), and a load that is
    a row's own gets this row's strain. Without them the answer is the law's alone.
    Starts where the load on the undeformed cell would lock; loads that fail are approached from beta = 45 degrees.
    """
    options = options or StrainOptions()
    if not law.compliance.any():
        raise InputError(f"kind = {law.name}: the law is inextensible, its strain is 0 under every tensile load")
    alpha, beta = np.broadcast_arrays(np.atleast_1d(np.asarray(alpha_deg, float)), np.atleast_1d(beta_deg))
    beta = np.asarray(beta, float)
    search = _Search(law, options, options.offset / float(np.abs(law.compliance @ [0.5, 0.0, 0.5]).max()))
    state, steps = _newton(search, alpha, beta, _start(search, alpha, beta))
    for factor in RETRIES:
        failed = np.flatnonzero(state.size() > options.tolerance)
        if not failed.size:
            break
        wider = replace(search, scale=factor * search.scale)
        start = _start(wider, alpha[failed], np.full(len(failed), 45.0))
        again, more = _walk(wider, alpha[failed], beta[failed], start)
        steps[failed] += more
        better = again.size() < state.size()[failed]
        state = state.put(failed[better], again.take(better))
    good = state.size() <= options.tolerance
    S = state.S / np.where(good, trace(state.S), 1.0)[:, None]
    unique = face_width(law, S) < options.width
    status = np.where(good, "converged", "no_convergence")
    unknown = np.full(S.shape, np.nan)
    found = LockedStrain(state.E, unknown, unknown, S, state.size(), unique, status, steps)
    return found if rows is None else _with_rows(found, rows, alpha, beta, options.width)


def _with_rows(found: LockedStrain, rows: LockedRows, alpha: Array, beta: Array, width: float) -> LockedStrain:
    """The answer with the bounds that follow from the rows; a row's own load gets the row's strain and flag."""
    from rve import cauchy_line_load

    s, both, slack = cauchy_line_load(alpha, beta), with_mirror(rows), -normality(rows).slack
    same = np.abs(s[:, None] - _cauchy_load(both)).max(axis=2)
    at, row = np.flatnonzero(same.min(axis=1) < SAME_LOAD), same.argmin(axis=1)
    row = row[at]
    alone = both.unique[row]
    low, high = np.empty(s.shape), np.empty(s.shape)
    open_ = np.setdiff1d(np.arange(len(s)), at[alone])
    bounds = strain_bounds(rows, s[open_])
    low[open_], high[open_] = bounds.E_min, bounds.E_max
    low[at[alone]] = high[at[alone]] = both.E[row[alone]]
    E, S, residual, status = found.E.copy(), found.S.copy(), found.residual.copy(), found.status.copy()
    unique = found.unique & ((high - low).max(axis=1) < width)
    E[at], S[at], unique[at], residual[at], status[at] = both.E[row], both.S[row], alone, 0.0, "converged"
    low[at], high[at] = np.fmin(low[at], E[at]) - slack, np.fmax(high[at], E[at]) + slack
    return replace(found, E=E, E_min=low, E_max=high, S=S, residual=residual, unique=unique, status=status)


def _cauchy_load(rows: LockedRows) -> Array:
    """Unit Cauchy loads (n, 3) of the rows, F S F^T scaled to s:s = 1."""
    from rve import cauchy_of

    s = cauchy_of(rows.S, rows.E)
    return np.asarray(s / np.sqrt((s * s) @ WEIGHT)[:, None])


def face_width(law: MembraneLaw, S: Array, step: float = 2e-3) -> Array:
    """Width of the set of strains that lock under loads within `step` of S (n, 3), (n,): second difference of h.

    The loads turn about S at constant size, and grow or shrink in their ratio where S is far enough from rank one.
    """
    x = disc(S)
    radius = np.maximum(np.hypot(x[:, 0], x[:, 1]), 1e-12)[:, None]
    turn = np.stack([-x[:, 1], x[:, 0]], axis=1) / radius
    x = x / np.maximum(radius / (1.0 - 1e-9), 1.0)
    h = law.support(from_disc(x))
    width = np.zeros(len(S))
    for way in (turn, x / radius):
        ahead, behind = x + step * way, x - step * way
        inside = np.hypot(ahead[:, 0], ahead[:, 1]) <= (1.0 if way is not turn else 1.1)
        ends = [y / np.maximum(np.hypot(y[:, 0], y[:, 1]), 1.0)[:, None] for y in (ahead, behind)]
        bend = (law.support(from_disc(ends[0])) + law.support(from_disc(ends[1])) - 2.0 * h) / step
        width = np.maximum(width, np.where(inside, bend, 0.0))
    return width


def _start(search: _Search, alpha: Array, beta: Array) -> Array:
    """X (n, 3) of the strain that locks under the load at the undeformed cell, seen from far along its normal."""
    from rve import cauchy_line_load

    S = search.scale * _load(np.zeros((len(alpha), 3)), cauchy_line_load(alpha, beta))
    away = S @ search.law.compliance.T
    return search.law.response(FAR * away).E_star + away


def _evaluate(search: _Search, s: Array, X: Array) -> _Evaluation:
    """Residual S/scale - load(E) of unit trace and its derivative with respect to X."""
    answer, step = search.law.response(X), 1e-6
    E, S = answer.E_star, answer.S
    sides = [(_load(E + step * e, s), _load(E - step * e, s)) for e in np.eye(3)]
    d_load = np.stack([(ahead - behind) / (2.0 * step) for ahead, behind in sides], axis=-1)
    dE = np.eye(3) - search.law.compliance @ answer.C
    return _Evaluation(X, E, S, S / search.scale - _load(E, s), answer.C / search.scale - d_load @ dE)


def _load(E: Array, s: Array) -> Array:
    """Direction of the second Piola-Kirchhoff load at E, unit trace, (n, 3), kept `INWARD` from the rim of the cone."""
    from rve import deformation_gradient, second_pk

    S = second_pk(deformation_gradient(_possible(E)), s)
    x = disc(S / trace(S)[:, None])
    radius = np.hypot(x[:, 0], x[:, 1])
    return from_disc(x * ((1.0 - INWARD) / np.maximum(radius, 1.0 - INWARD))[:, None])


def _possible(E: Array) -> Array:
    """E (n, 3), drawn towards zero where I + 2E is not positive definite: only trial steps of Newton get there."""
    scale = np.ones(len(E))
    for _ in range(60):
        C = 2.0 * scale[:, None] * E + IDENTITY
        bad = (C[:, 0] <= FLAT) | (C[:, 2] <= FLAT) | (C[:, 0] * C[:, 2] - C[:, 1] ** 2 <= FLAT)
        if not bad.any():
            break
        scale[bad] *= 0.8
    return scale[:, None] * E


def _newton(search: _Search, alpha: Array, beta: Array, X: Array) -> tuple[_Evaluation, NDArray[np.int64]]:
    """Damped Newton from X (n, 3), least-norm steps where the strain is not unique; last state and steps taken."""
    from rve import cauchy_line_load

    options, s = search.options, cauchy_line_load(alpha, beta)
    state = _evaluate(search, s, X)
    steps = np.zeros(len(X), np.int64)
    for _ in range(options.newton_steps):
        todo = np.flatnonzero(state.size() > options.tolerance)
        if not todo.size:
            break
        tell(f"strains under {len(X)} loads", 1.0 - todo.size / len(X))
        steps[todo] += 1
        dX = -np.einsum("nij,nj->ni", np.linalg.pinv(state.J[todo], rcond=SINGULAR), state.r[todo])
        dX *= np.minimum(1.0, 0.3 / np.maximum(np.abs(dX).max(axis=1), 1e-300))[:, None]
        state = _line_search(search, s, state, todo, dX)
    return state, steps


def _walk(search: _Search, alpha: Array, beta: Array, X: Array) -> tuple[_Evaluation, NDArray[np.int64]]:
    """Newton along a path of loads from beta = 45 degrees, where it starts at X (n, 3), to beta.

    The steps get shorter towards the end, because strains change fast at beta = 0.
    """
    steps = np.zeros(len(X), np.int64)
    for turn, left in enumerate(np.linspace(1.0, 0.0, search.options.path_steps + 1) ** 3):
        share = turn / (search.options.path_steps + 1)
        with part_of("loads that failed, again along a path", share, share):
            state, more = _newton(search, alpha, beta + left * (45.0 - beta), X)
        X, steps = state.X, steps + more
    return state, steps


def _line_search(search: _Search, s: Array, state: _Evaluation, todo: NDArray[np.int64], dX: Array) -> _Evaluation:
    """Halves the step until the residual falls; after six halvings takes the last one, to leave a corner."""
    length, waiting = 1.0, np.arange(len(todo))
    before = state.size()[todo]
    for half in range(7):
        trial = _evaluate(search, s[todo[waiting]], state.X[todo[waiting]] + length * dX[waiting])
        ok = (trial.size() < (1.0 - 1e-4 * length) * before[waiting]) | (half == 6)
        state = state.put(todo[waiting[ok]], trial.take(ok))
        waiting, length = waiting[~ok], 0.5 * length
        if not waiting.size:
            break
    return state
