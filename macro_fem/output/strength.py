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

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from homogenize import Strength, strength_of_law
from macro_fem.fem.hung_law import HungLaw
from macro_fem.output.line_load import FINE, LineLoad, Nearby, largest_average, on_triangles
from macro_fem.output.point_force import Borne, HookRing, hook_ring, largest_borne
from macro_fem.scene.sites import edge_nodes
from macro_fem.scene.tables import Bar, EdgeLoad, PatchLoad, PointLoad
from macro_fem.solution import CurtainSolution
from rve.common.tensor import eigenvalues
from rve.common.types import Array

EVEN = 1.05
"""Pointwise utilisations this many times the largest average vary over a cell of the weave."""
KEYS = (
    "utilisation_max",
    "utilisation_max_at_mm",
    "utilisation_of_averages_max",
    "utilisation_of_point_forces_max",
    "utilisation_of_hook_rings_max",
    "ring_at_hook",
    "utilisation_mesh_too_coarse",
    "safety_factor",
    "collapse_factor",
    "first_yield_near",
)
"""Keys of summary.json that are null where the strength is not known."""


def summary(solution: CurtainSolution) -> dict[str, Any]:
    """Utilisation, factors, place and material for summary.json; None, with a reason, where they are not known."""
    law = solution.problem.law
    known, why, cell = strength(law), reason(law), law.cell
    found: dict[str, Any] = dict.fromkeys(KEYS)
    used = utilisation(solution)
    if used is not None and known is not None and cell is not None:
        first, last = _largest_asked(solution, known, cell.b_x_mm * cell.b_y_mm)
        found = _numbers(solution, first, last, hook_ring(solution, known), float(used.max()))
        why = (
            "utilisation_max is that of the line load averaged over one cell of the weave, or of the force at a held "
            "or loaded point over the width of that average where the mesh is too coarse there, or of the ring that "
            "takes that force; "
            "utilisation_pointwise_max grows with every refinement of the mesh at held and loaded points; "
            "utilisation_mesh_too_coarse says when the mesh is too coarse for both"
        )
    return found | {
        "utilisation_pointwise_max": None if used is None else float(used.max()),
        "ring_material": None if known is None else known.material.name,
        "ring_yield_N_per_mm2": None if known is None else known.material.yield_N_per_mm2,
        "material": None if known is None else asdict(known.material),
        "ring_joint": None if known is None else known.joint,
        "strength_note": why,
    }


@dataclass(frozen=True)
class MostAsked:
    """What is asked of the rings: the largest of the `averages`, and of the forces at `points`."""

    averages: LineLoad
    points: Borne

    @property
    def value(self) -> float:
        """The larger one."""
        return max(self.averages.value, self.points.value)

    @property
    def is_force(self) -> bool:
        """Whether a force at a point asks for more than any average."""
        return self.points.value > self.averages.value

    @property
    def at(self) -> Array:
        """Where it is (2,), mm, in the reference state."""
        return self.points.force.at if self.is_force and self.points.force is not None else self.averages.at


def _numbers(
    solution: CurtainSolution, first: MostAsked, last: MostAsked, ring: HookRing, pointwise: float
) -> dict[str, Any]:
    """The values of `KEYS` where the strength is known, from what first yield and collapse ask of mesh and `ring`."""
    mean, cell = first.averages, solution.problem.law.cell
    side = 0.0 if cell is None else np.sqrt(cell.b_x_mm * cell.b_y_mm)
    is_coarse = _side(solution, mean.at) > FINE * side and pointwise > EVEN * mean.value
    force = first.points.force if first.is_force else None
    most, collapse, at = max(first.value, ring.value), max(last.value, ring.collapse), first.at
    if ring.force is not None and ring.value >= first.value:
        force, at = ring.force, ring.force.at
    near = nearest(solution, at) if force is None else force.name
    return {
        "utilisation_max": most,
        "utilisation_max_at_mm": at.tolist(),
        "utilisation_of_averages_max": mean.value,
        "utilisation_of_point_forces_max": first.points.value,
        "utilisation_of_hook_rings_max": ring.value,
        "ring_at_hook": None if ring.force is None else f"ring at {ring.force.place}",
        "utilisation_mesh_too_coarse": bool(is_coarse and not first.is_force),
        "safety_factor": 1.0 / most if most > 0.0 else None,
        "collapse_factor": 1.0 / collapse if collapse > 0.0 else None,
        "first_yield_near": near if most > 0.0 else None,
    }


def strength(law: HungLaw) -> Strength | None:
    """The strength of the rings behind the law of a problem, in the frame of the weave; None if it has none."""
    return strength_of_law(law.own)


