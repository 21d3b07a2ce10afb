"""What all commands share: how they fail, stop, and say what they need.

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
import json
import math
import os
import shlex
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from importlib.util import find_spec
from pathlib import Path
from shutil import which
from types import FrameType
from typing import Any

import click

from rve.common.errors import InputError, NotConverged, OldName, require
from rve.common.progress import shown, tell
from rve.common.storage.files import check_out_file

_TRACE = "rve.common.command_line.traceback"
_QUIET = "rve.common.command_line.quiet"
_ANEW = "no file is left half-written, and the same command begins anew"
"""What a command says that is stopped and has nothing to go on from."""
_JSON = "rve.common.command_line.json"
_STOPS = ("SIGTERM", "SIGHUP")


class Stopped(BaseException):
    """A signal asks this process to end; like KeyboardInterrupt no Exception, so that no handler of errors holds it."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class Command(click.Command):
    """A click command that ends in one sentence, shows live progress, and has the options of all commands."""

    def __init__(self, name: str | None, **kwargs: Any) -> None:
        super().__init__(name, params=[*(kwargs.pop("params", None) or []), *map(_common, _OPTIONS)], **kwargs)

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        """The command with its options read; one sentence for what is wrong with them."""
        with _usage_in_one_sentence():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; whatever it raises becomes a sentence and an exit code."""
        try:
            with _stops_raised(), _old_names_told(), nullcontext() if ctx.meta.get(_QUIET) else shown():
                return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except (Exception, KeyboardInterrupt, Stopped) as error:
            if isinstance(error, OSError) and error.errno == errno.EPIPE:  # the reader of a pipe has gone: click's case
                raise
            if ctx.meta.get(_TRACE):
                click.echo("".join(traceback.format_exception(error)), err=True, nl=False)
            code, sentence = ending(error)
            notes = getattr(error, "__notes__", [_ANEW] if isinstance(error, (KeyboardInterrupt, Stopped)) else [])
            click.echo(f"Error: {'; '.join(_one_line(text) for text in (sentence, *notes))}", err=True)
            ctx.exit(code)


def options(*added: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A decorator that gives a command these options and arguments, in this order."""

    def decorate(command: Any) -> Any:
        for add in reversed(added):
            command = add(command)
        return command

    return decorate


class Group(click.Group):
    """A click group whose commands are all `Command`s, with `--version` and `-h`."""

    command_class = Command

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault("context_settings", {"help_option_names": ["-h", "--help"]})
        super().__init__(*args, **kwargs)
        click.version_option(package_name="ring-mesh")(self)

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        """The group with its options read; one sentence for what is wrong with them."""
        with _usage_in_one_sentence():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: click.Context) -> Any:
        """Find and run the command; one sentence for one that is not there."""
        with _usage_in_one_sentence():
            return super().invoke(ctx)


def _meta() -> dict[str, Any]:
    """What the common options say; nothing outside of a command."""
    context = click.get_current_context(silent=True)
    return {} if context is None else context.meta


def say(*lines: str, err: bool = False) -> None:
    """Prints what a command has done, unless --quiet or --json asks for none of it.

    With `err` on standard error, which --json leaves as it is.
    """
    meta = _meta()
    if lines and not meta.get(_QUIET) and (err or not meta.get(_JSON)):
        _print("\n".join(lines), err=err)


def say_next(package: str, *words: object, why: str = "") -> None:
    """The last sentence of a command: one that can be typed next, and what for."""
    called = click.get_current_context().find_root().info_name or ""
    is_module = called.startswith("python") or called.endswith(".py")
    script = [_python(), "-m", package] if is_module else [package.replace("_", "-")]
    command = shlex.join([*script, *map(str, words)])
    say(f"next: {command}{f'  # {why}' if why else ''}")


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


def _python() -> str:
    """What has to be typed for the interpreter that runs: `python` where that is it, else its path."""
    here = Path(sys.executable)
    found = which("python")
    if found is not None and Path(found).absolute().parent == here.parent:
        return "python"
    return str(here.relative_to(Path.cwd()) if here.is_relative_to(Path.cwd()) else here)


def answer(record: Mapping[str, Any], text: str | None = None, *, always: bool = False) -> None:
    """Prints the record of what a command has done as JSON, if --json asks for it, or `always`; numbers that are not
    finite become null. Else `text`, which is what was asked for and is printed with --quiet too.
    """
    if always or _meta().get(_JSON):
        _print(json.dumps(_without_nan(record), indent=2, allow_nan=False))
    elif text is not None:
        _print(text)


