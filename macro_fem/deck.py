"""A scene at rest for another solver: mesh, supports, loads, steps and user material for CalculiX; and its answer.

Triangles are CPS3 in the plane, M3D3 in space. The sheet starts flat with all loads on it and an even tension that
fades while the law stiffens (`UMAT_USER` in homogenize/export/umat.f). All loads are nodal forces of our own mesh, so
that both solvers hold the same curtain.
"""

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from homogenize import MembraneLaw
from homogenize.export import even_law, umat_source
from macro_fem.answer import read_job
from macro_fem.curtain import CurtainProblem, forces_by, make_problem
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.cells import counterclockwise
from macro_fem.job import solve_membrane
from macro_fem.scene.checks import check_scene, check_sizes
from macro_fem.scene.loads import meet
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.scene import Scene
from rve.common import Array, InputError, JsonObject, filled, job, part_of, versions, write_text
from rve.geometry import padded

RECORD = "deck.json"
THICKNESS = 10.0
"""Nominal thickness in mm of the elements; stresses times it are line loads. Larger: normals of cells in space are
stiffer, which have no other effect."""
COMPILE = "gfortran -O2 -std=legacy -w -c umat.f"
AGREE = 0.01
"""Forces of supports agree that differ by less than this part of the largest one."""
OPEN = (
    "balance leaves open how these supports share the load, above all sideways: ours is that of elastic rings, theirs "
    "follows from the rounding of the law, which is softer; single points and hooks that slide agree"
)
LINK = "gfortran -fopenmp -o ccx {0}/main.o umat.o {0}/ccx.a -lspooles -larpack -llapack -lblas -lpthread"


@dataclass(frozen=True)
class CalculixRun:
    """What CalculiX answers: whether it ended, where and after how many increments, iterations and seconds; positions
    (n, d), mm, and forces of supports on the curtain (n, d), N, both None if it did not end."""

    converged: bool
    reached: float
    increments: int
    iterations: int
    wall_s: float
    x: Array | None = None
    reactions: Array | None = None


def deck_problem(scene: Scene, law: MembraneLaw) -> CurtainProblem:
    """The discrete problem of a scene at full load; InputError for what a deck cannot hold, and what to leave out."""
    check_scene(scene)
    for what in left_out(scene):
        scene.refuse(f"{what}: a deck holds a curtain at rest under dead loads, leave it out")
    scene, law = meet(scene, law)
    check_sizes(scene, None if law.cell is None else law.cell.r1_mm)
    problem = make_problem(scene, law, build_mesh(scene, law.cell))
    if problem.winds:
        scene.refuse("[load.wind]: its force follows the shape; give pressure, without follows, in place of speed")
    if len(problem.supports.sliding.nodes):
        scene.refuse("[support]: one slides on a sloping line; hold it, or let it slide along an axis")
    if not np.abs(problem.force).any():
        scene.refuse("[load]: nothing pulls at the curtain; a deck needs its weight or a load")
    return problem


def left_out(scene: Scene) -> Iterator[str]:
    """Tables and keys of a scene that a deck cannot hold."""
    tables = {"[motion]": scene.motion, "[obstacle]": scene.obstacle, "[combination]": scene.combination}
    yield from (name for name, value in tables.items() if value)
    if scene.solver.is_bounded:
        yield "[solver] bounds and adapt"
    if scene.solver.is_plastic:
        yield "[solver] kind = 'plastic'"
    if scene.mesh.element != "P1":
        yield f"[mesh] element = {scene.mesh.element!r}"


def line_load(problem: CurtainProblem) -> float:
    """Sum of the loads over the size of the curtain, N/mm: the scale of its line loads."""
    return float(np.linalg.norm(problem.force, axis=1).sum()) / problem.mesh.size


