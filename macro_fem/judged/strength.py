"""Whether a curtain holds: the utilisation of its rings, averaged over one cell of the weave, and at points.

Averaged is S, the second Piola line load, at whose locked strain a law states its strength: it is symmetric, stays as
it is when a cell turns, and needs no inverse of F, which a mesh drawn to a line has not.

A force f at a point grows hardly with the mesh, and the direction m (reference) along which it is taken up neither.
Where cells there are too large for the average, balance of every section across m gives instead

    S = f / (w lambda) m m^T,

with lambda the stretch along m at which rings lock, and w the area of an average over the longest chord along the line
from the point. It is the largest average of the continuous curtain if all of f goes along that line, more if f fans out
(up to 1.4-fold at a square corner, 2-fold at an edge): an estimate, no bound, as rings are weaker along other lines.
"""

import math
from collections.abc import Callable
from dataclasses import fields

import numpy as np
import shapely

from homogenize.laws import Strength, strength_of_law
from macro_fem.curtain import CurtainState
from macro_fem.fem.hung_law import HungLaw, largest_stretch
from macro_fem.judged.forces import TOUCHES, PointForce, first_of_largest, point_forces, spot_loads
from macro_fem.judged.line_load import FINE, Extreme, Nearby, disks_of
from macro_fem.scene.shapes import MeshFile
from macro_fem.scene.tables import Bar, EdgeLoad
from macro_fem.summary import RingStrength, Utilisation
from rve import pulled_ring
from rve.common import Array, InputError, digits
from rve.common.plugins import plugin_of
from rve.common.tensor import dyad, eigenvalues
from rve.geometry import CellInfo

EVEN = 1.05
"""Pointwise utilisations this many times the average over `WIDER` mesh cells at the place vary over these cells."""
WIDER = 3.0
"""Side of that average in sides of mesh cells. On meshes 1.5 to 20 times too coarse at holes, notches and held ends the
ratio is 1.08 to 1.9, under even loads at most 1.01; with 2 it is 1.03 at some notches."""
RESOLVED = 0.125
"""Sides of mesh cells at a point over that of the averaging area with which the averages themselves are used."""
SHARPEST = np.pi / 6.0
"""Angle of a corner in which averages reach farthest; bounds their chord, so that few points are looked at."""
NONE = Extreme(0.0, np.full(2, np.nan))
UNLOADED = 1e-9
"""Utilisations up to which nothing is loaded: rounding leaves 1e-12 of a curtain without load."""
TOO_COARSE = (
    "the mesh is too coarse at {}: triangles there have sides of some {} mm, and the factor of the rings falls with "
    "refinement until they have at most {} mm{}"
)
EXTRAPOLATED = (
    "the table behind the law has no loads around those of {} of {} triangles, which are judged by the nearest it has: "
    "make the table of more directions"
)
LOADED = 0.25
"""Share of the largest utilisation up to which a wrong one may govern: one off the table was 0.31 of the true."""
MEANING = (
    "utilisation_max is that of the line load averaged over one cell of the weave, or of the force at a held or loaded "
    "point over the width of that average where the mesh is too coarse there, or of the ring that takes that force; "
    "utilisation_pointwise_max grows with every refinement of the mesh at held and loaded points; "
    "utilisation_too_low says why it may be larger; solved ring by ring, rings next to hooks "
    "bear 0.9 to 1.5 times these values, 1.1 on average: allow for 1.5"
)


def judge_strength(solution: CurtainState) -> RingStrength:
    """Utilisation, factors, place and material; None, with a reason, where they are not known."""
    law = solution.problem.law
    known, by = strength_of_law(law.own), judged_by(law)
    if isinstance(by, str):
        found = Utilisation(**dict.fromkeys(one.name for one in fields(Utilisation)))
    else:
        found, by = _utilisation(solution, *by), MEANING
    return RingStrength(
        **found.parts(),
        ring_material=None if known is None else known.material.name,
        ring_yield_N_per_mm2=None if known is None else known.material.yield_N_per_mm2,
        material=None if known is None else known.material,
        ring_joint=None if known is None else known.joint,
        strength_note=by,
    )


