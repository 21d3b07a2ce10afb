"""Scenes at several sizes, solved as rings and as the disk.

A sheet has `columns` k by `rows` k reference cells, k = 1, 2, ...; all its sizes are geometrically similar, and loads
grow with the weight. So the disk's answer over the height is the same number for all of them.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.measure import Row
from homogenize import default_law
from macro_fem import Scene, read_scene, solve
from macro_fem.rings import ring_scene
from rve.finite import FiniteSolution

Array = NDArray[np.float64]
AREAL_MASS = 2.8
GRAVITY = 9.81
SCALE = 10
"""k of the sheet that is solved as a disk, then scaled to k = 1. Solved at 1, patches would be smaller than a ring."""
ACROSS = 3
"""Line loads are averaged over squares of this many reference cells along each side."""


@dataclass(frozen=True)
class Sheet:
    """A scene of any size: its support, the angle of its weave in degrees, and a pull in the middle of its width at a
    third of its height, as multiples of the weight along x and y, at a point or over a circle whose diameter is the
    part `spread` of the width; `sizes`: the k that the full report solves."""

    key: str
    title: str
    support: str
    gather: float
    weave_angle: float = 0.0
    pull: tuple[float, float] = (0.0, 0.0)
    columns: int = 4
    rows: int = 3
    sizes: tuple[int, ...] = (1, 2, 3, 4)
    spread: float = 0.0

    def sides(self, k: int) -> tuple[float, float]:
        """Width and height in mm."""
        info = default_law().cell
        assert info is not None
        across = (info.b_y_mm, info.b_x_mm) if self.weave_angle == 90.0 else (info.b_x_mm, info.b_y_mm)
        return k * self.columns * across[0], k * self.rows * across[1]

    def weight(self, k: int) -> float:
        """In N."""
        W, H = self.sides(k)
        return 1e-6 * AREAL_MASS * GRAVITY * W * H

    def scene(self, k: int, cells: int, *, bounds: bool = False) -> Scene:
        """The scene; `cells` of the finite elements across."""
        W, H = self.sides(k)
        curtain = {"width": W, "height": H, "weave_angle": self.weave_angle, "areal_mass": AREAL_MASS}
        force = [part * self.weight(k) for part in self.pull]
        pull = {"at": [0.5 * W, H / 3.0], "force": force}
        load = {"patch": pull | {"radius": 0.5 * self.spread * W}} if self.spread else {"point": pull}
        support = {"kind": self.support, "gather": self.gather}
        solver = {"bounds": True} if bounds else {}
        tables = {"curtain": curtain, "mesh": {"cells": cells}, "support": support, "solver": solver}
        return read_scene(tables | ({"load": load} if any(force) else {}))


SHEETS = (
    Sheet("corners", "hung by its corners, 90 % apart", "corners", 0.9, sizes=(1, 2, 3, 4, 6)),
    Sheet("gathered", "top gathered to 70 %, hung across the grain", "top", 0.7, 90.0, sizes=(1, 2, 3, 4, 6)),
    Sheet("turned", "weave turned by 45 degrees, hung by its corners, 90 % apart", "corners", 0.9, 45.0),
    Sheet("pull", "top gathered to 90 %, a sideways pull of its weight at a point", "top", 0.9, 0.0, (1.0, 0.0)),
)


@dataclass(frozen=True, eq=False)
class Case:
    """An answer: its numbers, and its arrays by name."""

    numbers: Row
    arrays: dict[str, Array]


@cache
def rings_case(sheet: Sheet, k: int, space: bool) -> Case:
    """Every ring of a sheet. Arrays: X, area, P (n, 3, 2) of each ring."""
    rings = ring_scene(sheet.scene(k, 8))
    solution = rings.solve(space=space)
    mesh = rings.mesh
    numbers = {"status": solution.status, "rings": len(mesh.X), "links_intact": solution.contacts.links_intact}
    numbers |= {"min_gap_mm": solution.contacts.min_gap_mm, "kkt_residual": solution.kkt_residual}
    numbers |= {"mean_height_mm": solution.mean_height, "potential_N_mm": solution.potential}
    numbers |= {"lowest_mm": float(solution.centre[:, 1].min()), "wall_s": solution.wall_s}
    return Case(numbers, {"X": mesh.X, "area": mesh.area, "P": _line_load(solution)})


def _line_load(solution: FiniteSolution) -> Array:
    """P (n, 3, 2) in N/mm around each ring: virial of the contacts of all rings in a square of `ACROSS` cells."""
    mesh = solution.mesh
    own = solution.line_load(np.arange(len(mesh.X)), mesh.area) * mesh.area[:, None, None]
    half = 0.5 * ACROSS * float(np.mean(mesh.sides)) * (1.0 + 1e-9)
    near = cKDTree(mesh.X).query_ball_point(mesh.X, half, p=np.inf)
    return np.array([own[rows].sum(axis=0) / mesh.area[rows].sum() for rows in near])


@cache
def disk_case(sheet: Sheet, cells: int) -> Case:
    """The disk of a sheet, scaled to k = 1, with bounds. Arrays: middle, P, area of triangles."""
    result = solve(sheet.scene(SCALE, cells, bounds=True))
    solution = result.solution
    disc, summary = solution.problem.disc, result.summary["bounds"]
    count = len(solution.problem.mesh.mesh.t.T)
    P = disc.cell_mean(solution.P).reshape(count, -1)[:, :4].reshape(count, 2, 2) / SCALE
    numbers: Row = {"mean_height_mm": solution.mean_height() / SCALE, "lowest_mm": solution.x[:, 1].min() / SCALE}
    numbers["potential_N_mm"] = [summary[f"{end}_N_mm"] / SCALE**3 for end in ("lower", "upper")]
    middle = solution.problem.mesh.mesh.p[:, solution.problem.mesh.mesh.t].mean(axis=1).T / SCALE
    area = disc.weight.reshape(disc.n_quad, -1).sum(axis=0) / SCALE**2
    return Case(numbers, {"middle": middle, "P": P, "area": area})
