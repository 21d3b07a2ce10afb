"""Solving a scene, and writing summary, VTU and picture into a folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from homogenize import (
    LawInterval,
    MembraneLaw,
    default_law,
    interval_of_table,
    interval_or_law,
    read_law_interval,
    with_material,
)
from macro_fem.bounds.adapt import Level
from macro_fem.bounds.adapt import levels as refined_levels
from macro_fem.bounds.admissible import admissible_problem
from macro_fem.bounds.interval import Bounds
from macro_fem.curtain import solve_problem
from macro_fem.output import obstacles
from macro_fem.output.curtain_record import to_curtain
from macro_fem.output.explain import decisions
from macro_fem.output.files import (
    bounds_summary,
    interval_summary,
    summarize,
    support_rows,
    write_series,
    write_summary,
    write_vtu,
)
from macro_fem.output.looks import Looks, write_looks
from macro_fem.output.space_view import curtain_view
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.schema import Scene, check_scene, check_solver, load_scene
from macro_fem.solution import CurtainSolution, Problem, make_problem
from rve.common.drawing.page import write_page
from rve.common.errors import InputError, NotConverged, noted_if_stopped, require
from rve.common.materials import material_of
from rve.common.notebook import as_html
from rve.common.progress import part_of, tell
from rve.common.storage.files import check_out_file
from rve.common.storage.jobs import check_out_job, complete, job
from rve.common.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

    from macro_fem.demand.loop import Demand
    from rve import Cell, Curtain

RECORD = "summary.json"
"""The file that stands for the job; it lists the others by their checksums."""


@dataclass(frozen=True, eq=False)
class CurtainResult:
    """A solved scene: `steps`, the curtain at each load step, the last one at full load; `levels` of a scene that asks
    for bounds, each a finer mesh than the one before; `demand` of one whose law was asked of the rings.
    """

    scene: Scene
    steps: tuple[CurtainSolution, ...]
    levels: tuple[Level, ...] = ()
    demand: Demand | None = None

    @property
    def solution(self) -> CurtainSolution:
        """The curtain at full load, on the finest mesh."""
        return self.steps[-1]

    @property
    def status(self) -> str:
        """How the solve at full load ended, "converged" if it is accurate, and as narrow as asked of the rings."""
        return self.solution.status if self.demand is None else self.demand.status

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The numbers of summary.json: lengths in mm, forces in N, line loads in N per mm of reference length."""
        return self._summary(picture=False)

    def save(
        self,
        folder: str | Path,
        *,
        picture: bool = True,
        animation: bool = False,
        html: bool = False,
        inputs: Sequence[Path | None] = (),
    ) -> dict[str, Any]:
        """Write summary.json, curtain.vtu, support_forces.csv and curtain.png into `folder`; the summary.

        With more than one load step curtain.pvd lists one VTU per step. `animation`: curtain.gif of the load steps;
        `html`: curtain.html, which turns in a browser. All files appear together, and what they replace is gone
        (`rve.common.storage`). InputError where they cannot be written, or would overwrite `inputs`; NotConverged if a
        picture in space cannot be drawn, the other files are written then.
        """
        wanted = Looks(picture, animation, html)
        wanted.check(self.scene)
        check_out_job(folder, RECORD, inputs=inputs)
        summary = self._summary(picture=picture)
        bounds = self.levels[-1].bounds if self.levels else None
        with job(folder, RECORD, inputs) as staged:
            _write(staged, list(self.steps), bounds)
            density = None if bounds is None else error_density(self.solution, bounds)
            tell("files and pictures")
            failure = write_looks(staged, list(self.steps), wanted, density)
            write_summary(staged, summary)
        if failure is not None:
            raise NotConverged(f"{folder}: {failure}; the other files are written")
        return summary

    def write_html(self, path: str | Path) -> None:
        """Write the curtain at full load as one HTML file that turns in a browser without a network.

        InputError if plotly is missing or the file cannot be written.
        """
        check_out_file(path, "path")
        write_page(path, curtain_view(self.solution))

    def plot(self, ax: Axes | None = None) -> Axes:
        """Line loads of the deformed curtain with their directions, on `ax` or axes of their own (matplotlib)."""
        require("matplotlib", "plots", "plot()", "read curtain.vtu in another program")
        from macro_fem.output.plots import plot_line_loads

        return plot_line_loads(self.solution, ax)

    def plot_utilisation(self, ax: Axes | None = None) -> Axes:
        """Utilisation of the rings of each cell, on `ax` or axes of their own; InputError if the law does not tell it.

        Beside held and loaded points that of a cell grows with every refinement: judge by `utilisation_max`.
        """
        require("matplotlib", "plots", "plot_utilisation()", "read curtain.vtu in another program")
        from macro_fem.output.plots import plot_utilisation

        return plot_utilisation(self.solution, ax)

    @property
    def safety_factor(self) -> float | None:
        """Factor on all loads at which the first ring would yield; None where the law does not know its strength."""
        factor: float | None = self.summary["safety_factor"]
        return factor

    def support_forces(self) -> DataFrame:
        """The force of each held point on the curtain as a pandas DataFrame with the columns of support_forces.csv:
        number and name of the support, x and y in the reference state in mm, components in N.

        InputError if pandas is not installed.
        """
        require("pandas", "notebook", "support_forces()", "read support_forces.csv in another way")
        from pandas import DataFrame

        columns, rows = support_rows(self.summary["support_forces"])
        return DataFrame(rows, columns=list(columns))

    def to_curtain(self) -> Curtain:
        """The curtain at full load as `rve.localize` takes it: `rve.localize(result)`."""
        return to_curtain(self.solution)

    def _summary(self, *, picture: bool) -> dict[str, Any]:
        summary = summarize(self.solution)
        if self.levels:
            lines = [bounds_summary(level) for level in self.levels]
            summary |= {"bounds": lines[-1], "levels": lines} | interval_summary(self.levels[-1])
        if self.demand is not None:
            summary |= self.demand.to_dict()
        summary |= obstacles.summary(self.steps)
        features = decisions(self.solution, bounds=bool(self.levels), picture=picture)
        summary["features"] = [decision.to_dict() for decision in features]
        if len(self.steps) > 1:
            count = len(self.steps)
            summary["steps"] = [_step_line(one, step, count) for step, one in enumerate(self.steps, 1)]
        return summary

    def __str__(self) -> str:
        one = self.solution
        return f"CurtainResult: {self.status}, mean height {one.mean_height():.3f} mm, {one.problem.disc.n_cells} cells"

    def _repr_html_(self) -> str:
        """What a notebook shows: status, and the numbers of the summary that are single values."""
        return as_html(self, self.summary)


