"""Law and mesh refined by turns, until the interval of the answer is as narrow as asked.

    known directions -> inner law -> admissible curtain (upper bound) -> its stresses -> rings asked where they widen
    the interval -> outer law -> equilibrated stress (lower bound), error map -> finer mesh -> ...

Every upper bound holds for a law inside that of the rings, every lower bound for one that contains it, so the interval
of every turn holds the answer for the rings and the continuous curtain. The law's part is the sum of weight times width
over the stresses of the curtain (`macro_fem.bounds.interval.Loads`), the mesh's part the rest. At last the rings are
asked for their strength, also where the curtain comes nearest to yield.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from homogenize import LawInterval, MembraneLaw
from homogenize.laws import LockedRows, Strength, strength_of_table
from macro_fem.bounds.interval import CurtainBounds, Loads, admissible_problem, bound, loads_of, mark, with_cones_of
from macro_fem.curtain import CurtainSolution, solve_problem
from macro_fem.demand.directions import between, first_directions, rounded, widest
from macro_fem.demand.rings import ACCURACY, GAIN, Rings
from macro_fem.judged import critical_load
from macro_fem.scene.meshing.mesh import CurtainMesh, build_mesh, refine
from macro_fem.scene.scene import Scene
from rve import Cell, solve_table, with_rings
from rve.common import Array, part_of, tell
from rve.common.tensor import disc, trace
from rve.geometry import cauchy_of, load_angles

LAW_SHARE, AGAIN = 0.15, 2.0
"""The law may widen the interval by this part of what is asked, or of what the mesh does now: more saves ring solves
and costs triangles. With more than the second times that the curtain is solved again on its mesh."""
FIRST_GAP, FALL = 0.01, 0.6
"""The mesh's part over total load times height before it is known, and what a refinement leaves of it."""
QUESTIONS, LOOKS, LOST = 8, 6, 4
"""Ring problems between two looks at the law; looks within one turn; how often directions are asked because no curtain
hangs on the inner law yet."""
MOST_CELLS, MOST_SOLVES, MOST_TURNS = 30_000, 3_000, 60
"""Triangles, ring problems and turns at which a run gives up."""
SENTENCES = {
    "converged": "the interval of rings and continuous curtain is as narrow as asked",
    "mesh_limit": "the mesh would need more than {cells} triangles; ask for less accuracy, or start with fewer cells",
    "law_limit": "the law's part, {law:.2g} of the height, is the larger one and further ring solves cannot "
    "narrow the interval within {solves} ring problems ({failed} directions without an answer); ask for less accuracy",
    "bound_limit": "the lower bound ended with status {bound}; allow more [solver] max_iterations or start with other "
    "cells",
    "contradiction": "answers of the rings contradict each other by {raised:.1e}: some are not the largest work, the "
    "lower bound is not proved; make a table with rve table, which seeks the largest states, and begin with it",
    "turn_limit": "the limit of turns was reached; ask for less accuracy",
    "curtain_limit": "the curtain of the next turn was not solved, and the interval is that of the turn before: {why}",
}
"""What each status says; only the first means that the accuracy was reached."""
YIELD_LOOKS, NEAR = 4, 0.01
"""How often the rings are asked at the load that comes nearest to yield, whose place may move with every answer; not
where a direction is known that is nearer than this in the unit disc."""


@dataclass(frozen=True, eq=False)
class Demand:
    """The answer on demand: the last curtain with its bounds, the law of the rings that were asked, and the way there.

    turns: of each the triangles, rows known, ring problems solved and read so far, bounds and their law's part, by the
    names of summary.json; the lower bound is nan in turns that only asked the rings.
    status: "converged" if the interval is as narrow as asked; `message` says what limits it otherwise.
    """

    level: CurtainBounds
    law: LawInterval
    rings: Rings
    turns: tuple[dict[str, Any], ...]
    accuracy: float
    status: str
    message: str

    def to_dict(self) -> dict[str, Any]:
        """For summary.json: status and message of the whole, how the rings were asked, and every turn."""
        return {
            "status": self.status,
            "message": self.message,
            "accuracy": self.accuracy,
            "ring_solves": self.rings.solves,
            "cache_hits": self.rings.hits,
            "ring_failures": self.rings.failed,
            "rows": len(self.rings.rows),
            "largest_contradiction_of_rows": self.law.raised,
            "turns": list(self.turns),
            "wall_s": self.turns[-1]["wall_s"],
        }


