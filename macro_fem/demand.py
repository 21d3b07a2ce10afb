"""The law on demand: table and mesh refined by turns, until the interval of the answer is as narrow as asked.

    table -> inner law -> admissible curtain (upper bound) -> outer law -> equilibrated stress (lower bound), error map
    -> rows where the curtain is stressed, or a finer mesh, whichever widens the interval more -> ...

Every upper bound holds for a law inside that of the rings, every lower bound for one that contains it, so the interval
of every turn holds the answer for the rings and the continuous curtain. The law's part is the sum of weight times width
over the stresses of the curtain (`macro_fem.bounds.interval.Loads`), the mesh's part the rest.
"""

import os
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from scipy.spatial import cKDTree

from homogenize import LawInterval, read_law_interval
from homogenize.fitting import cell_of, interval_of_table, law_interval, rows_from_table
from homogenize.laws import LockedRows, Strength, strength_of_table, with_mirror
from macro_fem.bounds.interval import CurtainBounds, admissible_problem, bound, loads_of, mark, with_cones_of
from macro_fem.curtain import CurtainSolution, solve_problem
from macro_fem.judged import critical_load
from macro_fem.scene.meshing.mesh import CurtainMesh, build_mesh, refine
from macro_fem.scene.scene import Scene
from macro_fem.summary import Asked, Turn
from rve import Cell, StrainTable, grid, read_table, reference_cell, solve_table, with_rings, write_table
from rve.common import Array, Cache, InputError, JsonObject, part_of, read_entry, sidecar_path, versions
from rve.common.arguments import check_fields
from rve.common.cell_fields import check_ring_size
from rve.common.ring_sizes import radii_in
from rve.common.tensor import WEIGHT, disc, trace
from rve.geometry import cauchy_of, load_angles

ACCURACY = 5e-3
"""Of a run by default."""


@dataclass(frozen=True)
class DemandOptions:
    """Numbers of the turns."""

    fine_deg: float = 5.0
    coarse_deg: float = 15.0
    """Steps of the first table: of primitive cells, and of larger ones, where a row takes ten times as long."""
    law_share: float = 0.2
    """The law may widen the interval by this part of what is asked: more saves rows and costs triangles."""
    decimals: int = 2
    """Of load directions in degrees."""
    apart: float = 0.5
    near: float = 0.01
    """A new row keeps this part of its distance to the nearest row free of other new ones; and is not nearer to a row
    than this in the disc of directions. Larger: fewer rows at once."""
    lost: int = 4
    """How often rows are added because no curtain hangs on the inner law yet."""
    contradiction: float = 1e-8
    """Work at unit trace by which one row must exceed another to contradict it; round-off leaves 1e-12."""
    yield_looks: int = 4
    """How often the rings are asked at the load that comes nearest to yield, whose place may move with every row."""


DEMAND = DemandOptions()
SENTENCES = {
    "converged": "the interval of rings and continuous curtain is as narrow as asked",
    "mesh_limit": "the mesh would need more than {who.most_cells} triangles; ask for less accuracy, or start with "
    "fewer cells",
    "law_limit": "the law's part, {law:.2g} of the height, is the larger one and further ring solves cannot narrow the "
    "interval within {who.most_loads} load directions ({rings.failed} without an answer); ask for less accuracy",
    "bound_limit": "the lower bound ended with status {bound}; allow more [solver] max_iterations or start with other "
    "cells",
    "contradiction": "rows contradict each other by {rings.law.raised:.1e}: some are not the largest work, the lower "
    "bound is not proved; begin with a table of more loads by --table",
    "curtain_limit": "the curtain of the next turn was not solved, and the interval is that of the turn before: {why}",
}
"""What each status says; only the first means that the accuracy was reached."""


@dataclass(frozen=True)
class OnDemand:
    """A table of these rings is made and refined where the curtain needs it, until the interval of the answer is no
    wider than `accuracy` times total load times height, which for a curtain under its weight alone is that of the mean
    height.

    known: rows to begin with, an interval of laws or the file of a law or table (CSV) that tells one; cache: the folder
    where tables are kept; most_cells, most_loads: triangles and load directions at which a run gives up. InputError for
    an accuracy out of range.
    """

    cell: Cell
    accuracy: float = ACCURACY
    known: LawInterval | Path | None = None
    cache: str | Path | None = None
    most_cells: int = 30_000
    most_loads: int = 3_000

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


