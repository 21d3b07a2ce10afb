"""How anything in motion goes on: its frames, one per step, how long steps are, impacts, and how a run ends."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from macro_fem.motion.stage import let_go, scene_at
from macro_fem.motion.step import Account, Moment, Reached, kinetic_energy, predicted
from macro_fem.motion_summary import MotionNumbers, MotionSummary
from macro_fem.output.images import Draw
from macro_fem.scene.moving import Ball
from macro_fem.scene.scene import Scene
from macro_fem.scene.tables import Load, Timed
from rve.common import Array, part_of

Kept = dict[str, Any]
"""Numbers and arrays by name, as a file of numpy has them."""
COLUMNS = (
    *("t_s", "mean_x_mm", "mean_y_mm", "mean_z_mm", "lowest_point_mm", "kinetic_N_mm", "potential_N_mm", "stored_N_mm"),
    *("work_N_mm", "lost_by_scheme_N_mm", "lost_by_locking_N_mm", "lost_by_damping_N_mm", "support_force_N"),
    "relative_gap",
)
"""Columns of motion.csv; support_force_N is the size of the sum of the forces of all supports."""


@dataclass(frozen=True)
class PaceOptions:
    """How long steps are."""

    first_steps: int = 400
    smallest: float = 1e-4
    """Of a run without a step: the duration over its first step, and its least step, which impacts are met by, over
    it."""
    impact: float = 0.3
    least_impact: float = 1e-2
    """Part of the loss by locking that a step must lose for good to count as an impact, and that loss over the largest
    kinetic energy. Smaller ones are steps after one of Euler's, whose first-order error fades, and small rebounds."""
    gain: float = 1e-3
    """Part of the largest kinetic energy that a step may gain: more is a rebound of the impact of the step before."""
    safety: float = 0.9
    least_change: float = 0.3
    most_change: float = 1.5
    """A step follows the cube root of its error; changes beyond 1 + sqrt(2) would make BDF2 unstable."""
    halvings: int = 6
    """How often a step that is not solved, or passes a body by, is taken in two halves."""


PACE = PaceOptions()


End = Literal["converged", "stopped", "stalled", "infeasible", "pierced"]
"""How a run ended."""


class Failed(Exception):
    """A step cannot be solved; its halves may be."""

    def __init__(self, status: End, message: str) -> None:
        super().__init__(message)
        self.status = status


@dataclass(frozen=True, eq=False, kw_only=True)
class Frame(Reached, ABC):
    """What a run knows of a moment, and how many iterations its step took.

    How it goes on: the next step `h`, s, and whether that is Euler's, as at the start; the moment before its own, None
    at the start; `most`, the largest kinetic energy so far, N mm.
    """

    iterations: int = 0
    h: float = 0.0
    is_euler: bool = True
    last: Moment | None = None
    most: float = 0.0

    @property
    @abstractmethod
    def seen(self) -> tuple[Array, Array, Array, float]:
        """Places (n, 3) in mm, their shares (n,) of the reference area, forces of supports (k, d) in N, and the gap."""

    @property
    def row(self) -> list[float]:
        """The numbers of `COLUMNS`."""
        x, share, supports, gap = self.seen
        mean, force = (share @ x / share.sum()).tolist(), float(np.linalg.norm(supports.sum(axis=0)))
        return [self.moment.t, *mean, float(x[:, 1].min()), *astuple(self.account), force, gap]


F = TypeVar("F", bound=Frame)
A = TypeVar("A")


@dataclass(frozen=True, eq=False)
class Run(Generic[F]):
    """A scene in motion: one frame per step, the first one at the start, and how it ended."""

    frames: tuple[F, ...]
    status: End
    message: str
    wall_s: float


