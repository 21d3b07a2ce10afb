"""The largest pitch, bar or wind, or the thinnest wire, with which a curtain holds with a factor that is asked for.

Factors go nearly as a power of what is varied. So values are searched on logarithmic scales, in pairs around the place
where the line through the two best answers crosses the factor, until the last value that holds and the next one, which
does not, are `WIDTH` apart. A large mesh is searched after a coarser one, which says where to begin and which
combinations of loads may govern there. The last value that holds does so under all of them.
"""

import math
import os
from bisect import bisect_left
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from macro_fem.demand import OnDemand
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.scene import Scene
from macro_fem.scene.shapes import MeshFile
from macro_fem.scene.support_kinds import Hanging
from macro_fem.trials import VARIED, Row, Sought, Trials, Who, own_numbers, varied
from rve.common import (
    Array,
    InputError,
    JsonObject,
    checked,
    csv_text,
    digits,
    job,
    noted_if_stopped,
    shown,
    write_text,
)
from rve.common.commands.sweeps import workers
from rve.common.drawing.plane import BLUE, VERMILION, new_axes, save_figure
from rve.common.typed import not_one_of

WIDTH, COARSE_WIDTH = 5e-3, 5e-2
"""Distance of the last value that holds and the next one over the value; on a coarser mesh, which only guides."""
FEWEST, PER_DECADE, MOST_ROUNDS = 5, 2, 20
"""Values of the first round, at least and in each power of ten, and most rounds of one or two after it."""
NEAR = 20.0
"""An answer this many widths from where the curve crosses says where, well enough to try both sides of the place."""
LARGE, LEAST_COARSE = 48, 16
"""Cells along the width from which a coarser mesh guides the search, and the fewest of that mesh."""
KEPT = ".size"
"""Folder of answers inside that of the result."""
Uses = dict[float, float]
"""Logarithm of asked over found factor by value: at most 0 where it holds, inf where there is no answer."""


@dataclass(frozen=True)
class Range:
    """Values from `low` to `high`, or only those of the `grid`; from -log or log on, curtains hold less along it."""

    low: float
    high: float
    grid: tuple[float, ...] = ()
    sign: float = 1.0

    @property
    def ends(self) -> tuple[float, float]:
        """The first value, and the last one, that of the largest load."""
        low, high = (self.grid[0], self.grid[-1]) if self.grid else (self.low, self.high)
        return (low, high) if self.sign > 0.0 else (high, low)

    def way(self, value: float) -> float:
        """Where a value is along the range."""
        return self.sign * math.log(value)

    def first_round(self) -> list[float]:
        """Values of the first round, even in their logarithms."""
        first, last = map(self.way, self.ends)
        number = max(FEWEST, 1 + math.ceil(PER_DECADE * (last - first) / math.log(10.0)))
        places = np.linspace(first, last, number).tolist()
        values = {self.ends[0]: 0, self.ends[1]: 0} | {self.value(at): 0 for at in places[1:-1]}
        return sorted(values, key=self.way)

    def around(self, at: float, width: float, left: float, right: float) -> list[float]:
        """Two values around a place, less than `width` apart, that lie between the places `left` and `right`."""
        if self.grid:
            between = sorted((v for v in self.grid if left < self.way(v) < right), key=self.way)
            k = bisect_left(between, at, key=self.way)
            return between[max(k - 1, 0) : k + 1]
        both = {self.value(at + part * math.log1p(width)) for part in (-0.35, 0.35)}
        return sorted((v for v in both if left < self.way(v) < right), key=self.way)

    def value(self, at: float) -> float:
        """The value at a place, of four digits or of the grid, inside the range."""
        first, last = map(self.way, self.ends)
        value = math.exp(self.sign * min(max(at, first), last))
        if self.grid:
            return min(self.grid, key=lambda one: abs(math.log(one / value)))
        rounded = float(f"{value:.4g}")
        return min(max(rounded, self.low), self.high)


def bracket(uses: Uses, span: Range) -> tuple[float | None, float | None]:
    """The last value that holds, and the first one after it that does not; None where there is none."""
    order = sorted(uses, key=span.way)
    good = next((value for value in reversed(order) if uses[value] <= 0.0), None)
    beyond = [value for value in order if good is None or span.way(value) > span.way(good)]
    return good, next(iter(beyond), None)


