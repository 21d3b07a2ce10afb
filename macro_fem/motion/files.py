"""Files of anything in motion: motion.csv, a series for ParaView, summary.json, and motion.npz, from which it goes on.

All but pictures are in place after every step, so that a run that is killed loses none that is finished. Pictures are
drawn when the run has ended.
"""

import hashlib
import shutil
import subprocess
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from homogenize import MembraneLaw
from homogenize.laws import strength_of_law
from macro_fem.answer import RECORD, read_job
from macro_fem.motion.curtain import MovingCurtain
from macro_fem.motion.pace import COLUMNS, Frame, Mover, Run
from macro_fem.motion.rings import MovingRings
from macro_fem.motion.step import Account, Forces, Moment
from macro_fem.output.files import collection
from macro_fem.output.images import Draw, in_turn, save_animation, save_panels
from macro_fem.output.page import write_moments
from macro_fem.output.pictures import Drawings, Pictures, draw_all
from macro_fem.rings.every_ring import EveryRing
from macro_fem.scene.scene import Scene
from rve.common import Array, InputError, check_belongs, check_out_file, csv_text, json_text, read_json_object
from rve.common.files import HIDDEN, UNREADABLE, atomic_path, checksum, job, versions, write_mesh_file, write_text

KEPT = "motion.npz"
PICTURES = ("motion.png", "motion.html", "motion.gif", "motion.mp4")
MOST_SHOWN, PANELS, IMAGES = 200, 4, 48
"""Moments at most in the series of VTUs of a run, in motion.png, and in motion.gif and motion.html."""
RUNNING = "running"
"""Status of a run that has not ended, or was killed."""
IMPULSES = (
    "rings that lock do so by impulses: forces and line loads are those over each step divided by its length, and grow "
    'with shorter steps where something is struck; kind = "elastic" under [solver] gives forces'
)
AnyMover = Mover[Any, Any]
FORCES = "at the ends of the steps, by the elasticity of the rings"
BROKEN = (*UNREADABLE, EOFError, NotImplementedError, zipfile.BadZipFile)
"""What a damaged motion.npz raises."""


def run_motion(
    scene_path: Path, law_path: Path | None, out: Path, *, goes_on: bool = False, **how: Any
) -> dict[str, Any]:
    """Solve the scene of [motion] in a file, write its files into `out` and return the summary.

    goes_on: from the last step of the run whose files are in `out`, of the same scene but for its duration, and the
    same law. how: `picture`, `animation` and `html`, and for a scene that is solved ring by ring space and start of
    `EveryRing`. InputError in one sentence, and nothing written, for what cannot be read or begin; NotDrawn, after
    everything else is in place, for pictures that fail.
    """
    scene, law, inputs = read_job(scene_path, law_path, out)
    each_ring = {name: how.pop(name) for name in ("space", "start") if name in how}
    wanted = Pictures(**how, stem="motion")
    wanted.check(scene, in_space=True)
    mover: AnyMover = MovingRings(scene, EveryRing(law, **each_ring)) if each_ring else MovingCurtain(scene, law)
    log = Log(out, mover, _checksum(scene, law, each_ring.get("space")), inputs)
    run = mover.solve(log.resume() if goes_on else None, log.add)
    summary = log.finish(run)
    draw_all(out, RECORD, summary, _drawings(out, mover, list(log.shown.values()), wanted), inputs)
    return summary


