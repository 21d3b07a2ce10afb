"""One command run for many inputs: side by side on this machine, or on the workers of a Dask scheduler.

Each item is a command as a user would type it, with a record that it writes. A finished item leaves a mark with the
hash of its command, of its input files and of the versions; the same sweep started again runs only the others. Items do
not depend on each other, so that files are the same to the bit for any number of workers, and after one was killed.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from rve.common.command_line import answer, say
from rve.common.errors import InputError, NotConverged, noted_if_stopped, require
from rve.common.progress import tell
from rve.common.storage.files import check_out_folder, checksum, versions, write_text
from rve.common.storage.reading import read_json_object

MARKS = ".sweep"
"""Folder of the marks of finished items, inside that of the sweep."""
RETRIES = 3
"""How often an item is begun again whose worker was lost."""
CONNECT_S = 10.0


@dataclass(frozen=True)
class Item:
    """`python -m package arguments`, which reads `inputs` and writes the JSON `record`; paths are absolute."""

    name: str
    package: str
    arguments: tuple[str, ...]
    record: Path
    inputs: tuple[Path, ...] = ()

    @property
    def key(self) -> str:
        """Hash of all that the answer depends on."""
        sums = [checksum(path) if path.is_file() else None for path in self.inputs]
        return hashlib.sha256(json.dumps([self.package, self.arguments, sums, versions()]).encode()).hexdigest()


@dataclass(frozen=True)
class Ended:
    """How an item ended: exit code, and the sentence of one that failed."""

    code: int
    message: str


def run_item(package: str, arguments: tuple[str, ...]) -> Ended:
    """Runs a command in this process; it never raises."""
    said = io.StringIO()
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(said):
            main = import_module(f"{package}.cli").main
            code = main.main(list(arguments), prog_name=package, standalone_mode=False)
    except click.ClickException as error:
        return Ended(error.exit_code, error.format_message())
    lines = [line for line in said.getvalue().splitlines() if line.startswith("Error: ")]
    return Ended(code if isinstance(code, int) else 0, lines[-1].removeprefix("Error: ") if lines else "")


def sweep(
    items: Sequence[Item],
    out: Path,
    *,
    jobs: int = 1,
    cluster: str | None = None,
    done: Callable[[str], None] = lambda name: None,
) -> list[Ended]:
    """How each item ended, in their order; `done` is told the name of each as it ends.

    jobs: processes on this machine; cluster: address of a Dask scheduler, whose workers see the folder `out` under the
    same name. InputError if nothing answers there. Stopped, or with a worker lost for good, it keeps what is finished.
    """
    if cluster is not None:
        require("distributed", "cluster", "--cluster", "use --jobs")
        if jobs != 1:
            raise InputError("--jobs and --cluster are two ways to run a sweep: give one")
    marks = out / MARKS
    marks.mkdir(parents=True, exist_ok=True)
    keys = [item.key for item in items]
    ended = {number: found for number, item in enumerate(items) if (found := _mark(marks, item, keys[number]))}
    for number in ended:
        done(items[number].name)
    left = [number for number in range(len(items)) if number not in ended]
    run = _on_cluster(items, left, cluster) if cluster is not None else _here(items, left, jobs)
    try:
        with noted_if_stopped(_kept(out)):
            for number, how in run:
                if how.code in (0, 1) and not items[number].record.exists() and not how.message:
                    how = Ended(1, f"{items[number].record} is not there; workers must see {out} under the same name")
                ended[number] = how
                if how.code in (0, 1) and items[number].record.exists():
                    mark = {"key": keys[number], "code": how.code, "message": how.message}
                    write_text(marks / f"{items[number].name}.json", json.dumps(mark) + "\n")
                done(items[number].name)
    except BrokenProcessPool as error:
        lost = "a worker process was ended from outside, perhaps for lack of memory; take fewer --jobs"
        raise NotConverged(f"{lost}; {_kept(out)}") from error
    return [ended[number] for number in range(len(items))]


def _kept(out: Path) -> str:
    return f"what is finished is kept in {out}, and the same command goes on from there"


def _mark(marks: Path, item: Item, key: str) -> Ended | None:
    """How the item ended in an earlier run; None if it has to run."""
    path = marks / f"{item.name}.json"
    if not path.exists() or not item.record.exists():
        return None
    try:
        found = read_json_object(path)
        return Ended(int(found["code"]), str(found["message"])) if found["key"] == key else None
    except (InputError, KeyError, TypeError, ValueError):
        return None


def _here(items: Sequence[Item], left: list[int], jobs: int) -> Iterator[tuple[int, Ended]]:
    if jobs == 1:
        for number in left:
            yield number, run_item(items[number].package, items[number].arguments)
        return
    from rve.common.workers import worker_pool

    with worker_pool(jobs) as pool:
        futures = {pool.submit(run_item, items[n].package, items[n].arguments): n for n in left}
        for future in as_completed(futures):
            yield futures[future], future.result()


def _on_cluster(items: Sequence[Item], left: list[int], address: str) -> Iterator[tuple[int, Ended]]:
    from distributed import Client, KilledWorker
    from distributed import as_completed as as_finished

    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise InputError(f"--cluster = {address}: no Dask scheduler answers there: {error}") from error
    with client:
        futures = {
            client.submit(run_item, items[n].package, items[n].arguments, pure=False, retries=RETRIES): n for n in left
        }
        for future in as_finished(list(futures)):
            try:
                yield futures[future], future.result()
            except KilledWorker as error:
                yield futures[future], Ended(1, f"its workers were lost: {' '.join(str(error).split())}")


def written_sweep(
    items: Sequence[Item], out: Path, columns: Callable[[dict[str, Any]], dict[str, Any]], **how: Any
) -> list[dict[str, Any]]:
    """The rows of sweep.csv, which is written into `out`: name, exit_code, message, what `columns` takes."""
    check_out_folder(out, "--out")
    rows = []
    for item, ended in zip(items, sweep(items, out, **how), strict=True):
        record = read_json_object(item.record) if ended.code in (0, 1) and item.record.exists() else {}
        rows.append({"name": item.name, "exit_code": ended.code, **columns(record), "message": ended.message})
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(out / "sweep.csv", text.getvalue())
    return rows


def sweep_options(command: Callable[..., None]) -> Callable[..., None]:
    """The options --out, --jobs and --cluster of a command that runs a sweep."""
    for decorate in (
        click.option("--cluster", metavar="ADDRESS", help="Dask scheduler to use, e.g. tcp://head:8786."),
        click.option(
            "--jobs", type=click.IntRange(1, 1000), default=1, show_default=True, help="Processes on this machine."
        ),
        click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder to fill."),
    ):
        command = decorate(command)
    return command


def run_sweep(
    items: Sequence[Item], out: Path, columns: Callable[[dict[str, Any]], dict[str, Any]], **how: Any
) -> list[dict[str, Any]]:
    """Runs a sweep, says how it ended and returns the rows of sweep.csv; exit code 1 if an item failed.

    Options that the command of an item has not are refused before the first one runs.
    """
    count = 0
    for item in items:
        name, *words = item.arguments
        command = import_module(f"{item.package}.cli").main.commands[name]
        command.make_context(f"{item.package} {name}", words)

    def done(name: str) -> None:
        nonlocal count
        count += 1
        tell(f"sweep, {count} of {len(items)} done", count / len(items))

    tell(f"sweep, 0 of {len(items)} done", 0.0)
    rows = written_sweep(items, out, columns, done=done, **how)
    failed = [row for row in rows if row["exit_code"] != 0]
    tell("")
    for row in failed:
        click.echo(f"{row['name']}: {row['message'] or 'not converged, see its record'}", err=True)
    say(f"{len(rows) - len(failed)} of {len(rows)} done; written to {out / 'sweep.csv'}")
    answer({"out": str(out), "done": len(rows) - len(failed), "items": rows})
    if failed:
        raise click.exceptions.Exit(1)
    return rows


def numbers_of(text: str, option: str) -> list[float]:
    """Numbers with commas between them; InputError for others."""
    try:
        return [float(one) for one in text.split(",")]
    except ValueError as error:
        raise InputError(f"{option} = {text!r}: is not a list of numbers with commas between them") from error