def search(
    use: Callable[[Sequence[float]], Uses],
    span: Range,
    first: Sequence[float] = (),
    width: float = WIDTH,
    guide: Uses | None = None,
) -> tuple[float | None, float | None]:
    """`bracket` of all values that `use`, which answers for more of them, is asked for, beginning with `first`, until
    its ends are `width` apart or neighbours of the grid, or one of them is the end of the range.

    guide: uses on a coarser mesh, whose curve, shifted and tilted, is followed instead of a straight line.
    """
    uses, gaps = use(first), [math.inf, math.inf]
    for _ in range(MOST_ROUNDS):
        good, bad = bracket(uses, span)
        gaps.append(math.inf if good is None or bad is None else span.way(bad) - span.way(good))
        if not (values := _next_values(uses, span, width, guide, is_slow=gaps[-1] > 0.5 * gaps[-3])):
            break
        uses = use(values)
    return bracket(uses, span)


def _next_values(uses: Uses, span: Range, width: float, guide: Uses | None, *, is_slow: bool) -> list[float]:
    """What to try next: where the curve through the answers crosses 0, and, if one is near, on both sides of this
    place; or the end of the range that it does not reach; none at the end of the search.

    is_slow: two rounds have hardly brought the ends closer, so thirds of the way between them are tried.
    """
    (good, bad), (first, last) = bracket(uses, span), span.ends
    if good == last or (good is None and first in uses):
        return [] if good == last else _peak(uses, span, width)
    left = span.way(first if good is None else good)
    right = span.way(last if bad is None else bad)
    if good is not None and bad is not None:
        if right - left <= math.log1p(width):
            return []
        if is_slow and not span.grid:
            return [v for part in (1 / 3, 2 / 3) for v in span.around(left + part * (right - left), 0.0, left, right)]
    known = sorted((span.way(value), log) for value, log in uses.items() if log < math.inf)
    at, distance = 0.5 * (left + right), math.inf
    if known:
        curve = _curve(known, span, guide, places := np.linspace(left, right, 401))
        crossings = np.flatnonzero((curve[:-1] <= 0.0) & (curve[1:] > 0.0))
        if len(crossings):
            k = crossings[-1 if good is None else 0]
            at = float(places[k] - curve[k] * (places[k + 1] - places[k]) / (curve[k + 1] - curve[k]))
            distance = min(abs(place - at) for place, _ in known)
        elif (is_end := bad is None and curve[0] <= 0.0) or (good is None and curve[0] > 0.0):
            return [last if is_end else first]
    return span.around(at, width if distance < NEAR * width else 0.0, left, right)


def _curve(known: Sequence[tuple[float, float]], span: Range, guide: Uses | None, places: Array) -> Array:
    """log use at places along the range: that of a coarser mesh, else of a load whose factor is one over it, and what
    the known answers differ by, monotone between them and straight beyond."""
    coarse = sorted((span.way(value), log) for value, log in (guide or {}).items() if log < math.inf)

    def shape(at: Array) -> Array:
        if len(coarse) < 2:
            return at
        return np.asarray(PchipInterpolator(*np.transpose(coarse))(np.clip(at, coarse[0][0], coarse[-1][0])))

    place, log = np.transpose(known)
    shift = log - shape(place)
    curve = shape(places) + (
        shift[0] if len(known) == 1 else PchipInterpolator(place, shift, extrapolate=False)(places)
    )
    for end, beyond in ((0, places < place[0]), (-1, places > place[-1])):
        far = np.flatnonzero(np.abs(place - place[end]) > 2.0 * WIDTH)  # two that are close tell no slope
        other = far[end] if len(far) else end
        slope = (shift[other] - shift[end]) / (place[other] - place[end]) if len(far) else 0.0
        curve[beyond] = shape(places[beyond]) + shift[end] + slope * (places[beyond] - place[end])
    return np.asarray(curve)


