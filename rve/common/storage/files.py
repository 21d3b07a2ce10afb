"""Single files: atomic writes, checksums, what an output may not overwrite, and versions of what has written it.

Jobs of several files are in `rve.common.storage.jobs`.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path

from rve.common.errors import InputError

AnyPath = str | os.PathLike[str]

TABLE_FORMAT = "ring-mesh strain-load table"
"""The entry `format` of a table's sidecar."""


@contextmanager
def atomic_path(path: AnyPath) -> Iterator[Path]:
    """A temporary path in the folder of `path`, with the same ending; moved to `path` when the block ends well.

    A link is followed: the file that it names is replaced. A process killed inside the block leaves the old file and a
    hidden temporary one. Raises InputError when the folder does not exist or cannot be written.
    """
    target = Path(os.path.realpath(path))
    try:
        handle, name = tempfile.mkstemp(prefix=".part-", suffix=target.suffix, dir=target.parent)
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


def write_whole(path: AnyPath, write: Callable[[Path], object]) -> None:
    """Let `write` fill a temporary path, which then replaces `path`; nothing is left behind if `write` fails."""
    with atomic_path(path) as temporary:
        write(temporary)


def write_text(path: AnyPath, text: str) -> None:
    """Write a text file, atomically."""
    write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


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
    target = Path(path)
    folder = Path(os.path.realpath(target)).parent
    if not check_replaceable(target, option, inputs):
        if not folder.is_dir():
            raise InputError(f"{option} = {target}: cannot be written: the folder {target.parent} does not exist")
    elif target.suffix == ".json" and is_sidecar(target):
        raise InputError(f"{option} = {target}: is the sidecar file of a table; choose another name")
    elif not os.access(target, os.W_OK):
        raise InputError(f"{option} = {target}: cannot be written: the file is write-protected")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{option} = {target}: cannot be written: the folder {folder} is write-protected")


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
    if stat.S_ISDIR(found.st_mode):
        raise InputError(f"{option} = {target}: is a folder; give the name of a file")
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{option} = {target}: is a device, pipe or socket; give the name of a file")
    for one in inputs:
        if one is None:
            continue
        if _is_same(target, Path(one)) or (_is_same(target, sidecar_path(one)) and is_sidecar(target)):
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


def versions() -> dict[str, str]:
    """Versions of what has computed a result."""
    out = {"python": platform.python_version()}
    for name in ("ring-mesh", "numpy", "scipy"):
        try:
            out[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            out[name] = "not installed"
    return out
