"""Every ring in motion: steps by `rve.finite.step_rings`, with the differences, account and pace of a curtain.

Places x (2 n + b, 3) of a moment are those of `rve.finite.ring_places`: n centres, n points of the same masses on the
axes, b centres of balls.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from macro_fem.motion.pace import End, Failed, Frame, Kept, Mover
from macro_fem.motion.stage import TONNE, relative_wind, scene_at
from macro_fem.motion.step import Account, Moment, StepEnd, TimeStep, predicted
from macro_fem.motion_summary import MotionNumbers, RingMotionSummary
from macro_fem.output.images import Draw
from macro_fem.rings.every_ring import EveryRing, ring_supports
from macro_fem.rings.ring_scene import RingScene, ring_scene, with_loads
from macro_fem.scene.loads import BREEZE, PER_MM2, areal_mass
from macro_fem.scene.scene import Scene
from macro_fem.solvers.path import times
from rve.common import Array, NotConverged, digits
from rve.finite import FiniteSolution, HalfSpace, RoundBody, ring_places, slack_rings, step_rings, with_bodies

NEAR = 1e-6
"""Rings within this part of r1 of where supports hold them are there."""
NOT_JUDGED = (
    "whether the rings hold is not known: every ring is rigid, and contact forces at impacts grow with shorter steps; "
    'macro_fem run with kind = "elastic" under [solver] judges the strength of the rings of a law'
)
"""What is said of a verdict of every ring in motion."""
KEPT = ("reaction", "wall_force", "kkt_residual")
"""What motion.npz has of the rings of a frame, beside their contacts."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RingFrame(Frame):
    """Rings, at places and with velocities (2 n + b, 3), with their contacts, and what was asked of them."""

    rings: FiniteSolution
    asked: RingScene

    @property
    def seen(self) -> tuple[Array, Array, Array, float]:
        rings = self.rings
        return rings.centre, rings.mesh.area, rings.reaction, rings.kkt_residual


