"""The strength of rings that were asked for their law: at the directions asked, and where the curtain comes nearest to
yield."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from homogenize import LockedRows, Strength, strength_of_table
from macro_fem.demand.directions import rounded
from macro_fem.demand.loop import Demand
from macro_fem.output.strength import critical_load
from rve import Cell, cauchy_of, solve_table, with_rings
from rve.common import tell
from rve.common.tensor import disc, eigenvalues, trace

LOOKS, NEAR = 4, 0.01
"""How often the rings are asked at the load that comes nearest to yield, whose place may move with every answer; not
where a direction is known that is nearer than this in the unit disc."""


def with_strength(found: Demand) -> Demand:
    """`found` with a law that knows the strength of its rings, of their material: exact at the directions that were
    asked, and at that of the largest utilisation of the curtain."""
    rows, cell = found.law.rows, found.rings.cell
    strength = strength_of_rows(rows, cell)
    for _ in range(LOOKS):
        tell(f"asking the rings for their strength, {len(strength.S)} loads known")
        told = _with_strength(found, strength)
        load = critical_load(told.level.solution)
        if load is None:
            break
        x, known = disc(load[None] / trace(load)), disc(rows.S)
        images = known * [1.0, -1.0] if rows.is_mirrored else known
        if np.hypot(*(np.vstack([known, images]) - x).T).min() < NEAR:
            break
        row = found.rings.answer(rounded(x)[0])
        if row is None:
            break
        rows, strength = rows.join([row]), strength.join([strength_of_rows(row, cell)])
    return told


def strength_of_rows(rows: LockedRows, cell: Cell) -> Strength:
    """The strength at the loads of rows, each solved again under the Cauchy load that locks the cell in its strain."""
    s = cauchy_of(rows.S, rows.E)
    low, high = eigenvalues(s)
    alpha = 0.5 * np.degrees(np.arctan2(2.0 * s[:, 1], s[:, 0] - s[:, 2]))
    beta = np.degrees(np.arctan2(np.maximum(low, 0.0), high))
    found = strength_of_table(with_rings(solve_table(cell, (alpha, beta)), cell))
    assert found is not None  # the table has the columns
    return found


def _with_strength(found: Demand, strength: Strength) -> Demand:
    """`found` with this strength in its law and in that of its curtain."""
    solution, inner = found.level.solution, replace(found.law.inner, strength=strength)  # type: ignore[type-var]
    law = replace(found.law, inner=inner, law=inner)
    own = replace(solution.problem.law.own, strength=strength)  # type: ignore[type-var]
    problem = replace(solution.problem, law=replace(solution.problem.law, own=own))
    return replace(found, law=law, level=replace(found.level, solution=replace(solution, problem=problem)))
