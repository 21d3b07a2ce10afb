"""The largest line load of a curtain: at a point, and averaged over one cell of the weave.

At a held or loaded point the stress of a membrane grows without bound as the mesh is refined, about as one over the
distance. Rings cannot carry less than the load of one cell: the mean of P over an area b_x b_y is finite, converges
with the mesh, and is what the rings there bear. The mean at a point is taken over the part of the curtain nearest to
it, in the reference state, that has this area: a disk inside, half a disk on an edge, a quarter at a corner.
"""

from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from macro_fem.curtain import CurtainState
from macro_fem.fem.cells import signed_areas
from macro_fem.judged.forces import PointForce
from macro_fem.scene.loads import disk_areas
from macro_fem.scene.meshing.mesh import CurtainMesh
from macro_fem.summary import LineLoads
from rve.common import Array, Index

STEPS = np.linspace(0.0, 1.5, 7)
"""Centres of averages along the line of a force, in radii of the average at its point."""
FINE = 0.25
"""Sides of mesh cells over that of the averaging area up to which an average at a held point counts as known: 5 to
15 % below that of finer meshes (docs/measured/steel.md, cells of 3 mm). Smaller: flags more meshes as too coarse."""
ALIKE = 1e-6
"""Relative difference of values that are taken for the same where a place is named."""
SAME = 1e-9
"""Part of the curtain's area by which an average of all of it may miss, as areas in disks are rounded."""


class Extreme(NamedTuple):
    """The largest `value` of something, where it is (2,) in the reference state, mm, the line load that it is of, and
    the force that this follows from, if any."""

    value: float
    at: Array
    load: Array | None = None
    force: PointForce | None = None


def judge_line_loads(solution: CurtainState) -> LineLoads:
    """The largest line loads for summary.json; averages are None for a law that has no cell."""
    cell, peak = solution.problem.law.cell, largest(solution)
    area = None if cell is None else cell.b_x_mm * cell.b_y_mm
    mean = None if area is None else largest_mean(solution, area)
    return LineLoads(
        max_principal_line_load_N_per_mm=peak.value,
        max_principal_line_load_at_mm=peak.at.tolist(),
        max_line_load_over_a_cell_N_per_mm=None if mean is None else mean.value,
        max_line_load_over_a_cell_at_mm=None if mean is None else mean.at.tolist(),
        line_load_averaged_over_mm2=area,
    )


def largest(solution: CurtainState) -> Extreme:
    """The largest principal line load of any cell, and the middle of that cell."""
    values, mesh = solution.principal()[0][:, 0], solution.problem.mesh.mesh
    cell = int(values.argmax())
    return Extreme(float(values[cell]), mesh.p[:, mesh.t[:, cell]].mean(axis=1))


def largest_mean(solution: CurtainState, area: float) -> Extreme:
    """The largest singular value of P averaged over the `area` (mm2) nearest to a corner of the mesh."""
    P = solution.recovered(solution.P)
    size = np.linalg.norm(P, 2, axis=(1, 2))
    near = Nearby(disks_of(solution.problem.mesh, area), P, size)
    return near.largest(lambda P: np.asarray(np.linalg.norm(P, 2, axis=(1, 2))))


