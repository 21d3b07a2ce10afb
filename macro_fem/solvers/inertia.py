"""The quadratic term of a step of motion, (x - x_hat).W (x - x_hat) / 2 over the nodes of a curtain.

W holds one symmetric block per node: its mass over (beta h)^2, and what else resists its motion over beta h. With
x = x_held + T z the term adds T^T W (x_hat - x) to the balance of forces and T^T W T to Newton's matrix, and it bounds
what an unbalanced force r can gain, r.(T^T W T)^-1 r / 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from macro_fem.fem.supported import SupportedFem
from rve.common import Array


@dataclass(frozen=True, eq=False)
class Inertia:
    """Blocks W (n_nodes, d, d) in N/mm, symmetric, positive definite where nodes are free; x_hat (n_nodes, d) in mm.

    force_scale, N, and energy_scale, N mm: what residuals and gap are compared with besides the loads.
    """

    fem: SupportedFem
    W: Array
    x_hat: Array
    force_scale: float = 0.0
    energy_scale: float = 0.0

    def force(self, z: Array) -> Array:
        """T^T W (x_hat - x) (n,), N."""
        return -self.fem.gather(times(self.W, self.fem.positions(z) - self.x_hat))

    def energy(self, z: Array) -> float:
        """(x - x_hat).W (x - x_hat) / 2, N mm."""
        away = self.fem.positions(z) - self.x_hat
        return 0.5 * float((away * times(self.W, away)).sum())

    @cached_property
    def data(self) -> Array:
        """W as data of the lower triangle of `fem.pattern`."""
        n, d = self.x_hat.shape
        flat = np.arange(n * d).reshape(n, d)
        place = self.fem.pattern.place(*np.broadcast_arrays(flat[:, :, None], flat[:, None, :]))
        is_stored = place >= 0
        data = np.bincount(place[is_stored], self.W[is_stored], minlength=self.fem.pattern.nnz)
        return np.asarray(data, dtype=np.float64)

    def deficit(self, r: Array) -> float:
        """r.(T^T W T)^-1 r / 2 for forces r (n,), N mm: what they can gain."""
        return 0.5 * float(r @ self._factor.solve(r))

    @cached_property
    def _factor(self) -> Any:
        n, d = self.x_hat.shape
        whole = sparse.bsr_matrix((self.W, np.arange(n), np.arange(n + 1)), shape=(n * d, n * d))
        return sparse.linalg.splu(sparse.csc_matrix(self.fem.T.T @ whole @ self.fem.T))


def times(W: Array, v: Array) -> Array:
    """W v at every node (n_nodes, d)."""
    return np.asarray((W @ v[:, :, None])[:, :, 0])
