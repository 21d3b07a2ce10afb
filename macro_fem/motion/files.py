"""Files of anything in motion: motion.csv, a series for ParaView, summary.json, pictures, and motion.npz, from which it
goes on."""

import hashlib
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np

from homogenize import MembraneLaw, strength_of_law
from macro_fem.answer import RECORD, read_job
from macro_fem.motion.curtain import MovingCurtain
from macro_fem.motion.pace import COLUMNS, Frame, Mover, Run
from macro_fem.motion.rings import MovingRings
from macro_fem.motion.step import Account, Moment
from macro_fem.output.files import collection
from macro_fem.output.images import Draw, in_turn, save_animation, save_panels
from macro_fem.output.page import write_moments
from macro_fem.output.pictures import Pictures
from macro_fem.rings.every_ring import EveryRing
from macro_fem.scene.scene import Scene
from rve.common import Array, InputError, check_belongs, csv_text, read_json_object, tell
from rve.common.files import atomic_path, job, versions, write_mesh_file, write_text

KEPT = "motion.npz"
MOST_SHOWN, PANELS, IMAGES = 200, 4, 48
"""Moments at most in the series of VTUs, in motion.png, and in motion.gif and motion.html."""
IMPULSES = (
    "rings that lock do so by impulses: forces and line loads are those over each step divided by its length, and grow "
    'with shorter steps where something is struck; kind = "elastic" under [solver] gives forces'
)
AnyMover = Mover[Any, Any]
FORCES = "at the ends of the steps, by the elasticity of the rings"


def run_motion(
    scene_path: Path, law_path: Path | None, out: Path, *, goes_on: bool = False, **how: Any
) -> dict[str, Any]:
    """Solve the scene of [motion] in a file, write its files into `out` and return the summary.

    goes_on: from the end of the run whose files are in `out`, of the same scene but for its duration, and the same law.
    how: `picture`, `animation` and `html`, and for a scene that is solved ring by ring space and start of `EveryRing`.
    InputError in one sentence, and nothing written, for what cannot be read or begin.
    """
    scene, law, inputs = read_job(scene_path, law_path, out)
    each_ring = {name: how.pop(name) for name in ("space", "start") if name in how}
    wanted = Pictures(**how, stem="motion")
    wanted.check(scene, in_space=True)
    mover: AnyMover = MovingRings(scene, EveryRing(law, **each_ring)) if each_ring else MovingCurtain(scene, law)
    of, before, rows = _checksum(scene, law, each_ring.get("space")), list[Frame](), list[Any]()
    if goes_on:
        before, rows = read_kept(out / KEPT, mover, of)
        if before[-1].moment.t >= mover.motion.duration * (1.0 - 1e-9):
            raise InputError(f"--continue: the run in {out} has come to its end; give a longer duration under [motion]")
    run = mover.solve(before[-1] if before else None)
    new = run.frames[1 if before else 0 :]
    table = np.array([*rows, *([*frame.row, *mover.peaks(frame)] for frame in new)])
    shown = chosen((*before[:-1], *run.frames), MOST_SHOWN)
    summary = summarize(mover, run, table) | {"frames": len(shown)}
    with job(out, RECORD, summary, inputs) as folder:
        write_text(folder / "motion.csv", csv_text(COLUMNS, table[:, : len(COLUMNS)].tolist()))
        _write_frames(folder, mover, shown)
        _write_kept(folder / KEPT, mover, of, shown, table)
        _write_pictures(folder, mover, shown, wanted)
    return summary


def chosen(frames: Sequence[Frame], most: int) -> list[Any]:
    """At most so many frames, at times as even as the steps are, the first and the last among them."""
    t = np.array([frame.moment.t for frame in frames])
    which = np.arange(len(t))
    if len(t) > most:
        which = np.unique(np.abs(t[:, None] - np.linspace(t[0], t[-1], most)).argmin(axis=0))
    return [frames[int(k)] for k in which]


