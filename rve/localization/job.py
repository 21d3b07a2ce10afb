"""From a solved curtain to its rings: a curtain in memory or in files in, a `RingField` out."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rve.common.drawing.page import check_page
from rve.common.errors import InputError, require
from rve.common.progress import tell
from rve.common.storage.jobs import check_out_job, complete
from rve.common.types import Array
from rve.common.values import Options, choice, whole
from rve.geometry.cell import Cell
from rve.geometry.weave import WEAVES
from rve.localization.curtain import (
    CURTAIN_RECORD,
    Curtain,
    SolvedCurtain,
    WeaveOfCurtain,
    curtain_file,
    read_curtain,
    read_weave,
    weave_of,
)
from rve.localization.field import RECORD, RingField, WorstCell
from rve.localization.forces import cauchy_of, cell_forces, largest_forces
from rve.localization.frames import turns
from rve.localization.poses import LockedArrangements, PoseOptions, locked_arrangements, nearest_poses
from rve.localization.rings import Sites, axes_of_weave, find_sites, fit_of, place_rings


@dataclass(frozen=True)
class LocalizeOptions(Options):
    """Which rings of a curtain are wanted.

    r1, r2 (mm), hang_deg: as in the curtain's summary if None. window: only rings in x0, y0, x1, y1 (mm, before
    deformation); all if None. weave, grain: those of the law's table. max_rings: more rings are refused, because their
    files grow by 0.3 kB each. poses: options of the pose solver. InputError for values that make no sense.
    """

    r1: float | None = None
    r2: float | None = None
    hang_deg: float | None = None
    weave: str = choice(*WEAVES, default="4-in-1")
    grain: str = choice("x", "y", default="y")
    window: tuple[float, float, float, float] | None = None
    max_rings: int = whole(100_000, least=1, most=10**9)
    poses: PoseOptions = field(default_factory=PoseOptions)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.window is not None:
            ends = np.array(self.window, float)
            if ends.shape != (4,) or not np.isfinite(ends).all() or not (ends[:2] < ends[2:]).all():
                raise InputError(f"window = {self.window}: must be x0, y0, x1, y1 in mm with x0 < x1 and y0 < y1")


def localize(curtain: SolvedCurtain | str | Path, options: LocalizeOptions | None = None) -> RingField:
    """Every ring of a solved curtain: place, tilt, gaps, links and contact forces.

    `curtain`: what `macro_fem.solve` returned, or the path of a curtain.vtu or of its folder. InputError in one
    sentence for a file that is not a curtain or not that of the summary beside it, unknown radii, a window without
    rings or too many of them. NotConverged if no locked state is found.
    """
    began = time.perf_counter()
    options = options or LocalizeOptions()
    fields, weave, source = _opened(curtain, options)
    cell = Cell(weave.r1, weave.r2, WEAVES[options.weave], options.grain)
    locked = locked_arrangements(cell, options.poses)
    _check_sides(cell, locked, weave)
    axes = axes_of_weave(cell, weave.hang_deg)
    tell("rings in their cells")
    sites = find_sites(fields, cell, locked.sides, axes, options.window)
    _check_count(source, sites, options)
    used, row = np.unique(sites.cell, return_inverse=True)
    states = nearest_poses(_in_weave(fields.E[used], axes), cell, options.poses, locked)
    tell(f"{len(sites.X)} rings in their places")
    rings = place_rings(fields, sites, states, row, cell, axes)
    tell(f"contact forces of {len(used)} cells")
    loads = cauchy_of(_in_weave(fields.S[used], axes), states.E)
    force = largest_forces(loads, cell, options.poses.direct)[row, sites.index[:, 0]]
    worst = _worst(fields, cell, options.poses, locked, axes)
    seconds = round(time.perf_counter() - began, 3)
    return RingField(fields, weave, cell, rings, states, row, fit_of(rings, cell), force, worst, source, seconds)


def run_localize(
    vtu: Path, out: Path, options: LocalizeOptions, *, picture: bool = True, tubes: bool = False, html: bool = False
) -> dict[str, Any]:
    """Rings of the curtain in `vtu`: rings.vtu, worst_cell.csv, localize.json and rings.png in `out`; the summary.

    Errors as in `localize` and `RingField.save`. What the picture needs and what `out` would overwrite is checked
    before anything is solved.
    """
    if picture:
        require("pyvista", "three-d", "rings.png", "ask for --no-picture")
    if html:
        check_page("rings.html", "leave out --html")
    vtu = curtain_file(vtu)
    check_out_job(out, RECORD, inputs=[vtu])
    return localize(vtu, options).save(out, picture=picture, tubes=tubes, html=html, inputs=[vtu])


def _opened(curtain: SolvedCurtain | str | Path, options: LocalizeOptions) -> tuple[Curtain, WeaveOfCurtain, str]:
    """Fields and weave of a curtain, and where they come from."""
    asked = (options.r1, options.r2, options.hang_deg)
    if isinstance(curtain, str | Path):
        vtu = curtain_file(Path(curtain))
        complete(vtu.parent, CURTAIN_RECORD)
        return read_curtain(vtu), read_weave(vtu, *asked), str(vtu)
    if not hasattr(curtain, "to_curtain"):
        raise InputError(
            f"localize takes what macro_fem.solve returns, or the path of a curtain.vtu, not a {type(curtain).__name__}"
        )
    return curtain.to_curtain(), weave_of(curtain.summary, asked, "the curtain's summary"), "a curtain in memory"


def _check_sides(cell: Cell, locked: LockedArrangements, weave: WeaveOfCurtain) -> None:
    """The reference cell of the rings must be the one that the curtain's strain is measured from."""
    sides = weave.sides
    own = tuple(cell.r1 * side for side in (locked.sides[::-1] if cell.grain == "x" else locked.sides))
    if sides is not None and not np.allclose(own, sides, rtol=1e-4):
        raise InputError(
            f"{weave.source}: rings: a cell of {sides[0]:.4f} x {sides[1]:.4f} mm is not that of "
            f"{cell.weave.name} with grain {cell.grain}, {own[0]:.4f} x {own[1]:.4f} mm; give --weave and --grain, "
            "or a curtain whose law refers to rings side by side (rve table --reference side-by-side)"
        )


