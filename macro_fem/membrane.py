"""The answer of a law: the curtain at each load step, its bounds, summary, order sheet, pictures and files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from macro_fem.answer import Solution
from macro_fem.bounds.interval import CurtainBounds
from macro_fem.bounds.limit import CurtainLimit
from macro_fem.curtain import CurtainSolution, forces_note, with_forces
from macro_fem.judged import (
    Rupture,
    change_of_forces,
    combination_rows,
    envelope,
    judge,
    live_way,
    obstacle_forces,
    settling_of,
    string_stress,
    support_forces,
)
from macro_fem.output import files
from macro_fem.output.pictures import (
    Drawings,
    Pictures,
    curtain_drawings,
    plot_line_loads,
    plot_utilisation,
    write_curtain_page,
)
from macro_fem.rings.curtain import curtain_of, read_told
from macro_fem.rings.field import RingField
from macro_fem.rings.localize import localize
from macro_fem.scene.loads import edge_shares
from macro_fem.scene.meshing.outline_files import write_outline
from macro_fem.scene.scene import Scene
from macro_fem.scene.support_kinds import Track
from macro_fem.scene.tables import Bar, Combination
from macro_fem.solvers.status import Status
from macro_fem.summary import Asked, Bounds, CombinationRow, CurtainNumbers, CurtainSummary, LoadStep, Order
from rve.common import check_out_file, checked, csv_text, write_text
from rve.common.files import write_mesh_file
from rve.common.optional import Axes

if TYPE_CHECKING:
    from macro_fem.demand import Demand


@dataclass(frozen=True, eq=False, repr=False)
class MembraneSolution(Solution):
    """A solved scene: the curtain at each of the load `steps`; `levels` of a scene that asks for bounds, each a finer
    mesh than the one before; `demand` of one whose law was asked of the rings; the answers to `combinations` of loads;
    the curtain on a `coarser` mesh, where forces of single hooks are compared. Of rings that flow the `limits`, each
    on a finer mesh than the one before, and the answer of rings that do not, `rigid`, None where there is none; where
    strings break under the live loads, or why it is not known.
    """

    scene: Scene
    steps: tuple[CurtainSolution, ...]
    levels: tuple[CurtainBounds, ...] = ()
    demand: Demand | None = None
    combinations: tuple[tuple[Combination, MembraneSolution], ...] = ()
    coarser: CurtainSolution | None = None
    limits: tuple[CurtainLimit, ...] = ()
    rigid: MembraneSolution | None = None
    rupture: Rupture | str | None = None

    @property
    def solution(self) -> CurtainSolution:
        """The curtain at full load, on the finest mesh."""
        return self.steps[-1]

    @cached_property
    def loaded(self) -> CurtainSolution:
        """The curtain at full load, with forces of elastic rings where rigid ones leave them open, found when asked."""
        return with_forces(self.solution)

    @property
    def are_hooks_open(self) -> bool:
        """Whether balance leaves forces of a row of hooks, runners or points of a plugin open."""
        is_solved = self.solution.status == Status.CONVERGED and not self.limits
        rows = any(len(one.nodes) > 2 for one in self.solution.problem.mesh.places)
        return is_solved and rows and forces_note(self.loaded) is not None

    @property
    def status(self) -> Status:
        """How the solve at full load ended, "converged" if it is accurate, and as narrow as asked of the rings."""
        failed = [one.status for _, one in self.combinations if one.status != Status.CONVERGED]
        own = Status(self.solution.status if self.demand is None else self.demand.status)
        return failed[0] if failed and own == Status.CONVERGED else own

    @cached_property
    def summary(self) -> CurtainSummary:
        numbers, asked, bounds = files.summarize(self.loaded), Asked(), Bounds()
        rows, most = tuple[CombinationRow, ...](), None
        if self.levels:
            bounds = files.interval_summary(self.levels)
        if self.limits:
            rigid = None if self.rigid is None or self.rigid.solution.status != "converged" else self.rigid.loaded
            numbers = files.with_limit(numbers, self.limits[-1], self.loaded, rigid, self.rupture)
        if (demand := self.demand) is not None:
            asked, wall_s = demand.asked(), demand.turns[-1].wall_s
            numbers = replace(numbers, status=demand.status, message=demand.message, wall_s=wall_s)
        else:  # of all that was solved
            wall_s = sum(step.wall_s for step in self._shown) + sum(one.summary.wall_s for _, one in self.combinations)
            numbers = replace(numbers, wall_s=wall_s)
        if self.combinations:
            answers = [(one, found.summary) for one, found in self.combinations]
            rows = combination_rows(answers)
            most = envelope(answers, rows)
            failed = [row for row in rows if row.status != Status.CONVERGED]
            if failed and numbers.status == Status.CONVERGED:
                message = f"combination {failed[0].name}: {failed[0].message}"
                numbers = replace(numbers, status=failed[0].status, message=message)
        if self.are_hooks_open:
            other = None if self.coarser is None else support_forces(self.coarser)
            numbers = replace(numbers, single_forces_note=change_of_forces(numbers.support_forces, other))
        return CurtainSummary(
            **numbers.parts(),
            **bounds.parts(),
            **asked.parts(),
            obstacles=obstacle_forces(self._shown) or None,
            settling=settling_of(self.loaded),
            combinations=rows or None,
            envelope=most,
            **judge(numbers, rows, most).parts(),
            order=order(self.loaded, numbers),
            features=files.features(self.loaded, bounds=bool(self.levels)),
            steps=self._load_steps() if len(self.steps) > 1 else None,
        )

    def _load_steps(self) -> tuple[LoadStep, ...]:
        return tuple(
            LoadStep(
                step=step,
                factor=step / len(self.steps),
                status=one.status,
                mean_height_mm=one.mean_height(),
                lowest_point_mm=float(one.x[:, 1].min()),
                potential_primal_N_mm=one.primal,
                way_mm=None if one.tau is None else live_way(one),
                plastic_work_N_mm=one.plastic_work,
                strings_stress_N_per_mm2=string_stress(one),
            )
            for step, one in enumerate(self.steps, 1)
        )

    def drawings(self, wanted: Pictures) -> Drawings:
        wanted.check(self.scene)
        return curtain_drawings(self._shown, wanted)

    def _write(self, staged: Path) -> None:
        summary, area = self.summary, self.solution.problem.disc.cell_area
        error = {"error_N_mm_per_mm2": self.levels[-1].error / area} if self.levels else {}
        write_mesh_file(staged / "curtain.vtu", files.curtain_mesh(self.loaded, error))
        if len(self.steps) > 1:
            entries = [(k / len(self.steps), 0, f"curtain_{k:04d}.vtu") for k in range(1, len(self.steps) + 1)]
            for (_, _, name), step in zip(entries, self._shown, strict=True):
                write_mesh_file(staged / name, files.curtain_mesh(step))
            write_text(staged / "curtain.pvd", files.collection(entries))
        sheet = summary.order.to_dict()
        write_text(staged / "order.csv", csv_text(list(sheet), [sheet.values()]))
        if summary.envelope is not None:
            rows = [one.to_dict() for one in summary.envelope.support_forces]
            write_text(staged / "envelope.csv", csv_text(list(rows[0]), (row.values() for row in rows)))

    def write_html(self, path: str | Path) -> None:
        check_out_file(path, "path")
        write_curtain_page(path, self.loaded)

    @checked
    def write_report(self, path: str | Path, inputs: Sequence[Path | None] = ()) -> None:
        """Write a report as PDF: drawings with dimensions, every support force, order, factors, limits, checksums of
        `inputs`; InputError without typst (extra `report`), or pyvista for a curtain in space."""
        Pictures(picture=False, report=Path(path)).check(self.scene, inputs=inputs)
        from macro_fem.report import write_report

        others = [(one.name, found.summary) for one, found in self.combinations]
        write_report(path, self.loaded, self.summary, others, inputs)

    @checked
    def write_dxf(self, path: str | Path) -> None:
        """Write the outline of the flat sheet as DXF, mm; InputError without ezdxf (extra `cad`)."""
        Pictures(picture=False, dxf=Path(path)).check()
        write_outline(Path(path), self.solution.problem.mesh.mesh)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Line loads of the deformed curtain with their directions, on `ax` or axes of their own (matplotlib)."""
        return plot_line_loads(self.loaded, ax)

    def plot_utilisation(self, ax: Axes | None = None) -> Axes:
        """Utilisation of the rings of each cell, on `ax` or axes of their own; InputError if the law does not tell it.

        Beside held and loaded points that of a cell grows with every refinement: judge by `utilisation_max`.
        """
        return plot_utilisation(self.loaded, ax)

    @checked
    def rings(self, window: tuple[float, ...] | None = None) -> RingField:
        """Every ring of the curtain at full load, or in a window: place, tilt, gaps, links and contact forces, see
        `macro_fem.localize`; InputError where the law has no rings.
        """
        told = read_told(self.summary, "the curtain's summary")
        return localize(curtain_of(files.curtain_mesh(self.loaded), told, "a curtain in memory"), window)

    @property
    def _shown(self) -> list[CurtainSolution]:
        """The load steps, the last one with its forces."""
        return [*self.steps[:-1], self.loaded]


