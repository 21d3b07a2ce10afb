"""What all commands share: how they end, what they print, and --quiet, --json and --traceback.

A command ends with code 0; 1 where it has not converged or something unforeseen happened; 2 for bad input; 128 plus
the number of the signal that stopped it, 130 for SIGINT (Ctrl-C), 143 for SIGTERM. Each failure is one sentence on
standard error; with `--traceback` the place in the code is printed before it. What takes long is shown live in a
terminal. A command prints sentences by `say`, the last one by `say_next`, and its record by `answer`: `--quiet` leaves
out the sentences, `--json` prints the record in their place.

    @click.group(cls=Group)
    def main() -> None: ...
"""

from __future__ import annotations

import errno
import os
import shlex
import signal
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any

import click

from rve.common.errors import InputError, NotConverged, require
from rve.common.files import check_out_file
from rve.common.progress import shown, tell
from rve.common.texts import json_text

_ANEW = "no file is left half-written, and the same command begins anew"
"""What a command says that is stopped and has nothing to go on from."""
LARGEST_LOAD = 1e100
_OPTIONS = {
    "--quiet": "Show no progress and print no sentences; errors, and answers that are asked for, stay.",
    "--json": "Print the record of the run as one JSON object instead of sentences.",
    "--traceback": "Show where in the code an error arose.",
}


class Stopped(KeyboardInterrupt):
    """A signal asks this process to end."""


class CommandFailed(click.ClickException):
    """What a command raised, as a sentence and an exit code."""

    def __init__(self, sentence: str, code: int) -> None:
        super().__init__(sentence)
        self.exit_code = code  # type: ignore[misc]


class Command(click.Command):
    """A click command that ends in one sentence, shows live progress, and has the options of all commands."""

    def __init__(self, name: str | None, **kwargs: Any) -> None:
        super().__init__(name, params=[*(kwargs.pop("params", None) or []), *map(_common, _OPTIONS)], **kwargs)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; whatever it raises becomes a sentence and an exit code."""
        try:
            with _stops_raised(), nullcontext() if _asked("--quiet") else shown():
                return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except (Exception, KeyboardInterrupt) as error:
            if isinstance(error, OSError) and error.errno == errno.EPIPE:  # the reader of a pipe has gone: click's case
                raise
            if _asked("--traceback"):
                click.echo("".join(traceback.format_exception(error)), err=True, nl=False)
            code, sentence = ending(error)
            notes = getattr(error, "__notes__", [_ANEW] if isinstance(error, KeyboardInterrupt) else [])
            raise CommandFailed("; ".join(" ".join(str(text).split()) for text in (sentence, *notes)), code) from error


class Group(click.Group):
    """A click group whose commands are all `Command`s, with `--version` and `-h`."""

    command_class = Command

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault("context_settings", {"help_option_names": ["-h", "--help"]})
        super().__init__(*args, **kwargs)
        click.version_option(package_name="ring-mesh")(self)


def options(*added: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A decorator that gives a command these options and arguments, in this order."""

    def decorate(command: Any) -> Any:
        for add in reversed(added):
            command = add(command)
        return command

    return decorate


def _common(name: str) -> click.Option:
    """An option that all commands have; what it says is kept in the context."""

    def remember(ctx: click.Context, param: click.Parameter, value: bool) -> None:
        ctx.meta[f"rve{name}"] = value

    return click.Option([name], is_flag=True, is_eager=True, expose_value=False, callback=remember, help=_OPTIONS[name])


