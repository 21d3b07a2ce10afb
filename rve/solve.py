"""From load directions to a strain-load table."""

import time
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rve.common import SENTENCES, Array, InputError, JsonObject, NotConverged, checked, part_of, versions
from rve.common.tensor import double_dot, trace
from rve.directions import grid
from rve.geometry.cell import Cell, CellInfo, weave_axes
from rve.geometry.contacts import unlisted_gap
from rve.geometry.kinematics import cauchy_line_load, green_lagrange, second_pk
from rve.geometry.pose import Pose, mirror_modes
from rve.locking.dead_load import DeadLoad, LoadedCell, solve_dead, solve_stable
from rve.locking.global_search import in_cell, sample_states
from rve.locking.interior_point import DirectOptions, Equilibrium, LockedStates, solve_equilibrium
from rve.locking.limits import with_limits
from rve.locking.relaxation import MIXTURE, RowStates, largest_rows
from rve.locking.strings import string_states
from rve.locking.system import Equations
from rve.table import Origin, RowQuality, StrainTable

BLOCK = 512
"""Cases advanced together: enough to hide the overhead of Python, few enough to stay in the cache."""


def locked_block(alpha_deg: Array, beta_deg: Array, cell: Cell, options: DirectOptions) -> LockedStates:
    """Locked states of one block of loads (n,). Rows with a negative principal load get the status "compressive" and
    are not solved."""
    s = cauchy_line_load(alpha_deg, beta_deg)[:, weave_axes(cell)]
    principal = cauchy_line_load(np.zeros_like(beta_deg), beta_deg)
    tensile = np.asarray(np.all(principal[:, [0, 2]] >= 0.0, axis=1))
    solved = np.where(tensile[:, None], s, np.array([0.0, 0.0, 1.0]))
    equations = Equations.of(cell.weave, cell.wire)
    found, unique = with_limits(solved, equations, solve_stable(solved, equations, options), options)
    found = mark_unlisted(found, cell)
    found = replace(found, status=np.where(tensile, found.status, "compressive").astype("<U16"))
    return LockedStates(found, s, unique | ~tensile, cell)


def mark_unlisted(found: Equilibrium, cell: Cell) -> Equilibrium:
    """The equilibria, with the status "unlisted" where rings overlap that the weave does not list as a pair."""
    overlaps = unlisted_gap(found.pose, cell.weave, cell.wire) < 0.0
    return replace(found, status=np.where(overlaps, "unlisted", found.status).astype("<U16"))


def locked_states(alpha_deg: Array, beta_deg: Array, cell: Cell, options: DirectOptions) -> LockedStates:
    """Locked states of any number of loads (n,), block by block."""
    blocks, begun = [], time.monotonic()
    for first in range(0, len(alpha_deg), BLOCK):
        rows = slice(first, first + BLOCK)
        with part_of(f"{first} of {len(alpha_deg)} loads solved", *((first, len(alpha_deg), begun) if first else ())):
            blocks.append(locked_block(alpha_deg[rows], beta_deg[rows], cell, options))
    return blocks[0].join(blocks[1:])


@lru_cache(maxsize=64)
def reference_sides(cell: Cell, options: DirectOptions) -> tuple[float, float]:
    """Sides b_x, b_y in mm of the reference cell: locked under a pull along the grain. Raises NotConverged.

    options.reference = "side-by-side" imposes the symmetry of the grain: b_x = 2 (r1 + r2) at every r1/r2. "locked"
    takes the longest state, in which rings slide over each other from r1/r2 of about 20 on (docs/theory.md, 3).
    """
    x2, x3 = lattice_mm(reference_pose(cell, options), cell)
    return float(x2[0, 0]), float(x3[0, 1])


def reference_cell(cell: Cell, options: DirectOptions | None = None) -> CellInfo:
    """The rings of a cell with the reference cell that strains refer to, see `reference_sides`. Raises NotConverged."""
    options = options or DirectOptions()
    return CellInfo.of(cell, reference_sides(cell, options), options.reference)


