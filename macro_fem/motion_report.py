"""Reports of scenes in motion and of natural frequencies, as `macro_fem.report` is of a curtain at rest."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from macro_fem.motion_summary import ModesSummary, MotionSummary
from macro_fem.output import plans
from macro_fem.output.images import Draw
from macro_fem.output.report_pages import HIGH, PAGE, Chapter, Headline, PageTable, Picture, write_pages
from macro_fem.output.sentences import loads_in_words, motion_verdict
from macro_fem.report import LIMITS, NOISE, components_of, places_of
from macro_fem.scene.scene import Scene
from macro_fem.scene.tables import in_3d
from macro_fem.summary import RingSupport, SupportForce
from rve.common import digits
from rve.common.optional import Axes, Figure


def write_motion_report(
    path: str | Path, scene: Scene, summary: MotionSummary, plot: Callable[[Axes], Axes],
    moments: Sequence[tuple[str, Draw]], inputs: Iterable[Path | None] = (),
) -> None:  # fmt: skip
    """Write the report of a scene in motion: verdict, force over time, moments, forces of supports at the weakest one,
    peaks, energies, limits. `plot` draws the forces; `moments`: their names, and how to draw them."""
    names, draws = zip(*moments, strict=True)
    curve = Picture(lambda width: plans.draw_axes(width, 0.6 * HIGH, plot), PAGE, "Force of all supports over time.")
    shown = Picture(lambda width: plans.draw_views(draws, width, PAGE, names), PAGE, "Line loads and forces over time.")
    told = motion_verdict(summary)
    lines = [
        f"{told[:1].upper()}{told[1:]}",
        f"First to give: {summary.weakest}{f', {summary.weakest_place}' if summary.weakest_place else ''}.",
        f"Largest force of all supports together: {digits(summary.peak_support_force_N, 4)} N, "
        f"at {digits(summary.peak_support_force_at_s, 4)} s.",
    ]
    lines = [line for line in lines if summary.weakest or not line.startswith("First")]
    if summary.status != "converged":
        lines = [f"{summary.status[:1].upper()}{summary.status[1:]}: {summary.message}", *lines]
    rows = list(_numbers(summary))
    limits = [*LIMITS, f"Forces: {summary.forces}.", summary.verdict_note, *summary.notes]
    sections = [
        Chapter("Forces of supports at the weakest moment", tables=_at_moment(summary)),
        Chapter("Peaks, factors and energies", tables=[PageTable("", ("what", "value", "unit"), rows)]),
        Chapter("Loads", [loads_in_words(scene)]),
        Chapter("Assumptions and limits", [f"{one[:1].upper()}{one[1:]}" for one in limits if one]),
    ]
    holds = summary.holds if summary.status == "converged" else False
    write_pages(path, scene, Headline(lines, holds), [[curve], [shown]], sections, summary.versions, inputs)


def _numbers(summary: MotionSummary) -> Iterator[tuple[str, str, str]]:
    """Words, value and unit of each number of `WORDS` that a summary has."""
    for key, words in WORDS.items():
        if (value := summary.get(key)) is not None:
            unit = next((one for end, one in UNITS.items() if key.endswith(f"_{end}")), "")
            yield words, f"{value}" if isinstance(value, int) else digits(value, 4), unit


UNITS = {
    "N_per_mm": "N/mm",
    "N_mm": "N mm",
    "N_s": "N s",
    "N_per_mm2": "N/mm2",
    "N": "N",
    "mm": "mm",
    "s": "s",
}
"""Units by the ends of keys, longer ones first."""
WORDS = {
    "smallest_factor": "smallest factor of all links over time",
    "at_s": "its moment",
    "safety_factor": "at that moment: first ring yields at so many times the load",
    "collapse_factor": "a ring collapses at so many times the load",
    "ring_yield_N_per_mm2": "yield stress of the wire",
    "utilisation_max": "rings are used at most, 1: yields",
    "utilisation_of_averages_max": "of it in the mesh, averages over a cell of the weave",
    "utilisation_of_point_forces_max": "of it at held and loaded points",
    "utilisation_of_hook_rings_max": "of it in the rings at hooks",
    "utilisation_pointwise_max": "largest utilisation in a triangle at that moment",
    "peak_utilisation": "largest utilisation in a triangle over time",
    "peak_utilisation_at_s": "its moment",
    "peak_line_load_N_per_mm": "largest line load over time",
    "peak_line_load_at_s": "its moment",
    "peak_contact_force_N": "largest force between two rings over time",
    "peak_contact_force_at_s": "its moment",
    "peak_support_force_N": "largest force of all supports together",
    "peak_support_force_at_s": "its moment",
    "peak_support_impulse_N_s": "largest impulse of a step on all supports together",
    "mean_height_mm": "mean height of the mesh at the end",
    "lowest_point_mm": "lowest point at the end",
    "kinetic_N_mm": "kinetic energy at the end",
    "potential_N_mm": "potential energy of the weight at the end",
    "stored_N_mm": "energy stored in the rings at the end",
    "work_N_mm": "work of wind and supports",
    "lost_by_damping_N_mm": "energy lost by damping",
    "lost_by_locking_N_mm": "energy lost as rings lock and things touch",
    "lost_by_scheme_N_mm": "energy lost by the steps of time, less with shorter ones",
    "lost_by_scheme_share": "its share of the largest kinetic energy",
    "account_error": "error of the sum of these energies, relative",
    "impacts": "steps in which rings or bodies strike",
    "largest_impact_at_s": "the moment of the largest",
    "duration_s": "duration asked for",
    "reached_s": "duration solved",
    "steps": "steps",
    "cells": "triangles",
    "ring_count": "rings",
    "min_gap_mm": "smallest gap between two rings",
}
"""What the table of numbers calls those of summary.json, in its order."""


def _at_moment(summary: MotionSummary) -> list[PageTable]:
    """Forces of supports at the weakest moment, as far as they are known."""
    rows, sums = [], []
    supports: tuple[SupportForce | RingSupport, ...] = summary.support_forces
    least = NOISE * max((abs(part) for one in supports for part in one.force_N or ()), default=0.0)
    for number, one in enumerate(supports, 1):
        of = f" of support {number}" if len(supports) > 1 else ""
        for k, point in enumerate(one.points, 1):
            force = in_3d(tuple(point.force_N)) if point.force_N else ()
            rows.append([f"{point.point or f'point {k}'}{of}", *places_of(point), *components_of(force, least, 3)])
        sums.append(
            [
                f"sum of {one.support}{of}",
                *5 * [""],
                *components_of(in_3d(tuple(one.force_N)) if one.force_N else (), least, 3),
            ]
        )
    groups = [("", 1), ("in sheet, mm", 2), ("at that moment, mm", 3), ("force, N", 4)]
    return [PageTable("", ("point", "x", "y", "x", "y", "z", "size", "x", "y", "z"), [*rows, *sums], groups)]


def write_modes_report(
    path: str | Path, scene: Scene, summary: ModesSummary, draw: Callable[[float], Figure],
    inputs: Iterable[Path | None] = (),
) -> None:  # fmt: skip
    """Write the report of natural frequencies: the lowest one, shapes, all of them, what is left out, limits."""
    hertz = [digits(one, 4) for one in summary.frequencies_Hz]
    lines = [f"Lowest natural frequency: {hertz[0]} Hz", f"Under {summary.loads}."]
    rows = [
        [f"{k}", one, f"{count}"] for k, (one, count) in enumerate(zip(hertz, summary.multiplicity, strict=True), 1)
    ]
    shapes = Picture(draw, PAGE, "Shapes of the lowest modes, each at a size that can be seen.")
    table = PageTable("", ("no.", "frequency, Hz", "modes of this frequency"), rows)
    limits = [*LIMITS[:2], f"Left out: {summary.left_out}", f"Line loads: {summary.forces_by}", *summary.notes]
    words = Chapter("Assumptions and limits", [one for one in limits if one])
    every = [Chapter("Natural frequencies", tables=[table]), words]
    write_pages(path, scene, Headline(lines, None), [[shapes]], every, summary.versions, inputs)