def _write_pictures(folder: Path, mover: AnyMover, frames: Sequence[Frame], wanted: Pictures) -> None:
    """motion.png, motion.html and motion.gif, as far as they are wanted; motion.mp4 where ffmpeg is installed."""

    def moments(some: Sequence[Frame]) -> list[tuple[str, Draw]]:
        return [(f"{one.moment.t:.3f} s", draw) for one, draw in zip(some, mover.views(some), strict=True)]

    if wanted.picture:
        at, draws = zip(*moments(chosen(frames, PANELS)), strict=True)
        save_panels(folder / "motion.png", draws, f"at {', '.join(at)}")
    some = moments(chosen(frames, IMAGES)) if wanted.html or wanted.animation else []
    if wanted.html:
        write_moments(folder / "motion.html", in_turn(some), mover.scene.source.stem)
    if wanted.animation:
        save_animation(folder / "motion.gif", in_turn(some))
        if ffmpeg := shutil.which("ffmpeg"):
            even = "scale=trunc(iw/2)*2:trunc(ih/2)*2,format=yuv420p"  # what every player shows
            words = (ffmpeg, "-v", "quiet", "-i", folder / "motion.gif", "-vf", even, folder / "motion.mp4")
            subprocess.run(words, check=False)


def _write_frames(folder: Path, mover: AnyMover, frames: Sequence[Frame]) -> None:
    """motion_0000.vtu and so on with motion.pvd, and where bodies are, as points and in bodies.csv."""
    import meshio

    balls, entries, places = mover.balls, [], []
    for k, frame in enumerate(frames):
        tell(f"writing frames, {k} of {len(frames)}")
        t = frame.moment.t
        entries.append((t, 0, f"motion_{k:04d}.vtu"))
        mover.write_vtu(folder / entries[-1][2], frame)
        if balls:
            x, v = (one[-len(balls) :] for one in (frame.moment.x, frame.moment.v))
            data = {"radius_mm": np.array([ball.radius for ball in balls]), "velocity_mm_per_s": v}
            entries.append((t, 1, f"bodies_{k:04d}.vtu"))
            points = meshio.Mesh(x, [("vertex", np.arange(len(x))[:, None])], point_data=data)
            write_mesh_file(folder / entries[-1][2], points)
            both = np.hstack([x, v]).tolist()
            places += [(t, ball.name, *numbers) for ball, numbers in zip(balls, both, strict=True)]
    write_text(folder / "motion.pvd", collection(entries))
    if balls:
        names = ("t_s", "body", "x_mm", "y_mm", "z_mm", "v_x_mm_per_s", "v_y_mm_per_s", "v_z_mm_per_s")
        write_text(folder / "bodies.csv", csv_text(names, places))


def summarize(mover: AnyMover, run: Run[Any], rows: Array) -> dict[str, Any]:
    """The numbers of summary.json from the `row` and the `peaks` of every step (m, 14 or more)."""
    last, t, force = run.frames[-1], rows[:, 0], rows[:, COLUMNS.index("support_force_N")]
    first = len(last.moment.x) - len(mover.balls)
    ends = zip(mover.balls, last.moment.x[first:], last.moment.v[first:], strict=True)
    found = {
        "status": run.status,
        "message": run.message,
        "duration_s": mover.motion.duration,
        "reached_s": float(t[-1]),
        "steps": len(rows) - 1,
        "scheme": mover.motion.scheme,
        "forces": IMPULSES if mover.is_rigid else FORCES,
        "peak_support_force_N": float(force.max()),
        "peak_support_force_at_s": float(t[force.argmax()]),
        "lowest_point_mm": float(rows[-1, 4]),
        **{name: float(value) for name, value in zip(COLUMNS[5:12], rows[-1, 5:12], strict=True)},
        "account_error": account_error(rows),
        "relative_gap": float(rows[:, COLUMNS.index("relative_gap")].max()),
        "wall_s": run.wall_s,
        "versions": versions("scikit-fem", "scikit-sparse"),
        "bodies": [
            {"body": ball.name, "mass_kg": ball.mass, "end_mm": x.tolist(), "velocity_mm_per_s": v.tolist()}
            for ball, x, v in ends
        ],
    }
    if mover.is_rigid:
        found["peak_support_impulse_N_s"] = float((force[1:] * np.diff(t)).max(initial=0.0))
    return found | mover.summary(last, t, rows[:, len(COLUMNS) :])


