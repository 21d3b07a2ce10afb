"""Law and mesh refined by turns, until the interval of the answer is as narrow as asked.

    known directions -> inner law -> admissible curtain (upper bound) -> its stresses -> rings asked where they widen
    the interval -> outer law -> equilibrated stress (lower bound), error map -> finer mesh -> ...

Every upper bound holds for a law inside that of the rings, every lower bound for one that contains it, so the interval
of every turn holds the answer for the rings and the continuous curtain. The law's part is the sum of weight times width
over the stresses of the curtain (`macro_fem.bounds.interval.Loads`), the mesh's part the rest.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from homogenize import CellInfo, LawInterval, MembraneLaw, law_interval
from macro_fem.bounds.adapt import Level, mark, with_cones_of
from macro_fem.bounds.admissible import admissible_problem
from macro_fem.bounds.interval import Loads, bound, loads_of
from macro_fem.curtain import solve_problem
from macro_fem.demand.directions import between, widest
from macro_fem.demand.record import DEMAND, SENTENCES, Demand, DemandOptions, Turn
from macro_fem.demand.ring_answers import GAIN, Samples, ask, first_directions, ring_info, rounded, settle
from macro_fem.scene.meshing.mesh import CurtainMesh, build_mesh, refine
from macro_fem.scene.schema import Scene
from macro_fem.solution import CurtainSolution
from rve import Cell
from rve.common.cache import NO_CACHE, Cache
from rve.common.errors import InputError
from rve.common.progress import heard_by, part_of, tell
from rve.common.tensor import disc
from rve.common.types import Array

LAW_SHARE = 0.15
"""The law may widen the interval by this part of what is asked, or of what the mesh does now. More saves ring solves
and costs triangles."""
FALL = 0.6
"""What a refinement leaves of the mesh's part: 0.55 to 0.65 on the corner-hung square."""
FIRST_GAP = 0.01
"""The mesh's part over total load times height, before it is known."""
AGAIN = 2.0
"""The curtain is solved again on its mesh if the law that it was solved with makes more than this times the share."""
QUESTIONS = 8
"""Ring problems between two looks at the law."""
LOOKS = 6
"""Looks at the law within one turn."""
SAME_RINGS = 1e-6
"""Relative difference of radii and reference cells that are taken for the same."""
LOST = 4
"""How often directions are asked because no curtain hangs on the inner law yet."""


@dataclass(frozen=True, eq=False)
class _RingsOnDemand:
    """What does not change: scene, rings, their reference cell, cache, options, and when the run began, s."""

    scene: Scene
    cell: Cell
    info: CellInfo
    cache: Cache
    options: DemandOptions
    began: float = field(default_factory=time.perf_counter)

    @property
    def is_mirrored(self) -> bool:
        return self.cell.weave.is_mirrored

    def law(self, asked: Samples) -> LawInterval:
        """What is known of the law; InputError if the rings answered too few questions."""
        if asked.rows is None or len(asked.rows) < 4:
            raise InputError(
                f"--rings: {asked.failed} of {len(asked.x)} load directions found no locked state; try other radii"
            )
        return law_interval(asked.rows, cell=self.info)


