"""Compliant contact over one step: a small strictly convex quadratic programme per load case, solved in batches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rve.common import Array, Flags, Rows


def _times(matrix: Array, vector: Array) -> Array:
    return np.matmul(matrix, vector[..., None])[..., 0]


@dataclass(frozen=True)
class Programme(Rows):
    """Contact steps of n cases: A (n, m, m) positive definite, b (n, m), G (n, c, m), gap and stiffness k (n, c), 0 for
    slots without a contact. Displacements w and forces lam obey

        A w = b + G^T lam,    0 <= lam  _|_  gap + G w + lam/k >= 0,

    which is where 1/2 w^T A w - b^T w + 1/2 sum k min(gap + G w, 0)^2 is least.
    """

    A: Array
    b: Array
    G: Array
    gap: Array
    k: Array

    def energy(self, w: Array) -> Array:
        """The function that the step minimises, (n,)."""
        pressed = np.minimum(self.gap + _times(self.G, w), 0.0)
        smooth = 0.5 * (w * _times(self.A, w)).sum(axis=1) - (self.b * w).sum(axis=1)
        return np.asarray(smooth + 0.5 * (self.k * pressed**2).sum(axis=1))


def solve_contact_step(programme: Programme, *, max_iterations: int = 60) -> tuple[Array, Array, Flags]:
    """Displacements w (n, m) and forces lam (n, c) >= 0 of the contact steps, and which have converged, (n,).

    Newton's method changes the set of working contacts and ends after finitely many, with a line search from any start
    (Qi and Sun 1993, doi 10.1007/BF01581275). No case depends on the others, to the bit.

    >>> one = np.ones((1, 1))
    >>> solve_contact_step(Programme(one[:, None], -2 * one, one[:, None], 0 * one, 3 * one))[:2]
    (array([[-0.5]]), array([[1.5]]))
    """
    w, todo = np.zeros(programme.b.shape), np.arange(len(programme.b))
    converged = np.zeros(len(todo), dtype=bool)
    for _ in range(max_iterations):
        part = programme.take(todo)
        # At the start nothing moves yet: what touches or penetrates works.
        working = (part.gap + _times(part.G, w[todo]) <= 0.0) & (part.k > 0.0)
        kw = np.where(working, part.k, 0.0)
        Gt = part.G.transpose(0, 2, 1)
        H = part.A + np.matmul(Gt * kw[:, None, :], part.G)
        target = np.linalg.solve(H, (part.b - _times(Gt, kw * part.gap))[..., None])[..., 0]
        w[todo], settled = _searched(part, w[todo], target, working)
        converged[todo[settled]] = True
        todo = todo[~settled]
        if not len(todo):
            break
    lam = np.maximum(-programme.k * (programme.gap + _times(programme.G, w)), 0.0)
    return w, lam, converged


def _searched(programme: Programme, w: Array, target: Array, working: Flags) -> tuple[Array, Flags]:
    """The point reached from w towards `target`, and whether it is the minimum."""
    G, gap, k = programme.G, programme.gap, programme.k
    after = gap + _times(G, target)
    # A contact with a gap of round-off may alternate without end; its force is k times round-off.
    verge = 1e-15 * (1.0 + np.abs(_times(np.abs(G), np.abs(target))))
    same = (((after <= 0.0) & (k > 0.0)) == working) | (np.abs(after) <= verge) | (k == 0.0)
    settled = same.all(axis=1)
    step = target - w
    slope = (step * (_times(programme.A, w) - programme.b)).sum(axis=1)
    slope += (k * np.minimum(gap + _times(G, w), 0.0) * _times(G, step)).sum(axis=1)
    before = programme.energy(w)
    length = np.ones(len(w))
    for _ in range(40):
        worse = ~settled & (programme.energy(w + length[:, None] * step) > before + 1e-4 * length * slope)
        if not worse.any():
            break
        length[worse] *= 0.5
    return np.where(settled[:, None], target, w + length[:, None] * step), settled
