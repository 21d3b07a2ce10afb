"""What the command line says of rings, checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from macro_fem.demand.cache import default_folder
from rve import WEAVES, Cell
from rve.common.errors import InputError
from rve.common.values import shown


def ring_options(
    rings: str | None,
    weave: str | None,
    grain: str | None,
    accuracy: float | None,
    cache: Path | None,
    no_cache: bool,
) -> dict[str, Any]:
    """The options rings (Cell or None), accuracy and cache (folder or None) of `macro_fem.job.run_scene`.

    InputError for radii, weave or grain that make no mesh, and for options that need --rings.

    >>> ring_options("5,0.5", None, None, 1e-3, None, True)["rings"].wire
    0.1
    """
    if rings is None:
        given = {"--weave": weave, "--grain": grain, "--accuracy": accuracy, "--cache": cache}
        for name, value in given.items():
            if value is not None:
                raise InputError(f"{name} = {value}: belongs to --rings R1,R2")
        if no_cache:
            raise InputError("--no-cache: belongs to --rings R1,R2")
        return {}
    if cache is not None and no_cache:
        raise InputError("--cache and --no-cache contradict each other: give one")
    weave = "4-in-1" if weave is None else weave
    if weave not in WEAVES:
        raise InputError(f"--weave = {shown(weave)}: known are {', '.join(WEAVES)}")
    cell = Cell(*radii(rings), WEAVES[weave], "y" if grain is None else grain)
    folder = None if no_cache else default_folder() if cache is None else cache
    return {"rings": cell, "accuracy": accuracy, "cache": folder}


def radii(text: str) -> tuple[float, float]:
    """The radii r1, r2 in mm in "r1,r2"; InputError if these are not two numbers.

    >>> radii("5,0.5")
    (5.0, 0.5)
    """
    try:
        r1, r2 = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--rings = {shown(text)}: write the radii of ring and wire in mm, such as 5,0.5") from None
    return r1, r2
