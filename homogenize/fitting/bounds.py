"""What the rows alone prove about the support function: a bound from inside and one from outside, no reference needed.

Inside: each row's strain is admissible, so h(S) >= max S:E_i. Outside: each row's half-space S_i:E <= h_i holds, and
C = I + 2E is positive semidefinite for every deformation, so h(S) <= max S:E over these. Half-spaces of singular C,
v.C v >= 0 for `DIRECTIONS` vectors v, keep the outer polyhedron bounded where the rows' loads do not reach.
"""

from dataclasses import dataclass

import numpy as np

from homogenize.laws.geometry import fibres, highest, outer_vertices
from homogenize.laws.polyhedral import PolyhedralLaw, polyhedral_law
from homogenize.laws.rows import LockedRows, with_mirror
from rve.common import Array, Index
from rve.common.tensor import WEIGHT, disc, double_dot, eigenvalues, from_disc, trace
from rve.geometry import CellInfo


@dataclass(frozen=True, eq=False)
class SupportBounds:
    """Vertices of the inner hull and of the outer polyhedron, as strains: inner (k, 3), outer (m, 3)."""

    inner: Array
    outer: Array

    def lower(self, S: Array) -> Array:
        """Lower bound of h at S (n, 3), (n,)."""
        return highest(S, self.inner)

    def upper(self, S: Array) -> Array:
        """Upper bound of h at S (n, 3), (n,)."""
        return highest(S, self.outer)

    def gap(self, S: Array) -> Array:
        """How far both are apart at S (n, 3), (n,), zero or more."""
        return np.maximum(self.upper(S) - self.lower(S), 0.0)


def bounds_of(rows: LockedRows) -> SupportBounds:
    """Inner and outer bound of the convex set behind the rows, mirror images included.

    InputError if the half-spaces do not bound the strain under tension (all loads along one direction, for instance).
    """
    both = with_mirror(rows)
    return SupportBounds(both.E, outer_vertices(both.S, both.h))


def outer_law(rows: LockedRows, stiffness: Array | None = None, cell: CellInfo | None = None) -> PolyhedralLaw:
    """The rows' half-spaces and their mirror images."""
    both = with_mirror(rows)
    return polyhedral_law(both.S, both.h, stiffness, cell)


def inner_law(rows: LockedRows, stiffness: Array | None = None, cell: CellInfo | None = None) -> PolyhedralLaw:
    """The hull of the rows' strains minus the tensile cone; between two rim loads it is passed by less than 1e-5."""
    from scipy.spatial import ConvexHull

    E = with_mirror(rows).E
    hull = ConvexHull(E, qhull_options="QJ")
    facets = hull.equations[:, :3] / WEIGHT
    facets = facets[eigenvalues(facets)[0] >= 0.0]
    # Loads of rank one of the inner law.
    S = np.vstack([facets / trace(facets)[:, None], fibres(720), rim_kinks(E, hull.simplices)])
    return polyhedral_law(S, highest(S, E), stiffness, cell)


def rim_kinks(E: Array, triangles: Index) -> Array:
    """Loads of rank one (k, 3) under which two corners of a triangle (m, 3) of the hull of strains E (n, 3) do the same
    work, and none more: h has a kink there, which loads beside it miss."""
    ends = np.unique(triangles[:, [0, 1, 1, 2, 2, 0, 1, 0, 2, 1, 0, 2]].reshape(-1, 2), axis=0)  # a side has two
    first, way = E[ends[:, 0]], E[ends[:, 1]] - E[ends[:, 0]]
    x, y = disc(way).T
    with np.errstate(divide="ignore", invalid="ignore"):  # nan where no load of rank one does no work along the side
        angle = np.arctan2(y, x) + np.arccos(-trace(way) / np.hypot(x, y))  # 2 S:way = trace(way) + disc(S).disc(way)
    S = from_disc(np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return S[double_dot(S, first) >= highest(S, E) - 1e-12]