def solve(
    scene: Scene,
    law: MembraneLaw | LawInterval | None = None,
    *,
    rings: Cell | None = None,
    accuracy: float | None = None,
    cache: str | Path | None = None,
) -> CurtainResult:
    """The curtain of a scene with a law, by default that of rings with r1/r2 = 10.

    Bounds of a scene that asks for them hold for the law, or for its rings if it is an interval; the curtain is then
    that of the upper bound, by the inner law. With `rings` the law is asked of them until the interval is no wider than
    `accuracy` (default 5e-3) times the height; `law`, an interval, is what is known to begin with, and `cache` the
    folder where answers of the rings are kept.

    An answer that has not converged has a status that says why. InputError if the scene is contradictory or its
    supports are out of reach.

    >>> from macro_fem.scene.schema import Scene
    >>> scene = Scene.rectangle(100.0, 100.0, cells=4).hung_by("top")
    >>> solve(scene).status
    'converged'
    """
    check_scene(scene)
    if rings is not None:
        metal = material_of(dict(scene.material), f"{scene.source}: [material]", base=rings.material)
        rings = replace(rings, material=metal, density=metal.density_kg_per_mm3)
        return _on_demand(scene, law, rings, accuracy, cache)
    if accuracy is not None or cache is not None:
        raise InputError("accuracy and cache belong to rings: give their radii as well")
    if law is None:
        law = read_law_interval() if asks_bounds(scene) else default_law()
    law = with_material(law, dict(scene.material), f"{scene.source}: [material]")
    count = scene.load.steps
    if not asks_bounds(scene):
        return CurtainResult(scene, tuple(_steps(scene, law.law if isinstance(law, LawInterval) else law, count)))
    steps = _steps(scene, law.inner if isinstance(law, LawInterval) else law, count)
    levels = tuple(_with_bounds(scene, law, steps[-1]))
    return CurtainResult(scene, (*steps[:-1], levels[-1].solution), levels)


def _on_demand(
    scene: Scene,
    law: MembraneLaw | LawInterval | None,
    rings: Cell,
    accuracy: float | None,
    cache: str | Path | None,
) -> CurtainResult:
    """The curtain by a law that is asked of the rings; earlier load steps by the law found at full load."""
    from macro_fem.demand.cache import open_cache
    from macro_fem.demand.loop import DemandOptions, solve_on_demand
    from macro_fem.demand.ring_strength import with_strength

    bounded = replace(scene, solver=replace(scene.solver, bounds=True))
    try:
        check_solver(bounded, scene.source)
    except InputError as error:
        error.add_note(
            "asking the rings on the way needs bounds: make their table by rve table --rings, fit a law, and give it "
            "by --law"
        )
        raise
    options = DemandOptions() if accuracy is None else DemandOptions(accuracy)
    if law is not None and not isinstance(law, LawInterval):
        raise InputError("law: has no rows to begin with; make it again with homogenize fit, or give none")
    kept = open_cache(cache)
    note = "give --cache FOLDER to keep the answers of the rings"
    if kept.folder is not None:
        note = f"answers of the rings are kept in {kept.folder}, and the same command goes on from there"
    with noted_if_stopped(note):
        found = with_strength(solve_on_demand(bounded, rings, options, known=law, cache=kept), rings, kept)
        early = _steps(bounded, found.law.inner, scene.load.steps - 1)
    return CurtainResult(bounded, (*early, found.level.solution), (found.level,), found)


