"""What gives first in a curtain: the mesh, the ring at a hook or the hook itself; the verdict, and the load combination
that governs it."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from macro_fem.judged.forces import support_rows
from macro_fem.judged.strength import UNLOADED
from macro_fem.scene.tables import Combination
from rve.common import digits

JUDGED = ("safety_factor", "weakest", "weakest_factor", "weakest_place", "utilisation_too_low")
"""Keys of a summary that combinations of loads are judged by."""
UTILISATIONS = tuple(f"utilisation_of_{what}_max" for what in ("averages", "point_forces", "hook_rings"))
"""Keys of what is asked of the mesh, by averages and by forces at points, and of the rings at hooks."""


class Link(NamedTuple):
    """What may give way: at how many times the load, its name, a sentence without end, and its place in the flat sheet,
    with what is nearest to it."""

    factor: float
    name: str
    text: str
    place: str = ""


def links(summary: dict[str, Any]) -> list[Link]:
    """The links of a curtain that are loaded and whose strength is known, the weakest first."""
    averages, points, ring = (summary[key] or 0.0 for key in UTILISATIONS)
    mesh, found = max(averages, points), []
    if mesh > UNLOADED:
        text, place = "the mesh", ""
        if mesh >= ring:
            near, distance = summary["first_yield_near"], summary["first_yield_distance_mm"]
            place = _place(summary["utilisation_max_at_mm"], f"{_from(distance)} {near}")
            text = f"rings {place}"
        found.append(Link(1.0 / mesh, "mesh", text, place))
    if ring > UNLOADED:
        place = _place(summary["utilisation_max_at_mm"]) if ring > mesh else ""
        found.append(Link(1.0 / ring, summary["ring_at_hook"], f"the {summary['ring_at_hook']}", place))
    supports = summary["support_forces"]
    for number, support in enumerate(supports, 1):
        capacity, force = support.get("capacity_N"), support["largest_nodal_force_N"]
        if capacity is not None and force > UNLOADED * capacity:
            kind = "runner" if support["support"] == "track" else support["support"].removesuffix("s")
            of = f" of support {number}" if len(supports) > 1 else ""
            text = f"{kind}s of support {number} bear up to {digits(force, 4)} N of {capacity:g} N"
            most = max(support["points"], key=lambda one: np.linalg.norm(one["force_N"]), default=None)
            place = _place(most["at_mm"], f"{most['point']}{of}") if most else ""
            found.append(Link(capacity / force, f"{kind} capacity{of}", text, place))
    return sorted(found)


def _place(at: Sequence[float], near: str = "") -> str:
    """A place in the flat sheet, and what is near."""
    x, y = at
    return f"at ({x:.6g}, {y:.6g}) mm{', ' * bool(near)}{near}"


def _from(distance: float) -> str:
    """How far a place is from something, as far as it matters."""
    return "at" if distance < 0.05 else f"{digits(distance)} mm from"


def governing(summary: Mapping[str, Any]) -> dict[str, Any]:
    """What a reader decides by: whether the curtain holds, None where that is not known, under which combination (None
    without any), by which factor, why that may be less, what gives first and where; the largest force of a single point
    under any of them."""
    worst, rows = summary.get("envelope", summary), summary.get("combinations", ())
    factor, is_solved = worst["weakest_factor"], summary["status"] == "converged"
    own = max((one["largest_nodal_force_N"] for one in summary["support_forces"]), default=0.0)
    return {
        "holds": None if factor is None or not is_solved else factor >= 1.0,
        "governing_factor": factor,
        "governing_note": worst["utilisation_too_low"],
        "governing_combination": worst.get("governing"),
        "governing_link": worst["weakest"],
        "governing_place": worst["weakest_place"],
        "governing_force_N": max((row["largest_force_N"] for row in rows), default=own),
    }


def envelope(found: Sequence[tuple[Combination, Mapping[str, Any]]]) -> dict[str, Any]:
    """What summary.json says of combinations, from their summaries: factors, status and what gives first of each; which
    one governs, by the least factor (by the largest force of a single point where the strength of the rings is not
    known); for each held point the largest force of all and the combination that asks for it."""
    rows: list[dict[str, Any]] = [
        {
            "name": combination.name,
            "factors": {item.name: getattr(combination, item.name) for item in fields(combination)[1:]},
            "largest_force_N": max((one["largest_nodal_force_N"] for one in summary["support_forces"]), default=0.0),
        }
        | {key: summary[key] for key in ("status", "message", *JUDGED)}
        for combination, summary in found
    ]
    worst = max(rows, key=lambda row: row["largest_force_N"])
    if known := [row for row in rows if row["weakest_factor"] is not None]:  # others may be without load
        worst = min(known, key=lambda row: row["weakest_factor"])
    points: dict[tuple[Any, ...], dict[str, Any]] = {}  # by places: each combination may have refined its own mesh
    sums: dict[int, dict[str, Any]] = {}
    for combination, summary in found:
        for row in support_rows(summary["support_forces"])[1]:
            own = dict(zip(("support_number", "support", "x_mm", "y_mm"), row, strict=False))
            own |= {"force_N": float(np.linalg.norm(row[4:7])), "combination": combination.name, "point": row[-1]}
            place = row[0], *np.round(row[2:4], 6)
            points[place] = max(points.get(place, own), own, key=lambda one: one["force_N"])
        for number, one in enumerate(summary["support_forces"], 1):
            size = float(np.linalg.norm(one["force_N"]))
            own = {
                "support_number": number,
                "support": one["support"],
                "force_N": size,
                "combination": combination.name,
            }
            sums[number] = max(sums.get(number, own), own, key=lambda one: one["force_N"])
    told = {"governing": worst["name"]} | {key: worst[key] for key in JUDGED}
    forces = {"support_forces": list(points.values()), "support_sums": list(sums.values())}
    return {"combinations": rows, "envelope": told | forces}
