"""What each number that steers a solver does: every field of every record of options at half and at twice its value."""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import Any

import numpy as np

from benchmarks.frame import Section, table
from benchmarks.measure import Row, decade, least_seconds
from benchmarks.problems import Array, loads, square
from homogenize import default_law, fit, locked_strain
from macro_fem import EveryRing, OnDemand, read_scene, solve
from macro_fem.curtain import make_problem, solve_problem
from macro_fem.modes import find_modes
from macro_fem.motion.curtain import MovingCurtain
from macro_fem.scene.meshing.mesh import build_mesh
from rve import Cell, solve_table, with_rings
from rve.common import InputError, NotConverged
from rve.directions import product

WIND = {"direction": [0.3, 0.0, 1.0], "speed": 8.0, "follows": True}
BALL = {"kind": "sphere", "centre": [200.0, 150.0, -80.0], "radius": 60.0, "move": [0.0, 0.0, 60.0]}
HOOKS = {"kind": "hooks", "count": 5, "gather": 0.8}
GUST = {"load": {"wind": WIND | {"follows": False, "history": [[0.0, 0.0], [0.05, 1.0]]}}, "motion": {"duration": 0.1}}
UNCHANGED = 1e-9
"""Relative changes of answers up to which none is told."""
KEPT: Any = type(cache(abs))


def curtains() -> Array:
    """Heights and forces: hung by corners; by hooks, elastic; drawn apart; in wind that follows; on a body."""
    scenes = [square(4), square(4, HOOKS, solver={"kind": "elastic"}), square(4, {"kind": "top", "gather": 1.5})]
    scenes += [square(4, "top", 400.0, load={"wind": WIND}), square(4, "top", 400.0, obstacle=[BALL])]
    found = [solve(read_scene(one)) for one in scenes]
    return np.array([[one.summary["mean_height_mm"], one.summary["max_principal_line_load_N_per_mm"]] for one in found])


def motion() -> Array:
    """Where a sheet in a gust is, by steps of its own, and its frequencies at rest."""
    run = MovingCurtain(read_scene(square(4, "top", 400.0) | GUST), default_law()).solve()
    scene = read_scene(square(8, "top", 400.0))
    rest = solve_problem(make_problem(scene, default_law(), build_mesh(scene, default_law().cell)))
    return np.append(run.frames[-1].row[1:4], find_modes(rest, 4).frequencies_Hz)


def every_ring() -> Array:
    """Height and largest force of a sheet of some 180 rings in space."""
    told = solve(read_scene(square(6, size=120.0)), EveryRing()).summary
    return np.array([told["mean_height_mm"], told["largest_contact_force_N"]])


def rings() -> Array:
    """Least gap and largest force of the rings of a solved curtain."""
    field = solve(read_scene(square(6, "top", 200.0))).rings()
    return np.array([field.summary["largest_contact_force_N"], field.summary["worst_cell"]["largest_force_N"]])


def tables() -> Array:
    """Strains of 4-in-1 at r1/r2 = 10 and 25, of 6-in-1 at 12; strength of the first."""
    cells = Cell(5.0, 0.5), Cell(5.0, 0.2), Cell(5.0, 5.0 / 12.0, weave="6-in-1")
    found = [solve_table(cell, loads(22.5, 22.5)) for cell in cells]
    strong = with_rings(found[0], cells[0]).strength
    return np.concatenate([*(one.E.ravel() for one in found), strong.ravel()])


def fits() -> Array:
    """Support function and utilisation of a law fitted to a table of 45 loads, at random loads."""
    cell, rng = Cell(5.0, 0.5), np.random.default_rng(0)
    law = fit(with_rings(solve_table(cell, loads(10.0, 0.0)), cell)).law
    root = rng.standard_normal((200, 2, 2))
    S = (root @ root.swapaxes(1, 2)).reshape(-1, 4)[:, [0, 1, 3]]
    return np.append(law.support(S), law.strength.utilisation(S))


def on_demand() -> Array:
    """Ends of the interval of a small sheet hung by its corners, to 1e-2."""
    told = solve(read_scene(square(4, size=200.0)), OnDemand(Cell(5.0, 0.5), 1e-2)).summary
    return np.array(told["mean_height_interval_mm"])


