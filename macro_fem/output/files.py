"""Files of a solved curtain: summary.json, support_forces.csv and curtain.vtu, written atomically."""

from __future__ import annotations

import csv
import io
import json
import platform
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from homogenize import CellInfo
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.discretization import discretize
from macro_fem.fem.linear import chosen
from macro_fem.fem.space import padded
from macro_fem.output import line_load, strength
from macro_fem.scene.loads import PER_MM2, areal_mass
from macro_fem.scene.meshing.places import counterclockwise
from macro_fem.scene.tables import Hooks, Track
from macro_fem.scene.wind import wind_summary
from macro_fem.solution import CurtainSolution, Problem
from rve.common.cells import mean_at_corners
from rve.common.storage.files import write_text, write_whole
from rve.common.storage.vtu import DIRECTION_1, DISPLACEMENT, LINE_LOAD_1, LINE_LOAD_2, STATE, STRAIN, STRESS
from rve.common.types import Array

if TYPE_CHECKING:
    from macro_fem.bounds.adapt import Level

NOT_UNIQUE = (
    "rigid rings can share the load in many ways, and forces of single points, line loads and the safety factor are "
    'those of one of them; kind = "elastic" under [solver] gives those that the stiffness of the rings decides'
)
"""What a rigid curtain that hangs from several points says of its forces."""
VTU_CELLS = {"P1": "triangle", "CR": "triangle", "P2": "triangle", "Q1": "quad", "Q2": "quad"}


def write_summary(folder: Path, summary: dict[str, Any]) -> None:
    """summary.json in `folder`, where numbers that are not finite are null, and support_forces.csv beside it."""
    content = json.dumps(_finite(summary), indent=2, allow_nan=False) + "\n"
    write_text(folder / "summary.json", content)
    write_text(folder / "support_forces.csv", support_table(summary["support_forces"]))


def support_table(supports: list[dict[str, Any]]) -> str:
    """The forces of supports point by point as CSV: number and name of the support, reference position, force.

    In space the third component of the force follows, and where the point is held.

    >>> print(support_table([{"support": "top", "points": [{"at_mm": [0.0, 9.0], "force_N": [0.5, 2.0]}]}]), end="")
    support_number,support,x_mm,y_mm,force_x_N,force_y_N
    1,top,0.0,9.0,0.5,2.0
    """
    text = io.StringIO()
    columns, rows = support_rows(supports)
    csv.writer(text, lineterminator="\n").writerows([columns, *rows])
    return text.getvalue()


def support_rows(supports: list[dict[str, Any]]) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
    """Names of the columns and the rows of `support_table`."""
    in_space = any("place_mm" in point for support in supports for point in support["points"])
    more = ("force_z_N", "place_x_mm", "place_y_mm", "place_z_mm") if in_space else ()
    rows = [
        (number, support["support"], *point["at_mm"], *point["force_N"], *point.get("place_mm", ()))
        for number, support in enumerate(supports, start=1)
        for point in support["points"]
    ]
    return ("support_number", "support", "x_mm", "y_mm", "force_x_N", "force_y_N", *more), rows


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return value if not isinstance(value, float) or np.isfinite(value) else None


