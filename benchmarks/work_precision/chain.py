"""The whole chain: the error of the curtain's mean height, split into contact tolerance, table, law and mesh.

Each ladder varies one part and leaves the others at the base. Its error is the difference from the finest setting, for
meshes from the extrapolated mesh. Then the settings of `examples/curtain.py --accuracy` run from rings to curtain, and
their errors are compared with the accuracy they state.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise

import numpy as np

from benchmarks.frame import Diagram, Section, Table, curves, table
from benchmarks.measure import Row, decade, ladder, least_seconds, signed
from benchmarks.problems import loads
from benchmarks.work_precision.curtain import corner_height, reference_height
from examples.curtain import SETTINGS, Setting, extrapolated
from homogenize import FitOptions, MembraneLaw, fit
from rve import Cell, DirectOptions, InputError, StrainTable, solve_table

HEIGHT = 1000.0
BASE_SPACING, FINE_SPACING = 5.0, 2.5
BASE_CELLS = 8
GAPS = (1e-2, 1e-3, 1e-4, 1e-6, 1e-8)
SPACINGS = (22.5, 15.0, 9.0, 5.0, 3.0)
LAWS = ("net", "inner", "outer", "refined")
NAMES = {"contact": "contact tolerance", "table": "table spacing", "law": "kind of law"}
ERROR, SECONDS = "error of the mean height / height", "s, rings to curtain"
LEAST = 1e-6
"""Errors below are within the tolerance of the curtain's solver."""


def table_of(spacing: float, options: DirectOptions | None = None) -> StrainTable:
    """Load directions `spacing` degrees apart."""
    return solve_table(Cell(r1=5.0, r2=0.5), loads(spacing), options)


@cache
def law_of(spacing: float, kind: str = "refined") -> MembraneLaw:
    """The law of that table."""
    return fit(table_of(spacing), FitOptions(kind)).law


def base_height(law: MembraneLaw) -> float:
    """Mean height in mm on the base mesh."""
    return corner_height(law, BASE_CELLS)


def row_of(exact: float, height: float, seconds: float) -> Row:
    """The cells of one setting."""
    return {ERROR: (height - exact) / HEIGHT, "s": seconds, "_size": abs(height - exact) / HEIGHT, "_height": height}


def contact_ladder() -> list[Row]:
    """Gap times force (in units of s r1) at which contacts count as closed; residual likewise."""
    exact = base_height(law_of(BASE_SPACING))
    options = {gap: DirectOptions(tolerance=max(gap, 1e-11), mu_end=gap, branches="first") for gap in GAPS}

    def judge(found: StrainTable, seconds: float) -> Row:
        try:
            height = base_height(fit(found, FitOptions(normality=10.0 * found.options.mu_end)).law)
        except InputError:
            return row_of(exact, math.nan, seconds)  # rows so inaccurate that they contradict each other are refused
        return row_of(exact, height, seconds)

    return ladder(
        "contact", {f"{gap:.0e}": partial(table_of, BASE_SPACING, options[gap]) for gap in GAPS}, judge, long=0.0
    )


def table_ladder() -> list[Row]:
    """Spacing of load directions, against a table of 2.5 degrees."""
    exact = base_height(law_of(FINE_SPACING))
    rungs = {f"{spacing:g} deg, {len(loads(spacing)[0])} rows": partial(table_of, spacing) for spacing in SPACINGS}
    return ladder("table", rungs, lambda found, s: row_of(exact, base_height(fit(found).law), s), long=0.0)


def law_ladder() -> list[Row]:
    """Kinds of law from the same table, against the default law of the fine one; seconds are those of the curtain."""
    exact = base_height(law_of(FINE_SPACING))
    rungs = {kind: partial(corner_height, law_of(BASE_SPACING, kind), BASE_CELLS) for kind in LAWS}
    return ladder("law", rungs, partial(row_of, exact), long=0.0)


def mesh_ladder(sizes: Sequence[int], exact: float) -> list[Row]:
    """P2 cells along the width, and pairs of meshes extrapolated; all with the base law."""
    rungs = {f"{cells} cells": partial(corner_height, law_of(BASE_SPACING), cells) for cells in sizes}
    singles = ladder("mesh", rungs, partial(row_of, exact), long=0.0)
    rows = singles[:1]
    for coarse, fine in pairwise(singles):
        pair = row_of(exact, extrapolated(coarse["_height"], fine["_height"]), coarse["s"] + fine["s"])
        setting = f"{coarse['setting'].split()[0]} and {fine['setting']}, extrapolated"
        rows += [fine, {"method": "mesh", "setting": setting, "_name": "mesh, extrapolated"} | pair]
    return [*rows[:-1], rows[-1] | {"setting": f"{rows[-1]['setting']}: the reference", "_size": math.nan}]


