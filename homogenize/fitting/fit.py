"""From a table file to a law with its error report: test the rows, build the law, measure it, write it."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from homogenize.fitting.bounds import inner_law, outer_law
from homogenize.fitting.refine import FINEST, NEWS, Parts, refined_half_spaces
from homogenize.fitting.report import ErrorReport, error_report, sampled_cone
from homogenize.fitting.rows import NORMALITY_TOLERANCE, Rows, normality, rows_from_table, rows_to_dict
from homogenize.fitting.stiffness import stiffness_of
from homogenize.io import save_law
from homogenize.laws.net import STATED_STIFFNESS, ring_cell, ring_net
from homogenize.laws.polyhedral import PolyhedralLaw, polyhedral_law
from homogenize.laws.protocol import CellInfo, MembraneLaw
from homogenize.strength import strength_of_table
from rve.common.errors import InputError
from rve.common.rings import STEEL_KG_PER_MM3, check_rings
from rve.common.types import Array

if TYPE_CHECKING:
    from rve import StrainTable

DEFAULT_KIND = "refined"
SLOW_OR_FIXED = ("net", "interpolated", "smooth")
"""Kinds that are not refitted without some of the rows: they do not depend on them, or take ten seconds a time."""


@dataclass(frozen=True)
class FitOptions:
    """`kind` of law; `normality`: what S_i:(E_i - E_j) may fall below zero, the strain error of the table if noisy.

    `resolution`: support differences that are worth a half-space of the refined law. A finer one makes smaller facets,
    so better strains inside them, and pays where the rows are close; the default suits a table of 5 degrees.
    """

    kind: str = DEFAULT_KIND
    normality: float = NORMALITY_TOLERANCE
    resolution: float = NEWS

    def __post_init__(self) -> None:
        if not FINEST <= self.resolution <= 1.0:
            raise InputError(f"resolution = {self.resolution}: must lie between {FINEST:g} and 1, as a strain")
        if self.resolution != NEWS and self.kind != DEFAULT_KIND:
            raise InputError(f"resolution = {self.resolution}: belongs to kind {DEFAULT_KIND!r}, not {self.kind!r}")


@dataclass(frozen=True, eq=False)
class FitResult:
    """The law, what is known of its error, and where it comes from."""

    law: MembraneLaw
    report: ErrorReport
    provenance: dict[str, Any]

    def save(self, path: str | Path) -> None:
        """Writes the law file."""
        save_law(self.law, path, self.provenance)


def fit_table(path: str | Path, options: FitOptions | None = None) -> FitResult:
    """Fits a law to the table file `path`; InputError (or the reader's TableError) says what is wrong with it."""
    from rve import read_table

    path = Path(path)
    table = read_table(path)
    try:
        result = fit(table, options)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    result.provenance["table"] = {"name": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    return result


def fit(table: StrainTable, options: FitOptions | None = None) -> FitResult:
    """Fits a law to a table in memory; InputError if the rows contradict each other or do not bound the strain."""
    options = options or FitOptions()
    rows = rows_from_table(table)
    found = normality(rows, options.normality)
    if not found.holds:
        raise InputError(found.sentence())
    cell = cell_of(table)
    stiffness, origin = stiffness_of(table, STATED_STIFFNESS)
    build = builder(options.kind, cell, stiffness, table, options.resolution)
    law = build(rows)
    strength = strength_of_table(table)
    if isinstance(law, PolyhedralLaw):
        law = replace(law, strength=strength)
    refit = None if options.kind in SLOW_OR_FIXED else build
    provenance = {
        "kind": options.kind,
        "rows": len(rows),
        "stiffness": origin,
        "sampled_loads": sampled_cone(rows).tolist(),
        "table_rows": rows_to_dict(rows),
        "table_provenance": dict(table.provenance),
        "python": platform.python_version(),
        "numpy": np.__version__,
    }
    report = replace(error_report(law, rows, found, refit), kind=options.kind)
    return FitResult(law, report, provenance | {"report": report.to_dict()})


def builder(
    kind: str, cell: CellInfo, stiffness: Array, table: StrainTable | None = None, resolution: float = NEWS
) -> Callable[[Rows], MembraneLaw]:
    """The function that makes a law of this kind from rows; InputError for a kind that does not exist.

    `resolution` belongs to the refined law (`FitOptions`).
    """
    from homogenize.fitting.interpolated import interpolated_law
    from homogenize.fitting.smooth import fit_smooth

    def interpolated(rows: Rows) -> MembraneLaw:
        if table is None:
            raise InputError("the interpolated law needs a table")
        return interpolated_law(table, "linear", stiffness, cell)

    kinds: dict[str, Callable[[Rows], MembraneLaw]] = {
        "refined": lambda rows: polyhedral_law(
            *refined_half_spaces(rows, resolution, Parts.of(resolution)), stiffness, cell
        ),
        "outer": lambda rows: outer_law(rows, stiffness, cell),
        "inner": lambda rows: inner_law(rows, stiffness, cell),
        "smooth": lambda rows: fit_smooth(rows, stiffness, cell),
        "net": lambda rows: ring_net(cell),
        "interpolated": interpolated,
    }
    if kind not in kinds:
        raise InputError(f"kind = {kind}: this version fits {', '.join(sorted(kinds))}")
    return kinds[kind]


def cell_of(table: StrainTable) -> CellInfo:
    """Radii, reference cell and areal mass of a table; InputError names a missing or impossible entry of its sidecar.

    Without an areal mass the cell is that of the 4-in-1 weave with the sidecar's density, or of steel.
    """
    where = "the sidecar file of the table:"
    known = check_rings(table.provenance, where)
    for key in ("r1_mm", "r2_mm", "b_x_mm", "b_y_mm"):
        if key not in known:
            raise InputError(f"{where} {key}: is missing")
    r1, r2, b_x, b_y = (known[key] for key in ("r1_mm", "r2_mm", "b_x_mm", "b_y_mm"))
    cell = ring_cell(r1, r2, b_x, b_y, known.get("density_kg_per_mm3", STEEL_KG_PER_MM3))
    mass = known.get("areal_mass_kg_per_m2", cell.areal_mass_kg_per_m2)
    return replace(cell, areal_mass_kg_per_m2=mass)