def solve_on_demand(scene: Scene, rings: Rings, accuracy: float = ACCURACY) -> Demand:
    """The curtain of a scene at its full load, its interval narrowed to `accuracy`, see `OnDemand`, by rings and what
    they know.

    The answer is the last admissible curtain, whose potential is the upper end of the interval. InputError if the scene
    makes no sense or its supports are out of reach.
    """
    began = time.perf_counter()
    if not len(rings.rows):
        rings.learn(first_directions(rings.is_mirrored))
    mesh, turns = build_mesh(scene, rings.info), list[dict[str, Any]]()
    last: CurtainSolution | None = None
    level: CurtainBounds | None = None
    share, status, why = FIRST_GAP, "turn_limit", dict[str, Any]()
    while len(turns) < MOST_TURNS:
        with part_of(_line(mesh, rings, level)):
            solution = _hang(scene, rings, mesh, last, LOST if level is None else 0)
        if solution.status != "converged":
            if level is None:
                what = "[support]" if solution.status == "infeasible" else f"status {solution.status}"
                scene.refuse(f"{what}: {solution.message} (law of {len(rings.rows)} ring problems)")
            status, why = "curtain_limit", {"why": solution.message}
            break
        scale = _scale(solution)
        allowed = LAW_SHARE * max(accuracy, share) * scale
        before, inner = len(rings.x), rings.law.inner
        _narrow(rings, solution, allowed)
        part = _loads(solution, rings, inner).law_part
        is_known = part <= AGAIN * allowed or len(rings.x) == before
        if is_known:
            with part_of("bounds"):
                new = bound(solution, outer=rings.law.outer)
        asked = {"rows": len(rings.rows), "ring_solves": rings.solves, "cache_hits": rings.hits}
        ends = {"upper_N_mm": solution.primal, "lower_N_mm": new.lower if is_known else np.nan, "law_part_N_mm": part}
        time_s = {"wall_s": time.perf_counter() - began}
        turns.append({"cells": solution.problem.disc.n_cells} | asked | ends | time_s)
        last = solution
        if not is_known:
            continue
        level = new if level is None or new.status == "converged" else level
        end = _find_end(new, rings, turns, accuracy)
        if end is not None:
            why = {"cells": MOST_CELLS, "solves": MOST_SOLVES, "failed": rings.failed, "raised": rings.law.raised}
            status, why = end, why | {"law": float(new.law_part or 0.0) / scale, "bound": new.status}
            break
        share = FALL * max(level.gap - part, 0.0) / scale
        mesh = refine(mesh, mark(level.error))
    if level is None:
        scene.refuse(f"no bounds after {len(turns)} turns; ask for less accuracy")
    return Demand(level, rings.law, rings, tuple(turns), accuracy, status, SENTENCES[status].format(**why))


def _scale(solution: CurtainSolution) -> float:
    """Total load times height, N mm; InputError without load."""
    scene, total = solution.problem.scene, float(np.abs(solution.problem.force).sum())
    if total == 0.0:
        scene.refuse("carries no load, so that no interval is narrow; give it weight or a pull")
    return total * solution.problem.mesh.height


def _hang(scene: Scene, rings: Rings, mesh: CurtainMesh, last: CurtainSolution | None, tries: int) -> CurtainSolution:
    """The curtain by the inner law.

    Where no curtain hangs on it, the rings are asked more widely, at most `tries` times: at the stress that proves it,
    and far from known directions.
    """
    while True:
        solution = solve_problem(with_cones_of(admissible_problem(scene, rings.law.inner, mesh), last))
        if solution.status == "converged" or tries == 0:
            return solution
        tries -= 1
        x = _widest(rings, _loads(solution, rings, rings.law.inner), QUESTIONS)
        rings.learn(np.vstack([x, between(np.vstack([rings.x, x]), QUESTIONS, rings.is_mirrored)]))


