"""A compliance that depends on the direction of the load, as one of a floor and widenings of half-spaces.

Let d_i = S_i:D S_i be the compliance of the rings along the load of every half-space S_i:E <= h_i of a law. The law is

    Psi(E) = min over E*, tau of  (E - E*):D0^-1:(E - E*)/2 + tau^2/2   subject to   S_i:E* - g_i tau <= h_i,

with the floor D0, one compliance for all directions with S_i:D0 S_i <= FLOOR d_i, and g_i^2 = d_i - S_i:D0 S_i. Under
t S_i the complementary energy is t h_i + t^2 d_i/2, or less where loads on both sides of S_i have less together: Psi is
the largest convex energy that is nowhere above these. It is convex and differentiable whatever the d_i are, since D0 is
positive definite, and its stress is a sum of the S_i, so tensile. d_i = S_i:D S_i with one D for all would be the
constant compliance.

With y = (R E, tau) as in `homogenize.laws.geometry` this is the closest point of a polyhedron in four dimensions, of
whose half-spaces at most four are active.
"""

import numpy as np

from homogenize.laws.strength import Strength
from rve.common import Array, InputError
from rve.common.tensor import WEIGHT, double_dot

FLOOR = 0.9
"""The floor's largest part of the compliance along a load. Nearer to 1: the stiffest direction is left to the floor
alone; smaller: the stress turns faster from one half-space to the next."""


def constant_compliance(S: Array, work: Array, is_mirrored: bool) -> Array:
    """A (3, 3) in tensor components, mm/N, whose S:A S is nearest to `work` (n,) > 0 in mm/N, at loads S (n, 3).

    Least squares of the relative error; of a weave that is its own mirror image A does not couple shear to the other
    components.
    """
    i, j = np.triu_indices(3)
    if is_mirrored:
        even = (i == 1) == (j == 1)
        i, j = i[even], j[even]
    terms = S[:, i] * S[:, j] * np.where(i == j, 1.0, 2.0)
    A = np.zeros((3, 3))
    A[i, j] = A[j, i] = np.linalg.lstsq(terms / work[:, None], np.ones(len(work)), rcond=None)[0]
    values, vectors = np.linalg.eigh(A)
    # Eigenvalues of a compliance below this share of the largest are raised to it: no load direction is rigid.
    values = np.maximum(values, 1e-3 * values.max())
    return np.asarray((vectors * values) @ vectors.T / WEIGHT[:, None])


def work_along(S: Array, A: Array) -> Array:
    """S:A S in mm/N for S (n, 3) and A (3, 3) or (n, 3, 3) in tensor components, (n,)."""
    return np.asarray(double_dot(S, (A @ S[:, :, None])[:, :, 0]))


def split_compliance(S: Array, strength: Strength) -> tuple[Array, Array] | None:
    """Stiffness D0^-1 (3, 3) of the floor in N/mm and widenings g (m,) in (mm/N)^0.5 of half-spaces of loads S (m, 3)
    of unit trace; None if the strength has too few directions."""
    rows = strength.stretched
    try:
        work = strength.compliance_along(S)
    except InputError:
        return None
    A = constant_compliance(rows.S, rows.compliance, rows.is_mirrored)
    floor = FLOOR * float((work / work_along(S, A)).min()) * A
    return np.asarray(np.linalg.inv(floor)), np.asarray(np.sqrt(work - work_along(S, floor)))
