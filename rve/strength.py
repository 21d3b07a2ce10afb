"""Stiffness and strength columns of a table, from the rings' own wire."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
from numpy.typing import NDArray

from rve.common.types import Array
from rve.equilibrium.interior_point import DirectOptions, Equilibrium
from rve.equilibrium.ring_states import ring_states
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell
from rve.geometry.pairs import widened
from rve.solve import locked, reference_sides
from rve.table import StrainTable


def with_rings(table: StrainTable, cell: Cell) -> StrainTable:
    """The table with compliance and strength of its rings, welded rings of the cell's material.

    compliance: dE/dS in mm/N for a line load of 1 N/mm, to first order: the bend of the locking surface and what the
    rings give; at s N/mm the bend is to be divided by s. nan where the strain is not unique. strength: see
    `StrainTable`. Rows that have not converged have nan in both. Docs: theory.md, 7.

    >>> from rve.solve import solve_table
    >>> found = with_rings(solve_table(Cell(), ([0.0], [90.0])), Cell())
    >>> found.strength.round(1)  # yield stress in N/mm2 per N/mm of line load along the grain
    array([[123.2,  59.4]])
    """
    found, s, unique = locked(table.alpha_deg, table.beta_deg, cell, DirectOptions())
    status = np.where(table.converged, found.status, "stalled")
    return with_ring_columns(table, cell, replace(found, status=status), s, unique)


def with_ring_columns(
    table: StrainTable, cell: Cell, found: Equilibrium, s: Array, unique: NDArray[np.bool_]
) -> StrainTable:
    """As `with_rings`, from the locked states behind the rows of the table: equilibria, loads s (n, 3), `unique`."""
    b_x, b_y = reference_sides(cell, DirectOptions())
    sides = (b_y, b_x) if cell.grain == "x" else (b_x, b_y)
    nx, ny = cell.weave.repeat
    reference = (sides[0] * nx / cell.r1, sides[1] * ny / cell.r1)
    material = cell.material
    weave = cell.weave if len(cell.weave.pairs) == found.lam.shape[1] else widened(cell.weave)
    states = ring_states(Equations.of(weave, cell.wire), found, s, reference, material.poisson)
    D = states.locking + states.elastic / (material.young_N_per_mm2 * cell.r1)
    D[~unique] = np.nan
    if cell.grain == "x":
        D = D[:, ::-1, ::-1]
    asked = np.stack([states.first_yield, states.collapse], axis=1) / cell.r1
    strength = asked / (table.S[:, 0] + table.S[:, 2])[:, None]
    provenance = table.provenance | {"compliance": "rings", "joint": "welded", "material": asdict(material)}
    return replace(table, compliance=D, strength=strength, provenance=provenance)
