"""Live progress: solvers tell what they do, and whoever wants to see it listens, as with logging.

with shown():                       # a line on the terminal: work and time
    solve_table(cell, loads)        # tells, as in tell("0 of 190 loads"), what is lost where nobody listens
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar

Listener = Callable[[str], object]

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


def tell(work: str) -> None:
    """Tell a listener, if there is one, what is being done and how far it is; "" wipes what was shown."""
    listener = _listener.get()
    if listener is not None:
        listener(work)


def time_left(begun: float, share: float) -> str:
    """Time used since `begun` (of `time.monotonic`) and expected for the rest of work of which a share is done.

    >>> time_left(time.monotonic() - 60.0, 0.25)
    '1.0 min used, about 3.0 min left'
    """
    used = time.monotonic() - begun
    return f"{_span(used)} used" + (f", about {_span(used / share - used)} left" if share > 0.0 else "")


def _span(seconds: float) -> str:
    unit, name = next((one for one in ((3600.0, "h"), (60.0, "min")) if seconds >= one[0]), (1.0, "s"))
    return f"{seconds / unit:.{0 if unit == 1.0 else 1}f} {name}"


@contextmanager
def heard_by(listener: Listener | None) -> Iterator[None]:
    """What is told in the block goes to this listener; None: to nobody."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@contextmanager
def part_of(work: str) -> Iterator[None]:
    """What is told in the block is told as a part of `work`.

    >>> heard = []
    >>> with heard_by(heard.append), part_of("64 cells, load step 2 of 2"):
    ...     tell("iteration 7")
    >>> heard
    ['64 cells, load step 2 of 2', '64 cells, load step 2 of 2, iteration 7']
    """
    outer = _listener.get()
    tell(work)
    with heard_by(outer and (lambda inner: outer(f"{work}, {inner}" if inner else ""))):
        yield


@contextmanager
def shown(period_s: float | None = None) -> Iterator[None]:
    """What is told in the block is shown on a line of a terminal, standard error, and wiped at its end; elsewhere, as
    in a pipe, nothing, or a line every `period_s` seconds."""
    if not sys.stderr.isatty():
        with nullcontext() if period_s is None else heard_by(_printed_every(period_s)):
            yield
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    text = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis"))
    columns = (SpinnerColumn(), text, TimeElapsedColumn())
    console = Console(file=sys.stderr)  # not where standard error is redirected to later, as by a sweep
    line = Progress(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False)
    task = line.add_task("", total=None)

    def show(work: str) -> None:
        line.update(task, description=work)
        (line.start if work else line.stop)()

    with heard_by(show):
        tell("starting")  # a command may import for a second before it does anything
        try:
            yield
        finally:
            tell("")


def _printed_every(period_s: float) -> Listener:
    """Prints what is told on standard error, at most once in so many seconds, the first time after them."""
    stream, due = sys.stderr, time.monotonic() + period_s

    def listen(work: str) -> None:
        nonlocal due
        if work and time.monotonic() >= due:
            stream.write(f"{work}\n")
            stream.flush()
            due = time.monotonic() + period_s

    return listen
