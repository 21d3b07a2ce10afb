"""Where the entries of a stiffness matrix go, found once per mesh and set of unknowns.

The matrix is symmetric; its lower triangle is stored by columns. The packed entries of a cell are the blocks (i, k),
i >= k, of components in the order of `component_pairs`, each with all pairs of nodes; of a block with i = k one half is
left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from macro_fem.fem.discretization import Discretization, Index
from rve.common import Array


@dataclass(frozen=True, eq=False)
class SparsityPattern:
    """Where the entries of a symmetric matrix on the free unknowns go; made once by `sparsity`.

    number (n_nodes * d,): the free unknown of each flat number, -1 where it is held; d: components per node.
    indptr (n + 1,), indices (nnz,): compressed columns of the lower triangle with its diagonal.
    slot (n_entries, n_cells): place in the data of each packed entry of a cell, nnz for "not free" and "left out".
    """

    number: Index
    d: int
    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    slot: Index

    @property
    def n(self) -> int:
        """Number of free unknowns."""
        return len(self.indptr) - 1

    @property
    def nnz(self) -> int:
        """Stored entries of the lower triangle."""
        return len(self.indices)

    def scatter(self, packed: Array) -> Array:
        """Data (nnz,) of the lower triangle from the packed entries (n_entries, n_cells) of all cells."""
        return np.asarray(
            np.bincount(self.slot.ravel(), weights=packed.ravel(), minlength=self.nnz + 1)[: self.nnz], dtype=np.float64
        )

    def full(self, data: Array) -> sparse.csc_matrix:
        """Both triangles as a sparse matrix (what SuperLU and conjugate gradients read)."""
        indptr, indices, source = self._mirror
        return _csc(data[source], indices, indptr, self.n)

    def place(self, row: Index, column: Index) -> Index:
        """Places in the data of entries (...) by their flat numbers: -1 above the diagonal and where one is held.

        The others must be entries of the pattern.
        """
        i, j = self.number[row], self.number[column]
        return np.where((j >= 0) & (i >= j), np.searchsorted(self._keys, j * self.n + i), -1)

    @cached_property
    def _keys(self) -> Index:
        column = np.repeat(np.arange(self.n), np.diff(self.indptr))
        return np.asarray(column * self.n + self.indices, dtype=np.int64)

    @cached_property
    def _mirror(self) -> tuple[NDArray[np.int32], NDArray[np.int32], Index]:
        # Numbers from 1 ride along as data: scipy sorts them into the full pattern once and for all.
        lower = _csc(np.arange(1.0, self.nnz + 1.0), self.indices, self.indptr, self.n)
        full = (lower + sparse.tril(lower, -1).T).tocsc()
        full.sort_indices()
        return full.indptr, full.indices, full.data.astype(np.int64) - 1


def sparsity(disc: Discretization, d: int, free: NDArray[Any], loose: int = 0) -> SparsityPattern:
    """The pattern of stiffness matrices on the free unknowns.

    `free` (n_nodes, d) or flat: which components are. The last `loose` nodes belong to no cell and are coupled with all
    others.
    """
    free = np.ravel(free)
    number = np.cumsum(free) - 1
    nodes = disc.cell_dofs.T
    n_local = len(nodes)
    a, b = np.triu_indices(n_local)
    key = np.minimum(nodes[a], nodes[b]) * disc.n_nodes + np.maximum(nodes[a], nodes[b])
    keys, pair = np.unique(key, return_inverse=True)
    column, row = np.divmod(keys, disc.n_nodes)
    if loose:
        every, last = np.indices((disc.n_nodes, loose)).reshape(2, -1)
        last += disc.n_nodes - loose
        column = np.concatenate([column, every[every <= last]])
        row = np.concatenate([row, last[every <= last]])
    # entries (n_pairs, d, d) of the pairs, row component first; those above the diagonal or held have no place
    i, j = np.broadcast_arrays(d * row[:, None, None] + np.arange(d)[:, None], d * column[:, None, None] + np.arange(d))
    is_stored = free[i] & free[j] & (i >= j)
    count, n = int(np.count_nonzero(is_stored)), int(free.sum())
    stored = (number[i[is_stored]], number[j[is_stored]])
    lower = sparse.csc_matrix((np.arange(count), stored), shape=(n, n))
    lower.sort_indices()
    place = np.full(is_stored.shape, count)
    sorted_place = np.empty(count, dtype=np.int64)
    sorted_place[lower.data] = np.arange(count)
    place[is_stored] = sorted_place
    pair_of = np.empty((n_local, n_local, disc.n_cells), dtype=np.int64)
    pair_of[a, b] = pair_of[b, a] = pair.reshape(key.shape)
    is_first = nodes[:, None] < nodes[None, :]
    slots = []
    for k, l in component_pairs(d):
        other = count if k == l else place[pair_of, l, k]
        slots.append(np.where(is_first, other, place[pair_of, k, l]).reshape(n_local**2, -1))
    index = (lower.indptr.astype(np.int32), lower.indices.astype(np.int32))
    return SparsityPattern(np.where(free, number, -1), d, *index, np.concatenate(slots))


def component_pairs(d: int) -> list[tuple[int, int]]:
    """The blocks (i, k), i >= k, in the order of the packed entries."""
    return [(i, k) for i in range(d) for k in range(i + 1)]


def _csc(data: Array, indices: NDArray[Any], indptr: NDArray[Any], n: int) -> sparse.csc_matrix:
    matrix = sparse.csc_matrix((data, indices, indptr), shape=(n, n))
    matrix.has_sorted_indices = True
    return matrix
