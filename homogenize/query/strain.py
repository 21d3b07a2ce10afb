"""The locked strain under a Cauchy load direction: what a law says where the table has a row, or none.

The load follows the deformation: S = J F^-1 s F^-T with F from E by the rotation rule, so S and E are found together.
The pair (E, S), E on the surface and S normal to it, is parametrised by the strain X = E + A S outside (Minty): X moves
smoothly through vertices, where E stands still, and through flat faces, where S does. Newton solves S(X) = load(E(X)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from homogenize.fitting.rows import Rows, normality, with_mirror
from homogenize.laws.protocol import MembraneLaw
from homogenize.query.strain_bounds import strain_bounds
from rve.common.tensor import IDENTITY, WEIGHT, disc, from_disc, trace
from rve.common.types import Array

FLAT = 1e-6
"""C = I + 2E with a determinant or side below this is a cell drawn to a line: no load can be pulled back to it."""


INWARD = 5e-4
"""A polyhedral law misses the rim of the tensile cone by 2.4e-4: a load of rank one is approached from inside, as the
limit of beta, which is also how the table answers where the strain under such a load is not unique."""

RETRIES = (1.0, 3.0, 10.0)
"""Multiples of the offset with which a failed point is walked to from beta = 45 degrees: larger is smoother."""

WIDTH = 0.05
"""Strains under one load that differ by more are not one strain; facets between rows are an order smaller."""

SAME_LOAD = 1e-9
"""A row answers for load directions whose unit Cauchy loads differ by less in every component."""

FAR = 10.0
"""Multiple of the offset from which the closest strain is the one that locks under the normal."""


@dataclass(frozen=True)
class StrainOptions:
    """`offset`: length of X - E as a strain; `tolerance` on the load direction (unit trace); iteration limits.

    A small offset resolves sharp edges better, a large one makes the surface smoother for Newton.
    """

    offset: float = 0.1
    tolerance: float = 1e-9
    newton_steps: int = 60
    path_steps: int = 18
    singular: float = 1e-9


@dataclass(frozen=True, eq=False)
class LockedStrain:
    """E (n, 3), S (n, 3) of unit trace, `residual` (n,) of the load direction, `unique`, `status`, `iterations` (n,).

    E_min, E_max (n, 3): bounds of the rings' locked strain from the rows of the table, nan if no rows were given.
    status is "converged" or "no_convergence" (the residual says by how much: try a larger offset or more steps).
    unique is false where another strain carries the same load, and where the bounds are too wide to tell (`WIDTH`).
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
class _State:
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
    rows: Rows | None = None,
) -> LockedStrain:
    """Locked strain and load under the principal angle alpha and the ratio angle beta, in degrees, arrays (n,).

    With the `rows` of the table behind the law the answer has bounds (a tenth of a second per load), and a load that is
    a row's own gets this row's strain. Without them the answer is the law's alone.
    Starts where the load on the undeformed cell would lock; points that fail walk from beta = 45 degrees to theirs.
    """
    options = options or StrainOptions()
    alpha, beta = np.broadcast_arrays(np.atleast_1d(np.asarray(alpha_deg, float)), np.atleast_1d(beta_deg))
    beta = np.asarray(beta, float)
    scale = _scale(law, options)
    state, steps = _newton(law, alpha, beta, _start(law, alpha, beta, scale), scale, options)
    for factor in RETRIES:
        failed = np.flatnonzero(state.size() > options.tolerance)
        if not failed.size:
            break
        start = _start(law, alpha[failed], np.full(len(failed), 45.0), factor * scale)
        again, more = _walk(law, alpha[failed], beta[failed], start, factor * scale, options)
        steps[failed] += more
        better = again.size() < state.size()[failed]
        state = _merge(state, failed[better], again, better)
    good = state.size() <= options.tolerance
    S = state.S / np.where(good, trace(state.S), 1.0)[:, None]
    unique = face_width(law, S) < WIDTH
    status = np.where(good, "converged", "no_convergence")
    unknown = np.full(S.shape, np.nan)
    found = LockedStrain(state.E, unknown, unknown, S, state.size(), unique, status, steps)
    return found if rows is None else _with_rows(found, rows, alpha, beta)


def _with_rows(found: LockedStrain, rows: Rows, alpha: Array, beta: Array) -> LockedStrain:
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
    unique = found.unique & ((high - low).max(axis=1) < WIDTH)
    E[at], S[at], unique[at], residual[at], status[at] = both.E[row], both.S[row], alone, 0.0, "converged"
    low[at], high[at] = np.fmin(low[at], E[at]) - slack, np.fmax(high[at], E[at]) + slack
    return replace(found, E=E, E_min=low, E_max=high, S=S, residual=residual, unique=unique, status=status)


