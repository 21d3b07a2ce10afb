"""What is kept of a run: the numbers of every step, frames that are shown, the weakest one; its summary and data."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from macro_fem.motion.pace import COLUMNS, PACE, Frame, Mover, Run
from macro_fem.motion_summary import BodyEnd, MotionNumbers, MotionSummary
from macro_fem.output.files import collection
from rve.common import Array, csv_text, versions, write_text
from rve.common.files import checksum, write_mesh_file

MOST_SHOWN = 200
"""Moments at most in the series of VTUs of a run, beside the last and the weakest one."""
IMPULSES = (
    "rings that lock do so by impulses: forces and line loads are those over each step divided by its length, and grow "
    'with shorter steps where something is struck; kind = "elastic" under [solver] gives forces'
)
FORCES = "at the ends of the steps, by the elasticity of the rings"
AnyMover = Mover[Any, Any]


class Series:
    """Frames of a run as they come. rows: the numbers of motion.csv and the `peaks` of every step; shown: frames by
    their steps; the last frame, and the weakest one, of the largest last peak."""

    def __init__(self, mover: AnyMover) -> None:
        self.mover = mover
        self.rows, self.shown = list[list[float]](), dict[int, Any]()
        self.last: Any = None
        self.weakest: Any = None
        self.period, self.due = mover.motion.duration / (MOST_SHOWN - 1), 0

    def add(self, frame: Frame) -> bool:
        """Whether a frame is a new one; one that a run goes on from is not."""
        if self.rows and frame.moment.t <= self.rows[-1][0]:
            return False
        row, worst = [*frame.row, *self.mover.peaks(frame)], max((one[-1] for one in self.rows), default=-np.inf)
        self.rows.append(row)
        self.last = frame
        if row[-1] > worst:
            self.weakest = frame
        if self.is_due(frame):
            self.shown[len(self.rows) - 1] = frame
        return True

    def is_due(self, frame: Frame) -> bool:
        """Whether a frame belongs to the series, of at most `MOST_SHOWN` moments as even as the steps are."""
        passed, self.due = self.due, int(frame.moment.t / self.period * (1.0 + 1e-9)) + 1
        return self.due > passed

    @property
    def weakest_step(self) -> int:
        """The step of the weakest frame."""
        return int(np.argmax([row[-1] for row in self.rows]))

    def finish(self) -> list[int]:
        """The steps that are shown now beside those before: the last one and the weakest."""
        ends = {len(self.rows) - 1: self.last, self.weakest_step: self.weakest}
        new = {number: frame for number, frame in ends.items() if number not in self.shown}
        self.shown = dict(sorted((self.shown | new).items()))
        return list(new)

    def table_text(self) -> str:
        """The text of motion.csv."""
        return csv_text(COLUMNS, [row[: len(COLUMNS)] for row in self.rows])

    def write_frame(self, folder: Path, number: int) -> dict[str, str]:
        """Write a frame that is shown as VTU, and its bodies; checksums by name."""
        import meshio

        frame, balls, (vtu, _, bodies) = self.shown[number], self.mover.balls, names(number)
        self.mover.write_vtu(folder / vtu, frame)
        if balls:
            x, v = (one[-len(balls) :] for one in (frame.moment.x, frame.moment.v))
            data = {"radius_mm": np.array([ball.radius for ball in balls]), "velocity_mm_per_s": v}
            points = meshio.Mesh(x, [("vertex", np.arange(len(x))[:, None])], point_data=data)
            write_mesh_file(folder / bodies, points)
        return {name: checksum(folder / name) for name in (vtu, *([bodies] if balls else []))}

    def write_lists(self, folder: Path) -> dict[str, str]:
        """Write motion.pvd, which lists motion_0000.vtu and so on, and where bodies are, as points and in bodies.csv;
        checksums by name."""
        balls, entries, places = self.mover.balls, [], []
        for number, frame in self.shown.items():
            t, (vtu, _, bodies) = frame.moment.t, names(number)
            entries += [(t, 0, vtu), *([(t, 1, bodies)] if balls else [])]
            both = np.hstack([frame.moment.x, frame.moment.v])[len(frame.moment.x) - len(balls) :].tolist()
            places += [(t, ball.name, *numbers) for ball, numbers in zip(balls, both, strict=True)]
        texts = {"motion.pvd": collection(entries)}
        if balls:
            columns = ("t_s", "body", "x_mm", "y_mm", "z_mm", "v_x_mm_per_s", "v_y_mm_per_s", "v_z_mm_per_s")
            texts["bodies.csv"] = csv_text(columns, places)
        for name, text in texts.items():
            write_text(folder / name, text)
        return {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()}

    def summary(self, run: Run[Any]) -> MotionSummary:
        """The numbers of summary.json."""
        mover, last, rows = self.mover, self.last, np.array(self.rows)
        t, kinetic, scheme = rows[:, 0], rows[:, 5], float(rows[-1, COLUMNS.index("lost_by_scheme_N_mm")])
        force, first = rows[:, COLUMNS.index("support_force_N")], len(last.moment.x) - len(mover.balls)
        struck, most = impacts(rows), float(kinetic.max())
        impulse = float((force[1:] * np.diff(t)).max(initial=0.0)) if mover.is_rigid else None
        told = MotionNumbers(
            status=run.status,
            message=run.message,
            duration_s=mover.motion.duration,
            reached_s=float(t[-1]),
            steps=len(rows) - 1,
            frames=len(self.shown),
            scheme=mover.motion.scheme,
            mean_height_mm=float(rows[-1, 2]),
            lowest_point_mm=float(rows[-1, 4]),
            forces=IMPULSES if mover.is_rigid else FORCES,
            peak_support_force_N=float(force.max()),
            peak_support_force_at_s=float(t[force.argmax()]),
            peak_support_impulse_N_s=impulse,
            **{name: float(value) for name, value in zip(COLUMNS[5:12], rows[-1, 5:12], strict=True)},
            lost_by_scheme_share=scheme / most if most > 0.0 else None,
            account_error=account_error(rows),
            impacts=int(np.count_nonzero(struck)),
            largest_impact_at_s=float(t[1:][struck.argmax()]) if struck.any() else None,
            relative_gap=float(rows[:, COLUMNS.index("relative_gap")].max()),
            notes=mover.notes,
            wall_s=run.wall_s,
            versions=versions("scikit-fem", "scikit-sparse"),
            bodies=tuple(
                BodyEnd(body=ball.name, mass_kg=ball.mass, end_mm=x.tolist(), velocity_mm_per_s=v.tolist())
                for ball, x, v in zip(mover.balls, last.moment.x[first:], last.moment.v[first:], strict=True)
            ),
        )
        return mover.summary(told, last, self.weakest, t, rows[:, len(COLUMNS) :])


def impacts(rows: Array) -> Array:
    """What each step (m - 1,) loses as rings lock or something is touched, 0 where smooth motion gives it back."""
    most = float(rows[:, 5].max())
    locking, scheme = (np.diff(rows[:, COLUMNS.index(f"lost_by_{one}_N_mm")]) for one in ("locking", "scheme"))
    is_lost = (locking > PACE.least_impact * most) & (locking + scheme > PACE.impact * locking)
    return np.where(is_lost, locking, 0.0)


def account_error(rows: Array) -> float:
    """How far energies plus losses less work are from where they began, over the largest change of a term.

    At rest no term changes: there 1e-6 of the largest term counts.
    """
    terms = rows[:, 5:12] - rows[0, 5:12]
    balance = terms @ np.array([1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0])
    scale = max(float(np.abs(terms).max()), 1e-6 * float(np.abs(rows[:, 5:12]).max()), 1e-300)
    return float(np.abs(balance).max()) / scale


def chosen(frames: Sequence[Frame], most: int, weakest: Frame) -> list[Any]:
    """At most so many frames and the weakest one, at times as even as the steps are, the first and the last among
    them."""
    t = np.array([frame.moment.t for frame in frames])
    which = np.arange(len(t))
    if len(t) > most:
        even = np.abs(t[:, None] - np.linspace(t[0], t[-1], most)).argmin(axis=0)
        worst = int(np.abs(t - weakest.moment.t).argmin())
        inner = even[1:-1]
        if most > 2 and worst not in even:
            inner[int(np.abs(t[inner] - t[worst]).argmin())] = worst
        which = np.unique(even)
    return [frames[int(k)] for k in which]


def names(number: int) -> tuple[str, str, str]:
    """The files of a step in the series: the mesh, its numbers, and bodies."""
    return f"motion_{number:04d}.vtu", f"motion_{number:04d}.npz", f"bodies_{number:04d}.vtu"
