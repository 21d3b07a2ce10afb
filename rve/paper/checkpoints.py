"""Sweeps of the paper's scheme that survive being killed, cut into blocks that may run side by side.

Each block of load cases has one file, replaced as a whole (temporary file, then rename) every `save_every` batch steps
and at the end. A sweep started again with the same folder goes on from these files and gives the same bits as one that
was never stopped, in blocks of any size and on any number of workers: no case looks at another.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import signal
import threading
import zipfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rve.common.errors import InputError, NotConverged
from rve.common.files import atomic_path
from rve.common.reading import first_line, read_bytes
from rve.common.types import Array
from rve.equilibrium.system import Equations
from rve.geometry.contacts import SLOTS, joined_contacts
from rve.geometry.pose import Pose
from rve.geometry.weave import Weave
from rve.paper.stewart_trinkle import (
    Motion,
    Progress,
    Settled,
    StewartTrinkleOptions,
    begin,
    continued,
    finder_of,
    settled,
)

MOST_CHECKPOINT_BYTES = 200_000_000
"""A block of 48 load cases has 0.1 MB."""
MOST_NUMBER = 1e12
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


def load(path: Path, equations: Equations, options: StewartTrinkleOptions, key: str, count: int) -> Progress:
    """Read what `save` has written of `count` load cases.

    Raises InputError when the file cannot be read, is damaged, or belongs to other loads, radii or options.
    """
    arrays = _arrays(path, key)
    groups: dict[str, dict[str, Any]] = {"going": {}, "gone": {}}
    for name, value in arrays.items():
        group, _, column = name.partition("_")
        if group in groups:
            groups[group][column] = value
    try:
        _check_columns(groups, arrays.get("forces"), equations, count)
    except ValueError as error:
        raise InputError(_damaged(path, error)) from error
    going = _motion(groups["going"], equations, options)
    if not groups["gone"]:
        return Progress(going)
    return Progress(going, (_motion(groups["gone"], equations, options),), (arrays["forces"],))


def _damaged(path: Path, error: object) -> str:
    return f"{path}: is not a checkpoint of a sweep: {error}; delete it to start anew"


def _arrays(path: Path, key: str) -> dict[str, NDArray[Any]]:
    """Arrays by name of a stored npz file: none is larger than the file, and together they are not."""
    content = read_bytes(path, MOST_CHECKPOINT_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            is_stored = all(member.compress_type == zipfile.ZIP_STORED for member in members)
            if not is_stored or sum(member.file_size for member in members) > len(content):
                raise ValueError("it holds more than its own bytes")
            arrays = {member.filename.removesuffix(".npy"): _array(archive.read(member)) for member in members}
    except Exception as error:  # zipfile and the header of an array raise a dozen kinds, each for a damaged file
        raise InputError(_damaged(path, first_line(error))) from error
    if str(arrays.get("key")) != key:
        raise InputError(f"{path}: belongs to other loads, radii or options; delete it or choose another folder")
    return arrays


def _array(content: bytes) -> NDArray[Any]:
    """One npy file; ValueError unless its header states as many bytes as follow."""
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    if version != (1, 0):
        raise ValueError(f"npy version {version} is not read")
    shape, is_fortran, dtype = np.lib.format.read_array_header_1_0(file)
    left = len(content) - file.tell()
    if dtype.kind not in "fiU" or is_fortran or min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != left:
        raise ValueError(f"an array of shape {shape} and type {dtype} does not fill its {left} bytes")
    return np.frombuffer(content[file.tell() :], dtype).reshape(shape).copy()


def _check_columns(
    groups: dict[str, dict[str, NDArray[Any]]], forces: NDArray[Any] | None, equations: Equations, count: int
) -> None:
    """ValueError unless every column has its shape and finite numbers, and each of the `count` cases is there once."""
    classes, pairs = equations.weave.classes, len(equations.weave.pairs)
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(_PLAIN, ())
    shapes |= {"s": (3,), "v": (len(equations.mass),)}
    shapes |= {"lattice": (3,), "centres": (classes, 2), "normals": (classes, 3)}
    rows = [columns["row"] for columns in groups.values() if "row" in columns]
    if sorted(np.concatenate([np.zeros(0), *map(np.ravel, rows)]).tolist()) != list(range(count)):
        raise ValueError(f"its rows are not those of {count} load cases")
    for columns in filter(None, groups.values()):
        size = columns["row"].size if "row" in columns else 0
        for name, shape in shapes.items():
            _check_array(name, columns.get(name), (size, *shape))
        length = np.linalg.norm(columns["normals"], axis=-1)
        if np.abs(length - 1.0).max(initial=0.0) > 1e-6:
            raise ValueError("a normal is not of length 1")
    if groups["gone"]:
        _check_array("forces", forces, (groups["gone"]["row"].size, pairs, SLOTS))


def _check_array(name: str, value: NDArray[Any] | None, shape: tuple[int, ...]) -> None:
    kind = "i" if name in ("row", "steps", "rejected") else "f"
    if value is None or value.shape != shape or value.dtype.kind != kind:
        raise ValueError(f"{name} is not an array of shape {shape}")
    wrong = np.isnan(value) if name == "R" else ~(np.abs(value) <= MOST_NUMBER)  # R is infinite before the first step
    if wrong.any():
        raise ValueError(f"{name} holds a number that is not finite, or beyond {MOST_NUMBER:g}")


def _key(s: Array, wire: float, weave: Weave, options: StewartTrinkleOptions) -> str:
    """Fingerprint of everything that decides a result."""
    text = json.dumps([weave.name, weave.repeat, wire, asdict(options), s.tolist()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _solved_block(
    s: Array, weave: Weave, wire: float, options: StewartTrinkleOptions, path: Path | None, save_every: int
) -> Progress:
    equations, key = Equations.of(weave, wire), _key(s, wire, weave, options)
    known = path is not None and path.exists()
    progress = load(path, equations, options, key, len(s)) if path and known else begin(s, equations, options)
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

    wire = r2/r1. Raises InputError when the folder cannot be made or one of its files belongs to another sweep,
    NotConverged when a worker is ended from outside. Stopped (KeyboardInterrupt), it ends its workers at once; the same
    call goes on from the files.
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
    kept = "" if how.folder is None else f"what is solved is kept in {how.folder}, and the same command goes on there"
    try:
        done = _solved_side_by_side(jobs, how.workers) if how.workers > 1 else [_solved_block(*job) for job in jobs]
    except BrokenProcessPool as error:
        lost = "a worker process was ended from outside, perhaps for lack of memory; take fewer --workers"
        raise NotConverged("; ".join(filter(None, [lost, kept]))) from error
    except BaseException as error:
        if kept and not isinstance(error, Exception):  # stopped
            error.add_note(kept)
        raise
    return _joined([settled(progress, options) for progress in done])


def _solved_side_by_side(jobs: list[Any], workers: int) -> list[Progress]:
    with _pool(workers) as pool:
        return list(pool.map(_solved_block, *zip(*jobs, strict=True)))


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes that end when an error leaves the block, and when this process ends, however it does.

    They wait for the end of a pipe whose other end only this process holds.
    """
    context = get_context("spawn")
    watched, held = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_end_with, initargs=(watched,))
    try:
        yield pool
    except BaseException:
        held.close()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        held.close()
        watched.close()


def _end_with(watched: Connection) -> None:
    """Let this worker end at once when the pipe does; Ctrl-C is the parent's to handle."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def wait() -> None:
        with suppress(EOFError, OSError):
            watched.recv_bytes()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def _joined(parts: list[Settled]) -> Settled:
    def column(name: str) -> Any:
        return np.concatenate([getattr(part, name) for part in parts])

    pose = Pose(*(np.concatenate([getattr(part.pose, name) for part in parts]) for name in _POSE))
    count = sum(len(part.R) for part in parts)
    contacts = joined_contacts([part.contacts for part in parts], np.arange(count))
    plain = {name: column(name) for name in ("lam", "R", "steps", "rejected", "time", "status")}
    return Settled(pose=pose, contacts=contacts, **plain)
