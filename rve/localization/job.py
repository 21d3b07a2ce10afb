"""One job: the VTU of a curtain in; its rings, the forces of the worst cell, a summary and a picture out."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rve.common.errors import InputError, NotConverged, require
from rve.common.files import write_text
from rve.common.jobs import check_out_job, complete, job
from rve.common.types import Array
from rve.common.versions import versions
from rve.geometry.cell import Cell
from rve.geometry.weave import WEAVES
from rve.localization.curtain import CURTAIN_RECORD, Curtain, WeaveOfCurtain, read_curtain, read_weave
from rve.localization.files import LINE, TUBE, write_forces_csv, write_ring_vtu
from rve.localization.forces import CellForces, cauchy_of, cell_forces, largest_forces
from rve.localization.poses import MEANINGS, LocalizeOptions, LockedStates, RingStates, localize, locked_states
from rve.localization.rings import NEAR, Fit, Sites, axes_of_weave, deformation, find_sites, fit_of, place_rings, turns

RECORD = "localize.json"
"""The file that stands for the job; it lists the others by their checksums."""


@dataclass(frozen=True)
class JobOptions:
    """r1, r2, hang_deg: as in the summary beside the VTU if None. window: x0, y0, x1, y1 in mm before deformation, all
    of the curtain if None. tubes: write tori instead of centre lines. max_rings: more are refused."""

    r1: float | None = None
    r2: float | None = None
    hang_deg: float | None = None
    weave: str = "4-in-1"
    grain: str = "y"
    window: tuple[float, float, float, float] | None = None
    tubes: bool = False
    max_rings: int = 100_000
    picture: bool = True


@dataclass(frozen=True)
class WorstCell:
    """The cell with the largest principal line load: number, pose, contact forces, turn (2, 2) into the curtain."""

    number: int
    states: RingStates
    forces: CellForces
    turn: Array


def run_localize(vtu: Path, out: Path, options: JobOptions) -> dict[str, Any]:
    """Rings of the curtain in `vtu`: rings.vtu, worst_cell.csv, localize.json and rings.png in `out`; the summary.

    All files appear together, and what they replace is gone (`rve.common.jobs`). InputError in one sentence for a file
    that is not a curtain or not that of the summary beside it, unknown radii, a window without rings or too many of
    them; nothing is written then. NotConverged if no locked state is found, or the picture cannot be drawn.
    """
    began = time.perf_counter()
    if options.picture:
        require("pyvista", "three-d", "rings.png", "ask for --no-picture")
    check_out_job(out, RECORD, inputs=[vtu])
    complete(vtu.parent, CURTAIN_RECORD)
    curtain = read_curtain(vtu)
    cell, weave = _mesh_of(vtu, options)
    how = LocalizeOptions()
    locked = locked_states(cell, how)
    _check_sides(vtu, cell, locked, weave.sides)
    axes = axes_of_weave(cell, weave.hang_deg)
    sites = find_sites(curtain, cell, locked.sides, axes, options.window)
    _check_count(vtu, sites, options)
    used, row = np.unique(sites.cell, return_inverse=True)
    states = localize(_in_weave(curtain.E[used], axes), cell, how, locked)
    rings = place_rings(curtain, sites, states, row, cell, axes)
    fit = fit_of(rings, cell)
    loads = cauchy_of(_in_weave(curtain.S[used], axes), states.E)
    force = largest_forces(loads, cell)[row, sites.index[:, 0]]
    worst = _worst(curtain, cell, how, locked, axes)
    data = _ring_data(curtain, sites, states, row, (fit, force), cell.r1)
    kind = TUBE if options.tubes else LINE
    summary = _summary(vtu, cell, weave, states, (fit, force, states.status[row]))
    summary |= {"worst_cell": _worst_lines(curtain, worst)}
    summary |= {"wall_s": round(time.perf_counter() - began, 3), "versions": versions()}
    with job(out, RECORD, [vtu]) as folder:
        write_ring_vtu(folder / "rings.vtu", (rings.centre, rings.normal), (cell.r1, cell.r2), data, kind)
        write_forces_csv(folder / "worst_cell.csv", worst.forces, worst.turn)
        write_text(folder / RECORD, json.dumps(summary, indent=2, allow_nan=False) + "\n")
        failure = draw(folder) if options.picture else None
    if failure is not None:
        raise NotConverged(
            f"{out / 'rings.png'}: {failure}; the other files are written; install libosmesa6 or ask for --no-picture"
        )
    return summary


def _mesh_of(vtu: Path, options: JobOptions) -> tuple[Cell, WeaveOfCurtain]:
    """Cell, and what the summary or the options say of its weave."""
    if options.weave not in WEAVES:
        raise InputError(f"--weave = {options.weave!r}: known are {', '.join(WEAVES)}")
    weave = read_weave(vtu, options.r1, options.r2, options.hang_deg)
    return Cell(weave.r1, weave.r2, WEAVES[options.weave], options.grain), weave


def _check_sides(vtu: Path, cell: Cell, locked: LockedStates, sides: tuple[float, float] | None) -> None:
    """The reference cell of the rings must be the one that the curtain's strain is measured from."""
    own = tuple(cell.r1 * side for side in (locked.sides[::-1] if cell.grain == "x" else locked.sides))
    if sides is not None and not np.allclose(own, sides, rtol=1e-4):
        raise InputError(
            f"{vtu.parent / 'summary.json'}: rings: a cell of {sides[0]:.4f} x {sides[1]:.4f} mm is not that of "
            f"{cell.weave.name} with grain {cell.grain}, {own[0]:.4f} x {own[1]:.4f} mm; give --weave and --grain"
        )


