"""What can go wrong, each with a name and a sentence that says what happened and what to try."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, requires
from importlib.util import find_spec


class InputError(ValueError):
    """Bad input; the message is one sentence that names the file, key and value."""


class NotConverged(RuntimeError):
    """A single solve did not reach its tolerance; the message holds the status and its sentence."""


SENTENCES = {
    "converged": "equilibrium found: residual, gaps and links are within tolerance",
    "stalled": "no equilibrium after all attempts; allow more iterations or attempts, or move the load by 0.01 degrees",
    "below": "another known state does more work under this load, and no equilibrium was reached from it; allow more "
    "iterations",
    "compressive": "a principal line load is negative and rings cannot push; keep beta between 0 and 90 degrees",
    "no-limit": "the load leaves the strain free and its limit was not found; raise the smaller principal load",
    "time-step": "the time step shrank to nothing before the energy fell; allow contact curvature or a smaller h_min",
    "step-limit": "the step limit was reached before the residual; allow more steps or a larger time step",
}


@contextmanager
def noted_if_stopped(note: str) -> Iterator[None]:
    """Says `note` as well where the block is stopped from outside, by Ctrl-C say: what is kept, how to go on.

    >>> try:
    ...     with noted_if_stopped("answers are kept in cache"):
    ...         raise KeyboardInterrupt
    ... except KeyboardInterrupt as stop:
    ...     print(stop.__notes__)
    ['answers are kept in cache']
    """
    try:
        yield
    except KeyboardInterrupt as stop:
        stop.add_note(note)
        raise


def require(module: str, extra: str, purpose: str, instead: str = "") -> None:
    """InputError if an optional package is missing; it says how to install it, and what else can be done.

    The package is named and not our extra alone: no package index need hold this project.

    >>> require("numpy", "plots", "pictures")
    """
    if find_spec(module) is not None:
        return
    package = module
    with suppress(PackageNotFoundError):  # package and version that our metadata ask for
        package = next(
            (one.split(";")[0].strip() for one in requires("ring-mesh") or [] if one.startswith(module)), module
        )
    way_out = f", or {instead}" if instead else ""
    raise InputError(f"{purpose} needs {module}: run pip install '{package}' (extra {extra}){way_out}")
