"""The locked strain under a Cauchy load direction: what a law says where the table has a row, or none.

The load follows the deformation: S = J F^-1 s F^-T with F from E by the rotation rule, so S and E are found together.
The pair (E, S), E on the surface and S normal to it, is parametrised by the strain X = E + A S outside (Minty): X moves
smoothly through vertices, where E stands still, and through flat faces, where S does. Newton solves S(X) = load(E(X)).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from homogenize.fitting.row_tests import normality
from homogenize.laws.protocol import MembraneLaw
from homogenize.laws.rows import LockedRows, with_mirror
from homogenize.query.strain_bounds import strain_bounds
from rve.common import Array, InputError, Rows, checked, part_of, tell
from rve.common.tensor import IDENTITY, WEIGHT, disc, from_disc, trace
from rve.geometry import cauchy_line_load, cauchy_of, deformation_gradient, second_pk


@dataclass(frozen=True)
class StrainOptions:
    """Numbers of the search for a strain."""

    flat: float = 1e-6
    """C = I + 2E with a determinant or side below this is a cell drawn to a line: no load can be pulled back to it."""
    retries: tuple[float, ...] = (1.0, 3.0, 10.0)
    """Multiples of the offset with which a load that fails is approached on a path."""
    singular: float = 1e-9
    """Singular values of the Jacobian below this share of the largest count as 0."""
    inward: float = 5e-4
    """Loads of rank one are replaced by loads this far inside the tensile cone, because a polyhedral law misses the rim
    by 2.4e-4; the table also answers with the limit of beta."""
    same_load: float = 1e-9
    """A row answers for loads whose unit Cauchy loads differ by less in every component."""
    far: float = 10.0
    """Multiple of the offset at which the first guess starts."""
    offset: float = 0.1
    """Length of X - E as a strain; a smaller one resolves sharp edges better, a larger one makes the surface smoother
    for Newton."""
    tolerance: float = 1e-9
    """Largest error of the load direction (unit trace)."""
    newton_steps: int = 60
    path_steps: int = 18
    """Limit of steps per load; loads on the way from beta = 45 degrees to a load that fails at first."""
    width: float = 0.05
    """Strains under one load that differ by more are not one strain; facets between rows are an order smaller."""


OPTIONS = StrainOptions()


@dataclass(frozen=True, eq=False)
class LockedStrain:
    """E (n, 3), S (n, 3) of unit trace, `residual` (n,) of the load direction, `unique`, `status` (n,). E_min, E_max
    (n, 3): bounds of the rings' locked strain from the rows of the table, nan if there are no rows. status is
    "converged" or "no_convergence" (the residual says by how much). unique is false where the bounds are wider than
    `OPTIONS.width`; without rows, where strains of the law near the load are."""

    E: Array
    E_min: Array
    E_max: Array
    S: Array
    residual: Array
    unique: NDArray[np.bool_]
    status: NDArray[np.str_]


@dataclass(frozen=True, eq=False)
class _Evaluation(Rows):
    """One evaluation at X (n, 3): surface strain, load, residual (n, 3) and its Jacobian (n, 3, 3)."""

    X: Array
    E: Array
    S: Array
    r: Array
    J: Array

    @property
    def size(self) -> Array:
        """What is left of r, and how far E is from a strain that a cell can have, (n,)."""
        return np.asarray(np.maximum(np.abs(self.r).max(axis=1), np.abs(self.E - _possible(self.E)).max(axis=1)))


@checked
def locked_strain(law: MembraneLaw, alpha_deg: Array, beta_deg: Array, rows: LockedRows | None = None) -> LockedStrain:
    """Locked strain and load under the principal angle alpha and the ratio angle beta, in degrees, arrays (n,).

    With the `rows` of the table behind the law the answer has bounds (a tenth of a second per load), and a load that is
    a row's own gets this row's strain. Without them the answer is the law's alone.
    Starts where the load on the undeformed cell would lock; loads that fail are approached from beta = 45 degrees.
    """
    if not law.compliance.any():
        raise InputError(f"kind = {law.name}: the law has no stiffness when locked, so no strain tells a load")
    try:
        alpha, beta = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, float)) for x in (alpha_deg, beta_deg)))
    except (TypeError, ValueError) as error:
        raise InputError("alpha and beta must be numbers, or lists of as many, in degrees") from error
    scale = OPTIONS.offset / float(np.abs(law.compliance @ [0.5, 0.0, 0.5]).max())  # trace of S in X = E + A S, N/mm
    state = _newton(law, scale, alpha, beta, _start(law, scale, alpha, beta))
    for factor in OPTIONS.retries:
        failed = np.flatnonzero(state.size > OPTIONS.tolerance)
        if not failed.size:
            break
        again = _walk(law, factor * scale, alpha[failed], beta[failed])
        better = again.size < state.size[failed]
        state = state.put(failed[better], again.take(better))
    good = state.size <= OPTIONS.tolerance
    S = state.S / np.where(good, trace(state.S), 1.0)[:, None]
    status = np.where(good, "converged", "no_convergence")
    unknown = np.full(S.shape, np.nan)
    found = LockedStrain(state.E, unknown, unknown, S, state.size, face_width(law, S) < OPTIONS.width, status)
    return found if rows is None else _with_rows(found, rows, alpha, beta)


def _with_rows(found: LockedStrain, rows: LockedRows, alpha: Array, beta: Array) -> LockedStrain:
    """The answer with the bounds that follow from the rows; a row's own load gets the row's strain and flag."""
    s, both, slack = cauchy_line_load(alpha, beta), with_mirror(rows), -normality(rows).slack
    own = cauchy_of(both.S, both.E)
    own /= np.sqrt((own * own) @ WEIGHT)[:, None]
    same = np.abs(s[:, None] - own).max(axis=2)
    at, row = np.flatnonzero(same.min(axis=1) < OPTIONS.same_load), same.argmin(axis=1)
    row = row[at]
    alone = both.unique[row]
    low, high = np.empty(s.shape), np.empty(s.shape)
    open_ = np.setdiff1d(np.arange(len(s)), at[alone])
    low[open_], high[open_] = strain_bounds(rows, s[open_])
    low[at[alone]] = high[at[alone]] = both.E[row[alone]]
    E, S, residual, status = found.E.copy(), found.S.copy(), found.residual.copy(), found.status.copy()
    unique = (high - low).max(axis=1) < OPTIONS.width
    E[at], S[at], unique[at], residual[at], status[at] = both.E[row], both.S[row], alone, 0.0, "converged"
    low[at], high[at] = np.fmin(low[at], E[at]) - slack, np.fmax(high[at], E[at]) + slack
    return replace(found, E=E, E_min=low, E_max=high, S=S, residual=residual, unique=unique, status=status)


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


def _start(law: MembraneLaw, scale: float, alpha: Array, beta: Array) -> Array:
    """X (n, 3) of the strain that locks under the load at the undeformed cell, seen from far along its normal."""
    away = scale * _load(np.zeros((len(alpha), 3)), cauchy_line_load(alpha, beta)) @ law.compliance.T
    return law.response(OPTIONS.far * away).E_star + away


def _evaluate(law: MembraneLaw, scale: float, s: Array, X: Array) -> _Evaluation:
    """Residual S/scale - load(E) of unit trace and its derivative with respect to X."""
    answer, step = law.response(X), 1e-6
    E, S = answer.E_star, answer.S
    sides = [(_load(E + step * e, s), _load(E - step * e, s)) for e in np.eye(3)]
    d_load = np.stack([(ahead - behind) / (2.0 * step) for ahead, behind in sides], axis=-1)
    dE = np.eye(3) - law.compliance @ answer.C
    return _Evaluation(X, E, S, S / scale - _load(E, s), answer.C / scale - d_load @ dE)


def _load(E: Array, s: Array) -> Array:
    """Direction of the second Piola-Kirchhoff load at E, unit trace, (n, 3), kept `OPTIONS.inward` from the rim of the
    cone."""
    S = second_pk(deformation_gradient(_possible(E)), s)
    x = disc(S / trace(S)[:, None])
    radius = np.hypot(x[:, 0], x[:, 1])
    return from_disc(x * ((1.0 - OPTIONS.inward) / np.maximum(radius, 1.0 - OPTIONS.inward))[:, None])


def _possible(E: Array) -> Array:
    """E (n, 3), drawn towards zero where I + 2E is not positive definite: only trial steps of Newton get there."""
    scale = np.ones(len(E))
    for _ in range(60):
        C = 2.0 * scale[:, None] * E + IDENTITY
        bad = (C[:, 0] <= OPTIONS.flat) | (C[:, 2] <= OPTIONS.flat) | (C[:, 0] * C[:, 2] - C[:, 1] ** 2 <= OPTIONS.flat)
        if not bad.any():
            break
        scale[bad] *= 0.8
    return scale[:, None] * E


def _newton(law: MembraneLaw, scale: float, alpha: Array, beta: Array, X: Array) -> _Evaluation:
    """Damped Newton from X (n, 3), least-norm steps where the strain is not unique; the last state.

    Steps are halved until the residual falls; after six halvings the last one is taken, to leave a corner.
    """
    s = cauchy_line_load(alpha, beta)
    state = _evaluate(law, scale, s, X)
    for _ in range(OPTIONS.newton_steps):
        todo = np.flatnonzero(state.size > OPTIONS.tolerance)
        if not todo.size:
            break
        tell(f"strains under {len(X)} loads, {todo.size} to go")
        dX = -np.einsum("nij,nj->ni", np.linalg.pinv(state.J[todo], rcond=OPTIONS.singular), state.r[todo])
        dX *= np.minimum(1.0, 0.3 / np.maximum(np.abs(dX).max(axis=1), 1e-300))[:, None]
        before = state.size
        for half in range(7):
            length = 0.5**half
            trial = _evaluate(law, scale, s[todo], state.X[todo] + length * dX)
            ok = (trial.size < (1.0 - 1e-4 * length) * before[todo]) | (half == 6)
            state = state.put(todo[ok], trial.take(ok))
            todo, dX = todo[~ok], dX[~ok]
            if not todo.size:
                break
    return state


def _walk(law: MembraneLaw, scale: float, alpha: Array, beta: Array) -> _Evaluation:
    """Newton along a path of loads from beta = 45 degrees to beta.

    The steps get shorter towards the end, because strains change fast at beta = 0.
    """
    X = _start(law, scale, alpha, np.full(len(beta), 45.0))
    for turn, left in enumerate(np.linspace(1.0, 0.0, OPTIONS.path_steps + 1) ** 3):
        with part_of(f"loads that failed, again along a path, step {turn + 1} of {OPTIONS.path_steps + 1}"):
            state = _newton(law, scale, alpha, beta + left * (45.0 - beta), X)
        X = state.X
    return state
