"""Section `contact`: error of the gap of two rings against time, for three ways to find their nearest points.

Rings are pairs of circles of radius 1; the gap is the distance of the circles less a wire, so its error is that of the
distance. What is wanted are all local minima below `REACH`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.pages.measuring import decade, least_seconds
from benchmarks.pages.model import Column, Curve, Diagram, Section, Table
from rve.contact import are_linked, local_minima, tangent_frame
from rve.projection import alternating_projection

Array = NDArray[np.float64]
REACH = 1.0
SAME = 0.1
"""A point on ring A closer than this to one of the reference counts as that one found."""
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


DEFAULT, FINER, PAPERS = ("Newton", "48 samples"), ("Newton", "96 samples"), ("projection", "400 iterations")


@dataclass(frozen=True)
class Pairs:
    """Circles of radius 1: centre of B seen from A, and the normals of both, (n, 3) each."""

    d: Array
    n_a: Array
    n_b: Array

    def take(self, rows: Sequence[int] | NDArray[np.intp]) -> Pairs:
        """The pairs of these rows."""
        return Pairs(self.d[rows], self.n_a[rows], self.n_b[rows])


@dataclass(frozen=True)
class Found:
    """Minima: pair (m,), point on ring A (m, 3), distance (m,)."""

    pair: NDArray[np.intp]
    point: Array
    distance: Array


Search = Callable[[Pairs], Found]


@dataclass(frozen=True)
class Score:
    """A search against the reference: largest error of a distance among the minima found, how many of `all` were
    missed, for how many pairs the deepest one was, and how many points are no minima or named twice.
    """

    error: float
    missed: int
    deepest: int
    all: int
    wrong: int


def random_pairs(count: int, seed: int = 7) -> Pairs:
    """Linked pairs as they come in a weave: centres in a plane, normals anywhere, wires of radius 0.05 apart."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(8 * count, 3)) * np.array([1.2, 1.2, 0.0])
    n_a, n_b = rng.normal(size=(2, 8 * count, 3))
    n_a, n_b = (n / np.linalg.norm(n, axis=1)[:, None] for n in (n_a, n_b))
    linked = Pairs(d, n_a, n_b).take(np.flatnonzero(are_linked(d, n_a, n_b, 1.0)))
    lowest = circle_distance(linked, np.tile(np.linspace(0.0, 2.0 * np.pi, 256), (len(linked.d), 1)))[0].min(axis=1)
    apart = np.flatnonzero(lowest > 0.1)
    if len(apart) < count:
        raise ValueError(f"only {len(apart)} of {count} pairs are apart: draw more")
    return linked.take(apart[:count])


def degenerate_pairs() -> dict[str, tuple[Pairs, int]]:
    """Pairs by name with the number of minima below `REACH` that they have; one where all points are as near."""
    z = [0.0, 0.0, 1.0]

    def pair(d: Sequence[float], n_b: Sequence[float], n_a: Sequence[float] = z) -> Pairs:
        return Pairs(np.array([d]), np.array([n_a]), np.array([n_b]))

    def leaning(excess: float) -> Pairs:
        """Two taut rings of wire 0.1 whose planes are so inclined that the one contact between them splits in two."""
        half = 0.5 * np.arccos(0.8 + excess)
        return pair([1.8, 0.0, 0.0], [0.0, -np.sin(half), np.cos(half)], [0.0, np.sin(half), np.cos(half)])

    slightly = [0.0, np.sin(1e-6), np.cos(1e-6)]
    return {
        "coaxial": (pair([0.0, 0.0, 0.7], z), 1),
        "identical": (pair([0.0, 0.0, 0.0], z), 1),
        "coplanar, apart": (pair([2.5, 0.0, 0.0], z), 1),
        "parallel planes, crossing projections": (pair([1.0, 0.0, 0.3], z), 2),
        "nearly parallel (1e-6 rad)": (pair([1.0, 0.0, 0.3], slightly), 2),
        "perpendicular through the centre": (pair([0.0, 0.0, 0.0], [0.0, 1.0, 0.0]), 2),
        "perpendicular and taut": (pair([1.8, 0.0, 0.0], [0.0, 1.0, 0.0]), 1),
        "just before two minima part": (leaning(-1e-3), 1),
        "just after": (leaning(1e-3), 2),
        "about to slip out": (pair([2.0 - 1e-6, 0.0, 0.0], [0.0, 1.0, 0.0]), 1),
    }


