"""Elimination of the strains of an elastic curtain from Newton's matrix, point by point."""

from __future__ import annotations

import numpy as np

from rve.common.types import Array


class Strains:
    """The strains' part of the matrices H (nq, k + 2 d, k + 2 d), eliminated point by point.

    By Cholesky's factor, for an explicit inverse would lose the square of its digits.
    """

    def __init__(self, H: Array, k: int) -> None:
        H = np.ascontiguousarray(H)
        H[:, range(k), range(k)] += 1.0
        self.root: Array = np.asarray(np.linalg.cholesky(H[:, :k, :k]))
        self.couple: Array = np.asarray(np.linalg.solve(self.root, H[:, :k, k:]))
        self.reduced: Array = H[:, k:, k:] - self.couple.swapaxes(1, 2) @ self.couple

    def half(self, strain: Array) -> Array:
        """root^-1 strain (nq, k)."""
        return _solved(self.root, strain)

    def onto_gradient(self, half: Array, shape: tuple[int, ...]) -> Array:
        """What strains that follow at once take from the right-hand side (nq, d, 2)."""
        return np.einsum("nij,ni->nj", self.couple, half).reshape(shape)

    def whole(self, half: Array, dF: Array) -> Array:
        """The change of the strains (nq, k) that goes with that of the gradient (nq, d, 2)."""
        moved = np.einsum("nij,nj->ni", self.couple, dF.reshape(len(dF), -1))
        return _solved(self.root.swapaxes(1, 2), half - moved)


def _solved(A: Array, b: Array) -> Array:
    return np.asarray(np.linalg.solve(A, b[:, :, None]))[:, :, 0]
