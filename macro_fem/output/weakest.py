"""The weakest link of a curtain, from its summary: the mesh, the ring at a hook, or the hook itself; and the load
combination that governs."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from macro_fem.output.forces import support_rows
from macro_fem.output.strength import UNLOADED
from macro_fem.scene.tables import Combination
from rve.common import digits

OF_FORCE = (
    "triangles there are too large for an average over one cell of the rings, so for the mesh the factor is that of "
    "the force at this point over the width of one cell"
)
"""What is said of a factor that follows from the force at a point."""
ROOM = 1.5
"""What rings next to hooks bear at most over their estimate: ten scenes, `python -m benchmarks hooks --full`."""
JUDGED = ("safety_factor", "weakest", "weakest_factor", "utilisation_too_low")
"""Keys of a summary that combinations of loads are judged by."""
UTILISATIONS = tuple(f"utilisation_of_{what}_max" for what in ("averages", "point_forces", "hook_rings"))
"""Keys of what is asked of the mesh, by averages and by forces at points, and of the rings at hooks."""


class Link(NamedTuple):
    """What may give way: at how many times the load, its name, and a sentence without end."""

    factor: float
    name: str
    text: str


def links(summary: dict[str, Any]) -> list[Link]:
    """The links of a curtain that are loaded and whose strength is known, the weakest first."""
    averages, points, ring = (summary[key] or 0.0 for key in UTILISATIONS)
    mesh, found = max(averages, points), []
    if mesh > UNLOADED:
        text = "the mesh"
        if mesh >= ring:
            x, y = summary["utilisation_max_at_mm"]
            text = f"rings near {summary['first_yield_near']}, at ({x:g}, {y:g}) mm"
        found.append(Link(1.0 / mesh, "mesh", text))
    if ring > UNLOADED:
        found.append(Link(1.0 / ring, summary["ring_at_hook"], f"the {summary['ring_at_hook']}"))
    supports = summary["support_forces"]
    for number, support in enumerate(supports, 1):
        capacity, force = support.get("capacity_N"), support["largest_nodal_force_N"]
        if capacity is not None and force > UNLOADED * capacity:
            kind = "runner" if support["support"] == "track" else support["support"].removesuffix("s")
            of = f" of support {number}" if len(supports) > 1 else ""
            text = f"{kind}s of support {number} bear up to {digits(force, 4)} N of {capacity:g} N"
            found.append(Link(capacity / force, f"{kind} capacity{of}", text))
    return sorted(found)


def holds_line(summary: dict[str, Any]) -> str:
    """Whether the curtain holds, in one line: the factor, what gives first, what the other links bear.

    >>> hooks = {"support": "hooks", "capacity_N": 50.0, "largest_nodal_force_N": 10.0}
    >>> known = {"utilisation_of_averages_max": 0.2, "utilisation_of_point_forces_max": 0.0, "strength_note": None}
    >>> ring = {"utilisation_of_hook_rings_max": 0.4, "ring_at_hook": "ring at hook 3"}
    >>> of = {"ring_material": "steel", "ring_yield_N_per_mm2": 235.0, "utilisation_too_low": None}
    >>> print(holds_line({"support_forces": [hooks], **known, **ring, **of}).replace("; ", ";\\n"))
    holds with a factor 2.5;
    the ring at hook 3 would yield first (steel, 235 N/mm2);
    hooks of support 1 bear up to 10 N of 50 N;
    the mesh yields at 5 times the load
    """
    found, too_low = links(summary), summary["utilisation_too_low"]
    least = found[0].factor if found else float("inf")
    if least < 1.0:
        parts = [f"does not hold, factor {digits(least)}"]
    elif summary["strength_note"] is not None and summary["utilisation_of_averages_max"] is None:
        parts = [f"strength of the rings not known: {summary['strength_note']}"]
    else:
        room = any(link.factor < ROOM and "capacity" not in link.name for link in found)
        ask = f" (ask for {ROOM:g}: rings next to hooks may bear so many times their estimate)" if room else ""
        parts = [f"holds with a factor {'of at most ' if too_low else ''}{digits(least)}{ask}" if found else "no load"]
    for number, link in enumerate(found):
        material = f"({summary['ring_material']}, {summary['ring_yield_N_per_mm2'] or 0.0:g} N/mm2)"
        verb = "yields" if link.text.startswith("the ") else "yield"
        of_rings = f"would yield first {material}" if not number else f"{verb} at {digits(link.factor)} times the load"
        parts.append(link.text if "capacity" in link.name else f"{link.text} {of_rings}")
    averages, points, _ = (summary[key] or 0.0 for key in UTILISATIONS)
    if too_low:
        parts.append(too_low)
    if found and points > averages:
        parts.append(OF_FORCE)
    return "; ".join(parts)


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
    for combination, summary in found:
        for row in support_rows(summary["support_forces"])[1]:
            own = dict(zip(("support_number", "support", "x_mm", "y_mm"), row, strict=False))
            own |= {"force_N": float(np.linalg.norm(row[4:7])), "combination": combination.name}
            place = row[0], *np.round(row[2:4], 6)
            points[place] = max(points.get(place, own), own, key=lambda one: one["force_N"])
    told = {"governing": worst["name"]} | {key: worst[key] for key in JUDGED}
    return {"combinations": rows, "envelope": told | {"support_forces": list(points.values())}}