def circle_distance(pairs: Pairs, angle: Array) -> tuple[Array, Array]:
    """Distance (n, k) of the points of ring A at `angle` (n, k) to circle B, and the points (n, k, 3)."""
    e1, e2 = (e[:, None] for e in tangent_frame(pairs.n_a))
    point = np.cos(angle)[..., None] * e1 + np.sin(angle)[..., None] * e2
    seen = point - pairs.d[:, None]
    height = (seen * pairs.n_b[:, None]).sum(axis=2)
    flat = np.linalg.norm(seen - height[..., None] * pairs.n_b[:, None], axis=2)
    return np.hypot(height, flat - 1.0), point


def brute_force(pairs: Pairs, samples: int) -> Found:
    """The lowest of `samples` points of ring A in every valley, as they are."""
    angle = np.tile(2.0 * np.pi * np.arange(samples) / samples, (len(pairs.d), 1))
    f, point = circle_distance(pairs, angle)
    row, column = np.nonzero((f < np.roll(f, 1, axis=1)) & (f <= np.roll(f, -1, axis=1)))
    flat = np.setdiff1d(np.arange(len(f)), row)  # every point as near as any other
    row, column = np.concatenate([row, flat]), np.concatenate([column, np.zeros(len(flat), np.intp)])
    return _near(row, point[row, column], f[row, column])


def golden_section(pairs: Pairs, samples: int = 4096, rounds: int = 45) -> Found:
    """The valleys of `brute_force`, each narrowed by golden sections: no derivatives, nothing of `rve.contact`."""
    e1, e2 = tangent_frame(pairs.n_a)
    start = brute_force(pairs, samples)
    at = pairs.take(start.pair)
    angle = np.arctan2((start.point * e2[start.pair]).sum(axis=1), (start.point * e1[start.pair]).sum(axis=1))[:, None]
    low, high = angle - 2.0 * np.pi / samples, angle + 2.0 * np.pi / samples
    for _ in range(rounds):
        left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        falls = circle_distance(at, left)[0] > circle_distance(at, right)[0]
        low, high = np.where(falls, left, low), np.where(falls, high, right)
    distance, point = circle_distance(at, 0.5 * (low + high))
    return _near(start.pair, point[:, 0], distance[:, 0])


def newton(pairs: Pairs, samples: int = 48) -> Found:
    """`rve.contact.local_minima`, our default."""
    found = local_minima(pairs.d, pairs.n_a, pairs.n_b, 1.0, reach=REACH, samples=samples)
    return Found(found.pair, found.rho_a, found.distance)


def projection(pairs: Pairs, iterations: int) -> Found:
    """Alternating projection from the points of ring A nearest to and farthest from the other ring's centre."""
    ends = [
        alternating_projection(pairs.d, pairs.n_a, pairs.n_b, sign * pairs.d, max_iterations=iterations)
        for sign in (1.0, -1.0)
    ]
    apart = np.linalg.norm(ends[0].rho_a - ends[1].rho_a, axis=1) > 1e-4
    both = ends[0].joined(ends[1].take(apart))
    return _near(both.pair, both.rho_a, both.distance)


def _near(pair: NDArray[np.intp], point: Array, distance: Array) -> Found:
    keep = distance <= REACH
    return Found(pair[keep], point[keep], distance[keep])


def one_by_one(search: Search, pairs: Sequence[Pairs]) -> list[Found]:
    """The search called for every one of them on its own."""
    return [search(one) for one in pairs]


def score(found: Found, reference: Found) -> Score:
    """Each reference minimum takes the nearest point found for its pair within `SAME`; what is left over is wrong."""
    error, missed, used = 0.0, 0, np.zeros(len(found.pair), bool)
    lowest = np.full(reference.pair.max(initial=0) + 1, np.inf)
    np.minimum.at(lowest, reference.pair, reference.distance)
    deepest = 0
    order = np.argsort(found.pair, kind="stable")
    first = np.searchsorted(found.pair[order], np.arange(reference.pair.max(initial=0) + 2))
    for pair, point, distance in zip(reference.pair, reference.point, reference.distance, strict=True):
        mine = order[first[pair] : first[pair + 1]]
        mine = mine[~used[mine]]
        way = np.linalg.norm(found.point[mine] - point, axis=1)
        if not len(mine) or way.min() > SAME:
            missed += 1
            deepest += int(distance == lowest[pair])
            continue
        best = mine[np.argmin(way)]
        used[best] = True
        error = max(error, abs(float(found.distance[best] - distance)))
    error = error if missed < len(reference.pair) else float("nan")
    return Score(error, missed, deepest, len(reference.pair), int((~used).sum()))


def ladders(full: bool) -> dict[str, list[tuple[str, Search]]]:
    """Every method with its settings, coarse to fine."""
    brute = (32, 128, 512, 2048) + (8192,) * full
    return {
        "Newton": [(f"{n} samples", partial(newton, samples=n)) for n in (12, 24, 48, 96)],
        "projection": [(f"{n} iterations", partial(projection, iterations=n)) for n in (5, 20, 80, 400)],
        "brute force": [(f"{n} samples", partial(brute_force, samples=n)) for n in brute],
    }


