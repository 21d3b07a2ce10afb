"""Live progress: solvers tell what they do, and whoever wants to see it listens, as with logging.

with shown():                       # a line on the terminal: work, bar, time, remaining time
    solve_table(cell, loads)

tell("190 loads", 0.4)              # inside solvers; nothing happens unless somebody listens
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Listener = Callable[[str, float | None], None]

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


def tell(work: str, share: float | None = None) -> None:
    """Tells a listener, if there is one, what is being done and which share of it is done, 0 to 1 or unknown.

    >>> heard = []
    >>> with heard_by(lambda work, share: heard.append((work, share))):
    ...     tell("rings", 0.5)
    >>> heard
    [('rings', 0.5)]
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
def shown() -> Iterator[None]:
    """What is told in the block is shown live on standard error, and wiped at its end; nothing if that is no terminal.

    rich comes with meshio.
    """
    if not sys.stderr.isatty():
        with heard_by(None):
            yield
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(20), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None)
        last = ["starting"]

        def listener(work: str, share: float | None) -> None:
            if work.split(",")[0] != last[0].split(",")[0]:
                bar.reset(task, total=None, description=work)
            last[0] = work
            total = None if share is None else 1.0
            bar.update(task, description=work, total=total, completed=share or 0.0)

        with heard_by(listener):
            yield