class Mover(ABC, Generic[F, A]):
    """What moves in a scene, by frames F, and what acts on it, A; `size` in mm and what it is called; is_rigid: whether
    rings that lock do so by impulses. InputError if nothing moves, or nothing holds what is to hang."""

    what: str
    size: float
    is_rigid = True

    def __init__(self, scene: Scene) -> None:
        if scene.motion is None:
            scene.refuse("[motion]: is missing, so nothing moves; give its duration in s")
        if scene.motion.start == "hung" and not scene.support:
            scene.refuse("[motion] start = 'hung': nothing holds the curtain, use 'reference'")
        self.scene, self.motion, self.balls = scene, scene.motion, scene.of(Ball)
        self.first_step = self.motion.step or self.motion.duration / PACE.first_steps
        self.near = 1e-9 * self.motion.duration  # times that differ by less are one, s
        self.changes = any(isinstance(item, Timed) and item.history for item in scene.items)
        self.acting: A | None = None
        self.released: frozenset[int] = frozenset()

    @abstractmethod
    def first_frame(self) -> F:
        """At t = 0; InputError or NotConverged for what cannot begin."""

    @abstractmethod
    def next_frame(self, frame: F, before: Moment | None, h: float) -> F:
        """After a step of h s, with the moment before `frame`, None for Euler's method; `Failed` if there is none."""

    @abstractmethod
    def act(self, t: float) -> A:
        """What acts at a time, without the supports `released`."""

    @abstractmethod
    def peaks(self, frame: F) -> list[float]:
        """Further numbers of a frame, of which the summary is made; that of its weakest moment is largest at last."""

    @abstractmethod
    def summary(self, told: MotionNumbers, last: F, weakest: F, t: Array, peaks: Array) -> MotionSummary:
        """What is told of any motion, with what the last and the weakest frame and the `peaks` (m, k) at the times t
        (m,) say."""

    @property
    @abstractmethod
    def notes(self) -> list[str]:
        """What of the scene was changed to fit it."""

    @abstractmethod
    def pack(self, frame: F) -> Kept:
        """Arrays by name, what a run that goes on needs of a frame beside its moment and account."""

    @abstractmethod
    def unpack(self, moment: Moment, account: Account, kept: Kept) -> F:
        """The frame of `pack`."""

    @abstractmethod
    def write_vtu(self, path: Path, frame: F) -> None: ...

    @abstractmethod
    def views(self, frames: Sequence[F]) -> list[Draw]:
        """How to draw frames in space, on one scale and with one camera."""

    def at_start(self, x: Array, mass: Array, weight: Array, stored: float = 0.0) -> tuple[Moment, Account]:
        """Nodes of masses (n,) in N s2/mm and weights (n, d) in N at rest at x (n, d), the last ones balls as they are
        thrown, at t = 0, and their account."""
        v = np.zeros_like(x)
        v[len(v) - len(self.balls) :] = np.array([ball.velocity for ball in self.balls]).reshape(-1, x.shape[1])
        return Moment(0.0, x, v), Account(kinetic_energy(mass, v), -float((weight * x).sum()), stored)

    def at(self, t: float) -> A:
        """What acts at a time; made anew only where something has changed."""
        released = let_go(self.scene, t)
        if self.acting is None or self.changes or released != self.released:
            self.released = released
            self.acting = self.act(t)
        return self.acting

    def solve(self, start: F | None = None, take: Callable[[F], object] | None = None) -> Run[F]:
        """The scene over its duration, from its beginning or from a frame of a run before.

        take: is given each frame as soon as it is known, instead of the run. InputError for what cannot begin,
        NotConverged if what it begins with at rest is no answer. A step that fails ends the run with a status; the
        frames so far are kept, as they are when Ctrl-C stops it.
        """
        begin, kept, t = time.perf_counter(), list[F](), -1.0
        take = kept.append if take is None else take
        status: End = "converged"
        message = "every step is solved"
        if late := [one for one in self.scene.support if (one.release or 0.0) >= self.motion.duration]:
            message += f"; {late[0].where} release = {late[0].release:g}: is not reached"
        try:
            for frame in self.frames(start):
                take(frame)
                t = frame.moment.t
        except Failed as failed:
            status, message = failed.status, str(failed)
        except KeyboardInterrupt:
            if t < 0.0:
                raise
            status, message = "stopped", f"stopped after {t:.6g} s; the steps so far are kept"
        return Run(tuple(kept), status, message, time.perf_counter() - begin)

    def frames(self, start: F | None = None) -> Iterator[F]:
        """The frames of `solve`, each as soon as it is known; the first one is that at the start.

        What hangs at rest stays there until something changes. Steps end where a support lets go, after which the first
        one is Euler's. Steps without a length of their own also end at the times of histories: long ones at rest would
        pass a gust unseen. No such step is shorter than the least one, of which rounding leaves too little.
        """
        frame = start or replace(self.first_frame(), h=self.first_step)
        end, near, least = self.motion.duration, self.near, PACE.smallest * self.first_step
        begun, first, count = time.monotonic(), frame.moment.t, 0
        releases = {item.release for item in self.scene.support if item.release is not None}
        timed = self.scene.of(Timed) if self.motion.step is None else ()
        kinks = {t for item in timed for t, _ in item.history}
        yield frame
        while (t := frame.moment.t) < end - near:
            of = f" of about {count + max(1, round((end - t) / frame.h))}" if frame.h > 0.0 else ""
            done = f"step {count + 1}{of}, {t:.4g} of {end:.4g} s"
            count += 1
            if any(abs(t - release) <= near for release in releases):
                frame = replace(frame, is_euler=True)
            stops = [one for one in releases if one > t + near] + [max(k, t + least) for k in kinks if k > t + near]
            with part_of(f"{self.what} in motion, {done}", t - first, end - first, begun):
                frame = self._accurate(frame, min([end, *stops]) - t)
            yield frame

    def _accurate(self, frame: F, left: float) -> F:
        """The next frame, by a step that is as accurate as asked for and no longer than `left`, s, to the next stop."""
        motion, least = self.motion, PACE.smallest * self.first_step
        now, h, before = frame.moment, frame.h, None if frame.is_euler else frame.last
        while True:
            h = left / max(1, np.ceil(left / h - 1e-9)) if left < 2.0 * h else h
            following = self._advanced(frame, before, h)
            is_impact = self._is_impact(frame, following, before)
            if is_impact and before is not None:
                following = self._advanced(frame, None, h)
            after = motion.step or h
            if motion.step is None:
                guess = predicted(now, frame.last, h)
                away = np.sqrt(((following.moment.x - guess.x) ** 2).sum(axis=1).mean()) / self.size
                factor = PACE.safety * (motion.accuracy / max(away, 1e-300)) ** (1.0 / 3.0)
                if away > motion.accuracy and h > least:
                    h = max(least, h * min(0.5, max(PACE.least_change, factor)))
                    continue
                after = max(least, h * min(PACE.most_change, max(PACE.least_change, factor)))
            most = max(frame.most, following.account.kinetic)
            return replace(following, h=after, is_euler=is_impact or motion.scheme == "euler", last=now, most=most)

    def _advanced(self, frame: F, before: Moment | None, h: float, halvings: int = PACE.halvings) -> F:
        """The frame after a step h or its two halves; the same one later if it is at rest and nothing else acts."""
        t = frame.moment.t
        has_moved = frame.most > 0.0 or frame.moment.v.any()
        if not has_moved and self.motion.start == "hung" and not self.scene.of(Ball):
            old, new = ((scene_at(self.scene, at).items, let_go(self.scene, at)) for at in (t, t + h))
            if old == new:
                return replace(frame, moment=replace(frame.moment, t=t + h), iterations=0)
        try:
            return self.next_frame(frame, before, h)
        except Failed:
            if not halvings:
                raise
        half = self._advanced(frame, before, 0.5 * h, halvings - 1)
        return self._advanced(half, frame.moment, 0.5 * h, halvings - 1)

    def _is_impact(self, start: F, end: F, before: Moment | None) -> bool:
        """Whether a step takes energy for good, against the largest kinetic energy so far.

        In smooth motion on the locked surface the loss by locking, of order h^2, and the gain of the scheme cancel to
        h^3. An impact keeps part of its loss, and differences over it would make what locks or touches rebound, which
        shows in a gain by contacts or the law: Euler's step takes its place, and the next step is Euler's as well. So
        it does over kinks of histories, where loads that end throw ahead. What sets off at once while it touches or is
        taut closes no gap: there the loss of the scheme tells. What has met something just before, or in a step of
        Euler's, closes none either and rebounds with a loss: there its `rebound` tells. Of Euler's own steps, which
        always lose, that counts in which nearly all motion begins.
        """
        most, kinetic = start.most, end.account.kinetic
        locking = end.account.lost_by_locking - start.account.lost_by_locking
        scheme = end.account.lost_by_scheme - start.account.lost_by_scheme
        lost = locking + scheme
        if before is None:
            begins = max(most, start.account.kinetic) < PACE.least_impact * kinetic
            return begins and locking > PACE.least_impact * kinetic and lost > PACE.impact * locking
        since, until = before.t - self.near, end.moment.t - self.near
        over = [item for item in self.scene.of(Timed) if any(since <= t < until for t, _ in item.history)]
        is_lost = locking > PACE.least_impact * most and lost > PACE.impact * locking
        is_jump = scheme > PACE.least_impact * max(most, kinetic) and not all(isinstance(one, Load) for one in over)
        is_thrown = end.late - lost > PACE.gain * most and bool(over)
        is_back = end.rebound > PACE.least_impact * most or min(end.gain, -lost) > PACE.gain * most
        return is_lost or is_jump or is_thrown or is_back
