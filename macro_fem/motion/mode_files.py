"""Files of natural frequencies: modes.json, the shapes in modes.vtu and as modes.png."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from homogenize import default_law, load_law
from macro_fem.curtain import solve_scene
from macro_fem.elastic_forces import forces_by, with_forces
from macro_fem.fem.cells import counterclockwise, padded
from macro_fem.motion.modes import Modes, find_modes
from macro_fem.motion.stage import scene_at
from macro_fem.output.files import corner_positions
from macro_fem.scene.schema import load_scene
from rve.common import check_out_job, job, json_text, versions, write_text
from rve.common.drawing.scale import Scale
from rve.common.drawing.space import THREE_QUARTERS, add, check_render, look, new_plotter, save_picture, surface
from rve.common.meshes import write_mesh_file

RECORD = "modes.json"
SHOWN = 0.15
"""The largest displacement of a shape in pictures over the size of the curtain."""


def run_modes(
    scene_path: Path, law_path: Path | None, out: Path, *, number: int = 6, picture: bool = True
) -> dict[str, Any]:
    """Find natural frequencies of the scene in a file, write modes.json, modes.vtu and modes.png; the summary.

    Line loads are those of elastic rings where rigid ones leave them open. InputError in one sentence for what cannot
    be read or told, NotConverged where the curtain at rest is none.
    """
    if picture:
        check_render("modes.png", "ask for --no-picture")
    scene = load_scene(scene_path)
    inputs = [scene_path, law_path, scene.mesh_file]
    check_out_job(out, RECORD, inputs=inputs)
    law = default_law() if law_path is None else load_law(law_path)
    found = with_forces(solve_scene(scene if scene.motion is None else scene_at(scene, 0.0), law))
    modes, problem = find_modes(found, number), found.problem
    summary = modes.summary | {"forces_by": forces_by(found), "cells": problem.disc.n_cells, "law": problem.law.name}
    summary |= {"wall_s": found.wall_s, "versions": versions("scikit-fem", "scikit-sparse")}
    with job(out, RECORD, inputs) as folder:
        write_shapes(folder, modes, picture=picture)
        write_text(folder / RECORD, json_text(summary))
    return summary


def write_shapes(folder: Path, modes: Modes, *, picture: bool) -> None:
    """modes.vtu, each shape as point data `shape_1_FREQUENCY_Hz` and so on, on the curtain at rest; with `picture`
    modes.png, the shapes side by side, each at `SHOWN` of the size of the curtain."""
    import meshio

    problem, rest = modes.solution.problem, padded(corner_positions(modes.solution))
    cells = counterclockwise(problem.mesh.mesh.p.T, problem.mesh.mesh.t.T)
    shapes = [shape[: len(rest)] for shape in modes.shapes]
    names = [f"shape_{k}_{one:.5g}_Hz" for k, one in enumerate(modes.frequencies_Hz, 1)]
    fields = dict(zip(names, shapes, strict=True))
    write_mesh_file(folder / "modes.vtu", meshio.Mesh(rest, [("triangle", cells)], point_data=fields))
    if not picture:
        return
    plotter, scale = new_plotter(len(shapes)), Scale("displacement over the largest", 0.0, 1.0, 1.0)
    for panel, shape in enumerate(shapes):
        plotter.subplot(0, panel)
        drawn = surface(rest + SHOWN * problem.mesh.size * shape, cells)
        drawn[scale.label] = np.linalg.norm(shape, axis=1)
        add(plotter, f"shape {panel + 1}", drawn, scale)
        look(plotter, THREE_QUARTERS)
    save_picture(folder / "modes.png", plotter, ", ".join(f"{one:.3g}" for one in modes.frequencies_Hz) + " Hz")
