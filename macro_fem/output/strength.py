"""Whether a curtain holds: the utilisation of its rings, averaged over one cell of the weave, and the load of hooks.

The strength of a law is a function of S, the second Piola line load, at the strain at which the rings lock under S; so
it holds for cells far from their reference. S and not P is averaged: S is symmetric, does not change when a cell turns,
and needs no inverse of F, which does not exist where the mesh is drawn to a line. An even load is its own average. At a
held or loaded point S grows as P does and so does the pointwise utilisation; the utilisation of the average converges
(`macro_fem.output.line_load`). Where the mesh is too coarse for the average at such a point, the utilisation is at
least that of the force there over the width of an average (`macro_fem.output.point_force`). All are in proportion to
the load as long as the shape stays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from homogenize import CellInfo, Strength, strength_of_law
from macro_fem.fem.hung_law import HungLaw
from macro_fem.output.line_load import FINE, Nearby, Peak, largest_average, on_triangles
from macro_fem.output.point_force import hook_rings, largest_borne
from macro_fem.scene.sites import edge_nodes
from macro_fem.scene.tables import Bar, EdgeLoad, PatchLoad, PointLoad
from macro_fem.solution import CurtainSolution
from rve.common.tensor import eigenvalues
from rve.common.types import Array

EVEN = 1.05
"""Pointwise utilisations this many times the largest average vary over a cell of the weave."""
KEYS = (
    *("utilisation_max", "utilisation_max_at_mm", "utilisation_of_averages_max", "utilisation_of_point_forces_max"),
    *("utilisation_of_hook_rings_max", "ring_at_hook", "utilisation_mesh_too_coarse"),
    *("safety_factor", "collapse_factor", "first_yield_near"),
)
"""Keys of summary.json that are null where the strength is not known."""
MEANING = (
    "utilisation_max is that of the line load averaged over one cell of the weave, or of the force at a held or loaded "
    "point over the width of that average where the mesh is too coarse there, or of the ring that takes that force; "
    "utilisation_pointwise_max grows with every refinement of the mesh at held and loaded points; "
    "utilisation_mesh_too_coarse says when the mesh is too coarse for both"
)


def summary(solution: CurtainSolution) -> dict[str, Any]:
    """Utilisation, factors, place and material for summary.json; None, with a reason, where they are not known."""
    law = solution.problem.law
    known, why, cell, used = strength_of_law(law.own), reason(law), law.cell, utilisation(solution)
    found: dict[str, Any] = dict.fromkeys(KEYS)
    if used is not None and known is not None and cell is not None:
        found, why = _numbers(solution, known, cell, float(used.max())), MEANING
    return found | {
        "utilisation_pointwise_max": None if used is None else float(used.max()),
        "ring_material": None if known is None else known.material.name,
        "ring_yield_N_per_mm2": None if known is None else known.material.yield_N_per_mm2,
        "material": None if known is None else asdict(known.material),
        "ring_joint": None if known is None else known.joint,
        "strength_note": why,
    }


def _numbers(solution: CurtainSolution, known: Strength, cell: CellInfo, pointwise: float) -> dict[str, Any]:
    """The values of `KEYS` where the strength is known, by what first yield and collapse ask of mesh and rings."""
    first, last = _largest_asked(solution, known, cell)
    hooks = hook_rings(solution, known)
    mean, points = first
    most = max(*hooks[:1], mean, points, key=lambda one: one.value)
    collapse = max(one.value for one in (*hooks[1:], *last))
    mesh, area = solution.problem.mesh.mesh, solution.problem.disc.cell_area
    touching = np.abs(mesh.p[:, mesh.t] - mean.at[:, None, None]).max(axis=0) < 1e-9 * solution.problem.mesh.size
    side = np.sqrt(area[touching.any(axis=0)].max() / (cell.b_x_mm * cell.b_y_mm))
    is_coarse = side > FINE and pointwise > EVEN * mean.value and points.value <= mean.value
    near = nearest(solution, most.at) if most.force is None else most.force.name
    return {
        "utilisation_max": most.value,
        "utilisation_max_at_mm": most.at.tolist(),
        "utilisation_of_averages_max": mean.value,
        "utilisation_of_point_forces_max": points.value,
        "utilisation_of_hook_rings_max": hooks[0].value if hooks else 0.0,
        "ring_at_hook": f"ring at {hooks[0].force.place}" if hooks and hooks[0].force else None,
        "utilisation_mesh_too_coarse": bool(is_coarse),
        "safety_factor": 1.0 / most.value if most.value > 0.0 else None,
        "collapse_factor": 1.0 / collapse if collapse > 0.0 else None,
        "first_yield_near": near if most.value > 0.0 else None,
    }


def reason(law: HungLaw) -> str | None:
    """Why the utilisation under a law is not known; None if it is."""
    known = strength_of_law(law.own)
    if known is None:
        return "the law was made without it: make its table with rve table --rings and fit it again"
    if known.material.yield_N_per_mm2 is None:
        return f"{known.material.name} has no yield stress: make the table with rve table --rings --yield"
    return None if law.cell is not None else "the law has no cell to average the line load over"


def utilisation(solution: CurtainSolution) -> Array | None:
    """Utilisation of the rings of each cell (n_cells,), averaged over neighbours as S is; None if it is not known."""
    law = solution.problem.law
    known = strength_of_law(law.own)
    return None if known is None or reason(law) else known.utilisation(law.in_weave(_loads(solution)))


def critical_load(solution: CurtainSolution) -> Array | None:
    """S (3,) in the frame of the weave, averaged over one cell where the utilisation is largest; None without any."""
    law = solution.problem.law
    known, cell = strength_of_law(law.own), law.cell
    if known is None or cell is None or reason(law):
        return None
    return max(_largest_asked(solution, known, cell)[0], key=lambda one: one.value).load


def _loads(solution: CurtainSolution) -> Array:
    """S (n_cells, 3) in the frame of the curtain, averaged over neighbours."""
    return solution.recovered(solution.problem.disc.cell_mean(solution.S))


def _largest_asked(solution: CurtainSolution, known: Strength, cell: CellInfo) -> list[tuple[Peak, Peak]]:
    """Peak utilisations of the mesh by S averaged over one cell of the weave and by forces at points, both at first
    yield and at collapse."""
    own = _loads(solution)
    corners, S = on_triangles(solution, solution.problem.law.in_weave(own))
    low, high = eigenvalues(S)
    near = Nearby(corners, S, cell.b_x_mm * cell.b_y_mm, np.maximum(low, 0.0) + np.maximum(high, 0.0))
    mesh = solution.problem.mesh.mesh
    X = mesh.p.T[np.unique(mesh.t)]
    # The tensile trace is convex, so that of an average is at most the largest; times the largest strength it bounds
    # the utilisation, whose values are weighted means of those strengths.
    trace = near.bound(X)

    def asked(value: Callable[[Array], Array], strengths: Array) -> tuple[Peak, Peak]:
        most = float(strengths.max()) / known.yield_stress()
        return largest_average(near, X, trace * most, value), largest_borne(solution, near, own, value, most)

    return [asked(known.utilisation, known.first_yield), asked(known.collapse_utilisation, known.collapse)]


def nearest(solution: CurtainSolution, at: Array) -> str:
    """The name of the support or load next to a place `at` (2,) of the reference state: "support 1 (corners)"."""
    problem = solution.problem
    nodes, scene = problem.disc.nodes, problem.scene
    places = {f"support {n} ({held.name})": nodes[held.nodes] for n, held in enumerate(problem.supports.held, 1)}
    spots: tuple[type[PointLoad | PatchLoad], ...] = (PointLoad, PatchLoad)
    edges: tuple[type[EdgeLoad | Bar], ...] = (EdgeLoad, Bar)
    for spot in spots:
        places |= {f"load.{spot.kind} {n}": np.array([one.at]) for n, one in enumerate(scene.of(spot), 1)}
    for along in edges:
        for n, one in enumerate(scene.of(along), 1):
            on_edge = edge_nodes(problem.mesh, problem.disc, one.edge, f"{scene.source}: {one.where} edge")
            places[f"load.{along.kind} {n} ({one.edge})"] = nodes[on_edge]
    return min(places, key=lambda name: float(np.linalg.norm(places[name] - at, axis=1).min()))
