"""Files of every ring in motion: motion.csv with the columns of a curtain, VTUs, summary.json and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from homogenize import default_law, load_law
from macro_fem.motion.files import COLUMNS, IMPULSES, RECORD, account_error, force_peaks
from macro_fem.motion.views import IMAGES, PANELS, chosen
from macro_fem.output.files import collection, versions
from macro_fem.rings.every_ring import EveryRing
from macro_fem.rings.motion import RingFrame, RingRun, solve_ring_motion
from macro_fem.scene.schema import load_scene
from rve.common.drawing.page import check_page, write_moments
from rve.common.drawing.plane import new_figure, save_figure
from rve.common.errors import require
from rve.common.files import check_out_job, job, write_text
from rve.common.texts import csv_text, json_text
from rve.common.types import Array

if TYPE_CHECKING:
    from pyvista import Plotter


def run_ring_motion(
    scene_path: Path,
    law_path: Path | None,
    out: Path,
    *,
    space: bool = True,
    start: str = "slack",
    picture: bool = True,
    html: bool = False,
) -> dict[str, Any]:
    """Solve every ring of the scene of [motion] in a file, write its files into `out` and return the summary.

    space, start: see `EveryRing`. InputError in one sentence, and nothing written, for what cannot be read or begin.
    """
    if picture:
        require("matplotlib", "plots", "motion.png", "ask for --no-picture")
    if html:
        check_page("motion.html", "leave out --html")
    scene, inputs = load_scene(scene_path), [scene_path, law_path]
    check_out_job(out, RECORD, inputs=inputs)
    run = solve_ring_motion(scene, EveryRing(default_law() if law_path is None else load_law(law_path), space, start))
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
    mean, lowest = rings.mesh.area @ rings.centre / rings.mesh.area.sum(), rings.centre[:, 1].min()
    force = float(np.linalg.norm(rings.reaction.sum(axis=0)))
    return [frame.moment.t, *mean.tolist(), float(lowest), *astuple(frame.account), force, rings.kkt_residual]


def summarize_ring_motion(run: RingRun, rows: Array) -> dict[str, Any]:
    """The numbers of summary.json from the rows of motion.csv (m, 14)."""
    assert run.scene.motion is not None
    last, t = run.frames[-1], rows[:, 0]
    contact = np.array([frame.rings.contacts.force.max(initial=0.0) for frame in run.frames])
    return {
        "status": str(run.status),
        "message": run.message,
        "duration_s": run.scene.motion.duration,
        "reached_s": float(t[-1]),
        "steps": len(rows) - 1,
        "scheme": run.scene.motion.scheme,
        "forces": IMPULSES,
        **force_peaks(t, rows[:, COLUMNS.index("support_force_N")], impulse=True),
        "peak_contact_force_N": float(contact.max()),
        "peak_contact_force_at_s": float(t[contact.argmax()]),
        "mean_end_mm": rows[-1, 1:4].tolist(),
        "lowest_point_mm": float(rows[-1, 4]),
        **{name: float(value) for name, value in zip(COLUMNS[5:12], rows[-1, 5:12], strict=True)},
        "account_error": account_error(rows),
        "relative_gap": float(rows[:, -1].max()),
        "ring_count": len(last.rings.centre),
        "centres": "space" if last.rings.is_space else "plane",
        "min_gap_mm": min(frame.rings.contacts.min_gap_mm for frame in run.frames),
        "links_intact": all(frame.rings.contacts.links_intact for frame in run.frames),
        "iterations": sum(frame.iterations for frame in run.frames),
        "wall_s": run.wall_s,
        "versions": versions(),
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
