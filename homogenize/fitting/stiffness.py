"""Stiffness beyond locking from the rings' own compliance.

Rings that give, or contacts of finite stiffness, make the locked strain depend on the size of the load, E = dh/dS + A
S. The compliance D = dE/dS of a row holds both: the bend of the locking surface, which has no part along S because h is
homogeneous of degree one, and A. So S:D S = S:A S, and one positive definite A with the symmetry of the weave is fitted
to these. The strength of the law keeps S:D S of every direction (`homogenize.strength`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rve.common.errors import InputError
from rve.common.tensor import WEIGHT
from rve.common.types import Array

if TYPE_CHECKING:
    from rve import StrainTable

LEAST_SHARE = 1e-3
"""Eigenvalues of A below this share of the largest are raised to it: no load direction is rigid."""


def compliance_fit(S: Array, D: Array, is_mirrored: bool) -> Array:
    """A (3, 3) in tensor components, mm/N, from loads S (n, 3) and rows' compliances D (n, 3, 3).

    Least squares of S:A S against S:D S, both relative to S:D S; of a weave that is its own mirror image A does not
    couple shear to the other components. InputError if no row has a finite positive S:D S.
    """
    work = np.einsum("ni,nij,nj->n", S * WEIGHT, D, S)
    ok = np.isfinite(work) & (work > 0.0)
    if not ok.any():
        raise InputError("no row of the table has a compliance with S:D S > 0")
    S, work = S[ok], work[ok]
    i, j = np.triu_indices(3)
    if is_mirrored:
        even = (i == 1) == (j == 1)
        i, j = i[even], j[even]
    terms = S[:, i] * S[:, j] * np.where(i == j, 1.0, 2.0)
    A = np.zeros((3, 3))
    A[i, j] = A[j, i] = np.linalg.lstsq(terms / work[:, None], np.ones(len(work)), rcond=None)[0]
    values, vectors = np.linalg.eigh(A)
    values = np.maximum(values, LEAST_SHARE * values.max())
    return np.asarray((vectors * values) @ vectors.T / WEIGHT[:, None])


def stiffness_of(table: StrainTable, stated: float) -> tuple[Array, str]:
    """Stiffness (3, 3) in tensor components, N/mm, and where it comes from: the table's compliance, or `stated`."""
    if table.compliance is None:
        return stated * np.eye(3), f"stated: {stated:g} N/mm for every strain, not from the table"
    rows = table.converged & table.unique
    S, D = table.S[rows], table.compliance[rows]
    A = compliance_fit(S, D, table.is_mirrored)
    found, exact = (np.einsum("ni,nij,nj->n", S * WEIGHT, M, S) for M in (np.broadcast_to(A, D.shape), D))
    known = np.isfinite(exact) & (exact > 0.0)
    share = found[known] / exact[known]
    origin = (
        f"the rows' compliance along their own load, S:D S of the rows times {share.min():.3g} to {share.max():.3g}"
    )
    return np.asarray(np.linalg.inv(A)), origin
