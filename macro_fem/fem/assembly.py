"""Gradients, nodal forces and stiffness matrices of a membrane, and where the entries of these go: no loop over cells.

Gradients in the coordinates of the reference element are the same numbers for every cell, so that the sums over
quadrature points and nodes are small dense matrix products. Entries reach their place in the matrix by one `bincount`.

Shapes: points are the leading axis, in the order of `macro_fem.fem.discretization`. The unknown u (n_nodes, d) has
d = 2 components (plane) or d = 3 (space); its flat number is node * d + component. The gradient F is (n_points, d, 2):
the reference state is always plane. Component slices such as F[:, 0, 1] of returned arrays are contiguous.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from macro_fem.fem.discretization import Discretization
from rve.common import Array, Index


@dataclass(frozen=True, eq=False)
class SparsityPattern:
    """Where the entries of symmetric matrices on n free unknowns go; d: components per node.

    keys (nnz,): column times n plus row of each entry of the lower triangle, ascending.
    slot (n_entries, n_cells): place among these of each packed entry of a cell, nnz for "held" and "left out". Packed
    are the blocks (i, k), i >= k, of components in the order of `component_pairs`, each with all pairs of nodes; of a
    block with i = k one half is left out.
    """

    d: int
    n: int
    keys: Index
    slot: Index

    @classmethod
    def of(cls, disc: Discretization, d: int, free: NDArray[Any]) -> SparsityPattern:
        """The pattern of stiffness matrices on the components marked by `free` (n_nodes, d) or flat."""
        free, nodes = np.ravel(free), disc.cell_dofs.T
        number, n = np.where(free, np.cumsum(free) - 1, -1), int(free.sum())
        nowhere, keys = n * n, []
        for k, l in component_pairs(d):
            i, j = number[d * nodes[:, None] + k], number[d * nodes[None, :] + l]
            low, high = np.minimum(i, j), np.maximum(i, j)
            is_out = (low < 0) | ((k == l) & (i < j))
            keys.append(np.where(is_out, nowhere, low * n + high).ravel())
        found, slot = np.unique(np.concatenate([*keys, [nowhere]]), return_inverse=True)
        return cls(d, n, found[:-1], slot[:-1].reshape(-1, disc.n_cells))

    def matrix(self, packed: Array) -> sparse.csc_matrix:
        """The matrix (n, n), both triangles, of the packed entries (n_entries, n_cells) of all cells."""
        summed = np.bincount(self.slot.ravel(), weights=packed.ravel(), minlength=len(self.keys) + 1)
        numbered, source = self._mirror
        return sparse.csc_matrix((summed[source], numbered.indices, numbered.indptr), shape=(self.n, self.n))

    @cached_property
    def _mirror(self) -> tuple[sparse.csc_matrix, Index]:
        """A matrix of both triangles, and the place in the data of the lower one of each of its entries."""
        column, row = np.divmod(self.keys, self.n)
        lower = sparse.csc_matrix((np.arange(1.0, len(self.keys) + 1.0), (row, column)), shape=(self.n, self.n))
        both = (lower + sparse.tril(lower, -1).T).tocsc()
        both.sort_indices()
        return both, both.data.astype(np.int64) - 1


def component_pairs(d: int) -> list[tuple[int, int]]:
    """The blocks (i, k), i >= k, in the order of the packed entries."""
    return [(i, k) for i in range(d) for k in range(i + 1)]


def gradient(disc: Discretization, v: Array) -> Array:
    """The gradient dv_i/dx_j of the nodal field v (n_nodes, d) at the points, (n_points, d, 2)."""
    d, iJ = v.shape[1], disc.inverse_jacobian
    local = np.ascontiguousarray(v.T)[:, disc.cell_dofs.T]
    G = np.matmul(disc.shape_gradients.reshape(-1, local.shape[1]), local)
    G = G.reshape(d, 1, disc.n_quad, 2, disc.n_cells)
    return np.moveaxis((G[..., 0, :] * iJ[0] + G[..., 1, :] * iJ[1]).reshape(d, 2, -1), -1, 0)


def internal_force(disc: Discretization, P: Array) -> Array:
    """Nodal forces f_ai = sum_p w_p P_pij dphi_a/dx_j (n_nodes, d), N, of P = dpsi/dF: (n_points, d, 2) or (d, 2)."""
    P = np.broadcast_to(P, (disc.n_points, *P.shape[-2:]))
    d, wJ = P.shape[1], disc.inverse_jacobian * disc.weight.reshape(disc.n_quad, -1)
    P = np.ascontiguousarray(np.moveaxis(P, 0, -1)).reshape(d, 2, disc.n_quad, -1)
    pulled = np.stack([P[:, 0] * wJ[J, 0] + P[:, 1] * wJ[J, 1] for J in range(2)], axis=2)
    local = np.matmul(disc.shape_gradients.reshape(-1, disc.cell_dofs.shape[1]).T, pulled.reshape(d, -1, disc.n_cells))
    return _sum_to_nodes(disc, local)


def load_vector(disc: Discretization, q: Array) -> Array:
    """Nodal forces (n_nodes, d) of a load per reference area q: (d,) or (n_points, d), N/mm2."""
    q = np.broadcast_to(q, (disc.n_points, np.shape(q)[-1]))
    local = (q * disc.weight[:, None]).T.reshape(q.shape[1], disc.n_quad, disc.n_cells)
    return _sum_to_nodes(disc, np.matmul(disc.shape_values.T, local))


def stiffness(disc: Discretization, pattern: SparsityPattern, A: Array) -> sparse.csc_matrix:
    """K = sum_p w_p dphi_a/dx_j A_pijkl dphi_b/dx_l (n, n).

    A (n_points, d, 2, d, 2) is d2psi/dF2 with its major symmetry; only the blocks A[:, i, :, k, :], i >= k, are read.
    """
    iJ, w, g = disc.inverse_jacobian, disc.weight.reshape(disc.n_quad, -1), disc.shape_gradients
    products = np.einsum("qJa,qNb->abqJN", g, g).reshape(-1, 4 * disc.n_quad)
    packed = np.empty(pattern.slot.shape).reshape(-1, len(products), disc.n_cells)
    for (i, k), block in zip(component_pairs(pattern.d), packed, strict=True):
        own = np.ascontiguousarray(np.moveaxis(A[:, i, :, k], 0, -1)).reshape(2, 2, disc.n_quad, -1)  # j, l, q, cell
        half = (iJ[:, 0, None] * own[0] + iJ[:, 1, None] * own[1]) * w  # J, l, q, cell
        pulled = half[:, None, 0] * iJ[:, 0] + half[:, None, 1] * iJ[:, 1]  # J, N, q, cell
        np.matmul(products, np.moveaxis(pulled, 2, 0).reshape(-1, disc.n_cells), out=block)
    return pattern.matrix(packed)


def _sum_to_nodes(disc: Discretization, local: Array) -> Array:
    """Nodal sums (n_nodes, d) of cell vectors (d, n_local, n_cells)."""
    where = disc.cell_dofs.T.ravel()
    return np.stack([np.bincount(where, weights=f.ravel(), minlength=disc.n_nodes) for f in local], axis=-1)
