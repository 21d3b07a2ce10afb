"""Bounds of a curtain and the interval of its answer, as numbers of the summary and in words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from macro_fem.problem import CurtainProblem
from macro_fem.scene.tables import LiveLoad

if TYPE_CHECKING:
    from macro_fem.bounds.adapt import Level


def is_mean_height(problem: CurtainProblem) -> bool:
    """Whether the potential tells the mean height: the curtain's own weight is the only load."""
    x, y, z = problem.scene.load.acceleration
    is_down = x == z == 0.0 and y < 0.0
    return is_down and not problem.scene.of(LiveLoad) and bool(np.abs(problem.force).sum() > 0.0)


def bounds_summary(level: Level) -> dict[str, Any]:
    """Bounds of the potential of the continuous curtain, N mm, and their gap over total load times size.

    Where weight is the only load the potential is the mean height, so that this is bounded too.
    """
    solution, bounds, problem = level.solution, level.bounds, level.solution.problem
    total = float(np.abs(problem.force).sum())
    mean = solution.mean_height()
    return {
        "status": bounds.status,
        "cells": problem.disc.n_cells,
        "upper_N_mm": bounds.upper,
        "lower_N_mm": bounds.lower,
        "gap_N_mm": bounds.gap,
        "gap_over_load_times_height": bounds.gap / (total * problem.mesh.height) if total > 0.0 else 0.0,
        "part_of_gap_due_to_points_N_mm": bounds.points,
        "wall_s": solution.wall_s + bounds.wall_s,
    } | ({"mean_height_mm": [mean - bounds.gap / total, mean]} if is_mean_height(problem) else {})


def interval_summary(level: Level) -> dict[str, Any]:
    """The interval of the answer and its parts: of the mean height in mm, or of the potential in N mm.

    The law's part is null where the law has no rows: then the interval is that of the law, not of the rings.
    """
    bounds, problem, law = level.bounds, level.solution.problem, level.bounds.law_part
    what, unit, per, ends = "potential", "N_mm", 1.0, [bounds.lower, bounds.upper]
    of = "potential, since other loads than the curtain's weight act"
    if is_mean_height(problem):
        what, unit, per, of = "mean_height", "mm", float(np.abs(problem.force).sum()), "mean height"
        ends = bounds_summary(level)["mean_height_mm"]
    for_what = "this law: its rows are not known" if law is None else "the rings, between the laws inside and outside"
    return {
        f"{what}_interval_{unit}": ends,
        f"law_part_{unit}": None if law is None else law / per,
        f"mesh_part_{unit}": (bounds.gap - (law or 0.0)) / per,
        "interval": f"of the {of}; holds for the continuous curtain and {for_what}",
    }
