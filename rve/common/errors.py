"""What can go wrong, each with a name and a sentence that says what happened and what to try."""

import re
import reprlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any


def cut(text: str) -> str:
    """A text on one line in which of every word of more than 80 letters the middle is left out; names of folders are
    words."""
    return re.sub(r"[^\s/\\]{81,}", lambda word: f"{word[0][:38]}...{word[0][-39:]}", " ".join(text.splitlines()))


class InputError(ValueError):
    """Bad input; the message is one sentence that names the file, key and value."""

    def __init__(self, message: str) -> None:
        super().__init__(cut(message))


class NotConverged(RuntimeError):
    """A single solve did not reach its tolerance; the message holds the status and its sentence."""


class NotDrawn(RuntimeError):
    """Pictures or reports of a result whose data are in place failed: why, by their names; and its record."""

    def __init__(self, causes: dict[str, Exception], record: Any) -> None:
        super().__init__("; ".join(f"{name} could not be made: {why}" for name, why in causes.items()))
        self.causes, self.record = causes, record


SENTENCES = {
    "stalled": "no equilibrium after all attempts; allow more iterations or attempts, or move the load by 0.01 degrees",
    "below": "another known state does more work under this load, and no equilibrium was reached from it; allow more "
    "iterations",
    "compressive": "a principal line load is negative and rings cannot push; keep beta between 0 and 90 degrees",
    "unlisted": "rings that the weave does not list as a pair overlap; list more pairs in the weave",
    "no-limit": "the load leaves the strain free and its limit was not found; raise the smaller principal load",
}
_short = reprlib.Repr()
_short.maxstring = _short.maxother = _short.maxlong = 80


def shown(value: Any) -> str:
    """A value as an error message shows it: its repr, cut to about a line however large or deep the value is."""
    text = _short.repr(value)
    return text if len(text) <= 160 else f"{text[:157]}..."


@contextmanager
def noted_if_stopped(note: str) -> Iterator[None]:
    """Says `note` as well where the block is stopped from outside, by Ctrl-C say: what is kept, how to go on."""
    try:
        yield
    except KeyboardInterrupt as stop:
        stop.add_note(note)
        raise


def require(module: str, extra: str, purpose: str, instead: str = "") -> None:
    """InputError if an optional package is missing; it says how to install it, and what else can be done."""
    if find_spec(module) is None:
        way_out = f", or {instead}" if instead else ""
        raise InputError(f"{purpose} needs {module}: run pip install {module} (extra {extra}){way_out}")
