"""Files: atomic writes, checksums, results of several files, and what an output may not overwrite.

    with job("out", "summary.json") as folder:   # a hidden folder inside `out`
        ...                                      # write any files into `folder`, and the record summary.json

The record is a JSON file. It gets an entry `files`, the SHA-256 of every other file by name. The files are moved to
their places one by one, the record last. A process that is killed in between leaves the old record, which refuses the
new files by their checksums (`check_belongs`). The next job removes the files that the old record lists, as far as
their content is still the listed one. Other files are never removed.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from typing import Any

from rve.common.errors import InputError

AnyPath = str | os.PathLike[str]

TABLE_FORMAT = "ring-mesh strain-load table"
"""The entry `format` of a table's sidecar."""
HIDDEN = ".part-"
"""Begins the names of temporary files and folders; what a killed process leaves of them may be removed."""


@contextmanager
def atomic_path(path: AnyPath) -> Iterator[Path]:
    """A temporary path in the folder of `path`, with the same ending; moved to `path` when the block ends well.

    A link is followed: the file that it names is replaced. A process killed inside the block leaves the old file and a
    hidden temporary one. Raises InputError when the folder does not exist or cannot be written.
    """
    target = Path(os.path.realpath(path))
    try:
        handle, name = tempfile.mkstemp(prefix=HIDDEN, suffix=target.suffix, dir=target.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: AnyPath, text: str) -> None:
    """Write a text file, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def checksum(path: AnyPath) -> str:
    """SHA-256 of the content of a file, in hexadecimal, as `sha256sum` prints it."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def versions(*more: str) -> dict[str, str]:
    """Versions of what has computed a result; `more` packages besides those of every result."""
    found = {"python": platform.python_version()}
    for name in ("ring-mesh", "numpy", "scipy", *more):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "absent"
    return found


def sidecar_path(path: AnyPath) -> Path:
    """The JSON beside a table file, of the same name."""
    table = Path(path)
    return table.with_suffix(".json") if table.name else table  # "." and "/" have no name to change


def beside(path: AnyPath, ending: str) -> Path:
    """A new name for what belongs to a file or folder: "curtain" and "rings" give "curtain_rings".

    >>> print(beside("curtain", "rings"), beside(".", "rings"))
    curtain_rings rings
    """
    known = Path(path)
    return known.with_name(f"{known.name}_{ending}") if known.name not in ("", "..") else known / ending


def is_sidecar(path: AnyPath) -> bool:
    """Whether a file is there and is the sidecar of a table."""
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(found, dict) and found.get("format") == TABLE_FORMAT


def check_out_file(path: AnyPath, option: str = "--out", inputs: Iterable[AnyPath | None] = ()) -> None:
    """InputError for a file that cannot be written, is the sidecar of any table, or is read: one of `inputs` or its
    sidecar, by any name. Nothing is written or made."""
    check_writable(path, option, inputs)
    if Path(path).suffix == ".json" and is_sidecar(path):
        raise InputError(f"{option} = {path}: is the sidecar file of a table; choose another name")


def check_writable(path: AnyPath, option: str, inputs: Iterable[AnyPath | None] = ()) -> None:
    """`check_out_file` for whoever may replace the sidecar of a table."""
    target, folder = Path(path), Path(os.path.realpath(path)).parent
    if not folder.is_dir():
        raise InputError(f"{option} = {target}: cannot be written: the folder {target.parent} does not exist")
    if not all(os.access(one, os.W_OK) for one in (folder, target) if _exists(one, option)):
        raise InputError(f"{option} = {target}: cannot be written: it or its folder is write-protected")
    _check_replaceable(target, option, inputs)


def _check_replaceable(target: Path, option: str, inputs: Iterable[AnyPath | None]) -> None:
    if _exists(target, option) and not target.is_file():
        raise InputError(f"{option} = {target}: is a folder, device, pipe or socket; give the name of a file")
    for one in inputs:
        read = [] if one is None else [Path(one), sidecar_path(one)]
        if any(path.exists() and target.exists() and target.samefile(path) for path in read):
            raise InputError(
                f"{option} = {target}: would overwrite {one} or its sidecar, which is read; choose another name"
            )


