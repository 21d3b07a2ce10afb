"""What a run of a curtain in motion goes on from: its last two moments, and the frames that files show."""

from __future__ import annotations

import hashlib
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np

from homogenize import MembraneLaw, with_material
from macro_fem.motion.account import Account
from macro_fem.motion.run import MotionFrame, Pace
from macro_fem.motion.scheme import Moment
from macro_fem.motion.stage import Stage, scene_at
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.schema import Scene
from rve.common.errors import InputError
from rve.common.files import atomic_path
from rve.common.types import Array

KEPT = "motion.npz"
FIELDS = ("t", "x", "v", "P", "S", "supports", "account", "gap")


def write_kept(path: Path, scene: Scene, law: MembraneLaw, frames: list[MotionFrame], rows: Array) -> None:
    """Write frames, the last one of the run at the end, and the rows of motion.csv."""
    pace = frames[-1].pace
    kept: dict[str, Any] = {"of": np.array(_name(scene, law)), "rows": rows, "pace": np.array([pace.h, pace.most])}
    each = [
        (one.moment.t, one.moment.x, one.moment.v, one.P, one.S, one.supports, astuple(one.account), one.relative_gap)
        for one in frames
    ]
    kept |= {name: np.array(values) for name, values in zip(FIELDS, zip(*each, strict=True), strict=True)}
    for name, moment in (("before", pace.before), ("last", pace.last)):
        if moment is not None:
            kept |= {f"{name}_t": np.array(moment.t), f"{name}_x": moment.x, f"{name}_v": moment.v}
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **kept)


def read_kept(path: Path, scene: Scene, law: MembraneLaw) -> tuple[tuple[MotionFrame, ...], Array]:
    """Frames and rows of a run of the same scene but for its duration; InputError for any other file."""
    try:
        with np.load(path, allow_pickle=False) as file:
            kept = dict(file)
        of, pace, rows = str(kept["of"]), kept["pace"], kept["rows"]
        parts = [kept[name] for name in FIELDS]
    except FileNotFoundError as error:
        raise InputError(f"--continue: {path} is missing: there is no run to go on with") from error
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise InputError(f"--continue: {path} is not what a run has kept: run again without it") from error
    if of != _name(scene, law):
        raise InputError(f"--continue: {path} is of another scene or law: only [motion] duration may differ")
    law = with_material(law, dict(scene.material), f"{scene.source}: [material]")
    stage = Stage(scene, law, build_mesh(scene_at(scene, 0.0), law.cell))
    frames = []
    for t, x, v, P, S, supports, account, gap in zip(*parts, strict=True):
        problem, _ = stage.at(float(t))
        own = Account(*account.tolist())
        frames.append(MotionFrame(Moment(float(t), x, v), P, S, own, supports, float(gap), problem, None))
    last = Pace(float(pace[0]), _moment(kept, "before"), _moment(kept, "last"), float(pace[1]))
    frames[-1] = replace(frames[-1], pace=last)
    return tuple(frames), rows


def _moment(kept: dict[str, Any], name: str) -> Moment | None:
    if f"{name}_t" not in kept:
        return None
    return Moment(float(kept[f"{name}_t"]), kept[f"{name}_x"], kept[f"{name}_v"])


def _name(scene: Scene, law: MembraneLaw) -> str:
    """A checksum of the scene without its duration and place, and of what its law answers."""
    assert scene.motion is not None
    told = replace(scene, motion=replace(scene.motion, duration=1e6), source=Path())
    probe = law.support(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.3, 2.0]]))
    return hashlib.sha256(f"{told!r} {law.cell!r} {probe.tolist()!r}".encode()).hexdigest()
