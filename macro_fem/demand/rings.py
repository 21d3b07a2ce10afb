"""The law asked of the rings on the way: whose rings, and how they answer: largest work h(S) under load directions,
each solved by itself and kept on disk.

A direction is a point x of the unit disc, S = (1 + x1, x2, 1 - x1)/2 of unit trace; its rim is the loads of rank one.
"""

import math
import os
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from homogenize import LawInterval, read_law_interval
from homogenize.fitting import interval_of_table, law_interval
from homogenize.laws import LockedRows
from macro_fem.demand.directions import rounded
from rve import Cell, reference_cell, support
from rve.common import (
    NO_CACHE,
    Array,
    Cache,
    InputError,
    NotConverged,
    heard_by,
    numbers_of,
    read_entry,
    tell,
    versions,
)
from rve.common.arguments import check_fields
from rve.common.cell_fields import check_ring_size
from rve.common.tensor import WEIGHT, disc, from_disc, mirror
from rve.geometry import CellInfo

Beside = tuple[tuple[float, float], ...]
"""Directions that a direction was solved with, whose locked states were starts."""
FORMAT, VERSION = "ring-mesh support value", 3
"""Of kept answers; raised when the same direction would be answered differently, so that older files are not read."""
NOT_ASKED = ("r1", "r2", "density", "material", "weave")
"""Fields of a cell that enter by name and ratio, or not at all."""
ROUNDING, GAIN = 1e-9, 1e-8
"""By how much h of a kept answer may differ from S:E, which it is computed as; and work at unit trace by which a strain
must exceed another row's own to contradict it. Round-off leaves 1e-12."""
ROUNDS = 6
"""How often rows that others contradict are asked again."""

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
        check_fields(self)
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


class Rings:
    """Rings of a mesh, what they were asked, and how the answers came about.

    x (n, 2): directions that were asked; rows: their answers without those that failed, to begin with those of an
    interval of laws that is `known`; beside: the directions that some rows were solved with. solves: ring problems
    solved; hits: answers read from the cache; failed: directions without an answer. is_mirrored: whether the weave is
    its own mirror image.
    """

    def __init__(self, cell: Cell, cache: Cache = NO_CACHE, known: LawInterval | None = None) -> None:
        self.cell, self.cache, self.is_mirrored = cell, cache, cell.weave.is_mirrored
        self.beside: dict[int, Beside] = {}
        self.solves = self.hits = self.failed = 0
        none, number = np.zeros((0, 3)), np.zeros(0, np.intp)
        self.rows = LockedRows(none, none, none[:, 0], number > 0, number, is_mirrored=self.is_mirrored)
        if known is not None:
            if known.law.cell is not None:
                self.info.check_same(known.law.cell, known.source, "--rings")
            self.rows = known.rows
        self.x = rounded(disc(self.rows.S))

    @cached_property
    def info(self) -> CellInfo:
        """Radii, reference cell and areal mass; NotConverged if the reference cell is not found."""
        return reference_cell(self.cell)

    @cached_property
    def law(self) -> LawInterval:
        """What is known of the law; InputError if the rings answered too few questions."""
        if len(self.rows) < 4:
            raise InputError(
                f"--rings: {self.failed} of {len(self.x)} load directions found no locked state; try other radii"
            )
        return law_interval(self.rows, cell=self.info)

    def ask(self, x: Array) -> None:
        """Ask for the directions x (n, 2), one after the other; each answer is kept as soon as it is there."""
        x = rounded(x)
        for number, one in enumerate(x):
            tell(f"asking the rings, {self.solves} solved, {len(x) - number} to go")
            if (row := self.answer(one)) is None:
                self.failed += 1
            else:
                self.rows = self.rows.join([row])
        self.x = np.vstack([self.x, x])

    def learn(self, x: Array) -> None:
        """Add the answers to the directions x (n, 2), settled, to what is known of the law."""
        self.ask(x)
        self.settle()
        vars(self).pop("law", None)

    def settle(self) -> None:
        """Ask again until no row's strain does more work under the load of another row than that row's own: that row is
        asked beside the load of the strain, whose locked states are then starts. Ends after a round without gain.
        """
        for _ in range(ROUNDS if len(self.rows) else 0):
            before = self.rows.h
            for i, j, x in contradictions(self.rows):
                old = self.beside.get(i, ())
                self.beside[i] = tuple(dict.fromkeys((*old, *self.beside.get(j, ()), x)))
                if len(self.beside[i]) == len(old):
                    continue
                own = self.rows.take(np.array([i]))
                row = self.answer(rounded(disc(own.S))[0], self.beside[i])
                if row is not None and row.h[0] > own.h[0]:
                    self.rows = self.rows.put(np.array([i]), replace(own, h=row.h, E=row.E))
            if (self.rows.h - before).max() < GAIN:
                break

    def answer(self, x: Array, beside: Beside = ()) -> LockedRows | None:
        """The row of the direction x (2,), from the cache or from the rings; None if they found no locked state."""
        S = from_disc(np.array([x, *beside]))
        key = question(self.cell, S[0], beside)
        found = self.cache.get(key)
        if found and (found["status"] != "converged" or abs(S[0] * WEIGHT @ found["E"] - found["h"]) < ROUNDING):
            self.hits += 1
        else:
            with heard_by(None):
                found = _solve(self.cell, S)
            self.solves += len(S)
            self.cache.put(key, found | {"versions": versions()})
        if found["status"] != "converged":
            return None
        h, E, unique = (np.array([found[name]]) for name in ("h", "E", "unique"))
        return LockedRows(S[:1], E, h, unique, np.array([len(self.rows)]), is_mirrored=self.is_mirrored)


def contradictions(rows: LockedRows) -> list[tuple[int, int, tuple[float, float]]]:
    """Rows i under whose load the strain of another does more work, the row j that does most, and its direction.

    The direction is that of the mirror image where it is the image of row j that does the work.
    """
    S, E = rows.S, rows.E
    if rows.is_mirrored:
        S, E = np.vstack([S, mirror(S)]), np.vstack([E, mirror(E)])
    work = (rows.S * WEIGHT) @ E.T
    best, excess = work.argmax(axis=1), work.max(axis=1) - rows.h
    x = rounded(disc(S))
    worst = [i for i in np.argsort(-excess, kind="stable") if excess[i] > GAIN]
    return [(int(i), int(best[i]) % len(rows), (float(x[best[i], 0]), float(x[best[i], 1]))) for i in worst]


def question(cell: Cell, S: Array, beside: Beside = ()) -> dict[str, Any]:
    """All that the answer to the direction S (3,) depends on: every field of the cell but its size and metal."""
    others = {one.name: str(getattr(cell, one.name)) for one in fields(cell) if one.name not in NOT_ASKED}
    return {
        "format": FORMAT,
        "format_version": VERSION,
        "weave": cell.weave.name,
        "repeat": list(cell.weave.repeat),
        "r2_over_r1": cell.wire,
        **others,
        "S11_S12_S22": [float(x) for x in S],
        "beside": [list(x) for x in beside],
    }


def _solve(cell: Cell, S: Array) -> dict[str, Any]:
    """What a cache keeps: h = max S:E of the first direction, E that reaches it, status, and whether E is unique."""
    try:
        found = support(cell, S)
    except NotConverged:
        return {"h": math.nan, "E": [math.nan] * 3, "status": "stalled", "unique": False}
    unique = bool(found.unique[0])
    return {"h": float(found.h[0]), "E": found.E[0].tolist(), "status": str(found.status[0]), "unique": unique}