class Log:
    """The files of a run in the folder `out`, in place after every step that is added.

    rows: the numbers of motion.csv and the `peaks` of every step. shown: the frames of the series by their steps.
    """

    def __init__(self, out: Path, mover: AnyMover, of: str, inputs: Sequence[Path | None]) -> None:
        assert mover.scene.motion is not None
        self.out, self.mover, self.of, self.inputs = out, mover, of, inputs
        self.rows, self.shown = list[list[float]](), dict[int, Any]()
        self.last: Any = None
        self.files: dict[str, str] = {}
        self.period, self.due = mover.motion.duration / (MOST_SHOWN - 1), 0

    def add(self, frame: Frame) -> None:
        """Write what a frame adds; the first one replaces what `out` held before."""
        number, row = len(self.rows), [*frame.row, *self.mover.peaks(frame)]
        if number and frame.moment.t <= self.rows[-1][0]:
            return  # that from which the run goes on
        self.rows.append(row)
        self.last = frame
        is_due = self._is_due(frame)
        if not number:
            with job(self.out, RECORD, self._record, self.inputs) as folder:
                self._write_table(folder)
                self._show(folder, 0, frame)
                self._keep(folder)
            return
        line = csv_text([str(one) for one in row[: len(COLUMNS)]], [])
        with (self.out / "motion.csv").open("a", encoding="utf-8", newline="") as file:
            file.write(line)
        self.table.update(line.encode())
        if is_due:
            self._show(self.out, number, frame)
        self._keep(self.out)
        self._write_record(self._record)

    def finish(self, run: Run[Any]) -> dict[str, Any]:
        """Write what the end of the run adds, all frames in one file among it; the summary."""
        if (number := len(self.rows) - 1) not in self.shown:
            self._show(self.out, number, self.last)
        self._write_table(self.out)
        self._keep(self.out, self.shown)
        self._remove(_names(one)[1] for one in self.shown)
        summary = summarize(self.mover, run, self.last, np.array(self.rows)) | {"frames": len(self.shown)}
        self._write_record(summary)
        return summary

    def resume(self) -> Frame:
        """The last frame of the run in `out`, whose files it takes over.

        InputError for a run of another scene or law, one that has come to its end, and for files that are damaged.
        """
        path, record, again = self.out / KEPT, self.out / RECORD, "run again without --continue"
        if not path.exists():
            raise InputError(f"--continue: {path} is missing: there is no run to go on with")
        before = read_json_object(record)
        if before.get("status") != RUNNING:
            check_belongs(path, record, before, again)
        kept = self._load(path)
        self.last = frame = self._unpack(kept)
        if frame.moment.t >= self.mover.motion.duration * (1.0 - 1e-9):
            words = "has come to its end; give a longer duration under [motion]"
            raise InputError(f"--continue: the run in {self.out} {words}")
        table, count = self.out / "motion.csv", len(kept["peaks"])
        try:
            self.rows = np.hstack(
                [np.loadtxt(table, delimiter=",", skiprows=1, ndmin=2, max_rows=count), kept["peaks"]]
            ).tolist()
        except (OSError, ValueError) as error:
            raise InputError(f"--continue: {table} does not hold the {count} steps of {path}: {again}") from error
        self.files = before["files"]
        for left in self.out.glob(f"{HIDDEN}*"):  # by a process that was killed
            shutil.rmtree(left, ignore_errors=True)
        self._remove(PICTURES)  # of fewer moments
        for number in kept["shown"].tolist():
            alone, one = _names(number)[1], _part(kept, f"shown_{number}_")
            if one:
                self._save(self.out, alone, one)
            self.shown[number] = self._unpack(one or self._load(self.out / alone))
            self._is_due(self.shown[number])
        self._write_table(self.out)
        self._write_series(self.out)
        self._keep(self.out)
        self._write_record(self._record)
        return frame

    @property
    def _record(self) -> dict[str, Any]:
        """What summary.json says of a run that has not ended."""
        message = (
            f"{self.rows[-1][0]:.6g} of {self.mover.motion.duration:g} s are solved; --continue goes on from there"
        )
        return {"status": RUNNING, "message": message, "reached_s": self.rows[-1][0], "steps": len(self.rows) - 1}

    def _is_due(self, frame: Frame) -> bool:
        """Whether a frame belongs to the series, of at most `MOST_SHOWN` moments as even as the steps are."""
        passed, self.due = self.due, int(frame.moment.t / self.period * (1.0 + 1e-9)) + 1
        return self.due > passed

    def _write_table(self, folder: Path) -> None:
        text = csv_text(COLUMNS, [row[: len(COLUMNS)] for row in self.rows])
        write_text(folder / "motion.csv", text)
        self.table = hashlib.sha256(text.encode())

    def _show(self, folder: Path, number: int, frame: Frame) -> None:
        """Add a frame to the series."""
        import meshio

        self.shown[number], balls = frame, self.mover.balls
        vtu, npz, bodies = _names(number)
        for name in (vtu, npz):
            check_out_file(folder / name, "--out", self.inputs)
        self.mover.write_vtu(folder / vtu, frame)
        self._save(folder, npz, _packed(self.mover, frame))
        if balls:
            x, v = (one[-len(balls) :] for one in (frame.moment.x, frame.moment.v))
            data = {"radius_mm": np.array([ball.radius for ball in balls]), "velocity_mm_per_s": v}
            points = meshio.Mesh(x, [("vertex", np.arange(len(x))[:, None])], point_data=data)
            write_mesh_file(folder / bodies, points)
            self.files[bodies] = checksum(folder / bodies)
        self.files[vtu] = checksum(folder / vtu)
        self._write_series(folder)

    def _write_series(self, folder: Path) -> None:
        """motion.pvd, which lists motion_0000.vtu and so on, and where bodies are, as points and in bodies.csv."""
        balls, entries, places = self.mover.balls, [], []
        for number, frame in self.shown.items():
            t, (vtu, _, bodies) = frame.moment.t, _names(number)
            entries += [(t, 0, vtu), *([(t, 1, bodies)] if balls else [])]
            both = np.hstack([frame.moment.x, frame.moment.v])[len(frame.moment.x) - len(balls) :].tolist()
            places += [(t, ball.name, *numbers) for ball, numbers in zip(balls, both, strict=True)]
        texts = {"motion.pvd": collection(entries)}
        if balls:
            names = ("t_s", "body", "x_mm", "y_mm", "z_mm", "v_x_mm_per_s", "v_y_mm_per_s", "v_z_mm_per_s")
            texts["bodies.csv"] = csv_text(names, places)
        for name, text in texts.items():
            write_text(folder / name, text)
            self.files[name] = hashlib.sha256(text.encode()).hexdigest()

    def _keep(self, folder: Path, shown: Mapping[int, Frame] = MappingProxyType({})) -> None:
        """Write what the run goes on from, after which the last step is in place; with frames of the series."""
        last = self.last
        kept: dict[str, Any] = {"h": last.h, "most": last.most, "is_euler": last.is_euler, "shown": list(self.shown)}
        kept["peaks"] = np.array(self.rows)[:, len(COLUMNS) :]
        if last.last is not None:
            kept |= {f"last_{name}": value for name, value in vars(last.last).items()}
        if last.forces is not None:
            kept |= {f"force_{name}": value for name, value in vars(last.forces).items()}
        for number, frame in shown.items():
            kept |= {f"shown_{number}_{name}": one for name, one in _packed(self.mover, frame).items()}
        self._save(folder, KEPT, kept | _packed(self.mover, last))
        self.files["motion.csv"] = self.table.hexdigest()

    def _remove(self, names: Iterable[str]) -> None:
        """Remove those of the files that the run has written."""
        for name in names:
            if self.files.pop(name, None):
                (self.out / name).unlink(missing_ok=True)

    def _write_record(self, record: dict[str, Any]) -> None:
        write_text(self.out / RECORD, json_text(record | {"files": self.files}))

    def _save(self, folder: Path, name: str, kept: dict[str, Any]) -> None:
        with atomic_path(folder / name) as temporary:
            np.savez(temporary, of=self.of, **kept)
        self.files[name] = checksum(folder / name)

    def _load(self, path: Path) -> dict[str, Any]:
        """The numbers of a file that `_save` has written; InputError for one of another scene or law, and damaged."""
        try:
            with np.load(path, allow_pickle=False) as file:
                kept = {name: one if one.ndim else one.item() for name, one in file.items()}
        except BROKEN as error:
            raise InputError(f"--continue: {path} is missing or damaged: run again without --continue") from error
        if kept.pop("of", None) != self.of:
            raise InputError(f"--continue: {path} is of another scene or law: only [motion] duration may differ")
        return kept

    def _unpack(self, kept: dict[str, Any]) -> Any:
        """The frame of `_packed`, and how the run goes on where that is in the file."""
        moment, account = Moment(kept["t"], kept["x"], kept["v"]), Account(*kept["account"].tolist())
        frame = self.mover.unpack(moment, account, _part(kept, "of_"))
        last, forces = _part(kept, "last_"), _part(kept, "force_")
        pace = {name: kept[name] for name in ("h", "most", "is_euler") if name in kept}
        return replace(
            frame, last=Moment(**last) if last else None, forces=Forces(**forces) if forces else None, **pace
        )


