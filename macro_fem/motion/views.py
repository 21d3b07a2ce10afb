"""A curtain in motion as curtains at rest: motion.png with some moments side by side, motion.gif, and motion.html."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from macro_fem.fem.assembly import internal_force
from macro_fem.motion.pace import F
from macro_fem.motion.run import MotionFrame, MotionRun
from macro_fem.motion.stage import let_go
from macro_fem.output import plots
from macro_fem.output.pictures import Pictures, write_animation
from macro_fem.output.space_view import PictureFrame, Titled, draw_curtain, drawn
from macro_fem.scene.obstacles import Sphere
from macro_fem.scene.tables import Item, Support
from macro_fem.solution import CurtainSolution, InnerForces
from macro_fem.solvers.status import Evidence
from rve.common.drawing.page import write_moments
from rve.common.drawing.plane import save_figure
from rve.common.drawing.space import new_plotter, save_picture

MOST_SHOWN, PANELS, IMAGES = 200, 4, 48
"""Moments at most in the series of VTUs, in motion.png, and in motion.gif and motion.html."""


def as_solution(run: MotionRun, frame: MotionFrame) -> CurtainSolution:
    """The curtain at a frame, with balls as obstacles of the scene and without supports that have let go.

    Its load is what line loads and supports balance: outer forces, pushes, and those of inertia.
    """
    problem, n = frame.problem, frame.problem.disc.n_nodes
    gone = let_go(run.scene, frame.moment.t)
    kept: list[Item] = [item for number, item in enumerate(problem.scene.support) if number not in gone]
    kept += [item for item in problem.scene.items if not isinstance(item, Support)]
    for ball, place in zip(run.bodies, frame.moment.x[n:], strict=True):
        kept.append(Sphere(tuple(place), ball.radius, name=ball.name))
    scene = replace(problem.scene, items=tuple(kept))
    force = internal_force(problem.disc, frame.P) - frame.supports
    told = replace(problem, scene=scene, force=force, walls=None, winds=())
    inner, asked = InnerForces(frame.P, frame.S, 0.0, np.zeros(0)), Evidence(1.0, 1.0, 1.0)
    return CurtainSolution(told, "converged", asked, frame.moment.x[:n], inner, 0.0, 0.0, frame.iterations, run.wall_s)


def chosen(frames: Sequence[F], most: int = MOST_SHOWN) -> list[F]:
    """At most so many frames, at times as even as the steps are, the first and the last among them."""
    t = np.array([frame.moment.t for frame in frames])
    which = np.arange(len(t))
    if len(t) > most:
        which = np.unique(np.abs(t[:, None] - np.linspace(t[0], t[-1], most)).argmin(axis=0))
    return [frames[int(k)] for k in which]


def write_views(folder: Path, run: MotionRun, frames: Sequence[MotionFrame], wanted: Pictures) -> None:
    """Write the wanted pictures into `folder`; motion.mp4 beside motion.gif where ffmpeg is installed."""

    def told(most: int) -> Titled:
        return [(f"{one.moment.t:.3f} s", as_solution(run, one)) for one in chosen(frames, most)]

    if wanted.html:
        write_moments(folder / "motion.html", drawn(told(IMAGES)), run.scene.source.stem)
    if wanted.picture and run.scene.in_space:
        steps = told(PANELS)
        view, plotter = PictureFrame.of([one for _, one in steps]), new_plotter(len(steps))
        for panel, (_, solution) in enumerate(steps):
            plotter.subplot(0, panel)
            draw_curtain(solution, plotter, view)
        save_picture(folder / "motion.png", plotter, "at " + ", ".join(words for words, _ in steps))
    elif wanted.picture:
        save_figure(folder / "motion.png", plots.side_by_side(told(PANELS)))
    if wanted.animation:
        write_animation(folder / "motion.gif", told(IMAGES))
        if ffmpeg := shutil.which("ffmpeg"):
            even = "scale=trunc(iw/2)*2:trunc(ih/2)*2,format=yuv420p"  # what every player shows
            words = (ffmpeg, "-v", "quiet", "-i", folder / "motion.gif", "-vf", even, folder / "motion.mp4")
            subprocess.run(words, check=False)