def strains() -> Array:
    """Strains of the default law under Cauchy loads."""
    return locked_strain(default_law(), *product(np.arange(-90.0, 91.0, 30.0), np.array([3.0, 20.0, 45.0, 80.0]))).E


PROBLEMS: dict[str, Callable[[], Array]] = {
    "rve.finite": every_ring,
    "rve.placed": rings,
    "rve": tables,
    "homogenize.query": strains,
    "homogenize": fits,
    "macro_fem.demand": on_demand,
    "macro_fem.motion": motion,
    "macro_fem": curtains,
}
"""What the numbers of a package are tried on: by the first name that fits."""


def measure(full: bool) -> Section:
    """The section."""
    for problem in set(PROBLEMS.values()):
        problem()  # modules with records are imported where they are first used
    rows = [row for cls in records() for row in rows_of(cls)]
    still = sum(row["_change"] <= UNCHANGED and 0.95 < row["_time"] < 1.05 for row in rows)
    text = (
        "Each field at half and at twice its value, the others as they are: the largest relative change of an answer, "
        "or how it then ends, and the time over that of the value itself. Answers: "
        + "; ".join(f"`{name}`: {problem.__doc__}" for name, problem in PROBLEMS.items())
    )
    note = f"{still} of {len(rows)} fields change neither an answer by 1e-9 nor the time by 5 % on these problems."
    return Section("Numbers that steer solvers", text, (table("", rows),), (), note)


def records() -> list[type]:
    """Classes of options of which there are instances in use, by module and name."""
    found = {type(one) for one in gc.get_objects() if is_dataclass(type(one)) and not isinstance(one, type)}
    named = [
        cls for cls in found if cls.__name__.endswith(("Options", "Method")) and not cls.__module__.startswith("tests")
    ]
    return sorted(named, key=lambda cls: (cls.__module__, cls.__name__))


def rows_of(cls: Any) -> Iterator[Row]:
    """A row for each number of a record."""
    name = next(key for key in PROBLEMS if cls.__module__.startswith(key))
    right, usual = answer_of(name)
    for item in fields(cls):
        if item.default is MISSING or isinstance(item.default, bool) or not isinstance(item.default, int | float):
            continue
        row: Row = {"record": f"{cls.__module__}.{cls.__name__}", "field": item.name, "value": item.default}
        change, ratio = 0.0, 1.0
        for word, factor in (("halved", 0.5), ("doubled", 2.0)):
            value = type(item.default)(factor * item.default)
            with set_to(cls, item.name, value):
                try:
                    got, seconds = least_seconds(PROBLEMS[name], 1)
                    away = (
                        float(np.nanmax(np.abs(got - right)) / np.nanmax(np.abs(right)))
                        if got.shape == right.shape
                        else np.inf
                    )
                    row |= {word: decade(away, UNCHANGED), f"time, {word}": seconds / usual}
                    change, ratio = max(change, away), max(ratio, seconds / usual, usual / seconds)
                except (InputError, NotConverged, ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
                    row |= {word: str(error)[:40], f"time, {word}": float("nan")}
                    change = np.inf
        yield row | {"_change": change, "_time": ratio}


@cache
def answer_of(name: str) -> tuple[Array, float]:
    """The answer of a problem with all numbers as they are, and its time, s."""
    return least_seconds(PROBLEMS[name], 1)


@contextmanager
def set_to(cls: Any, field: str, value: float) -> Iterator[None]:
    """Every record of a class with another value in a field, those that are made meanwhile as well."""
    old = {id(one): (one, getattr(one, field)) for one in gc.get_objects() if type(one) is cls}
    init, names = cls.__init__, [item.name for item in fields(cls) if item.default is not MISSING]
    defaults = init.__defaults__
    init.__defaults__ = tuple(value if name == field else one for name, one in zip(names, defaults, strict=True))
    try:
        for one, _ in old.values():
            object.__setattr__(one, field, value)
        forget()
        yield
    finally:
        init.__defaults__ = defaults
        for one, before in old.values():
            object.__setattr__(one, field, before)
        forget()


def forget() -> None:
    """Clear what was found with other numbers and is kept."""
    for one in gc.get_objects():
        if isinstance(one, KEPT) and one is not answer_of:
            one.cache_clear()
