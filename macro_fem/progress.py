"""A progress line on the terminal: the present work and the seconds since the start."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

Say = Callable[[str], None]
INTERVAL_S = 1.0


def silent(text: str) -> None:
    """A progress function that writes nothing."""


@contextmanager
def progress_line(stream: TextIO | None = None, interval_s: float = INTERVAL_S) -> Iterator[Say]:
    """A function that sets the text of the line; the seconds since the start follow it, renewed every `interval_s`.

    The line is written to `stream` (standard error) and erased at the end. Without a terminal nothing is written.
    """
    out = sys.stderr if stream is None else stream
    if not out.isatty():
        yield silent
        return
    began, said, done = time.monotonic(), ["starting"], threading.Event()

    def show() -> None:
        while not done.wait(interval_s):
            out.write(f"\r\x1b[K{said[0]}, {time.monotonic() - began:.0f} s")
            out.flush()

    def say(text: str) -> None:
        said[0] = text

    thread = threading.Thread(target=show, daemon=True)
    thread.start()
    try:
        yield say
    finally:
        done.set()
        thread.join()
        out.write("\r\x1b[K")
        out.flush()
