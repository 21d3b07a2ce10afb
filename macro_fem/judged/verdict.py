"""What gives first in a curtain: the mesh, the ring at a hook or the hook itself; the verdict, and the load combination
that governs it."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from macro_fem.curtain import CurtainState
from macro_fem.judged.forces import first_of_largest, support_forces
from macro_fem.judged.strength import UNLOADED, largest_utilisation
from macro_fem.scene.tables import Combination
from macro_fem.summary import (
    CombinationRow,
    CurtainNumbers,
    Decision,
    Envelope,
    LargestForce,
    Limit,
    SupportForce,
    Utilisation,
)
from rve.common import digits


class Link(NamedTuple):
    """What may give way: at how many times the load, its name, a sentence without end, and its place in the flat sheet,
    with what is nearest to it."""

    factor: float
    name: str
    text: str
    place: str = ""


def asked_of_rings(summary: Utilisation) -> tuple[float, float, float]:
    """Utilisation of the mesh, by averages and by forces at points, and of the rings at hooks; 0 if not known."""
    averages, points = summary.utilisation_of_averages_max, summary.utilisation_of_point_forces_max
    return averages or 0.0, points or 0.0, summary.utilisation_of_hook_rings_max or 0.0


def severity(state: CurtainState) -> float:
    """How near a curtain is to failure: 1 over the least factor of its `links`, or, where neither the strength of rings
    nor a capacity is known, the largest force of a single point, N."""
    supports, used = support_forces(state), largest_utilisation(state)
    borne = [one.largest_nodal_force_N / one.capacity_N for one in supports if one.capacity_N]
    return largest_force(supports) if used is None and not borne else max(used or 0.0, *borne, 0.0)


def links(summary: Utilisation, supports: Sequence[SupportForce]) -> list[Link]:
    """The links of a curtain that are loaded and whose strength is known, the weakest first: rings and mesh at first
    yield, or at their limit where rings flow."""
    limit = summary if isinstance(summary, Limit) else Limit()
    averages, points, ring = asked_of_rings(summary)
    at, mesh, found = summary.utilisation_max_at_mm or (), max(averages, points), list[Link]()
    if limit.limit_of_mesh is not None:
        found.append(Link(limit.limit_of_mesh, "limit of the mesh", "the mesh"))
        if limit.limit_of_points is not None:
            found.append(Link(limit.limit_of_points, "rings at points", "the ring at a held or loaded point"))
    elif mesh > UNLOADED:
        text, place = "the mesh", ""
        if mesh >= ring:
            place = _place(at, f"{_from(summary.first_yield_distance_mm or 0.0)} {summary.first_yield_near}")
            text = f"rings {place}"
        found.append(Link(1.0 / mesh, "mesh", text, place))
    if ring > UNLOADED and limit.limit_of_mesh is None:
        place = _place(at) if ring > mesh else ""
        found.append(Link(1.0 / ring, summary.ring_at_hook or "ring", f"the {summary.ring_at_hook}", place))
    for number, support in enumerate(supports, 1):
        capacity, force = support.capacity_N, support.largest_nodal_force_N
        if capacity is not None and force > UNLOADED * capacity:
            held = support.points
            kind = str(held[0].point).rpartition(" ")[0] if held else "point"
            of = f" of support {number}" if len(supports) > 1 else ""
            text = f"{kind}s of support {number} bear up to {digits(force, 4)} N of {capacity:g} N"
            most = held[first_of_largest([one.size_N for one in held])] if held else None
            place = _place(most.at_mm, f"{most.point}{of}") if most else ""
            found.append(Link(capacity / force, f"{kind} capacity{of}", text, place))
    return sorted(found)


def _place(at: Sequence[float], near: str = "") -> str:
    """A place in the flat sheet, and what is near."""
    x, y = at
    return f"at ({x:.6g}, {y:.6g}) mm{', ' * bool(near)}{near}"


def _from(distance: float) -> str:
    """How far a place is from something, as far as it matters."""
    return "at" if distance < 0.05 else f"{digits(distance)} mm from"


def largest_force(supports: Sequence[SupportForce]) -> float:
    """The largest force of a single point, N."""
    return max((one.largest_nodal_force_N for one in supports), default=0.0)


def judge(summary: CurtainNumbers, rows: Sequence[CombinationRow] = (), most: Envelope | None = None) -> Decision:
    """What a reader decides by: whether the curtain holds, None where that is not known, under which combination of the
    `rows` (None without any), by which factor, why that may be less, what gives first and where; the largest force of
    a single point under any of them. most: the envelope of the rows."""
    worst, is_solved = most or summary, summary.status in ("converged", "collapsed")
    factor = worst.weakest_factor
    is_judged = factor is None or summary.utilisation_max is not None
    unknown = None if is_judged else f"the strength of the mesh is not known: {summary.strength_note}"
    return Decision(
        holds=None if factor is None or not is_solved else factor >= 1.0,
        governing_factor=factor,
        governing_note=worst.utilisation_too_low or unknown,
        governing_combination=None if most is None else most.governing,
        governing_link=worst.weakest,
        governing_place=worst.weakest_place,
        governing_force_N=max((row.largest_force_N for row in rows), default=largest_force(summary.support_forces)),
    )


def combination_rows(answers: Sequence[tuple[Combination, CurtainNumbers]]) -> tuple[CombinationRow, ...]:
    """Of each combination its factors, how its answer ended, and what gives first."""
    return tuple(
        CombinationRow(
            name=combination.name,
            factors={key: value for key, value in vars(combination).items() if key not in ("name", "own")}
            | dict(combination.own),
            largest_force_N=largest_force(summary.support_forces),
            status=summary.status,
            message=summary.message,
            **_judged(summary),
        )
        for combination, summary in answers
    )


def _judged(of: CurtainNumbers | CombinationRow) -> dict[str, Any]:
    """What combinations of loads are judged by."""
    return {
        "safety_factor": of.safety_factor,
        "weakest": of.weakest,
        "weakest_factor": of.weakest_factor,
        "weakest_place": of.weakest_place,
        "utilisation_too_low": of.utilisation_too_low,
        "limit_factor": of.limit_factor,
    }


def envelope(answers: Sequence[tuple[Combination, CurtainNumbers]], rows: Sequence[CombinationRow]) -> Envelope:
    """Which combination governs, by the least factor (by the largest force of a single point where the strength of the
    rings is not known); for each held point the largest force of all and the combination that asks for it. rows: the
    `combination_rows` of the answers."""
    known = [row for row in rows if row.weakest_factor is not None]  # others may be without load
    worst = min(
        known or rows, key=lambda row: -row.largest_force_N if row.weakest_factor is None else row.weakest_factor
    )
    points: dict[tuple[Any, ...], LargestForce] = {}  # by places: each combination may have refined its own mesh
    sums: dict[int, LargestForce] = {}
    for combination, summary in answers:
        for number, support in enumerate(summary.support_forces, 1):
            named: dict[str, Any] = {
                "support_number": number,
                "support": support.support,
                "combination": combination.name,
            }
            total = LargestForce(**named, force_N=float(np.linalg.norm(support.force_N)))
            sums[number] = max(sums.get(number, total), total, key=lambda one: one.force_N)
            for one in support.points:
                x, y = one.at_mm[:2]
                own = LargestForce(**named, x_mm=x, y_mm=y, force_N=one.size_N, point=one.point)
                place = number, round(x, 6), round(y, 6)
                points[place] = max(points.get(place, own), own, key=lambda one: one.force_N)
    each, whole = tuple(points.values()), tuple(sums.values())
    return Envelope(governing=worst.name, **_judged(worst), support_forces=each, support_sums=whole)
