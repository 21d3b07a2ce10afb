"""Rings that answer questions: largest work h(S) under load directions, each solved by itself and kept on disk.

A direction is a point x of the unit disc, S = (1 + x1, x2, 1 - x1)/2 of unit trace; its rim is the loads of rank one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homogenize import CellInfo, Rows, cell_of
from macro_fem.demand.cache import RingAnswer, RingCache
from rve import Cell, solve_table, support
from rve.common.errors import NotConverged
from rve.common.tensor import from_disc
from rve.common.types import Array

DIGITS = 9
"""Digits of a direction: nearer ones are one question."""


@dataclass(frozen=True, eq=False)
class Asked:
    """Directions x (n, 2) that were asked, their rows without those that failed, and how the answers came about.

    solves: ring problems solved in this run; hits: answers read from the cache; failed: directions without an answer.
    """

    x: Array
    rows: Rows | None = None
    solves: int = 0
    hits: int = 0
    failed: int = 0

    @property
    def count(self) -> int:
        """Rows known."""
        return 0 if self.rows is None else len(self.rows)


def ring_info(cell: Cell) -> CellInfo:
    """Radii, reference cell and areal mass of a mesh; NotConverged if its reference cell is not found."""
    return cell_of(solve_table(cell, ([0.0], [90.0])))


def rounded(x: Array) -> Array:
    """Directions (n, 2) with DIGITS digits, inside the disc.

    >>> rounded(np.array([[0.6, 0.8000000001], [0.1234567891, 0.0]])).tolist()
    [[0.6, 0.8], [0.123456789, 0.0]]
    """
    x = np.round(x, DIGITS) + 0.0
    size = np.hypot(x[:, 0], x[:, 1])
    return np.asarray(np.where(size[:, None] > 1.0, x / np.maximum(size, 1.0)[:, None], x))


def first_directions(is_mirrored: bool) -> Array:
    """Directions (n, 2) to begin with: the centre, some half-way to the rim, and most on it, where meshes wrinkle.

    Of a mesh that is its own mirror image, x2 -> -x2, one half is enough.

    >>> len(first_directions(True)), len(first_directions(False))
    (12, 19)
    """
    rim = np.pi * np.arange(7) / 6.0 if is_mirrored else np.pi * np.arange(12) / 6.0
    ring = np.pi * np.arange(4) / 3.0 if is_mirrored else np.pi * np.arange(6) / 3.0
    points = [np.zeros((1, 2)), *(r * np.column_stack([np.cos(a), np.sin(a)]) for r, a in ((0.6, ring), (1.0, rim)))]
    return rounded(np.vstack(points))


def ask(cell: Cell, cache: RingCache, x: Array, asked: Asked) -> Asked:
    """`asked` with the directions x (n, 2) as well, from the cache or from the rings, one after the other.

    Every answer is kept as soon as it is there: a run that is killed loses the one in flight.
    """
    x = rounded(x)
    solves = hits = 0
    answers = []
    for S in from_disc(x):
        answer = cache.get(cell, S)
        hits += answer is not None
        if answer is None:
            answer = _solved(cell, S)
            cache.put(cell, S, answer)
            solves += 1
        answers.append(answer)
    good = [i for i, answer in enumerate(answers) if answer.status == "converged"]
    new = _rows(cell, from_disc(x[good]), [answers[i] for i in good]) if good else None
    return Asked(
        np.vstack([asked.x, x]),
        _joined(asked.rows, new),
        asked.solves + solves,
        asked.hits + hits,
        asked.failed + len(answers) - len(good),
    )


def _solved(cell: Cell, S: Array) -> RingAnswer:
    try:
        found = support(cell, S[None])
    except NotConverged:
        return RingAnswer(np.nan, (np.nan,) * 3, "stalled", False)
    E = tuple(float(value) for value in found.E[0])
    return RingAnswer(float(found.h[0]), (E[0], E[1], E[2]), str(found.status[0]), bool(found.unique[0]))


def _rows(cell: Cell, S: Array, answers: list[RingAnswer]) -> Rows:
    h, E = np.array([one.h for one in answers]), np.array([one.E for one in answers])
    unique = np.array([one.unique for one in answers])
    return Rows(S, E, h, unique, np.arange(len(h)), is_mirrored=cell.weave.is_mirrored)


def _joined(old: Rows | None, new: Rows | None) -> Rows | None:
    if old is None or new is None:
        return new if old is None else old
    S, E, h, unique = (np.concatenate([getattr(old, k), getattr(new, k)]) for k in ("S", "E", "h", "unique"))
    return Rows(S, E, h, unique, np.arange(len(h)), old.dropped, old.is_mirrored)
