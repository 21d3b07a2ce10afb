"""What the run behind a solved curtain used, what it left out, and why.

Decisions are made where the work is done and recorded in `CurtainSolution`; here they are listed.
"""

from __future__ import annotations

import numpy as np

from macro_fem.solution import CurtainSolution, Decision
from macro_fem.solvers.cones import Cones, facets_of


def decisions(solution: CurtainSolution, *, bounds: bool, picture: bool) -> list[Decision]:
    """What the run behind a solution used and left out; `bounds`, `picture`: whether it was bounded, is drawn."""
    return [
        _third_coordinate(solution),
        *([] if solution.cones is None else [_half_spaces(solution, solution.cones)]),
        _ties(solution),
        *_obstacles(solution),
        *solution.decided,
        _slack_cells(solution),
        *_outputs(solution, bounds, picture),
    ]


def _third_coordinate(solution: CurtainSolution) -> Decision:
    why = solution.problem.scene.space_reason
    in_plane = "all loads and supports lie in the plane, and so does the least potential"
    return Decision("third-coordinate", bool(why), why or in_plane)


def _half_spaces(solution: CurtainSolution, cones: Cones) -> Decision:
    facets = facets_of(solution.problem.law)
    all_of = "infinitely many" if facets is None else f"{len(facets.h)}"
    each = f"{len(cones) / len(cones.first):.1f} of the law's {all_of} half-spaces per point"
    return Decision("all-half-spaces", False, f"{each} are near enough to matter; the law confirms the rest")


def _ties(solution: CurtainSolution) -> Decision:
    bars = any(bar.straight for bar in solution.problem.scene.load.bar)
    lines = any(held.slide is not None for held in solution.problem.supports.held)
    why = ["a bar keeps an edge straight"] * bars + ["an edge slides on a sloping line"] * lines
    return Decision("ties", bool(why), " and ".join(why) or "no straight bar and no sloping line")


def _obstacles(solution: CurtainSolution) -> list[Decision]:
    """Nothing for a scene without obstacles and following pressure."""
    problem, settling = solution.problem, solution.settling
    found = []
    if problem.walls is not None:
        found.append(Decision("half-spaces-on-nodes", True, f"{len(problem.walls)} linear cones keep obstacles clear"))
    if settling is not None:
        why = f"bodies or following pressure; forces of {settling.misfit:.1e} of the load still turn"
        found.append(Decision("rounds", True, f"{settling.rounds} convex solves: {why}"))
    return found


def _slack_cells(solution: CurtainSolution) -> Decision:
    """Never left out: see docs/reports/omissions.md for what that would save."""
    share = float(np.mean(solution.state() == 0))
    return Decision(
        "slack-cells", True, f"{100.0 * share:.0f} % of the cells hang slack; which ones is part of the answer"
    )


def _outputs(solution: CurtainSolution, bounds: bool, picture: bool) -> list[Decision]:
    solver = solution.problem.scene.solver
    asked = solver.bounds or solver.adapt > 0
    why = "[solver] bounds or adapt" if asked else "not asked for"
    return [
        Decision("bounds", bounds, f"{why}: a second, equilibrated solution and an error map"),
        Decision("picture", picture, "curtain.png" if picture else "--no-picture"),
    ]
