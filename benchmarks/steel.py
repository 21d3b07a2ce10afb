"""Curtains of the examples in steel: what the rings give, and how their utilisation converges with the mesh.

The rings are those of the shipped law, r1 = 5 mm, r2 = 0.5 mm, S235 where a scene names no other material.
"""

from dataclasses import replace
from math import log2
from typing import Any

import numpy as np

from benchmarks.frame import Section, table
from benchmarks.measure import ROOT, Row
from homogenize import default_law, with_material
from homogenize.laws import PolyhedralLaw, constant_compliance
from macro_fem import Scene, load_scene, solve
from macro_fem.curtain import CurtainSolution, make_problem, solve_problem
from macro_fem.fem import signed_areas
from macro_fem.judged import judge_strength, utilisation
from macro_fem.scene.meshing.mesh import CurtainMesh, refine
from rve.common import trace

EXAMPLES = ["corner_hung", "facade_panel", "facade_wind", "gathered_with_bar", "over_the_edge", "passage"]
EXAMPLES += ["round_net", "shop_counter", "shop_front", "shoulder", "to_the_floor", "turned_weave"]
SIDES = (6.0, 3.0, 1.5)
"""Sides in mm of the finest cells: half, a quarter and an eighth of the side of the averaging area."""
HIGH = 0.7
"""Cells are refined where the utilisation is above this part of the largest average, and at its place."""
REACH = 40.0
"""How far from the place of the largest utilisation cells are refined, mm: more than three sides of an average."""
HALVINGS = 2
"""How often cells are halved before the curtain is solved again."""
COARSE = 0.5
"""Cells of the mesh to begin with over those of the example."""
ELASTIC_AT = 0.25
"""Cells of the meshes of elastic curtains over those of the example."""
FEWEST = 6
FINE = ("corner_hung", "facade_wind")
"""Examples whose mesh is refined in the short form."""
TEXT = (
    "The first table has curtains on even meshes with a quarter of the cells of the scenes, and changes of the mean "
    "height against the rigid one. The second has the utilisation of rigid ones, which is that of the line load "
    "averaged over one cell of the weave, 139 mm2: on the mesh of the scene, and refined where it is largest, to "
    "finest cells as small as the head says. Utilisation is 1 at first yield. Force at a point: capacity of the rings "
    "under the hook, on the mesh of the scene; the utilisation that a run prints is the larger one of both."
)


def with_one_compliance() -> PolyhedralLaw:
    """The shipped law with the one compliance that fits that of its rings best, for all directions."""
    law = default_law()
    assert isinstance(law, PolyhedralLaw)
    assert law.strength is not None
    known = law.strength.stretched
    fitted = constant_compliance(known.S, known.compliance, known.is_mirrored)
    return replace(law, stiffness=np.linalg.inv(fitted), strength=None)


def scene_of(name: str, part: float, kind: str = "rigid") -> Scene:
    """An example with `part` of its cells, without bounds."""
    scene = load_scene(ROOT / "examples" / f"{name}.toml")
    cells = max(FEWEST, round(part * scene.mesh.cells))
    solver = replace(scene.solver, kind=kind, bounds=False, adapt=0)
    return replace(scene, mesh=replace(scene.mesh, cells=cells), solver=solver)


def solved(name: str, part: float, kind: str = "rigid", law: Any = None) -> CurtainSolution:
    """The curtain at full load; with a `law` of another stiffness without the scene's material, which changes none."""
    scene = scene_of(name, part, kind)
    return solve(scene if law is None else replace(scene, material=()), law).solution


def giving_row(name: str) -> Row:
    """How far the three answers of one example are apart."""
    rigid, by_direction = (solved(name, ELASTIC_AT, kind) for kind in ("rigid", "elastic"))
    constant = solved(name, ELASTIC_AT, "elastic", with_one_compliance())
    S = by_direction.problem.disc.cell_mean(by_direction.S)
    others = {"constant": constant, "by direction": by_direction}
    return {
        "example": name,
        "cells": rigid.problem.disc.n_cells,
        "status": ", ".join(sorted({one.status for one in (rigid, constant, by_direction)})),
        "largest line load, N/mm": float(trace(S).max()),
        "mean height rigid, mm": rigid.mean_height(),
        **{f"{name}, mm": one.mean_height() - rigid.mean_height() for name, one in others.items()},
        **{f"farthest node, {name}, mm": farthest(one, rigid) for name, one in others.items()},
        "farthest node, constant to by direction, mm": farthest(constant, by_direction),
    }


