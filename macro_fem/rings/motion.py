"""Every ring in motion: steps by `rve.step_rings`, with the differences, account and pace of `macro_fem.motion`.

Places x (2 n + b, 3) of a moment are those of `rve.ring_places`: n centres, n points of the same masses on the axes, b
centres of balls.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from macro_fem.motion.account import Account, Worked, kinetic_energy, next_account
from macro_fem.motion.pace import Failed, Frame, MotionStatus, Pace, Run, collected, first_step, motion_of, stepped
from macro_fem.motion.scheme import Moment, difference
from macro_fem.motion.stage import TONNE, let_go, relative_wind, scene_at
from macro_fem.motion.step import Forces
from macro_fem.rings.every_ring import EveryRing
from macro_fem.rings.ring_scene import RingScene, ring_scene, with_loads
from macro_fem.scene.loads import PER_MM2, areal_mass
from macro_fem.scene.moving import Ball
from macro_fem.scene.schema import Scene
from macro_fem.scene.tables import Timed
from rve import FiniteOptions, FiniteSolution, RoundBody, ring_places, slack_rings, step_rings, with_bodies
from rve.common import Array, InputError, NotConverged

HALVINGS = 6
"""How often a step that is not solved is taken in two halves."""
JUST_AFTER = 1e-9
"""Part of the duration after which supports count as those of the slack weave at the start."""
NEAR = 1e-6
"""Rings within this part of r1 of where supports hold them are there."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RingFrame(Frame):
    """Rings, at places and with velocities (2 n + b, 3), with their contacts, and what was asked of them."""

    rings: FiniteSolution
    asked: RingScene


RingRun = Run[RingFrame]


class RingStage:
    """The loads, supports and walls of the rings at the times of a run, and the balls at its start."""

    def __init__(self, scene: Scene, first: RingScene) -> None:
        self.scene, self.first, self.last = scene, first, first
        self.balls = scene.of(Ball)
        g = np.array(first.scene.load.acceleration)
        weights = [tuple((ball.mass * g).tolist()) for ball in self.balls]
        pairs = zip(self.balls, weights, strict=True)
        self.bodies = tuple(RoundBody(ball.at, ball.radius, weight, ball.name) for ball, weight in pairs)
        self.released: frozenset[int] | None = None
        self.changes = any(isinstance(item, Timed) and item.history for item in scene.items)

    def at(self, t: float) -> RingScene:
        """The rings as they are asked for at a time."""
        released = let_go(self.scene, t)
        if self.changes or released != self.released:
            assert self.first.info is not None
            self.last = with_loads(scene_at(self.scene, t), self.first.info, self.first.mesh, released)
            self.released = released
        return self.last

    def masses(self, asked: RingScene) -> Array:
        """Masses (2 n + b,) of what `ring_places` are the places of, N s2/mm: bars move with rings and do not turn."""
        own = areal_mass(asked.scene, asked.info)[0] * PER_MM2 * asked.mesh.area
        return TONNE * np.concatenate([asked.mass, own, [ball.mass for ball in self.balls]])

    def weights(self, asked: RingScene) -> Array:
        """Weights (2 n + b, 3) of what `ring_places` are the places of, N."""
        own = asked.mass[:, None] * np.array(asked.scene.load.acceleration)
        return np.concatenate([own, np.zeros_like(own), np.array([one.load for one in self.bodies]).reshape(-1, 3)])


def solve_ring_motion(scene: Scene, who: EveryRing | None = None, start: RingFrame | None = None) -> RingRun:
    """Every ring of the scene over the duration of [motion], from rest or from a frame of a run before.

    start = "hung": the rings in equilibrium under loads and moves at t = 0; "reference": the slack weave. InputError
    for what cannot begin, NotConverged where there is no such equilibrium. A step that fails ends the run with a
    status; the frames so far are kept, as they are when Ctrl-C stops it.
    """
    return collected(scene, ring_frames(scene, who or EveryRing(), start))


def ring_frames(scene: Scene, who: EveryRing, start: RingFrame | None = None) -> Iterator[RingFrame]:
    """The frames of `solve_ring_motion`, each as soon as it is known; the first one is that at the start."""
    motion = motion_of(scene)
    first = ring_scene(scene_at(scene, 0.0), who.rings)
    stage = RingStage(scene, first)

    def advance(frame: RingFrame, before: Moment | None, h: float) -> RingFrame:
        return next_ring_frame(stage, motion.damping, frame, before, h)

    if start is None:
        after = JUST_AFTER * motion.duration  # supports that let go at t = 0 hold nothing then
        rings = _hung(first, who) if motion.start == "hung" else _slack(stage.at(after), who.space)
        start = replace(first_ring_frame(stage, rings), pace=Pace(first_step(motion)))
    size = float(np.hypot(*np.ptp(first.mesh.X, axis=0)))
    yield from stepped(scene, start, advance, size, f"{len(start.rings.centre)} rings")