@dataclass(frozen=True, eq=False)
class Demand:
    """The answer on demand: the last curtain with its bounds, the rings that were asked, and the way there.

    status: "converged" if the interval is as narrow as asked; `message` says what limits it otherwise.
    """

    level: CurtainBounds
    rings: "Rings"
    turns: tuple[Turn, ...]
    accuracy: float
    status: str
    message: str

    def asked(self) -> Asked:
        """How the rings were asked, and every turn."""
        return Asked(
            accuracy=self.accuracy,
            ring_solves=self.rings.solves,
            cache_hits=self.rings.hits,
            ring_failures=self.rings.failed,
            rows=len(self.rings.law.rows),
            largest_contradiction_of_rows=self.rings.law.raised,
            turns=self.turns,
        )


class Rings:
    """The law of rings as far as they were asked, and how it came about.

    law: of all rows, with their `strength`; loads (n, 2): what was asked, angles in degrees; solves, hits, failed: load
    directions that were solved, that were read from the folder of tables, and that have no answer.
    """

    law: LawInterval
    strength: Strength

    def __init__(self, who: OnDemand) -> None:
        self.cell, self.cache, known = who.cell, Cache(who.cache), who.interval()
        self.solves = self.hits = self.failed = 0
        if known is not None and known.law.cell is not None:
            reference_cell(self.cell).check_same(known.law.cell, known.source, "--cell")
        own = grid(DEMAND.coarse_deg if self.cell.is_larger else DEMAND.fine_deg, self.cell.weave)
        self.loads = np.transpose(own) if known is None else directions_of(known.rows.S, known.rows)
        table = self._table(self.loads)
        if table.converged.sum() < 4:
            what = f"{self.failed} of {len(table)} load directions have no locked state"
            raise InputError(f"--cell: {what}; try other radii")
        self._learn(table)
        if known is not None and known.raised <= DEMAND.contradiction:
            self.law = law_interval(known.rows, cell=self.law.law.cell, strength=self.strength)

    def ask(self, loads: Array) -> None:
        """Add the rows of the load directions (n, 2), alpha and beta in degrees.

        Where rows contradict each other all are solved together, so that the states of each are starts for the others.
        """
        self.loads = np.vstack([self.loads, loads])
        table = self._table(loads)
        if table.converged.any():
            self._learn(table, self.law)
        if self.law.raised > DEMAND.contradiction:
            self._learn(self._table(self.loads))

    def missing(self, solution: CurtainSolution) -> Array:
        """Load directions (n, 2) of a curtain's stresses that hold most of the law's part, apart from each other and
        from those that were asked."""
        problem, law = solution.problem, self.law
        loads = loads_of(problem.disc.weight, problem.law.in_weave(solution.S), law.inner, law.outer)
        x, free, chosen = places(loads.S, law.rows), DEMAND.apart * distance(loads.S, law.rows), list[int]()
        for i in mark(loads.weight * loads.width):
            if free[i] > DEMAND.apart * DEMAND.near and (np.hypot(*(x[chosen] - x[i]).T) > free[chosen]).all():
                chosen.append(int(i))
        new = np.unique(directions_of(loads.S[chosen], law.rows), axis=0)
        return np.asarray(new[~(new[:, None] == self.loads).all(axis=2).any(axis=1)])

    def _learn(self, table: StrainTable, before: LawInterval | None = None) -> None:
        """Make the law of the rows of a table and those before."""
        rows, strength = rows_from_table(table), strength_of_table(table)
        assert strength is not None  # tables have the columns of rings
        if before is not None:
            rows, strength = before.rows.join([rows]), self.strength.join([strength])
        self.law, self.strength = law_interval(rows, cell=cell_of(table), strength=strength), strength

    def _table(self, loads: Array) -> StrainTable:
        """The table of these load directions with the strength of the rings, from the folder or from the rings."""
        cell, table = self.cell, None
        question: JsonObject = {"weave": cell.weave.name, "grain": cell.grain, "loads_deg": loads.tolist()}
        question |= {"cells": list(cell.cells), "centres": cell.centres, "r1_mm": cell.r1, "r2_mm": cell.r2}
        question |= {"material": asdict(cell.material), "versions": versions()}
        question |= {} if cell.drawing is None else {"drawing": asdict(cell.drawing)}
        path = self.cache.path(question, ".csv")
        with suppress(InputError):  # none, or a damaged one
            if path is not None and (kept := read_table(path)).origin.notes.get("question") == question:
                table = kept
        if table is None:
            with part_of(f"{len(loads)} load directions"):
                table = with_rings(solve_table(cell, (loads[:, 0], loads[:, 1])), cell)
            if path is not None:
                sidecar_path(path).unlink(missing_ok=True)
                origin = replace(table.origin, notes={**table.origin.notes, "question": question})
                write_table(replace(table, origin=origin), path)
            self.solves += len(table)
        else:
            self.hits += len(table)
        self.failed += int((~table.converged).sum())
        return table


