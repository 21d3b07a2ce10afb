"""The whole chain: the error of the curtain's mean height, split into contact tolerance, table, law and mesh.

Each ladder varies one part and leaves the others as they are in `BASE`; its error is against the end of its own
ladder, mesh errors against the extrapolated mesh. Then the settings of `examples/curtain.py --accuracy` run from
rings to curtain, and what they were promised to hold is compared with what they do.
"""

from __future__ import annotations

import math
from functools import cache, partial

import numpy as np

from benchmarks.pages.measuring import least_seconds
from benchmarks.pages.model import Column, Curve, Diagram, Section, Table
from benchmarks.work_precision.curtain import converged, reference_height
from examples.curtain import SETTINGS, Setting, extrapolated, grid_of, scene_text
from homogenize.fit import FitOptions, fit
from homogenize.law import InputError, MembraneLaw
from macro_fem.scene import read_scene
from macro_fem.solvers import solve_scene
from rve.equilibrium import DirectOptions
from rve.sweep import Cell, solve_table
from rve.table import StrainTable

HEIGHT = 1000.0
BASE_SPACING, FINE_SPACING = 5.0, 2.5
BASE_CELLS = 8
GAPS = (1e-2, 1e-3, 1e-4, 1e-6, 1e-8)
SPACINGS = (22.5, 15.0, 9.0, 5.0, 3.0)
LAWS = ("net", "inner", "outer", "smooth", "refined")
PAIR, REFERENCE = "extrapolated", ": the reference"
PARTS = ("contact", "table", "law", "mesh")
Step = tuple[str, float, float, float]
"""Setting in words, error of the mean height over the height (signed), seconds, and the height itself in mm."""


def table_of(spacing: float, options: DirectOptions | None = None) -> StrainTable:
    """Load directions `spacing` degrees apart."""
    return solve_table(*grid_of(spacing), Cell(r1=5.0, r2=0.5), options)


@cache
def law_of(spacing: float, kind: str = "refined") -> MembraneLaw:
    """The law of that table."""
    return fit(table_of(spacing), FitOptions(kind)).law


def height_of(law: MembraneLaw, cells: int = BASE_CELLS) -> float:
    """Mean height in mm of the corner-hung square metre, P2."""
    import tomllib

    scene = read_scene(tomllib.loads(scene_text(cells)))
    return converged(solve_scene(scene, law)).mean_height()


def contact_ladder() -> list[Step]:
    """Gap times force (in units of s r1) at which contacts count as closed; residual likewise."""
    exact = height_of(law_of(BASE_SPACING))
    steps = []
    for gap in GAPS:
        options = DirectOptions(tolerance=max(gap, 1e-11), mu_end=gap)
        table, seconds = least_seconds(partial(table_of, BASE_SPACING, options), long=0.0)
        try:
            height = height_of(fit(table, FitOptions(normality=10.0 * gap)).law)
        except InputError:
            height = math.nan  # rows so inaccurate that they contradict each other are refused
        steps.append((f"{gap:.0e}", (height - exact) / HEIGHT, seconds, height))
    return steps


def table_ladder() -> list[Step]:
    """Spacing of load directions, against a table of 2.5 degrees."""
    exact = height_of(law_of(FINE_SPACING))
    steps = []
    for spacing in SPACINGS:
        table, seconds = least_seconds(partial(table_of, spacing), long=0.0)
        height = height_of(fit(table).law)
        steps.append((f"{spacing:g} deg, {len(table)} rows", (height - exact) / HEIGHT, seconds, height))
    return steps


def law_ladder() -> list[Step]:
    """Kinds of law from the same table, against the default law of the fine one; seconds are those of the curtain."""
    exact = height_of(law_of(FINE_SPACING))
    steps = []
    for kind in LAWS:
        law = law_of(BASE_SPACING, kind)
        height, seconds = least_seconds(partial(height_of, law), long=0.0)
        steps.append((kind, (height - exact) / HEIGHT, seconds, height))
    return steps


def mesh_ladder(sizes: tuple[int, ...], reference: float) -> list[Step]:
    """P2 cells along the width, and pairs of meshes extrapolated; all with the base law."""
    law = law_of(BASE_SPACING)
    steps, before, spent = [], math.nan, 0.0
    for cells in sizes:
        height, seconds = least_seconds(partial(height_of, law, cells), long=0.0)
        steps.append((f"{cells} cells", (height - reference) / HEIGHT, seconds, height))
        if math.isfinite(before):
            pair = extrapolated(before, height)
            words = f"{cells // 2} and {cells} cells, {PAIR}" + (REFERENCE if cells == sizes[-1] else "")
            steps.append((words, (pair - reference) / HEIGHT, spent + seconds, pair))
        before, spent = height, seconds
    return steps


def from_rings(setting: Setting) -> float:
    """Mean height in mm by the whole chain with this setting."""
    law = fit(table_of(setting.spacing)).law
    return extrapolated(*(height_of(law, cells) for cells in setting.cells))


