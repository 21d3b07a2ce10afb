"""Rest by motion: the rings move, heavily damped, until the equilibrium near them is found.

Steps are Euler's. Where the kinetic energy falls, the rings have passed an equilibrium and are stopped: dynamic
relaxation with kinetic damping. Inertia makes the matrix of a step positive definite where that of the rings at rest
is not.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from rve.common.progress import tell
from rve.finite.problem import Problem
from rve.finite.records import FiniteOptions, Record
from rve.finite.solution import FiniteSolution
from rve.finite.step import near_equilibrium, ring_places, rings_at, step_rings

ROUGH = FiniteOptions(tolerance=1e-4, first=1e-4, last=1e-4, retries=0, max_iterations=40)
"""Options of a step on the way to rest."""
LONGEST = 0.4
"""Way in r1 of the fastest ring without contacts in one step, and of a held ring or a half-space."""
SHORTER, LONGER = 0.5, 1.3
"""Factors on this way after a step that fails, which is taken anew, and after one that does not."""
CALM = 0.02
"""Way of a ring in a step, in r1, below which the equilibrium is looked for though the rings still fall."""
MOST_STEPS = 400
"""Steps until the rings are given up."""


def rest_by_motion(problem: Problem, options: FiniteOptions) -> FiniteSolution:
    """The equilibrium in which a damped motion from the slack weave ends; see `FiniteMesh.solve`."""
    began, r1 = time.perf_counter(), problem.mesh.cell.r1
    problem.check()
    placed = problem.start(options)
    planes = zip(problem.walls, placed.x[placed.rings :], strict=True)
    cut = tuple(replace(wall, offset=r1 * float(wall.unit @ p) - problem.mesh.cell.r2) for wall, p in planes)
    start = replace(problem, walls=cut)
    rings = found = rings_at(start, r1 * placed.x[: placed.rings], placed.normal[: placed.rings])
    size = np.linalg.norm(problem.force, axis=1)
    load = np.maximum(size, size.mean())  # masses times 1 mm/s2: on the way to rest they may be any
    share, v, energy = 1.0, np.zeros((2 * len(load), 3)), 0.0
    history: tuple[Record, ...] = ()
    for number in range(MOST_STEPS):
        tell(f"{len(load)} rings on their way to rest, step {number + 1}")
        way = np.where(problem.held, problem.at - rings.centre, 0.0)
        walls_way = np.array([to.offset - now.offset for to, now in zip(problem.walls, rings.walls, strict=True)])
        longest = max(np.abs(way).max(initial=0.0), np.abs(walls_way).max(initial=0.0))
        part = min(1.0, share * LONGEST * r1 / max(float(longest), 1e-300))
        speed = float(np.linalg.norm(v, axis=1).max())
        h = (np.sqrt(speed**2 + 4.0 * share * LONGEST * r1) - speed) / 2.0
        walls = [replace(w, offset=w.offset + part * d) for w, d in zip(rings.walls, walls_way, strict=True)]
        places = ring_places(rings)
        aim, at = places + h * v, rings.centre + part * way
        step = step_rings(
            rings, load / h**2, aim, problem.force, problem.held, at, walls=walls, options=ROUGH, other_mu=()
        )
        end = step.rings
        history += end.history
        if end.status != "converged":
            share, v = SHORTER * share, np.zeros_like(v)
            continue
        rings, moved = end, ring_places(end) - places
        kinetic = float((np.tile(load, 2)[:, None] * moved**2).sum()) / h**2
        is_past = kinetic < energy
        v, energy = (0.0 * v, 0.0) if is_past else (moved / h, kinetic)
        if part == 1.0 and (is_past or np.abs(moved).max() < CALM * r1):
            found = near_equilibrium(problem, rings, options)
            history += found.history
            if found.status == "converged":
                break
        share = min(1.0, LONGER * share)
    return replace(found, wall_s=time.perf_counter() - began, history=history)
