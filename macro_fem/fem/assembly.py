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
    >>> disc = discretize(skfem.MeshQuad.init_tensor(np.linspace(0, 2, 5), np.linspace(0, 1, 3)), "Q1")
    >>> u = disc.nodes @ np.array([[0.1, 0.0], [0.0, 0.0]])
    >>> bool(np.allclose(deformation_gradient(disc, u), [[1.1, 0.0], [0.0, 1.0]]))
    True
    >>> pattern = sparsity(disc, d=2, free=disc.nodes[:, 0] > 0.0)
    >>> A = np.broadcast_to(np.eye(4).reshape(2, 2, 2, 2), (disc.n_points, 2, 2, 2, 2))
    >>> pattern.full(stiffness(disc, pattern, A)).shape
    (24, 24)
"""

from __future__ import annotations

import numpy as np

from macro_fem.fem.discretization import Discretization
from macro_fem.fem.sparsity import SparsityPattern, component_pairs
from rve.common.types import Array


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


def deformation_gradient(disc: Discretization, u: Array) -> Array:
    """F = I + grad u (n_points, d, 2) of the displacement u (n_nodes, d); I is the first two columns of the unit."""
    F = gradient(disc, u)
    F[:, 0, 0] += 1.0
    F[:, 1, 1] += 1.0
    return F


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
    n_local = disc.cell_dofs.shape[1]
    shape = (disc.n_quad, disc.n_cells)
    iJ, w = disc.inverse_jacobian, disc.weight.reshape(shape)
    one, two = _pair_products(disc.shape_gradients)
    packed = np.empty(pattern.slot.shape)
    start = 0
    for i, k in component_pairs(pattern.d):
        block = [[A[:, i, j, k, l].reshape(shape) for l in range(2)] for j in range(2)]
        pulled = _pull_back(block, iJ, w, is_symmetric=i == k)
        products = one if i == k else two
        stop = start + (n_local * (n_local + 1) // 2 if i == k else n_local**2)
        np.matmul(products, pulled.reshape(-1, disc.n_cells), out=packed[start:stop])
        start = stop
    return pattern.scatter(packed)


def _sum_to_nodes(disc: Discretization, local: Array) -> Array:
    """Nodal sums (n_nodes, d) of cell vectors (d, n_local, n_cells)."""
    where = disc.cell_dofs.T.ravel()
    return np.stack([np.bincount(where, weights=f.ravel(), minlength=disc.n_nodes) for f in local], axis=-1)


def _pair_products(g: Array) -> tuple[Array, Array]:
    """Constant matrices that turn pulled-back tangents into packed entries.

    Of g (n_quad, 2, n_local): for i = k (n_local (n_local + 1)/2, 3 n_quad) with the entries 11, 12, 22 of a symmetric
    tangent, for i > k (n_local^2, 4 n_quad) with the entries 11, 12, 21, 22.
    """
    n_quad, _, n = g.shape
    full = np.einsum("qJa,qNb->abqJN", g, g)
    a, b = np.triu_indices(n)
    up = full[a, b]
    symmetric = np.stack([up[..., 0, 0], up[..., 0, 1] + up[..., 1, 0], up[..., 1, 1]], axis=-1)
    return symmetric.reshape(len(a), 3 * n_quad), full.reshape(n * n, 4 * n_quad)


def _pull_back(block: list[list[Array]], iJ: Array, w: Array, *, is_symmetric: bool) -> Array:
    """w_p iJ_Jj A_jl iJ_Nl (n_quad, 3 or 4, n_cells) of one component block, see `_pair_products`."""
    half = [[(iJ[J, 0] * block[0][l] + iJ[J, 1] * block[1][l]) * w for l in range(2)] for J in range(2)]
    entries = ((0, 0), (0, 1), (1, 1)) if is_symmetric else ((0, 0), (0, 1), (1, 0), (1, 1))
    out = np.empty((w.shape[0], len(entries), w.shape[1]))
    for m, (J, N) in enumerate(entries):
        np.multiply(half[J][0], iJ[N, 0], out=out[:, m])
        out[:, m] += half[J][1] * iJ[N, 1]
    return out
