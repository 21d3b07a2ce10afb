"""Strain tables by the paper's scheme."""

from __future__ import annotations

import time
from dataclasses import asdict, replace

import numpy as np
from numpy.typing import ArrayLike

from rve.equilibrium.interior_point import DirectOptions, Equilibrium
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell
from rve.paper.dynamics import StewartTrinkleOptions
from rve.paper.stewart_trinkle import solve
from rve.solve import BLOCK, checked_angles, locked_states, reference_sides, table_provenance, table_rows
from rve.table import StrainTable


def solve_table_stewart_trinkle(
    cell: Cell, loads: tuple[ArrayLike, ArrayLike], options: StewartTrinkleOptions | None = None
) -> StrainTable:
    """The strain-load table of a cell under load directions (alpha, beta) in degrees, each (n,), by the paper's scheme
    at its contact stiffness.

    Strains refer to the rigid reference cell and differ from rigid ones in proportion to load over stiffness; minimum
    gaps are negative. `unique` and `states` are those of the direct solver; where `unique` is 0, E is where the motion
    ends. `iterations` are accepted steps. Radius and density come from the cell.
    Raises InputError for angles that are not finite, NotConverged if there is no reference cell.
    """
    options = replace(options or StewartTrinkleOptions(), r1_mm=cell.r1, density=cell.density)
    began = time.perf_counter()
    alpha, beta = checked_angles(*loads)
    sides = reference_sides(cell, DirectOptions())
    states = locked_states(alpha, beta, cell, DirectOptions())
    tensile = states.found.status != "compressive"
    s = np.where(tensile[:, None], states.s, np.array([0.0, 0.0, 1.0]))
    equations = Equations.of(cell.weave, cell.wire)
    parts = [solve(s[i : i + BLOCK], equations, options) for i in range(0, len(s), BLOCK)]
    rest = parts[0].join(parts[1:])
    status = np.where(tensile, rest.status, "compressive")
    found = Equilibrium(rest.pose, rest.lam, rest.contacts, rest.R, rest.steps, status, rest.rejected + 1)
    table = table_rows(alpha, beta, cell, found, states.unique, sides)
    provenance = table_provenance(cell, DirectOptions(), sides, status, time.perf_counter() - began)
    provenance |= {"method": "stewart-trinkle", "options": asdict(options), "simulated_s": float(rest.time.sum())}
    return replace(table, provenance=provenance, states=states)
