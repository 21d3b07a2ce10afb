"""An iterate of the solver of finite meshes, its equations and its step. Lengths in units of r1, see `solver`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rve.common.types import Array
from rve.finite.factor import Solve
from rve.finite.records import Task
from rve.finite.system import Factored, Pattern
from rve.finite.touching import Placed, Touching

_TIE = 0.1
"""Stiffness of the spring between a ring and its guide over mu, in 1/r1^2."""
_TIED = 1e-3
"""mu below which rings are guided no more."""


@dataclass(frozen=True, eq=False)
class State:
    """An iterate; damping of all pairs, and `local` (p,) of single ones on top of it; convex (p,): which part of the
    negative curvature of each pair is left out."""

    placed: Placed
    touching: Touching
    force: Array
    mu: float
    damping: float
    local: Array
    convex: Array


@dataclass(frozen=True, eq=False)
class Step:
    """A Newton step q (n, 5), forecast of the gaps and forces, part (p,) that is safe, slope of the barrier function
    along it, stiffness of contacts, and a function that solves with its matrix."""

    q: Array
    dgap: Array
    dforce: Array
    safe: Array
    slope: float
    stiff: Array
    solve: Solve


@dataclass
class Work:
    """What is added to the matrix of one iteration, see `State`, and stiffness (m,) that contacts have on top of
    theirs; lacking (p, 7, 7): what blocks of pairs lack to be positive semidefinite, nan where nobody asked; last: the
    last factor; counts."""

    damping: float
    local: Array
    convex: Array
    extra: Array
    lacking: Array | None = None
    last: Factored | None = None
    turns: int = 0
    trials: int = 0
    factors: int = 0
    failed: int = 0
    why: str = ""


@dataclass(frozen=True, eq=False)
class Linear:
    """The equations of an iterate: gap gradients, stiffness of contacts, blocks and where they go, stiffness (n, 5) of
    single coordinates, right-hand side (n, 5) with 0 for what is not free, held step (n, 5), weight (p,) of the damping
    of each pair, barrier function."""

    G: Array
    stiff: Array
    blocks: Array
    pattern: Pattern
    soft: Array
    rhs: Array
    held: Array
    heavy: Array
    barrier: float
    mu: float
    is_moving: bool = field(default=False)


def central(gap: Array, mu: float, reach: float) -> Array:
    """Forces (m,) on the central path, a little more than none where a gap is at the reach."""
    return np.asarray(mu * np.maximum(1.0 / gap - 1.0 / reach, 1e-8))


def ties(task: Task, mu: float, n: int) -> tuple[Array, Array]:
    """Stiffness (n, 3) of the springs between the centres and their guide, and where these end; 0 at a small mu."""
    if task.guide is None or mu < _TIED:
        return np.zeros((n, 3)), np.zeros((n, 3))
    guided = np.isfinite(task.guide)
    return np.where(guided, _TIE * mu, 0.0), np.where(guided, task.guide, 0.0)


def barrier(placed: Placed, touching: Touching, task: Task, mu: float, reach: float) -> float:
    """-f.x + mu sum (g/R - 1 - log g/R), g the gap and R the reach, and the energy of the springs to the guide, all
    without units: falls along a step at one mu."""
    gap = np.minimum(touching.gap / reach, 1.0)
    tie, end = ties(task, mu, len(placed.x))
    energy = 0.5 * (tie * (placed.x - end) ** 2).sum() - (task.force * placed.x).sum()
    return float(energy + mu * (gap - 1.0 - np.log(gap)).sum())
