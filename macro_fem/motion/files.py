"""Files of a curtain in motion: its rows, VTUs and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from homogenize import default_law, load_law, with_material
from macro_fem.curtain import is_elastic
from macro_fem.fem.assembly import internal_force, load_vector
from macro_fem.fem.cells import padded
from macro_fem.motion.account import Account
from macro_fem.motion.run import MotionFrame, MotionRun, solve_motion
from macro_fem.motion.scheme import Moment
from macro_fem.motion.series import (
    PANELS,
    Kept,
    Series,
    chosen,
    named,
    row_of,
    run_series,
    summary_of,
    write_moving,
)  # fmt: skip
from macro_fem.motion.stage import Stage, let_go, scene_at
from macro_fem.output import plots, strength
from macro_fem.output.files import write_vtu
from macro_fem.output.pictures import Pictures, figures
from macro_fem.output.space_view import PictureFrame, Titled, draw_curtain, drawn
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.obstacles import Sphere
from macro_fem.scene.schema import load_scene
from macro_fem.scene.sites import Support
from macro_fem.scene.tables import Item
from macro_fem.solution import CurtainSolution, InnerForces
from macro_fem.solvers.status import Evidence
from rve.common import Array
from rve.common.drawing.plane import save_figure
from rve.common.drawing.space import THREE_QUARTERS, look, new_plotter, save_picture

FIELDS = ("P", "S", "supports", "relative_gap")
"""What motion.npz has of each frame beside its moment and account."""


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
    """Solve the scene of [motion] in a file, write its files into `out` and return the summary; see `run_series`."""
    scene, wanted = load_scene(scene_path), Pictures(picture, animation, html, stem="motion")
    wanted.check(scene)
    law = default_law() if law_path is None else load_law(law_path)

    def unpack(kept: Kept, moments: Sequence[Moment], accounts: Sequence[Account]) -> list[MotionFrame]:
        own = with_material(law, dict(scene.material), f"{scene.source}: [material]")
        stage = Stage(scene, own, build_mesh(scene_at(scene, 0.0), own.cell))
        each = zip(moments, accounts, *(kept[name] for name in FIELDS), strict=True)
        return [
            MotionFrame(
                moment=moment, account=account, problem=stage.at(moment.t)[0], **dict(zip(FIELDS, more, strict=True))
            )
            for moment, account, *more in each
        ]

    series = Series(
        scene,
        named(law),
        lambda start: solve_motion(scene, law, start),
        lambda run, frame: row(run, frame) + peaks(run, frame),
        summarize_motion,
        lambda path, run, frame: write_vtu(path, as_solution(run, frame)),
        lambda folder, run, shown: write_views(folder, run, shown, wanted),
        lambda frames: {name: np.array([getattr(one, name) for one in frames]) for name in FIELDS},
        unpack,
    )
    return run_series(series, out, [scene_path, law_path, scene.mesh_file], goes_on=goes_on)


def row(run: MotionRun, frame: MotionFrame) -> list[float]:
    """A row of motion.csv."""
    disc, x = frame.problem.disc, padded(frame.moment.x[: frame.problem.disc.n_nodes])
    return row_of(frame, x, load_vector(disc, np.array([1.0]))[:, 0], frame.supports, frame.relative_gap)


def peaks(run: MotionRun, frame: MotionFrame) -> list[float]:
    """The largest principal line load of a moment, N/mm, and utilisation of its rings, nan where it is not known."""
    solution = as_solution(run, frame)
    used = strength.utilisation(solution)
    load = float(solution.principal()[0].max(initial=0.0))
    return [load, np.nan if used is None else float(used.max(initial=0.0))]


def summarize_motion(run: MotionRun, rows: Array) -> dict[str, Any]:
    """The numbers of summary.json from the `row` and the `peaks` of every step (m, 16)."""
    last, t = run.frames[-1], rows[:, 0]
    found = summary_of(run, rows, is_rigid=not is_elastic(last.problem.scene))
    for name, unit, values in (("line_load", "_N_per_mm", rows[:, -2]), ("utilisation", "", rows[:, -1])):
        if np.isfinite(values).all():
            found |= {f"peak_{name}{unit}": float(values.max()), f"peak_{name}_at_s": float(t[values.argmax()])}
    return found | {
        "cells": last.problem.disc.n_cells,
        "element": last.problem.disc.element,
        "law": last.problem.law.name,
    }


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


def write_views(folder: Path, run: MotionRun, frames: Sequence[MotionFrame], wanted: Pictures) -> None:
    """Write the wanted pictures into `folder`."""

    def told(some: Sequence[MotionFrame]) -> Titled:
        return [(f"{one.moment.t:.3f} s", as_solution(run, one)) for one in some]

    title = run.scene.source.stem
    write_moving(folder, title, frames, wanted, lambda some: drawn(told(some)), lambda some: figures(told(some)))
    steps = told(chosen(frames, PANELS))
    if wanted.picture and run.scene.in_space:
        view, plotter = PictureFrame.of([one for _, one in steps]), new_plotter(len(steps))
        for panel, (_, solution) in enumerate(steps):
            plotter.subplot(0, panel)
            draw_curtain(solution, plotter, view)
        ends = np.reshape([one.bounds for one in plotter.renderers], (-1, 3, 2))
        for panel in range(len(steps)):
            plotter.subplot(0, panel)
            look(plotter, THREE_QUARTERS, box=np.stack([ends[:, :, 0].min(axis=0), ends[:, :, 1].max(axis=0)]))
        save_picture(folder / "motion.png", plotter, "at " + ", ".join(words for words, _ in steps))
    elif wanted.picture:
        save_figure(folder / "motion.png", plots.side_by_side(steps))
