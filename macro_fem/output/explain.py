"""What a scene of a curtain needs, what it leaves out, and why; `force` in [solver] puts it back in.

Decisions are made where the work is done; here is what a solved curtain tells of them, in words.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from macro_fem.curtain import COARSE_FROM, starts_coarse
from macro_fem.solution import CurtainSolution
from macro_fem.solvers.cones import Cones, facets_of


@dataclass(frozen=True)
class Decision:
    """A feature, whether the run has used it, and why in this scene."""

    feature: str
    used: bool
    why: str

    def to_dict(self) -> dict[str, str | bool]:
        """For summary.json."""
        return asdict(self)


def decisions(solution: CurtainSolution, *, bounds: bool, picture: bool) -> list[Decision]:
    """What the run behind a solution used and left out; `bounds`, `picture`: whether it was bounded, is drawn."""
    rigid = solution.problem.scene.solver.kind == "rigid"
    own = [_third_coordinate(solution), _half_spaces(solution, solution.cones)] if rigid and solution.cones else []
    return [
        *own,
        _ties(solution),
        _coarse_start(solution),
        _slack_cells(solution),
        *_outputs(solution, bounds, picture),
    ]


def _third_coordinate(solution: CurtainSolution) -> Decision:
    if solution.problem.scene.solver.forces("third-coordinate"):
        return Decision("third-coordinate", True, "forced: nodes may leave the plane")
    return Decision(
        "third-coordinate", False, "all loads and supports lie in the plane, and so does the least potential"
    )


def _half_spaces(solution: CurtainSolution, cones: Cones) -> Decision:
    points = len(cones.first)
    facets = facets_of(solution.problem.law)
    all_of = "infinitely many" if facets is None else f"{len(facets.h)}"
    if solution.problem.scene.solver.forces("all-half-spaces"):
        return Decision("all-half-spaces", True, f"forced: {all_of} half-spaces at every point")
    each = f"{len(cones) / points:.1f} of the law's {all_of} half-spaces per point"
    return Decision("all-half-spaces", False, f"{each} are near enough to matter; the law confirms the rest")


def _ties(solution: CurtainSolution) -> Decision:
    if solution.problem.supports.tie is not None:
        return Decision("ties", True, "a bar keeps an edge straight")
    if solution.problem.scene.solver.forces("ties"):
        return Decision("ties", True, "forced: free components are picked by a matrix")
    return Decision("ties", False, "no straight bar")


def _coarse_start(solution: CurtainSolution) -> Decision:
    used, points = starts_coarse(solution.problem), solution.problem.disc.n_points
    if used and points < COARSE_FROM:
        return Decision("coarse-start", True, f"forced: a coarser curtain comes first, though {points} points are few")
    if used:
        return Decision("coarse-start", True, f"{points} points: a coarser curtain tells the first half-spaces")
    solver = solution.problem.scene.solver
    if solver.kind == "clarabel":
        return Decision("coarse-start", False, "clarabel takes no start")
    small = points < COARSE_FROM and not solver.forces("coarse-start")
    why = f"{points} points are fewer than {COARSE_FROM}" if small else "this mesh has no coarser one"
    return Decision("coarse-start", False, why)


def _slack_cells(solution: CurtainSolution) -> Decision:
    """Never left out: see docs/reports/omissions.md for what that would save."""
    share = float(np.mean(solution.state() == 0))
    return Decision(
        "slack-cells", True, f"{100.0 * share:.0f} % of the cells hang slack; which ones is part of the answer"
    )


def _outputs(solution: CurtainSolution, bounds: bool, picture: bool) -> list[Decision]:
    solver = solution.problem.scene.solver
    asked = solver.bounds or solver.adapt > 0
    why = "[solver] bounds or adapt" if asked else "forced" if bounds else "not asked for"
    return [
        Decision("bounds", bounds, f"{why}: a second, equilibrated solution and an error map"),
        Decision("picture", picture, "curtain.png" if picture else "--no-picture"),
    ]
