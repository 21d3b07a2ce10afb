"""What acts in a scene in motion at a moment: histories, masses lumped at the nodes, weights, winds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from macro_fem.drag import senses, wind_density, with_wind
from macro_fem.fem.assembly import load_vector
from macro_fem.motion.step import Forces, Moment
from macro_fem.problem import CurtainProblem
from macro_fem.scene.loads import BREEZE, PER_MM2, areal_mass, bar_masses, breeze, nodal_forces
from macro_fem.scene.moving import Ball, at_time
from macro_fem.scene.obstacles import unit
from macro_fem.scene.schema import Scene
from macro_fem.scene.tables import Timed, Wind
from macro_fem.solvers.cones import green_strain
from rve.common import Array, InputError

TONNE = 1e-3
"""N s2/mm per kg: with lengths in mm and forces in N."""


def scene_at(scene: Scene, t: float) -> Scene:
    """The scene without its motion and bodies, as its histories say at the time t."""
    items = tuple(at_time(item, t) if isinstance(item, Timed) else item for item in scene.items)
    solver = replace(scene.solver, space=scene.solver.space or scene.in_space, bounds=False, adapt=0)
    kept = tuple(item for item in items if not isinstance(item, Ball))
    return replace(scene, items=kept, motion=None, solver=solver)


def let_go(scene: Scene, t: float) -> frozenset[int]:
    """Numbers of the supports that have let go before the end of a step at t."""
    times = [np.inf if item.release is None else item.release for item in scene.support]
    return frozenset(number for number, release in enumerate(times) if release < t * (1.0 - 1e-9))


def mesh_masses(problem: CurtainProblem) -> Array:
    """Masses (n_nodes,) of the mesh alone, N s2/mm; InputError for P2."""
    scene, disc = problem.scene, problem.disc
    if disc.element != "P1":
        raise InputError(f"{scene.source}: [mesh] element = {disc.element!r}: motion needs P1")
    per_area = areal_mass(scene, problem.law.cell)[0] * PER_MM2 * TONNE
    return np.asarray(per_area * load_vector(disc, np.array([1.0]))[:, 0])


def masses_of(problem: CurtainProblem, balls: tuple[Ball, ...] = ()) -> Array:
    """Masses (n,) of nodes, with the bars in edges, and of bodies, N s2/mm; InputError for P2."""
    own = mesh_masses(problem) + TONNE * bar_masses(problem.scene, problem.mesh, problem.disc)
    return np.append(own, [TONNE * ball.mass for ball in balls])


def weights_of(problem: CurtainProblem, balls: tuple[Ball, ...]) -> Array:
    """Weights of nodes and bodies (n, d), N."""
    scene = problem.scene
    own = nodal_forces(scene, problem.mesh, problem.disc, problem.law.cell, 0.0)
    g = np.array(scene.load.acceleration[: scene.d])
    return np.vstack([own, *[ball.mass * g[None] for ball in balls]])


def stored_energy(problem: CurtainProblem, F: Array) -> float:
    """The stored energy of an elastic curtain, N mm."""
    return float(problem.fem.disc.weight @ problem.elastic_law.response(green_strain(F)).energy)


def forces_at(problem: CurtainProblem, balls: tuple[Ball, ...], now: Moment, damping: float) -> Forces:
    """Forces on nodes and bodies at the end of a step; winds with a speed by the velocity relative to the mesh."""
    dead, n = weights_of(problem, balls), problem.disc.n_nodes
    live, drag = np.zeros_like(dead), None
    if problem.winds:
        still = with_wind(problem, np.zeros((problem.disc.n_points, 3)))
        live[:n] = still.force - dead[:n]
        drag = np.zeros((len(dead), 3, 3))
        for wind in problem.winds:
            one = replace(problem, winds=(breeze(wind),))
            pressed = with_wind(still, wind_density(one, now.x[:n], senses(one))).force - still.force
            own, block = relative_wind(wind, pressed, now.v[:n])
            live[:n] += own
            drag[:n] += block
    else:
        live[:n] = problem.force - dead[:n]
    resist = np.where(np.arange(len(dead)) < n, damping, 0.0)  # not of bodies
    return Forces(dead, live, drag, resist)


def relative_wind(wind: Wind, force: Array, v: Array) -> tuple[Array, Array]:
    """The force (n, 3) of a wind on still nodes, and the blocks C (n, 3, 3) of -C v that the velocity relative to the
    wind adds: (U - v.w) |U - v_n.w| / W^2 of the `force` (n, 3) of `breeze(wind)`, with the speed U along w, W that of
    the breeze, and the last velocities v_n.

    Of wind that follows, whose force is not along w, the last velocities count alone.
    """
    none = np.zeros((len(force), 3, 3))
    if wind.speed is None:
        return force, none
    U, W, w = 1e3 * wind.speed, 1e3 * (wind.speed or BREEZE), unit(wind.direction)
    share = np.abs(U - v @ w) / W
    if wind.follows:
        return (share * (U - v @ w) / W)[:, None] * force, none
    return (share * U / W)[:, None] * force, (share / W)[:, None, None] * force[:, :, None] * w
