"""From a solved curtain to its rings: a curtain in memory or in files in, a `RingField` out."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from macro_fem.rings.curtain import Curtain, curtain_file, read_curtain
from macro_fem.rings.field import RingField, WorstCell, check_outputs
from macro_fem.rings.places import find_sites, place_rings, turns
from rve import (
    NearestPoses,
    PoseOptions,
    axes_of_weave,
    cauchy_of,
    cell_forces,
    fit_rings,
    largest_forces,
    locked_arrangements,
    nearest_poses,
)
from rve.common import Array, InputError, Typed, shown, tell


@dataclass(frozen=True)
class LocalizeOptions(Typed):
    """Which rings of a curtain are wanted: those in the window x0, y0, x1, y1 (mm, before deformation), all if None.

    max_rings: more are refused, because their files grow by 0.5 kB each. poses: options of the pose solver. InputError
    for values that make no sense.
    """

    window: tuple[float, float, float, float] | None = None
    max_rings: Annotated[int, Meta(ge=1, le=10**9)] = 100_000
    poses: PoseOptions = field(default_factory=PoseOptions)

    def check(self) -> None:
        """InputError for a window that is no rectangle."""
        ends = self.window
        if ends is not None and not (np.isfinite(ends).all() and ends[0] < ends[2] and ends[1] < ends[3]):
            self.refuse(f"window = {ends}: must be x0, y0, x1, y1 in mm with x0 < x1 and y0 < y1")


def parse_window(text: str | None) -> tuple[float, float, float, float] | None:
    """A window from "x0,y0,x1,y1" in mm, or None for None; InputError for other texts.

    >>> parse_window("0,0,50,80.5")
    (0.0, 0.0, 50.0, 80.5)
    """
    if text is None:
        return None
    try:
        x0, y0, x1, y1 = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--window = {shown(text)}: write x0,y0,x1,y1 in mm") from None
    return x0, y0, x1, y1


def localize(curtain: Curtain | str | Path, options: LocalizeOptions | None = None) -> RingField:
    """Every ring of a solved curtain: place, tilt, gaps, links and contact forces.

    `curtain`: that of an answer (`answer.rings()` calls this), or the folder that `macro_fem run` wrote, or its
    curtain.vtu. InputError in one sentence for files that are no curtain or not of one run, unknown rings, a window
    without rings or too many of them. NotConverged if no locked state is found.
    """
    began = time.perf_counter()
    options = options or LocalizeOptions()
    curtain = curtain if isinstance(curtain, Curtain) else read_curtain(curtain)
    cell, how = curtain.told.cell(curtain.source), options.poses
    locked = locked_arrangements(cell, how)
    axes = axes_of_weave(cell, curtain.told.hang_deg)
    tell("rings in their cells")
    sites = find_sites(curtain, cell, locked.sides, axes, options.window)
    if not len(sites.X):
        where = "" if options.window is None else f"--window = {','.join(f'{x:g}' for x in options.window)}: "
        raise InputError(f"{where}not one ring of {curtain.source} lies there")
    if len(sites.X) > options.max_rings:
        raise InputError(
            f"{curtain.source}: {len(sites.X)} rings are more than --max-rings = {options.max_rings}; ask for a "
            "--window"
        )

    def solved(cells: NDArray[np.intp]) -> tuple[NearestPoses, Array]:
        """Poses of some cells, and the Cauchy line loads (n, 3) on them."""
        states = nearest_poses(in_weave(curtain.E[cells], axes), cell, how, locked)
        return states, cauchy_of(in_weave(curtain.S[cells], axes), states.E)

    used, row = np.unique(sites.triangle, return_inverse=True)
    states, loads = solved(used)
    tell(f"{len(sites.X)} rings in their places")
    centre, normal = place_rings(curtain, sites, states, row, cell, axes)
    tell(f"contact forces of {len(used)} cells")
    force = largest_forces(loads, cell, how.direct)[row, sites.index[:, 0]]
    among = np.arange(len(curtain.line_load)) if options.window is None else used
    number = int(among[np.argmax(curtain.line_load[among])])
    pose, load = solved(np.array([number]))
    turn = turns(curtain, np.array([number]), pose.E, axes)[0]
    worst = WorstCell(number, str(pose.status[0]), cell_forces(load[0], cell, how.direct), turn)
    fit = fit_rings(sites.index, centre, normal, cell)
    wall_s = round(time.perf_counter() - began, 3)
    return RingField(curtain, cell, sites, centre, normal, states, row, fit, force, worst, wall_s)


def run_localize(
    path: Path, out: Path, options: LocalizeOptions, *, picture: bool = True, html: bool = False, **vtu: bool
) -> dict[str, Any]:
    """`localize` and `RingField.save` into `out`, `vtu`: its `tubes` and `stl`; the summary. What the picture needs and
    what `out` would overwrite is checked before anything is solved."""
    inputs = [curtain_file(path)]
    check_outputs(out, inputs, picture=picture, html=html)
    return localize(path, options).save(out, picture=picture, html=html, inputs=inputs, **vtu)


def in_weave(triples: Array, axes: Array) -> Array:
    """Tensors (n, 3) of the curtain in the weave's own axes; `axes` (2, 2) leads from the weave to the curtain."""
    turned = axes.T @ triples[:, [[0, 1], [1, 2]]] @ axes
    return np.stack([turned[:, 0, 0], turned[:, 0, 1], turned[:, 1, 1]], axis=1)