def _utilisation(solution: CurtainState, known: Strength, cell: CellInfo) -> Utilisation:
    """Where the strength is known, by what first yield and collapse ask of mesh and rings."""
    near, first, last = _largest_asked(solution, known, cell)
    mean, points, hook = first
    pointwise = known.utilisation(near.P)
    most, collapse = (max(each, key=lambda one: one.value) for each in (first, last))
    off = int(known.extrapolates(near.P[pointwise > max(LOADED * most.value, UNLOADED)]).sum())
    too_low = [_too_coarse(solution, near, known, mean, float(pointwise.max()))] * bool(points.value <= mean.value)
    too_low += [EXTRAPOLATED.format(off, len(near.P))] * bool(off)
    name, distance = nearest(solution, most.at) if most.force is None else (most.force.name, 0.0)
    is_loaded = most.value > UNLOADED
    return Utilisation(
        utilisation_max=most.value,
        utilisation_max_at_mm=most.at.tolist(),
        utilisation_pointwise_max=float(pointwise.max()),
        utilisation_of_averages_max=mean.value,
        utilisation_of_point_forces_max=points.value,
        utilisation_of_hook_rings_max=hook.value,
        ring_at_hook=f"ring at {hook.force.place}" if hook.force else None,
        utilisation_too_low="; ".join(filter(None, too_low)) or None,
        safety_factor=1.0 / most.value if is_loaded else None,
        collapse_factor=1.0 / collapse.value if is_loaded else None,
        first_yield_near=name if is_loaded else None,
        first_yield_distance_mm=distance if is_loaded else None,
    )


def _too_coarse(solution: CurtainState, near: Nearby, known: Strength, mean: Extreme, pointwise: float) -> str | None:
    """Which mesh is needed at the largest average, where it lies in cells too large for it and not evenly loaded."""
    (side, largest), needed = near.sides(mean.at), FINE * float(np.sqrt(near.area))
    wide = float(known.utilisation(near.mean(mean.at, (WIDER * side) ** 2)[None])[0])
    if side <= needed or pointwise <= max(EVEN * wide, UNLOADED):
        return None
    spec = solution.problem.scene
    cells = math.ceil(spec.mesh.cells * largest / needed)  # meshes of more cells are as uneven
    more = "; make the mesh file finer there" if isinstance(spec.curtain, MeshFile) else f", as with cells = {cells}"
    return TOO_COARSE.format(nearest(solution, mean.at)[0], digits(side), digits(needed), more)


def judged_by(law: HungLaw) -> tuple[Strength, CellInfo] | str:
    """The strength and the cell by which a curtain of a law is judged; where its utilisation is not known, why."""
    known = strength_of_law(law.own)
    if known is None and law.cell is None:
        return "the law has no rings that bear the loads"
    if known is None and (plugin := plugin_of(type(law.own))) is not None:
        return f"a law of the plugin {plugin} does not tell it"
    if known is None:
        return (
            "the law was made without it: make its table with rve table --rings, in Python with rve.with_rings, and "
            "fit it again"
        )
    if known.material.yield_N_per_mm2 is None:
        return f"{known.material.name} has no yield stress: make the table with rve table --rings --yield"
    try:
        known.utilisation(np.array([[0.5, 0.0, 0.5]]))
    except InputError as error:  # too few loads, or on one side
        return f"{error}: make its table of more loads"
    return "the law has no cell to average the line load over" if law.cell is None else (known, law.cell)


def utilisation(solution: CurtainState) -> Array | None:
    """Utilisation of the rings of each cell (n_cells,), averaged over neighbours as S is; None if it is not known."""
    law = solution.problem.law
    by = judged_by(law)
    return None if isinstance(by, str) else by[0].utilisation(law.in_weave(solution.recovered(solution.S)))


def collapse_at_points(solution: CurtainState) -> float | None:
    """The factor at which a ring at a held or loaded point collapses, or the mesh there by `largest_borne` where cells
    are too large to tell; None where nothing bears there, or it is not known."""
    by = judged_by(solution.problem.law)
    if isinstance(by, str):
        return None
    _, points, ring = _largest_asked(solution, *by)[2]
    most = max(points.value, ring.value)
    return 1.0 / most if most > UNLOADED else None


