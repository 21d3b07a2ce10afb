"""A scene solved ring by ring: who is asked, the answer and its files; beside the homogenized membrane."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from homogenize import MembraneLaw
from macro_fem.answer import Solution
from macro_fem.curtain import CurtainSolution
from macro_fem.judged import own_forces, support_forces
from macro_fem.output.files import weave_of
from macro_fem.output.html_page import write_page
from macro_fem.output.pictures import Drawings, Pictures
from macro_fem.output.sentences import components
from macro_fem.ring_summary import EveryRingSummary, RingObstacle
from macro_fem.rings.ring_scene import RingScene
from macro_fem.summary import HeldPoint, RingSupport
from rve import Cell
from rve.common import Array, InputError, JsonObject, check_fields, versions
from rve.common.drawing.plane import new_axes, save_figure
from rve.common.optional import Axes
from rve.finite import FiniteSolution

ACROSS = 3
"""Line loads are averaged over squares of this many reference cells along each side."""
OF_RINGS = (
    *("status", "ring_count", "centres", "potential_N_mm", "mean_height_mm", "lowest_point_mm"),
    *("min_gap_mm", "links_intact", "kkt_residual"),
)
"""Keys of the summary of rings that stand beside those of the membrane."""


@dataclass(frozen=True)
class EveryRing:
    """Every ring answers, as a rigid body: `rings` are those of a cell, or those that a law was made of (None: r1 = 5,
    r2 = 0.5 mm).

    space: whether centres are free in space, or stay in the plane; start: the "slack" weave, or one that the membrane
    of the law guides ("disk").
    """

    rings: Cell | MembraneLaw | None = None
    space: bool = True
    start: Literal["slack", "disk"] = "slack"

    def __post_init__(self) -> None:
        check_fields(self)


def or_none(value: float | Array) -> Any:
    """The number, or list of numbers, None where it is not finite: JSON has neither nan nor inf."""
    array = np.asarray(value)
    return array.tolist() if np.isfinite(array).all() else None


def ring_supports(scene: RingScene, found: FiniteSolution) -> tuple[RingSupport, ...]:
    """Force of each support on rings of a scene, in sum and at each of the rings that it holds."""
    supports = []
    shares = own_forces([held for _, held in scene.groups], found.reaction)
    for (name, _), (own, part, most) in zip(scene.groups, shares, strict=True):
        points = tuple(
            HeldPoint(at_mm=X.tolist(), force_N=or_none(force), place_mm=x.tolist())
            for X, force, x, mine in zip(scene.mesh.X, part, found.centre, own, strict=True)
            if mine.any()
        )
        whole = {"force_N": or_none(part.sum(axis=0)), "largest_nodal_force_N": or_none(most)}
        supports.append(RingSupport(support=name, **whole, points=points))
    return tuple(supports)


@dataclass(frozen=True, eq=False, repr=False)
class EveryRingSolution(Solution):
    """A scene solved ring by ring; start: "slack" or "disk", see `EveryRing`; disk: what guided the rings."""

    scene: RingScene
    found: FiniteSolution
    start: str = "slack"
    disk: CurtainSolution | None = None

    @cached_property
    def summary(self) -> EveryRingSummary:
        """The numbers of summary.json: lengths in mm, forces in N; null for forces where there are none."""
        rings, solution, contacts = self.scene, self.found, self.found.contacts
        force = contacts.whole[1]
        largest = float(force.max(initial=0.0))  # nan where there are no forces
        return EveryRingSummary(
            status=solution.status,
            message=solution.message,
            ring_count=len(rings.mesh.X),
            centres="space" if solution.is_space else "plane",
            mean_height_mm=solution.mean_height,
            lowest_point_mm=float(solution.centre[:, 1].min()),
            depth_mm=float(np.ptp(solution.centre[:, 2])),
            potential_N_mm=solution.potential,
            min_gap_mm=contacts.min_gap_mm,
            notes=list(rings.notes),
            links=len(rings.mesh.linked),
            links_intact=contacts.links_intact,
            kkt_residual=or_none(solution.kkt_residual),
            way_left_mm=solution.way_left_mm,
            contacts=int((force > 1e-6 * largest).sum()) if np.isfinite(largest) else None,
            largest_contact_force_N=or_none(largest),
            total_load_N=solution.load.sum(axis=0).tolist(),
            support_forces=ring_supports(rings, solution),
            safety_factor=None,
            obstacles=tuple(
                RingObstacle(obstacle=wall.name, reaction_N=or_none(force))
                for wall, force in zip(solution.walls, solution.wall_force, strict=True)
            ),
            **weave_of(rings.info, rings.scene.curtain.weave_angle).parts(),
            iterations=solution.iterations,
            wall_s=round(solution.wall_s, 3),
            versions=versions("scikit-fem", "scikit-sparse"),
            start=self.start,
        )

    def drawings(self, wanted: Pictures) -> Drawings:
        if wanted.animation:
            raise InputError("animation: every ring is solved in one step, there is nothing to animate")
        replace(wanted, stem="rings").check()
        png: Drawings = {"rings.png": lambda path: save_figure(path, self.plot(new_axes(8.0, 8.0)).figure, dpi=200)}
        return (png if wanted.picture else {}) | ({"rings.html": self.write_html} if wanted.html else {})

    def _write(self, staged: Path) -> None:
        self.found.write_vtu(staged / "rings.vtu")

    def plot(self, ax: Axes | None = None) -> Axes:
        return self.found.plot(ax)

    def write_html(self, path: str | Path) -> None:
        rings = self.found
        height = f"mean height {rings.mean_height:.1f} mm, lowest point {rings.centre[:, 1].min():.1f} mm"
        write_page(path, rings.view, f"{len(rings.centre)} rings: {rings.status}\n{height}")

    def rings(self) -> FiniteSolution:
        return self.found


@dataclass(frozen=True, eq=False)
class Comparison:
    """The membrane and the rings of one scene."""

    disk: CurtainSolution
    rings: EveryRingSolution

    @cached_property
    def summary(self) -> JsonObject:
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
                "support_forces_N": [one.force_N for one in support_forces(disk)],
                "wall_s": disk.wall_s,
            },
            "rings": {key: told[key] for key in OF_RINGS}
            | {
                "unknowns": int(5 * len(found.centre)),
                "support_forces_N": [one.force_N for one in told.support_forces],
                "wall_s": found.wall_s,
            },
            "mean_height_difference_mm": difference,
            "mean_height_difference_over_height": difference / float(np.ptp(mesh.X[:, 1])),
            "shape_distance_mm": float(np.sqrt(mesh.area @ away / mesh.area.sum())),
            "line_load_distance": or_none(self.line_load_distance()),
            "line_load_averaged_over_cells": ACROSS**2,
        }

    def __str__(self) -> str:
        """A table of both, and the distances, in lines."""
        summary = self.summary
        lines = [f"{'':<20}{'disk':>28}{'rings':>28}"]
        lines += [
            f"{key:<20}{_text(value):>28}{_text(summary['rings'][key]):>28}" for key, value in summary["disk"].items()
        ]
        return "\n".join([*lines, *(f"{key}: {one:.6g}" for key, one in summary.items() if isinstance(one, float))])

    def line_load_distance(self) -> float:
        """How far line loads of both are apart, see `summary`."""
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
        P = np.pad(disc.cell_mean(disk.P), ((0, 0), (0, 3 - disk.problem.fem.d), (0, 0))).reshape(-1, 6)
        total = np.bincount(cells, disc.cell_area, minlength=n)
        sums = np.stack([np.bincount(cells, disc.cell_area * column, minlength=n) for column in P.T], axis=1)
        theirs = sums / np.maximum(total, 1e-300)[:, None]
        there = np.where(total > 0.0, area, 0.0)
        square = there @ (ours - theirs) ** 2, there @ theirs**2
        return float(np.sqrt(square[0].sum() / square[1].sum()))


def _text(value: Any) -> str:
    if isinstance(value, list):
        return "; ".join("-" if force is None else components(*force) for force in value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)