def order(solution: CurtainSolution, summary: CurtainNumbers) -> Order:
    """The order sheet of a solved curtain, lengths in mm.

    Width and height are those of the sheet pulled along its grain, the reference state of the law. `cells` and `rings`
    are areas over the area of a cell of the weave, rounded; they, weave and radii are None for a law without rings, and
    the material where the law does not tell the strength of rings. `hooks` counts the points
    that are held one by one, `hook_pitch_mm` is their distance along the mesh, None where there is no row of them.
    `track_mm` and `bars_mm` are the lengths of all tracks, None without any, and of the edges that have bars.
    """
    problem = solution.problem
    scene, disc, mesh = problem.scene, problem.disc, problem.mesh.mesh
    width, height = scene.curtain.extent(mesh.p.T).tolist()
    points = {int(node) for one in problem.supports.held if not len(one.facets) for node in one.nodes}
    info, cells, area = problem.law.cell, None, float(disc.cell_area.sum())
    if info is not None and info.weave is not None:
        cells = area / math.prod(info.sides_mm)
    rings = info if cells is not None else None
    bars, tracks = scene.of(Bar), scene.of(Track)
    return Order(
        mesh_width_mm=width,
        mesh_height_mm=height,
        area_m2=1e-6 * area,
        holes=1 - (len(np.unique(mesh.t)) - mesh.facets.shape[1] + mesh.t.shape[1]),  # Euler's formula
        cells=None if cells is None else round(cells),
        rings=None if cells is None or rings is None else round(cells * rings.cell().weave.classes),
        weave=rings and rings.weave,
        r1_mm=rings and rings.r1_mm,
        r2_mm=rings and rings.r2_mm,
        outer_diameter_mm=rings and 2.0 * (rings.r1_mm + rings.r2_mm),
        inner_diameter_mm=rings and 2.0 * (rings.r1_mm - rings.r2_mm),
        wire_mm=rings and 2.0 * rings.r2_mm,
        mass_kg=summary.mass_kg,
        hooks=len(points),
        hook_pitch_mm=next((one.pitch_mm for one in summary.support_forces if one.pitch_mm is not None), None),
        track_mm=sum(one.along(problem.mesh.border)[1].length for one in tracks) or None,
        bars=len(bars),
        bars_mm=sum(float(edge_shares(problem.mesh, disc, one.edge).sum()) for one in bars),
        bars_kg=sum(one.mass for one in bars),
        material=summary.ring_material,
        held_width_mm=float(np.ptp(solution.x[problem.supports.mask.any(axis=1), 0])),
        lowest_point_mm=summary.lowest_point_mm,
    )
