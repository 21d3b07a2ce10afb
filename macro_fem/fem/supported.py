"""A discretised curtain with its supports: positions x = x_held + T z of the free unknowns z.

A held component is a number in x_held, a free one counts from a node of the mesh, so that z is small wherever that is;
a bar that stays straight ties its nodes to two of them through T. With no ties T only picks the free components, and
matrices are assembled on these at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy import sparse

from macro_fem.fem.assembly import SparsityPattern, gradient, internal_force, stiffness
from macro_fem.fem.discretization import Discretization
from rve.common import Array
from rve.common.factor import Factorizer, Solve
from rve.geometry import padded

SHIFTS = (0.0, 1e-15, 1e-13, 1e-11, 1e-9)
"""Relative additions to the diagonal that are tried in turn when a pivot is not positive."""


@dataclass(frozen=True, eq=False)
class SupportedFem:
    """A discretisation whose nodes (n_nodes, d) are at x_held + T z.

    free (n_nodes * d,) marks components that are unknowns themselves; `tie` (n_nodes * d, n_z) is None without ties.
    """

    disc: Discretization
    x_held: Array
    free: np.ndarray
    tie: sparse.csc_matrix | None = None

    @cached_property
    def T(self) -> sparse.csc_matrix:
        """T (n_nodes * d, n_z); without ties it picks the free components."""
        if self.tie is not None:
            return self.tie
        free = np.flatnonzero(self.free)
        one = (np.ones(len(free)), (free, np.arange(len(free))))
        return sparse.csc_matrix(one, shape=(self.free.size, len(free)))

    def moved(self, x_held: Array) -> SupportedFem:
        """The same curtain with its held components elsewhere; pattern and symbolic factor are kept."""
        other = replace(self, x_held=x_held)
        kept = ("T", "pattern", "factorizer")
        other.__dict__.update({name: self.__dict__[name] for name in kept if name in self.__dict__})
        return other

    @property
    def d(self) -> int:
        """Components of a position."""
        return int(self.x_held.shape[1])

    @property
    def n(self) -> int:
        """Number of free unknowns."""
        return int(self.T.shape[1])

    @cached_property
    def held(self) -> np.ndarray:
        """Which components (n_nodes, d) no unknown moves."""
        return np.asarray((np.diff(self.T.tocsr().indptr) == 0).reshape(self.x_held.shape))

    @cached_property
    def reference(self) -> Array:
        """Positions of the nodes in the plane reference state (n_nodes, d), mm."""
        return padded(self.disc.nodes, self.d)

    @cached_property
    def pattern(self) -> SparsityPattern:
        """Where matrix entries go: on the free unknowns, or on all of them if ties must be applied afterwards."""
        free = self.free if self.tie is None else np.ones_like(self.free)
        return SparsityPattern.of(self.disc, self.d, free)

    def positions(self, z: Array) -> Array:
        """x (n_nodes, d)."""
        return self.x_held + self.spread(z)

    def gradient(self, z: Array) -> Array:
        """F (nq, d, 2), of places that count from the first node: far from the origin digits would cancel."""
        return gradient(self.disc, self.x_held - self.x_held[0] + self.spread(z))

    def gradient_change(self, dz: Array) -> Array:
        """B dz (nq, d, 2)."""
        return gradient(self.disc, self.spread(dz))

    def force(self, P: Array) -> Array:
        """B^T (w P) (n,) of P (nq, d, 2), or (d, 2) everywhere."""
        return self.gather(internal_force(self.disc, P))

    def gather(self, nodal: Array) -> Array:
        """T^T f (n,) of nodal forces f (n_nodes, d)."""
        return np.asarray(self.T.T @ nodal.ravel())

    def unknowns(self, x: Array) -> Array:
        """The z whose positions are nearest to x (n_nodes, d)."""
        change = (x - self.x_held).ravel()
        if self.tie is None:
            return np.asarray(change[self.free])
        return np.asarray(sparse.linalg.spsolve((self.tie.T @ self.tie).tocsc(), self.tie.T @ change))

    def spread(self, dz: Array) -> Array:
        """T dz as nodal vectors (n_nodes, d)."""
        return np.asarray((self.T @ dz).reshape(self.x_held.shape))

    def factorize(self, tangent: Array, added: sparse.csc_matrix | None = None) -> Callable[[Array], Array]:
        """A solver of B^T (w A) B x = b for tangents A (nq, d, 2, d, 2), its matrix and `added` (n, n), such as that of
        walls, in sum; ArithmeticError if there is none.

        Stiffnesses of taut and slack places may differ by 16 orders. If a pivot is lost to rounding a multiple of the
        diagonal is added; two rounds of refinement with the true matrix remove most of its effect.
        """
        matrix = stiffness(self.disc, self.pattern, tangent)
        if self.tie is not None:
            matrix = (self.tie.T @ matrix @ self.tie).tocsc()
        if added is not None:
            matrix = matrix + added
        matrix.sort_indices()
        if not np.isfinite(matrix.data.sum()):
            raise ArithmeticError("the matrix holds an entry that is not finite")
        if not matrix.shape[0]:
            return lambda b: np.zeros(0)
        for shift in SHIFTS:
            shifted = matrix
            if shift:
                shifted = matrix.copy()
                shifted.setdiag((1.0 + shift) * matrix.diagonal())
            solve = self.factorizer(shifted)
            if callable(solve):
                return partial(_refined, solve, matrix)
        raise ArithmeticError(f"no pivot order works even with the diagonal raised by {SHIFTS[-1]:g}")

    @cached_property
    def factorizer(self) -> Factorizer:
        """Factorizes matrices on the free unknowns, ties applied; their ordering is found once."""
        return Factorizer()


def with_loose_nodes(fem: SupportedFem, count: int) -> SupportedFem:
    """The discretisation with `count` free nodes more, the centres of bodies with mass: numbered last, in no
    cell; x_held is 0 there.
    """
    if not count:
        return fem
    d = fem.d
    nodes = np.vstack([fem.disc.nodes, np.tile(fem.disc.nodes.mean(axis=0), (count, 1))])
    return replace(
        fem,
        disc=replace(fem.disc, nodes=nodes),
        x_held=np.vstack([fem.x_held, np.zeros((count, d))]),
        free=np.concatenate([fem.free, np.ones(d * count, bool)]),
        tie=None if fem.tie is None else sparse.csc_matrix(sparse.block_diag([fem.tie, sparse.eye(d * count)])),
    )


def _refined(solve: Solve, matrix: sparse.csc_matrix, b: Array) -> Array:
    """x with two rounds of refinement, as long as they help. Sizes are maxima: a norm would wake BLAS's threads."""
    x = solve(b)
    left = b - matrix @ x
    best, least = x, np.abs(left).max(initial=0.0)
    for _ in range(2):
        x = x + solve(left)
        left = b - matrix @ x
        size = np.abs(left).max(initial=0.0)
        if not size < least:
            break
        best, least = x, size
    return best