def directions_of(S: Array, rows: LockedRows) -> Array:
    """Cauchy load directions (n, 2), alpha and beta in degrees, of loads S (n, 3), each in that strain of the rows
    which does most work under it.

    Rounded, so that loads of nearly rank one, as wrinkled meshes carry, have rank one.
    """
    both = with_mirror(rows)
    E = both.E[((S * WEIGHT) @ both.E.T).argmax(axis=1)]
    alpha, beta, _ = load_angles(cauchy_of(S, E))
    alpha = np.abs(alpha) if rows.is_mirrored else alpha
    return np.column_stack([alpha, beta]).round(DEMAND.decimals)


def distance(S: Array, rows: LockedRows) -> Array:
    """Distance in the disc of directions of loads S (n, 3) to the nearest row, (n,)."""
    return np.asarray(cKDTree(places(rows.S, rows)).query(places(S, rows))[0])


def places(S: Array, rows: LockedRows) -> Array:
    """Loads S (n, 3) in the disc of directions (n, 2), mirror images as one."""
    x = disc(S)
    return np.column_stack([x[:, 0], np.abs(x[:, 1])]) if rows.is_mirrored else x


def solve_on_demand(scene: Scene, who: OnDemand) -> Demand:
    """The curtain of a scene at its full load, its interval narrowed to the accuracy that is asked.

    The answer is the last admissible curtain, whose potential is the upper end of the interval. InputError if the scene
    makes no sense or its supports are out of reach.
    """
    began, rings = time.perf_counter(), Rings(who)
    mesh, turns, why = build_mesh(scene, rings.law.law.cell), list[Turn](), ""
    last: CurtainSolution | None = None
    level: CurtainBounds | None = None
    while True:
        with part_of(_line(mesh, rings, level)):
            solution = _hang(scene, rings, mesh, last)
        if solution.status != "converged":
            status, why = "curtain_limit", solution.message
            break
        with part_of("bounds"):
            new = bound(solution, outer=rings.law.outer)
        asked, ends = (
            (len(rings.law.rows), rings.solves, rings.hits),
            (new.upper, new.lower, float(new.law_part or 0.0)),
        )
        turns.append(Turn(solution.problem.disc.n_cells, *asked, *ends, time.perf_counter() - began))
        last, level = solution, new if level is None or new.status == "converged" else level
        target, law_part = who.accuracy * _scale(solution), turns[-1].law_part_N_mm
        rows = rings.missing(solution) if law_part > DEMAND.law_share * target else rings.loads[:0]
        is_coarse = new.gap - law_part > (1.0 - DEMAND.law_share) * target or not len(rows)
        cells = mark(level.error) if is_coarse else np.zeros(0, int)
        if end := _end(new, rings, who, target, (len(rows), len(cells))):
            status = end
            break
        if len(rows):
            rings.ask(rows)
        if len(cells):
            mesh = refine(mesh, cells)
    assert level is not None  # a first curtain that does not hang is refused
    part = turns[-1].law_part_N_mm / _scale(level.solution)
    message = SENTENCES[status].format(who=who, rings=rings, law=part, bound=new.status, why=why)
    return Demand(_with_strength(level, rings), rings, tuple(turns), who.accuracy, status, message)