def solve_on_demand(
    scene: Scene,
    cell: Cell,
    options: DemandOptions = DEMAND,
    *,
    known: LawInterval | None = None,
    cache: Cache = NO_CACHE,
) -> Demand:
    """The curtain of a scene of these rings at its full load, its interval narrowed to `options.accuracy`.

    known: what is known of the rings to begin with. The answer is the last admissible curtain, whose potential is the
    upper end of the interval. InputError if the scene makes no sense or its supports are out of reach.
    """
    rings = _RingsOnDemand(scene, cell, ring_info(cell), cache, options)
    asked = _first(rings, known)
    mesh = build_mesh(scene, rings.info)
    turns: list[Turn] = []
    last, level, share = None, None, FIRST_GAP
    law = rings.law(asked)
    while len(turns) < options.most_turns:
        with part_of(_line(mesh, asked, level), 0.0, 1.0):
            solution, law, asked = _hang(rings, mesh, law, asked, last, LOST if level is None else 0)
        if solution.status != "converged":
            return _give_up(rings, level, law, asked, turns, solution)
        target, scale = _scales(solution, options.accuracy)
        before, inner = len(asked.x), law.inner
        law, asked = _narrow(rings, law, solution, asked, LAW_SHARE * max(target, share * scale))
        part = _loads(solution, inner, law.outer).law_part
        if part > AGAIN * LAW_SHARE * max(target, share * scale) and len(asked.x) > before:
            turns.append(_turn(rings, solution, asked, part))
            last = solution
            continue
        with part_of("bounds", 0.0, 1.0):
            new = Level(solution, bound(solution, outer=law.outer))
        turns.append(_turn(rings, solution, asked, part, new))
        ended = _find_end(rings, new, turns, target, asked)
        level = new if level is None or new.bounds.status == "converged" else level
        if ended is not None:
            return Demand(level, law, asked, tuple(turns), options.accuracy, *_doubt(law, *ended))
        share = FALL * max(level.bounds.gap - part, 0.0) / scale
        mesh, last = refine(mesh, mark(level.bounds.error), scene), solution
    if level is None:
        raise InputError(f"{scene.source}: no bounds after {len(turns)} turns; ask for less accuracy")
    return Demand(level, law, asked, tuple(turns), options.accuracy, "turn_limit", SENTENCES["turn_limit"])


def _first(rings: _RingsOnDemand, known: LawInterval | None) -> Samples:
    """What the first law is made of; InputError if what is known belongs to other rings."""
    if known is None:
        return _ask_all(rings, first_directions(rings.is_mirrored), Samples(np.zeros((0, 2))))
    cell, info = known.law.cell, rings.info
    names = ("r2_mm", "b_x_mm", "b_y_mm")
    if cell is not None:
        given, own = ([getattr(one, name) / one.r1_mm for name in names] for one in (cell, info))
        if np.abs(np.subtract(given, own)).max() > SAME_RINGS:
            text = [", ".join(f"{x:.6g}" for x in one) for one in (given, own)]
            raise InputError(f"{known.source}: r2, b_x and b_y over r1 are {text[0]}, those of --rings are {text[1]}")
    return Samples(rounded(disc(known.rows.S)), known.rows)


def _scales(solution: CurtainSolution, accuracy: float) -> tuple[float, float]:
    """Width to reach, and total load times height, N mm."""
    problem = solution.problem
    scale = float(np.abs(problem.force).sum()) * problem.mesh.height
    return accuracy * scale, max(scale, 1e-300)


def _ask_all(rings: _RingsOnDemand, x: Array, asked: Samples) -> Samples:
    """`asked` and the directions x (n, 2), told one by one."""
    for number, one in enumerate(x):
        tell(f"asking the rings, {asked.solves} solved, {len(x) - number} to go", number / len(x))
        with heard_by(None):
            asked = ask(rings.cell, rings.cache, one[None], asked)
    return settle(rings.cell, rings.cache, asked) if len(x) else asked


def _hang(
    rings: _RingsOnDemand, mesh: CurtainMesh, law: LawInterval, asked: Samples, last: CurtainSolution | None, tries: int
) -> tuple[CurtainSolution, LawInterval, Samples]:
    """The curtain by the inner law; where none hangs on it, the rings are asked more widely, at most `tries` times."""
    while True:
        problem = admissible_problem(rings.scene, law.inner, mesh)
        solution = solve_problem(with_cones_of(problem, last))
        if solution.status == "converged" or tries == 0:
            return solution, law, asked
        tries -= 1
        asked = _ask_all(rings, _more_anywhere(rings, law, solution, asked), asked)
        law = rings.law(asked)


def _narrow(
    rings: _RingsOnDemand, law: LawInterval, solution: CurtainSolution, asked: Samples, allowed: float
) -> tuple[LawInterval, Samples]:
    """The law after the rings were asked at the solution's stresses until its part, N mm, is what is allowed."""
    for _ in range(LOOKS):
        loads = _loads(solution, law.inner, law.outer)
        left = rings.options.most_solves - asked.solves
        if loads.law_part <= allowed or left <= 0:
            break
        most = min(QUESTIONS, left)
        x = widest(disc(loads.S), loads.weight * loads.width, asked.x, most, rings.is_mirrored)
        if not len(x):
            break
        asked = _ask_all(rings, x, asked)
        law = rings.law(asked)
    return law, asked


