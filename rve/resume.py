"""Sweeps of the paper's scheme that survive being killed, cut into blocks that may run side by side.

Each block of load cases has one file, replaced as a whole (temporary file, then rename) every `save_every` batch steps
and at the end. A sweep started again with the same folder goes on from these files and gives the same bits as one that
was never stopped, in blocks of any size and on any number of workers: no case looks at another.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rve.cell import Pose, joined_contacts
from rve.errors import InputError
from rve.files import atomic_path
from rve.stewart_trinkle import Motion, Progress, Settled, StewartTrinkleOptions, begin, continued, finder_of, settled
from rve.system import Equations
from rve.weave import Weave

Array = NDArray[np.float64]

_PLAIN = ("row", "s", "v", "h", "time", "steps", "rejected", "R")
_POSE = ("lattice", "centres", "normals")


@dataclass(frozen=True)
class SweepOptions:
    """folder: where the files go, none without; block: load cases per file; workers: processes side by side;
    save_every: batch steps between two savings.
    """

    folder: str | os.PathLike[str] | None = None
    block: int = 48
    workers: int = 1
    save_every: int = 50


def _columns(motions: tuple[Motion, ...]) -> dict[str, Any]:
    out = {name: np.concatenate([getattr(motion, name) for motion in motions]) for name in _PLAIN}
    return out | {name: np.concatenate([getattr(motion.pose, name) for motion in motions]) for name in _POSE}


def _motion(columns: dict[str, Any], equations: Equations, options: StewartTrinkleOptions) -> Motion:
    pose = Pose(*(columns[name] for name in _POSE))
    contacts = finder_of(options)(pose, equations.weave, equations.wire, options.reach)
    plain = {name: columns[name] for name in _PLAIN}
    return Motion(pose=pose, contacts=contacts, **plain)


def save(path: Path, progress: Progress, key: str) -> None:
    """Write a solve under way to an npz file, whole or not at all; `key` says what is being solved."""
    arrays = {f"going_{name}": value for name, value in _columns((progress.going,)).items()}
    if progress.gone:
        arrays |= {f"gone_{name}": value for name, value in _columns(progress.gone).items()}
        arrays["forces"] = np.concatenate(progress.forces)
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, key=np.array(key), **arrays)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


def load(path: Path, equations: Equations, options: StewartTrinkleOptions, key: str) -> Progress:
    """Read what `save` has written.

    Raises InputError when the file cannot be read or belongs to other loads, radii or options.
    """
    try:
        content = path.read_bytes()
        if not zipfile.is_zipfile(io.BytesIO(content)):  # numpy leaves a half-open archive behind
            raise ValueError("not an npz archive")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = dict(file)
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: is not a checkpoint of a sweep: {error}; delete it to start anew") from error
    if str(arrays.get("key")) != key:
        raise InputError(f"{path}: belongs to other loads, radii or options; delete it or choose another folder")
    groups: dict[str, dict[str, Any]] = {"going": {}, "gone": {}}
    for name, value in arrays.items():
        group, _, column = name.partition("_")
        if group in groups:
            groups[group][column] = value
    going = _motion(groups["going"], equations, options)
    if not groups["gone"]:
        return Progress(going)
    return Progress(going, (_motion(groups["gone"], equations, options),), (arrays["forces"],))


def _key(s: Array, wire: float, weave: Weave, options: StewartTrinkleOptions) -> str:
    """Fingerprint of everything that decides a result."""
    text = json.dumps([weave.name, weave.repeat, wire, asdict(options), s.tolist()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _solved_block(
    s: Array, weave: Weave, wire: float, options: StewartTrinkleOptions, path: Path | None, save_every: int
) -> Progress:
    equations, key = Equations.of(weave, wire), _key(s, wire, weave, options)
    known = path is not None and path.exists()
    progress = load(path, equations, options, key) if path and known else begin(s, equations, options)
    while len(progress.going.row):
        progress = continued(progress, equations, options, save_every)
        if path is not None:
            save(path, progress, key)
    return progress


def sweep(
    s: Array,
    weave: Weave,
    wire: float,
    options: StewartTrinkleOptions | None = None,
    how: SweepOptions | None = None,
) -> Settled:
    """Like `stewart_trinkle.solve` for loads s (n, 3), in blocks, with files from which it can be resumed.

    wire = r2/r1. Raises InputError when the folder cannot be made or one of its files belongs to another sweep.
    """
    options, how = options or StewartTrinkleOptions(), how or SweepOptions()
    options.validate()
    blocks = [s[i : i + how.block] for i in range(0, len(s), how.block)]
    paths: list[Path | None] = [None] * len(blocks)
    if how.folder is not None:
        folder = Path(how.folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be made: {error.strerror}") from error
        paths = [folder / f"block-{i:04d}.npz" for i in range(len(blocks))]
    jobs = [(block, weave, wire, options, path, how.save_every) for block, path in zip(blocks, paths, strict=True)]
    if how.workers > 1:
        with ProcessPoolExecutor(how.workers, mp_context=get_context("spawn")) as pool:
            done = list(pool.map(_solved_block, *zip(*jobs, strict=True)))
    else:
        done = [_solved_block(*job) for job in jobs]
    return _joined([settled(progress, options) for progress in done])


def _joined(parts: list[Settled]) -> Settled:
    def column(name: str) -> Any:
        return np.concatenate([getattr(part, name) for part in parts])

    pose = Pose(*(np.concatenate([getattr(part.pose, name) for part in parts]) for name in _POSE))
    count = sum(len(part.R) for part in parts)
    contacts = joined_contacts([part.contacts for part in parts], np.arange(count))
    plain = {name: column(name) for name in ("lam", "R", "steps", "rejected", "time", "status")}
    return Settled(pose=pose, contacts=contacts, **plain)
