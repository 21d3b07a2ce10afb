"""A time step of every ring: the solver of finite meshes with the term of inertia added.

    minimise  |y - y_hat|^2_W / 2 - f.y   subject to gap >= 0

A ring that does not spin about its axis moves like two points of its mass: its centre, and one on its axis whose
distance from the centre is the radius of gyration about a diameter. So places y (2 n + b, 3) are those of the centres,
then of these points, less the centres, then of the centres of b balls, and any difference in time serves for all.
Iterations are those of `solver`: no gap is closed, no wire passes through another, and links stay as they are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rve.common import Array, Flags
from rve.common.rings import gyration_radius
from rve.finite.equations import gradients, spread
from rve.finite.layout import FiniteMesh
from rve.finite.problem import Problem
from rve.finite.solution import FiniteSolution, as_solution
from rve.finite.solver import solve_near
from rve.finite.task import FiniteOptions, Found, RingInertia, Task
from rve.finite.touching import Touching, find_touching, nearest, of_pairs
from rve.finite.walls import HalfSpace, Obstacle, RoundBody
from rve.geometry.ring_pair import cross, rotation

STEP = tuple(
    FiniteOptions(tolerance=1e-10, retries=0, max_iterations=100, first=first, last=last)
    for first, last in ((1e-8, 1e-8), (1e-5, 1e-9), (1e-4, 1e-10), (1e-4, 1e-8))
)
"""Options of a step, tried in this order. Most steps need no path of mu. Where many contacts open and close, the way at
a small mu is in short parts, and at a larger one minima of distances split and merge without end: a minimum about to
split has one force or two beside each other, and there may be no equilibrium with either. The curvature below which
this is so falls with the root of the gap, so few are left at the end of a path, and others at another end."""
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


def _without_forces(problem: Problem, centre: Array, normal: Array) -> FiniteSolution:
    """Rings at rest with these centres (n, 3) in mm and normals (n, 3), without forces."""
    task = problem.task(1.0)
    touching = task.find(problem.placed(centre, normal), FiniteOptions.reach)
    found = Found(touching, np.zeros(len(touching.gap)), "converged", 0.0, ())
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
    problem = Problem(start.mesh, force, held, at, start.is_space, tuple(walls))
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
    for options in STEP:
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


def _forces(start: FiniteSolution, task: Task, touching: Touching, mu: float) -> Array:
    """Forces (m,) of contacts at the start, without units: those of each pair shared out as on the central path."""
    pairs, force = start.contacts.pairs, start.contacts.force
    row = of_pairs(touching.key, pairs[:, 0] * len(touching.placed.x) + pairs[:, 1])
    total = np.bincount(row[row >= 0], force[row >= 0] / task.unit, minlength=len(touching.key))
    return touching.shared(np.asarray(total, float), mu)
