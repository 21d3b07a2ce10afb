"""What all commands share: how they end, what they print, and --quiet, --json and --traceback.

A command ends with code 0; 1 where it has not converged or something unforeseen happened; 2 for bad input; 3 where all
is in place but a picture or report; 130 for SIGINT (Ctrl-C), 143 for SIGTERM, 129 for a closed terminal (SIGHUP). Each
failure is one sentence on standard error; with `--traceback` the place in the code is printed before it. What takes
long is shown live in a terminal. A command prints sentences by `say`, the last one by `say_next`, and its record by
`answer`: `--quiet` leaves out the sentences, `--json` prints the record in their place.

    @click.group(cls=Group)
    def main() -> None: ...
"""

import errno
import os
import re
import shlex
import signal
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import click

from rve.common.errors import InputError, NotConverged, NotDrawn, cut, require
from rve.common.errors import shown as quoted
from rve.common.files import check_out_file, json_text
from rve.common.plugins import load_plugin, place_in_plugin
from rve.common.progress import shown, tell
from rve.common.texts import numbers_of
from rve.common.typed import alone, did_you_mean

_ANEW = "no file is left half-written, and the same command begins anew"
"""What a command says that is stopped and has nothing to go on from."""
_COMMON = {
    "quiet": "Show no progress and print no sentences; errors, and answers that are asked for, stay.",
    "json": "Print the record of the run as one JSON object instead of sentences.",
    "traceback": "Show where in the code an error arose.",
}
"""Options of every command, which it finds in its context."""

Record = TypeVar("Record", bound=Mapping[str, Any])


class Command(click.Command):
    """A click command that ends in one sentence, shows live progress, and has the options of all commands.

    period_s: seconds between lines of progress where standard error is no terminal; None shows none there.
    """

    def __init__(self, name: str | None, *, period_s: float | None = None, **kwargs: Any) -> None:
        self.period_s = period_s
        common = [click.Option([f"--{key}"], is_flag=True, help=text) for key, text in _COMMON.items()]
        plugin = "Python file with own laws, supports, loads or materials; may be given several times."
        common.append(click.Option(["--plugin"], multiple=True, type=click.Path(), metavar="FILE.py", help=plugin))
        super().__init__(name, params=[*(kwargs.pop("params", None) or []), *common], **kwargs)

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        """The context of the words of a user; a wrong one is refused in one sentence."""
        with _refused_in_a_sentence():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command on one thread of BLAS unless the user says more, as its threads wait for one another where a
        core is busy (a curtain took 80 to 190 s, not 20); whatever it raises becomes a sentence and an exit code.
        """
        os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy is imported
        ctx.meta.update({key: ctx.params.pop(key) for key in (*_COMMON, "plugin")})
        try:
            for path in ctx.meta["plugin"]:
                load_plugin(path)
            with _stops_raised(), nullcontext() if _asked("quiet") else shown(self.period_s):
                return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort, BrokenPipeError):
            raise
        except (Exception, KeyboardInterrupt) as error:
            _say_where(error)
            code, sentence = ending(error)
            notes = getattr(error, "__notes__", [_ANEW] if isinstance(error, KeyboardInterrupt) else [])
            failed = click.ClickException("; ".join(" ".join(str(text).split()) for text in (sentence, *notes)))
            failed.exit_code = code  # type: ignore[misc]
            raise failed from error


class Group(click.Group):
    """A click group whose commands are all `Command`s, with `--version` and `-h`."""

    command_class = Command

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault("context_settings", {"help_option_names": ["-h", "--help"]})
        super().__init__(*args, **kwargs)
        click.version_option(package_name="ring-mesh")(self)

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        """As of a `Command`."""
        with _refused_in_a_sentence():
            return super().make_context(*args, **kwargs)

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """The command that is named; one that there is not is refused in one sentence."""
        if self.get_command(ctx, args[0]) is None and not args[0].startswith("-"):
            raise _refusal(f"{quoted(args[0])} is no command; {did_you_mean(args[0], self.commands)}", self.commands)
        with _refused_in_a_sentence():
            return super().resolve_command(ctx, args)


def _refusal(said: str, known: Iterable[str] = ()) -> click.ClickException:
    """Ends a command with a sentence and the code of bad input."""
    refused = click.ClickException(cut(f"{said}known are {', '.join(known)}" if known else said))
    refused.exit_code = 2  # type: ignore[misc]
    return refused


@contextmanager
def _refused_in_a_sentence() -> Iterator[None]:
    """What click says of words that it refuses in one sentence, with the one probably meant, without usage."""
    try:
        yield
    except click.exceptions.NoArgsIsHelpError:
        raise
    except click.UsageError as error:
        said = " ".join(error.format_message().split()).rstrip(".").replace(". Choose from", "; choose from")
        value, hint = re.search(r"'([^']*)' is not (?:one of|a valid)", said), ""
        if isinstance(error, click.NoSuchOption):
            known = [] if error.ctx is None else [name for one in error.ctx.command.params for name in one.opts]
            said, hint = f"No such option: {error.option_name}", did_you_mean(error.option_name, known)
        elif isinstance(error, click.BadParameter) and isinstance(error.param, click.Option) and value:
            kind, unit = error.param.type, re.search(r"\bin ([\w/]+)\b", error.param.help or "")
            if isinstance(kind, click.Choice):
                hint = did_you_mean(value[1], kind.choices)
            else:
                hint = alone(value[1], unit[1] if unit else "")
        said = said.replace("a valid float", "a number").replace("a valid integer", "a whole number")
        raise _refusal(f"{said}; {hint}".rstrip("; ")) from error


@contextmanager
def _stops_raised() -> Iterator[None]:
    """What ends a process is raised in the block, so that it keeps what is finished: SIGTERM, and a closed terminal."""
    names = ("SIGTERM", "SIGHUP") if threading.current_thread() is threading.main_thread() else ()
    with ExitStack() as stack:
        for number in (getattr(signal, name) for name in names if hasattr(signal, name)):
            before = signal.getsignal(number)
            if before != signal.SIG_IGN:  # nohup ignores SIGHUP
                stack.callback(signal.signal, number, before)
                signal.signal(number, _stop)
        yield


def _stop(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt(number)


def _asked(name: str) -> bool:
    """Whether a common option was given; no outside of a command."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(name))