def _loads(solution: CurtainSolution, inner: MembraneLaw, outer: MembraneLaw) -> Loads:
    """The stresses of a curtain, in the frame of the weave."""
    problem = solution.problem
    return loads_of(problem.disc.weight, problem.law.in_weave(solution.S), inner, outer)


def _more_anywhere(rings: _RingsOnDemand, law: LawInterval, solution: CurtainSolution, asked: Samples) -> Array:
    """Directions (n, 2) to ask where no curtain was found: at the stress that proves it, and far from known ones."""
    loads = _loads(solution, law.inner, law.outer)
    x = widest(disc(loads.S), loads.weight * loads.width, asked.x, QUESTIONS, rings.is_mirrored)
    return np.vstack([x, between(np.vstack([asked.x, x]), QUESTIONS, rings.is_mirrored)])


def _turn(
    rings: _RingsOnDemand, solution: CurtainSolution, asked: Samples, part: float, level: Level | None = None
) -> Turn:
    return Turn(
        solution.problem.disc.n_cells,
        asked.count,
        asked.solves,
        asked.hits,
        solution.primal,
        np.nan if level is None else level.bounds.lower,
        part,
        time.perf_counter() - rings.began,
    )


def _find_end(
    rings: _RingsOnDemand, level: Level, turns: Sequence[Turn], target: float, asked: Samples
) -> tuple[str, str] | None:
    """Status and message if this was the last turn."""
    bounds, options = level.bounds, rings.options
    if bounds.status != "converged":
        return "bound_limit", SENTENCES["bound_limit"].format(bound=bounds.status)
    if bounds.gap <= target:
        return "converged", SENTENCES["converged"]
    part, cells = float(bounds.law_part or 0.0), turns[-1].cells
    if part > 0.5 * bounds.gap and part > 0.5 * target and _is_idle(turns):
        _, scale = _scales(level.solution, options.accuracy)
        why = SENTENCES["law_limit"].format(law=part / scale, solves=options.most_solves, failed=asked.failed)
        return "law_limit", why
    if cells + 3 * len(mark(bounds.error)) > options.most_cells:
        return "mesh_limit", SENTENCES["mesh_limit"].format(cells=options.most_cells)
    return None


def _doubt(law: LawInterval, status: str, message: str) -> tuple[str, str]:
    """Status and message, unless rows contradict each other: then some h are not the largest work."""
    if status == "converged" and law.raised > GAIN:
        return "contradiction", SENTENCES["contradiction"].format(raised=law.raised)
    return status, message


def _is_idle(turns: Sequence[Turn]) -> bool:
    """Whether the last turn has added no row to the law."""
    return len(turns) > 1 and turns[-1].rows == turns[-2].rows


def _give_up(
    rings: _RingsOnDemand,
    level: Level | None,
    law: LawInterval,
    asked: Samples,
    turns: Sequence[Turn],
    solution: CurtainSolution,
) -> Demand:
    """The turn before, if there is one; InputError if no curtain hangs on what is known of the rings."""
    if level is None:
        what = "[support]" if solution.status == "infeasible" else f"status {solution.status}"
        raise InputError(f"{rings.scene.source}: {what}: {solution.message} (law of {asked.count} ring problems)")
    why = SENTENCES["curtain_limit"].format(why=solution.message)
    return Demand(level, law, asked, tuple(turns), rings.options.accuracy, "curtain_limit", why)


def _line(mesh: CurtainMesh, asked: Samples, level: Level | None) -> str:
    """What the progress line says."""
    text = f"{mesh.mesh.t.shape[1]} triangles, {asked.count} ring problems"
    if level is None:
        return text
    _, scale = _scales(level.solution, 1.0)
    law = float(level.bounds.law_part or 0.0)
    gap = level.bounds.gap
    return f"{text}, interval {gap / scale:.2e} of the height (law {law / scale:.1e}, mesh {(gap - law) / scale:.1e})"