def _cauchy_load(rows: Rows) -> Array:
    """Unit Cauchy loads (n, 3) of the rows, F S F^T scaled to s:s = 1."""
    from rve import deformation_gradient

    F = deformation_gradient(rows.E)
    S = np.stack([rows.S[:, [0, 1]], rows.S[:, [1, 2]]], axis=1)
    s = (F @ S @ F.transpose(0, 2, 1))[:, [0, 0, 1], [0, 1, 1]]
    return np.asarray(s / np.sqrt((s * s) @ WEIGHT)[:, None])


def _scale(law: MembraneLaw, options: StrainOptions) -> float:
    """Trace of S (N/mm) that puts X about `offset` away from the surface."""
    return options.offset / float(np.abs(law.compliance @ [0.5, 0.0, 0.5]).max())


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


def _start(law: MembraneLaw, alpha: Array, beta: Array, scale: float) -> Array:
    """X (n, 3) of the strain that locks under the load at the undeformed cell, seen from far along its normal."""
    from rve import cauchy_line_load

    S = scale * _load(np.zeros((len(alpha), 3)), cauchy_line_load(alpha, beta))
    away = S @ law.compliance.T
    return law.response(FAR * away).E_star + away


def _evaluate(law: MembraneLaw, s: Array, X: Array, scale: float) -> _State:
    """Residual S/scale - load(E) of unit trace and its derivative with respect to X."""
    answer = law.response(X)
    E, S = answer.E_star, answer.S
    load = _load(E, s)
    step = 1e-6
    d_load = np.stack([(_load(E + step * e, s) - _load(E - step * e, s)) / (2.0 * step) for e in np.eye(3)], axis=-1)
    dE = np.eye(3) - law.compliance @ answer.C
    return _State(X, E, S, S / scale - load, answer.C / scale - d_load @ dE)


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


def _newton(
    law: MembraneLaw, alpha: Array, beta: Array, X: Array, scale: float, options: StrainOptions
) -> tuple[_State, NDArray[np.int64]]:
    """Damped Newton from X (n, 3), least-norm steps where the strain is not unique; last state and steps taken."""
    from rve import cauchy_line_load

    s = cauchy_line_load(alpha, beta)
    state = _evaluate(law, s, X, scale)
    steps = np.zeros(len(X), np.int64)
    for _ in range(options.newton_steps):
        todo = np.flatnonzero(state.size() > options.tolerance)
        if not todo.size:
            break
        steps[todo] += 1
        dX = -np.einsum("nij,nj->ni", np.linalg.pinv(state.J[todo], rcond=options.singular), state.r[todo])
        dX *= np.minimum(1.0, 0.3 / np.maximum(np.abs(dX).max(axis=1), 1e-300))[:, None]
        state = _search(law, s, state, todo, dX, scale)
    return state, steps


def _walk(
    law: MembraneLaw, alpha: Array, beta: Array, X: Array, scale: float, options: StrainOptions
) -> tuple[_State, NDArray[np.int64]]:
    """Newton along a path of loads from beta = 45 degrees, where it starts at X (n, 3), to beta."""
    steps = np.zeros(len(X), np.int64)
    for left in (
        np.linspace(1.0, 0.0, options.path_steps + 1) ** 3
    ):  # ever shorter steps: strains change fast at beta = 0
        state, more = _newton(law, alpha, beta + left * (45.0 - beta), X, scale, options)
        X, steps = state.X, steps + more
    return state, steps


def _search(law: MembraneLaw, s: Array, state: _State, todo: NDArray[np.int64], dX: Array, scale: float) -> _State:
    """Halves the step until the residual falls; after six halvings takes the last one, to leave a corner."""
    length, waiting = 1.0, np.arange(len(todo))
    before = state.size()[todo]
    for half in range(7):
        trial = _evaluate(law, s[todo[waiting]], state.X[todo[waiting]] + length * dX[waiting], scale)
        ok = (trial.size() < (1.0 - 1e-4 * length) * before[waiting]) | (half == 6)
        state = _merge(state, todo[waiting[ok]], trial, ok)
        waiting, length = waiting[~ok], 0.5 * length
        if not waiting.size:
            break
    return state


def _merge(state: _State, where: NDArray[np.int64], other: _State, pick: NDArray[np.bool_]) -> _State:
    """`state` with the points `where` replaced by the points `pick` of `other`."""
    new = {name: getattr(state, name).copy() for name in ("X", "E", "S", "r", "J")}
    for name, array in new.items():
        array[where] = getattr(other, name)[pick]
    return _State(**new)