def _names(number: int) -> tuple[str, str, str]:
    """The files of a step in the series: the mesh, its numbers, and bodies."""
    return f"motion_{number:04d}.vtu", f"motion_{number:04d}.npz", f"bodies_{number:04d}.vtu"


def _part(kept: dict[str, Any], begin: str) -> dict[str, Any]:
    """The numbers whose names begin so, without the beginning."""
    return {name.removeprefix(begin): one for name, one in kept.items() if name.startswith(begin)}


def _packed(mover: AnyMover, frame: Frame) -> dict[str, Any]:
    """The numbers of a frame by name."""
    return (
        vars(frame.moment) | {"account": astuple(frame.account)} | {f"of_{k}": v for k, v in mover.pack(frame).items()}
    )


def chosen(frames: Sequence[Frame], most: int) -> list[Any]:
    """At most so many frames, at times as even as the steps are, the first and the last among them."""
    t = np.array([frame.moment.t for frame in frames])
    which = np.arange(len(t))
    if len(t) > most:
        which = np.unique(np.abs(t[:, None] - np.linspace(t[0], t[-1], most)).argmin(axis=0))
    return [frames[int(k)] for k in which]


def _drawings(out: Path, mover: AnyMover, frames: Sequence[Frame], wanted: Pictures) -> Drawings:
    """How to draw motion.png, motion.html and motion.gif, as far as they are wanted; motion.mp4 of the GIF in `out`
    where ffmpeg is installed."""

    def moments(most: int) -> list[tuple[str, Draw]]:
        some = chosen(frames, most)
        return [(f"{one.moment.t:.3f} s", draw) for one, draw in zip(some, mover.views(some), strict=True)]

    def draw_panels(path: Path) -> None:
        at, draws = zip(*moments(PANELS), strict=True)
        save_panels(path, draws, mover.scene.source.stem, at)

    def encode(path: Path) -> None:
        even = "scale=trunc(iw/2)*2:trunc(ih/2)*2,format=yuv420p"  # what every player shows
        words = (str(ffmpeg), "-v", "quiet", "-i", out / "motion.gif", "-vf", even, path)
        if subprocess.run(words, check=False).returncode:
            raise RuntimeError("ffmpeg failed")

    drawings: Drawings = {}
    if wanted.picture:
        drawings["motion.png"] = draw_panels
    if wanted.html:
        drawings["motion.html"] = lambda path: write_moments(path, in_turn(moments(IMAGES)), mover.scene.source.stem)
    if wanted.animation:
        drawings["motion.gif"] = lambda path: save_animation(path, in_turn(moments(IMAGES)))
        if ffmpeg := shutil.which("ffmpeg"):
            drawings["motion.mp4"] = encode
    return drawings


def summarize(mover: AnyMover, run: Run[Any], last: Frame, rows: Array) -> dict[str, Any]:
    """The numbers of summary.json from the last frame, and the `row` and the `peaks` of every step (m, 14 or more)."""
    t, force = rows[:, 0], rows[:, COLUMNS.index("support_force_N")]
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


def _checksum(scene: Scene, law: MembraneLaw, space: bool | None) -> str:
    """A checksum of the scene without its duration and place, and of the law, or its rings in space or not."""
    assert scene.motion is not None
    told = replace(scene, motion=replace(scene.motion, duration=1e6), source=Path())
    times = [(getattr(item, "history", ()), getattr(item, "release", None)) for item in scene.items]  # not in a repr
    mesh = scene.sheet_file.read_bytes() if scene.sheet_file else b""
    probe = law.support(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.3, 2.0]]))
    rings = law.cell, probe.tolist(), law.elastic().compliance.tolist(), strength_of_law(law)
    return hashlib.sha256(f"{told!r} {times} {space} {rings}".encode() + mesh).hexdigest()
