"""The answer that `macro_fem.solve` gives, whoever has been asked: a law, the rings on demand, or every ring."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from homogenize import MembraneLaw, default_law, load_law
from macro_fem.judged import support_rows
from macro_fem.motion_summary import MotionSummary
from macro_fem.output.pictures import Drawings, Pictures, draw_all
from macro_fem.ring_summary import EveryRingSummary
from macro_fem.scene.reading import load_scene
from macro_fem.scene.scene import Scene
from macro_fem.solvers.status import Status
from macro_fem.summary import CurtainSummary
from rve.common import check_out_job, checked, csv_text, digits, job, require, write_text
from rve.common.optional import Axes, DataFrame

RECORD = "summary.json"
"""The file that stands for the job; it lists the others by their checksums."""


def read_job(
    scene_path: Path, law_path: Path | None, out: Path, record: str = RECORD
) -> tuple[Scene, MembraneLaw, list[Path | None]]:
    """The scene and the law in files, by default that of `default_law`, and all files that are read; InputError for
    what cannot be read, and for a folder `out` that cannot be written into."""
    scene = load_scene(scene_path)
    inputs = [scene_path, law_path, scene.sheet_file]
    check_out_job(out, record, inputs=inputs)
    return scene, default_law() if law_path is None else load_law(law_path), inputs


class Solution(ABC):
    """A solved scene: status, summary, forces of supports, pictures, rings and files."""

    @property
    @abstractmethod
    def summary(self) -> CurtainSummary | EveryRingSummary | MotionSummary:
        """The numbers of summary.json: lengths in mm, forces in N, line loads in N per mm of reference length."""

    @checked
    def save(
        self,
        folder: str | Path,
        *,
        picture: bool = True,
        animation: bool = False,
        html: bool = False,
        inputs: Sequence[Path | None] = (),
    ) -> CurtainSummary | EveryRingSummary | MotionSummary:
        """Write summary.json, VTU and pictures into `folder`; the summary.

        By a law: curtain.vtu, support_forces.csv, order.csv, curtain.png, with more than one load step curtain.pvd with
        one VTU per step and, as `animation`, curtain.gif of them, with `html` curtain.html, which turns in a browser.
        Ring by ring: rings.vtu, support_forces.csv, rings.png, with `html` rings.html. In motion: motion.csv,
        motion.pvd with its VTUs, support_forces.csv of the weakest moment, motion.png, and as asked motion.gif and
        motion.html.

        All but pictures appear together, and what they replace is gone; pictures follow. InputError where files cannot
        be written, or would overwrite `inputs`, or if what a picture needs is missing; NotDrawn, when all else is in
        place, for pictures that fail.
        """
        drawings, summary = self.drawings(Pictures(picture, animation, html)), self.summary
        with job(folder, RECORD, summary, inputs) as staged:
            self._write(staged)
            write_text(staged / "support_forces.csv", csv_text(*support_rows(summary.support_forces)))
        draw_all(folder, RECORD, summary, drawings, inputs)
        return summary

    @abstractmethod
    def drawings(self, wanted: Pictures) -> Drawings:
        """How to draw the wanted pictures; InputError for those without sense, and if what they need is missing."""

    @abstractmethod
    def _write(self, staged: Path) -> None:
        """Write the data that this answer alone has into a new folder."""

    @abstractmethod
    def plot(self, ax: Axes | None = None) -> Axes:
        """The answer in the plane, on `ax` or axes of their own (matplotlib)."""

    @abstractmethod
    def write_html(self, path: str | Path) -> None:
        """Write the answer as one HTML file that turns in a browser without a network; InputError without plotly."""

    @abstractmethod
    def rings(self) -> Any:
        """Every ring with its place, tilt and largest contact force."""

    @property
    def status(self) -> Status:
        """How the answer ended."""
        return Status(self.summary.status)

    @property
    def message(self) -> str:
        """What the status means, and what to try."""
        return self.summary.message

    @property
    def safety_factor(self) -> float | None:
        """Factor on all loads at which the first ring would yield; None where the strength is not known."""
        return self.summary.safety_factor

    def support_forces(self) -> DataFrame:
        """The force of each held point on the curtain as a pandas DataFrame with the columns of support_forces.csv."""
        require("pandas", "notebook", "support_forces()", "read support_forces.csv in another way")
        from pandas import DataFrame

        columns, rows = support_rows(self.summary.support_forces)
        return DataFrame(rows, columns=list(columns))

    def __str__(self) -> str:
        words = [f"Solution: {self.status}", f"mean height {self.summary.mean_height_mm:.3f} mm"]
        if (holds := self.summary.get("holds")) is not None:
            factor = self.summary.get("governing_factor", self.summary.get("smallest_factor"))
            most = "at most " if self.summary.get("utilisation_too_low") else ""
            words.append("holds" if holds else "does not hold")
            words += [] if factor is None else [f"factor {most}{digits(factor)}"]
        return ", ".join(words)

    __repr__ = __str__
