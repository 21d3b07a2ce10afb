"""Bodies with mass as further nodes of a curtain's discretisation that belong to no cell.

A half-space n.(x_i - c) >= R between a point of the curtain and the centre c of a ball has the share 1 at the nodes of
the point and -1 at the node of the ball, so that the push on both is the same by construction. Newton's matrix gets
full rows for these nodes, which come last.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from macro_fem.fem.sparsity import SparsityPattern
from macro_fem.fem.supported import SupportedFem


def with_loose_nodes(fem: SupportedFem, count: int) -> SupportedFem:
    """The discretisation with `count` free nodes more, numbered last and coupled with all others; x_held is 0 there."""
    if not count:
        return fem
    d = fem.d
    nodes = np.vstack([fem.disc.nodes, np.tile(fem.disc.nodes.mean(axis=0), (count, 1))])
    tie = None if fem.tie is None else sparse.csc_matrix(sparse.block_diag([fem.tie, sparse.eye(d * count)]))
    out = replace(
        fem,
        disc=replace(fem.disc, nodes=nodes),
        x_held=np.vstack([fem.x_held, np.zeros((count, d))]),
        free=np.concatenate([fem.free, np.ones(d * count, bool)]),
        tie=tie,
    )
    out.__dict__["pattern"] = bordered(fem.pattern, fem.x_held.size, d * count)
    return out


def bordered(pattern: SparsityPattern, number: int, count: int) -> SparsityPattern:
    """The pattern with `count` free unknowns more, with flat numbers from `number` on, that are coupled with all."""
    n, nnz = pattern.n, pattern.nnz
    per_column = np.diff(pattern.indptr)
    column = np.repeat(np.arange(n), per_column)
    first = np.concatenate([pattern.indptr[:-1] + count * np.arange(n), [nnz + count * n]])
    own = np.concatenate([first[:-1], first[-1] + np.cumsum(np.arange(count, 0, -1)) - np.arange(count, 0, -1)])
    total = nnz + count * n + count * (count + 1) // 2
    indices = np.empty(total, np.int32)
    place = np.arange(nnz) + count * column
    indices[place] = pattern.indices
    more = first[:-1] + per_column
    indices[more[:, None] + np.arange(count)] = n + np.arange(count)
    indices[nnz + count * n :] = n + np.concatenate([np.arange(k, count) for k in range(count)])
    slot = np.concatenate([place, [total]])[pattern.slot]
    free = np.concatenate([pattern.free, number + np.arange(count)])
    indptr = np.concatenate([own, [total]]).astype(np.int32)
    return SparsityPattern(n + count, pattern.d, free, indptr, indices, slot)
