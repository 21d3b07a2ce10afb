"""Load combinations: a scene with partial factors on its loads, and the envelope of what the combinations ask for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from homogenize import CellInfo
from macro_fem.scene.loads import areal_mass
from macro_fem.scene.moving import scaled
from macro_fem.scene.schema import Scene
from macro_fem.scene.tables import Combination, LiveLoad


def combined(scene: Scene, combination: Combination, cell: CellInfo | None) -> Scene:
    """The scene with each load times its factor; `cell`: that of the law, which tells the weight of the mesh.

    A wind by its speed has a drag in proportion to the square, so its speed grows with the root of the factor.
    """
    curtain = scene.curtain
    if combination.weight != 1.0:
        curtain = replace(curtain, areal_mass=combination.weight * areal_mass(scene, cell)[0])
    items = (
        scaled(item, getattr(combination, item.kind), ("force", "pressure", "mass"))
        if isinstance(item, LiveLoad)
        else item
        for item in scene.items
    )
    return replace(scene, curtain=curtain, items=tuple(items), combination=())


def envelope(found: Sequence[tuple[Combination, Mapping[str, Any]]]) -> dict[str, Any]:
    """What summary.json says of combinations and their summaries.

    `combinations` has each one's factors, status and what gives first; `envelope` the one that governs, with the least
    factor (the largest force of a single point where the strength of the rings is not known), and for each held point
    the largest force of all and the combination that asks for it.
    """
    rows: list[dict[str, Any]] = [
        {
            "name": combination.name,
            "factors": {item.name: getattr(combination, item.name) for item in fields(combination)[1:]},
            "largest_force_N": max((one["largest_nodal_force_N"] for one in summary["support_forces"]), default=0.0),
        }
        | {key: summary[key] for key in ("status", "message", "safety_factor", "weakest", "weakest_factor")}
        for combination, summary in found
    ]
    known = [row for row in rows if row["weakest_factor"] is not None]
    worst = (
        min(known, key=lambda row: row["weakest_factor"])
        if len(known) == len(rows)
        else max(rows, key=lambda row: row["largest_force_N"])
    )
    told = {key: worst[key] for key in ("safety_factor", "weakest", "weakest_factor")}
    return {"combinations": rows, "envelope": {"governing": worst["name"], **told, "support_forces": _most(found)}}


def _most(found: Sequence[tuple[Combination, Mapping[str, Any]]]) -> list[dict[str, Any]]:
    """The largest force of each held point, and the combination that it is of."""
    rows = []
    for number, supports in enumerate(zip(*(one["support_forces"] for _, one in found), strict=True), 1):
        for points in zip(*(support["points"] for support in supports), strict=True):
            forces = [float(np.linalg.norm(point["force_N"])) for point in points]
            most = int(np.argmax(forces))
            place = points[0]["at_mm"]
            name = supports[0]["support"]
            rows.append(
                {"support_number": number, "support": name, "x_mm": place[0], "y_mm": place[1]}
                | {"force_N": forces[most], "combination": found[most][0].name}
            )
    return rows
