"""Strain tables by the paper's scheme, and locking compliances as extra columns of any table."""

from __future__ import annotations

import time
from dataclasses import asdict, replace

import numpy as np
from numpy.typing import ArrayLike

from rve.common.errors import InputError
from rve.equilibrium.compliance import soften
from rve.equilibrium.interior_point import DirectOptions, Equilibrium
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell
from rve.paper.checkpoints import SweepOptions, sweep
from rve.paper.stewart_trinkle import StewartTrinkleOptions
from rve.solve import checked_angles, locked, reference_sides, table_provenance, table_rows
from rve.strength import with_rings
from rve.table import StrainTable


def solve_table_stewart_trinkle(
    cell: Cell,
    loads: tuple[ArrayLike, ArrayLike],
    options: StewartTrinkleOptions | None = None,
    how: SweepOptions | None = None,
) -> StrainTable:
    """The strain-load table of a cell under load directions (alpha, beta) in degrees, each (n,), by the paper's scheme
    at its contact stiffness.

    Strains refer to the rigid reference cell and differ from rigid ones in proportion to load over stiffness; minimum
    gaps are negative. Where `unique` is 0 (which the direct solver tells) E is where the motion ends. `iterations` are
    accepted steps. Radius and density come from the cell. `how` says where checkpoints go and how many workers there
    are. Raises InputError for senseless angles or options, NotConverged if there is no reference cell.
    """
    how = how or SweepOptions()
    options = replace(options or StewartTrinkleOptions(), r1_mm=cell.r1, density=cell.density)
    try:
        options.validate()
    except ValueError as error:
        raise InputError(str(error)) from error
    began = time.perf_counter()
    alpha, beta = checked_angles(*loads)
    sides = reference_sides(cell, DirectOptions())
    direct, s, unique = locked(alpha, beta, cell, DirectOptions())
    tensile = direct.status != "compressive"
    rest = sweep(np.where(tensile[:, None], s, np.array([0.0, 0.0, 1.0])), cell.weave, cell.wire, options, how)
    status = np.where(tensile, rest.status, "compressive")
    found = Equilibrium(rest.pose, rest.lam, rest.contacts, rest.R, rest.steps, status, rest.rejected + 1)
    table = table_rows(alpha, beta, cell, found, unique, sides)
    provenance = table_provenance(cell, DirectOptions(), sides, status, time.perf_counter() - began)
    provenance |= {"method": "stewart-trinkle", "options": asdict(options), "simulated_s": float(rest.time.sum())}
    return replace(table, provenance=provenance)


def with_compliance(
    table: StrainTable, stiffness_N_per_mm: float | None = None, cell: Cell | None = None
) -> StrainTable:
    """The table with its compliance, dE/dS in mm/N for a line load of 1 N/mm: that of its rings (`with_rings`), or of
    rigid rings with contacts of this stiffness.

    A line load of s N/mm at stiffness k has the compliance of stiffness k/s, over s. Rows that have not converged or
    whose strain is not unique have nan. Raises InputError for a stiffness that is not positive.
    """
    if stiffness_N_per_mm is None:
        return with_rings(table, cell or Cell())
    if not (np.isfinite(stiffness_N_per_mm) and stiffness_N_per_mm > 0.0):
        raise InputError(f"stiffness = {stiffness_N_per_mm}: must be a positive number of N/mm")
    cell = cell or Cell()
    b_x, b_y = reference_sides(cell, DirectOptions())
    found, s, unique = locked(table.alpha_deg, table.beta_deg, cell, DirectOptions())
    status = np.where(unique & table.converged, found.status, "stalled")
    sides = (b_y, b_x) if cell.grain == "x" else (b_x, b_y)
    nx, ny = cell.weave.repeat
    reference = (sides[0] * nx / cell.r1, sides[1] * ny / cell.r1)
    equations = Equations.of(cell.weave, cell.wire)
    # One contact per primitive cell: forces in s_hat r1 and penetrations in r1 leave only the ratio k / s_hat.
    D = soften(replace(found, status=status), s, equations, stiffness_N_per_mm, reference).compliance
    if cell.grain == "x":
        D = D[:, ::-1, ::-1]
    springs = {"compliance": "contact springs", "compliance_stiffness_N_per_mm": stiffness_N_per_mm}
    provenance = table.provenance | springs
    return replace(table, compliance=D, provenance=provenance)
