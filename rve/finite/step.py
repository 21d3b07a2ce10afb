"""A time step of every ring: the solver of finite meshes with the term of inertia added.

    minimise  |y - y_hat|^2_W / 2 - f.y   subject to gap >= 0

A ring that does not spin about its axis moves like two points of its mass: its centre, and a point on its axis at the
radius of gyration about a diameter. So places y (2 n + b, 3) are the centres, then the vectors from the centres to
these points, then the centres of b balls, and differences in time are the same for all. Iterations are those of
`solve`: no gap closes, no wire passes through another, and links stay intact.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rve.common import Array, Flags, Index
from rve.finite.contacts import MeshContacts, find_mesh_contacts, find_rows, nearest_contacts
from rve.finite.layout import RingLayout
from rve.finite.newton import gradients, spread
from rve.finite.problem import FiniteOptions, HalfSpace, Obstacle, Problem, RingInertia, RoundBody, ScaledProblem
from rve.finite.solution import FiniteSolution, SolverResult, as_solution
from rve.finite.solve import solve_near
from rve.geometry.ring_pair import cross, rotation

STEP = tuple(
    FiniteOptions(tolerance=1e-10, retries=0, max_iterations=100, first=first, last=last)
    for first, last in ((1e-8, 1e-8), (1e-6, 1e-8), (1e-4, 1e-8), (1e-5, 1e-9), (1e-4, 1e-10))
)
"""Options of a step, tried in this order. Where many contacts open and close, steps at a small mu are short, and at a
larger one minima of distances may split and merge without end. The curvature below which that happens falls with the
root of the gap, so few such minima are left at the end of a path, and others at another."""
NEAR = 0.04
"""Largest difference of the ways of two rings without forces, in r1, up to which a step needs no path of mu: below, 3
to 6 iterations do, where a path takes 8 to 14; beyond 0.1 that takes 30 on average, and a path 18."""


@dataclass(frozen=True, eq=False)
class RingStep:
    """The end of a time step.

    rings: places, contacts, forces of supports and walls, status. pushes (2 n + b, 3): forces in N on `ring_places`, of
    contacts and of the constraint that axes keep their length. touched: sum of contact forces times the closing of
    their gaps, N mm.
    """

    rings: FiniteSolution
    pushes: Array
    touched: float


def ring_places(rings: FiniteSolution) -> Array:
    """Places (2 n + b, 3) in mm: centres, vectors of one radius of gyration along the axes, centres of balls."""
    balls = np.array([wall.place for wall in rings.walls if isinstance(wall, RoundBody)]).reshape(-1, 3)
    return np.concatenate([rings.centre, rings.mesh.gyration_mm * rings.normal, balls])


def slack_rings(mesh: RingLayout, *, space: bool = True, walls: Sequence[HalfSpace] = ()) -> FiniteSolution:
    """The slack weave at rest, without forces, its centres in the plane z = 0 about those of the reference."""
    none = np.zeros((len(mesh.X), 3))
    problem = Problem(mesh, none, none > 0.0, none, space, tuple(walls))
    centre, normal = mesh.slack()
    centre[:, :2] += (mesh.X - centre[:, :2]).mean(axis=0)
    return _without_forces(problem, centre, normal)


def with_bodies(rings: FiniteSolution, bodies: Sequence[RoundBody]) -> FiniteSolution:
    """The rings with balls that exert no force; a ball that cuts a ring makes `contacts.min_gap_mm` negative."""
    none = np.zeros((len(bodies), 3))
    walls, wall_force = (*rings.walls, *bodies), np.concatenate([rings.wall_force, none])
    problem = Problem(rings.mesh, rings.load, rings.load > 0.0, rings.centre, rings.is_space, walls)
    gap = _without_forces(problem, rings.centre, rings.normal).contacts.min_gap_mm
    contacts = replace(rings.contacts, min_gap_mm=gap)
    return replace(rings, walls=walls, wall_force=wall_force, contacts=contacts)


def _without_forces(problem: Problem, centre: Array, normal: Array) -> FiniteSolution:
    """Rings at rest with these centres (n, 3) in mm and normals (n, 3), without forces."""
    scaled = problem.scaled(1.0)
    contacts = scaled.find(problem.pose(centre, normal), FiniteOptions.reach)
    return as_solution(problem, scaled, SolverResult(contacts, np.zeros(len(contacts.gap)), "converged", 0.0, ()))


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

    weight (2 n + b,): W of `ring_places`, for Euler's method mass over the square of the step, N/mm; aim (2 n + b, 3):
    y_hat, the places without forces, mm. Nothing need hold the mesh. walls: as many as at the start, half-spaces where
    they are at the end, balls where they are at the start. A step that has not converged has its status.
    """
    problem = Problem(start.mesh, force, held, at, start.is_space, tuple(walls))
    n, radius = len(start.centre), start.mesh.gyration_mm
    scaled, least = _with_inertia(problem, weight, aim, ring_places(start))
    pose = replace(problem, walls=start.walls).pose(start.centre, start.normal)
    contacts = find_mesh_contacts(pose, scaled.linked, scaled.wire, FiniteOptions.reach)
    way, pair = (aim[:n] - start.centre) / start.mesh.cell.r1, (contacts.a < n) & (contacts.b < n)
    apart = np.linalg.norm(way[contacts.a[pair]] - way[contacts.b[pair]], axis=1).max(initial=0.0)
    for options in STEP[1:] if apart > NEAR else STEP:
        options = replace(options, tolerance=max(options.tolerance, least))
        result = solve_near(scaled, contacts, _forces(start, scaled, contacts, options.first), options)
        if result.status == "converged":
            break
    rings, con = as_solution(problem, scaled, result), result.contacts
    row = nearest_contacts(con, contacts)
    closing = np.maximum(np.where(row >= 0, contacts.gap[row], FiniteOptions.reach) - con.gap, 0.0)
    pushes = scaled.unit * spread(con, gradients(con), result.force)
    torque = start.mesh.cell.r1 * rotation(rings.normal, pushes[:n, 3:])
    tension = weight[n : 2 * n] * (rings.normal * (radius * rings.normal - aim[n : 2 * n])).sum(axis=1)
    axes = cross(torque, rings.normal) / radius + tension[:, None] * rings.normal
    pushes = np.concatenate([pushes[:n, :3], axes, pushes[_balls(problem), :3]])
    return RingStep(rings, pushes, scaled.unit * start.mesh.cell.r1 * float(result.force @ closing))


