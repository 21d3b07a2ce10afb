"""Wind on the present shape: drag of layers on their front, pressure normal to the surface.

A cell that shows a wind the part v of its reference area is 1/v layers there. What the wind sees is cut into faces that
the same cells cover. The n layers of a face, the sum of those of its cells, take q C_D of its area, with C_D of n
layers (`macro_fem.scene.loads`) and q = rho v^2 / 2, and each cell its share of the layers. So the front is the union
of the cells, and the drag never more than that of a plate of its area.

Wind that follows presses along the vector area a = F_1 x F_2 per reference area: a pressure per present area, a speed
by its component along the normal, q C_D (a . w / |a|)^2, on 1/|a| layers and those before and behind them.
"""

from dataclasses import dataclass

import numpy as np
import shapely

from macro_fem.curtain import CurtainProblem, CurtainSolution
from macro_fem.fem.assembly import gradient
from macro_fem.fem.cells import counterclockwise, cross, recovered, signed_areas
from macro_fem.scene import loads
from macro_fem.scene.obstacles import unit
from macro_fem.scene.tables import Wind
from rve.common import Array
from rve.common.records import Index

LEAST_FRONT = 1e-9
"""Front per reference area below which it is none; overlap of two triangles, over the size, that counts."""
P2_PARTS = [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]
"""Triangles of the nodes of a quadratic cell."""


def wind_density(problem: CurtainProblem, x: Array) -> Array:
    """What winds press the points with (n_points, 3), N/mm2, on a shape with nodes at x (n_nodes, 3); InputError for
    pressure that follows and blows along the flat sheet."""
    disc, F = problem.disc, gradient(problem.disc, x)
    area, total = np.cross(F[:, :, 0], F[:, :, 1]), np.zeros((disc.n_points, 3))
    for wind in problem.winds:
        if wind.speed is None:
            total += _side(problem, wind) * problem.factor * loads.wind_pressure(wind, None) * area
        else:
            total += np.tile(problem.factor * _drag(problem, wind, x, area), (disc.n_quad, 1))
    return total


def _drag(problem: CurtainProblem, wind: Wind, x: Array, area: Array) -> Array:
    """What a wind with a speed presses cells with, (n_cells, 3), N/mm2, where `area` (n_points, 3) are vector areas.

    Averaged over neighbours, since slack cells fold in many ways.
    """
    disc, cell, along, q = problem.disc, problem.law.cell, unit(wind.direction), loads.dynamic_pressure(wind)
    front, corners = front_of(problem, x, along), problem.mesh.mesh.t.T
    if not wind.follows:
        n = front.layers(front.own)
        push = (q * front.area * loads.layered_drag(cell, n) / n)[front.face] * front.own
        density = np.bincount(front.cell, push, disc.n_cells) / disc.cell_area
        return np.asarray(recovered(corners, density, disc.cell_area)[:, None] * along)
    a = recovered(corners, disc.cell_mean(area), disc.cell_area)
    size, v = np.maximum(np.linalg.norm(a, axis=1), LEAST_FRONT), a @ along
    parts = front.area, front.area / front.layers(1.0 / size[front.cell])
    whole, shares = (np.bincount(front.cell, one[front.face], disc.n_cells) for one in parts)
    n = np.where(whole > 0.0, whole / np.where(whole > 0.0, shares, 1.0), 1.0 / size)
    push = q * loads.layered_drag(cell, n) / n * v * np.abs(v) / size**3
    return np.asarray(push[:, None] * a)


@dataclass(frozen=True, eq=False)
class Front:
    """What a wind sees of a shape: areas (m,) of faces in mm2; of each pair (k,) of a face and a cell that covers it
    their numbers, and how many layers the cell is there."""

    area: Array
    face: Index
    cell: Index
    own: Array

    def layers(self, each: Array) -> Array:
        """Layers (m,) of the faces, of `each` pair (k,)."""
        return np.asarray(np.bincount(self.face, each, len(self.area)), float)