def recommendation(reference: float, ladders: dict[str, list[Step]]) -> Table:
    """What each accuracy takes: the parts' errors by the ladders, the error that came out, and the time."""
    rows = []
    for accuracy, setting in SETTINGS.items():
        height, seconds = least_seconds(partial(from_rings, setting), long=0.0)
        error = abs(height - reference) / HEIGHT
        spacing = next((s for s in ladders["table"] if s[0].startswith(f"{setting.spacing:g} deg")), None)
        part = abs(spacing[1]) if spacing else math.nan
        words = " and ".join(str(cells) for cells in setting.cells) + (f", {PAIR}" if setting.cells[1:] else "")
        held = "yes" if error <= accuracy else "NO"
        rows.append((f"{accuracy:.2%}", f"{setting.spacing:g}", words, _decade(part), _decade(error), held, seconds))
    columns = (
        Column("good to"),
        Column("table spacing, degrees"),
        Column("P2 cells along the width"),
        Column("error of table and law", ".0e"),
        Column("error of the answer", ".0e"),
        Column("held"),
        Column("s, rings to curtain", ".1f", timed=True),
    )
    title = "Recommended: `examples/curtain.py --accuracy`"
    return Table(title, columns, tuple(rows), f"Reference: {reference:.2f} mm, with the law of 2.5 degrees.")


def measure(full: bool) -> Section:
    """The section; `full` goes to meshes twice as fine."""
    sizes = (4, 8, 16, 32, 64) if full else (4, 8, 16, 32)
    mesh_reference, doubt = reference_height(sizes[-1])
    ladders = {
        "contact": contact_ladder(),
        "table": table_ladder(),
        "law": law_ladder(),
        "mesh": mesh_ladder(sizes, mesh_reference),
    }
    # What a finer table changes on the base mesh is added to the limit of the base law's meshes.
    reference = mesh_reference + height_of(law_of(FINE_SPACING)) - height_of(law_of(BASE_SPACING))
    recommended = recommendation(reference, ladders)
    rows = tuple((part, *_shown(step)) for part in PARTS for step in ladders[part])
    columns = (
        Column("part"),
        Column("setting"),
        Column("error of the mean height / height"),
        Column("s", ".2f", timed=True),
    )
    note = (
        "Seconds: of the table for contact and table, of the curtain for law and mesh. The mesh's limit is known to "
        f"{doubt / HEIGHT:.0e}."
    )
    picture = Diagram(
        "chain",
        "Mean height of the corner-hung square metre: what an error costs",
        "error of the mean height / height",
        "processor time (s)",
        curves_of(ladders, recommended),
    )
    return Section(
        "chain",
        "The whole chain",
        _text(),
        (recommended, Table("Parts", columns, rows, note)),
        (picture,),
        _conclusion(ladders),
    )


def curves_of(ladders: dict[str, list[Step]], recommended: Table) -> tuple[Curve, ...]:
    """A curve for each part, single and extrapolated meshes apart, and one for the whole chain as recommended."""
    parts = [
        ("contact tolerance", ladders["contact"], True),
        ("table spacing", ladders["table"], True),
        ("kind of law", ladders["law"], False),
        ("mesh", [step for step in ladders["mesh"] if PAIR not in step[0]], True),
        ("mesh, extrapolated", [s for s in ladders["mesh"] if PAIR in s[0] and REFERENCE not in s[0]], True),
    ]
    curves = [Curve(name, _column(steps, 1), _column(steps, 2), joined) for name, steps, joined in parts]
    seconds = tuple(float(row[-1] or 0.0) for row in recommended.rows)
    return (*curves, Curve("rings to curtain", tuple(SETTINGS), seconds))


def _column(steps: list[Step], place: int) -> tuple[float, ...]:
    """Sizes of one number of the steps."""
    return tuple(abs(float(step[place])) for step in steps)


def _text() -> str:
    return (
        "Rings (r1/r2 = 10) to table to law to the mean height of a square metre hung by its two top corners. Base: "
        f"contacts closed to round-off, table of {BASE_SPACING:g} degrees, the default law, {BASE_CELLS} P2 cells "
        "along the width. Each ladder changes one part."
    )


def _conclusion(ladders: dict[str, list[Step]]) -> str:
    finest = {part: min(abs(step[1]) for step in ladders[part] if math.isfinite(step[1])) for part in PARTS[:2]}
    single = min(abs(step[1]) for step in ladders["mesh"] if PAIR not in step[0])
    return (
        f"The mesh decides ({_decade(single)} at the finest single one), then the table; contacts cost little to close "
        f"to round-off (error {_decade(finest['contact'])} at {GAPS[-1]:.0e}). Two meshes extrapolated are worth more "
        "than one twice as fine, and are what 0.01 % takes."
    )


def _shown(step: Step) -> tuple[str, str, float]:
    name, error, seconds, _ = step
    return name, "refused: rows contradict each other" if math.isnan(error) else _signed(error), seconds


def _signed(error: float) -> str:
    """One digit and the sign; what is below the curtain solver's own tolerance counts as nothing."""
    return "< 1e-06" if abs(error) < 1e-6 else f"{error:+.0e}"


def _decade(error: float) -> str:
    return "-" if not np.isfinite(error) else "< 1e-06" if error < 1e-6 else f"{error:.0e}"
