"""The smooth law: a log-sum-exp of few learned patches, convex, tensile and weave-symmetric for every parameter value.

In T = (E11 + E22)/2, D = (E11 - E22)/2, G = E12 and for patch k with load (1, p_k, q_k) of unit trace let

    z_k = (T + p_k D + q_k G + rho_k sqrt((D - d_k)^2 + (G - g_k)^2 + eps_k^2) - h_k) / tau_k.

The set is {log sum exp z <= 0} over all patches and their mirror images (q, g -> -q, -g). Each z_k is convex with a
gradient in the cone of tensile loads because |(p_k, q_k)| + rho_k <= 1, and so is their log-sum-exp. tau_k is the
strain over which a patch blends with its neighbours, rho_k the radius of the disc of loads that it turns through. The
first patch is a cap with p = q = 0, rho = 1: it alone turns through all tensile loads, so every support is finite.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from homogenize.laws.net import STATED_STIFFNESS
from homogenize.laws.projection import ProjectionError
from homogenize.laws.protocol import CellInfo, Cut, HalfSpaces, Response, check_finite, stiffness_matrix
from rve.common.errors import InputError
from rve.common.tensor import WEIGHT, disc, double_dot, from_disc, trace
from rve.common.types import Array
from rve.common.values import checked, numbers

TO_TDG = np.array([[0.5, 0.0, 0.5], [0.5, 0.0, -0.5], [0.0, 1.0, 0.0]])
BLOCK = 2048
MOST_PATCHES, MOST_THETA = 1_000, 1e6
"""In a law file: more patches than a fit makes, and larger parameters than change anything."""
TOLERANCE = 1e-12
MAX_STEPS = 200
GROWTH = np.concatenate([10.0 ** np.arange(-1, 5), [1e4, 1e4, 1e4]])
"""Distances, in strains, from which the support is approached: each starts where the last one ended."""


WALK = np.linspace(0.0, 1.0, 13)[1:] ** 2
"""Parts of the way from the surface to a point whose closest point is not found at once."""


@dataclass(frozen=True, eq=False)
class Patches:
    """All patches, mirror images included, as rows of one array each (m,)."""

    p: Array
    q: Array
    rho: Array
    d: Array
    g: Array
    eps2: Array
    tau: Array
    h: Array


def patches_of(theta: Array) -> Patches:
    """Patches of the parameters theta (k, 8), any real numbers: no value leaves the convex tensile laws.

    Columns: direction a, b of the load; share of the free disc; d; g; eps; tau; h. All but the first two pass through
    tanh, so that absurd numbers end at the edge of a sensible range. Complex numbers give complex-step derivatives.
    """
    a, b, share, d, g, eps, tau, h = theta.T
    a, b = np.where(np.arange(len(theta)) == 0, 0.0, [a, b])
    size = 1.0 / np.sqrt(1.0 + a * a + b * b)
    p, q = a * size, b * size
    turned = np.where(np.arange(len(theta)) == 0, 1.0, 0.5 * (1.0 + np.tanh(share)))
    rho = (1.0 - np.sqrt(p * p + q * q)) * turned
    width, blend = 0.001 + 0.25 * (1.0 + np.tanh(eps)), np.exp(np.log(0.015) + 2.7 * np.tanh(tau))
    d, g, h = np.tanh(d), np.tanh(g), 2.0 * np.tanh(h)

    def twice(x: Array, sign: float = 1.0) -> Array:
        return np.concatenate([x, sign * x])

    columns = (p, rho, d, width**2, blend, h)
    p2, rho2, d2, w2, t2, h2 = (twice(x) for x in columns)
    return Patches(p2, twice(q, -1.0), rho2, d2, twice(g, -1.0), w2, t2, h2)


def log_sum(x: Array, k: Patches) -> tuple[Array, Array, Array]:
    """log sum exp z at x = (T, D, G) (n, 3), its gradient (n, 3) and Hessian (n, 3, 3)."""
    T, D, G = x[:, :1], x[:, 1:2], x[:, 2:]
    u, v = D - k.d, G - k.g
    root = np.sqrt(u * u + v * v + k.eps2)
    z = (T + k.p * D + k.q * G + k.rho * root - k.h) / k.tau
    top = z.real.max(axis=1, keepdims=True)
    w = np.exp(z - top)
    total = w.sum(axis=1)
    w = w / total[:, None]
    slope = np.stack([1.0 / k.tau + 0.0 * z, (k.p + k.rho * u / root) / k.tau, (k.q + k.rho * v / root) / k.tau])
    gradient = (w * slope).sum(axis=2)
    H = np.einsum("nk,ink,jnk->nij", w, slope, slope) - np.einsum("in,jn->nij", gradient, gradient)
    bend = w * k.rho / (k.tau * root**3)
    H[:, 1, 1] += (bend * (v * v + k.eps2)).sum(axis=1)
    H[:, 2, 2] += (bend * (u * u + k.eps2)).sum(axis=1)
    mixed = (bend * u * v).sum(axis=1)
    H[:, 1, 2] -= mixed
    H[:, 2, 1] -= mixed
    return top[:, 0] + np.log(total), gradient.T, H


@dataclass(frozen=True, eq=False)
class Closest:
    """Closest points x (n, 3) in (T, D, G), factor (n,) of the load (1, p, q), Jacobian (n, 4, 4), residual (n,).

    The residual is relative to 1 + |X|: far points lose digits.
    """

    x: Array
    factor: Array
    jacobian: Array
    residual: Array


def equations(x: Array, factor: Array, X: Array, patches: Patches, A: Array) -> tuple[Array, Array]:
    """x - X + factor A n = 0 and G = 0, both over the slope of G along T, (n, 4), and their Jacobian (n, 4, 4)."""
    G, slope, H = log_sum(x, patches)
    along = slope[:, 0]
    n = slope / along[:, None]
    F = np.concatenate([x - X + factor[:, None] * (n @ A.T), (G / along)[:, None]], axis=1)
    dn = H / along[:, None, None] - slope[:, :, None] * H[:, None, 0, :] / along[:, None, None] ** 2
    J = np.zeros((len(x), 4, 4))
    J[:, :3, :3] = np.eye(3) + factor[:, None, None] * (A @ dn)
    J[:, :3, 3] = n @ A.T
    J[:, 3, :3] = n - (G / along**2)[:, None] * H[:, 0, :]
    return F, J


def closest(X: Array, patches: Patches, A: Array, start: Closest | None = None) -> Closest:
    """Closest points of the set to points X (n, 3) outside it, in the metric of the compliance A (3, 3) of (T, D, G).

    Damped Newton; a residual above the tolerance says that it did not end.
    """
    x, factor = (X.copy(), np.zeros(len(X))) if start is None else (start.x.copy(), start.factor.copy())
    F, J = equations(x, factor, X, patches, A)
    unit = 1.0 + np.abs(X).max(axis=1)
    size = np.abs(F).max(axis=1) / unit
    for _ in range(MAX_STEPS):
        todo = np.flatnonzero(size > TOLERANCE)
        if not todo.size:
            break
        step = -np.linalg.solve(J[todo], F[todo][:, :, None])[:, :, 0]
        length, waiting = 1.0, np.arange(len(todo))
        for halving in range(9):
            at = todo[waiting]
            x_try = x[at] + length * step[waiting, :3]
            factor_try = np.maximum(factor[at] + length * step[waiting, 3], 0.0)
            F_try, J_try = equations(x_try, factor_try, X[at], patches, A)
            size_try = np.abs(F_try).max(axis=1) / unit[at]
            ok = (size_try < (1.0 - 0.1 * length) * size[at]) | (halving == 8)
            put = at[ok]
            x[put], factor[put], F[put], J[put] = x_try[ok], factor_try[ok], F_try[ok], J_try[ok]
            size[put] = size_try[ok]
            waiting, length = waiting[~ok], 0.4 * length
            if not waiting.size:
                break
    return Closest(x, factor, J, size)


@dataclass(frozen=True, eq=False)
class SmoothLaw:
    """Patches from the parameters theta (k, 8); stiffness (3, 3) in tensor components."""

    theta: Array
    stiffness: Array
    cell: CellInfo | None = None
    name: str = "smooth"

    @property
    def compliance(self) -> Array:
        """Inverse of the stiffness, mm/N."""
        return np.asarray(np.linalg.inv(self.stiffness))

    @property
    def patches(self) -> Patches:
        """The patches and their mirror images."""
        return patches_of(self.theta)

    def support(self, S: Array) -> Array:
        """h(S) by proximal steps of growing length, each the closest point to one far out along S; (n,)."""
        check_finite(S, "line loads")
        size = trace(S)
        n = np.column_stack([np.ones(len(S)), disc(S / size[:, None])])
        x = np.column_stack([-self._height(np.zeros((len(S), 2))), np.zeros((len(S), 2))])
        for length in GROWTH:
            found = closest(x + length * n, self.patches, np.eye(3), Closest(x, np.full(len(S), length), n, n))
            x = found.x
        if found.residual.max() > 1e-8:
            raise ProjectionError(f"support not found for {int((found.residual > 1e-8).sum())} loads: use another kind")
        return np.asarray((n * x).sum(axis=1) * size)

    def half_spaces(self) -> HalfSpaces:
        """Seventeen tight ones: the equibiaxial load, eight half-way to the rim of the tensile cone, eight near it."""
        angle = 0.25 * np.pi * np.arange(8)
        ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        S = from_disc(np.vstack([np.zeros((1, 2)), 0.5 * ring, 0.98 * ring]))
        return HalfSpaces(S, self.support(S))

    def cut(self, E: Array) -> Cut:
        """The half-space each E violates most: the surface is lifted by t along the identity until it holds E."""
        check_finite(E)
        x = E @ TO_TDG.T
        t = x[:, 0] + self._height(x[:, 1:])
        _, slope, _ = log_sum(np.column_stack([x[:, 0] - t, x[:, 1:]]), self.patches)
        S = from_disc(slope[:, 1:] / slope[:, :1])
        return Cut(S, double_dot(S, E) - t, t)

    def _height(self, y: Array) -> Array:
        """phi (n,) at y = (D, G) (n, 2) such that T + phi = 0 on the surface: monotone Newton from below."""
        k = self.patches
        root = np.sqrt((y[:, :1] - k.d) ** 2 + (y[:, 1:] - k.g) ** 2 + k.eps2)
        phi = (k.p * y[:, :1] + k.q * y[:, 1:] + k.rho * root - k.h).max(axis=1)
        for _ in range(MAX_STEPS):
            G, slope, _ = log_sum(np.column_stack([-phi, y]), k)
            step = G / slope[:, 0]
            phi = phi + step
            if np.abs(step).max(initial=0.0) <= 1e-15 * (1.0 + np.abs(phi).max(initial=0.0)):
                break
        return phi

    def response(self, E: Array) -> Response:
        """Energy, stress and tangent beyond locking; ProjectionError if a closest point is not found."""
        n = len(E)
        check_finite(E)
        answer = Response(np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3)), E.copy())
        A = TO_TDG @ self.compliance @ np.diag(1.0 / WEIGHT) @ TO_TDG.T
        for start in range(0, n, BLOCK):
            X = E[start : start + BLOCK] @ TO_TDG.T
            out = np.flatnonzero(log_sum(X, self.patches)[0] > 0.0)
            found = self._closest(X[out], A)
            if found.residual.max(initial=0.0) > 1e-8:
                missed = int((found.residual > 1e-8).sum())
                raise ProjectionError(f"{missed} closest points of the smooth law not found: use the refined law")
            load = np.linalg.solve(A, (X[out] - found.x).T).T
            right = np.zeros((len(out), 4, 3))
            right[:, :3] = np.eye(3)
            moved = np.linalg.solve(found.jacobian, right)[:, :3]
            back = (TO_TDG / WEIGHT).T
            at = start + out
            answer.energy[at] = 0.5 * (load * (X[out] - found.x)).sum(axis=1)
            answer.S[at] = load @ back.T
            answer.C[at] = back @ np.linalg.solve(A, np.eye(3) - moved) @ TO_TDG
            answer.E_star[at] = found.x @ np.linalg.inv(TO_TDG).T
        return answer

    def _closest(self, X: Array, A: Array) -> Closest:
        """Closest points to X (n, 3); what Newton misses from X itself is walked to from the surface below X."""
        found = closest(X, self.patches, A)
        missed = np.flatnonzero(found.residual > TOLERANCE)
        if not missed.size:
            return found
        base = np.column_stack([-self._height(X[missed, 1:]), X[missed, 1:]])
        path = Closest(base, np.zeros(len(missed)), base, base)
        for part in WALK:
            path = closest(base + part * (X[missed] - base), self.patches, A, path)
        for old, new in ((found.x, path.x), (found.factor, path.factor), (found.jacobian, path.jacobian)):
            old[missed] = new
        found.residual[missed] = path.residual
        return found

    def to_dict(self) -> dict[str, Any]:
        """Parameters and stiffness."""
        return {"theta": self.theta.tolist(), "stiffness_N_per_mm": self.stiffness.tolist()}


def smooth_from_dict(data: dict[str, Any], cell: CellInfo | None, where: str) -> SmoothLaw:
    """The law that `SmoothLaw.to_dict` wrote; InputError names a missing or impossible entry."""
    theta = checked(data, "theta", numbers(None, 8, least=-MOST_THETA, most=MOST_THETA, longest=MOST_PATCHES), where)
    return smooth_law(theta, stiffness_matrix(data, where), cell)


def smooth_law(theta: Array, stiffness: Array | None = None, cell: CellInfo | None = None) -> SmoothLaw:
    """The law of the parameters theta (k, 8); InputError if they are no finite numbers of this shape."""
    if theta.ndim != 2 or theta.shape[1] != 8 or not len(theta) or not np.isfinite(theta).all():
        raise InputError(f"a smooth law has rows of eight finite parameters, got the shape {theta.shape}")
    law = SmoothLaw(theta, STATED_STIFFNESS * np.eye(3))
    return replace(law, stiffness=law.stiffness if stiffness is None else stiffness, cell=cell)