def _hung(asked: RingScene, who: EveryRing) -> FiniteSolution:
    """The rings in equilibrium at t = 0."""
    scene = asked.scene
    if not scene.support:
        raise InputError(f"{scene.source}: [motion] start = 'hung': nothing holds the curtain, use 'reference'")
    if who.start == "disk":
        raise InputError(f"{scene.source}: --start disk: is for rings at rest; a motion starts from the slack weave")
    found = asked.solve(space=who.space, options=FiniteOptions(by_motion=who.start == "motion"))
    if found.status != "converged":
        raise NotConverged(f"{scene.source}: the rings at rest at t = 0 are {found.status}: {found.message}")
    return found


def _slack(asked: RingScene, space: bool) -> FiniteSolution:
    """The slack weave at rest; InputError where supports hold its rings elsewhere, or walls cut it."""
    where = f"{asked.scene.source}: [motion] start = 'reference'"
    if asked.scene.in_space and not space:
        raise InputError(f"{asked.scene.source}: {asked.scene.space_reason}: centres cannot stay there")
    rings = slack_rings(asked.mesh, space=space, walls=asked.walls)
    away = float(np.abs(np.where(asked.held, asked.at - rings.centre, 0.0)).max(initial=0.0))
    if away > NEAR * asked.mesh.cell.r1:
        raise InputError(
            f"{where}: supports hold rings up to {away:.4g} mm from where they are in the slack weave; use 'hung'"
        )
    if rings.contacts.min_gap_mm <= 0.0:
        raise InputError(f"{where}: a floor or wall cuts the slack weave; move it away")
    return rings


def first_ring_frame(stage: RingStage, rings: FiniteSolution) -> RingFrame:
    """Rings at rest at t = 0, and the balls as they are thrown; InputError for a ball that a ring is inside of."""
    asked, gap = stage.at(0.0), rings.contacts.min_gap_mm
    rings = with_bodies(rings, stage.bodies)
    if rings.contacts.min_gap_mm < min(gap, 0.0):
        raise InputError(f"{stage.scene.source}: [[body]]: rings are inside a body at the start; put it farther away")
    places, n = ring_places(rings), 2 * len(asked.mass)
    v = np.concatenate([np.zeros((n, 3)), np.array([ball.velocity for ball in stage.balls]).reshape(-1, 3)])
    potential = -float((stage.weights(asked) * places).sum())
    kinetic = kinetic_energy(stage.masses(asked), v)
    return RingFrame(moment=Moment(0.0, places, v), account=Account(kinetic, potential), rings=rings, asked=asked)


def next_ring_frame(
    stage: RingStage, damping: float, frame: RingFrame, before: Moment | None, h: float, halvings: int = HALVINGS
) -> RingFrame:
    """The frame after a step h, or after its two halves where it is not solved; Failed where these are not either."""
    now, asked = frame.moment, stage.at(frame.moment.t + h)
    change = difference(now, before, h)
    mass, n = stage.masses(asked), len(asked.mass)
    resist = np.where(np.arange(len(mass)) < 2 * n, damping, 0.0)  # not of balls
    damped = change.beta_h * resist[:, None]
    weight = mass * (1.0 + damped[:, 0]) / change.beta_h**2
    aim = (change.x_hat + damped * change.X) / (1.0 + damped)
    force = asked.force.copy()
    for wind, blown in asked.winds:
        own, block = relative_wind(wind, blown, now.v[:n])
        force += own - (block @ now.v[:n, :, None])[:, :, 0] - (0.0 if wind.speed == 0.0 else blown)
    end = step_rings(frame.rings, weight, aim, force, asked.held, asked.at, walls=(*asked.walls, *stage.bodies))
    rings = end.rings
    if rings.status != "converged":
        if not halvings:
            raise Failed(
                MotionStatus.INFEASIBLE if rings.way_left_mm > 0.0 else MotionStatus.STALLED,
                f"the step to {now.t + h:.6g} s ended {rings.status} at a residual of {rings.kkt_residual:.1e}: "
                f"use another step",
            )
        half = next_ring_frame(stage, damping, frame, before, 0.5 * h, halvings - 1)
        return next_ring_frame(stage, damping, half, now, 0.5 * h, halvings - 1)
    none, dead = np.zeros((len(mass) - n, 3)), stage.weights(asked)
    live = np.concatenate([force - dead[:n], none])
    forces = Forces(dead, live, None, resist)
    way = [new.offset - old.offset for new, old in zip(asked.walls, frame.asked.walls, strict=True)]
    moved = sum(float(push @ wall.unit) * d for push, wall, d in zip(rings.wall_force, asked.walls, way, strict=False))
    worked = Worked(np.concatenate([rings.reaction, none]), end.pushes, moved=moved, touched=end.touched)
    x = ring_places(rings)
    account = next_account(frame.account, mass, change, now, forces, x, worked)
    moment = Moment(now.t + h, x, change.velocity(x))
    return RingFrame(moment=moment, account=account, iterations=rings.iterations, rings=rings, asked=asked)
