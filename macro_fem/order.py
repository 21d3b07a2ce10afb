"""What to order for a curtain: mesh, rings, hooks, and what it covers when it hangs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from macro_fem.rings.curtain import read_told
from macro_fem.solution import CurtainSolution
from rve.common.errors import InputError


def order(solution: CurtainSolution, summary: dict[str, Any]) -> dict[str, Any]:
    """The order sheet of a solved curtain for summary.json, lengths in mm.

    Width and height are those of the sheet pulled along its grain, the reference state of the law. `cells` and `rings`
    are areas over the area of a cell of the weave, rounded, None for a law without rings. `hooks` counts the points
    that are held one by one, `hook_pitch_mm` is their distance along the mesh, None where there is no row of them.
    """
    corners = solution.problem.mesh.mesh.p
    width, height = np.ptp(corners, axis=1).tolist()
    area = float(solution.problem.disc.cell_area.sum())
    single = [one for one in summary["support_forces"] if "largest_force_per_ring_N" in one]
    return {
        "mesh_width_mm": width,
        "mesh_height_mm": height,
        **_counts(area, summary),
        "mass_kg": summary["mass_kg"],
        "hooks": sum(one["nodes_held"] for one in single),
        "hook_pitch_mm": next((one["pitch_mm"] for one in single if "pitch_mm" in one), None),
        "covers_width_mm": float(np.ptp(solution.x[:, 0])),
        "lowest_point_mm": summary["lowest_point_mm"],
    }


def _counts(area: float, summary: dict[str, Any]) -> dict[str, int | None]:
    """Cells and rings on an area in mm2."""
    try:
        cell = read_told(summary, "").cell("")
    except InputError:  # a law without rings, or of a weave that is not known
        return {"cells": None, "rings": None}
    cells = area / (summary["rings"]["b_x_mm"] * summary["rings"]["b_y_mm"] * math.prod(cell.weave.repeat))
    return {"cells": round(cells), "rings": round(cells * cell.weave.classes)}
