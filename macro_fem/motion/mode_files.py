"""Files of natural frequencies: modes.json, the shapes in modes.vtu and as modes.png."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from homogenize import default_law, load_law
from macro_fem.curtain import solve_scene
from macro_fem.elastic_forces import forces_by, with_forces
from macro_fem.fem.cells import as_triangles, counterclockwise, padded
from macro_fem.motion.modes import Modes, find_modes
from macro_fem.motion.stage import scene_at
from macro_fem.output.files import VTU_CELLS, corner_positions
from macro_fem.scene.schema import load_scene
from rve.common.drawing.scale import Scale
from rve.common.drawing.space import THREE_QUARTERS, add, check_render, look, new_plotter, save_picture, surface
from rve.common.files import check_out_job, job, versions, write_text
from rve.common.meshes import write_mesh_file
from rve.common.texts import json_text
from rve.common.types import Array

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
    modes = find_modes(found, number)
    summary = modes.summary | {"forces_by": forces_by(found), "cells": found.problem.disc.n_cells}
    summary |= {
        "law": found.problem.law.name,
        "wall_s": found.wall_s,
        "versions": versions("scikit-fem", "scikit-sparse"),
    }
    with job(out, RECORD, inputs) as folder:
        write_shapes(folder / "modes.vtu", modes)
        if picture:
            draw_shapes(folder / "modes.png", modes)
        write_text(folder / RECORD, json_text(summary))
    return summary


def _at_corners(modes: Modes, shape: Array) -> Array:
    """Corners of the curtain at rest moved by a shape (n_nodes, 3) times 1 mm, (n_corners, 3) mm."""
    found = modes.solution
    return padded(corner_positions(replace(found, x=found.x + shape[:, : found.x.shape[1]])))


def write_shapes(path: Path, modes: Modes) -> None:
    """Each shape as point data `shape_1_FREQUENCY_Hz` and so on, on the curtain at rest."""
    import meshio

    mesh, rest = modes.solution.problem.mesh.mesh, padded(corner_positions(modes.solution))
    names = [f"shape_{k}_{one:.5g}_Hz" for k, one in enumerate(modes.frequencies_Hz, 1)]
    shapes = [in_space(modes, shape) for shape in modes.shapes]
    cells = [(VTU_CELLS[modes.solution.problem.disc.element], counterclockwise(mesh.p.T, mesh.t.T))]
    write_mesh_file(path, meshio.Mesh(rest, cells, point_data=dict(zip(names, shapes, strict=True))))


def in_space(modes: Modes, shape: Array) -> Array:
    """The displacements (n_corners, 3) of a shape (n_nodes, 3) at the corners of the mesh."""
    flat = modes.solution.problem.fem.d == 2
    moved = _at_corners(modes, shape[:, [2, 2, 2]] if flat else shape) - padded(corner_positions(modes.solution))
    return np.column_stack([0.0 * moved[:, :2], moved[:, 0]]) if flat else moved


def draw_shapes(path: Path, modes: Modes) -> None:
    """The shapes side by side, each at `SHOWN` of the size of the curtain."""
    found = modes.solution
    mesh, rest = found.problem.mesh.mesh, padded(corner_positions(found))
    corners = as_triangles(counterclockwise(mesh.p.T, mesh.t.T))[0]
    plotter, scale = new_plotter(len(modes.shapes)), Scale("displacement over the largest", 0.0, 1.0, 1.0)
    for panel, shape in enumerate(modes.shapes):
        plotter.subplot(0, panel)
        way = in_space(modes, shape)
        drawn = surface(rest + SHOWN * found.problem.mesh.size * way, corners)
        drawn[scale.label] = np.linalg.norm(way, axis=1)
        add(plotter, f"shape {panel + 1}", drawn, scale)
        look(plotter, THREE_QUARTERS)
    save_picture(path, plotter, ", ".join(f"{one:.3g}" for one in modes.frequencies_Hz) + " Hz")
