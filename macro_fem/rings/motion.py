"""Every ring in motion: steps by `rve.step_rings`, with the differences, account and pace of `macro_fem.motion`.

Places x (2 n, 3) of a moment are those of `rve.ring_places`: n centres, and n points of the same masses on the axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from macro_fem.motion.account import Account, Worked, next_account
from macro_fem.motion.masses import TONNE
from macro_fem.motion.pace import UNPACED, Failed, MotionStatus, Pace, Run, collected, first_step, motion_of, stepped
from macro_fem.motion.scheme import Moment, difference
from macro_fem.motion.stage import let_go, scene_at
from macro_fem.motion.step import Forces
from macro_fem.rings.every_ring import EveryRing
from macro_fem.rings.ring_scene import RingScene, ring_scene, with_loads
from macro_fem.scene.moving import Thrown
from macro_fem.scene.schema import Scene
from macro_fem.scene.tables import Timed, Wind
from rve import FiniteOptions, FiniteSolution, ring_places, slack_rings, step_rings
from rve.common.errors import InputError, NotConverged
from rve.common.types import Array

HALVINGS = 6
"""How often a step that is not solved is taken in two halves."""
JUST_AFTER = 1e-9
"""Part of the duration after which supports count as those of the slack weave at the start."""
NEAR = 1e-6
"""Rings within this part of r1 of where supports hold them are there."""


@dataclass(frozen=True, eq=False)
class RingFrame:
    """The rings at a moment: places and velocities (2 n, 3), the rings with their contacts, the energy account, and how
    many iterations the step took."""

    moment: Moment
    rings: FiniteSolution
    account: Account
    asked: RingScene
    iterations: int = 0
    pace: Pace = UNPACED

    def paced(self, pace: Pace) -> RingFrame:
        """The frame, from which the run goes on like this."""
        return replace(self, pace=pace)


RingRun = Run[RingFrame]


class RingStage:
    """The loads, supports and walls of the rings at the times of a run."""

    def __init__(self, scene: Scene, first: RingScene) -> None:
        self.scene, self.first, self.last = scene, first, first
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


def solve_ring_motion(scene: Scene, who: EveryRing | None = None) -> RingRun:
    """Every ring of the scene over the duration of [motion], from rest.

    start = "hung": the rings in equilibrium under loads and moves at t = 0; "reference": the slack weave. InputError
    for what cannot begin, NotConverged where there is no such equilibrium. A step that fails ends the run with a
    status; the frames so far are kept, as they are when Ctrl-C stops it.
    """
    return collected(scene, ring_frames(scene, who or EveryRing()))


def ring_frames(scene: Scene, who: EveryRing) -> Iterator[RingFrame]:
    """The frames of `solve_ring_motion`, each as soon as it is known; the first one is that at the start."""
    motion = motion_of(scene)
    if scene.of(Thrown):
        raise InputError(f"{scene.source}: [[body]]: every ring in motion meets floors and walls only, no bodies")
    if any(wind.speed is not None for wind in scene.of(Wind)):
        raise InputError(f"{scene.source}: [load.wind] speed: every ring in motion takes a pressure, no speed")
    first = ring_scene(scene_at(scene, 0.0), who.rings)
    stage = RingStage(scene, first)
    after = JUST_AFTER * motion.duration  # supports that let go at t = 0 hold nothing then
    rings = _hung(first, who) if motion.start == "hung" else _slack(stage.at(after), who.space)

    def advance(frame: RingFrame, before: Moment | None, h: float) -> RingFrame:
        return next_ring_frame(stage, motion.damping, frame, before, h)

    start = first_ring_frame(stage.at(0.0), rings).paced(Pace(first_step(motion)))
    size = float(np.hypot(*np.ptp(first.mesh.X, axis=0)))
    yield from stepped(motion, start, advance, size, f"{len(rings.centre)} rings")


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


def first_ring_frame(asked: RingScene, rings: FiniteSolution) -> RingFrame:
    """Rings at rest at t = 0."""
    places = ring_places(rings)
    potential = -float((_weights(asked) * rings.centre).sum())
    return RingFrame(Moment(0.0, places, np.zeros_like(places)), rings, Account(potential=potential), asked)


def _weights(asked: RingScene) -> Array:
    """Weights (n, 3) of rings and bars, N."""
    return np.asarray(asked.mass[:, None] * np.array(asked.scene.load.acceleration))


def next_ring_frame(
    stage: RingStage, damping: float, frame: RingFrame, before: Moment | None, h: float, halvings: int = HALVINGS
) -> RingFrame:
    """The frame after a step h, or after its two halves where it is not solved; Failed where these are not either."""
    now, asked = frame.moment, stage.at(frame.moment.t + h)
    change = difference(now, before, h)
    mass, damped = TONNE * asked.mass, damping * change.beta_h
    weight = mass * (1.0 + damped) / change.beta_h**2
    aim = (change.x_hat + damped * change.X) / (1.0 + damped)
    end = step_rings(frame.rings, weight, aim, asked.force, asked.held, asked.at, walls=asked.walls)
    rings, n = end.rings, len(mass)
    if rings.status != "converged":
        if not halvings:
            raise Failed(
                MotionStatus.INFEASIBLE if rings.way_left_mm > 0.0 else MotionStatus.STALLED,
                f"the step to {now.t + h:.6g} s ended {rings.status} at a residual of {rings.kkt_residual:.1e}: "
                f"use a smaller step",
            )
        half = next_ring_frame(stage, damping, frame, before, 0.5 * h, halvings - 1)
        return next_ring_frame(stage, damping, half, now, 0.5 * h, halvings - 1)
    none = np.zeros((n, 3))
    dead = np.concatenate([_weights(asked), none])
    forces = Forces(dead, np.concatenate([asked.force, none]) - dead, None, damping)
    way = [new.offset - old.offset for new, old in zip(asked.walls, frame.asked.walls, strict=True)]
    moved = sum(float(push @ wall.unit) * d for push, wall, d in zip(rings.wall_force, asked.walls, way, strict=True))
    worked = Worked(np.concatenate([rings.reaction, none]), end.pushes, moved=moved, touched=end.touched)
    x = ring_places(rings)
    account = next_account(frame.account, np.tile(mass, 2), change, now, forces, x, worked)
    return RingFrame(Moment(now.t + h, x, change.velocity(x)), rings, account, asked, rings.iterations)
