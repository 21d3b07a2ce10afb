"""The plain baseline: strains interpolated over the two angles of the load, component by component.

It is what a user would try first and what Fig. 13 of the paper suggests. Nothing makes the interpolant convex, so as a
law it is the hull of its own strains on a fine grid: convex, but between the rows neither inside nor outside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from homogenize.fitting.bounds import inner_law
from homogenize.fitting.rows import Rows
from homogenize.laws.polyhedral import PolyhedralLaw
from homogenize.laws.protocol import CellInfo
from rve.common.errors import InputError
from rve.common.tensor import double_dot
from rve.common.types import Array

if TYPE_CHECKING:
    from rve import StrainTable


@dataclass(frozen=True, eq=False)
class AngleInterpolant:
    """E (a, b, 3) on the grid alpha_deg (a,), beta_deg (b,), piecewise linear or cubic between."""

    alpha_deg: Array
    beta_deg: Array
    E: Array
    method: str = "linear"

    def strain(self, alpha_deg: Array, beta_deg: Array) -> Array:
        """E (n, 3) at angles (n,) in degrees; InputError outside the grid, nothing is extrapolated."""
        from scipy.interpolate import RegularGridInterpolator

        interpolate = RegularGridInterpolator((self.alpha_deg, self.beta_deg), self.E, method=self.method)
        try:
            return np.asarray(interpolate(np.column_stack([alpha_deg, beta_deg])))
        except ValueError as error:
            raise InputError(
                f"angles outside the table: alpha {self.alpha_deg[0]} to {self.alpha_deg[-1]}, "
                f"beta {self.beta_deg[0]} to {self.beta_deg[-1]} degrees"
            ) from error

    def rows(self, per_cell: int = 5) -> Rows:
        """The interpolant's strains on a grid `per_cell` times as fine, as if they were rows of a table."""
        from rve import cauchy_line_load, deformation_gradient, second_pk

        fine = [np.interp(np.arange(per_cell * (len(x) - 1) + 1) / per_cell, np.arange(len(x)), x) for x in self._axes]
        alpha, beta = (mesh.ravel() for mesh in np.meshgrid(*fine, indexing="ij"))
        E = self.strain(alpha, beta)
        S = second_pk(deformation_gradient(E), cauchy_line_load(alpha, beta))
        S = S / (S[:, 0] + S[:, 2])[:, None]
        return Rows(S, E, double_dot(S, E), np.ones(len(S), bool), np.arange(len(S)))

    @property
    def _axes(self) -> tuple[Array, Array]:
        return self.alpha_deg, self.beta_deg


def angle_interpolant(table: StrainTable, method: str = "linear") -> AngleInterpolant:
    """The interpolant of a table whose converged rows fill a grid of angles; InputError names a missing grid point."""
    ok = table.converged
    alpha, beta, E = table.alpha_deg[ok], table.beta_deg[ok], table.E[ok]
    a, b = np.unique(alpha), np.unique(beta)
    grid = np.full((len(a), len(b), 3), np.nan)
    grid[np.searchsorted(a, alpha), np.searchsorted(b, beta)] = E
    missing = np.argwhere(np.isnan(grid[:, :, 0]))
    if missing.size:
        i, j = missing[0]
        raise InputError(
            f"interpolation needs a full grid: alpha = {a[i]}, beta = {b[j]} has no converged row "
            f"({len(missing)} grid points are missing)"
        )
    return AngleInterpolant(a, b, grid, method)


def interpolated_law(
    table: StrainTable, method: str = "linear", stiffness: Array | None = None, cell: CellInfo | None = None
) -> PolyhedralLaw:
    """The hull of the interpolated strains as a law."""
    return inner_law(angle_interpolant(table, method).rows(), stiffness, cell)