def reference_pose(cell: Cell, options: DirectOptions) -> Pose:
    """The pose (n = 1) of the reference cell, see `reference_sides`. Raises NotConverged."""
    modes = mirror_modes(cell.weave) if cell.weave.is_mirrored else None
    along = np.array([[0.0, 0.0, 1.0]])
    equations = Equations.of(cell.weave, cell.wire, modes)
    # Rings joined along x and y one by one leave b_x free: it is that of the least pull across.
    found = mark_unlisted(with_limits(along, equations, solve_equilibrium(along, equations, options), options)[0], cell)
    if options.reference == "locked" and found.status[0] == "converged":
        # The work of this load is that of its length along the grain, whatever the sides.
        longest = Equations.of(cell.weave, cell.wire, load=DeadLoad((1.0, 1.0)))
        found = mark_unlisted(solve_dead(along, longest, options), cell)
    if found.status[0] != "converged":
        raise NotConverged(f"the reference cell (a pull along the grain): {SENTENCES[str(found.status[0])]}")
    return found.pose


def lattice_mm(pose: Pose, cell: Cell) -> tuple[Array, Array]:
    """x2 and x3 in mm, (n, 2) each, for one primitive cell and in the axes of the user."""
    nx, ny = cell.weave.repeat
    a1, a2 = cell.r1 * pose.a1 / nx, cell.r1 * pose.a2 / ny
    return (a2[:, ::-1], a1[:, ::-1]) if cell.grain == "x" else (a1, a2)


def checked_angles(alpha_deg: ArrayLike, beta_deg: ArrayLike) -> tuple[Array, Array]:
    """Angles as two arrays of one length; raises InputError where they are not, or not finite."""
    try:
        alpha, beta = (np.asarray(angles, dtype=float).ravel() for angles in (alpha_deg, beta_deg))
    except (TypeError, ValueError) as error:
        raise InputError("alpha and beta must be numbers, or lists of them, in degrees") from error
    if alpha.shape != beta.shape or not len(alpha):
        raise InputError(f"alpha has {len(alpha)} and beta {len(beta)} values; give as many of both, and at least one")
    if not (np.isfinite(alpha).all() and np.isfinite(beta).all()):
        raise InputError("alpha and beta must be finite numbers of degrees")
    return alpha, beta


@checked
def solve_table(
    cell: Cell, loads: tuple[ArrayLike, ArrayLike] | None = None, options: DirectOptions | None = None
) -> StrainTable:
    """The strain-load table of a cell under load directions (alpha, beta) in degrees, each (n,), by the direct solver.

    Without loads they are the grid of 5 degrees. The reference cell is the locked state under a pull along the grain;
    it is always solved and raises NotConverged if it fails. Where several locked states coexist, a row holds that of
    largest work (options.branches). Other rows that fail keep their status and have nan elsewhere. The table's `states`
    are the locked states.

    >>> print(solve_table(Cell(), ([0.0], [45.0])).x2_mm[0, 0].round(4))
    13.1163
    """
    options = options or DirectOptions()
    began = time.perf_counter()
    alpha, beta = checked_angles(*(grid(5.0, cell.weave) if loads is None else loads))
    info = reference_cell(cell, options)
    states = locked_states(alpha, beta, cell, options)
    record: JsonObject = {}
    if options.branches == "largest":
        table, record["branches"] = largest_table(alpha, beta, states, options, info.sides_mm)
    elif cell.is_larger:
        raise InputError("--branches first follows the slack pose, which is the same in every cell: leave out --cells")
    else:
        table = table_rows(alpha, beta, states, info.sides_mm)
    notes = table_notes(cell, table.status, time.perf_counter() - began)
    return replace(table, origin=Origin(info, options, notes=notes | record))