def _narrow(rings: Rings, solution: CurtainSolution, allowed: float) -> None:
    """Ask the rings at the solution's stresses until the law's part, N mm, is what is allowed."""
    for _ in range(LOOKS):
        loads, left = _loads(solution, rings, rings.law.inner), MOST_SOLVES - rings.solves
        if loads.law_part <= allowed or left <= 0:
            break
        x = _widest(rings, loads, min(QUESTIONS, left))
        if not len(x):
            break
        rings.learn(x)


def _widest(rings: Rings, loads: Loads, most: int) -> Array:
    """At most `most` directions (n, 2) of loads that widen the interval most."""
    return widest(disc(loads.S), loads.weight * loads.width, rings.x, most, rings.is_mirrored)


def _loads(solution: CurtainSolution, rings: Rings, inner: MembraneLaw) -> Loads:
    """The stresses of a curtain in the frame of the weave, between the law `inner` and the outer law of the rings."""
    problem = solution.problem
    return loads_of(problem.disc.weight, problem.law.in_weave(solution.S), inner, rings.law.outer)


def _find_end(bounds: CurtainBounds, rings: Rings, turns: Sequence[dict[str, Any]], accuracy: float) -> str | None:
    """The status if this was the last turn."""
    target = accuracy * _scale(bounds.solution)
    if bounds.status != "converged":
        return "bound_limit"
    if bounds.gap <= target:  # by rows that do not contradict each other, else some h are not the largest work
        return "converged" if rings.law.raised <= GAIN else "contradiction"
    is_idle = len(turns) > 1 and turns[-1]["rows"] == turns[-2]["rows"]
    if is_idle and float(bounds.law_part or 0.0) > 0.5 * max(bounds.gap, target):
        return "law_limit"
    return "mesh_limit" if turns[-1]["cells"] + 3 * len(mark(bounds.error)) > MOST_CELLS else None


def _line(mesh: CurtainMesh, rings: Rings, level: CurtainBounds | None) -> str:
    """What the progress line says."""
    text = f"{mesh.mesh.t.shape[1]} triangles, {len(rings.rows)} ring problems"
    if level is None:
        return text
    scale, gap, law = _scale(level.solution), level.gap, float(level.law_part or 0.0)
    return f"{text}, interval {gap / scale:.2e} of the height (law {law / scale:.1e}, mesh {(gap - law) / scale:.1e})"


def with_strength(found: Demand) -> Demand:
    """`found` with a law that knows the strength of its rings, of their material: exact at the directions that were
    asked, and at that of the largest utilisation of the curtain."""
    rows, cell = found.law.rows, found.rings.cell
    strength = strength_of_rows(rows, cell)
    for _ in range(YIELD_LOOKS):
        tell(f"asking the rings for their strength, {len(strength.S)} loads known")
        told = _with_strength(found, strength)
        load = critical_load(told.level.solution)
        if load is None:
            break
        x, known = disc(load[None] / trace(load)), disc(rows.S)
        images = known * [1.0, -1.0] if rows.is_mirrored else known
        if np.hypot(*(np.vstack([known, images]) - x).T).min() < NEAR:
            break
        row = found.rings.answer(rounded(x)[0])
        if row is None:
            break
        rows, strength = rows.join([row]), strength.join([strength_of_rows(row, cell)])
    return told


def strength_of_rows(rows: LockedRows, cell: Cell) -> Strength:
    """The strength at the loads of rows, each solved again under the Cauchy load that locks the cell in its strain."""
    alpha, beta, _ = load_angles(cauchy_of(rows.S, rows.E))
    found = strength_of_table(with_rings(solve_table(cell, (alpha, beta)), cell))
    assert found is not None  # the table has the columns
    return found


def _with_strength(found: Demand, strength: Strength) -> Demand:
    """`found` with this strength in its law and in that of its curtain."""
    solution, inner = found.level.solution, replace(found.law.inner, strength=strength)  # type: ignore[type-var]
    law = replace(found.law, inner=inner, law=inner)
    own = replace(solution.problem.law.own, strength=strength)  # type: ignore[type-var]
    problem = replace(solution.problem, law=replace(solution.problem.law, own=own))
    return replace(found, law=law, level=replace(found.level, solution=replace(solution, problem=problem)))