def critical_load(solution: CurtainState) -> Array | None:
    """S (3,) in the frame of the weave where the utilisation of the mesh is largest; None where it is not known."""
    by = judged_by(solution.problem.law)
    if isinstance(by, str):
        return None
    mean, points, _ = _largest_asked(solution, *by)[1]
    return max(mean, points, key=lambda one: one.value).load


def largest_utilisation(solution: CurtainState) -> float | None:
    """The largest utilisation at first yield, of the mesh and of rings at points; None where it is not known."""
    by = judged_by(solution.problem.law)
    if isinstance(by, str):
        return None
    return max(one.value for one in _largest_asked(solution, *by, collapse=False)[1])


def _largest_asked(
    solution: CurtainState, known: Strength, cell: CellInfo, *, collapse: bool = True
) -> tuple[Nearby, tuple[Extreme, ...], tuple[Extreme, ...]]:
    """Averages of S over one cell of the weave; extreme utilisations by them, by forces at points, and of the rings
    there, at first yield and, if asked for, at collapse."""
    own = solution.recovered(solution.S)
    S = solution.problem.law.in_weave(own)
    # Utilisation is the tensile trace over a weighted mean of strengths, and the trace is convex in S.
    trace = np.maximum(eigenvalues(S), 0.0).sum(axis=0)
    near = Nearby(disks_of(solution.problem.mesh, cell.b_x_mm * cell.b_y_mm), S, trace)
    first, last = hook_rings(solution, known, cell)

    def asked(value: Callable[[Array], Array], strengths: Array, ring: Extreme) -> tuple[Extreme, ...]:
        most = float(strengths.max()) / known.yield_stress()
        return near.largest(value, most), largest_borne(solution, near, own, value, most), ring

    at_yield = asked(known.utilisation, known.first_yield, first)
    return near, at_yield, asked(known.collapse_utilisation, known.collapse, last) if collapse else ()


def nearest(solution: CurtainState, at: Array) -> tuple[str, float]:
    """The support, load, obstacle, hole or edge nearest to a place `at` (2,) of the reference state, as "hole 1", and
    its distance there, mm; of equal distances the first in this order."""
    problem, mesh = solution.problem, solution.problem.mesh
    nodes, scene, edges = problem.disc.nodes, problem.scene, dict(mesh.edges)
    parts = {
        f"support {held.number + 1} ({held.name})": shapely.points(nodes[held.nodes]) for held in problem.supports.held
    }
    parts |= {name: shapely.points([load.at]) for name, load in spot_loads(scene)}
    loads: list[tuple[int, EdgeLoad | Bar]] = [*enumerate(scene.of(EdgeLoad), 1), *enumerate(scene.of(Bar), 1)]
    line = {name: shapely.linestrings(mesh.mesh.p.T[mesh.mesh.facets[:, of].T]) for name, of in edges.items()}
    parts |= {f"load.{one.kind} {n} ({one.edge})": line[one.edge] for n, one in loads}
    for one, push in zip(solution.obstacles, solution.pushed, strict=True):
        touched = np.linalg.norm(push, axis=1) > TOUCHES * float(np.abs(problem.force).sum())
        which = f"obstacle {one.number + 1}" if one.number >= 0 else "body"
        parts[f"{which} ({one.obstacle.name})"] = shapely.points(nodes[touched])
    parts |= {name: line[name] for name in line if name.startswith("hole ")}
    sides = [name for name in line if name != "outline" and not name.startswith("hole")]
    parts |= {f"edge {name}": line[name] for name in (*sides, "outline")}
    away = {name: float(shapely.distance(part, shapely.Point(at)).min(initial=np.inf)) for name, part in parts.items()}
    name = min(away, key=lambda name: round(away[name] / (1e-6 * mesh.size)) if away[name] < np.inf else np.inf)
    return name, away[name]