def _without_nan(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_nan(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _print(text: str, *, err: bool = False) -> None:
    """Prints below what was shown live, which is wiped first."""
    tell("")
    click.echo(text, err=err)


@contextmanager
def _usage_in_one_sentence() -> Iterator[None]:
    """Wrong options and commands: click's sentence without its lines of usage, and where these are."""
    try:
        yield
    except click.exceptions.NoArgsIsHelpError:
        raise
    except click.UsageError as error:
        if error.ctx is None:
            raise
        hint = f"; see {error.ctx.command_path} --help"
        raise click.UsageError(_one_line(error.format_message()).rstrip(".") + hint) from error


def ending(error: BaseException) -> tuple[int, str]:
    """Exit code and sentence for what a command raised."""
    if isinstance(error, InputError):
        return 2, str(error)
    if isinstance(error, NotConverged):
        return 1, str(error)
    if isinstance(error, KeyboardInterrupt):
        return 128 + signal.SIGINT, "stopped by SIGINT"
    if isinstance(error, Stopped):
        return 128 + error.number, f"stopped by {error}"
    if isinstance(error, OSError) and error.strerror:
        where = "" if error.filename is None else f"{os.fspath(error.filename)!s}: "
        code = 2 if error.errno in _BAD_NAMES else 1
        return code, f"{where}{error.strerror}; {_REMEDIES.get(error.errno or 0, _REMEDY)}"
    if isinstance(error, MemoryError):
        return 1, "there is not enough memory for this; ask for fewer cells, rings, rows or workers"
    kind = type(error).__name__
    return 1, f"unforeseen {kind}: {str(error) or 'no message'}; please report it with what --traceback prints"


_BAD_NAMES = (errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR, errno.EISDIR)
"""Errors that only a name given by the user can cause: bad input."""
_REMEDY = "files that were there before are unchanged"
_REMEDIES = {
    number: f"{remedy}; {_REMEDY}"
    for number, remedy in (
        (errno.ENOSPC, "make room on the disk, or write to another one"),
        (getattr(errno, "EDQUOT", -1), "make room in your quota, or write to another disk"),
        (errno.EFBIG, "raise the limit of file sizes, or write to another disk"),
        (errno.EACCES, "ask for the right to use it, or choose another place"),
        (errno.EPERM, "ask for the right to use it, or choose another place"),
        (errno.ENAMETOOLONG, "choose a shorter name"),
    )
}


def _one_line(text: object) -> str:
    return " ".join(str(text).split())


_OPTIONS = {
    "--quiet": (_QUIET, "Show no progress and print no sentences; errors, and answers that are asked for, stay."),
    "--json": (_JSON, "Print the record of the run as one JSON object instead of sentences."),
    "--traceback": (_TRACE, "Show where in the code an error arose."),
}


def _common(name: str) -> click.Option:
    """An option that all commands have; what it says is kept in the context."""
    key, text = _OPTIONS[name]

    def remember(ctx: click.Context, param: click.Parameter, value: bool) -> None:
        ctx.meta[key] = value

    return click.Option([name], is_flag=True, is_eager=True, expose_value=False, callback=remember, help=text)


def _raise_stopped(number: int, frame: FrameType | None) -> None:
    raise Stopped(number)


@contextmanager
def _old_names_told() -> Iterator[None]:
    """Warnings of old names in files are printed as sentences on standard error."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", OldName)
        others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
            if issubclass(category, OldName):
                _warn(str(message))
            else:
                others(message, category, *place)

        warnings.showwarning = show  # type: ignore[assignment]
        yield


def _warn(text: str) -> None:
    """A warning on standard error, unless --quiet asks for none."""
    if not _meta().get(_QUIET):
        _print(f"Warning: {text}", err=True)


def idle_option(name: str, text: str) -> Callable[[Any], Any]:
    """A hidden option that is read and has no effect any more; who gives it is told so."""

    def told(ctx: click.Context, param: click.Parameter, value: tuple[str, ...]) -> None:
        if value:
            _warn(f"{name} {text}")

    return click.option(name, multiple=True, hidden=True, expose_value=False, callback=told)


@contextmanager
def _stops_raised() -> Iterator[None]:
    """Signals that end a process are raised as `Stopped` in the block, so that it cleans up behind itself."""
    if threading.current_thread() is not threading.main_thread():  # signals belong to the main thread
        yield
        return
    numbers = [getattr(signal, name) for name in _STOPS if hasattr(signal, name)]
    numbers = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]  # nohup ignores SIGHUP
    for number in numbers:
        signal.signal(number, _raise_stopped)
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)
