"""A scene twice: as the homogenized membrane and ring by ring, side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from macro_fem.rings.every_ring import EveryRingSolution, or_none
from macro_fem.solution import CurtainSolution
from rve.common import Array

ACROSS = 3
"""Line loads are averaged over squares of this many reference cells along each side."""
OF_RINGS = (
    *("status", "ring_count", "centres", "potential_N_mm", "mean_height_mm", "lowest_point_mm"),
    *("min_gap_mm", "links_intact", "kkt_residual"),
)
"""Keys of the summary of rings that stand beside those of the membrane."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """The membrane and the rings of one scene."""

    disk: CurtainSolution
    rings: EveryRingSolution

    @property
    def summary(self) -> dict[str, Any]:
        """Numbers side by side: lengths in mm, forces in N, line loads in N/mm of reference length.

        shape_distance_mm: root mean square, over the reference area, of the distance of the rings' centres from the
        points of the membrane that belong to them. line_load_distance: of P averaged over `ACROSS` x `ACROSS` cells,
        relative to the root mean square of the membrane's.
        """
        disk, mesh, found, told = self.disk, self.rings.scene.mesh, self.rings.found, self.rings.summary
        difference = found.mean_height - disk.mean_height()
        away = ((found.centre - disk.places(mesh.X)) ** 2).sum(axis=1)
        return {
            "disk": {
                "status": disk.status,
                "unknowns": int(disk.problem.fem.d * disk.problem.disc.n_nodes),
                "potential_N_mm": disk.primal,
                "mean_height_mm": disk.mean_height(),
                "lowest_point_mm": float(disk.x[:, 1].min()),
                "support_forces_N": [
                    disk.reactions[held.nodes].sum(axis=0).tolist() for held in disk.problem.supports.held
                ],
                "wall_s": disk.wall_s,
            },
            "rings": {key: told[key] for key in OF_RINGS}
            | {
                "unknowns": int(5 * len(found.centre)),
                "support_forces_N": [one["force_N"] for one in told["support_forces"]],
                "wall_s": found.wall_s,
            },
            "mean_height_difference_mm": difference,
            "mean_height_difference_over_height": difference / float(np.ptp(mesh.X[:, 1])),
            "shape_distance_mm": float(np.sqrt(mesh.area @ away / mesh.area.sum())),
            "line_load_distance": or_none(self.line_load_distance()),
            "line_load_averaged_over_cells": ACROSS**2,
        }

    def line_load_distance(self) -> float:
        """See `summary`."""
        disk, mesh, disc = self.disk, self.rings.scene.mesh, self.disk.problem.disc
        low, size = mesh.X.min(axis=0), np.ptp(mesh.X, axis=0)
        count = np.maximum(np.round(size / (ACROSS * np.array(mesh.sides))), 1).astype(int)
        n = int(count.prod())

        def part(X: Array) -> np.ndarray:
            ij = np.clip(np.floor((X - low) / (size / count)), 0, count - 1).astype(int)
            return np.asarray(ij[:, 0] * count[1] + ij[:, 1])

        group = part(mesh.X)
        area = np.bincount(group, mesh.area, minlength=n)
        ours = self.rings.found.line_load(group, np.maximum(area, 1e-300)).reshape(n, 6)
        cells = part(disk.problem.mesh.mesh.p[:, disk.problem.mesh.mesh.t].mean(axis=1).T)
        weight = disc.cell_area
        P = np.pad(disc.cell_mean(disk.P), ((0, 0), (0, 3 - disk.problem.fem.d), (0, 0))).reshape(-1, 6)
        total = np.bincount(cells, weight, minlength=n)
        sums = np.stack([np.bincount(cells, weight * column, minlength=n) for column in P.T], axis=1)
        theirs = sums / np.maximum(total, 1e-300)[:, None]
        there = np.where(total > 0.0, area, 0.0)
        square = there @ (ours - theirs) ** 2, there @ theirs**2
        return float(np.sqrt(square[0].sum() / square[1].sum()))
