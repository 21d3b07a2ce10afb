"""Section `contact`: error of the gap of two rings against time, for three contact searches."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.every_ring.brute import Array, frames, minima, to_circle
from benchmarks.frame import Diagram, Section, curves, table
from benchmarks.measure import Row, count_of, decade, ladder
from rve.common import Rows
from rve.geometry import are_linked, foot_on_circle, local_minima

REACH = 1.0
SAME = 0.1
"""A minimum of the reference counts as found if a point on ring A lies closer to it than this."""
ERROR, BATCH = "largest error of the gap / r1", "us per pair"


@dataclass(frozen=True)
class Pairs(Rows):
    """Circles of radius 1: centre of B seen from A, and the normals of both, (n, 3) each."""

    d: Array
    n_a: Array
    n_b: Array


@dataclass(frozen=True)
class Found:
    """Minima: pair (m,), point on ring A (m, 3), distance (m,)."""

    pair: NDArray[np.intp]
    point: Array
    distance: Array


Search = Callable[[Pairs], Found]


class Score(NamedTuple):
    """A search against the reference: largest error of a distance among the minima found, missed minima of `all`, pairs
    whose deepest minimum is missed, and points that are no minima or found twice.
    """

    error: float
    missed: int
    deepest: int
    all: int
    wrong: int


def random_pairs(count: int, seed: int = 7) -> Pairs:
    """Linked pairs as in a weave: centres in a plane, normals in all directions, circles at least 0.1 apart."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(8 * count, 3)) * np.array([1.2, 1.2, 0.0])
    n_a, n_b = rng.normal(size=(2, 8 * count, 3))
    n_a, n_b = (n / np.linalg.norm(n, axis=1)[:, None] for n in (n_a, n_b))
    linked = Pairs(d, n_a, n_b).take(np.flatnonzero(are_linked(d, n_a, n_b)))
    pair, _, distance = minima(linked.d, linked.n_a, linked.n_b)
    apart = np.setdiff1d(np.arange(len(linked.d)), pair[distance <= 0.1])
    if len(apart) < count:
        raise ValueError(f"only {len(apart)} of {count} pairs are apart: draw more")
    return linked.take(apart[:count])


def degenerate_pairs() -> dict[str, tuple[Pairs, int]]:
    """Pairs by name with their number of minima below `REACH`; 1 where all points are equally near."""
    z = [0.0, 0.0, 1.0]

    def pair(d: Sequence[float], n_b: Sequence[float], n_a: Sequence[float] = z) -> Pairs:
        return Pairs(np.array([d]), np.array([n_a]), np.array([n_b]))

    def leaning(excess: float) -> Pairs:
        """Two taut rings of wire 0.1; at `excess` = 0 of the cosine between their planes one contact splits in two."""
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


def brute_force(pairs: Pairs, samples: int, rounds: int = 0) -> Found:
    """The lowest of `samples` points of ring A in every valley, which `rounds` of golden sections narrow."""
    pair, angle, distance = minima(pairs.d, pairs.n_a, pairs.n_b, samples, rounds)
    e1, e2 = (e[pair] for e in frames(pairs.n_a))
    return _near(pair, np.cos(angle)[:, None] * e1 + np.sin(angle)[:, None] * e2, distance)


golden_section = partial(brute_force, samples=4096, rounds=45)
"""The reference: no derivatives, no code of `rve`."""


def newton(pairs: Pairs, samples: int = 48) -> Found:
    """`rve.geometry.ring_pair.local_minima`, the default."""
    found = local_minima(pairs.d, pairs.n_a, pairs.n_b, reach=REACH, samples=samples)
    return Found(found.pair, found.rho_a, found.distance)


def projection(pairs: Pairs, iterations: int) -> Found:
    """Alternating projection, as in the paper (Fig. 7), from the points of ring A nearest to and farthest from the
    other ring's centre. Each ends in *one* local minimum; the contraction factor tends to 1 where two minima merge.
    """
    d, n_a, n_b = np.tile(pairs.d, (2, 1)), np.tile(pairs.n_a, (2, 1)), np.tile(pairs.n_b, (2, 1))
    on_a = foot_on_circle(np.concatenate([pairs.d, -pairs.d]), n_a)
    todo = np.arange(len(d))
    for _ in range(iterations):
        on_b = d[todo] + foot_on_circle(on_a[todo] - d[todo], n_b[todo])
        new = foot_on_circle(on_b, n_a[todo])
        moved = np.linalg.norm(new - on_a[todo], axis=1)
        on_a[todo] = new
        todo = todo[moved > 1e-12]
    distance = to_circle(on_a, d, n_b, 1.0)
    first, second = np.split(on_a, 2)
    once = np.append(np.ones(len(first), bool), np.linalg.norm(first - second, axis=1) > 1e-4)
    return _near(np.tile(np.arange(len(first)), 2)[once], on_a[once], distance[once])


