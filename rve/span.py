"""How far the strain may move where a load leaves it free.

The admissible strains under such a load are a face of the locking surface. Its extent in one component of E is what the
locked state reaches when a vanishing load along that component is added; it may be a push, as long as rings stop it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from rve.common.types import Array
from rve.equilibrium.interior_point import DirectOptions
from rve.equilibrium.interior_point import solve_equilibrium as solve
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load, green_lagrange
from rve.solve import lattice_mm
from rve.table import StrainTable

_SIDES = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0], [0, 0, 1.0], [0, 0, -1.0]])


def strain_span(table: StrainTable, cell: Cell, options: DirectOptions | None = None, size: float = 2e-3) -> Array:
    """Least and largest E11, E12, E22 of the rows that leave the strain free, (m, 3, 2), m = number of such rows.

    Loads of `size` times the row's load are added one by one in both senses of each component; what is found is wrong
    by about that size. A solve that fails adds nothing: the span is one from inside and holds the row's own E.
    """
    rows = np.flatnonzero(~table.unique & table.converged)
    s = cauchy_line_load(table.alpha_deg[rows], table.beta_deg[rows])
    loads = (s[:, None] + size * _SIDES).reshape(-1, 3)
    if cell.grain == "x":
        loads = loads[:, ::-1]
    quick = replace(options or DirectOptions(), attempts=3)
    found = solve(loads, Equations.of(cell.weave, cell.wire), quick)
    x2, x3 = lattice_mm(found.pose, cell)
    F = np.stack([x2 / table.provenance["b_x_mm"], x3 / table.provenance["b_y_mm"]], axis=2)
    E = np.where((found.status == "converged")[:, None], green_lagrange(F), np.nan).reshape(len(rows), 6, 3)
    E = np.concatenate([E, table.E[rows, None]], axis=1)
    return np.stack([np.nanmin(E, axis=1), np.nanmax(E, axis=1)], axis=2)


def with_span(table: StrainTable, cell: Cell, options: DirectOptions | None = None) -> StrainTable:
    """The table with the spans of its free rows in the provenance, under "free_strains"."""
    rows = np.flatnonzero(~table.unique & table.converged)
    span = strain_span(table, cell, options) if len(rows) else np.zeros((0, 3, 2))
    records: list[dict[str, Any]] = [
        {"alpha_deg": float(table.alpha_deg[row]), "beta_deg": float(table.beta_deg[row])}
        | {name: ends.tolist() for name, ends in zip(("E11", "E12", "E22"), one, strict=True)}
        for row, one in zip(rows, span, strict=True)
    ]
    return replace(table, provenance=table.provenance | {"free_strains": records})