def _peak(uses: Uses, span: Range, width: float) -> list[float]:
    """Where nothing holds, the place between answers at which the parabola through the best three says that it may."""
    order = sorted(uses, key=span.way)
    best = min(range(len(order)), key=lambda k: uses[order[k]])
    three = order[max(best - 1, 0) : best + 2]
    if len(three) < 3 or not all(uses[value] < math.inf for value in three):
        return []
    a, b, c = np.polyfit([span.way(value) for value in three], [uses[value] for value in three], 2)
    at = -0.5 * b / a if a > 0.0 else math.nan
    left, right = span.way(three[0]), span.way(three[2])
    is_far = all(abs(span.way(value) - at) > math.log1p(width) for value in three)
    return span.around(at, width, left, right) if left < at < right and is_far and c + 0.5 * b * at <= 0.0 else []


@dataclass(frozen=True)
class Size:
    """The largest `value` of what is varied, of r2 the least, where the factor is at least the one asked for, and what
    the `next` one has; None where none holds, or the end of the range does. `curve`: all values that were tried, in
    order; `estimates`: those on a coarser mesh. `note`: why rings are not judged, or judged too well, why the next
    value has no answer, and which smaller ones do not hold.
    """

    vary: str
    value: float | None
    safety_factor: float | None
    factor: float | None
    weakest: str | None
    factor_asked: float
    curve: tuple[Row, ...]
    note: str | None = None
    governing_combination: str | None = None
    next_value: float | None = None
    next_factor: float | None = None
    searched: tuple[float, float] = (0.0, 0.0)
    estimates: tuple[Row, ...] = ()

    def __str__(self) -> str:
        unit, asked, (low, high) = f" {varied(self.vary)[0]}".rstrip(), f"a factor {self.factor_asked:g}", self.searched
        if self.value is None:
            return f"no {self.vary} from {low:g} to {high:g} holds with {asked}: {_why_none(self.curve)}"
        under = f" under {self.governing_combination}" if self.governing_combination else ""
        held = f"{digits(self.factor or 0.0, 4)} ({self.weakest}{under})"
        text = f"{self.vary} = {self.value:.6g}{unit}"
        if self.next_value is None:
            way = f"{'down' if self.vary == 'r2' else 'up'} to {self.value:.6g}"
            every = " holds" if self.failing else f": all values {way} hold"
            return f"{text}, the end of the range{every} with {asked}: {held}"
        after = "no answer" if self.next_factor is None else digits(self.next_factor, 4)
        return f"{text} is the last that holds with {asked}: {held}; {self.next_value:.6g}{unit}: {after}"

    @property
    def failing(self) -> list[Row]:
        """What does not hold although the `value` does, which needs more: known on this mesh, or clear on a coarser
        one."""
        sign, most = -1.0 if self.vary == "r2" else 1.0, self.factor_asked
        rows = [row for row in self.curve if (row.factor or 0.0) < most]
        # Share by which a factor on the coarser mesh must be less than the one asked for to tell that a value does
        # not hold. Larger: fewer values are told; smaller: errors of that mesh are told as values that do not hold.
        rows += [row for row in self.estimates if 1.25 * (row.factor or 0.0) < most]
        return [row for row in rows if self.value is not None and sign * row.value < sign * self.value]

    @checked
    def save(self, folder: str | Path, *, picture: bool = True) -> JsonObject:
        """Write size.json and size.csv into `folder`, then size.png; the record."""
        record = asdict(self)
        with job(folder, "size.json", record) as staged:
            write_text(staged / "size.csv", csv_of(self.vary, self.curve))
        if picture:
            with job(folder, "size.json", record, adds=True) as staged:
                _draw(staged / "size.png", self)
        return record


def csv_of(vary: str, rows: Sequence[Row]) -> str:
    """The table of rows, whose first column is what is varied, with its unit."""
    names = ["_".join(filter(None, [vary, varied(vary)[0].replace("/", "_per_")])), *list(Row.__dataclass_fields__)[1:]]
    return csv_text(names, (asdict(row).values() for row in rows))


def _why_none(rows: Sequence[Row]) -> str:
    """What the answers say where no value holds."""
    most = max(rows, key=lambda row: row.factor or 0.0)
    if not most.factor:
        return most.status
    unsolved = [row for row in rows if row.factor is None]
    more = f"; {len(unsolved)} values have no answer ({unsolved[0].value:g}: {unsolved[0].status})" if unsolved else ""
    return f"the largest factor is {digits(most.factor)}, at {most.value:g}{more}"


