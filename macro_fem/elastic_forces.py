"""Forces that rigid rings leave open, decided by the elasticity of the rings: a second step after the rigid shape.

Forces of supports are unique if balance alone decides them, or if they act at two points: balance then leaves one pull
along their line, the slope of the least potential over their distance. Level supports at more points, as far apart as
the mesh is wide, are where the potential has a kink: columns of rings lock side by side and may share the load in many
ways. Elastic rings have one answer.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from macro_fem.curtain import solve_problem
from macro_fem.problem import CurtainProblem
from macro_fem.scene.meshing.mesh import components
from macro_fem.solution import CurtainSolution
from rve.common import Array, InputError, part_of

NOT_UNIQUE = (
    "rigid rings can share the load in many ways, and forces of single points, line loads and the safety factor are "
    'those of one of them; kind = "elastic" under [solver] gives those that the stiffness of the rings decides'
)
"""What a rigid curtain says of forces that it leaves open."""
RANK = 1e-9
"""Singular values of the equations of balance below this part of the largest count as none."""


def self_balanced(problem: CurtainProblem, x: Array) -> int:
    """How many independent sets of support forces at positions x (n_nodes, d) balance without any load; 0 if the forces
    are unique. A component that slides on a sloping line counts as held.
    """
    number, label = components(problem.disc.cell_dofs, problem.disc.n_nodes)
    found = 0
    for piece in range(number):
        nodes, axes = np.nonzero(problem.supports.mask & (label == piece)[:, None])
        if len(np.unique(nodes)) > 2:
            found += len(nodes) - int(np.linalg.matrix_rank(_balance(x[nodes], axes), RANK))
    return found


def _balance(x: Array, axes: np.ndarray) -> Array:
    """Forces and moments (3 or 6, k) of unit forces along `axes` (k,) at positions x (k, d), size 1."""
    d = x.shape[1]
    away = x - x.mean(axis=0)
    arm, force = np.zeros((len(x), 3)), np.eye(3)[axes]
    arm[:, :d] = away / max(float(np.abs(away).max()), 1e-300)
    moment = np.cross(arm, force)
    return np.concatenate([force[:, :d].T, moment[:, 2:].T if d == 2 else moment.T])


def with_forces(found: CurtainSolution) -> CurtainSolution:
    """The curtain with line loads and forces of elastic rings where rigid ones leave them open, its shape unchanged.

    For `kind = "auto"`; `second_step` says what was done, or why elastic rings give no answer and rigid forces stay.
    """
    problem = found.problem
    if problem.scene.solver.kind != "auto" or found.status != "converged":
        return found
    count = self_balanced(problem, found.x)
    if not count:
        why = "balance, or the distance of two points, decides the forces of the supports"
        return replace(found, second_step=(False, why))
    elastic, why = None, f"as a law of kind {problem.law.name} has no stiffness"
    if problem.law.compliance.any():
        solver = replace(problem.scene.solver, kind="elastic", bounds=False, adapt=0)
        second = replace(problem, scene=replace(problem.scene, solver=solver), bodies=(), winds=())
        try:
            with part_of("forces by elastic rings", 0.0, 1.0):
                elastic = solve_problem(second, found)
                why = f"with elastic rings {elastic.message}"
        except InputError as error:
            why = f"with elastic rings {error}"
    if elastic is None or elastic.status != "converged":
        return replace(found, second_step=(False, f"forces are one choice of many: {why}"))
    why = (
        f"rigid rings leave {count} sets of support forces open: forces, line loads and the safety factor are those of "
        f"elastic rings, {elastic.iterations} more steps of the solver; shape and heights are those of rigid rings"
    )
    return replace(
        found,
        second_step=(True, why),
        inner=elastic.inner,
        asked=replace(found.asked, unbalanced=max(found.asked.unbalanced, elastic.asked.unbalanced)),
        wall_s=found.wall_s + elastic.wall_s,
    )


def forces_by(found: CurtainSolution) -> str:
    """Which rings the forces are those of: "rigid" or "elastic"."""
    return "elastic" if found.elastic or (found.second_step or (False,))[0] else "rigid"


def forces_note(found: CurtainSolution) -> str | None:
    """How forces that rigid rings leave open were found, or why they are one choice; None if they are unique."""
    if found.elastic or not self_balanced(found.problem, found.x):
        return None
    return NOT_UNIQUE if found.second_step is None else found.second_step[1]
