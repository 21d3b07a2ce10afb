"""Where the entries of a stiffness matrix go, found once per mesh and set of unknowns.

The matrix is symmetric; its lower triangle is stored by columns. The packed entries of a cell are the blocks (i, k),
i >= k, of components in the order of `component_pairs`; a block with i = k holds the pairs of nodes a <= b, the others
all pairs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from macro_fem.fem.discretization import Discretization, Index
from rve.common.types import Array


@dataclass(frozen=True, eq=False)
class SparsityPattern:
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

    def place(self, row: Index, column: Index) -> Index:
        """Places in the data of entries (k,) of the lower triangle, which must be stored."""
        found = np.searchsorted(self._keys, column * self.n + row)
        return np.asarray(found, dtype=np.int64)

    @cached_property
    def _keys(self) -> Index:
        column = np.repeat(np.arange(self.n), np.diff(self.indptr))
        return np.asarray(column * self.n + self.indices, dtype=np.int64)

    @cached_property
    def _mirror(self) -> tuple[NDArray[np.int32], NDArray[np.int32], Index]:
        # Numbers from 1 ride along as data: scipy sorts them into the full pattern once and for all.
        lower = self.lower(np.arange(1.0, self.nnz + 1.0))
        full = (lower + sparse.tril(lower, -1).T).tocsc()
        full.sort_indices()
        return full.indptr, full.indices, full.data.astype(np.int64) - 1


def sparsity(disc: Discretization, d: int, free: NDArray[Any]) -> SparsityPattern:
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
    return SparsityPattern(
        n=len(counts),
        d=d,
        free=np.flatnonzero(free),
        indptr=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        indices=number[rows[keep]].astype(np.int32),
        slot=np.concatenate([new_place[block] for block in _packed_places(d, pair.number, swap, place)]),
    )


def tied_pattern(pattern: SparsityPattern, tie: sparse.csc_matrix) -> tuple[SparsityPattern, sparse.csr_matrix]:
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
    return SparsityPattern(n, pattern.d, np.arange(n), indptr, i.astype(np.int32), no_slot), spread


def component_pairs(d: int) -> list[tuple[int, int]]:
    """The blocks (i, k), i >= k, in the order of the packed entries."""
    return [(i, k) for i in range(d) for k in range(i + 1)]


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
    for i, k in component_pairs(d):
        both = np.where(swap, place[number, k, i], place[number, i, k])
        blocks.append(both[upper] if i == k else both.reshape(n * n, -1))
    return blocks