def _asked(name: str) -> bool:
    """Whether a common option was given; no outside of a command."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(f"rve{name}"))


def say(*lines: str, err: bool = False) -> None:
    """Prints what a command has done, unless --quiet or --json asks for none of it.

    With `err` on standard error, which --json leaves as it is.
    """
    if lines and not _asked("--quiet") and (err or not _asked("--json")):
        _print("\n".join(lines), err=err)


def say_next(package: str, *words: object, why: str = "") -> None:
    """The last sentence of a command: one that can be typed next, and what for."""
    is_module = (click.get_current_context().find_root().info_name or "").startswith("python")
    script = ["python", "-m", package] if is_module else [package.replace("_", "-")]
    command = shlex.join([*script, *map(str, words)])
    say(f"next: {command}{f'  # {why}' if why else ''}")


def answer(record: Mapping[str, Any], text: str | None = None, *, always: bool = False) -> None:
    """Prints the record of what a command has done as JSON, if --json asks for it, or `always`; numbers that are not
    finite become null. Else `text`, which is what was asked for and is printed with --quiet too.
    """
    if always or _asked("--json"):
        _print(json_text(record).rstrip())
    elif text is not None:
        _print(text)


def _print(text: str, *, err: bool = False) -> None:
    """Prints below what was shown live, which is wiped first."""
    tell("")
    click.echo(text, err=err)


def feature_lines(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """The table of --explain: what a run used and left out, and why."""
    return [f"{row['feature']:<16} {'used' if row['used'] else 'left out':<9} {row['why']}" for row in rows]


def numbers_of(text: str, option: str) -> list[float]:
    """Numbers with commas between them; InputError for others."""
    try:
        return [float(one) for one in text.split(",")]
    except ValueError as error:
        raise InputError(f"{option} = {text!r}: is not a list of numbers with commas between them") from error


def parse_load(text: str) -> Any:
    """The line load (3,) of --S "S11,S12,S22"; InputError unless it is three numbers whose squares are numbers, too."""
    import numpy as np

    S = np.array(numbers_of(text, "--S"))
    if len(S) != 3 or not (np.abs(S) <= LARGEST_LOAD).all():
        raise InputError(f"--S = {text!r}: give three finite numbers S11,S12,S22, at most {LARGEST_LOAD:g} in size")
    return S


def check_plot(path: Path, inputs: Iterable[Path | None] = ()) -> None:
    """InputError, before anything is solved, for a picture of --plot that cannot be written."""
    require("matplotlib", "plots", "--plot")
    check_out_file(path, "--plot", inputs)
    from matplotlib.backend_bases import FigureCanvasBase

    if path.suffix and path.suffix[1:].lower() not in FigureCanvasBase.get_supported_filetypes():
        raise InputError(f"--plot = {path}: give a name that ends in .png, .svg or .pdf")


def no_picture(module: str) -> tuple[str, ...]:
    """What a next command is given where its picture needs a module that is not installed."""
    return () if find_spec(module) is not None else ("--no-picture",)


def ending(error: BaseException) -> tuple[int, str]:
    """Exit code and sentence for what a command raised."""
    if isinstance(error, InputError):
        return 2, str(error)
    if isinstance(error, NotConverged):
        return 1, str(error)
    if isinstance(error, KeyboardInterrupt):
        number = signal.Signals(error.args[0]) if isinstance(error, Stopped) else signal.SIGINT
        return 128 + number, f"stopped by {number.name}"
    if isinstance(error, OSError) and error.strerror:
        where = "" if error.filename is None else f"{os.fspath(error.filename)!s}: "
        is_full = error.errno in (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", -1))
        remedy = "make room on the disk, or write to another one; " if is_full else ""
        return 1, f"{where}{error.strerror}; {remedy}files that were there before are unchanged"
    if isinstance(error, MemoryError):
        return 1, "there is not enough memory for this; ask for fewer cells, rings, rows or workers"
    kind = type(error).__name__
    return 1, f"unforeseen {kind}: {str(error) or 'no message'}; please report it with what --traceback prints"


@contextmanager
def _stops_raised() -> Iterator[None]:
    """Signals that end a process are raised as `Stopped` in the block, so that it cleans up behind itself."""
    if threading.current_thread() is not threading.main_thread():  # signals belong to the main thread
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        raise Stopped(number)

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    numbers = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]  # nohup ignores SIGHUP
    for number in numbers:
        signal.signal(number, stop)
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)