def farthest(one: CurtainSolution, other: CurtainSolution) -> float:
    """The largest distance in mm of a node between two answers."""
    return float(np.linalg.norm(one.x - other.x, axis=1).max())


def refined(scene: Scene, mesh: CurtainMesh, side: float, place: Any = None) -> CurtainSolution:
    """The rigid curtain on a mesh whose cells are `side` mm small at a place (2,) in mm of the reference state, by
    default where the rings' utilisation is largest."""
    law = with_material(default_law(), dict(scene.material), scene.source)
    while True:
        found = solve_problem(make_problem(scene, law, mesh))
        told, used = judge_strength(found), utilisation(found)
        assert used is not None
        at = np.array(told.utilisation_max_at_mm if place is None else place)
        distance = np.linalg.norm(mesh.mesh.p - at[:, None], axis=0)[mesh.mesh.t]
        high = (used > HIGH * told.utilisation_of_averages_max) & (distance.min(axis=0) < REACH)
        high |= distance.min(axis=0) <= distance.min()
        which, finer = mesh.mesh.element_finder(), mesh
        for _ in range(HALVINGS):
            middle = finer.mesh.p[:, finer.mesh.t].mean(axis=1)
            area = np.abs(signed_areas(finer.mesh.p.T[finer.mesh.t.T]))
            where = np.flatnonzero(high[which(*middle)] & (area > side**2))
            finer = refine(finer, where) if len(where) else finer
        if finer is mesh:
            return found
        mesh = finer


def utilisation_row(name: str) -> Row:
    """Utilisation of the example's own mesh and of ever finer ones, and the order that their differences show."""
    scene = scene_of(name, 1.0)
    own = solved(name, 1.0)
    cells = float(np.sqrt(own.problem.disc.cell_area.mean()))
    finest: list[CurtainSolution] = []
    mesh, known = solved(name, COARSE).problem.mesh, judge_strength(own)
    # The force at a hook hardly depends on the mesh: the worst hook stays the worst one.
    is_force = known.utilisation_of_point_forces_max > known.utilisation_of_averages_max
    for side in SIDES:
        finest.append(refined(scene, mesh, side, known.utilisation_max_at_mm if is_force else None))
        mesh = finest[-1].problem.mesh
    values = [judge_strength(one) for one in finest]
    used = [float(one.utilisation_of_averages_max) for one in values]
    pointwise = [one.utilisation_pointwise_max for one in values]
    first, last = used[-2] - used[-3], used[-1] - used[-2]
    return {
        "example": name,
        **{"side of its cells, mm": cells, "status": ", ".join(sorted({one.status for one in (own, *finest)}))},
        "its own mesh": float(known.utilisation_of_averages_max),
        "its own mesh, force at a point": known.utilisation_of_point_forces_max or None,
        "its own mesh, told too coarse": bool(known.utilisation_too_low),
        **{f"{side:g} mm": value for side, value in zip(SIDES, used, strict=True)},
        "order": log2(abs(first / last)) if first * last > 0.0 else None,
        **{"last change": last / used[-1], "safety factor": 1.0 / used[-1], "near": values[-1].first_yield_near},
        **{"pointwise": float(pointwise[-1]), "pointwise, last change": 1.0 - pointwise[-2] / pointwise[-1]},
        "cells": finest[-1].problem.disc.n_cells,
    }


def measure(full: bool) -> Section:
    """Both tables; the second one of all examples if `full`, hours."""
    apart = [giving_row(name) for name in EXAMPLES]
    fine = [utilisation_row(name) for name in (EXAMPLES if full else FINE)]
    lengths = dict.fromkeys((key for key in apart[0] if key.endswith(", mm")), ".3f")
    lengths |= {"largest line load, N/mm": ".3g"}
    changes = {"order": ".2f", "last change": ".1%", "pointwise, last change": ".0%"}
    tables = (table("Rigid and elastic rings", apart, lengths), table("Utilisation over the mesh", fine, changes))
    return Section("Steel", TEXT, tables)
