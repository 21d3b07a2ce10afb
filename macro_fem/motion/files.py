"""Files of a run: motion.csv, a series for ParaView, summary.json, and motion.npz, from which it goes on.

All but pictures are in place after every step, so that a run that is killed loses none that is finished. Pictures are
drawn when the run has ended.
"""

import hashlib
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
from macro_fem.judged import support_rows
from macro_fem.motion.pace import COLUMNS, Frame, Kept
from macro_fem.motion.series import AnyMover, Series, names
from macro_fem.motion.solution import MotionSolution, mover_of
from macro_fem.motion.step import Account, Forces, Moment
from macro_fem.motion_summary import MotionSummary, Running
from macro_fem.output.pictures import Pictures, draw_all
from macro_fem.rings.every_ring import EveryRing
from macro_fem.scene.scene import Scene
from macro_fem.summary import Summary
from rve.common import InputError, check_belongs, check_out_file, csv_text, json_text, read_json_object
from rve.common.files import UNREADABLE, atomic_path, checksum, clear_parts, job, write_text

KEPT, FORMAT = "motion.npz", 2
"""What a run goes on from, and its format."""
PICTURES = ("motion.png", "motion.html", "motion.gif", "motion.mp4")
FORCES = "support_forces.csv"
RUNNING = "running"
"""Status of a run that has not ended, or was killed."""
BROKEN = (*UNREADABLE, EOFError, NotImplementedError, zipfile.BadZipFile)
"""What a damaged motion.npz raises."""


def run_motion(
    scene_path: Path, law_path: Path | None, out: Path, *, goes_on: bool = False, **how: Any
) -> MotionSummary:
    """Solve the scene of [motion] in a file, write its files into `out` and return the summary.

    goes_on: from the last step of the run whose files are in `out`, of the same scene but for its duration, and the
    same law. how: `picture`, `animation`, `html` and the path of a `report`, and for a scene solved ring by ring space
    and start of `EveryRing`. InputError in one sentence, and nothing written, for what cannot be read or begin;
    NotDrawn, after everything else is in place, for pictures that fail.
    """
    scene, law, inputs = read_job(scene_path, law_path, out)
    each_ring = {name: how.pop(name) for name in ("space", "start") if name in how}
    wanted = Pictures(**how, stem="motion")
    wanted.check(scene, inputs, in_space=True)
    mover = mover_of(scene, EveryRing(law, **each_ring) if each_ring else law)
    log = Log(out, mover, _checksum(scene, law, each_ring.get("space")), inputs)
    answer = MotionSolution(mover, log.series, mover.solve(log.resume() if goes_on else None, log.add))
    summary = log.finish(answer)
    drawings = answer.drawings(wanted)
    if wanted.report is not None:
        drawings[str(wanted.report.absolute())] = lambda path: answer.write_report(path, inputs)
    draw_all(out, RECORD, summary, drawings, inputs)
    return summary


