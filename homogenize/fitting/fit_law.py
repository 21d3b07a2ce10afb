"""The fit: from a table to a law with its error report. Test the rows, build the law, measure it, write it.

Rings that give make the locked strain depend on the size of the load, E = dh/dS + A S. The compliance D = dE/dS of a
row holds both: the bend of the locking surface, none along S because h is homogeneous of degree one, and A. So S:D S =
S:A S, and one positive definite A with the symmetry of the weave is fitted to these. The strength of the law keeps S:D
S of every direction (`homogenize.laws.strength`), of which `homogenize.laws.giving` makes the law of elastic curtains.
"""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from homogenize.directions import each_once, hull_of
from homogenize.fitting.bounds import inner_law, outer_law
from homogenize.fitting.refine import RESOLUTION, Resolution, refined_half_spaces
from homogenize.fitting.report import error_report
from homogenize.fitting.row_tests import NORMALITY_TOLERANCE, mended, normality, rows_from_table, without
from homogenize.laws.giving import constant_compliance, work_along
from homogenize.laws.net import STATED_STIFFNESS, ring_net
from homogenize.laws.polyhedral import PolyhedralLaw, giving_law, polyhedral_law
from homogenize.laws.protocol import MembraneLaw
from homogenize.laws.report import ErrorReport
from homogenize.laws.rows import LockedRows
from homogenize.laws.stored import Law
from homogenize.laws.strength import strength_of_table
from rve import Cell, StrainTable, reference_cell
from rve.common import Array, InputError, Typed, checked, checksum, types_of
from rve.common.cell_fields import ArealMass
from rve.common.optional import DataFrame
from rve.common.tensor import disc, trace
from rve.geometry import CellInfo, read_cell_info

STATED_LOAD = 1.0
"""Size S11 + S22 in N/mm of the line load at which the compliance of elastic curtains is compared with the rows'."""


@dataclass(frozen=True)
class FitOptions(Typed):
    """`kind` of law; `normality`: tolerated violation of S_i:(E_i - E_j) >= 0, the strain error of the table if noisy.

    `resolution`: support differences that are worth a half-space of the refined law. A finer one makes smaller facets,
    so better strains inside them, and pays where the rows are close; the default suits a table of 5 degrees.
    `contradictions`: of rows that contradict each other, "list" refuses them with their distances, "drop" leaves out
    the fewest that it can, "mend" takes the nearest strains that do not. What else is known of a mesh of which only
    loads and strains are: `cell`, its rings, whose reference cell its strains refer to, `areal_mass` in kg/m2, and
    `mirrored`, whether it is its own mirror image, so that every row stands for two. InputError for values out of
    range.
    """

    kind: Literal["inner", "net", "outer", "refined"] = "refined"
    normality: Annotated[float, Meta(ge=0.0, le=1.0)] = NORMALITY_TOLERANCE
    resolution: Resolution = RESOLUTION
    contradictions: Literal["list", "drop", "mend"] = "list"
    cell: Cell | None = None
    areal_mass: ArealMass | None = None
    mirrored: bool = True

    def check(self) -> None:
        if self.resolution != RESOLUTION and self.kind != "refined":
            self.refuse(f"resolution = {self.resolution}: belongs to kind 'refined', not {self.kind!r}")


@dataclass(frozen=True, eq=False, repr=False)
class FitResult:
    """The law and what is known of its error, which the law carries into its file."""

    law: Law
    report: ErrorReport

    @checked
    def save(self, path: str | Path) -> None:
        self.law.save(path)

    def __str__(self) -> str:
        return self.report.text()

    __repr__ = __str__


@checked
def fit_table(path: str | Path, options: FitOptions | None = None) -> FitResult:
    """Fits a law to the table file `path`; InputError (or the reader's TableError) says what is wrong with it."""
    from rve import read_table

    path = Path(path)
    table = read_table(path)
    try:
        result = fit(table, options)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    source = {"name": path.name, "sha256": checksum(path)}
    return replace(result, law=replace(result.law, provenance=result.law.provenance | {"table": source}))


@checked
def fit_rows(E: Array, S: Array, options: FitOptions | None = None) -> FitResult:
    """Fits a law to strains E (n, 3) and second Piola-Kirchhoff line loads S (n, 3) of any unit, a row each, see `fit`.

    >>> S = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]])
    >>> fit_rows(0.02 * S, S, FitOptions("outer")).law.support(S[2:3]).round(9)
    array([0.04])
    """
    return fit(StrainTable.from_rows(E, S), options)