def deck_text(problem: CurtainProblem, title: str = "") -> str:
    """The input file of CalculiX."""
    X, d = problem.disc.nodes, problem.fem.d
    t = counterclockwise(X, problem.mesh.mesh.t.T)
    away = problem.supports.positions - problem.fem.reference
    n, cells = len(X), len(t)
    fields = {
        "TITLE": title[:100],
        "COMPILE": COMPILE,
        "LINK": LINK.format("DIR"),
        "NODES": numbered(1, padded(X)),
        "ELEMENT": "CPS3" if d == 2 else "M3D3",
        "CELLS": numbered(1, t + 1),
        "SECTION": "SOLID" if d == 2 else "MEMBRANE",
        "THICKNESS": f"{THICKNESS:.12g}",
        "LINE_LOAD": f"{line_load(problem):.12g}",
        "TIES": "\n".join(bar_equations(problem)),
        "CUBES": cubes(X.max(axis=0) + problem.mesh.size, n + 1, cells + 1),
        "LOWER": f"{cells + 1}",
        "UPPER": f"{cells + 2}",
        "SUPPORTS": "\n".join(
            f"{i + 1}, {k + 1}, {k + 1}, {away[i, k]:.12g}" for i, k in np.argwhere(problem.supports.fixed)
        ),
        "LOADS": "\n".join(f"{i + 1}, {k + 1}, {problem.force[i, k]:.12g}" for i, k in np.argwhere(problem.force)),
    }
    return filled(__package__, "deck.inp", fields).replace("\n\n", "\n")


def numbered(first: int, rows: Any) -> str:
    """Lines of a number each, from `first` on, and the entries of a row (n, k)."""
    return "\n".join(", ".join([str(i), *(f"{x:.12g}" for x in row)]) for i, row in enumerate(rows.tolist(), first))


def bar_equations(problem: CurtainProblem) -> Iterator[str]:
    """Equations that keep the nodes of straight bars between their ends."""
    if problem.supports.bars is None:
        return
    bars = problem.supports.bars.tocsr()
    for node in np.flatnonzero(bars.diagonal() == 0.0):
        row = bars[[node]]
        for axis in range(1, problem.fem.d + 1):
            ends = [f"{end + 1}, {axis}, {-weight:.12g}" for end, weight in zip(row.indices, row.data, strict=True)]
            yield f"*EQUATION\n{len(ends) + 1}\n{node + 1}, {axis}, 1., " + ", ".join(ends)


def cubes(at: Array, node: int, cell: int) -> str:
    """Two unit cubes, one on the other and 0.001 mm inside it, from a corner `at` (2,) and from these numbers on."""
    square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    corners = [(at[0] + x, at[1] + y, z) for z in (0.0, 1.0, 0.999, 1.999) for x, y in square]
    own = node + np.arange(16).reshape(2, 8)
    return f"{numbered(node, np.array(corners))}\n*ELEMENT, TYPE=C3D8, ELSET=CUBES\n{numbered(cell, own)}"


def run_calculix(problem: CurtainProblem, text: str, source: str, built: Path) -> CalculixRun:
    """The answer of CalculiX, linked with the material `source`, to a deck; InputError if it cannot be built."""
    if shutil.which("gfortran") is None or not (built / "ccx.a").exists():
        raise InputError(f"CALCULIX = {built}: gfortran, or ccx.a there, is missing: see .ci/calculix, or --no-run")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "deck.inp").write_text(text)
        (folder / "umat.f").write_text(source)
        for line in (COMPILE, LINK.format(built)):
            done = subprocess.run(line.split(), cwd=folder, capture_output=True, text=True)
            if done.returncode:
                last = (done.stderr.strip().splitlines() or ["no message"])[-1]
                raise InputError(f"CALCULIX = {built}: `{line.split()[0]}` fails, {last}; .ci/calculix DIR builds it")
        begin = time.perf_counter()
        with part_of("CalculiX"):
            done = subprocess.run([folder / "ccx", "deck"], cwd=folder, capture_output=True, text=True)
        wall_s = time.perf_counter() - begin
        log = folder / "deck.sta"
        rows = [line.split() for line in log.read_text().splitlines()] if log.exists() else []
        rows = [row for row in rows if len(row) == 7 and row[0].isdigit()]
        good = [row for row in rows if row[2].isdigit()]
        counts = (len(good), sum(int(row[3]) for row in rows), wall_s)
        reached = float(good[-1][4]) if good else 0.0
        if "Job finished" not in done.stdout:
            return CalculixRun(False, reached, *counts)
        table = [line.split() for line in (folder / "deck.dat").read_text().splitlines()]
    n, d = problem.fem.x_held.shape
    values = np.array([row[1:] for row in table if len(row) == 4 and row[0].isdigit()], float)[-2 * n :, :d]
    x = problem.fem.reference + values[:n]
    return CalculixRun(True, reached, *counts, x, problem.supports.carried(values[n:] - problem.force))


