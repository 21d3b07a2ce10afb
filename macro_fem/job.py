"""One job: a scene file in, a folder with summary, VTU and picture out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from homogenize import MembraneLaw, default_law, load_law
from macro_fem.bounds.adapt import Level, levels
from macro_fem.bounds.interval import Bounds
from macro_fem.curtain import solve_problem
from macro_fem.output.explain import decisions
from macro_fem.output.files import bounds_summary, summarize, write_series, write_summary, write_vtu
from macro_fem.progress import Say, silent
from macro_fem.scene.mesh import build_mesh
from macro_fem.scene.schema import FEATURES, Scene, check_solver, load_scene
from macro_fem.solution import CurtainSolution, make_problem
from rve.common.errors import InputError, require
from rve.common.jobs import check_out_job, complete, job
from rve.common.types import Array

RECORD = "summary.json"
"""The file that stands for the job; it lists the others by their checksums."""


def run_scene(
    scene_path: Path,
    law_path: Path | None,
    out: Path,
    *,
    picture: bool = True,
    force: tuple[str, ...] = (),
    say: Say = silent,
) -> dict[str, Any]:
    """Solves the scene, writes its files into `out` and returns the summary; `force` adds to that of the scene.

    curtain.vtu and curtain.png show the full load; with more than one load step curtain.pvd lists one VTU per step.
    All files appear together, and what they replace is gone (`rve.common.jobs`).
    InputError in one sentence if the scene cannot be read, makes no sense or has no solution; nothing is written then.
    `say` is told what is being solved.
    """
    if picture:
        require("matplotlib", "plots", "curtain.png", "ask for --no-picture")
    scene = with_force(load_scene(scene_path), force)
    if scene.solver.kind == "conic":
        require("clarabel", "cones", "[solver] kind = 'conic'", "use kind = 'rigid'")
    mesh_file = None if scene.curtain.file is None else Path(scene.source).parent / scene.curtain.file
    if mesh_file is not None:
        complete(mesh_file.parent, RECORD)
    inputs = [scene_path, law_path, mesh_file]
    check_out_job(out, RECORD, inputs=inputs)
    law = default_law() if law_path is None else load_law(law_path)
    steps = scene.load.steps
    early = [_solved(scene, law, step / steps, say) for step in range(1, steps)]
    if asks_bounds(scene):
        say("solving with bounds")
    final = _with_bounds(scene, law) if asks_bounds(scene) else []
    solution = final[-1].solution if final else _solved(scene, law, 1.0, say)
    bounds = final[-1].bounds if final else None
    summary = summarize(solution)
    if final:
        summary |= {"bounds": bounds_summary(final[-1]), "levels": [bounds_summary(level) for level in final]}
    summary["features"] = [decision.to_dict() for decision in decisions(solution, bounds=bool(final), picture=picture)]
    if early:
        summary["steps"] = [_step_line(one, step, scene.load.steps) for step, one in enumerate([*early, solution], 1)]
    with job(out, RECORD, inputs) as folder:
        _write(folder, [*early, solution], bounds, picture=picture)
        write_summary(folder, summary)
    return summary


def with_force(scene: Scene, force: tuple[str, ...]) -> Scene:
    """The scene with more features forced; InputError for those that are not known or do not go with it."""
    if not force:
        return scene
    for name in force:
        if name not in (*FEATURES, "all"):
            raise InputError(f"--force = {name!r}: known are all, {', '.join(FEATURES)}")
    wider = replace(scene, solver=replace(scene.solver, force=(*scene.solver.force, *force)))
    check_solver(wider, scene.source)
    return wider


def asks_bounds(scene: Scene) -> bool:
    """Whether bounds of the continuous curtain are wanted."""
    solver = scene.solver
    fits = solver.kind == "rigid" and scene.mesh.element == "P1"
    return solver.bounds or solver.adapt > 0 or (fits and solver.forces("bounds"))


def _solved(scene: Scene, law: MembraneLaw, factor: float, say: Say = silent) -> CurtainSolution:
    """The curtain at one share of the live load; InputError if there is none."""
    mesh = build_mesh(scene, law.cell)
    say(f"solving {mesh.mesh.t.shape[1]} cells, load step {round(factor * scene.load.steps)} of {scene.load.steps}")
    solution = solve_problem(make_problem(scene, law, mesh, factor))
    if solution.status == "infeasible":
        at = f" at {factor:.3g} of the prescribed moves" if scene.load.steps > 1 else ""
        raise InputError(f"{scene.source}: [support]: {solution.message}{at}")
    return solution


def _with_bounds(scene: Scene, law: MembraneLaw) -> list[Level]:
    """All levels of refinement; InputError if not even the first mesh has a solution."""
    found = list(levels(scene, law))
    if not found:
        coarse = replace(scene, solver=replace(scene.solver, bounds=False, adapt=0))
        solution = _solved(coarse, law, 1.0)
        raise InputError(f"{scene.source}: [solver] bounds: need a converged curtain: {solution.message}")
    return found


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
    disc = solution.problem.disc
    return bounds.error / disc.weight.reshape(disc.n_quad, disc.n_cells).sum(axis=0)