def front_of(problem: CurtainProblem, x: Array, along: Array) -> Front:
    """The faces that a wind along a unit vector sees of a shape with nodes at x (n_nodes, 3)."""
    disc, parts = problem.disc, P2_PARTS if problem.disc.element == "P2" else [[0, 1, 2]]
    _, _, Vt = np.linalg.svd(along[None])
    points, cells = x @ Vt[1:].T, disc.cell_dofs[:, parts].reshape(-1, 3)
    area, owner = np.abs(signed_areas(points[cells])), np.repeat(np.arange(disc.n_cells), len(parts))
    whole = disc.cell_area[owner] / len(parts)
    seen = np.flatnonzero(area > LEAST_FRONT * whole)
    area, owner, own = area[seen], owner[seen], whole[seen] / area[seen]
    corners = points[counterclockwise(points, cells[seen])]
    least = LEAST_FRONT * problem.mesh.size
    overlaps = np.zeros(len(corners), bool)
    overlaps[overlapping(corners, least)] = True
    alone, met = np.flatnonzero(~overlaps), np.flatnonzero(overlaps)
    cut, face, cell = faces_of(corners[met], least)
    return Front(
        np.append(area[alone], cut),
        np.append(np.arange(len(alone)), len(alone) + face),
        np.append(owner[alone], owner[met[cell]]),
        np.append(own[alone], own[met[cell]]),
    )


def overlapping(corners: Array, least: float) -> Index:
    """Numbers of the triangles with counterclockwise corners (n, 3, 2) that overlap others by more than `least`, mm."""
    box = shapely.box(*corners.min(axis=1).T, *corners.max(axis=1).T)
    i, j = shapely.STRtree(box).query(box)
    i, j = i[i < j], j[i < j]
    edge = np.roll(corners, -1, axis=1) - corners
    edge /= np.linalg.norm(edge, axis=2)[:, :, None]
    for _ in range(2):  # no edge of one has all of the other on its outer side
        away = corners[j][:, None] - corners[i][:, :, None]
        apart = cross(edge[i][:, :, None], away).max(axis=2).min(axis=1) <= least
        i, j = j[~apart], i[~apart]
    return np.unique(np.append(i, j))


def faces_of(corners: Array, least: float) -> tuple[Array, Index, Index]:
    """Areas (m,) of the faces into which triangles (n, 3, 2) cut each other, and pairs of faces and the triangles that
    cover them; corners and crossings closer than `least` are one."""
    triangles = shapely.polygons(corners)
    lines = shapely.get_parts(shapely.union_all(shapely.boundary(triangles), grid_size=least))
    faces = shapely.get_parts(shapely.polygonize(lines))
    face, triangle = shapely.STRtree(triangles).query(shapely.point_on_surface(faces), predicate="intersects")
    covered, face = np.unique(face, return_inverse=True)  # without gaps between triangles
    return shapely.area(faces[covered]), face, triangle


def _side(problem: CurtainProblem, wind: Wind) -> float:
    """1 for pressure along F_1 x F_2 of the flat sheet, -1 against it; InputError for pressure that blows along it."""
    start = problem.scene.start
    axes = problem.frame.T if start is None else (unit(start.x_axis), unit(start.y_axis))
    along = float(np.cross(*axes) @ unit(wind.direction))
    if abs(along) < 1e-3:
        problem.scene.refuse(
            f"[load.wind] direction = {list(wind.direction)}: lies in the flat sheet, so that it tells no side for "
            "follows = true; lay the sheet across it by [start]"
        )
    return float(np.sign(along))


def wind_summary(solution: CurtainSolution) -> dict[str, list[dict[str, float]]]:
    """Drag of one flat layer in winds with a speed, and front, its mean layers and solidity, and drag of the shape."""
    problem, lines = solution.problem, []
    cell, reference = problem.law.cell, problem.disc.cell_area
    for wind in problem.scene.of(Wind):
        if wind.speed is None:
            continue
        assert cell is not None  # see `macro_fem.scene.loads.nodal_forces`
        along, area = unit(wind.direction), np.cross(solution.F[:, :, 0], solution.F[:, :, 1])
        front = max(float(front_of(problem, solution.x, along).area.sum()), LEAST_FRONT * float(reference.sum()))
        line = {
            "speed_m_per_s": wind.speed,
            "solidity": loads.ring_solidity(cell),
            "drag_coefficient": float(loads.layered_drag(cell, np.ones(1))[0]),
            "pressure_N_per_m2": loads.wind_pressure(wind, cell) / loads.PER_MM2,
            "front_area_m2": front * loads.PER_MM2,
            "layers": float(reference.sum() / front),
            "drag_N": float(reference @ (problem.factor * _drag(problem, wind, solution.x, area)) @ along),
        }
        lines.append(line)
    return {"wind": lines} if lines else {}
