"""Pictures of a curtain in motion: motion.png with some moments side by side, motion.gif, and motion.html."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from macro_fem.motion.run import MotionFrame, MotionRun
from macro_fem.motion.shown import as_solution, chosen
from macro_fem.output import plots
from macro_fem.output.pictures import Pictures
from macro_fem.output.space_view import PictureFrame, draw_curtain, line_load_scale
from macro_fem.solution import CurtainSolution
from rve.common.drawing.page import write_moments
from rve.common.drawing.plane import new_figure, save_figure
from rve.common.drawing.space import FRAME_MS, compose, new_plotter, save_animation, save_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pyvista import Plotter

PANELS, IMAGES = 4, 48
"""Moments in motion.png, and images of motion.gif."""


def write_views(folder: Path, run: MotionRun, frames: Sequence[MotionFrame], wanted: Pictures) -> None:
    """Write the wanted pictures into `folder`; motion.mp4 beside motion.gif where ffmpeg is installed."""
    in_space, picture, animation = run.scene.in_space, wanted.picture, wanted.animation
    if wanted.html:
        steps = told(run, chosen(tuple(frames), IMAGES))
        write_moments(folder / "motion.html", _drawn(steps), run.scene.source.stem)
    if picture:
        steps = told(run, chosen(tuple(frames), PANELS))
        if in_space:
            _save_panels(folder / "motion.png", steps)
        else:
            _save_plane(folder / "motion.png", steps)
    if animation:
        steps = told(run, chosen(tuple(frames), IMAGES))
        save_animation(folder / "motion.gif", _images(steps) if in_space else plane_images(steps))
        _save_film(folder / "motion.gif", folder / "motion.mp4")


Told = list[tuple[str, CurtainSolution]]


def told(run: MotionRun, frames: Sequence[MotionFrame]) -> Told:
    """Frames as solutions with their times in words."""
    return [(f"{frame.moment.t:.3f} s", as_solution(run, frame)) for frame in frames]


def _save_panels(path: Path, steps: Told) -> None:
    view, plotter = PictureFrame.of([one for _, one in steps]), new_plotter(len(steps))
    for panel, (_, solution) in enumerate(steps):
        plotter.subplot(0, panel)
        draw_curtain(solution, plotter, view)
    save_picture(path, plotter, "at " + ", ".join(words for words, _ in steps))


def _save_film(gif: Path, film: Path) -> None:
    """An animation as MP4, which browsers and presentations play, where ffmpeg is installed."""
    from matplotlib.animation import FFMpegWriter
    from matplotlib.figure import Figure
    from PIL import Image, ImageSequence

    if not FFMpegWriter.isAvailable():
        return
    writer = FFMpegWriter(fps=round(1000 / FRAME_MS), codec="h264")
    with Image.open(gif) as images:
        figure = Figure(figsize=(images.width / 100, images.height / 100))
        with writer.saving(figure, str(film), dpi=100):
            for image in ImageSequence.Iterator(images):
                figure.clear()
                figure.figimage(np.asarray(image.convert("RGB")))
                writer.grab_frame()


def _drawn(steps: Told) -> Iterator[tuple[str, Plotter]]:
    """A plotter at each moment, on one scale."""
    view, plotter = PictureFrame.of([one for _, one in steps]), new_plotter()
    for words, solution in steps:
        yield words, draw_curtain(solution, plotter, view)
        plotter.clear_actors()
    plotter.close()


def _images(steps: Told) -> Iterator[Figure]:
    for words, plotter in _drawn(steps):
        yield compose(plotter, words)


def _save_plane(path: Path, steps: Told) -> None:
    scale = line_load_scale([one for _, one in steps])
    figure = new_figure(5.2 * len(steps), 6.0)
    for ax, (words, solution) in zip(figure.subplots(1, len(steps), squeeze=False)[0], steps, strict=True):
        plots.plot_line_loads(solution, ax, scale=scale).set_title(words, fontsize=11)
    save_figure(path, figure)


def plane_images(steps: Told) -> Iterator[Figure]:
    """Figures of the moments of a curtain in its plane."""
    for (words, _), figure in zip(steps, plots.frames([one for _, one in steps]), strict=True):
        figure.axes[0].set_title(words, fontsize=11)
        yield figure
