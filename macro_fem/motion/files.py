"""Files of a curtain in motion: motion.csv, a series of VTUs for ParaView, summary.json, pictures, and motion.npz, from
which the run goes on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np

from homogenize import default_law, load_law
from macro_fem.curtain import is_elastic
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.cells import padded
from macro_fem.motion.kept import KEPT, read_kept, write_kept
from macro_fem.motion.run import MotionFrame, MotionRun, solve_motion
from macro_fem.motion.views import as_solution, chosen, write_views
from macro_fem.output import strength
from macro_fem.output.files import collection, write_vtu
from macro_fem.output.pictures import Pictures
from macro_fem.scene.schema import load_scene
from rve.common.errors import InputError
from rve.common.files import check_out_job, job, versions, write_text
from rve.common.meshes import write_mesh_file
from rve.common.progress import tell
from rve.common.texts import csv_text, json_text
from rve.common.types import Array

RECORD = "summary.json"
COLUMNS = (
    *("t_s", "mean_x_mm", "mean_y_mm", "mean_z_mm", "lowest_point_mm", "kinetic_N_mm", "potential_N_mm", "stored_N_mm"),
    *("work_N_mm", "lost_by_scheme_N_mm", "lost_by_locking_N_mm", "lost_by_damping_N_mm", "support_force_N"),
    "relative_gap",
)
"""Columns of motion.csv; support_force_N is the size of the sum of the forces of all supports."""
IMPULSES = (
    "rings that lock do so by impulses: forces and line loads are those over each step divided by its length, and grow "
    'with shorter steps where something is struck; kind = "elastic" under [solver] gives forces'
)
FORCES = "at the ends of the steps, by the elasticity of the rings"


def run_motion(
    scene_path: Path,
    law_path: Path | None,
    out: Path,
    *,
    picture: bool = True,
    animation: bool = False,
    html: bool = False,
    goes_on: bool = False,
) -> dict[str, Any]:
    """Solve the scene of [motion] in a file, write its files into `out` and return the summary.

    goes_on: from the end of the run whose files are in `out`, of the same scene but for its duration, and the same law.
    InputError in one sentence, and nothing written, for what cannot be read or begin.
    """
    scene = load_scene(scene_path)
    if scene.motion is None:
        raise InputError(f"{scene.source}: [motion]: is missing, so nothing moves; give its duration in s")
    wanted = Pictures(picture, animation, html, stem="motion")
    wanted.check(scene)
    inputs = [scene_path, law_path, scene.mesh_file]
    check_out_job(out, RECORD, inputs=inputs)
    law = default_law() if law_path is None else load_law(law_path)
    before: tuple[MotionFrame, ...] = ()
    rows = np.zeros((0, len(COLUMNS) + 2))
    if goes_on:
        before, rows = read_kept(out / KEPT, scene, law)
        if before[-1].moment.t >= scene.motion.duration * (1.0 - 1e-9):
            raise InputError(f"--continue: the run in {out} has come to its end; give a longer duration under [motion]")
    run = solve_motion(scene, law, before[-1] if before else None)
    more = [row(run, frame) + peaks(run, frame) for frame in run.frames[1 if before else 0 :]]
    rows = np.vstack([rows, more])
    shown = chosen((*before[:-1], *run.frames))
    summary = summarize_motion(run, rows) | {"frames": len(shown)}
    with job(out, RECORD, inputs) as folder:
        write_text(folder / "motion.csv", csv_text(COLUMNS, rows[:, : len(COLUMNS)].tolist()))
        write_frames(folder, run, shown)
        write_kept(folder / KEPT, scene, law, shown, rows)
        write_views(folder, run, shown, wanted)
        write_text(folder / RECORD, json_text(summary))
    return summary


def row(run: MotionRun, frame: MotionFrame) -> list[float]:
    """A row of motion.csv."""
    disc, x = frame.problem.disc, padded(frame.moment.x[: frame.problem.disc.n_nodes])
    shares = load_vector(disc, np.array([1.0]))[:, 0]
    mean = shares @ x / shares.sum()
    force = float(np.linalg.norm(frame.supports.sum(axis=0)))
    return [frame.moment.t, *mean.tolist(), float(x[:, 1].min()), *astuple(frame.account), force, frame.relative_gap]


def peaks(run: MotionRun, frame: MotionFrame) -> list[float]:
    """The largest principal line load of a moment, N/mm, and utilisation of its rings, nan where it is not known."""
    solution = as_solution(run, frame)
    used = strength.utilisation(solution)
    load = float(solution.principal()[0].max(initial=0.0))
    return [load, np.nan if used is None else float(used.max(initial=0.0))]


def write_frames(folder: Path, run: MotionRun, frames: Sequence[MotionFrame]) -> None:
    """motion_0000.vtu and so on with motion.pvd, and where bodies are, as points and in bodies.csv."""
    entries, places = [], []
    for k, frame in enumerate(frames):
        tell(f"writing frames, {k} of {len(frames)}", k / len(frames))
        t, name = frame.moment.t, f"motion_{k:04d}.vtu"
        write_vtu(folder / name, as_solution(run, frame))
        entries.append((t, 0, name))
        if run.bodies:
            x, v = (one[frame.problem.disc.n_nodes :] for one in (frame.moment.x, frame.moment.v))
            entries.append((t, 1, f"bodies_{k:04d}.vtu"))
            _write_bodies(folder / entries[-1][2], x, v, [body.radius for body in run.bodies])
            places += [
                (t, body.name, *place, *speed)
                for body, place, speed in zip(run.bodies, x.tolist(), v.tolist(), strict=True)
            ]
    write_text(folder / "motion.pvd", collection(entries))
    if run.bodies:
        names = ("t_s", "body", "x_mm", "y_mm", "z_mm", "v_x_mm_per_s", "v_y_mm_per_s", "v_z_mm_per_s")
        write_text(folder / "bodies.csv", csv_text(names, places))


def _write_bodies(path: Path, x: Array, v: Array, radius: list[float]) -> None:
    import meshio

    data = {"radius_mm": np.array(radius), "velocity_mm_per_s": v}
    write_mesh_file(path, meshio.Mesh(x, [("vertex", np.arange(len(x))[:, None])], point_data=data))


def summarize_motion(run: MotionRun, rows: Array) -> dict[str, Any]:
    """The numbers of summary.json from the `row` and the `peaks` of every step (m, 16)."""
    assert run.scene.motion is not None
    t, force = rows[:, 0], rows[:, COLUMNS.index("support_force_N")]
    last = run.frames[-1]
    is_rigid = not is_elastic(last.problem.scene)
    summary: dict[str, Any] = {
        "status": str(run.status),
        "message": run.message,
        "duration_s": run.scene.motion.duration,
        "reached_s": float(t[-1]),
        "steps": len(rows) - 1,
        "scheme": run.scene.motion.scheme,
        "forces": IMPULSES if is_rigid else FORCES,
    } | force_peaks(t, force, impulse=is_rigid)
    for name, unit, values in (("line_load", "_N_per_mm", rows[:, -2]), ("utilisation", "", rows[:, -1])):
        if np.isfinite(values).all():
            summary |= {f"peak_{name}{unit}": float(values.max()), f"peak_{name}_at_s": float(t[values.argmax()])}
    n = last.problem.disc.n_nodes
    return summary | {
        "bodies": [
            {"body": body.name, "mass_kg": body.mass, "end_mm": x.tolist(), "velocity_mm_per_s": v.tolist()}
            for body, x, v in zip(run.bodies, last.moment.x[n:], last.moment.v[n:], strict=True)
        ],
        "mean_end_mm": rows[-1, 1:4].tolist(),
        "lowest_point_mm": float(rows[-1, 4]),
        **{name: float(value) for name, value in zip(COLUMNS[5:12], rows[-1, 5:12], strict=True)},
        "account_error": account_error(rows),
        "relative_gap": float(rows[:, len(COLUMNS) - 1].max()),
        "cells": last.problem.disc.n_cells,
        "element": last.problem.disc.element,
        "law": last.problem.law.name,
        "wall_s": run.wall_s,
        "versions": versions("scikit-fem", "scikit-sparse"),
    }


def force_peaks(t: Array, force: Array, *, impulse: bool) -> dict[str, float]:
    """The largest support force (m,) at times t (m,) in s, when it is, and the largest impulse of a step if asked."""
    peaks = {"peak_support_force_N": float(force.max()), "peak_support_force_at_s": float(t[force.argmax()])}
    if impulse:
        peaks["peak_support_impulse_N_s"] = float((force[1:] * np.diff(t)).max(initial=0.0))
    return peaks


def account_error(rows: Array) -> float:
    """How far energies plus losses less work are from where they began, over the largest change of a term.

    At rest no term changes: there 1e-6 of the largest term counts.
    """
    terms = rows[:, 5:12] - rows[0, 5:12]
    balance = terms @ np.array([1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0])
    scale = max(float(np.abs(terms).max()), 1e-6 * float(np.abs(rows[:, 5:12]).max()), 1e-300)
    return float(np.abs(balance).max()) / scale
