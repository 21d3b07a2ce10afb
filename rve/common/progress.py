"""Live progress: solvers tell what they do, and whoever wants to see it listens, as with logging.

with shown():                       # a line on the terminal: work and time
    solve_table(cell, loads)        # tells, as in tell("0 of 190 loads"), what is lost where nobody listens
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Progress:
    """What is being done; where it can be counted, how many of `total` are done in `used_s` seconds. `total` is 0 where
    it cannot, and leaves out what was done before.

    >>> told = Progress("sweep, 5 of 10 done", 2.0, 7.0, 30.0)
    >>> print(told)
    sweep, 5 of 10 done; 30 s used, about 1.2 min left
    >>> told.left_s
    75.0
    """

    work: str
    done: float = 0.0
    total: float = 0.0
    used_s: float = 0.0

    @property
    def left_s(self) -> float | None:
        """Seconds for the rest at the pace so far, None where that is not known."""
        return self.used_s * (self.total - self.done) / self.done if self.done > 0.0 else None

    def __str__(self) -> str:
        left = self.left_s
        return self.work if left is None else f"{self.work}; {_span(self.used_s)} used, about {_span(left)} left"


def _span(seconds: float) -> str:
    unit, name = next((one for one in ((3600.0, "h"), (60.0, "min")) if seconds >= one[0]), (1.0, "s"))
    return f"{seconds / unit:.{0 if unit == 1.0 else 1}f} {name}"


def _measured(work: str, done: float = 0.0, total: float = 0.0, since: float = 0.0) -> Progress:
    return Progress(work, done, total, time.monotonic() - since if total else 0.0)


Listener = Callable[[Progress], object]

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


def tell(work: str, done: float = 0.0, total: float = 0.0, since: float = 0.0) -> None:
    """Tell a listener, if there is one, what is being done; "" wipes what was shown. How far it is, where that can be
    counted: `done` of `total` since a time of `time.monotonic`."""
    listener = _listener.get()
    if listener is not None:
        listener(_measured(work, done, total, since))


@contextmanager
def heard_by(listener: Listener | None) -> Iterator[None]:
    """What is told in the block goes to this listener; None: to nobody."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@contextmanager
def part_of(work: str, *counted: float) -> Iterator[None]:
    """What is told in the block is told as a part of `work`, how far by what is `counted` of it, as in `tell`, if that
    is.

    >>> heard = []
    >>> with heard_by(heard.append), part_of("64 cells, load step 2 of 2"):
    ...     tell("iteration 7")
    >>> [str(one) for one in heard]
    ['64 cells, load step 2 of 2', '64 cells, load step 2 of 2, iteration 7']
    """
    outer = _listener.get()
    tell(work, *counted)

    def joined(inner: Progress) -> Progress:
        words = f"{work}, {inner.work}" if inner.work else ""
        return _measured(words, *counted) if counted else replace(inner, work=words)

    with heard_by(outer and (lambda inner: outer(joined(inner)))):
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
    from rich.progress import Progress as Line
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    text = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis"))
    columns = (SpinnerColumn(), text, TimeElapsedColumn())
    console = Console(file=sys.stderr)  # not where standard error is redirected to later, as by a sweep
    line = Line(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False)
    task = line.add_task("", total=None)

    def show(told: Progress) -> None:
        line.update(task, description=str(told))
        (line.start if told.work else line.stop)()

    with heard_by(show):
        tell("starting")  # a command may import for a second before it does anything
        try:
            yield
        finally:
            tell("")


def _printed_every(period_s: float) -> Listener:
    """Prints what is told on standard error, at most once in so many seconds, the first time after them."""
    stream, due = sys.stderr, time.monotonic() + period_s

    def listen(told: Progress) -> None:
        nonlocal due
        if told.work and time.monotonic() >= due:
            stream.write(f"{told}\n")
            stream.flush()
            due = time.monotonic() + period_s

    return listen
