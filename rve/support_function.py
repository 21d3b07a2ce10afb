"""The support function of the rings: the largest work S:E of a dead second Piola-Kirchhoff line load, with its pose."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rve.common import Array, ByValue, InputError, checked
from rve.common.tensor import double_dot, eigenvalues, trace
from rve.geometry.cell import Cell, weave_axes
from rve.geometry.pose import strain_of
from rve.geometry.weave import Weave
from rve.locking.dead_load import LoadedCell
from rve.locking.global_search import (
    SEARCH,
    BestStates,
    KnownStates,
    sample_states,
    search,
    search_beyond,
    slack_states,
)
from rve.locking.interior_point import DirectOptions, unit_loads
from rve.locking.limits import strain_is_unique
from rve.solve import lattice_mm, mark_unlisted, reference_sides

ROUND_OFF = 1e-6
"""Share of the larger eigenvalue by which the smaller one may be negative: loads are typed with few digits."""


@dataclass(frozen=True, eq=False, repr=False)
class SupportValue(ByValue):
    """Locked states of largest work under n dead loads.

    S (n, 3) as asked for; h (n,) = S:E in the unit of S, nan where no state was found; E (n, 3); x2_mm, x3_mm (n, 2);
    unique (n,): False where the load leaves the strain free, E is then one of many; status (n,); R, min_gap_mm (n,);
    branch (n,): how the state was reached, from the "slack" pose or by a "restart" from a locked state of another load;
    works: per load h of every state that was reached under it, ascending; sides_mm: b_x, b_y of the reference cell;
    states: what `support` can start from next time; weave: that
    of the poses.
    """

    S: Array
    h: Array
    E: Array
    x2_mm: Array
    x3_mm: Array
    unique: NDArray[np.bool_]
    status: NDArray[np.str_]
    R: Array
    min_gap_mm: Array
    branch: NDArray[np.str_]
    works: list[list[float]]
    sides_mm: tuple[float, float]
    states: KnownStates
    weave: Weave

    b_x_mm = property(lambda self: self.sides_mm[0], doc="Side of the reference cell.")
    b_y_mm = property(lambda self: self.sides_mm[1], doc="Side of the reference cell.")

    def __len__(self) -> int:
        return len(self.h)

    def row(self, i: int) -> dict[str, Any]:
        """Load i as plain values with the keys of `python -m rve support`; h and works are in the unit of S."""
        E, x2, x3 = self.E[i].tolist(), self.x2_mm[i].tolist(), self.x3_mm[i].tolist()
        return {
            "h": float(self.h[i]),
            **dict(zip(("E11", "E12", "E22"), E, strict=True)),
            **dict(zip(("x2_x_mm", "x2_y_mm", "x3_x_mm", "x3_y_mm"), x2 + x3, strict=True)),
            "status": str(self.status[i]),
            "unique": int(self.unique[i]),
            "branch": str(self.branch[i]),
            "states": len(self.works[i]),
            "works": self.works[i],
            "R": float(self.R[i]),
            "min_gap_mm": float(self.min_gap_mm[i]),
            "b_x_mm": self.b_x_mm,
            "b_y_mm": self.b_y_mm,
            "cells": list(self.weave.repeat),
            "centres": self.weave.centres,
        }

    def __str__(self) -> str:
        return f"SupportValue: {int((self.status == 'converged').sum())} of {len(self)} loads converged"

    __repr__ = __str__


@checked
def support(
    cell: Cell, S: ArrayLike, options: DirectOptions | None = None, *, known: SupportValue | None = None
) -> SupportValue:
    """h(S) = max S:E over the admissible cells for dead line loads S (3,) or (n, 3), positive semidefinite.

    It is the work of the best locked state that was found, hence at most the maximum; docs/reports/evidence.md says how
    often it was less. Starts are the slack pose, a sample of the cell's locked states (made once and kept), those of
    `known` (an earlier answer for the same cell) and those of the other loads. E refers to the reference cell of
    `options`. InputError for loads that are zero, not finite or have a negative eigenvalue; NotConverged if there is no
    reference cell. Loads that fail keep their status and have nan elsewhere.

    >>> found = support(Cell(5, 0.5), [1.0, 0.0, 0.0])
    >>> round(float(found.h[0]), 4), round(float(found.x2_mm[0, 0]), 3)
    (0.7539, 17.42)
    """
    if not isinstance(cell, Cell):
        raise InputError("support takes a Cell and loads: support(Cell(r1=5, r2=0.5), [S11, S12, S22])")
    options, S = options or DirectOptions(), checked_loads(S)
    mine, sides_mm = (cell.weave.name, cell.cells, cell.centres), reference_sides(cell, options)
    theirs = None if known is None else (known.weave.name, known.weave.repeat, known.weave.centres)
    if known is not None and (theirs != mine or not np.allclose(known.sides_mm, sides_mm, rtol=1e-6)):
        raise InputError("known: is the answer of another weave, other rings or another size; give one for this cell")
    loads = (S / trace(S)[:, None])[:, weave_axes(cell)]
    # Shear to round-off, as of rows of a table, turns thin wire off the path of its symmetric load, and it stalls.
    loads = np.where(np.abs(loads) < SEARCH.gain, 0.0, loads)
    states = None if known is None else known.states
    best, unique, mesh = solve_largest(loads, cell, sides_mm, options, states)
    found = mark_unlisted(best.found, mesh)
    good, reached = found.status == "converged", best.states
    E = strain_of(found.pose, best.mesh.sides)[:, weave_axes(cell)]
    E, x2, x3 = (np.where(good[:, None], values, np.nan) for values in (E, *lattice_mm(found.pose, mesh)))
    R, gap = (np.where(good, values, np.nan) for values in (found.R, cell.r1 * found.contacts.min_gap))
    works = [[float(size) * work for work in each] for size, each in zip(trace(S), best.works, strict=True)]
    reached = reached if states is None else states.join([reached])
    told = (unique, found.status, R, gap, best.branch, works, sides_mm, reached, mesh.weave)
    return SupportValue(S, double_dot(S, E), E, x2, x3, *told)


def checked_loads(S: ArrayLike) -> Array:
    """Dead loads (n, 3); InputError where one is no positive semidefinite tensor other than zero."""
    try:
        S = np.atleast_2d(np.asarray(S, dtype=float))
    except (TypeError, ValueError) as error:
        raise InputError("S must be numbers S11, S12, S22, or rows of them") from error
    if S.ndim != 2 or S.shape[1] != 3 or not len(S):
        raise InputError(f"S has the shape {S.shape}; give numbers S11, S12, S22, or rows of them")
    if not np.isfinite(S).all():
        raise InputError("S holds a number that is not finite; give S11, S12, S22, or rows of them")
    low, high = eigenvalues(S)
    for i in np.flatnonzero(~((high > 0.0) & (low >= -ROUND_OFF * np.maximum(high, 0.0))))[:1]:
        raise InputError(
            f"S = {', '.join(f'{x:g}' for x in S[i])}: has the eigenvalue {low[i]:.3g}, and a mesh of rings carries no "
            "compression: slack folds make S:E as large as one likes; give a load that is tensile and not zero"
        )
    return S


def solve_largest(
    loads: Array, cell: Cell, sides_mm: tuple[float, float], options: DirectOptions, known: KnownStates | None
) -> tuple[BestStates, NDArray[np.bool_], Cell]:
    """Best states of the loads (n, 3), flags `unique` (n,), and the cell of their poses."""
    mesh, stages = replace(cell, cells=(1, 1), centres="plane"), cell.stages
    loaded = LoadedCell.of(mesh, sides_mm, options)
    best = slack_states(loads, loaded)
    if options.branches != "first":
        best = search(best, sample_states(mesh, sides_mm, options), None if stages else known)
    for mesh in stages:
        loaded = LoadedCell.of(mesh, sides_mm, options)
        best = search_beyond(best, known if mesh is stages[-1] else None, loaded)
    return best, strain_is_unique(loaded.dead, best.found, unit_loads(loads)), mesh