def ending(error: BaseException) -> tuple[int, str]:
    """Exit code and sentence for what a command raised."""
    if isinstance(error, InputError):
        return 2, str(error)
    if isinstance(error, NotConverged):
        return 1, str(error)
    if isinstance(error, NotDrawn):
        why = (f"{name} could not be made: {ending(cause)[1]}" for name, cause in error.causes.items())
        return 3, "; ".join([*why, "all else is in place"])
    if isinstance(error, KeyboardInterrupt):
        number = signal.Signals(error.args[0] if error.args else signal.SIGINT)
        return 128 + number, f"stopped by {number.name}"
    if isinstance(error, OSError) and error.strerror:
        where = "" if error.filename is None else f"{error.filename}: "
        room = ", make room there" if error.errno in (errno.ENOSPC, errno.EDQUOT) else ""
        return 1, f"{where}{error.strerror}{room}; files that were there before are unchanged"
    if isinstance(error, MemoryError):
        return 1, "there is not enough memory for this; ask for fewer cells, rings, rows or workers"
    what, place = f"{type(error).__name__}: {str(error) or 'no message'}", place_in_plugin(error)
    if place:
        return (
            1,
            f"plugin {place}: {what}; it is an error of the plugin, --traceback at the end says more",
        )
    return 1, f"unforeseen {what}; please report it with what the same command prints with --traceback at the end"


def say(*lines: str, err: bool = False) -> None:
    """Prints what a command has done, unless --quiet, or without `err` (on standard error) --json, asks for none."""
    if lines and not _asked("quiet") and (err or not _asked("json")):
        _print("\n".join(lines), err=err)


def say_next(package: str, *words: object, why: str = "") -> None:
    """The last sentence of a command: one that can be typed next, and what for."""
    context = click.get_current_context(silent=True)
    plugins = () if context is None else context.meta.get("plugin", ())
    command = shlex.join(["python", "-m", package, *map(str, words), *(f"--plugin={path}" for path in plugins)])
    say(f"next: {command}{f'  # {why}' if why else ''}")


def _say_where(error: BaseException) -> None:
    """Prints where in the code an error arose, if --traceback asks for it."""
    if _asked("traceback"):
        click.echo("".join(traceback.format_exception(error)), err=True, nl=False)


def made(make: Callable[..., Record], *args: Any, **kwargs: Any) -> tuple[Record, NotDrawn | None]:
    """The record that a function returns, and how its pictures or reports failed where only they did."""
    try:
        return make(*args, **kwargs), None
    except NotDrawn as failed:
        return failed.record, failed


def end_as(failed: NotDrawn | None) -> None:
    """Ends a command that has printed its record with a sentence and exit code 3 if pictures or reports failed."""
    if failed is not None:
        _say_where(failed)
        click.echo(f"Error: {ending(failed)[1]}", err=True)
        raise click.exceptions.Exit(3)


def answer(record: Mapping[str, Any], text: str | None = None, *, always: bool = False) -> None:
    """Prints the record of what a command has done as JSON, if --json asks for it, or `always`; numbers that are not
    finite become null. Else `text`, which is what was asked for and is printed with --quiet too.
    """
    if always or _asked("json"):
        _print(json_text(record).rstrip())
    elif text is not None:
        _print(text)


def _print(text: str, *, err: bool = False) -> None:
    """Prints below what was shown live, which is wiped first."""
    tell("")
    click.echo(text, err=err)


def options(*added: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A decorator that gives a command these options and arguments, in this order."""

    def decorate(command: Any) -> Any:
        for add in reversed(added):
            command = add(command)
        return command

    return decorate


def renamed(old: str, new: str) -> Callable[[Any], Any]:
    """A decorator that gives a command an option which is refused with what it is called now."""

    def refuse(_: click.Context, option: click.Parameter, value: str | None) -> None:
        if value is not None:
            raise click.UsageError(f"{old} = {value}: is now {new}")

    return click.option(old, hidden=True, expose_value=False, callback=refuse)


def parse_load(text: str) -> Any:
    """The line load (3,) of --S "S11,S12,S22"; InputError unless it is three numbers."""
    import numpy as np

    return np.array(numbers_of(text, "--S", "S11,S12,S22"))


def check_plot(path: Path, inputs: Iterable[Path | None] = ()) -> None:
    """InputError, before anything is solved, for a picture of --plot that cannot be written."""
    require("matplotlib", "plots", "--plot")
    check_out_file(path, "--plot", inputs, ("", ".png", ".svg", ".pdf"))
