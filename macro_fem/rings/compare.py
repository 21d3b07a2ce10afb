"""A scene twice: as the homogenized membrane and ring by ring, side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from macro_fem.rings.every_ring import or_none
from macro_fem.rings.ring_scene import RingScene
from macro_fem.solution import CurtainSolution
from rve import FiniteSolution
from rve.common.types import Array

ACROSS = 3
"""Line loads are averaged over squares of this many reference cells along each side."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """The membrane and the rings of one scene."""

    disk: CurtainSolution
    rings: RingScene
    solution: FiniteSolution

    @property
    def summary(self) -> dict[str, Any]:
        """Numbers side by side: lengths in mm, forces in N, line loads in N/mm of reference length.

        shape_distance_mm: root mean square, over the reference area, of the distance of the rings' centres from the
        points of the membrane that belong to them. line_load_distance: of P averaged over `ACROSS` x `ACROSS` cells,
        relative to the root mean square of the membrane's.
        """
        disk, solution = self.disk, self.solution
        height = float(np.ptp(self.rings.mesh.X[:, 1]))
        difference = solution.mean_height - disk.mean_height()
        return {
            "disk": self._disk(),
            "rings": self._rings(),
            "mean_height_difference_mm": difference,
            "mean_height_difference_over_height": difference / height,
            "shape_distance_mm": self.shape_distance(),
            "line_load_distance": or_none(self.line_load_distance()),
            "line_load_averaged_over_cells": ACROSS**2,
        }

    def _disk(self) -> dict[str, Any]:
        disk = self.disk
        held = disk.problem.supports.held
        return {
            "status": disk.status,
            "unknowns": int(disk.problem.fem.d * disk.problem.disc.n_nodes),
            "potential_N_mm": disk.primal,
            "mean_height_mm": disk.mean_height(),
            "lowest_point_mm": float(disk.x[:, 1].min()),
            "support_forces_N": [disk.reactions[one.nodes].sum(axis=0).tolist() for one in held],
            "wall_s": disk.wall_s,
        }

    def _rings(self) -> dict[str, Any]:
        solution = self.solution
        return {
            "status": solution.status,
            "unknowns": int(5 * len(solution.centre)),
            "ring_count": len(solution.centre),
            "centres": "space" if solution.is_space else "plane",
            "potential_N_mm": solution.potential,
            "mean_height_mm": solution.mean_height,
            "lowest_point_mm": float(solution.centre[:, 1].min()),
            "support_forces_N": [or_none(solution.reaction[held].sum(axis=0)) for _, held in self.rings.groups],
            "min_gap_mm": solution.contacts.min_gap_mm,
            "links_intact": solution.contacts.links_intact,
            "kkt_residual": or_none(solution.kkt_residual),
            "wall_s": solution.wall_s,
        }

    def shape_distance(self) -> float:
        """See `summary`."""
        away = self.solution.centre - self.disk.places(self.rings.mesh.X)
        area = self.rings.mesh.area
        return float(np.sqrt((area * (away**2).sum(axis=1)).sum() / area.sum()))

    def line_load_distance(self) -> float:
        """See `summary`."""
        disk, mesh = self.disk, self.rings.mesh
        side = ACROSS * np.array(mesh.sides)
        low = mesh.X.min(axis=0)
        count = np.maximum(np.round(np.ptp(mesh.X, axis=0) / side), 1).astype(int)
        step = np.ptp(mesh.X, axis=0) / count

        def part(X: Array) -> np.ndarray:
            ij = np.clip(np.floor((X - low) / step), 0, count - 1).astype(int)
            return np.asarray(ij[:, 0] * count[1] + ij[:, 1])

        n = int(count.prod())
        group = part(mesh.X)
        area = np.bincount(group, mesh.area, minlength=n)
        ours = self.solution.line_load(group, np.maximum(area, 1e-300))
        t = disk.problem.mesh.mesh.t
        cells = part(disk.problem.mesh.mesh.p[:, t].mean(axis=1).T)
        weight = disk.problem.disc.weight.reshape(disk.problem.disc.n_quad, -1).sum(axis=0)
        P = np.zeros((len(weight), 3, 2))
        P[:, : disk.problem.fem.d] = disk.problem.disc.cell_mean(disk.P)
        total = np.bincount(cells, weight, minlength=n)
        sums = np.stack([np.bincount(cells, weight * column, minlength=n) for column in P.reshape(-1, 6).T], axis=1)
        theirs = sums / np.maximum(total, 1e-300)[:, None]
        there = (area > 0.0) & (total > 0.0)
        away = ours.reshape(n, 6) - theirs
        own = area[there] @ (away[there] ** 2).sum(axis=1)
        return float(np.sqrt(own / (area[there] @ (theirs[there] ** 2).sum(axis=1))))
