"""An iterate of the solver of finite meshes, its equations and its step. Lengths in units of r1, see `solver`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rve.common.types import Array
from rve.finite.equations import BLOCK
from rve.finite.factor import Solve
from rve.finite.records import Task
from rve.finite.system import Factored, Pattern
from rve.finite.touching import Placed, Touching
from rve.geometry.circles import cross, dot, tangent_frame

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


def springs(placed: Placed, task: Task, mu: float) -> tuple[float, Array, Array]:
    """Energy, generalised forces (n, 5) and stiffness (n, 5) of the springs to the guide, none at a small mu, and of
    the inertia of a time step."""
    energy, pull, stiff = 0.0, np.zeros((len(placed.x), BLOCK)), np.zeros((len(placed.x), BLOCK))

    def add(weight: Array, end: Array) -> float:
        away = end - placed.x
        pull[:, :3] += weight * away
        stiff[:, :3] += weight
        return 0.5 * float((weight * away**2).sum())

    if task.guide is not None and mu >= _TIED:
        guided = np.isfinite(task.guide)
        energy += add(np.where(guided, _TIE * mu, 0.0), np.where(guided, task.guide, 0.0))
    if task.inertia is not None:
        own = task.inertia
        energy += add(np.repeat(own.weight[:, None], 3, axis=1), own.place)
        energy += 0.5 * float((own.turning * ((placed.normal - own.normal) ** 2).sum(axis=1)).sum())
        torque = own.turning[:, None] * cross(placed.normal, own.normal)
        pull[:, 3:] = np.stack([dot(torque, e) for e in tangent_frame(placed.normal)], axis=1)
        stiff[:, 3:] = (own.turning * dot(placed.normal, own.normal))[:, None]
    return energy, pull, stiff


def barrier(placed: Placed, touching: Touching, task: Task, mu: float, reach: float) -> float:
    """-f.x + mu sum (g/R - 1 - log g/R), g the gap and R the reach, and the energy of springs and inertia, all without
    units: falls along a step at one mu."""
    gap = np.minimum(touching.gap / reach, 1.0)
    energy = springs(placed, task, mu)[0] - (task.force * placed.x).sum()
    return float(energy + mu * (gap - 1.0 - np.log(gap)).sum())
