"""Gradients, nodal forces and stiffness matrices of a membrane, without a loop over cells.

The gradients are taken in the coordinates of the reference element, where they are the same numbers for every cell, so
that the sums over quadrature points and nodes are small dense matrix products. Entries reach their place in the matrix
by one `bincount`.

Shapes: points are the leading axis, in the order of `macro_fem.fem.discretization`. The unknown u (n_nodes, d) has
d = 2 components (plane) or d = 3 (space); its flat number is node * d + component. The gradient F is (n_points, d, 2):
the reference state is always plane. Component slices such as F[:, 0, 1] of returned arrays are contiguous.

Example:
    >>> import skfem
    >>> from macro_fem.fem.discretization import discretize
    >>> from macro_fem.fem.sparsity import sparsity
    >>> disc = discretize(skfem.MeshTri.init_tensor(np.linspace(0, 2, 5), np.linspace(0, 1, 3)), "P1")
    >>> x = disc.nodes * [1.1, 1.0]
    >>> bool(np.allclose(gradient(disc, x), [[1.1, 0.0], [0.0, 1.0]]))
    True
    >>> pattern = sparsity(disc, d=2, free=np.repeat(disc.nodes[:, 0] > 0.0, 2))
    >>> A = np.broadcast_to(np.eye(4).reshape(2, 2, 2, 2), (disc.n_points, 2, 2, 2, 2))
    >>> pattern.full(stiffness(disc, pattern, A)).shape
    (24, 24)
"""

from __future__ import annotations

import numpy as np

from macro_fem.fem.discretization import Discretization
from macro_fem.fem.sparsity import SparsityPattern, component_pairs
from rve.common import Array


def gradient(disc: Discretization, v: Array) -> Array:
    """The gradient dv_i/dx_j of the nodal field v (n_nodes, d) at the points, (n_points, d, 2)."""
    d = v.shape[1]
    local = np.ascontiguousarray(v.T)[:, disc.cell_dofs.T]
    G = np.matmul(disc.shape_gradients.reshape(-1, local.shape[1]), local)
    G = G.reshape(d, disc.n_quad, 2, disc.n_cells)
    iJ = disc.inverse_jacobian
    out = np.empty((d, 2, disc.n_quad, disc.n_cells))
    for i, j in np.ndindex(d, 2):
        np.multiply(G[i, :, 0], iJ[0, j], out=out[i, j])
        out[i, j] += G[i, :, 1] * iJ[1, j]
    return np.moveaxis(out.reshape(d, 2, -1), -1, 0)


def internal_force(disc: Discretization, P: Array) -> Array:
    """Nodal forces f_ai = sum_p w_p P_pij dphi_a/dx_j (n_nodes, d) of the stress P = dpsi/dF (n_points, d, 2), N."""
    d = P.shape[1]
    shape = (disc.n_quad, disc.n_cells)
    w = disc.weight.reshape(shape)
    wJ = disc.inverse_jacobian * w
    pulled = np.empty((d, disc.n_quad, 2, disc.n_cells))
    for i, J in np.ndindex(d, 2):
        np.multiply(P[:, i, 0].reshape(shape), wJ[J, 0], out=pulled[i, :, J])
        pulled[i, :, J] += P[:, i, 1].reshape(shape) * wJ[J, 1]
    local = np.matmul(disc.shape_gradients.reshape(-1, disc.cell_dofs.shape[1]).T, pulled.reshape(d, -1, disc.n_cells))
    return _sum_to_nodes(disc, local)


def load_vector(disc: Discretization, q: Array) -> Array:
    """Nodal forces (n_nodes, d) of a load per reference area q: (d,) or (n_points, d), N/mm2."""
    q = np.broadcast_to(q, (disc.n_points, np.shape(q)[-1]))
    local = (q * disc.weight[:, None]).T.reshape(q.shape[1], disc.n_quad, disc.n_cells)
    return _sum_to_nodes(disc, np.matmul(disc.shape_values.T, local))


def stiffness(disc: Discretization, pattern: SparsityPattern, A: Array) -> Array:
    """Data (nnz,) of the lower triangle of K = sum_p w_p dphi_a/dx_j A_pijkl dphi_b/dx_l.

    A (n_points, d, 2, d, 2) is d2psi/dF2 with its major symmetry; only the blocks A[:, i, :, k, :], i >= k, are read.
    """
    shape = (disc.n_quad, disc.n_cells)
    iJ, w, g = disc.inverse_jacobian, disc.weight.reshape(shape), disc.shape_gradients
    products = np.einsum("qJa,qNb->abqJN", g, g).reshape(-1, 4 * disc.n_quad)
    pulled = np.empty((disc.n_quad, 2, 2, disc.n_cells))
    packed = np.empty(pattern.slot.shape).reshape(-1, len(products), disc.n_cells)
    for (i, k), block in zip(component_pairs(pattern.d), packed, strict=True):
        for J in range(2):
            half = [
                (iJ[J, 0] * A[:, i, 0, k, l].reshape(shape) + iJ[J, 1] * A[:, i, 1, k, l].reshape(shape)) * w
                for l in range(2)
            ]
            for N in range(2):
                np.multiply(half[0], iJ[N, 0], out=pulled[:, J, N])
                pulled[:, J, N] += half[1] * iJ[N, 1]
        np.matmul(products, pulled.reshape(-1, disc.n_cells), out=block)
    return pattern.scatter(packed)


def _sum_to_nodes(disc: Discretization, local: Array) -> Array:
    """Nodal sums (n_nodes, d) of cell vectors (d, n_local, n_cells)."""
    where = disc.cell_dofs.T.ravel()
    return np.stack([np.bincount(where, weights=f.ravel(), minlength=disc.n_nodes) for f in local], axis=-1)