def _near(pair: NDArray[np.intp], point: Array, distance: Array) -> Found:
    keep = distance <= REACH
    return Found(pair[keep], point[keep], distance[keep])


def score(found: Found, reference: Found) -> Score:
    """Each reference minimum takes the nearest point found for its pair within `SAME`; points left over are wrong."""
    error, missed, deepest, used = 0.0, 0, 0, np.zeros(len(found.pair), bool)
    lowest = np.full(reference.pair.max(initial=0) + 1, np.inf)
    np.minimum.at(lowest, reference.pair, reference.distance)
    for pair, point, distance in zip(reference.pair, reference.point, reference.distance, strict=True):
        mine = np.flatnonzero((found.pair == pair) & ~used)
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


def searches(full: bool) -> dict[str, dict[str, Search]]:
    """Every method with its settings, coarse to fine."""
    brute = (32, 128, 512, 2048) + (8192,) * full
    return {
        "Newton": {f"{n} samples": partial(newton, samples=n) for n in (12, 24, 48, 96)},
        "projection": {f"{n} iterations": partial(projection, iterations=n) for n in (5, 20, 80, 400)},
        "brute force": {f"{n} samples": partial(brute_force, samples=n) for n in brute},
    }


def random_rows(full: bool) -> list[Row]:
    """All methods on random linked pairs."""
    pairs = random_pairs(1000)
    reference = golden_section(pairs)

    def judge(found: Found, seconds: float) -> Row:
        got = score(found, reference)
        row: Row = {ERROR: got.error, "minima missed": f"{got.missed} of {got.all}"}
        row |= {"deepest of a pair missed": got.deepest, "wrong or twice": got.wrong}
        each = seconds / len(pairs.d)
        return row | {BATCH: 1e6 * each, "_error": max(got.error, 1e-16), "_s": each}

    rows: list[Row] = []
    for name, settings in searches(full).items():
        rows += ladder(name, {setting: partial(search, pairs) for setting, search in settings.items()}, judge)
    return rows


def degenerate_rows() -> list[Row]:
    """Found minima and error of the distance of each method on each degenerate pair."""
    every, rows = searches(full=False), []
    chosen = {"Newton": "48 samples", "projection": "400 iterations", "brute force": "2048 samples"}
    for name, (pairs, count) in degenerate_pairs().items():
        lowest = float(golden_section(pairs, samples=20001).distance.min())
        row: Row = {"pair": name, "minima, lowest distance": f"{count} at {lowest:.6f}"}
        for method, setting in chosen.items():
            found = every[method][setting](pairs)
            error = abs(float(found.distance.min()) - lowest) if len(found.distance) else float("nan")
            row[f"{method}, {setting}: found, error"] = f"{len(found.distance)}, {decade(error)}"
            row[f"_{method}"] = len(found.distance) == count
        rows.append(row)
    return rows


TEXT = f"""Rings as circles of radius 1. A contact search has to find **every** local minimum of the distance below
{REACH:g}: linked rings touch in two places. Newton (`rve.geometry.ring_pair`, the default) samples ring A and refines
each valley; alternating projection is the paper's, from two starts; brute force takes the lowest samples."""


def measure(full: bool) -> Section:
    """The section: random pairs, degenerate pairs."""
    rows, named = random_rows(full), degenerate_rows()
    ours, theirs = rows[2], rows[7]
    conclusion = (
        f"Newton's method is the default: it misses {ours['minima missed']} minima and finds {ours['wrong or twice']} "
        f"that are none, at an error of {decade(ours[ERROR], 1e-13)}. Alternating projection from two starts misses "
        f"{theirs['minima missed']} and finds {theirs['wrong or twice']} wrong ones at "
        f"{theirs[BATCH] / ours[BATCH]:.1f} times the time and an error of {decade(theirs[ERROR], 1e-13)}. Newton "
        f"counts the minima of {count_of([row['_Newton'] for row in named])} degenerate pairs correctly, projection "
        f"those of {count_of([row['_projection'] for row in named])}."
    )
    title = "Gap of two rings: error against time"
    every = curves(rows, "method", "_error", "_s")
    diagram = Diagram("contact", title, "largest error of a gap found / r1", "s per pair", every)
    note = "Reference: minima by 4096 samples and golden sections, which share no code with Newton's search."
    forms = {ERROR: "decade 1e-13", BATCH: ".3g"}
    tables = (table("1000 random linked pairs", rows, forms, note), table("Degenerate pairs", named))
    return Section("Contact search", TEXT, tables, (diagram,), conclusion)