class MovingRings(Mover[RingFrame, RingScene]):
    """Every ring of a scene, and its balls; what acts on it is what rings are asked for.

    start = "hung" of [motion]: rings in equilibrium under loads and moves at t = 0; "reference": the slack weave.
    """

    def __init__(self, scene: Scene, who: EveryRing | None = None) -> None:
        super().__init__(scene)
        self.who = who or EveryRing()
        self.first = ring_scene(scene_at(scene, 0.0), self.who.rings, at_rest=self.motion.start == "hung")
        self.what, self.size = f"{len(self.first.mesh.X)} rings", float(np.hypot(*np.ptp(self.first.mesh.X, axis=0)))
        g = np.array(self.first.scene.load.acceleration)
        weighed = ((ball, tuple((ball.mass * g).tolist())) for ball in self.balls)
        self.bodies = tuple(RoundBody(ball.at, ball.radius, weight, ball.name) for ball, weight in weighed)

    def act(self, t: float) -> RingScene:
        return with_loads(scene_at(self.scene, t), self.first.info, self.first.mesh, self.released)

    def masses(self, asked: RingScene) -> Array:
        """Masses (2 n + b,) of what `ring_places` are the places of, N s2/mm: bars move with rings and do not turn."""
        own = areal_mass(asked.scene, asked.info) * PER_MM2 * asked.mesh.weighing_area
        return TONNE * np.concatenate([asked.mass, own, [ball.mass for ball in self.balls]])

    def weights(self, asked: RingScene) -> Array:
        """Weights (2 n + b, 3) of what `ring_places` are the places of, N."""
        own = asked.mass[:, None] * np.array(asked.scene.load.acceleration)
        return np.concatenate([own, np.zeros_like(own), np.array([one.load for one in self.bodies]).reshape(-1, 3)])

    @cached_property
    def slack(self) -> FiniteSolution:
        """The slack weave beside nothing."""
        return slack_rings(self.first.mesh, space=self.who.space)

    def first_frame(self) -> RingFrame:
        if self.who.start == "disk":
            self.scene.refuse("--start disk: is for rings at rest; begin from the slack weave")
        if self.motion.start != "hung":
            return self.frame_of(self._slack())
        found = self.first.solve(space=self.who.space)
        if found.status != "converged":
            raise NotConverged(f"{self.scene.source}: the rings at rest at t = 0 are {found.status}: {found.message}")
        return self.frame_of(found)

    def _slack(self) -> FiniteSolution:
        """The slack weave at rest; InputError where supports hold its rings elsewhere, or walls cut it.

        Supports that let go at t = 0 hold nothing then.
        """
        asked, scene = self.at(self.near), self.scene
        where = "[motion] start = 'reference'"
        if asked.scene.in_space and not self.who.space:
            scene.refuse(f"{asked.scene.space_reason}: centres cannot stay there")
        rings, start = slack_rings(asked.mesh, space=self.who.space, walls=asked.walls), scene.start
        if start is not None:
            rings = with_bodies(replace(rings, centre=start.places(rings.centre), normal=rings.normal @ start.axes), ())
        away = float(np.abs(np.where(asked.held, asked.at - rings.centre, 0.0)).max(initial=0.0))
        if away > NEAR * asked.mesh.cell.r1:
            off = f"{digits(away, 4)} mm from where they are in the slack weave"
            scene.refuse(f"{where}: supports hold rings up to {off}; use 'hung'")
        if rings.contacts.min_gap_mm <= 0.0:
            scene.refuse(f"{where}: a floor or wall cuts the slack weave; move it away")
        return rings

    def frame_of(self, rings: FiniteSolution) -> RingFrame:
        """Rings at rest at t = 0, and the balls as they are thrown; InputError for a ball that a ring is inside of."""
        asked, gap = self.at(0.0), rings.contacts.min_gap_mm
        rings = with_bodies(rings, self.bodies)
        if rings.contacts.min_gap_mm < min(gap, 0.0):
            self.scene.refuse("[[body]]: rings are inside a body at the start; put it farther away")
        moment, account = self.at_start(ring_places(rings), self.masses(asked), self.weights(asked))
        return RingFrame(moment=moment, account=account, rings=rings, asked=asked)

    def next_frame(self, frame: RingFrame, before: Moment | None, h: float) -> RingFrame:
        now, asked = frame.moment, self.at(frame.moment.t + h)
        mass, n, dead = self.masses(asked), len(asked.mass), self.weights(asked)
        force, slows, ahead = asked.force.copy(), np.zeros(len(mass)), predicted(now, before, h).v[:n]
        for wind, blown in asked.winds:
            assert wind.speed is not None  # see `ring_scene`
            own, block = relative_wind(wind, blown, now.v[:n], ahead)
            slow = np.trace(
                block, axis1=1, axis2=2
            )  # one number for each ring: across the wind `ahead` makes up for it
            force += own - times(block, ahead) + slow[:, None] * ahead - (wind.speed / BREEZE) ** 2 * blown
            slows[:n] += slow
        none = np.zeros((len(mass) - n, 3))
        resist = np.where(np.arange(len(mass)) < 2 * n, self.motion.damping, 0.0)  # not of balls
        live, drag = np.concatenate([force - dead[:n], none]), slows[:, None, None] * np.eye(3)
        step = TimeStep(now, before, h, mass, dead, live, drag, resist)
        beta_h, X, _ = step.differences
        slowed = beta_h * (resist + slows / mass)[:, None]
        weight = mass * (1.0 + slowed[:, 0]) / beta_h**2
        aim = (step.x_hat + slowed * X) / (1.0 + slowed)
        end = step_rings(frame.rings, weight, aim, force, asked.held, asked.at, walls=(*asked.walls, *self.bodies))
        rings = end.rings
        if rings.status != "converged":
            words = f"the step to {now.t + h:.6g} s ended {rings.status} at a residual of {rings.kkt_residual:.1e}"
            status: End = "infeasible" if rings.way_left_mm > 0.0 else "stalled"
            raise Failed(status, f"{words}: use another step")
        self._check_balls(rings, now.t + h)
        moves = np.array([new.offset - old.offset for new, old in zip(asked.walls, frame.asked.walls, strict=True)])
        pushed = np.array([push @ wall.unit for push, wall in zip(rings.wall_force, asked.walls, strict=False)])
        supports = np.concatenate([rings.reaction, none])
        told = StepEnd(ring_places(rings), supports, end.pushes, pushed=pushed, moves=moves, touched=end.touched)
        done = step.finish(frame.account, told, frame.forces)
        return RingFrame(**vars(done), iterations=rings.iterations, rings=rings, asked=asked)

    def _check_balls(self, rings: FiniteSolution, t: float) -> None:
        """Failed where a ball would meet what balls beside a curtain by a law meet, and those beside rings do not."""
        for k, ball in enumerate(rings.walls):
            if isinstance(ball, HalfSpace):
                continue
            for other in rings.walls[:k]:  # half-spaces come before balls
                if isinstance(other, HalfSpace):
                    away = float(other.unit @ ball.place) - other.offset
                else:
                    away = math.dist(other.place, ball.place) - other.radius
                if away < (1.0 - NEAR) * ball.radius:
                    words = f"{ball.name} meets {other.name} before {t:.6g} s"
                    raise Failed("stalled", f"{words}: beside rings balls meet rings alone; end there, or ask a law")

    def peaks(self, frame: RingFrame) -> list[float]:
        """The largest contact force in N, the least gap in mm, whether links are intact, iterations, and the largest
        force of a support on a ring, N."""
        contacts, held = frame.rings.contacts, np.linalg.norm(frame.rings.reaction, axis=1)
        own = [float(contacts.force.max(initial=0.0)), contacts.min_gap_mm, contacts.links_intact, frame.iterations]
        return [*own, float(held.max(initial=0.0))]

    def summary(
        self, told: MotionNumbers, last: RingFrame, weakest: RingFrame, t: Array, peaks: Array
    ) -> RingMotionSummary:
        force, gap, intact, iterations, _ = peaks.T
        return RingMotionSummary(
            **told.parts(),
            holds=None,
            smallest_factor=None,
            weakest=None,
            weakest_place=None,
            at_s=weakest.moment.t,
            verdict_note=NOT_JUDGED,
            support_forces=ring_supports(weakest.asked, weakest.rings),
            peak_contact_force_N=float(force.max()),
            peak_contact_force_at_s=float(t[force.argmax()]),
            ring_count=len(last.rings.centre),
            centres="space" if last.rings.is_space else "plane",
            min_gap_mm=float(gap.min()),
            links_intact=bool(intact.all()),
            iterations=int(iterations.sum()),
        )

    @property
    def notes(self) -> list[str]:
        return list(self.first.notes)

    def pack(self, frame: RingFrame) -> Kept:
        rings = frame.rings
        return vars(rings.contacts) | {name: getattr(rings, name) for name in KEPT}

    def unpack(self, moment: Moment, account: Account, kept: Kept) -> RingFrame:
        asked, n = self.at(moment.t), len(self.first.mesh.X)
        axes, slack = moment.x[n : 2 * n], self.slack
        bodies = [body.moved(place) for body, place in zip(self.bodies, moment.x[2 * n :], strict=True)]
        rings = replace(
            slack,
            centre=moment.x[:n],
            normal=axes / np.linalg.norm(axes, axis=1)[:, None],
            load=asked.force,
            contacts=replace(slack.contacts, **{name: kept[name] for name in vars(slack.contacts)}),
            walls=(*asked.walls, *bodies),
            **{name: kept[name] for name in KEPT},
        )
        return RingFrame(moment=moment, account=account, rings=rings, asked=asked)

    def write_vtu(self, path: Path, frame: RingFrame) -> None:
        frame.rings.write_vtu(path)

    def views(self, frames: Sequence[RingFrame]) -> list[Draw]:
        rings = [frame.rings.drawn for frame in frames]
        return [partial(one.draw, series=rings) for one in rings]
