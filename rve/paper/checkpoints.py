"""Solves of the paper's scheme in blocks of load cases, side by side and with files from which they can be resumed.

Each block has one JSON file, written when the block is solved. A sweep started again with the same folder reads the
blocks that are there and solves the others. No case depends on another, so that results are the same to the bit for
blocks of any size and any number of workers.
"""

from __future__ import annotations

import hashlib
import json
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from rve.common.errors import InputError, NotConverged
from rve.common.progress import part_of, tell
from rve.common.storage.files import AnyPath, check_out_folder, write_text
from rve.common.storage.reading import read_json_object
from rve.common.types import Array
from rve.common.values import Check, Options, checked, list_of, numbers, one_of, whole
from rve.common.workers import worker_pool
from rve.equilibrium.system import Equations
from rve.geometry.contacts import SLOTS
from rve.geometry.pose import Pose
from rve.geometry.weave import Weave
from rve.paper.dynamics import StewartTrinkleOptions
from rve.paper.stewart_trinkle import NO_STEP, Settled, finder_of, solve

WITHOUT_FILES = 256
"""Load cases of a block that has no file."""
_COUNTS = ("steps", "rejected")
_POSE = ("lattice", "centres", "normals")


@dataclass(frozen=True)
class SweepOptions(Options):
    """folder: where the files go, none without; block: load cases per file; workers: processes side by side.

    A killed sweep loses the blocks that were being solved; smaller blocks lose less and take longer.
    """

    folder: AnyPath | None = None
    block: int = whole(12, least=1, most=1_000_000)
    workers: int = whole(1, least=1, most=1_000)


def save(path: Path, rest: Settled, key: str) -> None:
    """Write a solved block, atomically; `key` identifies what was solved."""
    columns = {name: getattr(rest.pose, name) for name in _POSE}
    columns |= {name: getattr(rest, name) for name in ("lam", "R", "time", "status", *_COUNTS)}
    write_text(path, json.dumps({"key": key} | {name: values.tolist() for name, values in columns.items()}) + "\n")


def load(path: Path, equations: Equations, options: StewartTrinkleOptions, key: str, count: int) -> Settled:
    """Read what `save` has written of `count` load cases.

    Raises InputError if the file cannot be read, is damaged, or belongs to other loads, radii or options.
    """
    found = read_json_object(path)
    if found.get("key") != key:
        raise InputError(f"{path}: belongs to other loads, radii or options; delete it or choose another folder")
    classes, pairs = equations.weave.classes, len(equations.weave.pairs)
    whole_numbers = numbers(count, least=0, most=2.0**53)
    checks: dict[str, Check] = {
        "lattice": numbers(count, 3),
        "centres": numbers(count, classes, 2),
        "normals": numbers(count, classes, 3, least=-1.0 - 1e-9, most=1.0 + 1e-9),
        "lam": numbers(count, pairs, SLOTS, least=0.0),
        "R": numbers(count, least=0.0, most=NO_STEP),
        "time": numbers(count, least=0.0),
        "status": list_of(one_of("converged", "step-limit", "time-step"), "words", least=count, most=count),
        **dict.fromkeys(_COUNTS, whole_numbers),
    }
    columns = {name: checked(found, name, check, f"{path}:") for name, check in checks.items()}
    for name in ("lattice", "centres"):
        if np.abs(columns[name]).max() > 1e6:
            raise InputError(
                f"{path}: {name} reaches {np.abs(columns[name]).max():g} r1; delete the file to start anew"
            )
    if np.abs(np.linalg.norm(columns["normals"], axis=2) - 1.0).max() > 1e-6:
        raise InputError(f"{path}: normals: one is not of length 1; delete the file to start anew")
    pose = Pose(*(columns.pop(name) for name in _POSE))
    columns |= {name: columns[name].astype(int) for name in _COUNTS} | {"status": np.array(columns["status"], "<U16")}
    contacts = finder_of(options)(pose, equations.weave, equations.wire, options.reach)
    return Settled(pose=pose, contacts=contacts, **columns)


def checkpoint_key(s: Array, wire: float, weave: Weave, options: StewartTrinkleOptions) -> str:
    """Fingerprint of everything that decides a result."""
    text = json.dumps([weave.name, weave.repeat, wire, asdict(options), s.tolist()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _solved_block(s: Array, weave: Weave, wire: float, options: StewartTrinkleOptions, path: Path | None) -> Settled:
    equations, key = Equations.of(weave, wire), checkpoint_key(s, wire, weave, options)
    if path is not None and path.exists():
        return load(path, equations, options, key, len(s))
    rest = solve(s, equations, options)
    if path is not None:
        save(path, rest, key)
    return rest


def sweep(
    s: Array,
    weave: Weave,
    wire: float,
    options: StewartTrinkleOptions | None = None,
    how: SweepOptions | None = None,
) -> Settled:
    """Like `stewart_trinkle.solve` for loads s (n, 3), in blocks, with files from which it can be resumed.

    wire = r2/r1. Raises InputError when the folder cannot be made or one of its files belongs to another sweep,
    NotConverged when a worker is ended from outside. Stopped (KeyboardInterrupt), it ends its workers at once.
    """
    options, how = options or StewartTrinkleOptions(), how or SweepOptions()
    kept = ""
    with ExitStack() as stack:
        if how.folder is not None:
            check_out_folder(how.folder, "checkpoints")
            Path(how.folder).mkdir(parents=True, exist_ok=True)
            kept = f"solved blocks are kept in {how.folder}, and the same command continues from there"
        shared = how.folder or (stack.enter_context(TemporaryDirectory()) if how.workers > 1 else None)
        size = how.block if shared else WITHOUT_FILES
        blocks = [s[i : i + size] for i in range(0, len(s), size)]
        paths = [Path(shared) / f"block-{i:04d}.json" if shared else None for i in range(len(blocks))]
        jobs = [(block, weave, wire, options, path) for block, path in zip(blocks, paths, strict=True)]
        try:
            if how.workers > 1:
                tell(f"motion of {len(s)} cells, 0 of {len(jobs)} blocks", 0.0)
                with worker_pool(how.workers) as pool:
                    for number, _ in enumerate(pool.map(_keep_block, jobs), 1):
                        tell(f"motion of {len(s)} cells, {number} of {len(jobs)} blocks", number / len(jobs))
            parts = []
            for number, job in enumerate(jobs):  # read, if workers have solved them
                with part_of(f"motion of {len(s)} cells", number / len(jobs), (number + 1) / len(jobs)):
                    parts.append(_solved_block(*job))
        except BrokenProcessPool as error:
            lost = "a worker process was ended from outside, perhaps for lack of memory; take fewer --workers"
            raise NotConverged("; ".join(filter(None, [lost, kept]))) from error
        except BaseException as error:
            if kept and not isinstance(error, Exception):  # stopped
                error.add_note(kept)
            raise
    return parts[0].join(parts[1:])


def _keep_block(job: tuple[Any, ...]) -> None:
    """Solve a block into its file. Nothing is sent back: a worker that ends while it sends would block the parent."""
    _solved_block(*job)
