"""Forces of supports: of each point, in sum, as a table, and how far apart hooks are."""

from __future__ import annotations

from typing import Any

import numpy as np

from macro_fem.problem import CurtainProblem
from macro_fem.solution import CurtainSolution
from rve.common.texts import csv_text


def support_forces(solution: CurtainSolution) -> list[dict[str, Any]]:
    """Force of each support on the curtain in N, in sum and at each of its nodes, and what it holds.

    A component held by two supports counts for the first, so that the forces of all points balance the loads.
    `pitch_mm` is the distance of hooks or runners along the mesh, `pitch_asked_mm` what the scene asks for. `at_mm` is
    the reference position, `place_mm`, in space, where the point is. `capacity_N` is that of each hook or runner of a
    support by hooks or a track, None if none is stated.
    `nodes_held` and `length_held_mm` also count what an earlier support holds.
    """
    problem, reactions = solution.problem, solution.reactions
    taken = np.zeros(reactions.shape, bool)
    forces = []
    for number, (item, held) in enumerate(zip(problem.scene.support, problem.supports.held, strict=True)):
        row, is_edge = problem.mesh.hooks.get(number), len(held.facets) > 0
        own = np.zeros_like(taken)
        own[held.nodes] = held.mask
        own &= ~taken
        taken |= own
        part = np.where(own, reactions, 0.0)
        nodes = held.nodes[own[held.nodes].any(axis=1)]
        largest = float(np.linalg.norm(part, axis=1).max())
        columns = {"at_mm": problem.disc.nodes, "force_N": part}
        columns |= {"place_mm": solution.x} if part.shape[1] == 3 else {}
        forces.append(
            {
                "support": held.name,
                "force_N": part.sum(axis=0).tolist(),
                "largest_nodal_force_N": largest,
                **({} if is_edge else {"largest_force_per_ring_N": largest / getattr(item, "rings_per_hook", 1)}),
                **({"capacity_N": item.capacity} if hasattr(item, "capacity") else {}),
                **({"pitch_mm": row.pitch, "pitch_asked_mm": getattr(item, "pitch", None)} if row else {}),
                "nodes_held": len(held.nodes),
                "length_held_mm": held_length(problem, [held.facets]),
                "points": [{name: values[node].tolist() for name, values in columns.items()} for node in nodes],
            }
        )
    return forces


def held_length(problem: CurtainProblem, facets: list[np.ndarray]) -> float:
    """Length in mm of the facets (k,) of several supports, each counted once."""
    mesh = problem.mesh.mesh
    ends = mesh.p[:, mesh.facets[:, np.unique(np.concatenate(facets))]]
    return float(np.hypot(*(ends[:, 1] - ends[:, 0])).sum())


def support_table(supports: list[dict[str, Any]]) -> str:
    """The forces of supports point by point as CSV: number and name of the support, reference position, force.

    In space the third component of the force follows, and where the point is held.

    >>> print(support_table([{"support": "top", "points": [{"at_mm": [0.0, 9.0], "force_N": [0.5, 2.0]}]}]), end="")
    support_number,support,x_mm,y_mm,force_x_N,force_y_N
    1,top,0.0,9.0,0.5,2.0
    """
    return csv_text(*support_rows(supports))


def support_rows(supports: list[dict[str, Any]]) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    """Names of the columns and the rows of `support_table`."""
    in_space = any("place_mm" in point for support in supports for point in support["points"])
    more = ("force_z_N", "place_x_mm", "place_y_mm", "place_z_mm") if in_space else ()
    rows = [
        (
            number,
            support["support"],
            *point["at_mm"],
            *(point["force_N"] or (None, None, None)),
            *point.get("place_mm", ()),
        )
        for number, support in enumerate(supports, start=1)
        for point in support["points"]
    ]
    return ("support_number", "support", "x_mm", "y_mm", "force_x_N", "force_y_N", *more), rows