def summarize(solution: CurtainSolution) -> dict[str, Any]:
    """The numbers of a solution: lengths in mm, forces in N, line loads in N per mm of reference length.

    Heights are y coordinates. `hang_deg` (angle of the weave) and `rings` (radii and cell of the law) are read by
    `rve localize`. Potentials are -sum force . displacement in N mm; their gap bounds the discrete error.
    """
    problem = solution.problem
    disc = problem.disc
    state = solution.state()
    area = disc.cell_area
    told, forces = strength.summary(solution), support_forces(solution)
    return {
        "status": solution.status,
        "message": solution.message,
        "mean_height_mm": solution.mean_height(),
        "lowest_point_mm": float(solution.x[:, 1].min()),
        **_places_in_space(solution),
        "max_displacement_mm": float(np.linalg.norm(solution.displacement, axis=1).max()),
        **line_load.summary(solution),
        **told,
        **strength.mechanism(told, forces),
        "total_load_N": problem.force.sum(axis=0).tolist(),
        "support_forces": forces,
        "support_forces_note": forces_note(solution),
        "nodes_held": int(problem.supports.mask.any(axis=1).sum()),
        "length_held_mm": held_length(problem, [held.facets for held in problem.supports.held]),
        "potential_primal_N_mm": solution.primal,
        "potential_dual_N_mm": solution.dual,
        "relative_gap": solution.relative_gap,
        "residual": solution.residual,
        "stretch_beyond_locking": solution.stretch_excess,
        "iterations": solution.iterations,
        "cells": disc.n_cells,
        "dofs": int(problem.fem.n),
        "element": disc.element,
        "pattern": problem.mesh.pattern,
        "linear_solver": None if problem.scene.solver.kind == "clarabel" else chosen(problem.fem.method),
        "law": problem.law.name,
        "hang_deg": problem.scene.curtain.weave_angle,
        "rings": rings(problem.law.cell),
        **wind_summary(problem.scene, problem.law.cell),
        **masses(solution),
        "taut_area_fraction": float(area[state == 2].sum() / area.sum()),
        "wrinkled_area_fraction": float(area[state == 1].sum() / area.sum()),
        "slack_area_fraction": float(area[state == 0].sum() / area.sum()),
        "wall_s": solution.wall_s,
        "versions": versions(),
    }


def _places_in_space(solution: CurtainSolution) -> dict[str, Any]:
    """Places that tell the shape of a curtain in space, mm; nothing for a plane one."""
    problem, x = solution.problem, solution.x
    if problem.fem.d == 2:
        return {}
    shares = load_vector(discretize(problem.mesh.mesh, problem.disc.element), np.array([1.0]))[:, 0]
    return {
        "lowest_point_at_mm": x[x[:, 1].argmin()].tolist(),
        "out_of_plane_mm": float(np.abs(x[:, 2]).max()),
        "centre_of_gravity_mm": (shares @ x / shares.sum()).tolist(),
    }


def rings(cell: CellInfo | None) -> dict[str, float] | None:
    """Radii and reference cell of the law, without its areal mass, which a scene may replace."""
    if cell is None:
        return None
    return {key: value for key, value in asdict(cell).items() if key != "areal_mass_kg_per_m2"}


def masses(solution: CurtainSolution) -> dict[str, Any]:
    """The areal mass of the curtain, whether it is from the scene or the law, and the mass of the whole curtain."""
    mass, source = areal_mass(solution.problem.scene, solution.problem.law.cell)
    total = mass * PER_MM2 * float(solution.problem.disc.cell_area.sum())
    return {"areal_mass_kg_per_m2": mass, "areal_mass_from": source, "mass_kg": total}


def support_forces(solution: CurtainSolution) -> list[dict[str, Any]]:
    """Force of each support on the curtain in N, in sum and at each of its nodes, and what it holds.

    A component held by two supports counts for the first, so that the forces of all points balance the loads.
    `at_mm` is the reference position, `place_mm`, in space, where the point is. `capacity_N` is that of each hook or
    runner of a support by hooks or a track, None if none is stated.
    `nodes_held` and `length_held_mm` also count what an earlier support holds.
    """
    problem, reactions = solution.problem, solution.reactions
    taken = np.zeros(reactions.shape, bool)
    forces = []
    for item, held in zip(problem.scene.support, problem.supports.held, strict=True):
        own = np.zeros_like(taken)
        own[held.nodes] = held.mask
        own &= ~taken
        taken |= own
        part = np.where(own, reactions, 0.0)
        nodes = held.nodes[own[held.nodes].any(axis=1)]
        forces.append(
            {
                "support": held.name,
                "force_N": part.sum(axis=0).tolist(),
                "largest_nodal_force_N": float(np.linalg.norm(part, axis=1).max()),
                **({"capacity_N": item.capacity} if isinstance(item, Hooks | Track) else {}),
                "nodes_held": len(held.nodes),
                "length_held_mm": held_length(problem, [held.facets]),
                "points": _points(problem.disc.nodes[nodes], part[nodes], solution.x[nodes]),
            }
        )
    return forces


