"""The quadratic term of a step of motion, (x - x_hat).W (x - x_hat) / 2 over the nodes of a curtain.

W holds one symmetric block per node: its mass over (beta h)^2, and what else resists its motion over beta h. With
x = x_held + T z the term adds T^T W (x_hat - x) to the balance of forces and T^T W T to Newton's matrix, whose pattern
stays. It also bounds what an unbalanced force r can gain, r.(T^T W T)^-1 r / 2, so that the lower bound of a step needs
no assumption on how far its nodes may go.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from macro_fem.fem.supported import SupportedFem
from rve.common.types import Array


@dataclass(frozen=True, eq=False)
class Inertia:
    """Blocks W (n_nodes, d, d) in N/mm, symmetric, positive definite where nodes are free; x_hat (n_nodes, d) in mm.

    force_scale, N, and energy_scale, N mm: what residuals and gap are compared with besides the loads.
    """

    fem: SupportedFem | None
    W: Array
    x_hat: Array
    force_scale: float = 0.0
    energy_scale: float = 0.0

    def away(self, z: Array) -> Array:
        """x - x_hat (n_nodes, d), mm."""
        assert self.fem is not None
        return self.fem.positions(z) - self.x_hat

    def force(self, z: Array) -> Array | float:
        """T^T W (x_hat - x) (n,), N."""
        return 0.0 if self.fem is None else -self.fem.gather(times(self.W, self.away(z)))

    def energy(self, z: Array) -> float:
        """(x - x_hat).W (x - x_hat) / 2, N mm."""
        if self.fem is None:
            return 0.0
        away = self.away(z)
        return 0.5 * float((away * times(self.W, away)).sum())

    def deficit(self, r: Array) -> float | None:
        """r.(T^T W T)^-1 r / 2 for forces r (n,), N mm: what they can gain; None without inertia."""
        return None if self.fem is None else 0.5 * float(r @ self._solve(r))

    def added(self, data: Array | None) -> Array | None:
        """Data of the lower triangle of `fem.pattern`, with that of W; `data` itself without inertia."""
        if self.fem is None:
            return data
        return self._data if data is None else data + self._data

    @cached_property
    def _data(self) -> Array:
        assert self.fem is not None
        pattern, d = self.fem.pattern, self.W.shape[1]
        number = np.full(self.fem.x_held.size, -1)
        number[pattern.free] = np.arange(pattern.n)
        out = np.zeros(pattern.nnz)
        for a, b in np.ndindex(d, d):
            i, j = number[a::d], number[b::d]
            here = np.flatnonzero((j >= 0) & (i >= j))
            np.add.at(out, pattern.place(i[here], j[here]), self.W[here, a, b])
        return out

    @cached_property
    def _solve(self) -> Callable[[Array], Array]:
        assert self.fem is not None
        n, d = self.x_hat.shape
        whole = sparse.bsr_matrix((self.W, np.arange(n), np.arange(n + 1)), shape=(n * d, n * d))
        if self.fem.tie is None:
            free = np.flatnonzero(self.fem.free)
            whole = whole.tocsr()[free][:, free]
        else:
            whole = self.fem.tie.T @ whole @ self.fem.tie
        solve: Callable[[Array], Array] = sparse.linalg.splu(sparse.csc_matrix(whole)).solve
        return solve


NO_INERTIA = Inertia(None, np.zeros((0, 2, 2)), np.zeros((0, 2)))
"""The static curtain."""


def times(W: Array, v: Array) -> Array:
    """W v at every node (n_nodes, d)."""
    return np.asarray((W @ v[:, :, None])[:, :, 0])
