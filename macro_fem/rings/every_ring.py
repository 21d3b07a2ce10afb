"""A scene solved ring by ring: who is asked, the answer and its files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from homogenize import MembraneLaw
from macro_fem.answer import Solution
from macro_fem.output.files import rings as rings_of
from macro_fem.output.files import write_summary
from macro_fem.output.pictures import Pictures
from macro_fem.rings.ring_scene import RingScene
from macro_fem.solution import CurtainSolution
from rve import Cell, FiniteSolution
from rve.common import Array, InputError, versions
from rve.common.drawing.plane import new_axes, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class EveryRing:
    """Every ring answers, as a rigid body: `rings` are those of a cell, or those that a law was made of (None: r1 = 5,
    r2 = 0.5 mm).

    space: whether centres are free in space, or stay in the plane; start: the "slack" weave, or one that the membrane
    of the law guides ("disk"), or that moves to rest, damped ("motion").
    """

    rings: Cell | MembraneLaw | None = None
    space: bool = True
    start: str = "slack"


def or_none(value: float | Array) -> Any:
    """The number, or list of numbers, None where it is not finite: JSON has neither nan nor inf."""
    array = np.asarray(value)
    return array.tolist() if np.isfinite(array).all() else None


@dataclass(frozen=True, eq=False, repr=False)
class EveryRingSolution(Solution):
    """A scene solved ring by ring; start: "slack", "disk" or "motion", see `EveryRing`; disk: what guided the rings."""

    scene: RingScene
    found: FiniteSolution
    start: str = "slack"
    disk: CurtainSolution | None = None

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The numbers of summary.json: lengths in mm, forces in N; null for forces where there are none."""
        rings, solution, contacts = self.scene, self.found, self.found.contacts
        has_forces = bool(np.isfinite(contacts.force).all())
        largest = float(contacts.force.max(initial=0.0)) if has_forces else math.nan
        supports = []
        for name, held in rings.groups:
            forces, places = solution.reaction[held], zip(rings.mesh.X[held], solution.centre[held], strict=True)
            supports.append(
                {
                    "support": name,
                    "force_N": or_none(forces.sum(axis=0)),
                    "largest_nodal_force_N": or_none(np.linalg.norm(forces, axis=1).max(initial=0.0)),
                    "points": [
                        {"at_mm": X.tolist(), "force_N": or_none(force), "place_mm": x.tolist()}
                        for force, (X, x) in zip(forces, places, strict=True)
                    ],
                }
            )
        return {
            "status": solution.status,
            "message": solution.message,
            "ring_count": len(rings.mesh.X),
            "centres": "space" if solution.is_space else "plane",
            "mean_height_mm": solution.mean_height,
            "lowest_point_mm": float(solution.centre[:, 1].min()),
            "depth_mm": float(np.ptp(solution.centre[:, 2])),
            "potential_N_mm": solution.potential,
            "min_gap_mm": contacts.min_gap_mm,
            "notes": list(rings.notes),
            "links": len(rings.mesh.linked),
            "links_intact": contacts.links_intact,
            "kkt_residual": or_none(solution.kkt_residual),
            "way_left_mm": solution.way_left_mm,
            "contacts": int((contacts.force > 1e-6 * largest).sum()) if has_forces else None,
            "largest_contact_force_N": or_none(largest),
            "total_load_N": solution.load.sum(axis=0).tolist(),
            "support_forces": supports,
            "safety_factor": None,
            "obstacles": [
                {"obstacle": wall.name, "reaction_N": or_none(force)}
                for wall, force in zip(solution.walls, solution.wall_force, strict=True)
            ],
            "hang_deg": rings.scene.curtain.weave_angle,
            "rings": rings_of(rings.info),
            "weave": rings.mesh.cell.weave.name,
            "iterations": solution.iterations,
            "wall_s": round(solution.wall_s, 3),
            "versions": versions("scikit-fem", "scikit-sparse"),
            "start": self.start,
        }

    def _write(self, staged: Path, wanted: Pictures) -> dict[str, Any]:
        if wanted.animation:
            raise InputError("animation: every ring is solved in one step, there is nothing to animate")
        self.found.write_vtu(staged / "rings.vtu")
        if wanted.picture:
            save_figure(staged / "rings.png", self.plot(new_axes(8.0, 8.0)).figure, dpi=200)
        if wanted.html:
            self.write_html(staged / "rings.html")
        write_summary(staged, self.summary)
        return self.summary

    def plot(self, ax: Axes | None = None) -> Axes:
        """Every ring in the plane x, y, coloured by its largest contact force."""
        return self.found.plot(ax)

    def write_html(self, path: str | Path) -> None:
        """See `Solution.write_html`."""
        self.found.write_html(path)

    def rings(self) -> FiniteSolution:
        """Every ring."""
        return self.found
