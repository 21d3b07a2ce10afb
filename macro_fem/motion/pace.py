"""How a run in motion goes on, whatever moves: its steps, impacts, and how it ends."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Generic, TypeVar

import numpy as np

from macro_fem.motion.account import Account
from macro_fem.motion.scheme import Moment, predicted
from macro_fem.motion.stage import let_go, scene_at
from macro_fem.scene.moving import Ball, Motion, Thrown
from macro_fem.scene.schema import Scene
from macro_fem.scene.tables import Timed
from rve.common import InputError, tell

FIRST_STEPS = 400
"""Steps of the whole duration with which a run without a step begins."""
SMALLEST = 1e-4
"""Least step of such a run over the first one. Impacts are met by smaller steps, down to this one."""
IMPACT, LEAST_IMPACT = 0.3, 1e-2
"""Part of the loss by locking that a step must lose for good to count as an impact, and that loss over the largest
kinetic energy. Smaller ones are steps after one of Euler's, whose first-order error fades, and small rebounds."""
GAIN = 1e-3
"""Part of the largest kinetic energy that a step may gain: more is a rebound of the impact of the step before."""
SAFETY, LEAST_CHANGE, MOST_CHANGE = 0.9, 0.3, 1.5
"""A step follows the cube root of its error; changes beyond 1 + sqrt(2) would make BDF2 unstable."""


class MotionStatus(StrEnum):
    """How a run ended."""

    CONVERGED = "converged"
    STOPPED = "stopped"
    STALLED = "stalled"
    INFEASIBLE = "infeasible"


@dataclass(frozen=True, eq=False)
class Pace:
    """How a run goes on: the next step `h`, s; the moment before the frame's own, None at the start; `most`, the
    largest kinetic energy so far, N mm; and whether the next step is Euler's, as at the start."""

    h: float
    last: Moment | None = None
    most: float = 0.0
    is_euler: bool = True


@dataclass(frozen=True, eq=False, kw_only=True)
class Frame:
    """What a run knows of a moment: places and velocities, the energy account, how the run goes on from it, and how
    many iterations the step took."""

    moment: Moment
    account: Account
    pace: Pace = Pace(0.0)
    iterations: int = 0


F = TypeVar("F", bound=Frame)
Advance = Callable[[F, Moment | None, float], F]
"""The frame after a step of h s from a frame, with the moment before it, None for a step of Euler's method."""
HasKink = Callable[[float, float], bool]
"""Whether what moves supports or obstacles has a kink between two times, s."""


@dataclass(frozen=True, eq=False)
class Run(Generic[F]):
    """A scene in motion: one frame per step, the first one at the start, and how it ended."""

    scene: Scene
    frames: tuple[F, ...]
    status: MotionStatus
    message: str
    wall_s: float

    @property
    def bodies(self) -> tuple[Ball, ...]:
        """The bodies of the scene, in the order of their nodes, which are the last ones of each moment."""
        return self.scene.of(Ball)


class Failed(Exception):
    """A step that cannot be solved ends the run; the frames so far are kept."""

    def __init__(self, status: MotionStatus, message: str) -> None:
        super().__init__(message)
        self.status = status


def motion_of(scene: Scene) -> Motion:
    """What the scene says of its motion; InputError if nothing moves."""
    if scene.motion is None:
        raise InputError(f"{scene.source}: [motion]: is missing, so nothing moves; give its duration in s")
    return scene.motion


def collected(scene: Scene, frames: Iterator[F]) -> Run[F]:
    """The frames until the run ends, a step fails or Ctrl-C stops it."""
    begin, kept = time.perf_counter(), list[F]()
    status, message = MotionStatus.CONVERGED, "every step is solved"
    try:
        for frame in frames:
            kept.append(frame)
    except Failed as failed:
        status, message = failed.status, str(failed)
    except KeyboardInterrupt:
        if not kept:
            raise
        status, message = MotionStatus.STOPPED, f"stopped after {kept[-1].moment.t:.6g} s; the steps so far are kept"
    return Run(scene, tuple(kept), status, message, time.perf_counter() - begin)


def first_step(motion: Motion) -> float:
    """The step that a run begins with, s."""
    return motion.step or motion.duration / FIRST_STEPS