def _hang(scene: Scene, rings: Rings, mesh: CurtainMesh, last: CurtainSolution | None) -> CurtainSolution:
    """The curtain by the inner law. Where none hangs on it yet rows are added at the stress that proves it; InputError
    if that does not help."""
    for left in range(DEMAND.lost if last is None else 0, -1, -1):
        solution = solve_problem(with_cones_of(admissible_problem(scene, rings.law.inner, mesh), last))
        if solution.status == "converged" or not left or not len(missing := rings.missing(solution)):
            break
        rings.ask(missing)
    if solution.status != "converged" and last is None:
        what = "[support]" if solution.status == "infeasible" else f"status {solution.status}"
        scene.refuse(f"{what}: {solution.message} (law of {len(rings.law.rows)} rows)")
    return solution


def _end(new: CurtainBounds, rings: Rings, who: OnDemand, target: float, more: tuple[int, int]) -> str | None:
    """The status if this was the last turn, after which so many more rows and triangles are to be refined."""
    if new.status != "converged":
        return "bound_limit"
    if new.gap <= target:  # by rows that do not contradict each other, else some h are not the largest work
        return "converged" if rings.law.raised <= DEMAND.contradiction else "contradiction"
    if len(rings.loads) + more[0] > who.most_loads or (float(new.law_part or 0.0) > target and not more[0]):
        return "law_limit"
    return "mesh_limit" if len(new.error) + 3 * more[1] > who.most_cells else None


def _scale(solution: CurtainSolution) -> float:
    """Total load times height, N mm; InputError without load."""
    scene, total = solution.problem.scene, float(np.abs(solution.problem.force).sum())
    if total == 0.0:
        scene.refuse("carries no load, so that no interval is narrow; give it weight or a pull")
    return total * solution.problem.mesh.height


def _line(mesh: CurtainMesh, rings: Rings, level: CurtainBounds | None) -> str:
    """What the progress line says."""
    text = f"{mesh.mesh.t.shape[1]} triangles, {len(rings.law.rows)} rows"
    if level is None:
        return text
    scale, gap, law = _scale(level.solution), level.gap, float(level.law_part or 0.0)
    return f"{text}, interval {gap / scale:.2e} of the height (law {law / scale:.1e}, mesh {(gap - law) / scale:.1e})"


def _with_strength(level: CurtainBounds, rings: Rings) -> CurtainBounds:
    """The curtain by a law that knows the strength of the rings, exactly at the load of its largest utilisation."""
    for _ in range(DEMAND.yield_looks):
        solution = level.solution
        own = replace(solution.problem.law.own, strength=rings.strength)  # type: ignore[type-var]
        problem = replace(solution.problem, law=replace(solution.problem.law, own=own))
        level = replace(level, solution=replace(solution, problem=problem))
        load = critical_load(level.solution)
        if load is None or distance(load[None] / trace(load), rings.law.rows)[0] < DEMAND.near:
            break
        rings.ask(directions_of(load[None], rings.law.rows))
    return level


def demand_options(
    cell: str | None, law: Path | None = None, table: Path | None = None, **given: Any
) -> OnDemand | None:
    """The rings that are asked, None if no radii are given; the rest as the command line has it. A law or table is what
    is known to begin with.

    Tables are kept in $XDG_CACHE_HOME/ring-mesh, by default ~/.cache/ring-mesh, unless told otherwise. InputError for
    radii, weave or grain that make no mesh, and for options that need --cell.

    >>> demand_options("5,0.5", no_cache=True).cell.wire
    0.1
    """
    told = {name: value for name, value in given.items() if value is not None and value is not False}
    if cell is None:
        for name, value in told.items():
            raise InputError(f"--{name.replace('_', '-')} = {value}: belongs to --cell R1,R2")
    if table is not None and (law is not None or cell is None):
        raise InputError(f"--table = {table}: is what a run with --cell begins with, instead of --law")
    if cell is None:
        return None
    if "cache" in told and "no_cache" in told:
        raise InputError("--cache and --no-cache contradict each other: give one")
    r1, r2 = radii_in(cell, "--cell")
    check_ring_size(r1, "--cell: r1")
    rings = Cell(r1, r2, told.get("weave", "4-in-1"), told.get("grain", "y"))
    base = os.environ.get("XDG_CACHE_HOME", "")
    kept = (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "ring-mesh"
    folder = None if "no_cache" in told else told.get("cache", kept)
    return OnDemand(rings, told.get("accuracy", ACCURACY), law if table is None else table, folder)
