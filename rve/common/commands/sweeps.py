"""One command run for many inputs, in processes side by side or on the workers of a Dask scheduler.

Each item is a command as a user would type it, with a record that it writes. A finished item is kept in a cache with
the checksums of all files that it has read and written; the same sweep started again runs only the others. Items do not
depend on each other, so that files are the same to the bit for any number of workers, and after one was killed.
"""

import io
import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, as_completed
from contextlib import AbstractContextManager, ExitStack, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from typing import Any

import click

from rve.common.commands.command_line import answer, ending, options, say
from rve.common.errors import InputError, NotConverged, noted_if_stopped, require
from rve.common.files import PLUGINS, Cache, JsonObject, checksum, clear_parts, versions, write_text
from rve.common.plugins import forget_plugins, load_plugin
from rve.common.progress import tell
from rve.common.texts import csv_text, read_json_object, recorded_reads

MARKS = ".sweep"
"""Folder of what is known of finished items, inside that of the sweep."""
CONNECT_S = 10.0
_WITHOUT = {3: "all is in place but a picture or report; run it alone to see why"}
LOST = "a worker was lost, perhaps for lack of memory: the same command with fewer of them goes on"


Row = dict[str, Any]
"""A row of the table of a sweep."""


@dataclass(frozen=True)
class SweepItem:
    """`python -m package arguments`, which writes the JSON `record`; paths are absolute. marks: where it is marked as
    finished; labels: columns of its row beside its name."""

    name: str
    package: str
    arguments: tuple[str, ...]
    record: Path
    marks: Path | None = None
    labels: tuple[tuple[str, str], ...] = ()

    @property
    def question(self) -> JsonObject:
        """What the answer depends on beside the files that are read."""
        return {"command": [self.package, *self.arguments], "versions": versions()}


@dataclass(frozen=True)
class Ended:
    """How an item ended: exit code, and the sentence of one that failed."""

    code: int
    message: str


def run_item(item: SweepItem) -> Ended:
    """Runs a command in this process, which ends where it is stopped from outside; that it is finished is marked at
    once, so that a sweep that is killed later does not lose it. Workers of a cluster may know plugins of another sweep.
    """
    forget_plugins()
    try:
        with recorded_reads() as read, redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            main = import_module(f"{item.package}.cli").main
            code = main.main(list(item.arguments), prog_name=item.package, standalone_mode=False)
        folder, names = item.record.parent, [item.record.name, *read_json_object(item.record).get("files", {})]
        files = read | {str(folder / name): checksum(folder / name) for name in names}
        Cache(item.marks).put(item.question, {"code": code or 0, "files": files})
        return Ended(code or 0, "")
    except click.ClickException as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            os._exit(1)  # whatever is raised, a worker of a pool would begin its next item
        return Ended(error.exit_code, error.format_message())
    except (InputError, OSError) as error:  # of its record, after the command
        return Ended(*ending(error))


def sweep(
    items: Sequence[SweepItem],
    out: Path,
    *,
    jobs: int = 1,
    cluster: str | None = None,
    on_end: Callable[[dict[str, Ended]], Any] = lambda ended: None,
) -> list[Ended]:
    """How each item ended, in their order.

    jobs: processes on this machine; cluster: address of a Dask scheduler, whose workers see the folder `out` under the
    same name; on_end: is called after each item with all that have ended, by name. InputError if nothing answers there,
    or two items have one name. However it ends, what is finished is kept.
    """
    for name, count in Counter(item.name for item in items).items():
        if count > 1:
            raise InputError(f"{name}: {count} items of the sweep are called so, and each needs files of its own")
    cache, ended = Cache(out / MARKS), dict[str, Ended]()
    for item in items:
        found = cache.get(item.question)
        if found and all(Path(name).exists() and checksum(name) == one for name, one in found["files"].items()):
            ended[item.name] = Ended(found["code"], "")
    left = [item for item in items if item.name not in ended]
    begun = time.monotonic()
    tell(f"sweep, {len(ended)} of {len(items)} done")
    kept = f"what is finished is kept in {out}, and the same command goes on from there"
    with noted_if_stopped(kept), workers(jobs, cluster, len(left), out) as pool:
        futures = {pool.submit(run_item, replace(item, marks=out / MARKS)): item for item in left}
        for future in as_completed(futures):
            item = futures[future]
            error = future.exception()
            if error is not None and not isinstance(error, Exception):
                raise error
            told = error and f"{LOST} ({type(error).__name__}: {' '.join(str(error).split())})"
            how = Ended(1, told) if told else future.result()
            if not how.message and not item.record.exists():  # written to another machine's disk
                how = Ended(1, f"{item.record} is not there; workers must see its folder under the same name")
            ended[item.name] = how
            on_end(ended)
            count = len(ended) + len(left) - len(items)  # of this run
            tell(f"sweep, {len(ended)} of {len(items)} done", count, len(left), begun)
    return [ended[item.name] for item in items]


