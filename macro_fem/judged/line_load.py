"""The largest line load of a curtain: at a point, and averaged over one cell of the weave.

At a held or loaded point the stress of a membrane grows without bound as the mesh is refined, about as one over the
distance. Rings cannot carry less than the load of one cell: the mean of P over an area b_x b_y is finite, converges
with the mesh, and is what the rings there bear. The mean at a point is taken over the part of the curtain nearest to
it, in the reference state, that has this area: a disk inside, half a disk on an edge, a quarter at a corner.
"""

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from macro_fem.curtain import CurtainSolution
from macro_fem.fem.cells import signed_areas
from macro_fem.judged.forces import PointForce
from macro_fem.scene.loads import disk_areas
from macro_fem.summary import LineLoads
from rve.common import Array, Index

WIDEST = 2.5
"""Averages reach no farther than this many radii of a disk of the same area, in corners of 60 degrees and more."""
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


def judge_line_loads(solution: CurtainSolution) -> LineLoads:
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


def largest(solution: CurtainSolution) -> Extreme:
    """The largest principal line load of any cell, and the middle of that cell."""
    values, mesh = solution.principal()[0][:, 0], solution.problem.mesh.mesh
    cell = int(values.argmax())
    return Extreme(float(values[cell]), mesh.p[:, mesh.t[:, cell]].mean(axis=1))


def largest_mean(solution: CurtainSolution, area: float) -> Extreme:
    """The largest singular value of P averaged over the `area` (mm2) nearest to a corner of the mesh."""
    P, mesh = solution.recovered(solution.P), solution.problem.mesh.mesh
    size = np.linalg.norm(P, 2, axis=(1, 2))
    near = Nearby(mesh.p.T, mesh.t.T, P, size, area)
    return near.largest(lambda P: np.asarray(np.linalg.norm(P, 2, axis=(1, 2))))


class Nearby:
    """Averages of P (n, ...), constant in triangles (n, 3) of points x (p, 2), over the `area` (mm2) nearest to one;
    size (n,): convex in P, such as its largest singular value, so that averages have at most the largest of it."""

    def __init__(self, x: Array, triangles: Index, P: Array, size: Array, area: float) -> None:
        self.points, self.corners = x[np.unique(triangles)], x[triangles]
        self.P, self.size, self.area = P, size, area
        self.middle = self.corners.mean(axis=1)
        self.half = np.linalg.norm(self.corners - self.middle[:, None], axis=-1).max(axis=1)
        self.radius = float(np.sqrt(area / np.pi))
        self.whole = float(np.abs(signed_areas(self.corners)).sum())
        self.tree = cKDTree(self.middle)
        self._means: dict[int, Array] = {}  # at the points, which first yield and collapse ask for

    @cached_property
    def bound(self) -> Array:
        """The largest size of any triangle that an average at each corner of the mesh may take in, (k,)."""
        return np.array([self.size[self._around(x, WIDEST * self.radius)].max() for x in self.points])

    def largest(self, value: Callable[[Array], Array], most: float = 1.0) -> Extreme:
        """The largest value (n,) of averages (n, ...) at the corners of the mesh; it is at most `most` times `size`.

        Places are visited in the order of this bound, until it is no more than the largest value found. Of places where
        the value is the same up to `ALIKE` the first is named, as the rest is rounding.
        """
        bound = most * self.bound
        order = np.argsort(-np.round(bound / max(float(bound.max()), 1e-300) / ALIKE), kind="stable")
        best = Extreme(0.0, self.points[order[0]])
        for i in order:
            if bound[i] * (1.0 + ALIKE) <= best.value:
                break
            if i not in self._means:
                self._means[i] = self.mean(self.points[i])
            mean = self._means[i]
            found = float(value(mean[None])[0])
            if found > (1.0 + ALIKE) * best.value:
                best = Extreme(found, self.points[i], mean)
            best = best._replace(value=max(found, best.value))
        return best

    def mean(self, x: Array, area: float = 0.0) -> Array:
        """P averaged over the area nearest to x (2,), or over another `area` (mm2) if that is larger; over all
        triangles if they have less."""
        cells, part, _ = self._nearest(x, area)
        return np.asarray(np.tensordot(part, self.P[cells], axes=1) / part.sum())

    def sides(self, x: Array) -> tuple[float, float]:
        """Side in mm, as root of the area, of the triangles in the average at x (2,): the mean by area, the largest."""
        cells, part, _ = self._nearest(x)
        areas = np.abs(signed_areas(self.corners[cells]))
        return float(np.sqrt(part @ areas / part.sum())), float(np.sqrt(areas[part > SAME * part.sum()].max()))

    def chord(self, x: Array, m: Array) -> float:
        """Longest part in mm of the line from x (2,) along m (2,) that lies in one of the averages centred on it."""
        steps = STEPS * self._nearest(x)[2]
        radii = [self._nearest(x + t * m)[2] for t in steps]
        return float(max(radius + min(t, radius) for t, radius in zip(steps, radii, strict=True)))

    def _around(self, x: Array, radius: float) -> np.ndarray:
        """The triangles that may have a point within `radius` of x (2,), in the order of their numbers."""
        cells = np.array(self.tree.query_ball_point(x, radius + self.half.max(), return_sorted=True), dtype=int)
        return np.asarray(cells[np.linalg.norm(self.middle[cells] - x, axis=1) <= radius + self.half[cells]])

    def _nearest(self, x: Array, area: float = 0.0) -> tuple[np.ndarray, Array, float]:
        """Triangles (k,) that the disk around x (2,) meets, the area (k,) of each in it, and its radius."""
        wanted = min(max(self.area, area), (1.0 - SAME) * self.whole)
        reach = float(np.sqrt(wanted / np.pi))

        def areas(radius: float) -> Array:
            return disk_areas(self.corners[cells], x, radius)

        while len(cells := self._around(x, reach)) == 0 or areas(reach).sum() < wanted:
            reach *= 1.5
        radius = float(brentq(lambda radius: areas(radius).sum() - wanted, 0.5 * reach, reach, xtol=1e-12 * reach))
        return cells, areas(radius), radius