def _balls(problem: Problem) -> Index:
    """Rows of the balls in the poses of a problem."""
    return len(problem.force) + np.flatnonzero([isinstance(wall, RoundBody) for wall in problem.walls])


def _with_inertia(problem: Problem, weight: Array, aim: Array, places: Array) -> tuple[ScaledProblem, float]:
    """The problem without units with the inertia of rings at `places`, and the residual of places to round-off."""
    mesh, r1, n = problem.mesh, problem.mesh.cell.r1, len(problem.force)
    inert = weight[:, None] * np.abs(aim - places)
    load = float(np.abs(problem.force).sum() + np.abs([wall.load for wall in problem.walls]).sum() + inert.sum())
    load = max(load, 1e-9 * r1 * float(weight.sum()))  # without any force: that of a tiny move of all rings
    scaled, radius, none = problem.scaled(load), mesh.gyration_mm, np.zeros((len(problem.walls), 3))
    place, normal = (np.concatenate([part, none]) for part in (aim[:n] / r1, aim[n : 2 * n] / radius))
    turned = weight[n : 2 * n] * radius[:, 0] ** 2
    mass, rotary = (np.append(part, none[:, 0]) for part in (weight[:n], turned))
    balls = _balls(problem)
    mass[balls], place[balls] = weight[2 * n :], aim[2 * n :] / r1
    inertia = RingInertia(mass * r1 / scaled.unit, place, rotary / (scaled.unit * r1), normal)
    # Guard points would come and go from step to step; with inertia the matrix needs none.
    least = np.finfo(float).eps * float(weight @ np.abs(aim).max(axis=1)) / load
    return replace(scaled, inertia=inertia, guard_points=False, wide=False), least


def _forces(start: FiniteSolution, scaled: ScaledProblem, contacts: MeshContacts, mu: float) -> Array:
    """Forces (m,) of contacts at the start, without units: of each pair in the proportions of the central path."""
    pairs, force = start.contacts.pairs, start.contacts.force
    row = find_rows(contacts.key, pairs[:, 0] * len(contacts.pose.x) + pairs[:, 1])
    total = np.bincount(row[row >= 0], force[row >= 0] / scaled.unit, minlength=len(contacts.key))
    return contacts.share_forces(np.asarray(total, float), mu)
