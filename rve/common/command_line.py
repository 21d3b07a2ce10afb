"""What all commands share: how they fail, stop, and say what they need.

A command ends with code 0; 1 where it has not converged or something unforeseen happened; 2 for bad input; 128 plus
the number of the signal that stopped it, 130 for SIGINT (Ctrl-C), 143 for SIGTERM. Each failure is one sentence on
standard error; with `--traceback` the place in the code is printed before it.

    @click.group(cls=Group)
    def main() -> None: ...
"""

from __future__ import annotations

import errno
import os
import signal
import threading
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import click

from rve.common.errors import InputError, NotConverged, OldName

_TRACE = "rve.common.command_line.traceback"
_STOPS = ("SIGTERM", "SIGHUP")


class Stopped(BaseException):
    """A signal asks this process to end; like KeyboardInterrupt no Exception, so that no handler of errors holds it."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class Command(click.Command):
    """A click command that ends in one sentence, and has the option `--traceback`."""

    def __init__(self, name: str | None, **kwargs: Any) -> None:
        option = click.Option(
            ["--traceback"],
            is_flag=True,
            expose_value=False,
            callback=_remember,
            help="Show where in the code an error arose.",
        )
        super().__init__(name, params=[*(kwargs.pop("params", None) or []), option], **kwargs)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; whatever it raises becomes a sentence and an exit code."""
        try:
            with _stops_raised(), _old_names_told():
                return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except (Exception, KeyboardInterrupt, Stopped) as error:
            if isinstance(error, OSError) and error.errno == errno.EPIPE:  # the reader of a pipe has gone: click's case
                raise
            if ctx.meta.get(_TRACE):
                click.echo("".join(traceback.format_exception(error)), err=True, nl=False)
            code, sentence = ending(error)
            notes = getattr(error, "__notes__", [])
            click.echo(f"Error: {'; '.join(_one_line(text) for text in (sentence, *notes))}", err=True)
            ctx.exit(code)


class Group(click.Group):
    """A click group whose commands are all `Command`s, with `--version`."""

    command_class = Command

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        click.version_option(package_name="ring-mesh")(self)


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


def _remember(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    ctx.meta[_TRACE] = value


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
                click.echo(f"Warning: {message}", err=True)
            else:
                others(message, category, *place)

        warnings.showwarning = show  # type: ignore[assignment]
        yield


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
