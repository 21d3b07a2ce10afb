"""Files: atomic writes, results of several files, what an output may not overwrite, and answers that are kept.

    with job("out", "summary.json", {"status": "converged"}) as folder:   # a hidden folder inside `out`
        ...                                                               # write any files into `folder`

The record is written as JSON with an entry `files`, the SHA-256 of every other file by name. The files are moved to
their places one by one, the record last. A process that is killed in between leaves the old record, which refuses the
new files by their checksums (`check_belongs`). The next job removes the files that the old record lists, as far as
their content is still the listed one. Other files are never removed.
"""

import hashlib
import json
import os
import platform
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any
from uuid import uuid4

import msgspec

from rve.common.errors import InputError

AnyPath = str | os.PathLike[str]
Inputs = Iterable[AnyPath | None]
Record = Mapping[str, Any]
JsonObject = dict[str, Any]
"""An object of a JSON file or a table of a TOML file, as it is read or before it is written."""

TABLE_FORMAT = "ring-mesh strain-load table"
"""The entry `format` of a table's sidecar."""
HIDDEN = ".part-"
"""Begins the names of temporary files and folders; what a killed process leaves of them may be removed."""
UNREADABLE = (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""What JSON that is missing, damaged or of another kind raises where its entries are used."""


PLUGINS: dict[str, str] = {}
"""Files of plugins that this process has imported (`rve.common.plugins`): absolute path to SHA-256."""


@contextmanager
def _staging(folder: Path, name: str, *, makes: bool = False) -> Iterator[Path]:
    """A new hidden folder inside `folder`, removed at the end; InputError, "name: cannot ...", if it cannot be made.

    makes: `folder` and those above it are made if need be, and removed if they stay empty.
    """
    staged, new = folder / f"{HIDDEN}{uuid4().hex[:12]}", list[Path]()
    try:
        try:
            new = [one for one in (folder, *folder.parents) if makes and not one.exists()]
            if makes:
                folder.mkdir(parents=True, exist_ok=True)
            staged.mkdir(mode=0o700)
        except OSError as error:
            said = "is a file, give a folder" if makes and folder.is_file() else f"cannot be written: {error.strerror}"
            raise InputError(f"{name}: {said}") from error
        yield staged
    finally:  # also of a process that is stopped while it makes the folder
        shutil.rmtree(staged, ignore_errors=True)
        with suppress(OSError):  # only empty folders can be removed
            for one in new:
                one.rmdir()


@contextmanager
def atomic_path(path: AnyPath) -> Iterator[Path]:
    """A temporary path with the same name; the file written there is moved to `path` when the block ends well.

    A link is followed: the file that it names is replaced. A process killed inside the block leaves the old file and a
    hidden folder. Raises InputError when the folder of `path` does not exist or cannot be written.
    """
    target = Path(os.path.realpath(path))
    with _staging(target.parent, str(path)) as folder:
        yield folder / target.name
        os.replace(folder / target.name, target)


def write_text(path: AnyPath, text: str) -> None:
    """Write a text file, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_mesh_file(path: AnyPath, mesh: Any) -> None:
    """Write a `meshio.Mesh` as VTU, atomically."""
    import meshio

    with atomic_path(path) as temporary:
        meshio.vtu.write(temporary, mesh)


def json_text(record: Mapping[str, Any], indent: int = 2) -> str:
    """A record as JSON with a line end: arrays as lists, null for numbers that are not finite.

    >>> print(json_text({"force_N": [1.5, float("nan")]}), end="")
    {
      "force_N": [
        1.5,
        null
      ]
    }
    """
    text = msgspec.json.encode({**record}, enc_hook=lambda value: value.tolist())  # arrays and numbers of numpy
    return msgspec.json.format(text, indent=indent).decode() + "\n"


def checksum(path: AnyPath) -> str:
    """SHA-256 of the content of a file, in hexadecimal, as `sha256sum` prints it."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def versions(*more: str) -> dict[str, str]:
    """Versions of what has computed a result, of plugins their checksums; `more` packages besides those of all."""
    found = {"python": platform.python_version()}
    for name in ("ring-mesh", "numpy", "scipy", *more):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "absent"
    return found | {f"plugin {Path(path).name}": content for path, content in PLUGINS.items()}


def clear_parts(folder: Path) -> None:
    """Remove what processes that were killed had not yet put into its place in a folder."""
    for left in folder.glob(f"{HIDDEN}*"):
        shutil.rmtree(left, ignore_errors=True)


def sidecar_path(path: AnyPath) -> Path:
    """The JSON beside a table file, of the same name."""
    table = Path(path)
    return table.with_suffix(".json") if table.name else table  # "." and "/" have no name to change


def check_out_file(
    path: AnyPath,
    option: str = "--out",
    inputs: Inputs = (),
    endings: tuple[str, ...] = (),
    *,
    is_sidecar: bool = False,
) -> None:
    """InputError, before any work, for a file that cannot be written, is one of `inputs` or its sidecar, or whose name
    has none of the `endings`, where there are any. The sidecar of a table and other JSON do not replace each other."""
    if endings and Path(path).suffix.lower() not in endings:
        raise InputError(f"{option} = {path}: give a name that ends in {' or '.join(filter(None, endings))}")
    with _staging(Path(os.path.realpath(path)).parent, f"{option} = {path}"):
        _check_target(Path(path), option, inputs)
    if Path(path).suffix == ".json" and Path(path).exists() and _is_sidecar(Path(path)) != is_sidecar:
        what = "is not that of a table, which would replace it" if is_sidecar else "is the sidecar file of a table"
        raise InputError(f"{option} = {path}: {what}; choose another name")


def _is_sidecar(path: Path) -> bool:
    try:
        return bool(json.loads(path.read_text(encoding="utf-8"))["format"] == TABLE_FORMAT)
    except UNREADABLE:
        return False


def check_out_job(folder: AnyPath, record: str, inputs: Inputs = ()) -> None:
    """InputError, before any work, for a folder that cannot be made or written, or whose old files are `inputs`."""
    out, inputs = Path(folder), list(inputs)
    with _staging(out, f"--out = {folder}", makes=True):
        for name in (record, *_listed(out, record)):
            _check_target(out / name, "--out", inputs)


def _check_target(target: Path, option: str, inputs: Inputs) -> None:
    """InputError for what is there and no file, and for one of `inputs` or its sidecar, by any name."""
    if not os.path.exists(target):
        return
    if not target.is_file():
        raise InputError(f"{option} = {target}: is a folder, device, pipe or socket; give the name of a file")
    for one in inputs:
        read = [] if one is None else [Path(one), sidecar_path(one)]
        if any(path.exists() and target.samefile(path) for path in read):
            raise InputError(
                f"{option} = {target}: would overwrite {one} or its sidecar, which is read; choose another name"
            )


@contextmanager
def job(folder: AnyPath, name: str, record: Record, inputs: Inputs = (), *, adds: bool = False) -> Iterator[Path]:
    """A hidden folder for the files of a result; they take their places in `folder` when the block ends well.

    `folder` is made if need be. The file `name` stands for the result: it holds the `record`, as it is at the end of
    the block. adds: files join those that `name` lists already, as pictures do whose data are in place. InputError for
    a folder that cannot be written, and when a new file would overwrite one of `inputs`.
    """
    out, inputs = Path(folder), list(inputs)
    with _staging(out, f"--out = {folder}", makes=True) as staged:
        yield staged
        names = [path.relative_to(staged).as_posix() for path in sorted(staged.rglob("*")) if path.is_file()]
        for one in (*names, name):
            _check_target(out / one, "--out", inputs)
        before = _listed(out, name)
        sums = (before if adds else {}) | {one: checksum(staged / one) for one in names}
        (staged / name).write_text(json_text({**record, "files": sums}), encoding="utf-8")
        for one, known in before.items():
            if one not in sums and (out / one).is_file() and checksum(out / one) == known:
                (out / one).unlink()
        for one in (*names, name):
            (out / one).parent.mkdir(parents=True, exist_ok=True)
            os.replace(staged / one, out / one)


def _listed(folder: Path, record: str) -> dict[str, str]:
    """Names and checksums of the files that a record lists; names that lead out of its folder are left out."""
    try:
        sums = json.loads((folder / record).read_text(encoding="utf-8"))["files"]
        inside = folder.resolve()
        return {name: known for name, known in sums.items() if (folder / name).resolve().is_relative_to(inside)}
    except UNREADABLE:
        return {}


def check_belongs(path: AnyPath, record: AnyPath, known: Mapping[str, Any], remedy: str) -> None:
    """InputError unless the record `known`, read from the file `record`, lists a file with the content of `path`, which
    may have been renamed."""
    sums = known.get("files")
    if not (isinstance(sums, dict) and checksum(path) in sums.values()):
        raise InputError(
            f"{path}: does not belong to {record}: its SHA-256 checksum is none of those listed there, so that one of "
            f"the two was changed or comes from another run; {remedy}"
        )


@dataclass(frozen=True)
class Cache:
    """Answers in a folder, keyed by what they depend on: one file each, safe to share between processes.

    A file holds the question, the answer, and a checksum of both; one that is damaged counts as missing. The folder is
    made, InputError if it cannot be; None keeps nothing.
    """

    folder: AnyPath | None = None

    def __post_init__(self) -> None:
        if self.folder is not None:
            try:
                Path(self.folder).mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(f"--cache = {self.folder}: cannot be made: {error.strerror}") from error

    def path(self, question: Record, ending: str = ".json") -> Path | None:
        """The file of a question that JSON can hold; None if nothing is kept."""
        return None if self.folder is None else Path(self.folder, _digest(question)[:40] + ending)

    def get(self, question: Record) -> JsonObject | None:
        """The answer to a question that JSON can hold; None if it is not there."""
        if (path := self.path(question)) is None:
            return None
        try:
            found = json.loads(path.read_bytes())
            return found["answer"] if found["sha256"] == _digest([question, found["answer"]]) else None
        except UNREADABLE:
            return None

    def put(self, question: Record, answer: Record) -> None:
        """Keep an answer; InputError if it cannot be written."""
        if (path := self.path(question)) is not None:
            record = {"question": question, "answer": answer, "sha256": _digest([question, answer])}
            write_text(path, json.dumps(record, indent=1) + "\n")


NO_CACHE = Cache()


def _digest(value: Any) -> str:
    """SHA-256 of a value that JSON can hold; tuples are lists, and keys have no order."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
