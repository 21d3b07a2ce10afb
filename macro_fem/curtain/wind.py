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

from macro_fem.curtain.problem import CurtainProblem
from macro_fem.curtain.solution import CurtainSolution
from macro_fem.fem.assembly import gradient
from macro_fem.fem.cells import counterclockwise, cross, recovered, signed_areas
from macro_fem.scene import loads
from macro_fem.scene.obstacles import unit
from macro_fem.scene.tables import Wind
from macro_fem.summary import WindDrag
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


def wind_drags(solution: CurtainSolution) -> tuple[WindDrag, ...]:
    """Drag of one flat layer in winds with a speed, and front, its mean layers and solidity, and drag of the shape."""
    problem, lines = solution.problem, []
    cell, reference = problem.law.cell, problem.disc.cell_area
    for wind in problem.scene.of(Wind):
        if wind.speed is None:
            continue
        assert cell is not None  # see `macro_fem.scene.loads.nodal_forces`
        along, area = unit(wind.direction), np.cross(solution.F[:, :, 0], solution.F[:, :, 1])
        front = max(float(front_of(problem, solution.x, along).area.sum()), LEAST_FRONT * float(reference.sum()))
        line = WindDrag(
            speed_m_per_s=wind.speed,
            solidity=loads.ring_solidity(cell),
            drag_coefficient=float(loads.layered_drag(cell, np.ones(1))[0]),
            pressure_N_per_m2=loads.wind_pressure(wind, cell) / loads.PER_MM2,
            front_area_m2=front * loads.PER_MM2,
            layers=float(reference.sum() / front),
            drag_N=float(reference @ (problem.factor * _drag(problem, wind, solution.x, area)) @ along),
        )
        lines.append(line)
    return tuple(lines)


@dataclass(frozen=True)
class MixerOptions:
    """Numbers of the mixing of forces."""

    memory: int = 20
    """Rounds before, of whose pressures the next one is mixed so that the changes cancel."""
    least_part: float = 0.02
    """Least part of a change that is taken. Less hardly moves."""
    far: float = 2.0
    """Changes this many times the least one are not built upon. Smaller values go back from every detour."""
    kept: int = 3
    """Rounds that are remembered on the way back."""
    growth: float = 1.3
    """How much larger the part becomes with every least change."""
    flat: float = 1e-4
    """Relative singular values of changes that are noise. With 1e-8 mixed forces were noise of solvers, multiplied."""


MIXER = MixerOptions()


class Mixer:
    """Fixed points of forces by Anderson's mixing, with a way back (D. G. Anderson, J. ACM 12, 1965).

    Forces f are looked for that a map G leaves: G(f) - f = 0. The next ones are those at which the changes seen so far,
    if they were linear, would cancel, plus a part of what then remains. Where a change is far larger than the least
    one, the forces of that one are tried again with half the part, and all but the newest few are forgotten: the slope
    of G may be far below -1, so that rounds swing between a curtain that flies and one that hangs.

    Forces (n_points, d) of some rounds at points of the areas `weight` (n_points,), and the least changed ones.

    part: of a change that is taken at first and `most` later. `idle`: rounds since the change was least.
    """

    def __init__(self, weight: Array, part: float, most: float) -> None:
        self.scale = np.sqrt(weight)[:, None]
        self.part, self.most, self.idle = part, most, 0
        self.rounds: list[Array] = []  # forces and their changes (2, n_points, d)
        self.best: tuple[Array, Array] | None = None
        self.least = self.far = np.inf

    def next(self, force: Array, change: Array) -> Array:
        """The force (n_points, d) to try after one that the present shape would change by `change`."""
        size = float(np.linalg.norm(self.scale * change))
        if self.best is not None and size > self.far:
            return self._back()
        if size < self.least:
            self.least, self.best, self.idle = size, (force, change), 0
            self.part = min(self.most, MIXER.growth * self.part)
        else:
            self.idle += 1
        self.far = MIXER.far * self.least
        self.rounds = [*self.rounds, np.stack([force, change])][-MIXER.memory - 1 :]
        return self._mixed(force, change)

    def _back(self) -> Array:
        """The best forces and a smaller part of their change."""
        assert self.best is not None
        self.part = max(0.5 * self.part, MIXER.least_part)
        self.far *= MIXER.far
        self.idle += 1
        self.rounds = self.rounds[-MIXER.kept :]
        return np.asarray(self.best[0] + self.part * self.best[1])

    def _mixed(self, force: Array, change: Array) -> Array:
        """Force and change less the sum of earlier ones that cancels the change best."""
        if len(self.rounds) == 1:
            return force + self.part * change
        df, dg = np.stack([self.rounds[-1] - before for before in self.rounds[:-1]], axis=-1)
        scaled = (self.scale[:, :, None] * dg).reshape(-1, dg.shape[-1])
        sizes = np.maximum(np.linalg.norm(scaled, axis=0), 1e-300)
        weights = np.linalg.lstsq(scaled / sizes, (self.scale * change).ravel(), rcond=MIXER.flat)[0] / sizes
        return np.asarray(force + self.part * change - (df + self.part * dg) @ weights)
