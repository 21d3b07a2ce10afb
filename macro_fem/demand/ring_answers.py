"""Rings that answer questions: largest work h(S) under load directions, each solved by itself and kept on disk.

A direction is a point x of the unit disc, S = (1 + x1, x2, 1 - x1)/2 of unit trace; its rim is the loads of rank one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from homogenize import CellInfo, LockedRows, cell_of
from macro_fem.demand.cache import Beside, RingAnswer, keep_answer, read_answer
from rve import Cell, solve_table, support
from rve.common.cache import Cache
from rve.common.errors import NotConverged
from rve.common.tensor import WEIGHT, disc, from_disc, mirror
from rve.common.types import Array

DIGITS = 9
"""Digits of a direction: nearer ones are one question."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Directions x (n, 2) that were asked, their rows without those that failed, and how the answers came about.

    solves: ring problems solved in this run; hits: answers read from the cache; failed: directions without an answer.
    beside: of each row, the directions that it was solved with.
    """

    x: Array
    rows: LockedRows | None = None
    solves: int = 0
    hits: int = 0
    failed: int = 0
    beside: tuple[Beside, ...] = ()

    def beside_of(self, i: int) -> Beside:
        """The directions that row i was solved with."""
        return self.beside[i] if i < len(self.beside) else ()

    @property
    def count(self) -> int:
        """LockedRows known."""
        return 0 if self.rows is None else len(self.rows)


GAIN = 1e-8
"""Work at unit trace by which a strain must exceed another row's own to contradict it; round-off leaves 1e-12."""
ROUNDS = 6
"""How often rows that others contradict are asked again."""


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


def ask(cell: Cell, cache: Cache, x: Array, asked: Samples) -> Samples:
    """`asked` with the directions x (n, 2) as well, from the cache or from the rings, one after the other.

    Every answer is kept as soon as it is there: a run that is killed loses the one in flight.
    """
    x = rounded(x)
    solves = hits = 0
    answers = []
    for one in x:
        answer, solved = _answer(cell, cache, one, ())
        answers.append(answer)
        solves, hits = solves + solved, hits + (solved == 0)
    good = [i for i, answer in enumerate(answers) if answer.status == "converged"]
    new = _rows(cell, from_disc(x[good]), [answers[i] for i in good]) if good else None
    return Samples(
        np.vstack([asked.x, x]),
        _join(asked.rows, new),
        asked.solves + solves,
        asked.hits + hits,
        asked.failed + len(answers) - len(good),
        asked.beside + ((),) * len(good),
    )


def settle(cell: Cell, cache: Cache, asked: Samples) -> Samples:
    """`asked` where no row's strain does more work under the load of another row than that row's own.

    A row for which one does is asked again beside the load of that strain, whose locked states are then starts; no
    later than after ROUNDS of this, or one without any gain.
    """
    for _ in range(ROUNDS):
        before = asked.rows
        if before is None:
            break
        for i, j, x in contradictions(before):
            asked = guard_points(cell, cache, asked, i, (*asked.beside_of(j), x))
        if asked.rows is None or (asked.rows.h - before.h).max() < GAIN:
            break
    return asked


def contradictions(rows: LockedRows) -> list[tuple[int, int, tuple[float, float]]]:
    """LockedRows i under whose load the strain of another does more work, the row j that does most, and its direction.

    The direction is that of the mirror image where it is the image of row j that does the work.

    >>> S, E = np.array([[0.5, 0.0, 0.5], [0.4, 0.0, 0.6]]), np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.1]])
    >>> contradictions(LockedRows(S, E, np.array([0.0, 0.1]), np.ones(2, bool), np.arange(2)))
    [(0, 1, (-0.2, 0.0))]
    """
    S, E = rows.S, rows.E
    if rows.is_mirrored:
        S, E = np.vstack([S, mirror(S)]), np.vstack([E, mirror(E)])
    work = (rows.S * WEIGHT) @ E.T
    best, excess = work.argmax(axis=1), work.max(axis=1) - rows.h
    x = rounded(disc(S))
    worst = [i for i in np.argsort(-excess, kind="stable") if excess[i] > GAIN]
    return [(int(i), int(best[i]) % len(rows), (float(x[best[i], 0]), float(x[best[i], 1]))) for i in worst]


def guard_points(cell: Cell, cache: Cache, asked: Samples, i: int, others: Beside) -> Samples:
    """`asked` with row i asked again beside other directions; the row as it was if nothing better is found."""
    rows, old = asked.rows, asked.beside_of(i)
    beside = (*old, *(x for x in dict.fromkeys(others) if x not in old))
    if rows is None or len(beside) == len(old):
        return asked
    answer, solved = _answer(cell, cache, rounded(disc(rows.S[i : i + 1]))[0], beside)
    asked = replace(asked, solves=asked.solves + solved, hits=asked.hits + (solved == 0))
    known = {k: one for k, one in enumerate(asked.beside) if one} | {i: beside}
    asked = replace(asked, beside=tuple(known.get(k, ()) for k in range(len(rows))))
    if answer.status != "converged" or not answer.h > rows.h[i]:
        return asked
    h, E = rows.h.copy(), rows.E.copy()
    h[i], E[i] = answer.h, answer.E
    return replace(asked, rows=replace(rows, h=h, E=E))


def _answer(cell: Cell, cache: Cache, x: Array, beside: Beside) -> tuple[RingAnswer, int]:
    """The answer to the direction x (2,), and how many ring problems were solved for it: none if it was kept."""
    S = from_disc(np.vstack([x[None], *(np.array([one]) for one in beside)]))
    answer = read_answer(cache, cell, S[0], beside)
    if answer is not None:
        return answer, 0
    answer = _solve(cell, S)
    keep_answer(cache, cell, S[0], answer, beside)
    return answer, len(S)


def _solve(cell: Cell, S: Array) -> RingAnswer:
    try:
        found = support(cell, S)
    except NotConverged:
        return RingAnswer(np.nan, (np.nan,) * 3, "stalled", False)
    E = tuple(float(value) for value in found.E[0])
    return RingAnswer(float(found.h[0]), (E[0], E[1], E[2]), str(found.status[0]), bool(found.unique[0]))


def _rows(cell: Cell, S: Array, answers: list[RingAnswer]) -> LockedRows:
    h, E = np.array([one.h for one in answers]), np.array([one.E for one in answers])
    unique = np.array([one.unique for one in answers])
    return LockedRows(S, E, h, unique, np.arange(len(h)), is_mirrored=cell.weave.is_mirrored)


def _join(old: LockedRows | None, new: LockedRows | None) -> LockedRows | None:
    if old is None or new is None:
        return new if old is None else old
    S, E, h, unique = (np.concatenate([getattr(old, k), getattr(new, k)]) for k in ("S", "E", "h", "unique"))
    return LockedRows(S, E, h, unique, np.arange(len(h)), old.dropped, old.is_mirrored)
