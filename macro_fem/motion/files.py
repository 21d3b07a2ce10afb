"""Files of a curtain in motion: its rows, VTUs and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from homogenize import default_law, load_law, with_material
from macro_fem.curtain import is_elastic
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.cells import padded
from macro_fem.motion.account import Account
from macro_fem.motion.run import MotionFrame, MotionRun, solve_motion
from macro_fem.motion.scheme import Moment
from macro_fem.motion.series import Kept, Series, named, row_of, run_series, summary_of
from macro_fem.motion.stage import Stage, scene_at
from macro_fem.motion.views import as_solution, write_views
from macro_fem.output import strength
from macro_fem.output.files import write_vtu
from macro_fem.output.pictures import Pictures
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.schema import load_scene
from rve.common import Array

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
            MotionFrame(moment, P, S, account, supports, float(gap), stage.at(moment.t)[0], None)
            for moment, account, P, S, supports, gap in each
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
