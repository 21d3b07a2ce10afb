"""Files of a curtain in motion: motion.csv, a series of VTUs for ParaView, summary.json, pictures, and motion.npz, from
which the run goes on."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np

from homogenize import MembraneLaw, default_law, load_law, with_material
from macro_fem.curtain import is_elastic
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.cells import padded
from macro_fem.motion.account import Account
from macro_fem.motion.pace import F, Pace, Run, motion_of
from macro_fem.motion.run import MotionFrame, MotionRun, solve_motion
from macro_fem.motion.scheme import Moment
from macro_fem.motion.stage import Stage, scene_at
from macro_fem.motion.views import as_solution, chosen, write_views
from macro_fem.output import strength
from macro_fem.output.files import collection, write_vtu
from macro_fem.output.pictures import Pictures
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.schema import Scene, load_scene
from rve.common.errors import InputError
from rve.common.files import atomic_path, check_out_job, job, versions, write_text
from rve.common.meshes import write_mesh_file
from rve.common.progress import tell
from rve.common.texts import csv_text, json_text
from rve.common.types import Array

RECORD, KEPT = "summary.json", "motion.npz"
COLUMNS = (
    *("t_s", "mean_x_mm", "mean_y_mm", "mean_z_mm", "lowest_point_mm", "kinetic_N_mm", "potential_N_mm", "stored_N_mm"),
    *("work_N_mm", "lost_by_scheme_N_mm", "lost_by_locking_N_mm", "lost_by_damping_N_mm", "support_force_N"),
    "relative_gap",
)
"""Columns of motion.csv; support_force_N is the size of the sum of the forces of all supports."""
FIELDS = ("t", "x", "v", "P", "S", "supports", "account", "gap")
"""What motion.npz has of each frame."""
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
    motion, wanted = motion_of(scene), Pictures(picture, animation, html, stem="motion")
    wanted.check(scene)
    inputs = [scene_path, law_path, scene.mesh_file]
    check_out_job(out, RECORD, inputs=inputs)
    law = default_law() if law_path is None else load_law(law_path)
    before: tuple[MotionFrame, ...] = ()
    rows = np.zeros((0, len(COLUMNS) + 2))
    if goes_on:
        before, rows = read_kept(out / KEPT, scene, law)
        if before[-1].moment.t >= motion.duration * (1.0 - 1e-9):
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
    return row_of(frame, x, load_vector(disc, np.array([1.0]))[:, 0], frame.supports, frame.relative_gap)


def row_of(frame: Any, x: Array, share: Array, supports: Array, gap: float) -> list[float]:
    """A row of motion.csv from places x (n, 3), their shares (n,) of the reference area, and forces of supports."""
    force = float(np.linalg.norm(supports.sum(axis=0)))
    return [
        frame.moment.t,
        *(share @ x / share.sum()).tolist(),
        float(x[:, 1].min()),
        *astuple(frame.account),
        force,
        gap,
    ]


def peaks(run: MotionRun, frame: MotionFrame) -> list[float]:
    """The largest principal line load of a moment, N/mm, and utilisation of its rings, nan where it is not known."""
    solution = as_solution(run, frame)
    used = strength.utilisation(solution)
    load = float(solution.principal()[0].max(initial=0.0))
    return [load, np.nan if used is None else float(used.max(initial=0.0))]


def write_frames(folder: Path, run: MotionRun, frames: Sequence[MotionFrame]) -> None:
    """motion_0000.vtu and so on with motion.pvd, and where bodies are, as points and in bodies.csv."""
    import meshio

    entries, places = [], []
    for k, frame in enumerate(frames):
        tell(f"writing frames, {k} of {len(frames)}", k / len(frames))
        t = frame.moment.t
        entries.append((t, 0, f"motion_{k:04d}.vtu"))
        write_vtu(folder / entries[-1][2], as_solution(run, frame))
        if run.bodies:
            x, v = (one[frame.problem.disc.n_nodes :] for one in (frame.moment.x, frame.moment.v))
            data = {"radius_mm": np.array([body.radius for body in run.bodies]), "velocity_mm_per_s": v}
            entries.append((t, 1, f"bodies_{k:04d}.vtu"))
            points = meshio.Mesh(x, [("vertex", np.arange(len(x))[:, None])], point_data=data)
            write_mesh_file(folder / entries[-1][2], points)
            both = np.hstack([x, v]).tolist()
            places += [(t, body.name, *numbers) for body, numbers in zip(run.bodies, both, strict=True)]
    write_text(folder / "motion.pvd", collection(entries))
    if run.bodies:
        names = ("t_s", "body", "x_mm", "y_mm", "z_mm", "v_x_mm_per_s", "v_y_mm_per_s", "v_z_mm_per_s")
        write_text(folder / "bodies.csv", csv_text(names, places))


def summarize_motion(run: MotionRun, rows: Array) -> dict[str, Any]:
    """The numbers of summary.json from the `row` and the `peaks` of every step (m, 16)."""
    last, t = run.frames[-1], rows[:, 0]
    n, found = last.problem.disc.n_nodes, summary_of(run, rows, is_rigid=not is_elastic(last.problem.scene))
    for name, unit, values in (("line_load", "_N_per_mm", rows[:, -2]), ("utilisation", "", rows[:, -1])):
        if np.isfinite(values).all():
            found |= {f"peak_{name}{unit}": float(values.max()), f"peak_{name}_at_s": float(t[values.argmax()])}
    return found | {
        "bodies": [
            {"body": body.name, "mass_kg": body.mass, "end_mm": x.tolist(), "velocity_mm_per_s": v.tolist()}
            for body, x, v in zip(run.bodies, last.moment.x[n:], last.moment.v[n:], strict=True)
        ],
        "cells": last.problem.disc.n_cells,
        "element": last.problem.disc.element,
        "law": last.problem.law.name,
    }


def summary_of(run: Run[F], rows: Array, *, is_rigid: bool) -> dict[str, Any]:
    """What summary.json says of any run, from the rows of motion.csv (m, 14 or more)."""
    motion, t, force = motion_of(run.scene), rows[:, 0], rows[:, COLUMNS.index("support_force_N")]
    found = {
        "status": str(run.status),
        "message": run.message,
        "duration_s": motion.duration,
        "reached_s": float(t[-1]),
        "steps": len(rows) - 1,
        "scheme": motion.scheme,
        "forces": IMPULSES if is_rigid else FORCES,
        "peak_support_force_N": float(force.max()),
        "peak_support_force_at_s": float(t[force.argmax()]),
        "mean_end_mm": rows[-1, 1:4].tolist(),
        "lowest_point_mm": float(rows[-1, 4]),
        **{name: float(value) for name, value in zip(COLUMNS[5:12], rows[-1, 5:12], strict=True)},
        "account_error": account_error(rows),
        "relative_gap": float(rows[:, COLUMNS.index("relative_gap")].max()),
        "wall_s": run.wall_s,
        "versions": versions("scikit-fem", "scikit-sparse"),
    }
    return found | ({"peak_support_impulse_N_s": float((force[1:] * np.diff(t)).max(initial=0.0))} if is_rigid else {})


def account_error(rows: Array) -> float:
    """How far energies plus losses less work are from where they began, over the largest change of a term.

    At rest no term changes: there 1e-6 of the largest term counts.
    """
    terms = rows[:, 5:12] - rows[0, 5:12]
    balance = terms @ np.array([1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0])
    scale = max(float(np.abs(terms).max()), 1e-6 * float(np.abs(rows[:, 5:12]).max()), 1e-300)
    return float(np.abs(balance).max()) / scale


def write_kept(path: Path, scene: Scene, law: MembraneLaw, frames: Sequence[MotionFrame], rows: Array) -> None:
    """Write what a run goes on from: frames, the last one of the run at the end, and the rows of motion.csv."""
    pace = frames[-1].pace
    kept: dict[str, Any] = {"of": np.array(_name(scene, law)), "rows": rows, "pace": np.array([pace.h, pace.most])}
    each = [
        (one.moment.t, one.moment.x, one.moment.v, one.P, one.S, one.supports, astuple(one.account), one.relative_gap)
        for one in frames
    ]
    kept |= {name: np.array(values) for name, values in zip(FIELDS, zip(*each, strict=True), strict=True)}
    for name, moment in (("before", pace.before), ("last", pace.last)):
        if moment is not None:
            kept |= {f"{name}_t": np.array(moment.t), f"{name}_x": moment.x, f"{name}_v": moment.v}
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **kept)


def read_kept(path: Path, scene: Scene, law: MembraneLaw) -> tuple[tuple[MotionFrame, ...], Array]:
    """Frames and rows of a run of the same scene but for its duration; InputError for any other file."""
    try:
        with np.load(path, allow_pickle=False) as file:
            kept = dict(file)
        of, pace, rows = str(kept["of"]), kept["pace"], kept["rows"]
        parts = [kept[name] for name in FIELDS]
    except FileNotFoundError as error:
        raise InputError(f"--continue: {path} is missing: there is no run to go on with") from error
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise InputError(f"--continue: {path} is not what a run has kept: run again without it") from error
    if of != _name(scene, law):
        raise InputError(f"--continue: {path} is of another scene or law: only [motion] duration may differ")
    law = with_material(law, dict(scene.material), f"{scene.source}: [material]")
    stage = Stage(scene, law, build_mesh(scene_at(scene, 0.0), law.cell))
    frames = []
    for t, x, v, P, S, supports, account, gap in zip(*parts, strict=True):
        problem, _ = stage.at(float(t))
        own = Account(*account.tolist())
        frames.append(MotionFrame(Moment(float(t), x, v), P, S, own, supports, float(gap), problem, None))
    before, last = (
        Moment(float(kept[f"{name}_t"]), kept[f"{name}_x"], kept[f"{name}_v"]) if f"{name}_t" in kept else None
        for name in ("before", "last")
    )
    frames[-1] = frames[-1].paced(Pace(float(pace[0]), before, last, float(pace[1])))
    return tuple(frames), rows


def _name(scene: Scene, law: MembraneLaw) -> str:
    """A checksum of the scene without its duration and place, and of what its law answers."""
    told = replace(scene, motion=replace(motion_of(scene), duration=1e6), source=Path())
    probe = law.support(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.3, 2.0]]))
    return hashlib.sha256(f"{told!r} {law.cell!r} {probe.tolist()!r}".encode()).hexdigest()
