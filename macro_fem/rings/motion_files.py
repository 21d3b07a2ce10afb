"""Files of every ring in motion: motion.csv with the columns of a curtain, VTUs, summary.json and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from homogenize import default_law, load_law
from macro_fem.motion.files import COLUMNS, RECORD, row_of, summary_of
from macro_fem.motion.views import IMAGES, PANELS, chosen
from macro_fem.output.files import collection
from macro_fem.output.pictures import Pictures
from macro_fem.rings.every_ring import EveryRing
from macro_fem.rings.motion import RingFrame, RingRun, solve_ring_motion
from macro_fem.scene.schema import load_scene
from rve.common.drawing.page import write_moments
from rve.common.drawing.plane import new_figure, save_figure
from rve.common.files import check_out_job, job, write_text
from rve.common.texts import csv_text, json_text
from rve.common.types import Array

if TYPE_CHECKING:
    from pyvista import Plotter


def run_ring_motion(
    scene_path: Path, law_path: Path | None, out: Path, *, picture: bool = True, html: bool = False, **how: Any
) -> dict[str, Any]:
    """Solve every ring of the scene of [motion] in a file, write its files into `out` and return the summary.

    how: space and start of `EveryRing`. InputError in one sentence, and nothing written, for what cannot be read or
    begin.
    """
    Pictures(picture, html=html, stem="motion").check()
    scene, inputs = load_scene(scene_path), [scene_path, law_path]
    check_out_job(out, RECORD, inputs=inputs)
    run = solve_ring_motion(scene, EveryRing(default_law() if law_path is None else load_law(law_path), **how))
    rows = np.array([ring_row(frame) for frame in run.frames])
    summary = summarize_ring_motion(run, rows)
    with job(out, RECORD, inputs) as folder:
        write_text(folder / "motion.csv", csv_text(COLUMNS, rows.tolist()))
        shown = chosen(run.frames)
        entries = [(frame.moment.t, 0, f"motion_{k:04d}.vtu") for k, frame in enumerate(shown)]
        for frame, (_, _, name) in zip(shown, entries, strict=True):
            frame.rings.write_vtu(folder / name)
        write_text(folder / "motion.pvd", collection(entries))
        if picture:
            _save_panels(folder / "motion.png", chosen(run.frames, PANELS))
        if html:
            write_moments(folder / "motion.html", _drawn(chosen(run.frames, IMAGES)), scene.source.stem)
        write_text(folder / RECORD, json_text(summary))
    return summary


def ring_row(frame: RingFrame) -> list[float]:
    """A row of motion.csv: means over the reference area, `relative_gap` the residual of the rings."""
    rings = frame.rings
    return row_of(frame, rings.centre, rings.mesh.area, rings.reaction, rings.kkt_residual)


def summarize_ring_motion(run: RingRun, rows: Array) -> dict[str, Any]:
    """The numbers of summary.json from the rows of motion.csv (m, 14)."""
    rings, contacts = run.frames[-1].rings, [frame.rings.contacts for frame in run.frames]
    force = np.array([one.force.max(initial=0.0) for one in contacts])
    return summary_of(run, rows, is_rigid=True) | {
        "peak_contact_force_N": float(force.max()),
        "peak_contact_force_at_s": float(rows[force.argmax(), 0]),
        "ring_count": len(rings.centre),
        "centres": "space" if rings.is_space else "plane",
        "min_gap_mm": min(one.min_gap_mm for one in contacts),
        "links_intact": all(one.links_intact for one in contacts),
        "iterations": sum(frame.iterations for frame in run.frames),
    }


def _save_panels(path: Path, frames: Sequence[RingFrame]) -> None:
    figure = new_figure(5.2 * len(frames), 6.0)
    axes = figure.subplots(1, len(frames), squeeze=False, sharex=True, sharey=True)[0]
    for ax, frame in zip(axes, frames, strict=True):
        frame.rings.drawn.plot(ax).set_title(f"{frame.moment.t:.3f} s", fontsize=11)
    save_figure(path, figure)


def _drawn(frames: Sequence[RingFrame]) -> Iterator[tuple[str, Plotter]]:
    """A plotter at each moment."""
    for frame in frames:
        plotter = frame.rings.drawn.draw(None)
        yield f"{frame.moment.t:.3f} s", plotter
        plotter.close()
