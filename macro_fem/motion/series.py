"""Files of anything in motion: motion.csv, a series for ParaView, summary.json; motion.npz, from which it goes on."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic
from zipfile import BadZipFile

import numpy as np

from homogenize import MembraneLaw
from macro_fem.motion.account import Account
from macro_fem.motion.pace import F, Pace, Run, motion_of
from macro_fem.motion.scheme import Moment
from macro_fem.output.files import collection
from macro_fem.output.pictures import Pictures
from macro_fem.scene.schema import Scene
from rve.common import Array, InputError, csv_text, json_text, tell
from rve.common.drawing.page import write_moments
from rve.common.drawing.space import save_animation
from rve.common.files import atomic_path, check_out_job, job, versions, write_text
from rve.common.meshes import write_mesh_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pyvista import Plotter

RECORD, KEPT = "summary.json", "motion.npz"
COLUMNS = (
    *("t_s", "mean_x_mm", "mean_y_mm", "mean_z_mm", "lowest_point_mm", "kinetic_N_mm", "potential_N_mm", "stored_N_mm"),
    *("work_N_mm", "lost_by_scheme_N_mm", "lost_by_locking_N_mm", "lost_by_damping_N_mm", "support_force_N"),
    "relative_gap",
)
"""Columns of motion.csv; support_force_N is the size of the sum of the forces of all supports."""
MOST_SHOWN, PANELS, IMAGES = 200, 4, 48
"""Moments at most in the series of VTUs, in motion.png, and in motion.gif and motion.html."""
IMPULSES = (
    "rings that lock do so by impulses: forces and line loads are those over each step divided by its length, and grow "
    'with shorter steps where something is struck; kind = "elastic" under [solver] gives forces'
)
FORCES = "at the ends of the steps, by the elasticity of the rings"

Kept = dict[str, Any]
"""Arrays by their names."""


@dataclass(frozen=True)
class Series(Generic[F]):
    """What is solved and written of one kind of frames.

    name: what answers. solve: the run from its beginning, or from a frame of a run before. row: of motion.csv, and
    numbers that the summary is made of. write_frame, write_views: a VTU, and pictures. pack, unpack: what is kept of
    frames beside their moments and accounts.
    """

    scene: Scene
    name: str
    solve: Callable[[F | None], Run[F]]
    row: Callable[[Run[F], F], list[float]]
    summary: Callable[[Run[F], Array], dict[str, Any]]
    write_frame: Callable[[Path, Run[F], F], None]
    write_views: Callable[[Path, Run[F], Sequence[F]], None]
    pack: Callable[[Sequence[F]], Kept]
    unpack: Callable[[Kept, Sequence[Moment], Sequence[Account]], list[F]]


def run_series(series: Series[F], out: Path, inputs: Sequence[Path | None], *, goes_on: bool = False) -> dict[str, Any]:
    """Solve a scene of [motion], write its files into `out` and return the summary.

    goes_on: from the end of the run whose files are in `out`, of the same scene but for its duration, and the same law.
    InputError in one sentence, and nothing written, for what cannot be read or begin.
    """
    check_out_job(out, RECORD, inputs=inputs)
    motion, before, rows = motion_of(series.scene), list[F](), list[Any]()
    if goes_on:
        before, rows = read_kept(out / KEPT, series)
        if before[-1].moment.t >= motion.duration * (1.0 - 1e-9):
            raise InputError(f"--continue: the run in {out} has come to its end; give a longer duration under [motion]")
    run = series.solve(before[-1] if before else None)
    table = np.array([*rows, *(series.row(run, frame) for frame in run.frames[1 if before else 0 :])])
    shown = chosen((*before[:-1], *run.frames))
    summary = series.summary(run, table) | {"frames": len(shown)}
    with job(out, RECORD, inputs) as folder:
        write_text(folder / "motion.csv", csv_text(COLUMNS, table[:, : len(COLUMNS)].tolist()))
        _write_frames(folder, series, run, shown)
        _write_kept(folder / KEPT, series, shown, table)
        series.write_views(folder, run, shown)
        write_text(folder / RECORD, json_text(summary))
    return summary


def chosen(frames: Sequence[F], most: int = MOST_SHOWN) -> list[F]:
    """At most so many frames, at times as even as the steps are, the first and the last among them."""
    t = np.array([frame.moment.t for frame in frames])
    which = np.arange(len(t))
    if len(t) > most:
        which = np.unique(np.abs(t[:, None] - np.linspace(t[0], t[-1], most)).argmin(axis=0))
    return [frames[int(k)] for k in which]


def write_moving(
    folder: Path,
    title: str,
    frames: Sequence[F],
    wanted: Pictures,
    drawn: Callable[[Sequence[F]], Iterable[tuple[str, Plotter]]],
    figures: Callable[[Sequence[F]], Iterable[Figure]],
) -> None:
    """Write motion.html, whose moments `drawn` draws, and motion.gif of `figures`, as far as they are wanted.

    motion.mp4 beside motion.gif where ffmpeg is installed.
    """
    some = chosen(frames, IMAGES)
    if wanted.html:
        write_moments(folder / "motion.html", drawn(some), title)
    if wanted.animation:
        save_animation(folder / "motion.gif", figures(some))
        if ffmpeg := shutil.which("ffmpeg"):
            even = "scale=trunc(iw/2)*2:trunc(ih/2)*2,format=yuv420p"  # what every player shows
            words = (ffmpeg, "-v", "quiet", "-i", folder / "motion.gif", "-vf", even, folder / "motion.mp4")
            subprocess.run(words, check=False)


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


def _write_frames(folder: Path, series: Series[F], run: Run[F], frames: Sequence[F]) -> None:
    """motion_0000.vtu and so on with motion.pvd, and where bodies are, as points and in bodies.csv."""
    import meshio

    entries, places = [], []
    for k, frame in enumerate(frames):
        tell(f"writing frames, {k} of {len(frames)}", k / len(frames))
        t = frame.moment.t
        entries.append((t, 0, f"motion_{k:04d}.vtu"))
        series.write_frame(folder / entries[-1][2], run, frame)
        if run.bodies:
            x, v = (one[-len(run.bodies) :] for one in (frame.moment.x, frame.moment.v))
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


def summary_of(run: Run[F], rows: Array, *, is_rigid: bool) -> dict[str, Any]:
    """What summary.json says of any run, from the rows of motion.csv (m, 14 or more)."""
    last = run.frames[-1].moment
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
    first = len(last.x) - len(run.bodies)
    found["bodies"] = [
        {"body": body.name, "mass_kg": body.mass, "end_mm": x.tolist(), "velocity_mm_per_s": v.tolist()}
        for body, x, v in zip(run.bodies, last.x[first:], last.v[first:], strict=True)
    ]
    return found | ({"peak_support_impulse_N_s": float((force[1:] * np.diff(t)).max(initial=0.0))} if is_rigid else {})


def account_error(rows: Array) -> float:
    """How far energies plus losses less work are from where they began, over the largest change of a term.

    At rest no term changes: there 1e-6 of the largest term counts.
    """
    terms = rows[:, 5:12] - rows[0, 5:12]
    balance = terms @ np.array([1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0])
    scale = max(float(np.abs(terms).max()), 1e-6 * float(np.abs(rows[:, 5:12]).max()), 1e-300)
    return float(np.abs(balance).max()) / scale


def _write_kept(path: Path, series: Series[F], frames: Sequence[F], rows: Array) -> None:
    """Write what a run goes on from: frames, the last one of the run at the end, and the rows of all steps."""
    pace, moments = frames[-1].pace, [one.moment for one in frames]
    kept: Kept = {"of": np.array(_checksum(series)), "rows": rows, "pace": np.array([pace.h, pace.most, pace.is_euler])}
    kept |= {name: np.array([getattr(one, name) for one in moments]) for name in ("t", "x", "v")}
    kept["account"] = np.array([astuple(one.account) for one in frames])
    if pace.last is not None:
        kept |= {f"last_{name}": np.array(getattr(pace.last, name)) for name in ("t", "x", "v")}
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **kept, **series.pack(frames))


def read_kept(path: Path, series: Series[F]) -> tuple[list[F], list[Any]]:
    """Frames and rows of a run of the same scene but for its duration; InputError for any other file."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            kept = dict(file)
        of, pace, rows = str(kept["of"]), kept["pace"], kept["rows"]
        accounts = [Account(*one.tolist()) for one in kept["account"]]
        moments = [Moment(float(t), x, v) for t, x, v in zip(kept["t"], kept["x"], kept["v"], strict=True)]
    except FileNotFoundError as error:
        raise InputError(f"--continue: {path} is missing: there is no run to go on with") from error
    except (OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error) as error:
        raise InputError(f"--continue: {path} is not what a run has kept: run again without it") from error
    if of != _checksum(series):
        raise InputError(f"--continue: {path} is of another scene or law: only [motion] duration may differ")
    frames = series.unpack(kept, moments, accounts)
    last = Moment(float(kept["last_t"]), kept["last_x"], kept["last_v"]) if "last_t" in kept else None
    frames[-1] = replace(frames[-1], pace=Pace(float(pace[0]), last, float(pace[1]), bool(pace[2])))
    return frames, list(rows)


def _checksum(series: Series[F]) -> str:
    """A checksum of the scene without its duration and place, and of what answers."""
    scene = series.scene
    told = replace(scene, motion=replace(motion_of(scene), duration=1e6), source=Path())
    times = [(getattr(item, "history", ()), getattr(item, "release", None)) for item in scene.items]  # not in a repr
    mesh = scene.mesh_file.read_bytes() if scene.mesh_file else b""
    return hashlib.sha256(f"{told!r} {times} {series.name}".encode() + mesh).hexdigest()


def named(law: MembraneLaw) -> str:
    """The rings of a law and what it answers."""
    probe = law.support(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.3, 2.0]]))
    return f"{law.cell!r} {probe.tolist()!r}"
