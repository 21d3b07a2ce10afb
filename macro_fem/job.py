"""Solving a scene, and writing summary, VTU and picture into a folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from homogenize import MembraneLaw, default_law, load_law
from macro_fem.bounds.adapt import Level
from macro_fem.bounds.adapt import levels as refined_levels
from macro_fem.bounds.interval import Bounds
from macro_fem.curtain import solve_problem
from macro_fem.output.explain import decisions
from macro_fem.output.files import bounds_summary, summarize, write_series, write_summary, write_vtu
from macro_fem.output.rings import to_curtain
from macro_fem.progress import Say, silent
from macro_fem.scene.mesh import build_mesh
from macro_fem.scene.schema import Scene, load_scene
from macro_fem.solution import CurtainSolution, Problem, make_problem
from rve.common.errors import InputError, require
from rve.common.jobs import check_out_job, complete, job
from rve.common.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from rve import Curtain

RECORD = "summary.json"
"""The file that stands for the job; it lists the others by their checksums."""


@dataclass(frozen=True, eq=False)
class CurtainResult:
    """A solved scene: `steps`, the curtain at each load step, the last one at full load; `levels` of a scene that asks
    for bounds, each a finer mesh than the one before.
    """

    scene: Scene
    steps: tuple[CurtainSolution, ...]
    levels: tuple[Level, ...] = ()

    @property
    def solution(self) -> CurtainSolution:
        """The curtain at full load, on the finest mesh."""
        return self.steps[-1]

    @property
    def status(self) -> str:
        """How the solve at full load ended, "converged" if it is accurate."""
        return self.solution.status

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The numbers of summary.json: lengths in mm, forces in N, line loads in N per mm of reference length."""
        return self._summary(picture=False)

    def save(self, folder: str | Path, *, picture: bool = True, inputs: Sequence[Path | None] = ()) -> dict[str, Any]:
        """Write summary.json, curtain.vtu, support_forces.csv and curtain.png into `folder`; the summary.

        With more than one load step curtain.pvd lists one VTU per step. All files appear together, and what they
        replace is gone (`rve.common.jobs`). InputError where they cannot be written, or would overwrite `inputs`.
        """
        if picture:
            require("matplotlib", "plots", "curtain.png", "ask for none")
        check_out_job(folder, RECORD, inputs=inputs)
        summary = self._summary(picture=picture)
        bounds = self.levels[-1].bounds if self.levels else None
        with job(folder, RECORD, inputs) as staged:
            _write(staged, list(self.steps), bounds, picture=picture)
            write_summary(staged, summary)
        return summary

    def plot(self, ax: Axes | None = None) -> Axes:
        """Line loads of the deformed curtain with their directions, on `ax` or axes of their own (matplotlib)."""
        require("matplotlib", "plots", "plot()", "read curtain.vtu in another program")
        from macro_fem.output.plots import plot_line_loads

        return plot_line_loads(self.solution, ax)

    def to_curtain(self) -> Curtain:
        """The curtain at full load as `rve.localize` takes it: `rve.localize(result)`."""
        return to_curtain(self.solution)

    def _summary(self, *, picture: bool) -> dict[str, Any]:
        summary = summarize(self.solution)
        if self.levels:
            lines = [bounds_summary(level) for level in self.levels]
            summary |= {"bounds": lines[-1], "levels": lines}
        features = decisions(self.solution, bounds=bool(self.levels), picture=picture)
        summary["features"] = [decision.to_dict() for decision in features]
        if len(self.steps) > 1:
            count = len(self.steps)
            summary["steps"] = [_step_line(one, step, count) for step, one in enumerate(self.steps, 1)]
        return summary

    def __str__(self) -> str:
        one = self.solution
        return f"CurtainResult: {one.status}, mean height {one.mean_height():.3f} mm, {one.problem.disc.n_cells} cells"

    def _repr_html_(self) -> str:
        """What a notebook shows: status, and the numbers of the summary that are single values."""
        rows = [(k, v) for k, v in self.summary.items() if isinstance(v, str | int | float)]
        body = "".join(f"<tr><th>{escape(k)}</th><td>{escape(format(v))}</td></tr>" for k, v in rows)
        return f"<p>{escape(str(self))}</p><table>{body}</table>"