def reason(law: HungLaw) -> str | None:
    """Why the utilisation under a law is not known; None if it is."""
    known = strength(law)
    if known is None:
        return "the law was made without it: make its table with rve table --rings and fit it again"
    if known.material.yield_N_per_mm2 is None:
        return f"{known.material.name} has no yield stress: make the table with rve table --rings --yield"
    return None if law.cell is not None else "the law has no cell to average the line load over"


def utilisation(solution: CurtainSolution) -> Array | None:
    """Utilisation of the rings of each cell (n_cells,), averaged over neighbours as S is; None if it is not known."""
    law = solution.problem.law
    known = strength(law)
    return None if known is None or reason(law) is not None else known.utilisation(_loads(solution))


def _side(solution: CurtainSolution, at: Array) -> float:
    """Side in mm of the largest mesh cell with a corner at a place (2,) of the reference state."""
    mesh = solution.problem.mesh.mesh
    away = np.abs(mesh.p[:, mesh.t] - at[:, None, None]).max(axis=0)
    touching = (away < 1e-9 * solution.problem.mesh.size).any(axis=0)
    return float(np.sqrt(solution.problem.disc.cell_area[touching].max()))


def critical_load(solution: CurtainSolution) -> Array | None:
    """S (3,) in the frame of the weave, averaged over one cell where the utilisation is largest; None without any."""
    law = solution.problem.law
    known, cell = strength(law), law.cell
    if known is None or cell is None or reason(law) is not None:
        return None
    area = cell.b_x_mm * cell.b_y_mm
    first, _ = _largest_asked(solution, known, area)
    if first.is_force:
        return first.points.S
    if not first.value > 0.0:
        return None
    corners, S = on_triangles(solution, _loads(solution))
    return Nearby(corners, S, area, np.ones(len(S))).mean(first.at)


def _loads(solution: CurtainSolution) -> Array:
    """S (n_cells, 3) in the frame of the weave, averaged over neighbours."""
    return solution.problem.law.in_weave(_own_loads(solution))


def _own_loads(solution: CurtainSolution) -> Array:
    """S (n_cells, 3) in the frame of the curtain, averaged over neighbours."""
    return solution.recovered(solution.problem.disc.cell_mean(solution.S))


def _largest_asked(solution: CurtainSolution, known: Strength, area: float) -> tuple[MostAsked, MostAsked]:
    """Largest utilisation, and largest share of the collapse load: of S averaged over `area` mm2, and of forces."""
    corners, S = on_triangles(solution, _loads(solution))
    low, high = eigenvalues(S)
    near = Nearby(corners, S, area, np.maximum(low, 0.0) + np.maximum(high, 0.0))
    mesh = solution.problem.mesh.mesh
    X = mesh.p.T[np.unique(mesh.t)]
    # The tensile trace is convex, so that of an average is at most the largest; times the largest strength it bounds
    # the utilisation, whose values are weighted means of those strengths.
    trace, stress = near.bound(X), known.yield_stress()
    own = _own_loads(solution)

    def asked(value: Callable[[Array, float], Array], most: float) -> MostAsked:
        def of(S: Array) -> Array:
            return value(S, stress)

        return MostAsked(largest_average(near, X, trace * most, of), largest_borne(solution, near, own, of, most))

    return (
        asked(known.utilisation, float(known.first_yield.max()) / stress),
        asked(known.collapse_utilisation, float(known.collapse.max()) / stress),
    )


def nearest(solution: CurtainSolution, at: Array) -> str:
    """The name of the support or load next to a place `at` (2,) of the reference state: "support 1 (corners)"."""
    return min(_places(solution), key=lambda item: float(np.linalg.norm(item[1] - at, axis=1).min()))[0]


def _places(solution: CurtainSolution) -> Iterator[tuple[str, Array]]:
    """Names and places (k, 2) of supports and live loads."""
    problem = solution.problem
    nodes, scene = problem.disc.nodes, problem.scene
    for number, held in enumerate(problem.supports.held, 1):
        yield f"support {number} ({held.name})", nodes[held.nodes]
    at = [("point", number, one.at) for number, one in enumerate(scene.of(PointLoad), 1)]
    at += [("patch", number, one.at) for number, one in enumerate(scene.of(PatchLoad), 1)]
    for kind, number, place in at:
        yield f"load.{kind} {number}", np.array([place])
    edges = [("edge", number, one.edge) for number, one in enumerate(scene.of(EdgeLoad), 1)]
    edges += [("bar", number, one.edge) for number, one in enumerate(scene.of(Bar), 1)]
    for kind, number, name in edges:
        on_edge = edge_nodes(problem.mesh, problem.disc, name, f"{scene.source}: [load.{kind}] edge")
        yield f"load.{kind} {number} ({name})", nodes[on_edge]
