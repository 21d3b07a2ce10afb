"""Jobs: several files that appear in a folder together or not at all, and that replace those of the job before.

    with job("out", "summary.json") as folder:   # a hidden folder inside `out`
        ...                                      # write any files into `folder`, and the record summary.json

The record is a JSON file. It gets an entry `files`, the SHA-256 of every other file of the job by name, so that a
reader can tell whether a file and a record belong together (`check_belongs`). The next job with the same record in
the same folder removes the files that the record lists, as far as their content is still the listed one. Other files
are never removed.

How files take their places. All are written into `out/.summary.json-XXXX.new`, with a list of what to remove and to
place, and flushed to the disk. That folder is then renamed to `out/.summary.json.ready`: before this one step the old
job holds, after it the new one. The rest is bookkeeping that can be repeated: the old files are removed, the new ones
are moved to their names, the record last, and the hidden folder is removed. `complete` does this rest for a job whose
process was killed in between. The next job in the folder calls it first, and so does what reads a job's files together
(`rve localize`, `read_table`, a scene with a mesh file): they see the whole old or the whole new job, whenever the
process was killed.

What remains: between the rename and the last move, less than a millisecond for a few files, other programs see a part
of the files, first of the old job, then of the new one, never of both, and never the new record without all its files.
If the process is killed there, they see this until one of the commands above looks into the folder.
Signals that ask to stop (SIGINT, SIGTERM) wait for the end of this step. Two processes exclude each other by a lock on
the folder where the system has locks on folders (POSIX); elsewhere two jobs must not write into one folder at once,
and hidden folders that killed processes left are not removed.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from hashlib import sha256
from pathlib import Path, PurePosixPath
from typing import Any

from rve.common.errors import InputError
from rve.common.storage.files import AnyPath, check_out_folder, check_replaceable, checksum, write_text

FILES, PLAN = "files", "plan.json"
"""Inside the hidden folder: the files of the job, and which names to remove and which to place, in this order."""
STOPS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@contextmanager
def job(folder: AnyPath, record: str, inputs: Iterable[AnyPath | None] = (), *, clears: bool = True) -> Iterator[Path]:
    """A hidden folder for the files of a job; they take their places in `folder` when the block ends without an error.

    `folder` is made if need be. `record` is the name of the JSON file that stands for the job; the block must write it.
    `clears`: files of the old job that the new one lacks are removed. Raises InputError when `folder` cannot be made or
    written, or a file would overwrite one of `inputs`.
    """
    out, inputs = Path(folder), list(inputs)
    made = _made(out)
    staged = None
    try:
        complete(out, record)
        with ExitStack() as stack:
            with _locked(out):
                _remove_leftovers(out, record)
                staged = Path(tempfile.mkdtemp(prefix=f".{_tag(record)}-", suffix=".new", dir=out))
                stack.enter_context(_locked(staged))
            (staged / FILES).mkdir()
            yield staged / FILES
            for name in _names(staged):
                check_replaceable(out / name, "--out", inputs)
            _publish(staged, out, record, clears=clears)
    finally:
        if staged is not None:
            shutil.rmtree(staged, ignore_errors=True)
        with suppress(OSError):  # only folders that are new and have stayed empty can be removed
            for one in made:
                one.rmdir()


def check_out_job(folder: AnyPath, record: str, inputs: Iterable[AnyPath | None] = ()) -> None:
    """Refuse, before any work, a folder for a job that cannot be written or whose old files are among `inputs`.

    Raises InputError; nothing is made, but an interrupted job of the folder is completed.
    """
    check_out_folder(folder)
    out, inputs = Path(folder), list(inputs)
    complete(out, record)
    for name in (record, *_listed(out / record)):
        check_replaceable(out / name, "--out", inputs)


def complete(folder: AnyPath, record: str) -> None:
    """Put the files of an interrupted job in their places; nothing happens where there is none.

    Raises InputError if they cannot be put there.
    """
    out = Path(folder)
    try:
        if os.path.isdir(_ready(out, record)):  # False for names that no folder can have
            with _locked(out):
                _place(out, record)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{out}: the last job was interrupted and its files in {_ready(out, record)} cannot be moved to their "
            f"places: {error}; run a command where one can write to the folder, or remove that hidden folder"
        ) from error


def check_belongs(path: AnyPath, record: AnyPath, known: dict[str, Any], remedy: str) -> None:
    """InputError if the record `known`, read from the file `record`, lists files and none has the content of `path`.

    Records of older versions list none and are believed. Files may be renamed: they are told by their content.
    """
    sums = known.get("files")
    if sums is None:
        return
    if not isinstance(sums, dict):
        raise InputError(f"{record}: files = {sums!r}: is not a table of names and SHA-256 checksums")
    if checksum(path) not in sums.values():
        raise InputError(
            f"{path}: does not belong to {record}: its SHA-256 checksum is none of those listed there, so that one of "
            f"the two was changed or comes from another run; {remedy}"
        )


def _tag(record: str) -> str:
    """The part of hidden names that tells one job of a folder from another, short enough for any file system."""
    return record if len(record.encode()) <= 100 else sha256(record.encode()).hexdigest()[:32]


def _ready(out: Path, record: str) -> Path:
    return out / f".{_tag(record)}.ready"


def _made(out: Path) -> list[Path]:
    """The folders that had to be made for `out`, the innermost first."""
    missing = [one for one in (out, *out.parents) if not one.exists()]
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out = {out}: cannot be made: {error.strerror}") from error
    if not os.access(out, os.W_OK):
        raise InputError(f"--out = {out}: cannot be written")
    return missing


def _remove_leftovers(out: Path, record: str) -> None:
    """Remove hidden folders of killed processes: those that nobody has locked."""
    for one in out.glob(f".{_tag(record)}-*.new"):
        with ExitStack() as stack, suppress(OSError):
            if stack.enter_context(_locked(one, wait=False)):
                shutil.rmtree(one)


def _names(staged: Path) -> list[str]:
    files = staged / FILES
    return [path.relative_to(files).as_posix() for path in sorted(files.rglob("*")) if path.is_file()]


def _publish(staged: Path, out: Path, record: str, *, clears: bool) -> None:
    """Decide what the new job replaces, rename its folder, and let the files take their places."""
    names = [name for name in _names(staged) if name != record]
    _sign(staged / FILES, record, names)
    names.append(record)
    with _locked(out), _uninterrupted():
        _place(out, record)
        old = _listed(out / record) if clears else {}
        stale = [name for name, known in old.items() if name not in names and _is_own(out / name, known)]
        write_text(staged / PLAN, json.dumps({"remove": stale, "place": names}))
        _flush(staged)
        os.rename(staged, _ready(out, record))
        _flush_folder(out)
        _place(out, record)


def _sign(folder: Path, record: str, names: list[str]) -> None:
    """Add the checksums of the other files to the record."""
    path = folder / record
    content = json.loads(path.read_text(encoding="utf-8")) | {"files": {n: checksum(folder / n) for n in names}}
    write_text(path, json.dumps(content, indent=2) + "\n")


def _listed(record: Path) -> dict[str, str]:
    """Names and checksums of the files in a record; names that lead out of its folder are left out."""
    try:
        sums = json.loads(record.read_text(encoding="utf-8"))["files"]
        return {name: known for name, known in sums.items() if _is_inside(name) and isinstance(known, str)}
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return {}


def _is_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return bool(path.parts) and not path.is_absolute() and ".." not in path.parts and "\\" not in name


def _is_own(path: Path, known: str) -> bool:
    """Whether a file still is what a job wrote."""
    return path.is_file() and not path.is_symlink() and checksum(path) == known


def _place(out: Path, record: str) -> None:
    """Remove the old files and move the new ones from the hidden folder; continues where a killed process stopped."""
    ready = _ready(out, record)
    if not ready.is_dir():
        return
    if (ready / PLAN).exists():
        plan = json.loads((ready / PLAN).read_text(encoding="utf-8"))
        if not all(_is_inside(name) for name in (*plan["remove"], *plan["place"])):
            raise ValueError(f"{PLAN} names a file outside the folder")
        waiting = [name for name in plan["place"] if (ready / FILES / name).exists()]
        for name in reversed((*plan["remove"], *waiting)):  # the record first
            (out / name).unlink(missing_ok=True)
        for name in waiting:
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(ready / FILES / name, out / name)
        _flush_folder(out)
        (ready / PLAN).unlink()
    shutil.rmtree(ready)


def _flush(folder: Path) -> None:
    """Make sure that files and names are on the disk before the job counts."""
    for path in (*folder.rglob("*"), folder):
        if path.is_dir():
            _flush_folder(path)
        else:
            with path.open("rb") as file:
                os.fsync(file.fileno())


def _flush_folder(folder: Path) -> None:
    with suppress(OSError):  # not every system can flush a folder
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@contextmanager
def _locked(folder: Path, *, wait: bool = True) -> Iterator[bool]:
    """Hold the lock of a folder, which ends with the process at the latest; False where there is none to have."""
    handle, is_held = None, False
    try:
        with suppress(OSError, ImportError):
            import fcntl

            handle = os.open(folder, os.O_RDONLY)
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            is_held = True
        yield is_held
    finally:
        if handle is not None:
            os.close(handle)


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Signals that ask to stop are delivered when the block has ended."""
    if threading.current_thread() is not threading.main_thread():  # only the main thread gets signals
        yield
        return
    caught: list[int] = []
    before = {number: signal.signal(number, lambda got, frame: caught.append(got)) for number in STOPS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        if caught:
            signal.raise_signal(caught[0])