def largest_table(
    alpha: Array, beta: Array, states: LockedStates, options: DirectOptions, sides_mm: tuple[float, float]
) -> tuple[StrainTable, JsonObject]:
    """The table of these locked states with every row replaced under whose S another known state does more work; and
    which states coexist, for the sidecar.
    """
    began, cell = time.perf_counter(), states.cell
    mesh, sample = LoadedCell.of(cell, sides_mm, options), sample_states(cell, sides_mm, options)
    first = RowStates.of(mesh, states.found, states.s, "slack", states.unique)
    rows, left, beside = largest_rows(first, states.s, mesh, sample)
    primitive, record = rows.E, {}
    for larger in cell.stages:
        mesh = LoadedCell.of(larger, sides_mm, options)
        rows = replace(rows, found=in_cell(rows.found, rows.s, mesh.cauchy))
        rows, left, more = largest_rows(rows, states.s, mesh, sample)
        beside |= more
        record = {"rows_beyond_the_primitive_cell": int((np.abs(rows.E - primitive).max(axis=1) > MIXTURE.moved).sum())}
    status = np.where(left, "below", rows.found.status).astype("<U16")
    found = mark_unlisted(replace(rows.found, status=status), mesh.cell)
    known = tuple((np.full(len(each[0]), i), *each) for i, each in beside.items() if rows.branch[i] == "coexisting")
    states = LockedStates(found, rows.s, rows.unique, mesh.cell, known)
    table = replace(table_rows(alpha, beta, states, sides_mm), branch=rows.branch)
    return table, branch_record(table, first, rows, time.perf_counter() - began) | record


def branch_record(table: StrainTable, first: RowStates, rows: RowStates, wall: float) -> JsonObject:
    """Which rows have several states, and what work each does under S, at unit trace of S."""
    branch, several = np.where(table.status == "below", "below", rows.branch), []
    for i in np.flatnonzero(branch != "slack").tolist():
        row = {"row": i, "alpha_deg": float(table.alpha_deg[i]), "beta_deg": float(table.beta_deg[i])}
        slack, best = (float(double_dot(rows.S[i], of.E[i])) for of in (first, rows))
        several.append(row | {"branch": str(branch[i]), "work_from_slack": slack, "work": best})
    how = "restarts from the states of loads all over, of other rows, and their mirror images"
    return {"maximum_by": how, "several_states": several, "wall_s": round(wall, 3)}


def table_rows(alpha: Array, beta: Array, states: LockedStates, sides: tuple[float, float]) -> StrainTable:
    """The table of locked states, for a reference cell with these sides in mm."""
    found, cell = states.found, states.cell
    x2, x3 = lattice_mm(found.pose, cell)
    F = np.stack([x2 / sides[0], x3 / sides[1]], axis=2)
    E, S = green_lagrange(F), second_pk(F, states.s[:, weave_axes(cell)])
    bad = found.status != "converged"
    E, S, x2, x3 = (np.where(bad[:, None], np.nan, array) for array in (E, S, x2, x3))
    R = np.where(bad, np.nan, found.R)
    gap = np.where(bad, np.nan, found.contacts.min_gap * cell.r1)
    contacts = np.where(bad, 0, ((found.lam > 1e-7) & found.contacts.present).sum(axis=(1, 2)))
    quality = RowQuality(R, gap, contacts, found.iterations)
    return StrainTable(alpha, beta, E, S, x2, x3, states.unique, found.status, quality, states=states)


def with_strings(table: StrainTable, cell: Cell) -> StrainTable:
    """The table with the work of rings drawn to strings under the load of each row that has converged."""
    assert table.cell is not None
    h, good = np.full(len(table), np.nan), table.converged
    if good.any():
        S = table.S[good] / trace(table.S[good])[:, None]
        with part_of(f"strings of {good.sum()} loads"):
            h[good] = string_states(cell, S, table.cell.sides_mm).h
    return replace(table, h_strings=h)


def table_notes(cell: Cell, status: NDArray[np.str_], wall: float) -> JsonObject:
    """How a table by the direct solver came about, beside its cell and options: outcome, versions, wall time in s."""
    statuses, counts = np.unique(status, return_counts=True)
    return {
        "cells": list(cell.cells),
        "centres": cell.centres,
        "method": "direct",
        "rows": {str(k): int(v) for k, v in zip(statuses, counts, strict=True)},
        "bound_note": cell.bound_note,
        "sentences": {str(k): SENTENCES[str(k)] for k in statuses if k != "converged"},
        "wall_s": round(wall, 3),
        "versions": versions(),
    }
