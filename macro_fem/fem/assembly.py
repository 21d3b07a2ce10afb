"""From a mesh to arrays: gradients, internal forces and stiffness matrices of a membrane, without a loop over cells.

A mesh and an element are turned into arrays once (`discretize`), the places of the matrix entries once per set of
free unknowns (`sparsity`). After that every Newton iteration is a handful of array operations. The gradients are taken
in the coordinates of the reference element, where they are the same numbers for every cell, so that the sums over
quadrature points and nodes are small dense matrix products; entries reach their place in the matrix by one `bincount`.

Shapes: the point p is the leading axis, p = q * n_cells + cell for quadrature point q. The unknown u (n_nodes, d) has
d = 2 components (plane) or d = 3 (space); its flat number is node * d + component. The gradient F is (n_points, d, 2):
the reference state is always plane. Component slices such as F[:, 0, 1] of returned arrays are contiguous.

Example:
    >>> import numpy as np, skfem
    >>> disc = discretize(skfem.MeshQuad.init_tensor(np.linspace(0, 2, 5), np.linspace(0, 1, 3)), "Q1")
    >>> u = disc.nodes @ np.array([[0.1, 0.0], [0.0, 0.0]])
    >>> bool(np.allclose(deformation_gradient(disc, u), [[1.1, 0.0], [0.0, 1.0]]))
    True
    >>> pattern = sparsity(disc, d=2, free=disc.nodes[:, 0] > 0.0)
    >>> A = np.zeros((disc.n_points, 2, 2, 2, 2))
    >>> for i, j in np.ndindex(2, 2):
    ...     A[:, i, j, i, j] = 1.0
    >>> K = pattern.full(stiffness(disc, pattern, A))
    >>> K.shape
    (24, 24)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray
from scipy import sparse

from rve.common.types import Array

Index = NDArray[np.int64]

# Element and order of its quadrature. P1 and CR have constant gradients; the others take the fewest points that
# integrate the stiffness of an undistorted cell without spurious modes.
_ELEMENTS: dict[str, tuple[Any, Any, int]] = {
    "P1": (skfem.MeshTri1, skfem.ElementTriP1, 0),
    "CR": (skfem.MeshTri1, skfem.ElementTriCR, 0),
    "P2": (skfem.MeshTri1, skfem.ElementTriP2, 2),
    "Q1": (skfem.MeshQuad1, skfem.ElementQuad1, 3),
    "Q2": (skfem.MeshQuad1, skfem.ElementQuad2, 5),
}
ELEMENTS = tuple(_ELEMENTS)


@dataclass(frozen=True, eq=False)
class Discretization:
    """A mesh and an element as arrays. See the module header for the order of points.

    nodes (n_nodes, 2): positions of the unknowns in the reference state, mm (CR: midpoints of edges).
    cell_dofs (n_cells, n_local): node numbers of each cell.
    shape_values (n_quad, n_local) and shape_gradients (n_quad, 2, n_local): in the reference element.
    inverse_jacobian (2, 2, n_quad, n_cells): dX_J/dx_j, or with n_quad replaced by 1 where it is constant in the cell.
    weight (n_points,): quadrature weight times area, mm2.
    """

    element: str
    nodes: Array
    cell_dofs: Index
    shape_values: Array
    shape_gradients: Array
    inverse_jacobian: Array
    weight: Array

    @property
    def n_nodes(self) -> int:
        """Number of nodes; the unknown has d components at each."""
        return self.nodes.shape[0]

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return self.cell_dofs.shape[0]

    @property
    def n_quad(self) -> int:
        """Quadrature points in a cell."""
        return self.shape_values.shape[0]

    @property
    def n_points(self) -> int:
        """Quadrature points of the whole mesh."""
        return self.n_quad * self.n_cells

    @cached_property
    def cell(self) -> Index:
        """The cell of each point, (n_points,)."""
        return np.tile(np.arange(self.n_cells), self.n_quad)

    @cached_property
    def dofs(self) -> Index:
        """The node numbers seen by each point, (n_points, n_local)."""
        return np.tile(self.cell_dofs, (self.n_quad, 1))

    @cached_property
    def phi(self) -> Array:
        """The shape functions at each point, (n_points, n_local)."""
        return np.repeat(self.shape_values, self.n_cells, axis=0)

    @cached_property
    def grad(self) -> Array:
        """The gradients of the shape functions at each point, (n_points, n_local, 2), 1/mm."""
        g = np.einsum("qJa,Jjqc->qcaj", self.shape_gradients, self._jacobian_at_points)
        return g.reshape(self.n_points, -1, 2)

    @cached_property
    def points(self) -> Array:
        """Positions of the points in the reference state, (n_points, 2), mm."""
        # Every element here reproduces the reference position, CR's edge midpoints included.
        return interpolate(self, self.nodes)

    @property
    def _jacobian_at_points(self) -> Array:
        shape = (2, 2, self.n_quad, self.n_cells)
        return np.broadcast_to(self.inverse_jacobian, shape)


@dataclass(frozen=True, eq=False)
class Pattern:
    """Where the entries of a symmetric matrix on the free unknowns go; made once by `sparsity`.

    n: number of free unknowns; free (n,): their flat numbers, increasing; d: components per node.
    indptr (n + 1,), indices (nnz,): compressed columns of the lower triangle with its diagonal.
    slot (n_entries, n_cells): place in the data of each packed entry of a cell, nnz for "not free".
    """

    n: int
    d: int
    free: Index
    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    slot: Index

    @property
    def nnz(self) -> int:
        """Stored entries of the lower triangle."""
        return len(self.indices)

    def scatter(self, packed: Array) -> Array:
        """Data (nnz,) of the lower triangle from the packed entries (n_entries, n_cells) of all cells."""
        return np.asarray(
            np.bincount(self.slot.ravel(), weights=packed.ravel(), minlength=self.nnz + 1)[: self.nnz], dtype=np.float64
        )

    def lower(self, data: Array) -> sparse.csc_matrix:
        """The lower triangle as a sparse matrix that shares `data` (what CHOLMOD reads)."""
        return _csc(data, self.indices, self.indptr, self.n)

    def full(self, data: Array) -> sparse.csc_matrix:
        """Both triangles as a sparse matrix (what SuperLU and conjugate gradients read)."""
        indptr, indices, source = self._mirror
        return _csc(data[source], indices, indptr, self.n)

    @cached_property
    def diagonal(self) -> Index:
        """Places of the diagonal in the data, (n,): each column of the lower triangle begins with it."""
        return self.indptr[:-1].astype(np.int64)

    @cached_property
    def _mirror(self) -> tuple[NDArray[np.int32], NDArray[np.int32], Index]:
        # Numbers from 1 ride along as data: scipy sorts them into the full pattern once and for all.
        lower = self.lower(np.arange(1.0, self.nnz + 1.0))
        full = (lower + sparse.tril(lower, -1).T).tocsc()
        full.sort_indices()
        return full.indptr, full.indices, full.data.astype(np.int64) - 1


def discretize(mesh: Any, element: str, order: int | None = None) -> Discretization:
    """The arrays of a scikit-fem mesh (`MeshTri`, `MeshQuad`) with an element of `ELEMENTS`.

    `order` is the polynomial degree integrated exactly in an undistorted cell; None takes the element's own.
    Raises ValueError for an unknown element, one that does not fit the cells, or a cell without area.
    """
    if element not in _ELEMENTS:
        raise ValueError(f"element = {element!r} is not one of {', '.join(ELEMENTS)}")
    mesh_type, element_type, own_order = _ELEMENTS[element]
    if not isinstance(mesh, mesh_type):
        raise ValueError(f"element {element} needs a {mesh_type.__name__}, not a {type(mesh).__name__}")
    degree = own_order if order is None else order
    # scikit-fem starts at three points on a triangle; a constant gradient needs one.
    rule = (np.full((2, 1), 1 / 3), np.array([0.5])) if degree <= 1 and mesh_type is skfem.MeshTri1 else None
    basis = skfem.CellBasis(mesh, element_type(), intorder=degree, quadrature=rule)
    X = basis.X
    n_local = basis.element_dofs.shape[0]
    local = [element_type().lbasis(X, a) for a in range(n_local)]
    ones = np.ones(X.shape[1])
    # A transposed copy, because the cell is the fast axis of every product below.
    inverse = np.ascontiguousarray(np.moveaxis(basis.mapping.invDF(X), -1, 2))
    weight = np.ascontiguousarray(basis.dx.T).ravel()
    if not (np.all(np.isfinite(weight)) and np.all(weight > 0.0)):
        bad = int(np.flatnonzero(~(weight > 0.0))[0]) % mesh.nelements
        raise ValueError(f"cell {bad} of the mesh has no area")
    if mesh_type is skfem.MeshTri1:
        inverse = np.ascontiguousarray(inverse[:, :, :1])
    return Discretization(
        element=element,
        nodes=np.ascontiguousarray(basis.doflocs.T),
        cell_dofs=np.ascontiguousarray(basis.element_dofs.T.astype(np.int64)),
        shape_values=np.stack([value * ones for value, _ in local], axis=-1),
        shape_gradients=np.stack([np.asarray(g) * np.ones_like(X) for _, g in local], axis=-1)
        .transpose(1, 0, 2)
        .copy(),
        inverse_jacobian=inverse,
        weight=weight,
    )


def interpolate(disc: Discretization, v: Array) -> Array:
    """The nodal field v (n_nodes, d) at the points, (n_points, d)."""
    local = v.T[:, disc.cell_dofs.T]
    return np.matmul(disc.shape_values, local).reshape(v.shape[1], -1).T


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


def cell_mean(disc: Discretization, values: Array) -> Array:
    """The area mean in each cell (n_cells, ...) of values at the points (n_points, ...)."""
    w = disc.weight.reshape(disc.n_quad, disc.n_cells)
    stacked = values.reshape(disc.n_quad, disc.n_cells, -1)
    mean = np.einsum("qc,qcx->cx", w / w.sum(axis=0), stacked)
    return mean.reshape((disc.n_cells, *values.shape[1:]))


def sparsity(disc: Discretization, d: int, free: NDArray[Any]) -> Pattern:
    """The pattern of stiffness matrices on the free unknowns.

    `free` is a Boolean mask: (n_nodes,) frees all components of a node, (n_nodes, d) or (n_nodes * d,) single ones.
    """
    free = np.asarray(free, dtype=bool)
    if free.size == disc.n_nodes:
        free = np.repeat(free.reshape(-1, 1), d, axis=1)
    if free.size != disc.n_nodes * d:
        raise ValueError(f"free has {free.size} entries, the mesh has {disc.n_nodes} nodes of {d} components")
    free = free.ravel()
    pair, swap = _node_pairs(disc)
    place, rows, columns = _lower_places(disc.n_nodes, d, pair.keys)
    keep = free[rows] & free[columns]
    nnz = int(np.count_nonzero(keep))
    number = np.cumsum(free) - 1
    counts = np.bincount(number[columns[keep]], minlength=int(free.sum()))
    new_place = np.where(keep, np.cumsum(keep) - 1, nnz)
    return Pattern(
        n=len(counts),
        d=d,
        free=np.flatnonzero(free),
        indptr=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        indices=number[rows[keep]].astype(np.int32),
        slot=np.concatenate([new_place[block] for block in _packed_places(d, pair.number, swap, place)]),
    )


def stiffness(disc: Discretization, pattern: Pattern, A: Array) -> Array:
    """Data (nnz,) of the lower triangle of K = sum_p w_p dphi_a/dx_j A_pijkl dphi_b/dx_l.

    A (n_points, d, 2, d, 2) is d2psi/dF2 with its major symmetry; only the blocks A[:, i, :, k, :], i >= k, are read.
    """
    n_local = disc.cell_dofs.shape[1]
    shape = (disc.n_quad, disc.n_cells)
    iJ, w = disc.inverse_jacobian, disc.weight.reshape(shape)
    one, two = _pair_products(disc.shape_gradients)
    packed = np.empty(pattern.slot.shape)
    start = 0
    for i, k in _component_pairs(pattern.d):
        block = [[A[:, i, j, k, l].reshape(shape) for l in range(2)] for j in range(2)]
        pulled = _pull_back(block, iJ, w, is_symmetric=i == k)
        products = one if i == k else two
        stop = start + (n_local * (n_local + 1) // 2 if i == k else n_local**2)
        np.matmul(products, pulled.reshape(-1, disc.n_cells), out=packed[start:stop])
        start = stop
    return pattern.scatter(packed)


def tied_pattern(pattern: Pattern, tie: sparse.csc_matrix) -> tuple[Pattern, sparse.csr_matrix]:
    """The pattern of T^T K T for a `tie` T (n, n_z), and the matrix that turns K's entries into its lower triangle's.

    `pattern` is that of K on all n unknowns; the second matrix multiplies `pattern.full(data).data`.
    """
    numbers = pattern.full(np.zeros(pattern.nnz))
    row, column = numbers.indices, np.repeat(np.arange(numbers.shape[0]), np.diff(numbers.indptr))
    masters, shares = _padded_rows(tie)
    n = tie.shape[1]
    keys, entries, values = [], [], []
    for a, b in np.ndindex(masters.shape[1], masters.shape[1]):
        i, j = masters[row, a], masters[column, b]
        keep = (j >= 0) & (i >= j)
        keys.append((j * n + i)[keep])
        entries.append(np.flatnonzero(keep))
        values.append((shares[row, a] * shares[column, b])[keep])
    unique, place = np.unique(np.concatenate(keys), return_inverse=True)
    shape = (len(unique), numbers.nnz)
    spread = sparse.coo_matrix((np.concatenate(values), (place, np.concatenate(entries))), shape=shape).tocsr()
    j, i = np.divmod(unique, n)
    indptr = np.searchsorted(j, np.arange(n + 1)).astype(np.int32)
    no_slot = np.zeros((0, 0), dtype=np.int64)
    return Pattern(n, pattern.d, np.arange(n), indptr, i.astype(np.int32), no_slot), spread


def pack_blocks(blocks: Array, d: int) -> Array:
    """Packed entries (n_entries, n_cells) for `Pattern.scatter` from symmetric cell matrices (n_cells, m, m).

    m = n_local * d; row a * d + i of a block belongs to component i of the cell's node a.
    """
    n_cells, m, _ = blocks.shape
    n = m // d
    B = blocks.reshape(n_cells, n, d, n, d)
    upper = np.triu_indices(n)
    parts = []
    for i, k in _component_pairs(d):
        one = B[:, :, i, :, k]
        parts.append(one[:, upper[0], upper[1]].T if i == k else one.reshape(n_cells, n * n).T)
    return np.ascontiguousarray(np.concatenate(parts))


def _padded_rows(T: sparse.csc_matrix) -> tuple[np.ndarray, Array]:
    """Columns and values of the rows of T as (rows, widest): absent entries are column -1 and value 0."""
    T = T.tocsr()
    length = np.diff(T.indptr)
    where = (np.repeat(np.arange(T.shape[0]), length), np.arange(T.nnz) - np.repeat(T.indptr[:-1], length))
    columns = np.full((T.shape[0], int(length.max())), -1, dtype=np.int64)
    values = np.zeros(columns.shape)
    columns[where], values[where] = T.indices, T.data
    return columns, values


def _csc(data: Array, indices: NDArray[Any], indptr: NDArray[Any], n: int) -> sparse.csc_matrix:
    matrix = sparse.csc_matrix((data, indices, indptr), shape=(n, n))
    matrix.has_sorted_indices = True
    return matrix


def _sum_to_nodes(disc: Discretization, local: Array) -> Array:
    """Nodal sums (n_nodes, d) of cell vectors (d, n_local, n_cells)."""
    where = disc.cell_dofs.T.ravel()
    return np.stack([np.bincount(where, weights=f.ravel(), minlength=disc.n_nodes) for f in local], axis=-1)


def _component_pairs(d: int) -> list[tuple[int, int]]:
    """The blocks (i, k), i >= k, in the order of the packed entries."""
    return [(i, k) for i in range(d) for k in range(i + 1)]


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


@dataclass(frozen=True)
class _Pairs:
    """Distinct pairs of nodes that share a cell: keys (n_pairs,) column * n_nodes + row; number (n, n, n_cells)."""

    keys: Index
    number: Index


def _node_pairs(disc: Discretization) -> tuple[_Pairs, NDArray[np.bool_]]:
    """Pairs of all cells, and where local node a has the smaller number than local node b, (n, n, n_cells)."""
    nodes = disc.cell_dofs.T
    n = len(nodes)
    a, b = np.triu_indices(n)
    key = np.minimum(nodes[a], nodes[b]) * disc.n_nodes + np.maximum(nodes[a], nodes[b])
    keys, inverse = np.unique(key, return_inverse=True)
    number = np.empty((n, n, disc.n_cells), dtype=np.int64)
    number[a, b] = inverse.reshape(key.shape)
    number[b, a] = number[a, b]
    return _Pairs(keys, number), nodes[:, None] < nodes[None, :]


def _lower_places(n_nodes: int, d: int, keys: Index) -> tuple[Index, Index, Index]:
    """Places (n_pairs, d, d) of the entries [row component, column component] of node pairs, and all rows and columns.

    Nodes that no cell uses have no diagonal pair and so no entry.
    """
    column, row = np.divmod(keys, n_nodes)
    pairs_of = np.bincount(column, minlength=n_nodes)
    # Column (J, l) holds d - l entries of the diagonal block (if any) and d for each other pair.
    used = pairs_of > 0
    length = (pairs_of - 1)[:, None] * d + (d - np.arange(d))
    length = np.where(used[:, None], length, 0)
    begin = np.concatenate([[0], np.cumsum(length.ravel())])
    rank = np.arange(len(keys)) - (np.cumsum(pairs_of) - pairs_of)[column]
    k, l = np.arange(d)[:, None], np.arange(d)[None, :]
    offset = np.where(rank[:, None, None] == 0, k - l, (rank[:, None, None] - 1) * d + d - l + k)
    place = begin[column[:, None, None] * d + l] + offset
    is_entry = (rank[:, None, None] > 0) | (k >= l)
    rows = np.empty(begin[-1], dtype=np.int64)
    columns = np.empty(begin[-1], dtype=np.int64)
    shape = place.shape
    rows[place[is_entry]] = np.broadcast_to(row[:, None, None] * d + k, shape)[is_entry]
    columns[place[is_entry]] = np.broadcast_to(column[:, None, None] * d + l, shape)[is_entry]
    return place, rows, columns


def _packed_places(d: int, number: Index, swap: NDArray[np.bool_], place: Index) -> list[Index]:
    """For each component block the places (n_entries, n_cells) in the unrestricted lower triangle."""
    n = len(number)
    upper = np.triu_indices(n)
    blocks = []
    for i, k in _component_pairs(d):
        both = np.where(swap, place[number, k, i], place[number, i, k])
        blocks.append(both[upper] if i == k else both.reshape(n * n, -1))
    return blocks