@checked
def fit(table: StrainTable | DataFrame, options: FitOptions | None = None) -> FitResult:
    """Fits a law to a table in memory, or to a data frame with its columns; InputError if the rows contradict each
    other or do not bound the strain.

    The stiffness is that of the table's compliance if it has one, else 1000 N/mm.
    """
    options = options or FitOptions()
    table = with_known(table if isinstance(table, StrainTable) else StrainTable.from_pandas(table), options)
    rows = rows_from_table(table)
    found = normality(rows, options.normality)
    if not found.holds and options.contradictions == "list":
        solved = table.origin.options
        first = "rows of --branches first need not be of largest work, solve the table with --branches largest; "
        raise InputError(first * (solved is not None and solved.branches == "first") + found.sentence())
    if not found.holds:
        rows = without(rows, found) if options.contradictions == "drop" else mended(rows)
        found = normality(rows, options.normality)
    cell = cell_of(table)
    hull_of(rows.S, rows.is_mirrored)  # InputError for loads on one line
    if options.kind == "net" and (cell is None or not rows.is_mirrored):
        raise InputError("kind 'net': is the law of 4-in-1 rings that are known, on two families of straight chains")
    stiffness, origin = stiffness_of(table)
    build: Callable[[LockedRows], Law] = {
        "refined": lambda some: polyhedral_law(*refined_half_spaces(some, options.resolution), stiffness, cell),
        "outer": lambda some: outer_law(some, stiffness, cell),
        "inner": lambda some: inner_law(some, stiffness, cell),
        "net": lambda _: ring_net(cell),  # type: ignore[arg-type]
    }[options.kind]
    mass = table.origin.areal_mass_kg_per_m2
    law = replace(build(rows), strength=strength_of_table(table), rows=rows, areal_mass_kg_per_m2=mass)
    provenance = {
        "kind": options.kind,
        "rows": len(rows),
        "stiffness": origin,
        "stiffness_by_direction": stiffness_by_direction(law),
        "table_provenance": table.origin.to_dict(),
        "python": platform.python_version(),
        "numpy": np.__version__,
    }
    report = replace(error_report(law, rows, found, None if options.kind == "net" else build), kind=options.kind)
    return FitResult(replace(law, provenance=provenance, report=report), report)


def stiffness_of(table: StrainTable) -> tuple[Array | None, str]:
    """Stiffness (3, 3) in tensor components, N/mm, by the table's compliance, None without; and its origin in words.

    InputError if the table has a compliance but no row with a finite positive S:D S.
    """
    if table.compliance is None:
        return None, f"stated: {STATED_STIFFNESS:g} N/mm for every strain, not from the table"
    work = work_along(table.S, table.compliance)
    known = np.flatnonzero(table.converged & table.unique & np.isfinite(work) & (work > 0.0))
    if not len(known):
        raise InputError("no row of the table has a compliance with S:D S > 0")
    known = known[each_once(disc(table.S[known] / trace(table.S[known])[:, None]), table.is_mirrored)]
    A = constant_compliance(table.S[known], work[known], table.is_mirrored)
    share = work_along(table.S[known], A) / work[known]
    told = f"S:D S of the rows times {share.min():.3g} to {share.max():.3g}"
    return np.asarray(np.linalg.inv(A)), f"the rows' compliance along their own load, {told}"


def stiffness_by_direction(law: MembraneLaw) -> str | None:
    """How well elastic curtains of a law meet S:D S of its rows, in words; None if it knows none."""
    giving = giving_law(law) if isinstance(law, PolyhedralLaw) else None
    if giving is None or giving.strength is None:
        return None
    known = giving.strength.stretched
    share = giving.compliance_along(known.S, STATED_LOAD) / known.compliance
    return f"elastic curtains: S:D S of the rows times {share.min():.3g} to {share.max():.3g} at {STATED_LOAD:g} N/mm"


@checked
def cell_of(table: StrainTable) -> CellInfo | None:
    """The rings of a table and their reference cell, None without; InputError names what its sidecar leaves out."""
    if table.cell is None and types_of(CellInfo).keys() & table.origin.notes.keys():
        return read_cell_info(table.origin.notes, "the sidecar file of the table:")
    return table.cell


def with_known(table: StrainTable, options: FitOptions) -> StrainTable:
    """The table with what the options tell of its mesh; InputError for rings of a table that tells others."""
    cell, mass, is_mirrored = table.cell, options.areal_mass, options.mirrored and table.origin.is_mirrored
    if options.cell is not None:
        told = reference_cell(options.cell)
        if cell is not None:
            cell.check_same(told, "cell", "the table")
        cell = told
    if cell is not None and mass is not None:
        cell = replace(cell, areal_mass_kg_per_m2=mass)
    mass = table.origin.areal_mass_kg_per_m2 if mass is None else mass
    return replace(table, origin=replace(table.origin, cell=cell, areal_mass_kg_per_m2=mass, is_mirrored=is_mirrored))
