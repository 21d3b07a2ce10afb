"""What the run behind a solved curtain used and left out: one short table made from the scene and its answer."""

from __future__ import annotations

from typing import Any

from macro_fem.scene.tables import Bar
from macro_fem.solution import CurtainSolution


def features(solution: CurtainSolution, *, bounds: bool, picture: bool) -> list[dict[str, Any]]:
    """Rows of feature, used and why; `bounds`, `picture`: whether the curtain was bounded, is drawn."""
    problem, settling = solution.problem, solution.settling
    scene, solver = problem.scene, problem.scene.solver
    bars = any(bar.straight for bar in scene.of(Bar))
    lines = any(held.slide is not None for held in problem.supports.held)
    ties = ["a bar keeps an edge straight"] * bars + ["an edge slides on a sloping line"] * lines
    asked = "[solver] bounds or adapt" if solver.bounds or solver.adapt > 0 else "not asked for"
    rows = [
        ("third-coordinate", scene.space_reason, "all loads and supports lie in the plane, and so does the answer"),
        ("ties", " and ".join(ties), "no straight bar and no sloping line"),
    ]
    if problem.walls is not None:
        rows.append(("half-spaces-on-nodes", f"{len(problem.walls)} linear cones keep obstacles clear", ""))
    if settling is not None:
        still = f"forces of {settling.misfit:.1e} of the load still turn"
        rows.append(("rounds", f"{settling.rounds} convex solves: bodies or wind on the present shape; {still}", ""))
    table = [{"feature": name, "used": bool(why), "why": why or why_not} for name, why, why_not in rows]
    if solution.second_step is not None:
        used, why = solution.second_step
        table.append({"feature": "elastic-forces", "used": used, "why": why})
    second = f"{asked}: a second, equilibrated solution and an error map"
    table.append({"feature": "bounds", "used": bounds, "why": second})
    return [*table, {"feature": "picture", "used": picture, "why": "curtain.png" if picture else "--no-picture"}]