def random_table(full: bool) -> tuple[Table, tuple[Curve, ...], dict[tuple[str, str], Score]]:
    """All methods on random linked pairs, one at a time and in a batch; scores by method and setting."""
    pairs = random_pairs(1000)
    reference = golden_section(pairs)
    some = [pairs.take([i]) for i in range(20)]
    rows, curves, scores = [], [], {}
    for name, ladder in ladders(full).items():
        x: list[float] = []
        y: list[float] = []
        for setting, search in ladder:
            found, seconds = least_seconds(partial(search, pairs))
            _, alone = least_seconds(partial(one_by_one, search, some))
            got = score(found, reference)
            batch, single = 1e6 * seconds / len(pairs.d), 1e6 * alone / len(some)
            counts = f"{got.missed} of {got.all}", got.deepest, got.wrong
            rows.append((name, setting, decade(got.error, 1e-13), *counts, batch, single))
            x, y, scores[name, setting] = [*x, max(got.error, 1e-16)], [*y, batch * 1e-6], got
        curves.append(Curve(name, tuple(x), tuple(y)))
    columns = (
        Column("method"),
        Column("setting"),
        Column("largest error of the gap / r1"),
        Column("minima missed"),
        Column("deepest of a pair missed", "d"),
        Column("wrong or twice", "d"),
        Column("us per pair in a batch of 1000", ".3g", timed=True),
        Column("us per pair alone", ".3g", timed=True),
    )
    ours = scores[DEFAULT]
    note = (
        f"Reference: {ours.all} minima by 4096 samples and golden sections; Newton's agree to "
        f"{decade(ours.error, 1e-13)} without sharing a line with them."
    )
    return Table("1000 random linked pairs", columns, tuple(rows), note), tuple(curves), scores


def degenerate_table() -> Table:
    """Found minima and error of the distance of each method on each degenerate pair."""
    searches = {
        "Newton": partial(newton, samples=48),
        "projection, 400 iterations": partial(projection, iterations=400),
        "brute force, 2048 samples": partial(brute_force, samples=2048),
    }
    rows = []
    for name, (pairs, count) in degenerate_pairs().items():
        lowest = float(golden_section(pairs, 20001).distance.min())
        cells = [f"{count} at {lowest:.6f}"]
        for search in searches.values():
            found = search(pairs)
            error = abs(float(found.distance.min()) - lowest) if len(found.distance) else float("nan")
            cells.append(f"{len(found.distance)}, {decade(error, 1e-12)}")
        rows.append((name, *cells))
    heads = ("pair", "minima, lowest distance", *(f"{name}: found, error" for name in searches))
    return Table("Degenerate pairs", tuple(Column(head) for head in heads), tuple(rows))


TEXT = f"""Rings as circles of radius 1. A contact search has to name **every** local minimum of the distance below
{REACH:g}: linked rings touch in two places. Newton samples ring A and polishes each valley with a second-order
iteration (`rve.contact`, the default); alternating projection is the paper's (`rve.projection`), from two starts; brute
force takes the lowest of the samples."""


def measure(full: bool) -> Section:
    """The section: random pairs, degenerate pairs."""
    table, curves, scores = random_table(full)
    degenerate = degenerate_table()
    right = sum(str(row[2]).split(",")[0] == str(row[1]).split()[0] for row in degenerate.rows)
    wrong = sum(str(row[3]).split(",")[0] != str(row[1]).split()[0] for row in degenerate.rows)
    ours, finer, theirs = (scores[key] for key in (DEFAULT, FINER, PAPERS))
    us = {(row[0], row[1]): float(str(row[6])) for row in table.rows}
    ratio = us[PAPERS] / us[DEFAULT]
    conclusion = (
        f"Newton's method is the default: it misses {ours.missed} of {ours.all} minima ({ours.deepest} times the "
        f"deepest of a pair; {finer.missed} with {FINER[1]}) and names {ours.wrong} that are none, at an error of "
        f"{decade(ours.error, 1e-13)}. Alternating projection from two starts misses {theirs.missed} and names "
        f"{theirs.wrong} wrongly at {ratio:.1f} times the time and an error of {decade(theirs.error, 1e-13)}: it "
        f"creeps where minima are about to merge. Of {len(degenerate.rows)} degenerate pairs Newton counts {right} "
        f"right, projection {len(degenerate.rows) - wrong}."
    )
    diagram = Diagram(
        "contact", "Gap of two rings: error against time", "largest error of a gap found / r1", "s per pair", curves
    )
    return Section("contact", "Contact search", TEXT, (table, degenerate), (diagram,), conclusion)