def _exists(path: Path, option: str) -> bool:
    try:
        return path.exists()
    except OSError as error:  # a name that no file can have
        raise InputError(f"{option} = {path}: cannot be written: {error.strerror}") from error


def check_out_folder(path: AnyPath, option: str = "--out") -> None:
    """InputError for a folder that cannot be made or written. Nothing is made."""
    folder = Path(path).absolute()
    there = next(one for one in (folder, *folder.parents) if _exists(one, option))
    if not there.is_dir():
        raise InputError(f"{option} = {path}: cannot be written: {there} is a file, not a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{option} = {path}: cannot be written: the folder {there} is write-protected")


def make_folder(path: AnyPath, option: str = "--out") -> Path:
    """Make a folder if it is not there, and those above it; InputError if that cannot be."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{option} = {path}: cannot be made: {error.strerror}; give another folder") from error
    return Path(path)


def check_out_job(folder: AnyPath, record: str, inputs: Iterable[AnyPath | None] = ()) -> None:
    """InputError, before any work, for a folder for a result that cannot be written or whose old files are read."""
    check_out_folder(folder)
    inputs = list(inputs)
    for name in (record, *_listed(Path(folder), record)):
        _check_replaceable(Path(folder, name), "--out", inputs)


@contextmanager
def job(folder: AnyPath, record: str, inputs: Iterable[AnyPath | None] = (), *, clears: bool = True) -> Iterator[Path]:
    """A hidden folder for the files of a result; they take their places in `folder` when the block ends well.

    `folder` is made if need be. `record` is the name of the JSON file that stands for the result; the block must write
    it. `clears`: files of the old result that the new one lacks are removed. Raises InputError when `folder` cannot be
    made or written, or a file would overwrite one of `inputs`.
    """
    out, inputs = Path(folder), list(inputs)
    check_out_folder(out)
    made = [one for one in (out, *out.parents) if not one.exists()]
    make_folder(out)
    try:
        staged = Path(tempfile.mkdtemp(prefix=HIDDEN, dir=out))
    except OSError as error:
        raise InputError(f"--out = {out}: cannot be written: {error.strerror}") from error
    try:
        yield staged
        _publish(staged, out, record, inputs, clears=clears)
    finally:
        shutil.rmtree(staged, ignore_errors=True)
        with suppress(OSError):  # only folders that are new and have stayed empty can be removed
            for one in made:
                one.rmdir()


def _publish(staged: Path, out: Path, record: str, inputs: Iterable[AnyPath | None], *, clears: bool) -> None:
    """Remove what the old result alone has, and move the new files to their places, the record last."""
    names = [path.relative_to(staged).as_posix() for path in sorted(staged.rglob("*")) if path.is_file()]
    for name in names:
        _check_replaceable(out / name, "--out", inputs)
    names.remove(record)
    content = json.loads((staged / record).read_text(encoding="utf-8"))
    content["files"] = {name: checksum(staged / name) for name in names}
    write_text(staged / record, json.dumps(content, indent=2) + "\n")
    for name, known in _listed(out, record).items() if clears else ():
        if name not in names and (out / name).is_file() and checksum(out / name) == known:
            (out / name).unlink()
    for name in (*names, record):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(staged / name, out / name)


def _listed(folder: Path, record: str) -> dict[str, str]:
    """Names and checksums of the files that a record lists; names that lead out of its folder are left out."""
    try:
        sums = json.loads((folder / record).read_text(encoding="utf-8"))["files"]
        inside = folder.resolve()
        return {name: known for name, known in sums.items() if (folder / name).resolve().is_relative_to(inside)}
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return {}


def check_belongs(path: AnyPath, record: AnyPath, known: dict[str, Any], remedy: str) -> None:
    """InputError if the record `known`, read from the file `record`, lists files and none has the content of `path`.

    Records of older versions list none and are believed. Files may be renamed: they are told by their content.
    """
    sums = known.get("files")
    if sums is not None and not (isinstance(sums, dict) and checksum(path) in sums.values()):
        raise InputError(
            f"{path}: does not belong to {record}: its SHA-256 checksum is none of those listed there, so that one of "
            f"the two was changed or comes from another run; {remedy}"
        )