def _steps(scene: Scene, law: MembraneLaw, last: int) -> list[CurtainSolution]:
    """The curtain at load steps 1 to `last`, each from the one before; one that obeys the law everywhere for bounds."""
    mesh, count = build_mesh(scene, law.cell), scene.load.steps
    pose = admissible_problem if asks_bounds(scene) else make_problem
    steps: list[CurtainSolution] = []
    for step in range(1, last + 1):
        work = f"{mesh.mesh.t.shape[1]} cells, load step {step} of {count}"
        with part_of(work, (step - 1) / last, step / last):
            steps.append(_solved(pose(scene, law, mesh, step / count), steps[-1] if steps else None))
    return steps


def run_scene(
    scene_path: Path,
    law_path: Path | None,
    out: Path,
    *,
    picture: bool = True,
    animation: bool = False,
    html: bool = False,
    table: Path | None = None,
    rings: Cell | None = None,
    accuracy: float | None = None,
    cache: Path | None = None,
) -> dict[str, Any]:
    """Solve the scene in a file, write its files into `out` and return the summary.

    `rings`, `accuracy` and `cache`: see `solve`; `animation` and `html`: see `CurtainResult.save`; `table`: a
    strain-load table to begin with instead of a law.

    InputError in one sentence, and nothing written, if the scene cannot be read, is contradictory or has no solution.
    What a picture or solver needs, and what `out` would overwrite, is checked before anything is solved.
    """
    wanted = Looks(picture, animation, html)
    wanted.check_packages()
    scene = load_scene(scene_path)
    wanted.check(scene)
    if scene.solver.kind == "clarabel":
        require("clarabel", "cones", "[solver] kind = 'clarabel'", "use kind = 'rigid'")
    mesh_file = None if scene.curtain.file is None else Path(scene.source).parent / scene.curtain.file
    if mesh_file is not None:
        complete(mesh_file.parent, RECORD)
    inputs = [scene_path, law_path, table, mesh_file]
    check_out_job(out, RECORD, inputs=inputs)
    if table is not None and (law_path is not None or rings is None):
        raise InputError(f"--table = {table}: is what a run with --rings begins with, instead of --law")
    read = interval_or_law if rings is None else read_law_interval
    law = None if law_path is None else read(law_path)
    law = law if table is None else interval_of_table(table)
    with noted_if_stopped(f"what was in {out} before is unchanged"):
        found = solve(scene, law, rings=rings, accuracy=accuracy, cache=cache)
        return found.save(out, picture=picture, animation=animation, html=html, inputs=inputs)


def asks_bounds(scene: Scene) -> bool:
    """Whether bounds of the continuous curtain are wanted."""
    return scene.solver.bounds or scene.solver.adapt > 0


def _solved(problem: Problem, start: CurtainSolution | None) -> CurtainSolution:
    """The curtain at one share of the live load, from that of the last step; InputError if there is none."""
    solution = solve_problem(problem, start)
    if solution.status == "infeasible":
        scene = problem.scene
        at = f" at {problem.factor:.3g} of the prescribed moves" if scene.load.steps > 1 else ""
        table = "obstacle" if solution.stop == "blocked" else "support"
        raise InputError(f"{scene.source}: [{table}]: {solution.message}{at}")
    return solution


def _with_bounds(scene: Scene, law: MembraneLaw | LawInterval, first: CurtainSolution) -> list[Level]:
    """All levels of refinement; InputError if not even the curtain on the first mesh has converged."""
    if first.status != "converged":
        raise InputError(f"{scene.source}: [solver] bounds: need a converged curtain: {first.message}")
    return list(refined_levels(scene, law, mesh=first.problem.mesh, first=first))


def _step_line(solution: CurtainSolution, step: int, steps: int) -> dict[str, Any]:
    """What the summary says of one load step."""
    return {
        "step": step,
        "factor": step / steps,
        "status": solution.status,
        "mean_height_mm": solution.mean_height(),
        "lowest_point_mm": float(solution.x[:, 1].min()),
        "potential_primal_N_mm": solution.primal,
    }


def _write(out: Path, steps: list[CurtainSolution], bounds: Bounds | None) -> None:
    """VTU files."""
    solution = steps[-1]
    extra = {} if bounds is None else {"error_N_mm_per_mm2": error_density(solution, bounds)}
    write_vtu(out / "curtain.vtu", solution, extra)
    if len(steps) > 1:
        write_series(out, steps)


def error_density(solution: CurtainSolution, bounds: Bounds) -> Array:
    """Error per reference area of every triangle (n_cells,), N mm / mm2."""
    return bounds.error / solution.problem.disc.cell_area