@checked
def largest_that_holds(scene: Scene, who: Who, vary: str, ends: tuple[float, float], factor: float) -> Size:
    """The largest value of `vary` between both `ends` at which the factor of the curtain is at least `factor`; the
    least one of r2, since thicker wire costs more and loads hooks more.

    A pitch has only values that divide the edge. A value without an answer does not hold. For r2 `who` is an
    `OnDemand`, of whose rings a table is made with each wire. InputError for a quantity that the scene has not, ends
    out of order, and where no value holds.
    """
    found = find_size(Sought(scene, who, vary, factor), ends)
    if found.value is None:
        scene.refuse(str(found))
    return found


def find_size(
    sought: Sought,
    ends: tuple[float, float],
    *,
    out: Path | None = None,
    jobs: int | None = 1,
    cluster: str | None = None,
) -> Size:
    """`largest_that_holds`, with `value` None where none does. out: a folder where each answer is kept as it comes, in
    size.csv too, and from which the same search goes on; jobs: processes, None for one a core where the mesh is large;
    cluster: address of a Dask scheduler, whose workers solve instead.
    """
    (low, high), vary = ends, sought.vary
    if not 0.0 < low < high < np.inf:
        raise InputError(f"--from = {low:g}, --to = {high:g}: give two positive values, the smaller one first")
    if not 0.0 < sought.factor < np.inf:
        raise InputError(f"--factor = {sought.factor:g}: must be positive")
    _check(sought)
    grid = _pitches(sought, low, high) if vary == "pitch" else ()
    span = Range(low, high, grid, -1.0 if vary == "r2" else 1.0)
    first: Sequence[float] = span.first_round()
    cells, note = _coarser(sought), "give --out FOLDER to keep the answers"
    if out is not None:
        note = f"what is answered is kept in {out}, and the same command goes on from there"
    trials = Trials(sought, None if out is None else out / KEPT)
    if out is not None:
        trials.on_answer = lambda: write_text(out / "size.csv", csv_of(vary, trials.rows))
    jobs = jobs or (os.cpu_count() or 1 if cells and cluster is None else 1)
    with (
        noted_if_stopped(note),
        workers(jobs, cluster) if jobs > 1 or cluster is not None else nullcontext() as trials.pool,
    ):
        trials.planned, guide = 3, None
        if cells:
            trials.guide = Trials(replace(sought, cells=cells), trials.folder, trials.pool, planned=6)
            first, guide = _guided(trials.guide, span, first), trials.guide.use(())
        while True:
            good, bad = search(trials.use, span, first, guide=guide)
            first = ()
            if good is None or not trials.ask([(good, case) for case in sought.cases]):
                return _size_of(trials, span, good, bad)


def _guided(guide: Trials, span: Range, first: Sequence[float]) -> Sequence[float]:
    """Where to begin after a search on a coarser mesh: where its curve crosses, or at its best value."""
    good, bad = search(guide.use, span, first, COARSE_WIDTH)
    uses = guide.use(())
    if min(uses.values()) == math.inf:
        return first
    if good is None or bad is None or uses[bad] == math.inf:
        return [good or min(uses, key=lambda value: uses[value])]
    part = uses[good] / (uses[good] - uses[bad])
    return [span.value((1.0 - part) * span.way(good) + part * span.way(bad))]