def _check_count(vtu: Path, sites: Sites, options: JobOptions) -> None:
    if not len(sites.X):
        where = "" if options.window is None else f"--window = {','.join(f'{x:g}' for x in options.window)}: "
        raise InputError(f"{where}not one ring of {vtu} lies there")
    if len(sites.X) > options.max_rings:
        raise InputError(
            f"{vtu}: {len(sites.X)} rings are more than --max-rings = {options.max_rings}; ask for a --window"
        )


def _in_weave(triples: Array, axes: Array) -> Array:
    """Tensors (n, 3) of the curtain in the weave's own axes; `axes` (2, 2) leads from the weave to the curtain."""
    full = np.stack([triples[:, [0, 1]], triples[:, [1, 2]]], axis=1)
    turned = axes.T @ full @ axes
    return np.stack([turned[:, 0, 0], turned[:, 0, 1], turned[:, 1, 1]], axis=1)


def _worst(curtain: Curtain, cell: Cell, how: LocalizeOptions, locked: LockedStates, axes: Array) -> WorstCell:
    number = int(np.argmax(curtain.line_load))
    states = localize(_in_weave(curtain.E[[number]], axes), cell, how, locked)
    s = cauchy_of(_in_weave(curtain.S[[number]], axes), states.E)[0]
    triangle = int(np.flatnonzero(curtain.cell == number)[0])
    F = axes.T @ deformation(curtain)[[triangle]] @ axes
    return WorstCell(number, states, cell_forces(s, cell), axes @ turns(F, states.E)[0])


def _ring_data(
    curtain: Curtain, sites: Sites, states: RingStates, row: NDArray[np.intp], found: tuple[Fit, Array], r1: float
) -> dict[str, Array]:
    """Numbers per ring for the VTU; gaps are looked for up to NEAR r1 and given as that where they are larger."""
    fit, force = found
    names = list(MEANINGS)
    code = np.array([names.index(str(status)) for status in states.status])
    listed: dict[str, Any] = {
        "ring": np.arange(len(row)),
        "class_i_j": sites.index,
        "macro_cell": sites.cell,
        "state_0_slack_1_wrinkled_2_taut": curtain.state[sites.cell],
        f"pose_{'_'.join(f'{i}_{name}' for i, name in enumerate(names))}": code[row],
        "strain_short": states.short[row],
        "strain_fold": states.fold[row],
        "cell_gap_mm": states.gap_mm[row],
        "drawn_gap_mm": np.minimum(fit.gap_mm, NEAR * r1),
        "broken_link": fit.broken.astype(int),
        "contact_force_N": force,
        "reference_mm": np.column_stack([sites.X, np.zeros(len(sites.X))]),
    }
    return listed


def _summary(
    vtu: Path, cell: Cell, weave: WeaveOfCurtain, states: RingStates, found: tuple[Fit, Array, NDArray[np.str_]]
) -> dict[str, Any]:
    """The numbers of a job, ready for JSON; found: how the rings fit, their contact forces and statuses (n,)."""
    fit, force, status = found
    names, counts = np.unique(states.status, return_counts=True)
    gap = np.minimum(fit.gap_mm, NEAR * cell.r1)
    return {
        "curtain": str(vtu),
        "curtain_status": weave.solved,
        "weave": cell.weave.name,
        "grain": cell.grain,
        "r1_mm": cell.r1,
        "r2_mm": cell.r2,
        "hang_deg": weave.hang_deg,
        "rings": len(force),
        "cells": len(states.E),
        "solves": states.solves,
        "cells_by_status": {str(name): int(count) for name, count in zip(names, counts, strict=True)},
        "meanings": {str(name): MEANINGS[str(name)] for name in names},
        "largest_strain_short": float(states.short.max()),
        "largest_strain_fold": float(states.fold.max()),
        "smallest_gap_in_a_cell_mm": float(states.gap_mm.min()),
        "drawn_gap_mm_quantiles_0_5_25_50": {
            str(name): [float(x) for x in np.quantile(gap[status == name], [0.0, 0.05, 0.25, 0.5])]
            for name in np.unique(status)
        },
        "links": fit.links,
        "links_intact": fit.linked,
        "largest_contact_force_N": float(force.max()),
    }


def _worst_lines(curtain: Curtain, worst: WorstCell) -> dict[str, Any]:
    """What the summary says of the worst cell."""
    forces = worst.forces
    triangle = int(np.flatnonzero(curtain.cell == worst.number)[0])
    return {
        "cell": worst.number,
        "reference_mm": curtain.X[curtain.triangles[triangle]].mean(axis=0).tolist(),
        "largest_principal_line_load_N_per_mm": float(curtain.line_load[worst.number]),
        "pose": str(worst.states.status[0]),
        "alpha_deg": forces.alpha_deg,
        "beta_deg": forces.beta_deg,
        "status": forces.status,
        "contacts": len(forces.force),
        "largest_force_N": float(forces.force.max(initial=0.0)),
        "cauchy_line_load_11_12_22_N_per_mm": forces.s.tolist(),
        "line_load_of_contacts_11_12_22_N_per_mm": forces.virial.tolist(),
    }


def draw(folder: Path) -> str | None:
    """rings.png from the files in `folder`, by a process of its own: renderers without a screen may crash.

    Returns what went wrong, None if the picture is there.
    """
    command = [sys.executable, "-m", "rve.localization.picture", str(folder)]
    here = str(Path(__file__).resolve().parents[1])
    paths = os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
    run = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": paths})
    if not run.returncode:
        return None
    last = (run.stderr.strip().splitlines() or ["no message"])[-1]
    return f"the renderer ended with code {run.returncode} ({last})"