def solve(scene: Scene, law: MembraneLaw | None = None, *, say: Say = silent) -> CurtainResult:
    """The curtain of a scene with a law, by default that of rings with r1/r2 = 10; `say` is told what is being solved.

    An answer that has not converged has a status that says why. InputError if the scene is contradictory or its
    supports are out of reach.

    >>> from macro_fem.scene.schema import Scene
    >>> scene = Scene.rectangle(100.0, 100.0, cells=4).hung_by("top")
    >>> solve(scene).status
    'converged'
    """
    law = default_law() if law is None else law
    mesh, count = build_mesh(scene, law.cell), scene.load.steps
    steps: list[CurtainSolution] = []
    for step in range(1, count + 1):
        say(f"solving {mesh.mesh.t.shape[1]} cells, load step {step} of {count}")
        steps.append(_solved(make_problem(scene, law, mesh, step / count), steps[-1] if steps else None))
    if asks_bounds(scene):
        say("solving with bounds")
        levels = tuple(_with_bounds(scene, law, steps[-1]))
        return CurtainResult(scene, (*steps[:-1], levels[-1].solution), levels)
    return CurtainResult(scene, tuple(steps))


def run_scene(
    scene_path: Path,
    law_path: Path | None,
    out: Path,
    *,
    picture: bool = True,
    say: Say = silent,
) -> dict[str, Any]:
    """Solve the scene in a file, write its files into `out` and return the summary.

    InputError in one sentence, and nothing written, if the scene cannot be read, is contradictory or has no solution.
    What a picture or solver needs, and what `out` would overwrite, is checked before anything is solved.
    """
    if picture:
        require("matplotlib", "plots", "curtain.png", "ask for --no-picture")
    scene = load_scene(scene_path)
    if scene.solver.kind == "clarabel":
        require("clarabel", "cones", "[solver] kind = 'clarabel'", "use kind = 'rigid'")
    mesh_file = None if scene.curtain.file is None else Path(scene.source).parent / scene.curtain.file
    if mesh_file is not None:
        complete(mesh_file.parent, RECORD)
    inputs = [scene_path, law_path, mesh_file]
    check_out_job(out, RECORD, inputs=inputs)
    law = default_law() if law_path is None else load_law(law_path)
    return solve(scene, law, say=say).save(out, picture=picture, inputs=inputs)


def asks_bounds(scene: Scene) -> bool:
    """Whether bounds of the continuous curtain are wanted."""
    return scene.solver.bounds or scene.solver.adapt > 0


def _solved(problem: Problem, start: CurtainSolution | None) -> CurtainSolution:
    """The curtain at one share of the live load, from that of the last step; InputError if there is none."""
    solution = solve_problem(problem, start)
    if solution.status == "infeasible":
        scene = problem.scene
        at = f" at {problem.factor:.3g} of the prescribed moves" if scene.load.steps > 1 else ""
        raise InputError(f"{scene.source}: [support]: {solution.message}{at}")
    return solution


def _with_bounds(scene: Scene, law: MembraneLaw, first: CurtainSolution) -> list[Level]:
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


def _write(out: Path, steps: list[CurtainSolution], bounds: Bounds | None, *, picture: bool) -> None:
    """VTU files and the picture."""
    solution = steps[-1]
    density = None if bounds is None else error_density(solution, bounds)
    extra = {} if density is None else {"error_N_mm_per_mm2": density}
    write_vtu(out / "curtain.vtu", solution, extra)
    if len(steps) > 1:
        write_series(out, steps)
    if picture:
        from macro_fem.output.plots import save_picture

        save_picture(out / "curtain.png", solution, density)


def error_density(solution: CurtainSolution, bounds: Bounds) -> Array:
    """Error per reference area of every triangle (n_cells,), N mm / mm2."""
    return bounds.error / solution.problem.disc.cell_area