def _size_of(trials: Trials, span: Range, good: float | None, bad: float | None) -> Size:
    """The record of a search that ended between two values."""
    sought, rows = trials.sought, {row.value: row for row in trials.rows}
    estimates = () if trials.guide is None else tuple(trials.guide.rows)
    size = Size(sought.vary, good, None, None, None, sought.factor, tuple(trials.rows))
    size = replace(size, searched=(span.low, span.high), estimates=estimates)
    if good is None:
        return size
    row, notes = rows[good], list[str | None]()
    alone = f"the factor is that of hooks or runners alone, the strength of the mesh is not known: {row.strength_note}"
    notes.append(row.utilisation_too_low if row.strength_note is None else alone)
    if bad is not None:
        if rows[bad].factor is None:
            notes.append(f"{sought.vary} = {bad:.6g} has no answer: {rows[bad].status}")
        size = replace(size, next_value=bad, next_factor=rows[bad].factor)
    if size.failing:
        least = min(size.failing, key=lambda one: one.factor or 0.0)
        side = "larger" if sought.vary == "r2" else "smaller"
        told = f"a factor {digits(least.factor)}" if least.factor else "no answer"
        notes.append(f"{side} values do not all hold: {least.value:.6g} has {told}")
    kept = {key: vars(row)[key] for key in ("factor", "safety_factor", "weakest", "governing_combination")}
    return replace(size, note="; ".join(filter(None, notes)) or None, **kept)


def _coarser(sought: Sought) -> int | None:
    """Cells along the width of a coarser mesh that guides the search, with a node for every hook; None without one."""
    scene, cells = sought.scene, sought.scene.mesh.cells
    if isinstance(scene.curtain, MeshFile) or scene.solver.is_bounded or isinstance(sought.who, OnDemand):
        return None
    width = float(np.ptp(scene.curtain.corners(cells)[:, 0]))
    hooks = [one.spaces(width) for one in scene.of(Hanging) if one.has_hooks and sought.vary != "pitch"]
    coarse = max(cells // 3, LEAST_COARSE, *hooks)
    return coarse if cells >= LARGE and cells >= 2 * coarse else None


def _pitches(sought: Sought, low: float, high: float) -> tuple[float, ...]:
    """The pitches from `low` to `high` that divide the longest line of the first row of hooks, in order."""
    length = next(iter(build_mesh(sought.at(high), None).hooks.values())).length
    counts = range(int(np.floor(length / low * (1.0 + 1e-9))), int(np.ceil(length / high * (1.0 - 1e-9))) - 1, -1)
    pitches = tuple(length / count for count in counts if count > 0)
    if not pitches:
        raise InputError(f"no pitch from {low:g} to {high:g} mm divides the edge of {length:g} mm: widen the range")
    return pitches


def _check(sought: Sought) -> None:
    """InputError for what is not there to be varied."""
    scene, vary = sought.scene, sought.vary
    if scene.motion is not None:
        scene.refuse("[motion]: is for a curtain over time, which is not sized")
    keys = [*VARIED, *sorted(set[str]().union(*map(own_numbers, scene.items)))]
    if vary not in keys:
        raise InputError(f"--vary = {shown(vary)}: {not_one_of(vary, keys)}")
    _, what, has = varied(vary)
    if vary == "r2":
        if not isinstance(sought.who, OnDemand):
            raise InputError("--vary r2: needs the rings, by --cell R1,R2, since a law is of one wire")
    elif not any(map(has, scene.items)):
        scene.refuse(f"--vary {vary}: the scene has no {what}")


def _draw(path: Path, size: Size) -> None:
    """The factor over the value, both on logarithmic scales where they span much."""
    ax, (unit, *_) = new_axes(6.4, 4.0), varied(size.vary)
    marks = (
        (size.estimates, "o--", "#9aa3b2", "on a coarser mesh"),
        (size.curve, "o-", BLUE, "on the mesh of the scene"),
    )
    for rows, style, colour, label in marks:
        known = [(row.value, row.factor) for row in rows if row.factor is not None]
        if known:
            ax.plot(*np.transpose(known), style, color=colour, ms=4, label=label)
    ax.axhline(size.factor_asked, color=VERMILION, lw=1.0, label=f"factor {size.factor_asked:g}")
    if size.value is not None:
        ax.axvline(
            size.value, color="#717581", lw=1.0, ls="--", label=f"{size.vary} = {size.value:.6g} {unit}".rstrip()
        )
    if size.searched[1] > 10.0 * size.searched[0]:
        ax.set(xscale="log", yscale="log")
    else:
        ax.set_ylim(bottom=0.0)
    ax.set(xlabel=f"{size.vary} ({unit})".removesuffix(" ()"), ylabel="factor until the first link gives")
    ax.legend(frameon=False)
    ax.grid(alpha=0.3)
    save_figure(path, ax.figure)
