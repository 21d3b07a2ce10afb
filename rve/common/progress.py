"""Live progress: solvers tell what they do, and whoever wants to see it listens, as with logging.

with shown():                       # a line on the terminal: work, bar, time, remaining time
    solve_table(cell, loads)        # tells, as in tell("190 loads", 0.4), what is lost where nobody listens
"""

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Listener = Callable[[str, float | None], None]

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)
MOST = 0.999
"""Share that is shown for finished work: at 1 the clock of a bar stops."""


def tell(work: str, share: float | None = None) -> None:
    """Tell a listener, if there is one, what is being done and which share of it is done, 0 to 1 or unknown.

    The clock starts anew where the words up to the first comma change. "" wipes what was shown.
    """
    listener = _listener.get()
    if listener is not None:
        listener(work, share)


@contextmanager
def heard_by(listener: Listener | None) -> Iterator[None]:
    """What is told in the block goes to this listener; None: to nobody."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


@contextmanager
def part_of(work: str, begin: float | None = None, end: float | None = None) -> Iterator[None]:
    """What is told in the block is told as a part of `work`, from its share `begin` to `end`; unknown without them.

    >>> heard = []
    >>> with heard_by(lambda work, share: heard.append((work, share))), part_of("64 cells, load step 2 of 2", 0.5, 1.0):
    ...     tell("iteration 7", 0.5)
    >>> heard
    [('64 cells, load step 2 of 2', 0.5), ('64 cells, load step 2 of 2, iteration 7', 0.75)]
    """
    outer = _listener.get()

    def of_part(inner: str, share: float | None) -> None:
        known = None if begin is None or end is None else begin + (end - begin) * (share or 0.0)
        if outer is not None:
            outer(f"{work}, {inner}" if inner else "", known)

    tell(work, begin)
    with heard_by(of_part):
        yield


def way(first: float, now: float, last: float) -> float | None:
    """Share of the fall from `first` to `last` by logarithm, 0 to 1; None if it is unknown.

    >>> way(1.0, 1e-3, 1e-6)
    0.5
    """
    if not (0.0 < last < first < math.inf and 0.0 < now < math.inf):
        return None
    return min(1.0, max(0.0, math.log(first / now) / math.log(first / last)))


@contextmanager
def shown() -> Iterator[None]:
    """What is told in the block is shown on a line of a terminal, standard error, and wiped at its end."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.table import Column

    text = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis"))
    columns = (SpinnerColumn(), text, BarColumn(12), TimeElapsedColumn(), TimeRemainingColumn())
    console = Console(file=sys.stderr)  # not where standard error is redirected to later, as by a sweep
    bar = Progress(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False)
    task = bar.add_task("", total=None)

    def show(work: str, share: float | None) -> None:
        if not work:
            bar.stop()
            return
        if work.split(",")[0] != bar.tasks[0].description.split(",")[0]:
            bar.reset(task, total=None)
        total, done = (None, 0.0) if share is None else (1.0, min(share, MOST))
        bar.update(task, description=work, total=total, completed=done)
        bar.start()

    with heard_by(show):
        tell("starting")  # a command may import for a second before it does anything
        try:
            yield
        finally:
            tell("")