def account_error(rows: Array) -> float:
    """How far energies plus losses less work are from where they began, over the largest change of a term.

    At rest no term changes: there 1e-6 of the largest term counts.
    """
    terms = rows[:, 5:12] - rows[0, 5:12]
    balance = terms @ np.array([1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0])
    scale = max(float(np.abs(terms).max()), 1e-6 * float(np.abs(rows[:, 5:12]).max()), 1e-300)
    return float(np.abs(balance).max()) / scale


def _write_kept(path: Path, mover: AnyMover, of: str, frames: Sequence[Frame], rows: Array) -> None:
    """Write what a run goes on from: frames, the last one of the run at the end, and the rows of all steps."""
    end = frames[-1]
    kept: dict[str, Any] = {"of": of, "rows": rows, "h": end.h, "most": end.most, "is_euler": end.is_euler}
    for k, frame in enumerate(frames):
        told = vars(frame.moment) | {"account": astuple(frame.account)} | mover.pack(frame)
        kept |= {f"{name}_{k}": value for name, value in told.items()}
    if end.last is not None:
        kept |= {f"{name}_last": value for name, value in vars(end.last).items()}
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **kept)


def read_kept(path: Path, mover: AnyMover, of: str) -> tuple[list[Any], list[Any]]:
    """Frames and rows of a run of the same scene but for its duration; InputError for any other file, and for one that
    the record beside it does not list by its checksum."""
    if not path.exists():
        raise InputError(f"--continue: {path} is missing: there is no run to go on with")
    record = path.with_name(RECORD)
    check_belongs(path, record, read_json_object(record), "run again without --continue")
    with np.load(path, allow_pickle=False) as file:
        kept = {name: one if one.ndim else one.item() for name, one in file.items()}
    if kept.pop("of") != of:
        raise InputError(f"--continue: {path} is of another scene or law: only [motion] duration may differ")
    rows, pace = list(kept.pop("rows")), {name: kept.pop(name) for name in ("h", "most", "is_euler")}
    parts: dict[str, dict[str, Any]] = {}
    for name, one in kept.items():
        own, _, number = name.rpartition("_")
        parts.setdefault(number, {})[own] = one
    moments = {number: Moment(one.pop("t"), one.pop("x"), one.pop("v")) for number, one in parts.items()}
    last = moments.pop("last", None)
    frames = [
        mover.unpack(moments[k], Account(*parts[k].pop("account").tolist()), parts[k])
        for k in map(str, range(len(moments)))
    ]
    frames[-1] = replace(frames[-1], last=last, **pace)
    return frames, rows


def _checksum(scene: Scene, law: MembraneLaw, space: bool | None) -> str:
    """A checksum of the scene without its duration and place, and of the law, or its rings in space or not."""
    assert scene.motion is not None
    told = replace(scene, motion=replace(scene.motion, duration=1e6), source=Path())
    times = [(getattr(item, "history", ()), getattr(item, "release", None)) for item in scene.items]  # not in a repr
    mesh = scene.sheet_file.read_bytes() if scene.sheet_file else b""
    probe = law.support(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.3, 2.0]]))
    rings = law.cell, probe.tolist(), law.elastic().compliance.tolist(), strength_of_law(law)
    return hashlib.sha256(f"{told!r} {times} {space} {rings}".encode() + mesh).hexdigest()
