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
import stat
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path, PurePosixPath
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


def sidecar_path(path: AnyPath) -> Path:
    """The JSON beside a table file, of the same name."""
    table = Path(path)
    return table.with_suffix(".json") if table.name else table  # "." and "/" have no name to change


def is_sidecar(path: AnyPath) -> bool:
    """Whether a file is the sidecar of a table, as `rve.table` writes it or made by hand."""
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(found, dict) and (found.get("format") == TABLE_FORMAT or {"r1_mm", "b_x_mm"} <= found.keys())


def check_out_file(path: AnyPath, option: str = "--out", inputs: Iterable[AnyPath | None] = ()) -> None:
    """Refuse a file that cannot be written, or whose writing would destroy something else.

    That is a folder, device, pipe or socket; a file that is write-protected; one of `inputs` or the sidecar of one,
    by whatever name or link; the sidecar of a table. Raises InputError; nothing is written or made.
    """
    target, folder = Path(path), Path(os.path.realpath(path)).parent
    is_there, why = check_replaceable(target, option, inputs), ""
    if not is_there and not folder.is_dir():
        why = f"cannot be written: the folder {target.parent} does not exist"
    elif is_there and target.suffix == ".json" and is_sidecar(target):
        why = "is the sidecar file of a table; choose another name"
    elif not os.access(target if is_there else folder, os.W_OK) or not os.access(folder, os.W_OK | os.X_OK):
        why = "cannot be written: it or its folder is write-protected"
    if why:
        raise InputError(f"{option} = {target}: {why}")


def check_out_table(path: AnyPath, option: str = "--out", inputs: Iterable[AnyPath | None] = ()) -> None:
    """`check_out_file` for a table and its sidecar; a sidecar may only replace the sidecar of a table."""
    target, sidecar, inputs = Path(path), sidecar_path(path), list(inputs)
    if sidecar == target:
        raise InputError(f"{option} = {target}: is the name of the table's sidecar file; choose a name such as *.csv")
    check_out_file(target, option, inputs)
    if check_replaceable(sidecar, option, inputs) and not is_sidecar(sidecar):
        raise InputError(
            f"{option} = {target}: its sidecar file would overwrite {sidecar}, which is not the sidecar of a table; "
            "choose another name"
        )


def check_replaceable(target: Path, option: str, inputs: Iterable[AnyPath | None]) -> bool:
    """Whether something is there already; InputError if it is no regular file, or one of the inputs or their sidecars.

    `inputs` are files that are read; None among them is skipped.
    """
    found = _status(target, option)
    if found is None:
        return False
    if not stat.S_ISREG(found.st_mode):
        kind = "folder" if stat.S_ISDIR(found.st_mode) else "device, pipe or socket"
        raise InputError(f"{option} = {target}: is a {kind}; give the name of a file")
    for one in inputs:
        if one is not None and (
            _is_same(target, Path(one)) or (_is_same(target, sidecar_path(one)) and is_sidecar(target))
        ):
            raise InputError(
                f"{option} = {target}: would overwrite {one} or its sidecar, which is read; choose another name"
            )
    return True


def check_out_folder(path: AnyPath, option: str = "--out") -> None:
    """Refuse a folder that cannot be made or written; raises InputError. Nothing is made."""
    folder = Path(path)
    found = _status(folder, option)
    if found is None:
        above = next((one for one in folder.absolute().parents if one.exists()), None)
        if above is not None and not (above.is_dir() and os.access(above, os.W_OK)):
            raise InputError(f"{option} = {folder}: cannot be made in {above}, which is no folder one can write to")
    elif not stat.S_ISDIR(found.st_mode):
        raise InputError(f"{option} = {folder}: is a file, not a folder; give the name of a folder")
    elif not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{option} = {folder}: cannot be written: the folder is write-protected")


def _status(path: Path, option: str) -> os.stat_result | None:
    """What is there, behind links; None for nothing, or for a link that leads nowhere."""
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise InputError(f"{option} = {path}: cannot be written: {error.strerror}") from error


def _is_same(one: Path, other: Path) -> bool:
    try:
        return one.samefile(other)
    except (OSError, ValueError):  # a name that no file can have
        return False


def versions(*more: str) -> dict[str, str]:
    """Versions of what has computed a result; `more` packages besides those of every result."""
    found = {"python": platform.python_version()}
    for name in ("ring-mesh", "numpy", "scipy", *more):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "absent"
    return found


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
    try:
        out.mkdir(parents=True, exist_ok=True)
        staged = Path(tempfile.mkdtemp(prefix=HIDDEN, dir=out))
    except OSError as error:
        raise InputError(f"--out = {out}: cannot be written: {error.strerror}") from error
    try:
        yield staged
        for name in _names(staged):
            check_replaceable(out / name, "--out", inputs)
        _publish(staged, out, record, clears=clears)
    finally:
        shutil.rmtree(staged, ignore_errors=True)
        with suppress(OSError):  # only folders that are new and have stayed empty can be removed
            for one in made:
                one.rmdir()


def check_out_job(folder: AnyPath, record: str, inputs: Iterable[AnyPath | None] = ()) -> None:
    """Refuse, before any work, a folder for a result that cannot be written or whose old files are among `inputs`.

    Raises InputError; nothing is made.
    """
    check_out_folder(folder)
    out, inputs = Path(folder), list(inputs)
    for name in (record, *_listed(out / record)):
        check_replaceable(out / name, "--out", inputs)


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


def beside(path: AnyPath, ending: str) -> Path:
    """A new name for what belongs to a file or folder: "curtain" and "rings" give "curtain_rings".

    >>> print(beside("curtain", "rings"), beside(".", "rings"))
    curtain_rings rings
    """
    known = Path(path)
    return known.with_name(f"{known.name}_{ending}") if known.name not in ("", "..") else known / ending


def _names(folder: Path) -> list[str]:
    return [path.relative_to(folder).as_posix() for path in sorted(folder.rglob("*")) if path.is_file()]


def _publish(staged: Path, out: Path, record: str, *, clears: bool) -> None:
    """Remove what the old result alone has, and move the new files to their places, the record last."""
    names = [name for name in _names(staged) if name != record]
    content = json.loads((staged / record).read_text(encoding="utf-8"))
    content["files"] = {name: checksum(staged / name) for name in names}
    write_text(staged / record, json.dumps(content, indent=2) + "\n")
    for name, known in _listed(out / record).items() if clears else ():
        if name not in names and _is_own(out / name, known):
            (out / name).unlink()
    for name in (*names, record):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(staged / name, out / name)


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