def compared(problem: CurtainProblem, run: CalculixRun, law: MembraneLaw) -> JsonObject:
    """The answer of CalculiX beside ours: heights, forces of supports and their differences."""
    record: JsonObject = {
        "status": "converged" if run.converged else "not converged",
        "time_reached": run.reached,
        "increments": run.increments,
        "iterations": run.iterations,
        "wall_s": run.wall_s,
    }
    if run.x is None or run.reactions is None:
        return record
    with part_of("our own answer"):
        ours = solve_membrane(problem.scene, law).loaded
    areas = load_vector(problem.disc, np.array([1.0]))[:, 0]
    places = np.average(run.x, axis=0, weights=areas), np.average(ours.x, axis=0, weights=areas)
    held = np.flatnonzero(problem.supports.mask.any(axis=1))
    largest = float(np.linalg.norm(ours.reactions, axis=1).max())
    return record | {
        "our_status": ours.status,
        "our_forces_by": forces_by(ours),
        "mean_height_mm": float(places[0][1]),
        "our_mean_height_mm": float(places[1][1]),
        "height_error": float(np.linalg.norm(places[0] - places[1])) / problem.mesh.size,
        "force_error": float(np.linalg.norm(run.reactions - ours.reactions, axis=1).max()) / largest,
        "supports": [
            {
                "at_mm": problem.disc.nodes[node].tolist(),
                "force_N": run.reactions[node].tolist(),
                "our_force_N": ours.reactions[node].tolist(),
            }
            for node in held
        ],
    }


def run_deck(scene_path: Path, law_path: Path | None, out: Path, *, runs: bool = True) -> JsonObject:
    """Write deck.inp, umat.f and deck.json of the scene in a file; the summary.

    With `runs`, and where CALCULIX names a folder of `.ci/calculix`, they are run and compared. InputError for scenes
    and laws that a deck cannot hold.
    """
    scene, law, inputs = read_job(scene_path, law_path, out, RECORD)
    problem = deck_problem(scene, law)
    title = f"{scene_path.name}, law {'of r1/r2 = 10' if law_path is None else law_path.name}"
    text, source = deck_text(problem, title), umat_source(even_law(problem.law.own, problem.law.to_curtain), title)
    summary: JsonObject = {
        "element": "CPS3" if problem.fem.d == 2 else "M3D3",
        "cells": problem.disc.n_cells,
        "status": "written",
        "build": [COMPILE, LINK.format("DIR")],
        "versions": versions(),
    }
    with job(out, RECORD, summary, inputs) as folder:
        write_text(folder / "deck.inp", text)
        write_text(folder / "umat.f", source)
    if runs and (built := os.environ.get("CALCULIX")):
        summary |= compared(problem, run_calculix(problem, text, source, Path(built).absolute()), law)
        with job(out, RECORD, summary, inputs, adds=True):  # the deck is in place however a run of minutes ends
            pass
    return summary


def deck_lines(summary: JsonObject, out: Path) -> list[str]:
    """What was written, and how CalculiX and we differ, in sentences."""
    lines = [f"written to {out}: deck.inp, {summary['cells']} triangles {summary['element']}, and umat.f"]
    if summary["status"] == "written":
        return [*lines, "build and run it as the head of deck.inp says; with CALCULIX set, this command does"]
    ended = f"CalculiX {summary['status']}, {summary['iterations']} iterations in {summary['wall_s']:.0f} s"
    if "force_error" not in summary:
        return [*lines, f"{ended}, at time {summary['time_reached']:g} of 2"]
    return [
        *lines,
        f"{ended}; mean height {summary['mean_height_mm']:.1f} mm, ours {summary['our_mean_height_mm']:.1f} mm",
        f"forces of supports differ by up to {summary['force_error']:.2%} of the largest one",
        *([OPEN] if summary["our_forces_by"] == "elastic" and summary["force_error"] > AGREE else []),
    ]