class Log:
    """The files of a run in the folder `out`, in place after every step that is added."""

    def __init__(self, out: Path, mover: AnyMover, of: str, inputs: Sequence[Path | None]) -> None:
        self.out, self.mover, self.of, self.inputs = out, mover, of, inputs
        self.series = Series(mover)
        self.files: dict[str, str] = {}

    def add(self, frame: Frame) -> None:
        """Write what a frame adds; the first one replaces what `out` held before."""
        series, number = self.series, len(self.series.rows)
        if not series.add(frame):
            return
        if not number:
            with job(self.out, RECORD, self._record, self.inputs) as folder:
                self._write_table(folder)
                self._show(folder, 0)
                self._keep(folder)
            return
        line = csv_text([str(one) for one in series.rows[-1][: len(COLUMNS)]], [])
        with (self.out / "motion.csv").open("a", encoding="utf-8", newline="") as file:
            file.write(line)
        self.table.update(line.encode())
        if number in series.shown:
            self._show(self.out, number)
        self._keep(self.out)
        self._write_record(self._record)

    def finish(self, answer: MotionSolution) -> MotionSummary:
        """Write what the end of the run adds, all frames in one file among it; the summary."""
        for number in self.series.finish():
            self._show(self.out, number)
        self._write_table(self.out)
        self._keep(self.out, self.series.shown)
        self._remove(names(one)[1] for one in self.series.shown)
        text = csv_text(*support_rows(answer.summary.support_forces))
        write_text(self.out / FORCES, text)
        self.files[FORCES] = hashlib.sha256(text.encode()).hexdigest()
        self._write_record(answer.summary)
        return answer.summary

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
        series, weakest = self.series, _part(kept, "weakest_")
        series.last = series.weakest = frame = self._unpack(kept)
        if weakest:
            series.weakest = self._unpack(weakest)
        if frame.moment.t >= self.mover.motion.duration * (1.0 - 1e-9):
            words = "has come to its end; give a longer duration under [motion]"
            raise InputError(f"--continue: the run in {self.out} {words}")
        table, count = self.out / "motion.csv", len(kept["peaks"])
        try:
            series.rows = np.hstack(
                [np.loadtxt(table, delimiter=",", skiprows=1, ndmin=2, max_rows=count), kept["peaks"]]
            ).tolist()
        except (OSError, ValueError) as error:
            raise InputError(f"--continue: {table} does not hold the {count} steps of {path}: {again}") from error
        self.files = before["files"]
        clear_parts(self.out)
        self._remove([*PICTURES, FORCES])  # of fewer moments
        for number in kept["shown"].tolist():
            alone, one = names(number)[1], _part(kept, f"shown_{number}_")
            if one:
                self._save(self.out, alone, one)
            series.shown[number] = self._unpack(one or self._load(self.out / alone))
            series.is_due(series.shown[number])
        self._write_table(self.out)
        self.files |= series.write_lists(self.out)
        self._keep(self.out)
        self._write_record(self._record)
        return frame

    @property
    def _record(self) -> Running:
        """What summary.json says of a run that has not ended."""
        reached, steps = self.series.rows[-1][0], len(self.series.rows) - 1
        message = f"{reached:.6g} of {self.mover.motion.duration:g} s are solved; --continue goes on from there"
        return Running(status=RUNNING, message=message, reached_s=reached, steps=steps)

    def _write_table(self, folder: Path) -> None:
        text = self.series.table_text()
        write_text(folder / "motion.csv", text)
        self.table = hashlib.sha256(text.encode())

    def _show(self, folder: Path, number: int) -> None:
        """Write a frame of the series."""
        vtu, npz, _ = names(number)
        for name in (vtu, npz):
            check_out_file(folder / name, "--out", self.inputs)
        files = self.series.write_frame(folder, number)
        self._save(folder, npz, _packed(self.mover, self.series.shown[number]))
        self.files |= files | self.series.write_lists(folder)

    def _keep(self, folder: Path, shown: Mapping[int, Frame] = MappingProxyType({})) -> None:
        """Write what the run goes on from, after which the last step is in place; with frames of the series."""
        series, last = self.series, self.series.last
        kept: Kept = {"h": last.h, "most": last.most, "is_euler": last.is_euler, "shown": list(series.shown)}
        kept["peaks"] = np.array(series.rows)[:, len(COLUMNS) :]
        if series.weakest is not last:
            kept |= {f"weakest_{name}": one for name, one in _packed(self.mover, series.weakest).items()}
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

    def _write_record(self, record: Summary) -> None:
        write_text(self.out / RECORD, json_text({**record, "files": self.files}))

    def _save(self, folder: Path, name: str, kept: Kept) -> None:
        with atomic_path(folder / name) as temporary:
            np.savez(temporary, of=self.of, **kept)
        self.files[name] = checksum(folder / name)

    def _load(self, path: Path) -> Kept:
        """The numbers of a file that `_save` has written; InputError for one of another scene or law, and damaged."""
        try:
            with np.load(path, allow_pickle=False) as file:
                kept = {name: one if one.ndim else one.item() for name, one in file.items()}
        except BROKEN as error:
            raise InputError(f"--continue: {path} is missing or damaged: run again without --continue") from error
        if kept.pop("of", None) != self.of:
            raise InputError(
                f"--continue: {path} is of another scene or law, or version: only [motion] duration may differ"
            )
        return kept

    def _unpack(self, kept: Kept) -> Any:
        """The frame of `_packed`, and how the run goes on where that is in the file."""
        moment, account = Moment(kept["t"], kept["x"], kept["v"]), Account(*kept["account"].tolist())
        frame = self.mover.unpack(moment, account, _part(kept, "of_"))
        last, forces = _part(kept, "last_"), _part(kept, "force_")
        pace = {name: kept[name] for name in ("h", "most", "is_euler") if name in kept}
        return replace(
            frame, last=Moment(**last) if last else None, forces=Forces(**forces) if forces else None, **pace
        )


def _part(kept: Kept, begin: str) -> Kept:
    """The numbers whose names begin so, without the beginning."""
    return {name.removeprefix(begin): one for name, one in kept.items() if name.startswith(begin)}


def _packed(mover: AnyMover, frame: Frame) -> Kept:
    """The numbers of a frame by name."""
    return (
        vars(frame.moment) | {"account": astuple(frame.account)} | {f"of_{k}": v for k, v in mover.pack(frame).items()}
    )


def _checksum(scene: Scene, law: MembraneLaw, space: bool | None) -> str:
    """A checksum of the scene without its duration and place, and of the law, or its rings in space or not."""
    assert scene.motion is not None
    told = replace(scene, motion=replace(scene.motion, duration=1e6), source=Path())
    times = [(item.history, item.release) for item in scene.items]  # not in a repr
    mesh = scene.sheet_file.read_bytes() if scene.sheet_file else b""
    probe = law.support(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.3, 2.0]]))
    rings = FORMAT, law.cell, probe.tolist(), law.elastic().compliance.tolist(), strength_of_law(law)
    return hashlib.sha256(f"{told!r} {times} {space} {rings}".encode() + mesh).hexdigest()
