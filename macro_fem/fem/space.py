"""A plane curtain with the third coordinate added as an unknown.

The rigid curtain is a convex problem that is symmetric about its plane, so the plane answer is the answer in space.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from macro_fem.fem.supported import SupportedFem
from rve.common.types import Array


def in_space(fem: SupportedFem) -> SupportedFem:
    """The same curtain with nodes free to leave the plane, except where a support holds them."""
    out = np.asarray(~fem.held.any(axis=1))
    free = np.column_stack([fem.free.reshape(-1, 2), out]).ravel()
    tie = None
    if fem.tie is not None:
        n, rows = len(out), fem.tie.shape[0]
        node, axis = np.divmod(np.arange(rows), 2)
        plane = sparse.csr_matrix((np.ones(rows), (3 * node + axis, np.arange(rows))), shape=(3 * n, rows)) @ fem.tie
        up = np.flatnonzero(out)
        lift = sparse.csr_matrix((np.ones(len(up)), (3 * up + 2, np.arange(len(up)))), shape=(3 * n, len(up)))
        tie = sparse.hstack([plane, lift]).tocsc()
    return replace(fem, x_held=padded(fem.x_held), free=free, tie=tie)


def padded(plane: Array, d: int = 3) -> Array:
    """Vectors (n, 2) as vectors (n, d), with a third component 0 in space; always a copy."""
    return np.column_stack([plane, np.zeros((len(plane), d - 2))])


def out_of_plane(fem: SupportedFem, z: Array) -> float:
    """Largest distance of a node from the plane, mm; 0 for a plane problem."""
    return float(np.abs(fem.positions(z)[:, 2:]).max(initial=0.0))