def workers(
    jobs: int, cluster: str | None, tasks: int = 1000, out: Path | None = None
) -> AbstractContextManager[Executor]:
    """What runs `tasks`, which write into the folder `out`: processes of this machine or, at the address of its
    scheduler, a Dask cluster, whose workers get what is lost with one again. NotConverged where none is left for it."""
    if cluster is not None and jobs > 1:
        raise InputError("--jobs and --cluster are two ways to run side by side: give one")
    return _side_by_side(min(jobs, tasks or 1), out) if cluster is None else _cluster(cluster)


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    """Workers of a Dask scheduler; InputError if none answers."""
    require("distributed", "cluster", "--cluster", "leave it out")
    from distributed import Client, KilledWorker

    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise InputError(f"--cluster = {address}: no Dask scheduler answers there: {error}") from error
    with client:
        client.register_worker_callbacks(partial(_learn, list(PLUGINS)))
        try:
            # How often an item is begun again whose worker on a cluster was lost.
            yield client.get_executor(pure=False, retries=3)
        except KilledWorker as error:
            raise NotConverged(LOST) from error


@contextmanager
def _side_by_side(jobs: int, out: Path | None) -> Iterator[Executor]:
    """Worker processes that end with the block, at once where it is left early, and when this process ends."""
    pool = ProcessPoolExecutor(
        jobs, mp_context=get_context("spawn"), initializer=_begin_worker, initargs=(list(PLUGINS),)
    )
    with pool, ExitStack() as early:
        early.callback(_end_children, out)
        try:
            yield pool
        except BrokenExecutor as error:
            raise NotConverged(LOST) from error
        early.pop_all()


def _end_children(out: Path | None) -> None:
    """End all workers, for which a pool waits: left running, one may end in a traceback. What they have half written
    goes."""
    for child in (ended := active_children()):
        child.terminate()
    for child in ended:
        child.join()
    if out is not None:
        clear_parts(out)


def _learn(plugins: Sequence[str]) -> None:
    """Let this process know the plugins of another one, whose classes come to it, and none that it knew before."""
    forget_plugins()
    for path in plugins:
        load_plugin(path)


def _begin_worker(plugins: Sequence[str]) -> None:
    """Let this worker know the plugins of its parent, and end at once when that does, which alone handles Ctrl-C."""
    _learn(plugins)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()

    def wait() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def further_options(words: Sequence[str], given: Sequence[str]) -> list[str]:
    """Options for every item with the paths of files that exist made absolute, as in `--law law.json` or
    `--law=law.json`; InputError for those that are `given` by the sweep or name one file for all items."""
    found = []
    for word in words:
        option, sign, path = word.rpartition("=")
        if word.partition("=")[0] in given:
            raise InputError(f"{word.partition('=')[0]}: is given by the sweep, or names one file for all of its items")
        found.append(f"{option}{sign}{Path(path).resolve()}" if path and Path(path).exists() else word)
    return found


cluster_option = click.option("--cluster", metavar="ADDRESS", help="Dask scheduler, in place of processes here.")
sweep_options = options(
    click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder to fill."),
    click.option("--jobs", type=click.IntRange(1, 1000), default=1, show_default=True, help="Processes side by side."),
    cluster_option,
)
"""The options of a command that runs a sweep."""


def run_sweep(
    items: Sequence[SweepItem], out: Path, columns: Callable[[Any], Row], jobs: int, cluster: str | None,
    *, table: str = "sweep.csv", then: Callable[[list[Row]], Any] = lambda rows: None,
) -> list[Row]:  # fmt: skip
    """Runs a sweep, writes its table, says how it ended and returns its rows; exit code 1 if an item failed.

    A row holds name, labels, exit_code, what `columns` takes from the record, and message. Options that the command of
    an item has not are refused before the first one runs. then: is called with the rows, of which some may have failed.
    """
    plugins = [f"--plugin={path}" for path in PLUGINS]
    items = [replace(item, arguments=(*item.arguments, *plugins)) for item in items]
    for item in items:
        command = import_module(f"{item.package}.cli").main.commands[item.arguments[0]]
        command.make_context(f"{item.package} {item.arguments[0]}", list(item.arguments[1:]))

    def rows_of(ended: dict[str, Ended]) -> list[Row]:
        """The rows of items that have ended, of which the table is written."""
        rows = []
        for item, how in ((item, ended[item.name]) for item in items if item.name in ended):
            record = {} if how.message else read_json_object(item.record)
            numbers = {"exit_code": how.code, **columns(record), "message": how.message}
            rows.append({"name": item.name, **dict(item.labels), **numbers})
        names = list(dict.fromkeys(key for row in rows for key in row))
        write_text(out / table, csv_text(names, ([row.get(key, "") for key in names] for row in rows)))
        return rows

    every = sweep(items, out, jobs=jobs, cluster=cluster, on_end=rows_of)
    rows = rows_of({item.name: how for item, how in zip(items, every, strict=True)})
    tell("")
    failed = [row for row in rows if row["exit_code"] != 0]
    for row in failed:
        click.echo(
            f"{row['name']}: {row['message'] or _WITHOUT.get(row['exit_code'], 'not converged, see its record')}",
            err=True,
        )
    say(f"{len(rows) - len(failed)} of {len(rows)} done; written to {out / table}")
    answer({"out": str(out), "done": len(rows) - len(failed), "items": rows})
    then(rows)
    if failed:
        raise click.exceptions.Exit(1)
    return rows
