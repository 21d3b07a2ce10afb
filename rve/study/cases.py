"""The load cases of the study, solved by the paper's scheme and by the direct solver."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rve.common.errors import InputError
from rve.common.types import Array
from rve.equilibrium.system import Equations
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load
from rve.geometry.pose import Pose, strain_of
from rve.paper import stewart_trinkle as st
from rve.paper.dynamics import StewartTrinkleOptions
from rve.paper.stewart_trinkle import History, Settled
from rve.solve import solve_table
from rve.table import StrainTable


@dataclass(frozen=True)
class Study:
    """Load cases solved by both methods.

    alpha_deg, beta_deg, s: the cases; rest: the paper's scheme, with history; E (n, 3): its strains; table: the direct
    solver's rows; wall_s: seconds of the scheme and of the direct solver.
    """

    alpha_deg: Array
    beta_deg: Array
    s: Array
    cell: Cell
    options: StewartTrinkleOptions
    rest: Settled
    E: Array
    table: StrainTable
    wall_s: tuple[float, float]

    @property
    def history(self) -> History:
        """Accepted steps of all cases."""
        if self.rest.history is None:
            raise ValueError("this study was solved without a history")
        return self.rest.history

    def case(self, alpha_deg: float, beta_deg: float) -> int | None:
        """Row of a load direction, None where the study has none."""
        rows = np.flatnonzero((self.alpha_deg == alpha_deg) & (self.beta_deg == beta_deg))
        return int(rows[0]) if len(rows) else None


def solve_study(
    alpha_deg: ArrayLike, beta_deg: ArrayLike, cell: Cell | None = None, options: StewartTrinkleOptions | None = None
) -> Study:
    """Solve the cases by the paper's scheme, with history, and by the direct solver.

    Strains of both refer to the rigid reference cell. The interlacing direction must be y, as in the paper; raises
    InputError otherwise.
    """
    cell = cell or Cell()
    if cell.grain != "y":
        raise InputError(f"grain = {cell.grain!r}: the study follows the paper, where it is y")
    options = options or StewartTrinkleOptions(r1_mm=cell.r1, density=cell.density)
    alpha, beta = np.asarray(alpha_deg, dtype=float), np.asarray(beta_deg, dtype=float)
    s = cauchy_line_load(alpha, beta)
    began = time.perf_counter()
    table = solve_table(cell, (alpha, beta))
    between = time.perf_counter()
    rest = st.solve(s, Equations.of(cell.weave, cell.wire), options, history=True)
    ended = time.perf_counter()
    sides = table.provenance["b_x_mm"] / cell.r1, table.provenance["b_y_mm"] / cell.r1
    E = strain_of(rest.pose, sides)
    return Study(alpha, beta, s, cell, options, rest, E, table, (ended - between, between - began))


def side_contact_times(study: Study, case: int) -> tuple[float, float]:
    """Times in s from which, for good, one and all of the final contacts between rings that do not interlink press.

    nan where the locked state has no such contact.
    """
    rows = study.history.case == case
    side, times = study.history.side[rows], study.history.time[rows]
    if not side[-1]:
        return float("nan"), float("nan")

    def since(pressed: NDArray[np.bool_]) -> float:
        before = np.flatnonzero(~pressed)
        return float(times[before[-1] + 1 if len(before) else 0])

    return since(side > 0), since(side == side[-1])


def history_strain(study: Study, rows: NDArray[np.intp]) -> Array:
    """Strains (m, 3) of rows of the history."""
    b_x, b_y = (study.table.provenance[name] / study.cell.r1 for name in ("b_x_mm", "b_y_mm"))
    none = np.zeros((len(rows), 0, 2))
    return strain_of(Pose(study.history.lattice[rows], none, none), (b_x, b_y))
