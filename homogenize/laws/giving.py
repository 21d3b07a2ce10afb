"""Rings that give by direction: ideal locking with a compliance that depends on the direction of the load.

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

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from homogenize.laws.geometry import Polyhedron, highest, outer_vertices, polyhedron_of
from homogenize.laws.polyhedral import PolyhedralLaw
from homogenize.laws.protocol import Cut, HalfSpaces, MembraneLaw, check_finite
from homogenize.laws.stored import StoredLaw
from rve.common import Array, InputError, checked
from rve.common.tensor import WEIGHT, disc, double_dot

LEAST_SHARE = 1e-3
"""Eigenvalues of a compliance below this share of the largest are raised to it: no load direction is rigid."""
FLOOR = 0.9
"""The floor's largest part of the compliance along a load. Nearer to 1: the stiffest direction is left to the floor
alone; smaller: the stress turns faster from one half-space to the next."""
SAME = 1e-9
"""Half-spaces nearer to each other than this are one."""
LEVELS = 13
"""Levels of tau between which support functions are interpolated."""
FAR = 100.0
"""Locked strains of a law of elastic curtains are not those of cells: bounds of I + 2E widen this much faster."""


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
    values = np.maximum(values, LEAST_SHARE * values.max())
    return np.asarray((vectors * values) @ vectors.T / WEIGHT[:, None])


def work_along(S: Array, A: Array) -> Array:
    """S:A S in mm/N for S (n, 3) and A (3, 3) or (n, 3, 3) in tensor components, (n,)."""
    return np.asarray(double_dot(S, (A @ S[:, :, None])[:, :, 0]))


@dataclass(frozen=True, eq=False, repr=False)
class GivingLaw(PolyhedralLaw):
    """A polyhedral law whose rings give by direction: its stiffness is that of the floor D0, `extra` (m,) are the roots
    g_i of its half-spaces, in (mm/N)^0.5.

    A law of elastic curtains. Strains may have a fourth component, tau, by which `cut` widens every half-space.
    """

    extra: Array

    def half_spaces(self) -> HalfSpaces:
        """Half-spaces to start with: the widening of each is its own, or the largest, which holds for all."""
        start = super().half_spaces()
        known = cKDTree(np.column_stack([disc(self.S), self.h]))
        distance, which = known.query(np.column_stack([disc(start.S), start.h]))
        return replace(start, extra=np.where(distance < SAME, self.extra[which], self.extra.max()))

    def cut(self, E: Array) -> Cut:
        """The most violated half-space of strains E (n, 3), or (n, 4) with tau, see MembraneLaw."""
        check_finite(E)
        E = E if E.shape[1] == 4 else np.column_stack([E, np.zeros(len(E))])
        worst, violation = self._body.worst(E)
        return Cut(self.S[worst], self.h[worst], violation, self.extra[worst])

    @cached_property
    def _body(self) -> Polyhedron:
        return polyhedron_of(self.S, self.h, self.stiffness, self.extra)

    elastic = StoredLaw.elastic

    def compliance_along(self, S: Array, size: float) -> Array:
        """Twice the complementary energy beyond size h(S), over size^2, mm/N, (n,): S:D S of this law at line loads
        size S in N/mm, S (n, 3) of unit trace.

        The largest of size H - tau^2/2 over tau, where H, the support function of half-spaces widened by tau, is
        concave in tau and taken as linear between LEVELS of it.
        """
        tau = size * self.extra.max() * np.linspace(0.0, 1.0, LEVELS) ** 2
        H = np.stack(
            [highest(S, outer_vertices(self.S, self.h + one * self.extra, FAR * one * self.extra.max())) for one in tau]
        )
        slope = np.diff(H, axis=0) / np.diff(tau)[:, None]
        at = np.clip(size * slope, tau[:-1, None], tau[1:, None])
        most = (size * (H[:-1] + slope * (at - tau[:-1, None])) - 0.5 * at**2).max(axis=0)
        return np.asarray(2.0 * (most - size * H[0]) / size**2 + work_along(S, self.compliance))


@checked
def elastic_law(law: MembraneLaw) -> MembraneLaw:
    """The law of an elastic curtain: with the compliance of its rings over the direction if it holds their strength,
    else a constant one.
    """
    return law.elastic()


def giving_law(law: PolyhedralLaw) -> GivingLaw | None:
    """The law with the compliance that its strength holds over the direction; None if it holds none."""
    strength = law.strength
    if strength is None:
        return None
    known = strength.stretched
    try:
        work = strength.compliance_along(law.S)
    except InputError:  # too few directions
        return None
    A = constant_compliance(known.S, known.compliance, known.is_mirrored)
    along = work_along(law.S, A)
    floor = FLOOR * float((work / along).min()) * A
    stiffness, extra = np.linalg.inv(floor), np.sqrt(work - work_along(law.S, floor))
    same = {one.name: getattr(law, one.name) for one in fields(law)}
    return GivingLaw(**(same | {"stiffness": stiffness, "extra": extra}))