def _check_count(source: str, sites: Sites, options: LocalizeOptions) -> None:
    if not len(sites.X):
        where = "" if options.window is None else f"--window = {','.join(f'{x:g}' for x in options.window)}: "
        raise InputError(f"{where}not one ring of {source} lies there")
    if len(sites.X) > options.max_rings:
        raise InputError(
            f"{source}: {len(sites.X)} rings are more than --max-rings = {options.max_rings}; ask for a --window"
        )


def _in_weave(triples: Array, axes: Array) -> Array:
    """Tensors (n, 3) of the curtain in the weave's own axes; `axes` (2, 2) leads from the weave to the curtain."""
    full = np.stack([triples[:, [0, 1]], triples[:, [1, 2]]], axis=1)
    turned = axes.T @ full @ axes
    return np.stack([turned[:, 0, 0], turned[:, 0, 1], turned[:, 1, 1]], axis=1)


def _worst(curtain: Curtain, cell: Cell, how: PoseOptions, locked: LockedArrangements, axes: Array) -> WorstCell:
    number = int(np.argmax(curtain.line_load))
    states = nearest_poses(_in_weave(curtain.E[[number]], axes), cell, how, locked)
    s = cauchy_of(_in_weave(curtain.S[[number]], axes), states.E)[0]
    triangle = np.flatnonzero(curtain.cell == number)[:1]
    return WorstCell(number, states, cell_forces(s, cell, how.direct), turns(curtain, triangle, states.E, axes)[0])
