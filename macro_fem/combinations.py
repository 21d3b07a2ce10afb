"""Load combinations: a scene with partial factors on its loads, and the envelope of what the combinations ask for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from homogenize import CellInfo
from macro_fem.output.forces import support_rows
from macro_fem.scene.loads import areal_mass
from macro_fem.scene.moving import scaled
from macro_fem.scene.schema import Scene
from macro_fem.scene.tables import Combination, LiveLoad


def combined(scene: Scene, combination: Combination, cell: CellInfo | None) -> Scene:
    """The scene with each load times its factor; `cell`: that of the law, which tells the weight of the mesh."""
    curtain, keys = scene.curtain, ("force", "pressure", "mass")
    if combination.weight != 1.0:
        curtain = replace(curtain, areal_mass=combination.weight * areal_mass(scene, cell)[0])
    items = tuple(
        scaled(item, getattr(combination, item.kind), keys) if isinstance(item, LiveLoad) else item
        for item in scene.items
    )
    return replace(scene, curtain=curtain, items=items, combination=())


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
        | {key: summary[key] for key in ("status", "message", "safety_factor", "weakest", "weakest_factor")}
        for combination, summary in found
    ]
    worst = max(rows, key=lambda row: row["largest_force_N"])
    if all(row["weakest_factor"] is not None for row in rows):
        worst = min(rows, key=lambda row: row["weakest_factor"])
    points = []
    for each in zip(*(support_rows(one["support_forces"])[1] for _, one in found), strict=True):
        sizes = [float(np.linalg.norm(row[4:7])) for row in each]  # of the components of the force
        most = int(np.argmax(sizes))
        own = {"force_N": sizes[most], "combination": found[most][0].name}
        points.append(dict(zip(("support_number", "support", "x_mm", "y_mm"), each[0], strict=False)) | own)
    told = {key: worst[key] for key in ("safety_factor", "weakest", "weakest_factor")}
    return {"combinations": rows, "envelope": {"governing": worst["name"], **told, "support_forces": points}}
