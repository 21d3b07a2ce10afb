"""From load directions to a strain-load table."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rve.common.errors import SENTENCES, InputError, NotConverged
from rve.common.files import TABLE_FORMAT
from rve.common.rings import (
    areal_mass,
)
from rve.common.types import Array
from rve.common.versions import versions
from rve.equilibrium.interior_point import DirectOptions, Equilibrium, solve_equilibrium
from rve.equilibrium.limits import with_limits
from rve.equilibrium.symmetry import solve_equilibrium_symmetric
from rve.equilibrium.system import Equations, mirror_modes
from rve.explain import Work, motion_terms
from rve.geometry.cell import Cell
from rve.geometry.kinematics import cauchy_line_load, green_lagrange, second_pk
from rve.geometry.pairs import pairs_in_reach, unlisted_gap, widened
from rve.geometry.pose import Pose
from rve.geometry.weave import Weave
from rve.paper.motion import locked_by_motion
from rve.paper.stewart_trinkle import StewartTrinkleOptions
from rve.table import StrainTable, joined_tables

# Cases advanced together: enough to hide the overhead of Python, few enough to stay in the cache.
BLOCK = 256


def locked(
    alpha_deg: Array, beta_deg: Array, cell: Cell, options: DirectOptions
) -> tuple[Equilibrium, Array, NDArray[np.bool_]]:
    """Equilibria of the loads (n,) of one block; loads s (n, 3) in weave axes; flags unique (n,).

    Rows with a negative principal load get the status "compressive" and are not solved.
    """
    found, s, unique, _ = locked_with_work(alpha_deg, beta_deg, cell, options)
    return found, s, unique


def locked_with_work(
    alpha_deg: Array, beta_deg: Array, cell: Cell, options: DirectOptions
) -> tuple[Equilibrium, Array, NDArray[np.bool_], Work]:
    """What `locked` returns, and what the solver has met."""
    s = cauchy_line_load(alpha_deg, beta_deg)
    if cell.grain == "x":
        s = s[:, ::-1]
    principal = cauchy_line_load(np.zeros_like(beta_deg), beta_deg)
    tensile = np.asarray(np.all(principal[:, [0, 2]] >= 0.0, axis=1))
    solved = np.where(tensile[:, None], s, np.array([0.0, 0.0, 1.0]))
    is_wide = "unlisted-pairs" in options.force
    found, unique, symmetric = _solved(solved, cell, options, widened(cell.weave) if is_wide else cell.weave)
    gap = np.full(len(s), np.inf) if is_wide else unlisted_gap(found.pose, cell.weave, cell.wire)
    overlap = not is_wide and bool(gap.min() < 0.0)
    if overlap:
        found, unique, symmetric = _solved(solved, cell, options, widened(cell.weave))
    near = pairs_in_reach(found.pose, cell.weave, cell.wire, options.reach)
    listed = found.contacts.gap.shape[1]
    work = Work(len(s), symmetric, listed, int(near.min()), int(near.max()), float(gap.min()), overlap)
    return replace(found, status=np.where(tensile, found.status, "compressive")), s, unique | ~tensile, work


def _solved(s: Array, cell: Cell, options: DirectOptions, weave: Weave) -> tuple[Equilibrium, NDArray[np.bool_], int]:
    """Equilibria, flags `unique`, and how many were solved in symmetric coordinates alone."""
    equations = replace(
        Equations.of(weave, cell.wire),
        far_pairs="far-pairs" in options.force,
        idle_curvature="idle-curvature" in options.force,
    )
    terms = motion_terms(options.force)
    if terms:
        motion = StewartTrinkleOptions(r1_mm=cell.r1, density=cell.density)
        found, symmetric = locked_by_motion(s, equations, options, motion, terms), 0
    elif "asymmetry" in options.force:
        found, symmetric = solve_equilibrium(s, equations, options), 0
    else:
        found, symmetric = solve_equilibrium_symmetric(s, equations, options)
    found, unique = with_limits(s, equations, found, options)
    return found, unique, symmetric


def reference_sides(cell: Cell, options: DirectOptions) -> tuple[float, float]:
    """Sides b_x, b_y in mm of the reference cell: locked under a pull along the grain, symmetric in the grain.

    The symmetry is imposed. From r1/r2 of about 30 on rings may slide over each other instead (docs/theory.md, 3),
    but side by side stays the natural reference: b_x = 2 (r1 + r2). Raises NotConverged.
    """
    modes = mirror_modes(cell.weave) if cell.weave.is_mirrored else None
    along = np.array([[0.0, 0.0, 1.0]])
    found = solve_equilibrium(along, Equations.of(cell.weave, cell.wire, modes), options)
    if unlisted_gap(found.pose, cell.weave, cell.wire)[0] < 0.0:
        found = solve_equilibrium(along, Equations.of(widened(cell.weave), cell.wire, modes), options)
    if found.status[0] != "converged":
        raise NotConverged(f"the reference cell (a pull along the grain): {SENTENCES[str(found.status[0])]}")
    x2, x3 = lattice_mm(found.pose, cell)
    return float(x2[0, 0]), float(x3[0, 1])


def lattice_mm(pose: Pose, cell: Cell) -> tuple[Array, Array]:
    """x2 and x3 in mm, (n, 2) each, for one primitive cell and in the axes of the user."""
    nx, ny = cell.weave.repeat
    a1, a2 = cell.r1 * pose.a1 / nx, cell.r1 * pose.a2 / ny
    return (a2[:, ::-1], a1[:, ::-1]) if cell.grain == "x" else (a1, a2)


def checked_angles(alpha_deg: ArrayLike, beta_deg: ArrayLike) -> tuple[Array, Array]:
    """Angles as two arrays of one length; raises InputError where they are not, or not finite."""
    alpha = np.asarray(alpha_deg, dtype=float).ravel()
    beta = np.asarray(beta_deg, dtype=float).ravel()
    if alpha.shape != beta.shape or not len(alpha):
        raise InputError(f"alpha has {len(alpha)} and beta {len(beta)} values; give as many of both, and at least one")
    if not (np.isfinite(alpha).all() and np.isfinite(beta).all()):
        raise InputError("alpha and beta must be finite numbers of degrees")
    return alpha, beta


def solve_table(
    cell: Cell,
    loads: tuple[ArrayLike, ArrayLike],
    options: DirectOptions | None = None,
    *,
    progress: Callable[[int], None] | None = None,
) -> StrainTable:
    """The strain-load table of a cell under load directions (alpha, beta) in degrees, each (n,), by the direct solver.

    The reference cell is the locked state under a pull along the grain; it is always solved and raises NotConverged if
    it fails. Other rows that fail keep their status and have nan elsewhere. `progress` is called with the number of
    rows done since the last call.

    >>> solve_table(Cell(), ([0.0], [45.0])).x2_mm.round(4)
    array([[13.1163,  0.    ]])
    """
    if not isinstance(cell, Cell) or not isinstance(loads, tuple | list) or len(loads) != 2:
        raise InputError("solve_table takes a Cell and a pair of angles: solve_table(Cell(r1=5, r2=0.5), grid(5.0))")
    options = options or DirectOptions()
    began = time.perf_counter()
    alpha, beta = checked_angles(*loads)
    b_x, b_y = reference_sides(cell, options)
    blocks, works = [], []
    for first in range(0, len(alpha), BLOCK):
        rows = slice(first, first + BLOCK)
        found, s, unique, work = locked_with_work(alpha[rows], beta[rows], cell, options)
        works.append(work)
        blocks.append(table_rows(alpha[rows], beta[rows], cell, found, unique, (b_x, b_y)))
        if progress is not None:
            progress(len(s))
    table = joined_tables(blocks)
    provenance = table_provenance(cell, options, (b_x, b_y), table.status, time.perf_counter() - began)
    return replace(table, provenance=provenance | {"work": reduce(Work.plus, works).to_dict()})


def table_rows(
    alpha: Array, beta: Array, cell: Cell, found: Equilibrium, unique: NDArray[np.bool_], sides: tuple[float, float]
) -> StrainTable:
    """Rows of a table from equilibria, for a reference cell with these sides in mm."""
    x2, x3 = lattice_mm(found.pose, cell)
    F = np.stack([x2 / sides[0], x3 / sides[1]], axis=2)
    E, S = green_lagrange(F), second_pk(F, cauchy_line_load(alpha, beta))
    bad = found.status != "converged"
    for array in (E, S, x2, x3):
        array[bad] = np.nan
    R = np.where(bad, np.nan, found.R)
    gap = np.where(bad, np.nan, found.contacts.min_gap * cell.r1)
    contacts = np.where(bad, 0, ((found.lam > 1e-7) & found.contacts.present).sum(axis=(1, 2)))
    return StrainTable(alpha, beta, E, S, x2, x3, R, gap, contacts, unique, found.status, found.iterations)


def table_provenance(
    cell: Cell, options: DirectOptions, sides: tuple[float, float], status: NDArray[np.str_], wall: float
) -> dict[str, Any]:
    """What a table by the direct solver is made of: mesh, reference sides in mm, options, outcome, wall time in s."""
    statuses, counts = np.unique(status, return_counts=True)
    b_x, b_y = sides
    ring_area = b_x * b_y * cell.weave.repeat[0] * cell.weave.repeat[1] / cell.weave.classes
    return {
        "format": TABLE_FORMAT,
        "format_version": 1,
        "weave": cell.weave.name,
        "grain": cell.grain,
        "r1_mm": cell.r1,
        "r2_mm": cell.r2,
        "b_x_mm": b_x,
        "b_y_mm": b_y,
        "density_kg_per_mm3": cell.density,
        "material": asdict(cell.material),
        "areal_mass_kg_per_m2": areal_mass(cell.r1, cell.r2, ring_area, cell.density),
        "method": "direct",
        "options": asdict(options) | {"force": list(options.force)},
        "rows": {str(k): int(v) for k, v in zip(statuses, counts, strict=True)},
        "caveat": cell.weave.caveat,
        "sentences": {str(k): SENTENCES[str(k)] for k in statuses if k != "converged"},
        "wall_s": round(wall, 3),
        "versions": versions(),
    }
