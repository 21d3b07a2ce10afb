"""The law asked of the rings on the way: from Python, and as the command line says it."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from homogenize import LawInterval, interval_of_table, read_law_interval
from rve import Cell
from rve.common import InputError, numbers_of, read_entry
from rve.common.rings import check_ring_size

ACCURACY = 5e-3
"""Of a run by default."""


@dataclass(frozen=True)
class OnDemand:
    """These rings are asked for the law where the curtain needs it, until the interval of the answer is no wider than
    `accuracy` times total load times height, which for a curtain under its weight alone is that of the mean height.

    known: what is known to begin with, an interval of laws or the file of a law or table (CSV) that tells one; cache:
    the folder where answers of the rings are kept. InputError for an accuracy out of range.
    """

    cell: Cell
    accuracy: float = ACCURACY
    known: LawInterval | Path | None = None
    cache: str | Path | None = None

    def __post_init__(self) -> None:
        read_entry(vars(self), "accuracy", Annotated[float, Meta(ge=1e-5, le=0.5)])

    def interval(self) -> LawInterval | None:
        """What is known to begin with; InputError for a law without rows."""
        if isinstance(self.known, Path):
            read = interval_of_table if self.known.suffix.lower() == ".csv" else read_law_interval
            return read(self.known)
        if not isinstance(self.known, LawInterval | None):
            raise InputError("law: has no rows to begin with; make it again with homogenize fit, or give none")
        return self.known


def ring_options(
    rings: str | None, law: Path | None = None, table: Path | None = None, **given: Any
) -> OnDemand | None:
    """The rings that are asked, None if no radii are given; the rest as the command line has it. A law or table is what
    is known to begin with.

    Answers are kept in $XDG_CACHE_HOME/ring-mesh, by default ~/.cache/ring-mesh, unless told otherwise. InputError for
    radii, weave or grain that make no mesh, and for options that need --rings.

    >>> ring_options("5,0.5", no_cache=True).cell.wire
    0.1
    """
    told = {name: value for name, value in given.items() if value is not None and value is not False}
    if rings is None:
        for name, value in told.items():
            raise InputError(f"--{name.replace('_', '-')} = {value}: belongs to --rings R1,R2")
    if table is not None and (law is not None or rings is None):
        raise InputError(f"--table = {table}: is what a run with --rings begins with, instead of --law")
    if rings is None:
        return None
    if "cache" in told and "no_cache" in told:
        raise InputError("--cache and --no-cache contradict each other: give one")
    r1, r2 = numbers_of(rings, "--rings", "R1,R2")
    check_ring_size(r1, "--rings: r1")
    cell = Cell(r1, r2, told.get("weave", "4-in-1"), told.get("grain", "y"))
    base = os.environ.get("XDG_CACHE_HOME", "")
    kept = (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "ring-mesh"
    folder = None if "no_cache" in told else told.get("cache", kept)
    return OnDemand(cell, told.get("accuracy", ACCURACY), law if table is None else table, folder)