def forces_note(solution: CurtainSolution) -> str | None:
    """Why forces of single points are one choice of many; None of elastic rings, and of one or two points."""
    is_elastic = solution.problem.scene.solver.kind == "elastic"
    return None if is_elastic or solution.problem.supports.mask.any(axis=1).sum() <= 2 else NOT_UNIQUE


def _points(at: Array, force: Array, place: Array) -> list[dict[str, list[float]]]:
    """Reference position `at` (k, 2) and force (k, d) of each held point, and in space where it is."""
    columns = {"at_mm": at, "force_N": force} | ({"place_mm": place} if place.shape[1] == 3 else {})
    return [
        dict(zip(columns, row, strict=True)) for row in zip(*(part.tolist() for part in columns.values()), strict=True)
    ]


def held_length(problem: Problem, facets: list[np.ndarray]) -> float:
    """Length in mm of the facets (k,) of several supports, each counted once."""
    mesh = problem.mesh.mesh
    ends = mesh.p[:, mesh.facets[:, np.unique(np.concatenate(facets))]]
    return float(np.hypot(*(ends[:, 1] - ends[:, 0])).sum())


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that were used."""
    from importlib.metadata import PackageNotFoundError, version

    found = {"python": platform.python_version()}
    for package in ("ring-mesh", "numpy", "scipy", "scikit-fem", "scikit-sparse", "clarabel"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "absent"
    return found


def bounds_summary(level: Level) -> dict[str, Any]:
    """Bounds of the potential of the continuous curtain, N mm, and their gap over total load times size.

    Where weight is the only load the potential is the mean height, so that this is bounded too.
    """
    solution, bounds = level.solution, level.bounds
    problem = solution.problem
    total = float(np.abs(problem.force).sum())
    summary = {
        "status": bounds.status,
        "cells": problem.disc.n_cells,
        "upper_N_mm": bounds.upper,
        "lower_N_mm": bounds.lower,
        "gap_N_mm": bounds.gap,
        "gap_over_load_times_height": bounds.gap / (total * problem.mesh.height) if total > 0.0 else 0.0,
        "part_of_gap_due_to_points_N_mm": bounds.points,
        "wall_s": solution.wall_s + bounds.wall_s,
    }
    if is_mean_height(problem):
        mean = solution.mean_height()
        summary["mean_height_mm"] = [mean - bounds.gap / total, mean]
    return summary


def is_mean_height(problem: Problem) -> bool:
    """Whether the potential tells the mean height: the curtain's own weight is the only load."""
    load = problem.scene.load
    others = load.edge or load.point or load.patch or load.bar or load.wind
    x, y, z = load.acceleration
    is_down = x == z == 0.0 and y < 0.0
    return is_down and not others and bool(np.abs(problem.force).sum() > 0.0)


def interval_summary(level: Level) -> dict[str, Any]:
    """The interval of the answer and its parts: of the mean height in mm, or of the potential in N mm.

    The law's part is null where the law has no rows: then the interval is that of the law, not of the rings.
    """
    bounds, problem = level.bounds, level.solution.problem
    is_height = is_mean_height(problem)
    unit = "mm" if is_height else "N_mm"
    per = float(np.abs(problem.force).sum()) if is_height else 1.0
    low, high = bounds.lower, bounds.upper
    if is_height:
        high = level.solution.mean_height()
        low = high - bounds.gap / per
    law = bounds.law_part
    of = "mean height" if is_height else "potential, since other loads than the curtain's weight act"
    for_what = "this law: its rows are not known" if law is None else "the rings, between the laws inside and outside"
    return {
        f"{'mean_height' if is_height else 'potential'}_interval_{unit}": [low, high],
        f"law_part_{unit}": None if law is None else law / per,
        f"mesh_part_{unit}": (bounds.gap - (law or 0.0)) / per,
        "interval": f"of the {of}; holds for the continuous curtain and {for_what}",
    }


