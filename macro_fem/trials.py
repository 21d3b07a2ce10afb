"""A curtain tried at many values of one quantity, under each of its load combinations, on one mesh.

Answers are kept on disk as they come. Those that may be solved at the same time run side by side. Each begins anew, so
that answers depend on no order: begun at the curtain of another value, a search of 50 runners took 104 s, not 110.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, wait
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from homogenize import LawInterval, MembraneLaw, default_law, fit
from macro_fem.demand import OnDemand
from macro_fem.job import combined, solve, solve_membrane
from macro_fem.scene.checks import check_scene
from macro_fem.scene.scene import Scene
from macro_fem.scene.shapes import Rectangle
from macro_fem.scene.support_kinds import Hanging
from macro_fem.scene.tables import Bar, Combination, Item, Wind
from macro_fem.summary import CurtainSummary
from rve import solve_table, with_rings
from rve.common import NO_CACHE, Cache, InputError, JsonObject, checksum, digits, part_of, tell, versions

VARIED: dict[str, tuple[str, str, Callable[[Item], bool]]] = {
    "pitch": ("mm", "hooks or runners", lambda item: isinstance(item, Hanging) and item.has_hooks),
    "mass": ("kg", "bar", lambda item: isinstance(item, Bar)),
    "speed": ("m/s", "wind with a speed", lambda item: isinstance(item, Wind) and item.speed is not None),
    "r2": ("mm", "wire of rings", lambda item: False),
}
"""What may be varied besides numbers in tables of plugins: its unit, and what of a scene has it."""
MAY_GOVERN = 1.1
"""A combination whose factor was this many times the least one, at the nearest value where it is known, is not solved.
Larger: more are; smaller: more of them turn out to govern at the end, and the search goes on."""

Who = MembraneLaw | LawInterval | OnDemand | None
Case = Combination | None
"""A load combination; None: loads as they are, or all at once."""
Key = tuple[float, Case]
Task = tuple[Scene, Who]


def own_numbers(item: Item) -> set[str]:
    """The keys of an entry of a plugin that are numbers, such as "sag"; none of ours."""
    is_ours = type(item).__module__.startswith("macro_fem.")
    return set() if is_ours else {key for key, value in vars(item).items() if isinstance(value, float)}


def varied(key: str) -> tuple[str, str, Callable[[Item], bool]]:
    """`VARIED` of a key, or what is said of one of plugins, whose unit is not known."""
    return VARIED.get(key) or ("", f"table of a plugin with {key}", lambda item: key in own_numbers(item))


class Outcome(NamedTuple):
    """What a `Row` says of a scene."""

    status: str
    factor: float | None = None
    safety_factor: float | None = None
    weakest: str | None = None
    utilisation_too_low: str | None = None
    governing_combination: str | None = None
    strength_note: str | None = None


@dataclass(frozen=True)
class Row:
    """An answer at a value: the least `factor` of all links, rings and hooks, and what gives first; `safety_factor`:
    that of the rings alone, too large where `utilisation_too_low` says why, None where `strength_note` does. Without
    an answer factors are None, and `status` says why. cells: of the mesh, along its width."""

    value: float
    factor: float | None
    safety_factor: float | None
    weakest: str | None
    status: str
    utilisation_too_low: str | None = None
    governing_combination: str | None = None
    cells: int = 0
    strength_note: str | None = None


@dataclass(frozen=True)
class Sought:
    """The quantity that varies, and the factor with which the curtain is to hold; `cells`: of the mesh, if not those of
    the scene."""

    scene: Scene
    who: Who
    vary: str
    factor: float
    cells: int | None = None

    @property
    def cases(self) -> tuple[Case, ...]:
        """What is solved at each value; rings on demand answer all combinations at once, by one law."""
        is_one = isinstance(self.who, OnDemand) and self.vary != "r2"
        return (None,) if is_one else self.scene.combination or (None,)

    def at(self, value: float) -> Scene:
        """The scene with the value in every part that has it."""
        has, scene, mesh = varied(self.vary)[2], self.scene, self.scene.mesh
        changes: Any = {self.vary: value} | ({"count": None} if self.vary == "pitch" else {})
        cells = self.cells or mesh.cells
        if self.vary == "pitch" and isinstance(scene.curtain, Rectangle):  # hooks are nodes of the mesh
            cells = max(cells, math.ceil(scene.curtain.width / value))
        items: list[Any] = list(scene.items)
        items = [replace(item, **changes) if has(item) else item for item in items]
        return replace(scene, mesh=replace(mesh, cells=cells), items=tuple(items))

    @cached_property
    def _sums(self) -> JsonObject:
        """Checksums of what answers depend on besides the scene, and versions."""

        def plain(value: Any) -> Any:
            return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)

        who, file = default_law() if self.who is None else self.who, self.scene.sheet_file
        law = sha256(msgspec.json.encode([type(who).__name__, who], enc_hook=plain)).hexdigest()
        return {"law": law, "sheet": file and checksum(file), "versions": versions()}

    def question(self, value: float, case: Case) -> JsonObject:
        """What the answer at a value depends on."""
        scene = replace(self.scene, source=Path("scene"), combination=())
        told = {"scene": repr(scene), "combination": repr(case), "all": repr(self.scene.combination) * (case is None)}
        return told | {"cells": self.cells, self.vary: value} | self._sums


@dataclass(eq=False)
class Trials:
    """Answers by value and load combination. folder: where they are kept; pool: what solves them, None this process;
    guide: answers on a coarser mesh; on_answer: is called after each one; planned: how many may be asked for
    after those asked for now."""

    sought: Sought
    folder: Path | None = None
    pool: Executor | None = None
    guide: Trials | None = None
    on_answer: Callable[[], None] = lambda: None
    planned: int = 0
    answers: dict[Key, Row] = field(default_factory=dict)
    _laws: dict[float, Who] = field(default_factory=dict)
    _solved: int = 0
    _later: int = 0
    _began: float = 0.0

    @property
    def rows(self) -> list[Row]:
        """The answer that governs at each value, in their order: none, or that of the least factor."""
        worst: dict[float, Row] = {}
        for (value, _), row in self.answers.items():
            worst[value] = min(worst.get(value, row), row, key=lambda one: one.factor or 0.0)
        return [worst[value] for value in sorted(worst)]

    def use(self, values: Sequence[float]) -> dict[float, float]:
        """log(asked / factor) at all values that are answered, inf where there is no answer, after asking for `values`:
        of many first for ends and middle, which tell the combinations that may govern at the others."""
        for part in (values[:: max(1, (len(values) - 1) // 2)], values):
            self._later = len(values) - len(part) + self.planned
            self.ask((value, case) for value in part for case in self.sought.cases if self._may_govern(value, case))
        return {row.value: math.log(self.sought.factor / row.factor) if row.factor else math.inf for row in self.rows}

    def ask(self, keys: Iterable[Key]) -> bool:
        """Solve what is not answered yet, here or in a run before; whether there was any."""
        cache, tasks = NO_CACHE if self.folder is None else Cache(self.folder), dict[Key, Task]()
        new = [key for key in keys if key not in self.answers]
        for key in new:
            if found := cache.get(self.sought.question(*key)):
                self.answers[key] = Row(**found)
                continue
            try:
                tasks[key] = self._task(*key)
            except InputError as error:
                self.answers[key] = self._row(key, Outcome(str(error)))
        self._began = self._began or time.monotonic()
        for key, told in self._run(tasks):
            self.answers[key] = self._row(key, told)
            cache.put(self.sought.question(*key), asdict(self.answers[key]))
            self._solved += 1
            self.on_answer()
        self.on_answer()
        return bool(new)

    def _row(self, key: Key, told: Outcome) -> Row:
        value, case = key
        name = told.governing_combination or (None if case is None else case.name)
        cells = self.sought.at(value).mesh.cells
        return Row(value, **told._replace(governing_combination=name)._asdict(), cells=cells)

    def _may_govern(self, value: float, case: Case) -> bool:
        """Whether a combination was within `MAY_GOVERN` of the one that governs, at the nearest value that tells."""
        for trials in filter(None, (self, self.guide)):
            known = [at for at, one in trials.answers if one == case]
            if known:
                at = min(known, key=lambda at: abs(math.log(at / value)))
                factors = {one: row.factor for (other, one), row in trials.answers.items() if other == at}
                least = min((factor for factor in factors.values() if factor), default=0.0)
                return (factors[case] or 0.0) <= MAY_GOVERN * least
        return True

    def _task(self, value: float, case: Case) -> Task:
        """What is solved for an answer; InputError where the scene takes no such value, or the rings have no law."""
        sought, scene = self.sought, self.sought.at(value)
        check_scene(scene)
        who = self._law(value) if sought.vary == "r2" else sought.who
        if case is not None:
            assert not isinstance(who, OnDemand)
            scene = combined(scene, case)
        return scene, who

    def _law(self, value: float) -> Who:
        """The law of a table of rings with wire of this radius."""
        if value not in self._laws:
            assert isinstance(self.sought.who, OnDemand)
            cell = replace(self.sought.who.cell, r2=value)
            with part_of(f"r2 = {value:.6g} mm, its table"):
                self._laws[value] = fit(with_rings(solve_table(cell), cell)).law
        return self._laws[value]

    def _run(self, tasks: dict[Key, Task]) -> Iterator[tuple[Key, Outcome]]:
        """How tasks end, as they do."""
        if self.pool is None:
            for count, (key, task) in enumerate(tasks.items()):
                with part_of(*self._told(key, len(tasks) - count)):
                    solved = answer_of(*task)
                yield key, solved
            return
        futures = {self.pool.submit(answer_of, *task): key for key, task in tasks.items()}
        left = set(futures)
        while left:
            tell(*self._told(futures[next(iter(left))], len(left)))
            # How often progress is told while other processes solve.
            done, left = wait(left, 1.0, FIRST_COMPLETED)
            for future in done:
                yield futures[future], future.result()

    def _told(self, key: Key, left: int) -> tuple[str, int, int, float]:
        """Progress: what is solved now, the last answer, and how many are left, as `tell` takes it."""
        unit, cases = varied(self.sought.vary)[0], f", {key[1].name}" if key[1] else ""
        now = f"{self.sought.vary} = {key[0]:.6g} {unit}".rstrip() + cases
        counted = self._solved, self._solved + left + self._later, self._began
        if not self._solved:
            return f"{now}, the first of about {left + self._later} answers", *counted
        last = next(reversed(self.answers.values()))
        told = f"factor {digits(last.factor)}" if last.factor else "no answer"
        return f"{now}, about {left + self._later} answers left; {last.value:.6g} {unit}: {told}", *counted


def answer_of(scene: Scene, who: Who) -> Outcome:
    """How a scene is judged; its own combinations, if it has any, govern."""
    try:
        found: Any = solve(scene, who) if isinstance(who, OnDemand) else solve_membrane(scene, who)
        has_one = found.status in ("converged", "collapsed")
        return _outcome(found.summary) if has_one else Outcome(str(found.message))
    except InputError as error:
        return Outcome(str(error))


def _outcome(summary: CurtainSummary) -> Outcome:
    worst = summary.envelope or summary
    note = summary.strength_note if summary.utilisation_max is None else None
    if worst.weakest_factor is None:
        return Outcome("there is no load" if note is None else f"the strength of the rings is not known: {note}")
    governing = summary.envelope.governing if summary.envelope else None
    factors = worst.weakest_factor, worst.safety_factor
    return Outcome("converged", *factors, worst.weakest, worst.utilisation_too_low, governing, note)
