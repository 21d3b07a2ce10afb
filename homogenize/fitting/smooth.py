"""Fits the smooth law to supports and contact points at once.

A row (S, E) says that the set's closest point to X = E + rho S is E. The difference of the law's closest point and E,
its part along S whole (that is the error of h, to second order) and its parts in the surface weighted by `TANGENTIAL`,
is minimised by Levenberg and Marquardt from patches spread over the rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homogenize.fitting.rows import Rows
from homogenize.laws.protocol import CellInfo
from homogenize.laws.smooth import TO_TDG, Closest, SmoothLaw, closest, log_sum, patches_of, smooth_law
from rve.common.tensor import disc
from rve.common.types import Array

TANGENTIAL = 0.15
REGULAR = 1e-4
"""Pull of each parameter to its start: keeps those that do not matter from drifting."""


@dataclass(frozen=True)
class SmoothOptions:
    """`patches` to learn; `offset` of X from the row as a strain; residual evaluations of the least squares."""

    patches: int = 12
    offset: float = 0.06
    evaluations: int = 200


def fit_smooth(
    rows: Rows, stiffness: Array | None = None, cell: CellInfo | None = None, options: SmoothOptions | None = None
) -> SmoothLaw:
    """The smooth law closest to the rows."""
    from scipy.optimize import least_squares

    options = options or SmoothOptions()
    x = rows.E @ TO_TDG.T
    n = np.column_stack([np.ones(len(rows)), disc(rows.S)])
    start = first_guess(x, n, options)
    problem = _Problem(x, n, options.offset, start.ravel(), np.where(rows.unique, TANGENTIAL, 0.0))
    fitted = least_squares(problem.residual, start.ravel(), problem.jacobian, max_nfev=options.evaluations)
    return smooth_law(fitted.x.reshape(-1, 8), stiffness, cell)


def first_guess(x: Array, n: Array, options: SmoothOptions) -> Array:
    """Parameters (k + 1, 8) of a cap over all rows and of patches that touch rows far from each other.

    Farthest first, and far as seen from X = x + offset n, so that a vertex counts as often as it has loads.
    """
    X = x + options.offset * n
    chosen, distance = [0], np.full(len(X), np.inf)
    for _ in range(min(options.patches, len(X)) - 1):
        distance = np.minimum(distance, np.linalg.norm(X - X[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    p, q = 0.995 * n[chosen, 1], 0.995 * n[chosen, 2]
    size = 1.0 / np.sqrt(1.0 - p * p - q * q)
    none = np.zeros(len(chosen))
    theta = np.stack([p * size, q * size, none - 0.5, x[chosen, 1], x[chosen, 2], none - 0.8, none, none], axis=1)
    half = patches_of(theta)
    k = slice(0, len(chosen))
    h = x[chosen, 0] + half.p[k] * x[chosen, 1] + half.q[k] * x[chosen, 2] + half.rho[k] * np.sqrt(half.eps2[k])
    theta[:, 7] = np.arctanh(np.clip(0.5 * h, -0.9, 0.9))
    middle = 0.5 * (x.min(axis=0) + x.max(axis=0))
    top = float((x[:, 0] + np.hypot(x[:, 1] - middle[1], x[:, 2])).max())
    cap = [0.0, 0.0, 0.0, middle[1], 0.0, -0.8, 0.0, np.arctanh(np.clip(0.5 * top + 0.02, -0.9, 0.9))]
    return np.vstack([cap, theta])


@dataclass(frozen=True, eq=False)
class _Problem:
    """Residuals and Jacobian of the fit; each evaluation starts its closest points at the rows themselves."""

    x: Array
    n: Array
    offset: float
    start: Array
    tangential: Array

    def _closest(self, theta: Array) -> Closest:
        guess = Closest(self.x, np.full(len(self.x), self.offset), self.x, self.x)
        return closest(self.x + self.offset * self.n, patches_of(theta.reshape(-1, 8)), np.eye(3), guess)

    def _weigh(self, moved: Array) -> Array:
        """Parts of strain differences (n, 3, ...) along the load and, weighted, in D and G."""
        shape = (-1, *([1] * (moved.ndim - 2)))
        along = sum(self.n[:, i].reshape(shape) * moved[:, i] for i in range(3))
        return np.stack([along, *(self.tangential.reshape(shape) * moved[:, i] for i in (1, 2))], axis=1)

    def residual(self, theta: Array) -> Array:
        found = self._closest(theta)
        parts = self._weigh(found.x - self.x)
        parts[found.residual > 1e-6] = 0.05  # a patch gone astray is no gain
        return np.concatenate([parts.ravel(), REGULAR * (theta - self.start)])

    def jacobian(self, theta: Array) -> Array:
        """By the implicit function theorem; the derivative of the equations by the parameters by complex steps."""
        found = self._closest(theta)
        _, slope, _ = log_sum(found.x, patches_of(theta.reshape(-1, 8)))
        along = slope[:, 0]
        d_slope, d_G = np.empty((*slope.shape, len(theta))), np.empty((len(slope), len(theta)))
        for j in range(len(theta)):
            nudged = theta.astype(complex)
            nudged[j] += 1e-30j
            G, g, _ = log_sum(found.x.astype(complex), patches_of(nudged.reshape(-1, 8)))
            d_slope[:, :, j], d_G[:, j] = g.imag * 1e30, G.imag * 1e30
        d_n = d_slope / along[:, None, None] - slope[:, :, None] * d_slope[:, :1] / along[:, None, None] ** 2
        d_F = np.concatenate([found.factor[:, None, None] * d_n, d_G[:, None] / along[:, None, None]], axis=1)
        parts = self._weigh(-np.linalg.solve(found.jacobian, d_F)[:, :3])
        parts[found.residual > 1e-6] = 0.0
        return np.vstack([parts.reshape(-1, len(theta)), REGULAR * np.eye(len(theta))])