def hook_rings(solution: CurtainState, known: Strength, cell: CellInfo) -> list[Extreme]:
    """Utilisations at first yield and at collapse of the ring that bears most at a held or loaded point; 0 without any.

    Each of the rings there is pulled by two opposed forces, its share of the force and that of its neighbours
    (`rve.pulled_ring`). A butted ring turns on its hook, so its joint is where it is worst.
    """
    points = [one for one in point_forces(solution) if one.rings]
    if not points:
        return [NONE, NONE]
    each = [one.force / one.rings for one in points]
    most = points[first_of_largest(each)]
    return [Extreme(max(each) / limit, most.at, force=most) for limit in _limits_of_ring(known, cell)]


def _limits_of_ring(known: Strength, cell: CellInfo) -> tuple[float, float]:
    """The force in N with which a ring between two opposed forces yields, and with which it collapses."""
    joint = "welded" if known.joint == "welded" else "butted:worst"
    ring = pulled_ring(cell.r1_mm, cell.r2_mm, known.material, joint)
    return ring.first_yield_N, ring.collapse_N


def rings_at_points(solution: CurtainState) -> tuple[Array, Array]:
    """Places (k, 2) of rings that bear forces at points, as the curtain hangs, mm, and their utilisations (k,); none
    where the strength is not known."""
    by, nodes = judged_by(solution.problem.law), solution.problem.disc.nodes
    points = [one for one in point_forces(solution) if one.rings and not isinstance(by, str)]
    at = [np.linalg.norm(nodes - one.at, axis=1).argmin() for one in points]
    used = [one.force / one.rings / _limits_of_ring(*by)[0] for one in points if not isinstance(by, str)]
    return solution.x[np.array(at, int), :2], np.array(used)


def largest_borne(
    solution: CurtainState, near: Nearby, S: Array, value: Callable[[Array], Array], most: float
) -> Extreme:
    """The largest value that any force at a point asks for, where the mesh is too coarse to tell; 0 without any.

    `near`: averages of the line loads S (n_cells, 3) of the curtain in its own frame; `value` (n,) of line loads (n, 3)
    in the frame of the weave, at most `most` times their trace.
    """
    law, best = solution.problem.law, NONE
    longest = 2.0 * np.sqrt(2.0 * near.area / SHARPEST)
    for one in sorted(point_forces(solution), key=lambda one: -one.force):
        if one.force * longest / near.area * most <= best.value:
            break
        cells = _cells_at(solution, one)
        side = float(np.sqrt(solution.problem.disc.cell_area[cells].max()))
        m = _direction(solution, S, cells, one.at)
        if m is None or side <= RESOLVED * max(np.sqrt(near.area), one.spread):
            continue
        width = max(near.area / near.chord(one.at, m), one.spread)
        load = law.in_weave(one.force / (width * float(largest_stretch(law, m[None])[0])) * dyad(m[None]))
        found = float(value(load)[0])
        best = Extreme(found, one.at, load[0], one) if found > best.value else best
    return best


def _cells_at(solution: CurtainState, one: PointForce) -> np.ndarray:
    """Numbers of the mesh cells that touch a point, or whose corners lie in its patch; the nearest one if none do."""
    mesh = solution.problem.mesh
    distance = np.linalg.norm(mesh.mesh.p - one.at[:, None], axis=0)
    near = max(0.5 * one.spread, float(distance.min())) + 1e-9 * mesh.size
    return np.flatnonzero((distance[mesh.mesh.t] <= near).any(axis=0))


def _direction(solution: CurtainState, S: Array, cells: np.ndarray, at: Array) -> Array | None:
    """The reference direction (2,) of the larger principal line load of some cells, into the curtain; None if slack."""
    mesh, area = solution.problem.mesh.mesh, solution.problem.disc.cell_area[cells]
    S11, S12, S22 = area @ S[cells] / area.sum()
    if not np.hypot(S11 - S22, 2.0 * S12) + S11 + S22 > 0.0:
        return None
    angle = 0.5 * np.arctan2(2.0 * S12, S11 - S22)
    m = np.array([np.cos(angle), np.sin(angle)])
    inwards = area @ mesh.p[:, mesh.t[:, cells]].mean(axis=1).T / area.sum() - at
    return m if inwards @ m >= 0.0 else -m