class Disks:
    """Triangles (n, 3) of points x (p, 2), and of each place those within the `area` (mm2) nearest to it."""

    def __init__(self, x: Array, triangles: Index, area: float) -> None:
        self.points, self.corners, self.area = x[np.unique(triangles)], x[triangles], area
        self.middle = self.corners.mean(axis=1)
        self.half = np.linalg.norm(self.corners - self.middle[:, None], axis=-1).max(axis=1)
        self.radius = float(np.sqrt(area / np.pi))
        self.whole = float(np.abs(signed_areas(self.corners)).sum())
        self.tree = cKDTree(self.middle)
        self._at_points: dict[int, tuple[np.ndarray, Array]] = {}

    @cached_property
    def reach(self) -> tuple[np.ndarray, np.ndarray]:
        """Triangles that an average at any of the `points` (k,) may take in, one point after another, and where those
        of each begin, (k,)."""
        # Averages reach no farther than this many radii of a disk of the same area, in corners of 60 degrees and
        # more.
        each = [self._around(x, 2.5 * self.radius) for x in self.points]
        return np.concatenate(each), np.cumsum([0, *map(len, each[:-1])])

    def at_point(self, i: int) -> tuple[np.ndarray, Array]:
        """`nearest` of one of the points, without the radius; found once."""
        if i not in self._at_points:
            self._at_points[i] = self.nearest(self.points[i])[:2]
        return self._at_points[i]

    def _around(self, x: Array, radius: float) -> np.ndarray:
        """The triangles that may have a point within `radius` of x (2,), in the order of their numbers."""
        cells = np.array(self.tree.query_ball_point(x, radius + self.half.max(), return_sorted=True), dtype=int)
        return np.asarray(cells[np.linalg.norm(self.middle[cells] - x, axis=1) <= radius + self.half[cells]])

    def nearest(self, x: Array, area: float = 0.0) -> tuple[np.ndarray, Array, float]:
        """Triangles (k,) that the disk around x (2,) meets, the area (k,) of each in it, and its radius."""
        wanted = min(max(self.area, area), (1.0 - SAME) * self.whole)
        reach = float(np.sqrt(wanted / np.pi))

        def areas(radius: float) -> Array:
            return disk_areas(self.corners[cells], x, radius)

        while len(cells := self._around(x, reach)) == 0 or areas(reach).sum() < wanted:
            reach *= 1.5
        radius = float(brentq(lambda radius: areas(radius).sum() - wanted, 0.5 * reach, reach, xtol=1e-12 * reach))
        return cells, areas(radius), radius


@lru_cache(maxsize=2)
def disks_of(mesh: CurtainMesh, area: float) -> Disks:
    """The disks of a mesh, which all moments and questions share."""
    return Disks(mesh.mesh.p.T, mesh.mesh.t.T, area)


class Nearby:
    """Averages of P (n, ...), constant in the triangles of `disks`, over their area; size (n,): convex in P, such as
    its largest singular value, so that averages have at most the largest of it."""

    def __init__(self, disks: Disks, P: Array, size: Array) -> None:
        self.disks, self.P, self.size, self.area = disks, P, size, disks.area
        self._means: dict[int, Array] = {}  # at the points, which first yield and collapse ask for

    @cached_property
    def bound(self) -> Array:
        """The largest size of any triangle that an average at each corner of the mesh may take in, (k,)."""
        cells, begin = self.disks.reach
        return np.maximum.reduceat(self.size[cells], begin)

    def largest(self, value: Callable[[Array], Array], most: float = 1.0) -> Extreme:
        """The largest value (n,) of averages (n, ...) at the corners of the mesh; it is at most `most` times `size`.

        Places are visited in the order of this bound, until it is no more than the largest value found. Of places where
        the value is the same up to `ALIKE` the first is named, as the rest is rounding.
        """
        bound = most * self.bound
        order = np.argsort(-np.round(bound / max(float(bound.max()), 1e-300) / ALIKE), kind="stable")
        points = self.disks.points
        best = Extreme(0.0, points[order[0]])
        for i in order:
            if bound[i] * (1.0 + ALIKE) <= best.value:
                break
            if i not in self._means:
                cells, part = self.disks.at_point(i)
                self._means[i] = np.asarray(np.tensordot(part, self.P[cells], axes=1) / part.sum())
            mean = self._means[i]
            found = float(value(mean[None])[0])
            if found > (1.0 + ALIKE) * best.value:
                best = Extreme(found, points[i], mean)
            best = best._replace(value=max(found, best.value))
        return best

    def mean(self, x: Array, area: float = 0.0) -> Array:
        """P averaged over the area nearest to x (2,), or over another `area` (mm2) if that is larger; over all
        triangles if they have less."""
        cells, part, _ = self.disks.nearest(x, area)
        return np.asarray(np.tensordot(part, self.P[cells], axes=1) / part.sum())

    def sides(self, x: Array) -> tuple[float, float]:
        """Side in mm, as root of the area, of the triangles in the average at x (2,): the mean by area, the largest."""
        cells, part, _ = self.disks.nearest(x)
        areas = np.abs(signed_areas(self.disks.corners[cells]))
        return float(np.sqrt(part @ areas / part.sum())), float(np.sqrt(areas[part > SAME * part.sum()].max()))

    def chord(self, x: Array, m: Array) -> float:
        """Longest part in mm of the line from x (2,) along m (2,) that lies in one of the averages centred on it."""
        steps = STEPS * self.disks.nearest(x)[2]
        radii = [self.disks.nearest(x + t * m)[2] for t in steps]
        return float(max(radius + min(t, radius) for t, radius in zip(steps, radii, strict=True)))