def from_rings(setting: Setting) -> float:
    """Mean height in mm by the whole chain with this setting."""
    law = fit(table_of(setting.spacing)).law
    return extrapolated(*(corner_height(law, cells) for cells in setting.cells))


def recommendation(reference: float, spacings: Sequence[Row]) -> list[Row]:
    """What each accuracy takes: the error of its table by the ladder, the measured error, and the time."""
    rows: list[Row] = []
    parts = {row["setting"].split()[0]: row["_size"] for row in spacings}
    for accuracy, setting in SETTINGS.items():
        height, seconds = least_seconds(partial(from_rings, setting), long=0.0)
        error, spacing = abs(height - reference) / HEIGHT, f"{setting.spacing:g}"
        cells = " and ".join(str(cells) for cells in setting.cells) + ", extrapolated" * (len(setting.cells) > 1)
        row: Row = {"good to": f"{accuracy:.2%}", "table spacing, degrees": spacing, "P2 cells along the width": cells}
        row |= {"error of table and law": parts.get(spacing, math.nan), "error of the answer": error}
        rows.append(
            row | {"held": error <= accuracy, SECONDS: seconds, "_accuracy": accuracy, "_name": "rings to curtain"}
        )
    return rows


def parts_table(rows: Sequence[Row], doubt: float) -> Table:
    """All ladders with signed errors."""
    refused = "refused: rows contradict each other"
    told = [signed(row[ERROR], LEAST) if math.isfinite(row[ERROR]) else refused for row in rows]
    shown = [
        {"part": row["method"], "setting": row["setting"], ERROR: error, "s": row["s"]}
        for row, error in zip(rows, told, strict=True)
    ]
    note = (
        "Seconds: of the table for contact and table, of the curtain for law and mesh. The limit of the meshes is "
        f"known to {doubt / HEIGHT:.0e}."
    )
    return table("Parts", shown, {"s": ".2f"}, note)


def measure(full: bool) -> Section:
    """The section; `full` goes to meshes twice as fine."""
    sizes = (4, 8, 16, 32, 64) if full else (4, 8, 16, 32)
    mesh_reference, doubt = reference_height(sizes[-1])
    rows = [*contact_ladder(), *table_ladder(), *law_ladder(), *mesh_ladder(sizes, mesh_reference)]
    rows = [{"_name": NAMES.get(row["method"], row["method"])} | row for row in rows]
    # The reference: the limit of the base law's meshes, plus the change by the finer table on the base mesh.
    reference = mesh_reference + base_height(law_of(FINE_SPACING)) - base_height(law_of(BASE_SPACING))
    settings = recommendation(reference, [row for row in rows if row["method"] == "table"])
    forms = {"error of table and law": f"decade {LEAST}", "error of the answer": f"decade {LEAST}", SECONDS: ".1f"}
    note = f"Reference: {reference:.2f} mm, with the law of 2.5 degrees."
    recommended = table("Recommended: `examples/curtain.py --accuracy`", settings, forms, note)
    drawn = [replace(curve, joined=curve.label != "kind of law") for curve in curves(rows, "_name", "_size", "s")]
    title = "Mean height of the corner-hung square metre: what an error costs"
    whole = curves(settings, "_name", "_accuracy", SECONDS)
    picture = Diagram("chain", title, ERROR, "processor time (s)", (*drawn, *whole))
    text = (
        "Rings (r1/r2 = 10) to table to law to the mean height of a square metre hung by its two top corners. Base: "
        f"contacts closed to round-off, table of {BASE_SPACING:g} degrees, the default law, {BASE_CELLS} P2 cells "
        "along the width. Each ladder changes one part."
    )
    return Section("The whole chain", text, (recommended, parts_table(rows, doubt)), (picture,), _conclusion(rows))


def _conclusion(rows: Sequence[Row]) -> str:
    mesh, gap = (
        np.nanmin([row["_size"] for row in rows if row["_name"] == name]) for name in ("mesh", NAMES["contact"])
    )
    return (
        f"The mesh contributes most (error {decade(mesh, LEAST)} at the finest), then the table; closing contacts to "
        f"round-off costs little (error {decade(gap, LEAST)} at {GAPS[-1]:.0e}). Two extrapolated meshes are more "
        "accurate than one of half the cell size; 0.01 % needs them."
    )
