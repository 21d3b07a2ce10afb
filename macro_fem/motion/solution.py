"""A scene in motion as an answer: its summary with the verdict, pictures, files."""

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from homogenize import MembraneLaw
from macro_fem.answer import Solution
from macro_fem.motion.curtain import MovingCurtain
from macro_fem.motion.pace import COLUMNS, Run
from macro_fem.motion.rings import MovingRings, RingFrame
from macro_fem.motion.series import AnyMover, Series, chosen
from macro_fem.motion_summary import MotionSummary
from macro_fem.output.html_page import check_page, write_moments
from macro_fem.output.images import Draw, in_turn, save_animation, save_panels
from macro_fem.output.pictures import Drawings, Pictures
from macro_fem.output.sentences import motion_verdict
from macro_fem.rings.every_ring import EveryRing
from macro_fem.scene.scene import Scene
from rve.common import InputError, check_out_file, checked, digits, write_text
from rve.common.drawing.plane import new_axes
from rve.common.optional import Axes
from rve.finite import FiniteSolution

PANELS, IMAGES, REPORTED = 4, 48, 3
"""Moments at most in motion.png, in motion.gif and motion.html, and in a report."""


@dataclass(frozen=True, eq=False, repr=False)
class MotionSolution(Solution):
    """A scene in motion: what moved, what is kept of its steps, and how the run ended."""

    mover: AnyMover
    series: Series
    run: Run[Any]

    @cached_property
    def summary(self) -> MotionSummary:
        return self.series.summary(self.run)

    def moments(self, most: int) -> list[tuple[str, Draw]]:
        """At most so many moments with their times, and how to draw them."""
        series = self.series
        some = chosen(list(series.shown.values()), most, series.weakest)
        why = "the largest force of a point" if self.summary.smallest_factor is None else "the weakest moment"
        weakest = {series.weakest.moment.t: f", {why}"}
        titles = (f"{one.moment.t:.3f} s{weakest.get(one.moment.t, '')}" for one in some)
        return list(zip(titles, self.mover.views(some), strict=True))

    @property
    def title(self) -> str:
        """What pages are headed by: the scene, and the verdict."""
        return f"{self.mover.scene.source.stem}: {motion_verdict(self.summary)}"

    def drawings(self, wanted: Pictures) -> Drawings:
        """Of motion.png, motion.html and motion.gif, and of motion.mp4 beside the GIF where ffmpeg is installed."""
        replace(wanted, stem="motion").check(self.mover.scene, in_space=True)
        film = b""

        def draw_panels(path: Path) -> None:
            at, draws = zip(*self.moments(PANELS), strict=True)
            save_panels(path, draws, motion_verdict(self.summary), at)

        def animate(path: Path) -> None:
            nonlocal film
            save_animation(path, in_turn(self.moments(IMAGES)))
            film = path.read_bytes()

        def encode(path: Path) -> None:
            even = "scale=trunc(iw/2)*2:trunc(ih/2)*2,format=yuv420p"  # what every player shows
            words = (str(ffmpeg), "-v", "quiet", "-f", "gif", "-i", "-", "-vf", even, path)
            if subprocess.run(words, check=False, input=film).returncode:
                raise RuntimeError("ffmpeg failed")

        drawings: Drawings = {}
        if wanted.picture:
            drawings["motion.png"] = draw_panels
        if wanted.html:
            drawings["motion.html"] = self.write_html
        if wanted.animation:
            drawings["motion.gif"] = animate
            if ffmpeg := shutil.which("ffmpeg"):
                drawings["motion.mp4"] = encode
        return drawings

    def _write(self, staged: Path) -> None:
        write_text(staged / "motion.csv", self.series.table_text())
        for number in self.series.shown:
            self.series.write_frame(staged, number)
        self.series.write_lists(staged)

    def plot(self, ax: Axes | None = None) -> Axes:
        """The force of all supports over time, on `ax` or axes of their own (matplotlib)."""
        ax, rows, summary = new_axes() if ax is None else ax, np.array(self.series.rows), self.summary
        force = rows[:, COLUMNS.index("support_force_N")]
        ax.plot(rows[:, 0], force, color="black", lw=1.2)
        label = f"largest: {digits(summary.peak_support_force_N, 4)} N at {summary.peak_support_force_at_s:.4g} s"
        ax.plot(summary.peak_support_force_at_s, summary.peak_support_force_N, "o", color="#d7263d", label=label)
        if summary.smallest_factor is not None:
            ax.axvline(summary.at_s, color="0.45", ls="--", lw=0.9, label=motion_verdict(summary))
        ax.set(xlabel="t, s", ylabel="force of all supports, N", ylim=(0.0, None))
        ax.legend(frameon=False, fontsize=9)
        return ax

    def write_html(self, path: str | Path) -> None:
        """Write some moments with a slider as one HTML file; InputError without plotly."""
        check_out_file(path, "path")
        check_page(str(path))
        write_moments(path, in_turn(self.moments(IMAGES)), self.title)

    @checked
    def write_report(self, path: str | Path, inputs: Sequence[Path | None] = ()) -> None:
        """Write a report as PDF: verdict, force over time, moments, forces at the weakest one, limits, checksums of
        `inputs`; InputError without typst (extra `report`) or pyvista."""
        Pictures(picture=False, report=Path(path)).check(inputs=inputs, in_space=True)
        from macro_fem.motion_report import write_motion_report

        write_motion_report(path, self.mover.scene, self.summary, self.plot, self.moments(REPORTED), inputs)

    def rings(self) -> FiniteSolution:
        """Every ring at the end, of a scene solved ring by ring; InputError of one by a law."""
        if isinstance(last := self.series.last, RingFrame):
            return last.rings
        raise InputError("rings: of a curtain in motion by a law are not placed; solve(scene, EveryRing()) moves them")


def mover_of(scene: Scene, who: MembraneLaw | EveryRing) -> AnyMover:
    """What moves in a scene."""
    return MovingRings(scene, who) if isinstance(who, EveryRing) else MovingCurtain(scene, who)


def solve_motion(scene: Scene, who: MembraneLaw | EveryRing) -> MotionSolution:
    """A scene over its [motion], by a law or ring by ring.

    InputError and NotConverged for what cannot begin; a step that fails ends the run with a status, as Ctrl-C does.
    """
    mover = mover_of(scene, who)
    series = Series(mover)
    run = mover.solve(take=series.add)
    series.finish()
    return MotionSolution(mover, series, run)
