"""The largest pitch, bar or wind, or the thinnest wire, with which a curtain holds with a factor that is asked for."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from homogenize import LawInterval, MembraneLaw, fit
from macro_fem.demand.rings import OnDemand
from macro_fem.job import solve
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.scene import Scene
from macro_fem.scene.shapes import Rectangle
from macro_fem.scene.tables import Bar, Item, Wind
from rve import solve_table
from rve.common import InputError, checked, csv_text, digits, job, part_of, shown, write_text
from rve.common.drawing.plane import new_axes, save_figure
from rve.common.typed import not_one_of
from rve.wire import with_rings

VARIED: dict[str, tuple[str, str, Callable[[Item], bool]]] = {
    "pitch": ("mm", "hooks or runners", lambda item: bool(getattr(item, "has_hooks", False))),
    "mass": ("kg", "bar", lambda item: isinstance(item, Bar)),
    "speed": ("m/s", "wind with a speed", lambda item: isinstance(item, Wind) and item.speed is not None),
    "r2": ("mm", "wire of rings", lambda item: False),
}
"""What may be varied: its unit, and what of a scene has it."""
COARSE, MOST = 5, 12
"""Values of the first round, and most values between the last one of them that holds and the next."""
CLOSE = 2e-3
"""A factor this close above the one asked for, or a gap between values of this part of the range, ends the search."""
RINGS_NOT_JUDGED = (
    "the law does not tell the strength of rings, so that the factor is that of hooks or runners alone: make the table "
    "with rve table --rings, in Python rve.with_rings(table, cell), and fit it again"
)


@dataclass(frozen=True)
class Row:
    """One value that was tried, and how the solver ended; `factor` is the least of all links, rings and hooks,
    `safety_factor` that of the rings alone, too large where `utilisation_too_low` says why."""

    value: float
    factor: float | None
    safety_factor: float | None
    weakest: str | None
    status: str
    utilisation_too_low: str | None = None


@dataclass(frozen=True)
class Size:
    """The largest `value` of what is varied, of r2 the least, where the factor is at least the one asked for; `curve`:
    all values that were tried, in order; `note`: why rings are not judged, or judged too well, or why
    the next value has no answer."""

    vary: str
    value: float
    safety_factor: float | None
    factor: float
    weakest: str | None
    factor_asked: float
    curve: tuple[Row, ...]
    note: str | None = None

    def __str__(self) -> str:
        text = f"{self.vary} = {self.value:.6g} {VARIED[self.vary][0]} is the last that holds with a factor"
        return f"{text} {self.factor_asked:g}: {digits(self.factor)} ({self.weakest})"

    @checked
    def save(self, folder: str | Path, *, picture: bool = True) -> dict[str, Any]:
        """Write size.json, size.csv and size.png into `folder`; the record."""
        record = asdict(self)
        with job(folder, "size.json", record) as staged:
            rows = record["curve"]
            value = f"{self.vary}_{VARIED[self.vary][0].replace('/', '_per_')}"
            write_text(staged / "size.csv", csv_text([value, *list(rows[0])[1:]], (row.values() for row in rows)))
            if picture:
                _draw(staged / "size.png", self)
        return record


@checked
def largest_that_holds(
    scene: Scene, who: MembraneLaw | LawInterval | OnDemand | None, vary: str, ends: tuple[float, float], factor: float
) -> Size:
    """The largest value of `vary` between both `ends` at which the factor of the curtain is at least `factor`; the
    least one of r2, since thicker wire costs more and loads hooks more.

    A pitch has only values that divide the edge. The factor is taken to cross `factor` once between two values of the
    first round, which are spread evenly. A value without an answer does not hold. For r2 `who` is an `OnDemand`, of
    whose rings a table is made with each wire. InputError for a quantity that the scene has not, ends out of order, and
    where no value holds.
    """
    low, high = ends
    if not 0.0 < low < high < np.inf:
        raise InputError(f"--from = {low:g}, --to = {high:g}: give two positive values, the smaller one first")
    if not 0.0 < factor < np.inf:
        raise InputError(f"--factor = {factor:g}: must be positive")
    _check(scene, who, vary)
    is_pitch = vary == "pitch"
    values = _pitches(scene, low, high) if is_pitch else np.linspace(low, high, COARSE).tolist()
    rows: dict[float, Row] = {}

    def use(value: float) -> float:
        """Asked over found factor: at most 1 where the curtain holds, inf where there is no answer."""
        if value not in rows:
            with part_of(f"{vary} = {value:.6g}"):
                rows[value] = _row(scene, who, vary, value)
        return np.inf if (known := rows[value].factor) is None else factor / known

    best = search(use, values[::-1] if vary == "r2" else values, between=not is_pitch)
    if best is None:
        most = max(rows.values(), key=lambda row: row.factor or 0.0)
        why = f"the largest factor is {digits(most.factor)}, at {most.value:g}" if most.factor else most.status
        unsolved = [row for row in rows.values() if row.factor is None]
        if most.factor and unsolved:
            why += f"; {len(unsolved)} values have no answer ({unsolved[0].value:g}: {unsolved[0].status})"
        scene.refuse(f"no {vary} from {low:g} to {high:g} holds with a factor {factor:g}: {why}")
    found = rows[best]
    assert found.factor is not None
    tried = sorted(rows, reverse=vary == "r2")
    beyond = [rows[value] for value in tried[tried.index(best) + 1 :]]
    note = RINGS_NOT_JUDGED if found.safety_factor is None else found.utilisation_too_low
    if not note and beyond and beyond[0].factor is None:
        note = f"{vary} = {beyond[0].value:g} has no answer: {beyond[0].status}"
    curve = tuple(rows[value] for value in sorted(rows))
    return Size(vary, best, found.safety_factor, found.factor, found.weakest, factor, curve, note)


def search(use: Callable[[float], float], values: Sequence[float], *, between: bool) -> float | None:
    """The last of `values`, in order, with a use of at most 1, None if none has, by halving; or one `between` them, by
    interpolation, as the use is nearly linear in what is varied."""
    few = range(len(values)) if between else np.unique(np.linspace(0, len(values) - 1, COARSE).round().astype(int))
    good = [int(k) for k in few if use(values[k]) <= 1.0]
    if not good or good[-1] == len(values) - 1:
        return values[good[-1]] if good else None
    first = good[-1], next(int(k) for k in few if k > good[-1])
    if not between:
        return values[bisect_right(range(len(values)), 1.0, *first, key=lambda k: use(values[k])) - 1]
    low, high = (values[k] for k in first)
    for _ in range(MOST):
        if use(low) > 1.0 - CLOSE or abs(high - low) < CLOSE * abs(values[-1] - values[0]):
            break
        # Aimed a little below 1, so that the values that are tried end on the side that holds.
        way = (1.0 - 0.5 * CLOSE - use(low)) / (use(high) - use(low)) if use(high) < np.inf else 0.5
        value = low + (high - low) * min(max(way, 0.05), 0.95)
        low, high = (value, high) if use(value) <= 1.0 else (low, value)
    return low


def _pitches(scene: Scene, low: float, high: float) -> list[float]:
    """The pitches from `low` to `high` that divide the longest line of the first row of hooks, in order."""
    length = next(iter(build_mesh(_changed(scene, "pitch", high), None).hooks.values())).length
    counts = range(int(np.floor(length / low * (1.0 + 1e-9))), int(np.ceil(length / high * (1.0 - 1e-9))) - 1, -1)
    found = [length / count for count in counts if count > 0]
    if not found:
        raise InputError(f"no pitch from {low:g} to {high:g} mm divides the edge of {length:g} mm: widen the range")
    return found


def _check(scene: Scene, who: Any, vary: str) -> None:
    """InputError for what is not there to be varied."""
    if scene.motion is not None:
        scene.refuse("[motion]: is for a curtain over time, which is not sized")
    if vary not in VARIED:
        raise InputError(f"--vary = {shown(vary)}: {not_one_of(vary, VARIED)}")
    _, what, has = VARIED[vary]
    if vary == "r2":
        if not isinstance(who, OnDemand):
            raise InputError("--vary r2: needs the rings, by --rings R1,R2, since a law is of one wire")
    elif not any(map(has, scene.items)):
        scene.refuse(f"--vary {vary}: the scene has no {what}")


def _row(scene: Scene, who: Any, vary: str, value: float) -> Row:
    try:
        if vary == "r2":
            cell = replace(who.cell, r2=value)
            who = fit(with_rings(solve_table(cell), cell)).law
        else:
            scene = _changed(scene, vary, value)
        told = solve(scene, who).summary
    except InputError as error:
        return Row(value, None, None, None, str(error))
    if told["status"] != "converged":
        return Row(value, None, None, None, str(told["message"]))
    worst = told.get("envelope", told)
    if (factor := worst["weakest_factor"]) is None:
        unknown = f"the strength of the rings is not known: {told['strength_note']}"
        return Row(value, None, None, None, unknown if told["utilisation_max"] is None else "there is no load")
    return Row(value, factor, worst["safety_factor"], worst["weakest"], "converged", worst["utilisation_too_low"])


def _changed(scene: Scene, vary: str, value: float) -> Scene:
    """The scene with the value in every part that has it."""
    has = VARIED[vary][2]
    changes: Any = {vary: value} | ({"count": None} if vary == "pitch" else {})
    items: list[Any] = list(scene.items)
    mesh = scene.mesh
    if vary == "pitch" and isinstance(scene.curtain, Rectangle):  # hooks are nodes of the mesh
        mesh = replace(mesh, cells=max(mesh.cells, int(np.ceil(scene.curtain.width / value))))
    return replace(scene, mesh=mesh, items=tuple(replace(item, **changes) if has(item) else item for item in items))


def _draw(path: Path, size: Size) -> None:
    """The factor over the value."""
    ax, (unit, *_) = new_axes(6.4, 4.0), VARIED[size.vary]
    known = [(row.value, row.factor) for row in size.curve if row.factor is not None]
    ax.plot(*np.transpose(known), "o-", color="#1f3a5f", ms=4)
    ax.axhline(size.factor_asked, color="#bd1f01", lw=1.0, label=f"factor {size.factor_asked:g}")
    ax.axvline(size.value, color="#717581", lw=1.0, ls="--", label=f"{size.vary} = {size.value:.6g} {unit}")
    top = 1.1 * max(size.factor_asked, *(factor for _, factor in known))
    ax.set(xlabel=f"{size.vary} ({unit})", ylabel="factor until the first link gives", ylim=(0.0, top))
    ax.legend(frameon=False)
    ax.grid(alpha=0.3)
    save_figure(path, ax.figure)