def write_series(folder: Path, steps: Sequence[CurtainSolution]) -> None:
    """curtain_0001.vtu and so on, one per load step, and curtain.pvd that lists them by the share of the load."""
    lines = []
    for number, solution in enumerate(steps, start=1):
        name = f"curtain_{number:04d}.vtu"
        write_vtu(folder / name, solution)
        lines.append(f'    <DataSet timestep="{number / len(steps):.9g}" part="0" file="{name}"/>')
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
    content = head + "\n".join(lines) + "\n  </Collection>\n</VTKFile>\n"
    write_text(folder / "curtain.pvd", content)


def corner_positions(solution: CurtainSolution) -> Array:
    """Deformed corners of the mesh (n_corners, d): nodal values, or for CR the mean over the cells at a corner."""
    mesh, disc = solution.problem.mesh.mesh, solution.problem.disc
    if disc.element != "CR":
        return solution.x[: mesh.p.shape[1]]
    middle = solution.x[disc.cell_dofs].mean(axis=1)
    X = mesh.p.T[mesh.t.T]
    F = disc.cell_mean(solution.F)
    at_corners = middle[:, None] + np.einsum("cij,ckj->cki", F, X - X.mean(axis=1, keepdims=True))
    return mean_at_corners(mesh.t.T, at_corners)


def write_vtu(path: Path, solution: CurtainSolution, extra: dict[str, Array] | None = None) -> None:
    """The curtain as VTU: displacement, forces of supports, strain, stress, line loads, taut or slack per cell.

    Points are those of the reference state, to be warped by `displacement_mm`; `direction_1` is a direction in the
    deformed state. `utilisation` is there where the strength of the rings is known. `extra` holds more cell
    data (n_cells, ...), such as an error map.
    """
    import meshio

    mesh, disc = solution.problem.mesh.mesh, solution.problem.disc
    values, direction = solution.principal()
    F = disc.cell_mean(solution.F)
    in_space = np.einsum("cij,cj->ci", F, direction)
    used = strength.utilisation(solution)
    cell_data: dict[str, Sequence[Array]] = {
        STRAIN: [disc.cell_mean(solution.E)],
        STRESS: [disc.cell_mean(solution.S)],
        LINE_LOAD_1: [values[:, 0]],
        LINE_LOAD_2: [values[:, 1]],
        DIRECTION_1: [padded(in_space)],
        STATE: [solution.state().astype(float)],
        **({} if used is None else {"utilisation": [used]}),
        **{name: [np.asarray(data)] for name, data in (extra or {}).items()},
    }
    document = meshio.Mesh(
        padded(mesh.p.T),
        [(VTU_CELLS[disc.element], counterclockwise(mesh.p.T, mesh.t.T))],
        point_data={
            DISPLACEMENT: padded(corner_positions(solution)) - padded(mesh.p.T),
            "support_force_N": padded(corner_forces(solution.problem, solution.reactions)),
            **(
                {}
                if solution.problem.walls is None
                else {"obstacle_force_N": padded(corner_forces(solution.problem, solution.pushes))}
            ),
        },
        cell_data=cell_data,
    )
    write_whole(path, lambda temporary: document.write(temporary, file_format="vtu"))


def corner_forces(problem: Problem, forces: Array) -> Array:
    """Nodal forces (n_nodes, d) at the corners of the mesh (n_corners, d), with the same sum and moment.

    A force at the middle of a side or cell is shared equally between its corners.
    """
    mesh = problem.mesh.mesh
    tree = cKDTree(problem.disc.nodes)
    result = np.zeros((mesh.p.shape[1], forces.shape[1]))
    left = forces.copy()
    for groups in (np.arange(mesh.p.shape[1])[None], mesh.facets, mesh.t):  # each of shape (corners, number)
        distance, node = tree.query(mesh.p[:, groups].mean(axis=1).T)
        here = distance < 1e-9 * problem.mesh.size
        for corners in groups[:, here]:
            np.add.at(result, corners, left[node[here]] / len(groups))
        left[node[here]] = 0.0
    return result
