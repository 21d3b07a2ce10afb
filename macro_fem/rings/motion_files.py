"""Files of every ring in motion: motion.csv with the columns of a curtain, VTUs, summary.json and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from homogenize import default_law, load_law
from macro_fem.motion.account import Account
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
from macro_fem.motion.stage import scene_at
from macro_fem.output.pictures import Pictures
from macro_fem.rings.every_ring import EveryRing
from macro_fem.rings.motion import RingFrame, RingRun, RingStage, solve_ring_motion
from macro_fem.rings.ring_scene import ring_scene
from macro_fem.scene.schema import Scene, load_scene
from rve import RingContacts, slack_rings, with_bodies
from rve.common import Array
from rve.common.drawing.plane import new_figure, save_figure
from rve.common.drawing.space import compose, new_plotter

if TYPE_CHECKING:
    from pyvista import Plotter

CONTACTS = ("pairs", "normal", "force", "gap")
"""What motion.npz has of the contacts of all frames, one after the other."""


def run_ring_motion(
    scene_path: Path,
    law_path: Path | None,
    out: Path,
    *,
    picture: bool = True,
    animation: bool = False,
    html: bool = False,
    goes_on: bool = False,
    **how: Any,
) -> dict[str, Any]:
    """Solve every ring of the scene of [motion] in a file, write its files into `out` and return the summary; see
    `run_series`.

    how: space and start of `EveryRing`.
    """
    wanted = Pictures(picture, animation, html, stem="motion")
    wanted.check()
    scene = load_scene(scene_path)
    law = default_law() if law_path is None else load_law(law_path)
    who = EveryRing(law, **how)

    def write_views(folder: Path, run: RingRun, shown: Sequence[RingFrame]) -> None:
        if picture:
            _save_panels(folder / "motion.png", chosen(shown, PANELS))
        title = scene.source.stem
        write_moving(
            folder, title, shown, wanted, _drawn, lambda some: (compose(one, words) for words, one in _drawn(some))
        )

    series = Series(
        scene,
        f"{who.space} {named(law)}",
        lambda start: solve_ring_motion(scene, who, start),
        lambda run, frame: ring_row(frame) + _contacts(frame),
        summarize_ring_motion,
        lambda path, run, frame: frame.rings.write_vtu(path),
        write_views,
        _pack,
        lambda kept, moments, accounts: _unpack(scene, who, kept, moments, accounts),
    )
    return run_series(series, out, [scene_path, law_path], goes_on=goes_on)


def _contacts(frame: RingFrame) -> list[float]:
    """The largest contact force in N, the least gap in mm, whether links are intact, iterations."""
    contacts = frame.rings.contacts
    return [float(contacts.force.max(initial=0.0)), contacts.min_gap_mm, contacts.links_intact, frame.iterations]


def summarize_ring_motion(run: RingRun, rows: Array) -> dict[str, Any]:
    """The numbers of summary.json from the rows of motion.csv and those of contacts (m, 18)."""
    rings, (force, gap, intact, iterations) = run.frames[-1].rings, rows[:, -4:].T
    return summary_of(run, rows, is_rigid=True) | {
        "peak_contact_force_N": float(force.max()),
        "peak_contact_force_at_s": float(rows[force.argmax(), 0]),
        "ring_count": len(rings.centre),
        "centres": "space" if rings.is_space else "plane",
        "min_gap_mm": float(gap.min()),
        "links_intact": bool(intact.all()),
        "iterations": int(iterations.sum()),
    }


def _pack(frames: Sequence[RingFrame]) -> Kept:
    rings = [one.rings for one in frames]
    kept: Kept = {name: np.concatenate([getattr(one.contacts, name) for one in rings]) for name in CONTACTS}
    kept["count"] = np.array([len(one.contacts.force) for one in rings])
    kept["forces"] = np.array([np.concatenate([one.reaction, one.wall_force]) for one in rings])
    told = [(one.contacts.min_gap_mm, one.contacts.links_intact, one.kkt_residual) for one in rings]
    return kept | {"told": np.array(told, float)}


def _unpack(
    scene: Scene, who: EveryRing, kept: Kept, moments: Sequence[Moment], accounts: Sequence[Account]
) -> list[RingFrame]:
    first = ring_scene(scene_at(scene, 0.0), who.rings)
    stage, n, frames = RingStage(scene, first), len(first.mesh.X), []
    slack = with_bodies(slack_rings(first.mesh, space=who.space, walls=first.walls), stage.bodies)
    ends = np.cumsum(kept["count"])[:-1]
    contacts = zip(*(np.split(kept[name], ends) for name in CONTACTS), strict=True)
    for moment, account, (pairs, normal, force, gaps), forces, (least, intact, residual) in zip(
        moments, accounts, contacts, kept["forces"], kept["told"], strict=True
    ):
        asked, axes = stage.at(moment.t), moment.x[n : 2 * n]
        bodies = [body.moved(place) for body, place in zip(stage.bodies, moment.x[2 * n :], strict=True)]
        rings = replace(
            slack,
            centre=moment.x[:n],
            normal=axes / np.linalg.norm(axes, axis=1)[:, None],
            load=asked.force,
            reaction=forces[:n],
            contacts=RingContacts(pairs, normal, force, gaps, float(least), bool(intact)),
            walls=(*asked.walls, *bodies),
            wall_force=forces[n:],
            kkt_residual=float(residual),
        )
        frames.append(RingFrame(moment=moment, account=account, rings=rings, asked=asked))
    return frames


def ring_row(frame: RingFrame) -> list[float]:
    """A row of motion.csv: means over the reference area, `relative_gap` the residual of the rings."""
    rings = frame.rings
    return row_of(frame, rings.centre, rings.mesh.area, rings.reaction, rings.kkt_residual)


def _save_panels(path: Path, frames: Sequence[RingFrame]) -> None:
    figure = new_figure(5.2 * len(frames), 6.0)
    axes = figure.subplots(1, len(frames), squeeze=False, sharex=True, sharey=True)[0]
    rings = [frame.rings.drawn for frame in frames]
    for ax, frame, one in zip(axes, frames, rings, strict=True):
        one.plot(ax, series=rings).set_title(f"{frame.moment.t:.3f} s", fontsize=11)
    save_figure(path, figure)


def _drawn(frames: Sequence[RingFrame]) -> Iterator[tuple[str, Plotter]]:
    """A plotter, the same one, with the rings at each moment, by one scale and with one camera."""
    rings, plotter = [frame.rings.drawn for frame in frames], new_plotter()
    for frame, one in zip(frames, rings, strict=True):
        yield f"{frame.moment.t:.3f} s", one.draw(plotter, rings)
        plotter.clear_actors()
    plotter.close()
