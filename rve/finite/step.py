"""A time step of every ring: the solver of finite meshes with the term of inertia added.

    minimise  |y - y_hat|^2_W / 2 - f.y   subject to gap >= 0

A ring that does not spin about its axis moves like two points of its mass: its centre, and one on its axis whose
distance from the centre is the radius of gyration about a diameter. So places y (2 n + b, 3) are those of the centres,
then of these points, less the centres, then of the centres of b balls, and any difference in time serves for all.
Iterations are those of `solver`: no gap is closed, no wire passes through another, and links stay as they are.

Rest by motion: the rings move by steps of Euler's, heavily damped, until the equilibrium near them is found. Where the
kinetic energy falls, the rings have passed an equilibrium and are stopped: dynamic relaxation with kinetic damping.
Inertia makes the matrix of a step positive definite where that of the rings at rest is not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rve.common import Array, Flags, tell
from rve.common.rings import gyration_radius
from rve.finite.equations import gradients, spread
from rve.finite.layout import FiniteMesh
from rve.finite.problem import Problem
from rve.finite.solution import FiniteSolution, as_solution
from rve.finite.solver import solve_near
from rve.finite.task import FiniteOptions, Found, Record, RingInertia, Task
from rve.finite.touching import Touching, find_touching, nearest, of_pairs
from rve.finite.walls import HalfSpace, Obstacle, RoundBody, flat
from rve.geometry.ring_pair import cross, rotation

STEP = tuple(
    FiniteOptions(tolerance=1e-10, retries=0, max_iterations=100, first=first, last=last)
    for first, last in ((1e-8, 1e-8), (1e-5, 1e-9), (1e-4, 1e-10), (1e-4, 1e-8))
)
"""Options of a step, tried in this order. Most steps need no path of mu. Where many contacts open and close, the way at
a small mu is in short parts, and at a larger one minima of distances split and merge without end: a minimum about to
split has one force or two beside each other, and there may be no equilibrium with either. The curvature below which
this is so falls with the root of the gap, so few are left at the end of a path, and others at another end."""
REST_MU, REST_RETRIES, REST_ITERATIONS = 1e-3, 8, 300
"""First mu, lifts of mu and iterations with which the equilibrium near a motion is found, or the motion goes on."""
ROUGH = (FiniteOptions(tolerance=1e-4, retries=0, max_iterations=40, first=1e-4, last=1e-4),)
"""Those of a step on the way to rest."""
LONGEST = 0.4
"""Way in r1 of the fastest ring without contacts in one step, and of a held ring or a half-space."""
SHORTER, LONGER, LEAST = 0.5, 1.3, 1e-6
"""Factors on this way after a step that fails, which is taken anew, and after one that does not; and the least one."""
CALM = 0.02
"""Way of a ring in a step, in r1, below which the equilibrium is looked for though the rings still fall."""
MOST_STEPS = 400
"""Steps until the rings are given up."""
_STILL = 1e-9
"""Residuals of a step without any force are measured by the force that moves all rings by this part of r1."""


@dataclass(frozen=True, eq=False)
class RingStep:
    """The end of a time step.

    rings: places, contacts, forces of supports and walls, status. pushes (2 n + b, 3): forces in N of contacts on
    `ring_places`, and of the axes, which keep their length. touched: forces of contacts times how far they have closed,
    N mm.
    """

    rings: FiniteSolution
    pushes: Array
    touched: float


def ring_places(rings: FiniteSolution) -> Array:
    """Places (2 n + b, 3) in mm: the centres, points on the axes one radius of gyration from them, less these, and the
    centres of balls."""
    balls = np.array([wall.place for wall in rings.walls if isinstance(wall, RoundBody)]).reshape(-1, 3)
    cell = rings.mesh.cell
    return np.concatenate([rings.centre, gyration_radius(cell.r1, cell.r2) * rings.normal, balls])


def slack_rings(mesh: FiniteMesh, *, space: bool = True, walls: Sequence[HalfSpace] = ()) -> FiniteSolution:
    """The slack weave at rest, without forces, its centres in the plane z = 0 about those of the reference."""
    none = np.zeros((len(mesh.X), 3))
    problem = Problem(mesh, none, none > 0.0, none, space, tuple(walls))
    centre, normal = mesh.slack()
    centre[:, :2] += (mesh.X - centre[:, :2]).mean(axis=0)
    return _without_forces(problem, centre, normal)


def with_bodies(rings: FiniteSolution, bodies: Sequence[RoundBody]) -> FiniteSolution:
    """The rings beside balls that do not push them; a ball that cuts a ring makes `contacts.min_gap_mm` negative."""
    none = np.zeros((len(bodies), 3))
    walls, wall_force = (*rings.walls, *bodies), np.concatenate([rings.wall_force, none])
    problem = Problem(rings.mesh, rings.load, rings.load > 0.0, rings.centre, rings.is_space, walls)
    gap = _without_forces(problem, rings.centre, rings.normal).contacts.min_gap_mm
    contacts = replace(rings.contacts, min_gap_mm=gap)
    return replace(rings, walls=walls, wall_force=wall_force, contacts=contacts)


def _without_forces(problem: Problem, centre: Array, normal: Array, status: str = "converged") -> FiniteSolution:
    """Rings with these centres (n, 3) in mm and normals (n, 3), without forces: at rest, or none of the load borne."""
    task = problem.task(1.0)
    touching = task.find(problem.placed(centre, normal), FiniteOptions.reach)
    found = Found(touching, np.zeros(len(touching.gap)), status, float(status != "converged"), ())
    return as_solution(problem, task, found)


def step_rings(
    start: FiniteSolution,
    weight: Array,
    aim: Array,
    force: Array,
    held: Flags,
    at: Array,
    *,
    walls: Sequence[Obstacle] = (),
) -> RingStep:
    """The rings after a time step from `start`, under forces (n, 3) in N, coordinates held as in `FiniteMesh.solve`.

    weight (2 n + b,): W of what `ring_places` are the places of, mass over the square of the step for Euler's method,
    N/mm; aim (2 n + b, 3): y_hat, where these would be without forces, mm. Nothing need hold the mesh. walls: as many
    as at the start, half-spaces where they are at the end, balls from where they are at the start. A step that has not
    converged has its status.
    """
    return _step(Problem(start.mesh, force, held, at, start.is_space, tuple(walls)), start, weight, aim, STEP)


def _step(
    problem: Problem, start: FiniteSolution, weight: Array, aim: Array, tries: Sequence[FiniteOptions]
) -> RingStep:
    """`step_rings` to the supports and half-spaces of a problem."""
    mesh, r1, n = start.mesh, start.mesh.cell.r1, len(start.centre)
    inert = weight[:, None] * np.abs(aim - ring_places(start))
    load = float(np.abs(problem.force).sum() + np.abs([wall.load for wall in problem.walls]).sum() + inert.sum())
    load = max(load, _STILL * r1 * float(weight.sum()))
    task = problem.task(load)
    # Of short steps places to round-off leave more than the tolerance.
    least = np.finfo(float).eps * float(weight @ np.abs(aim).max(axis=1)) / load
    # Points beside soft minima would come and go from step to step, and inertia holds what they are for.
    radius, none = gyration_radius(r1, mesh.cell.r2), np.zeros((len(problem.walls), 3))
    loose = n + np.flatnonzero([isinstance(wall, RoundBody) for wall in problem.walls])
    place, normal = (np.concatenate([part, none]) for part in (aim[:n] / r1, aim[n : 2 * n] / radius))
    heavy, turning = (np.append(part, none[:, 0]) for part in (weight[:n], weight[n : 2 * n]))
    heavy[loose], place[loose] = weight[2 * n :], aim[2 * n :] / r1
    inertia = RingInertia(heavy * r1 / task.unit, place, turning * radius**2 / (task.unit * r1), normal)
    task = replace(task, inertia=inertia, beside=False)
    placed = replace(problem, walls=start.walls).placed(start.centre, start.normal)
    touching = find_touching(placed, task.linked, task.wire, FiniteOptions.reach)
    for options in tries:
        tuned = replace(options, tolerance=max(options.tolerance, least))
        found = solve_near(task, touching, _forces(start, task, touching, options.first), tuned)
        if found.status == "converged":
            break
    rings, con = as_solution(problem, task, found), found.touching
    own = nearest(con, touching)
    closed = np.maximum(np.where(own >= 0, touching.gap[own], FiniteOptions.reach) - con.gap, 0.0)
    pushes = task.unit * spread(con, gradients(con), found.force)
    torque = r1 * rotation(rings.normal, pushes[:n, 3:])
    drawn = weight[n : 2 * n] * (rings.normal * (radius * rings.normal - aim[n : 2 * n])).sum(axis=1)
    axes = cross(torque, rings.normal) / radius + drawn[:, None] * rings.normal
    every = np.concatenate([pushes[:n, :3], axes, pushes[loose, :3]])
    return RingStep(rings, every, task.unit * r1 * float(found.force @ closed))


def rest_by_motion(problem: Problem, options: FiniteOptions) -> FiniteSolution:
    """The equilibrium in which a damped motion from the slack weave ends; see `FiniteMesh.solve`."""
    r1, placed = problem.mesh.cell.r1, problem.start(options)
    ends, r2 = flat(problem.walls), problem.mesh.cell.r2
    planes = zip(ends, placed.x[placed.rings :], strict=True)
    cut = tuple(replace(wall, offset=r1 * float(wall.unit @ p) - r2) for wall, p in planes)
    start = replace(problem, walls=cut)
    rings = _without_forces(start, r1 * placed.x[: placed.rings], placed.normal[: placed.rings])
    size = np.tile(np.linalg.norm(problem.force, axis=1), 2)
    load = np.maximum(size, size.mean())  # masses times 1 mm/s2: on the way to rest they may be any
    share, v, energy = 1.0, np.zeros((len(load), 3)), 0.0
    own = replace(options, first=REST_MU, retries=REST_RETRIES, max_iterations=REST_ITERATIONS)
    found, part, history = None, 0.0, tuple[Record, ...]()
    for number in range(MOST_STEPS):
        tell(f"{placed.rings} rings on their way to rest, step {number + 1}")
        way = np.where(problem.held, problem.at - rings.centre, 0.0)
        planes_now = flat(rings.walls)
        walls_way = np.array([to.offset - now.offset for to, now in zip(ends, planes_now, strict=True)])
        longest = max(np.abs(way).max(initial=0.0), np.abs(walls_way).max(initial=0.0))
        part = min(1.0, share * LONGEST * r1 / max(float(longest), 1e-300))
        speed = float(np.linalg.norm(v, axis=1).max())
        h = (np.sqrt(speed**2 + 4.0 * share * LONGEST * r1) - speed) / 2.0
        walls = [replace(w, offset=w.offset + part * d) for w, d in zip(planes_now, walls_way, strict=True)]
        places = ring_places(rings)
        there = replace(problem, at=rings.centre + part * way, walls=tuple(walls))
        end = _step(there, rings, load / h**2, places + h * v, ROUGH).rings
        history += end.history
        if end.status != "converged":
            share, v = SHORTER * share, np.zeros_like(v)
            if share < LEAST:
                break
            continue
        rings, moved = end, ring_places(end) - places
        kinetic = float((load[:, None] * moved**2).sum()) / h**2
        is_past = kinetic < energy
        v, energy = (0.0 * v, 0.0) if is_past else (moved / h, kinetic)
        if part == 1.0 and (is_past or np.abs(moved).max() < CALM * r1):
            task = problem.task()
            touching = task.find(problem.placed(rings.centre, rings.normal), options.reach)
            near = solve_near(task, touching, _forces(rings, task, touching, own.first), own)
            found = as_solution(problem, task, near)
            history += found.history
            if found.status == "converged":
                break
        share = min(1.0, LONGER * share)
    if found is None:  # the motion has never come near to rest
        status = "iterations" if part == 1.0 else "out-of-reach"
        found = _without_forces(replace(problem, walls=tuple(flat(rings.walls))), rings.centre, rings.normal, status)
    return replace(found, history=history)


def _forces(start: FiniteSolution, task: Task, touching: Touching, mu: float) -> Array:
    """Forces (m,) of contacts at the start, without units: those of each pair shared out as on the central path."""
    pairs, force = start.contacts.pairs, start.contacts.force
    row = of_pairs(touching.key, pairs[:, 0] * len(touching.placed.x) + pairs[:, 1])
    total = np.bincount(row[row >= 0], force[row >= 0] / task.unit, minlength=len(touching.key))
    return touching.shared(np.asarray(total, float), mu)