def stepped(scene: Scene, start: F, advance: Advance[F], size: float, what: str) -> Iterator[F]:
    """The frames from `start` to the end of the duration; size of what moves in mm; `what` is told to move.

    What hangs at rest stays there until something changes. Steps end where a support lets go, after which the first one
    is Euler's. Steps without a length of their own also end at the times of histories: long ones at rest would pass a
    gust unseen.
    """
    motion, frame = motion_of(scene), start
    near = 1e-9 * motion.duration
    releases = {item.release for item in scene.support if item.release is not None}
    stops = releases | ({t for item in scene.of(Timed) for t, _ in item.history} if motion.step is None else set())

    def advanced(frame: F, before: Moment | None, h: float) -> F:
        if not _is_at_rest(scene, frame, h):
            return advance(frame, before, h)
        return replace(frame, moment=replace(frame.moment, t=frame.moment.t + h), iterations=0)

    kinks = [t for item in (*scene.support, *scene.obstacle) for t, _ in item.history]

    def has_kink(begin: float, end: float) -> bool:
        return any(begin - near <= t < end - near for t in kinks)

    yield frame
    while (t := frame.moment.t) < motion.duration - near:
        tell(f"{what} in motion, {t:.4g} of {motion.duration:.4g} s", t / motion.duration)
        if any(abs(t - release) <= near for release in releases):
            frame = replace(frame, pace=replace(frame.pace, is_euler=True))
        left = min([motion.duration, *(stop for stop in stops if stop > t + near)]) - t
        frame = accurate_frame(motion, frame, advanced, size, left, has_kink)
        yield frame


def accurate_frame(motion: Motion, frame: F, advance: Advance[F], size: float, left: float, has_kink: HasKink) -> F:
    """The next frame, by a step that is as accurate as asked for and no longer than `left`, s, to the next stop."""
    least = SMALLEST * first_step(motion)
    now, pace = frame.moment, frame.pace
    h, before = pace.h, None if pace.is_euler else pace.last
    while True:
        h = left / max(1, np.ceil(left / h - 1e-9)) if left < 2.0 * h else h
        following = advance(frame, before, h)
        is_impact = _is_impact(frame, following, before, has_kink)
        if is_impact and before is not None:
            following = advance(frame, None, h)
        after = motion.step or h
        if motion.step is None:
            guess = predicted(now, pace.last, h)
            away = np.sqrt(((following.moment.x - guess) ** 2).sum(axis=1).mean()) / size
            factor = SAFETY * (motion.accuracy / max(away, 1e-300)) ** (1.0 / 3.0)
            if away > motion.accuracy and h > least:
                h = max(least, h * min(0.5, max(LEAST_CHANGE, factor)))
                continue
            after = max(least, h * min(MOST_CHANGE, max(LEAST_CHANGE, factor)))
        most = max(pace.most, following.account.kinetic)
        is_euler = is_impact or motion.scheme == "euler"
        return replace(following, pace=Pace(after, now, most, is_euler))


def _is_at_rest(scene: Scene, frame: Frame, h: float) -> bool:
    """Whether a step h leaves the answer at rest, because nothing else acts at its end than at its start."""
    t = frame.moment.t
    has_moved = frame.pace.most > 0.0 or frame.moment.v.any()
    if has_moved or motion_of(scene).start != "hung" or scene.of(Thrown):
        return False
    before, after = ((scene_at(scene, at).items, let_go(scene, at)) for at in (t, t + h))
    return before == after


def _is_impact(start: Frame, end: Frame, before: Moment | None, has_kink: HasKink) -> bool:
    """Whether a step takes energy for good, against the largest kinetic energy so far.

    In smooth motion on the locked surface the loss by locking, of order h^2, and the gain of the scheme cancel to h^3.
    An impact keeps part of its loss. Differences over it would make rings that lock and nodes that touch rebound, which
    also shows in a gain. Euler's step then takes its place, and the next step is Euler's as well. What sets off at
    once while it touches or is taut closes no gap: there the loss of the scheme tells. Of Euler's own steps, which
    always lose, that counts in which nearly all motion begins.
    """
    most, kinetic = start.pace.most, end.account.kinetic
    locking = end.account.lost_by_locking - start.account.lost_by_locking
    scheme = end.account.lost_by_scheme - start.account.lost_by_scheme
    lost = locking + scheme
    if before is None:
        begins = max(most, start.account.kinetic) < LEAST_IMPACT * kinetic
        return begins and locking > LEAST_IMPACT * kinetic and lost > IMPACT * locking
    is_lost = locking > LEAST_IMPACT * most and lost > IMPACT * locking
    is_jump = scheme > LEAST_IMPACT * max(most, kinetic) and has_kink(before.t, end.moment.t)
    return is_lost or is_jump or lost < -GAIN * most
