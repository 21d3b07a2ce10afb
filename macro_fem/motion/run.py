"""A scene in motion, step by step: the step, its account and its record."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from homogenize import MembraneLaw, with_material
from macro_fem.curtain import is_elastic, solve_problem
from macro_fem.fem.assembly import gradient, internal_force
from macro_fem.fem.space import in_space_of
from macro_fem.motion.account import Account, Worked, kinetic_energy, next_account, support_forces
from macro_fem.motion.contact import Contacts
from macro_fem.motion.scheme import Moment, difference, predicted
from macro_fem.motion.stage import Stage, forces_at, masses_of, scene_at, stored_energy, weights_of
from macro_fem.motion.step import Moving, Stepped, solve_step
from macro_fem.problem import CurtainProblem, make_problem
from macro_fem.scene.meshing.mesh import CurtainMesh, build_mesh
from macro_fem.scene.moving import Ball, Motion
from macro_fem.scene.schema import Scene
from macro_fem.solvers.cones import Cones
from macro_fem.solvers.status import ROUNDING
from rve.common.errors import InputError, NotConverged
from rve.common.progress import tell
from rve.common.types import Array

FIRST_STEPS = 400
"""Steps of the whole duration with which a run without a step begins."""
SMALLEST = 1e-4
"""Least step of such a run over the first one. Impacts are met by smaller steps, down to this one."""
IMPACT, LEAST_IMPACT = 0.3, 1e-2
"""Part of the loss by locking that a step must lose for good to count as an impact, and that loss over the largest
kinetic energy. Smaller ones are steps after one of Euler's, whose first-order error fades, and small rebounds."""
GAIN = 1e-3
"""Part of the largest kinetic energy that a step may gain: more is a rebound of the impact of the step before."""
REST = 10.0
"""mm that nodes at rest may go in a step before balls are looked at again."""
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
    """How a run goes on: moments before the frame's own, `before` for BDF2 and `last` for the guess of the next step,
    None where there is none; `most`, the largest kinetic energy so far, N mm; `h`, the next step, s."""

    h: float
    before: Moment | None = None
    last: Moment | None = None
    most: float = 0.0


@dataclass(frozen=True, eq=False)
class MotionFrame:
    """Positions and velocities of nodes and bodies, line loads P (nq, d, 2) in N/mm, the energy account, forces
    of the supports on the curtain (n_nodes, d) in N, and the relative gap and half-spaces of the step."""

    moment: Moment
    P: Array
    S: Array
    account: Account
    supports: Array
    relative_gap: float
    problem: CurtainProblem
    cones: Cones | None
    iterations: int = 0
    pace: Pace = Pace(0.0)


@dataclass(frozen=True, eq=False)
class MotionRun:
    """A scene in motion: one frame per step, the first one at the start; bodies are the last nodes of each moment."""

    scene: Scene
    frames: tuple[MotionFrame, ...]
    status: MotionStatus
    message: str
    wall_s: float

    @property
    def bodies(self) -> tuple[Ball, ...]:
        """The bodies of the scene, in the order of their nodes."""
        return self.scene.of(Ball)


def solve_motion(scene: Scene, law: MembraneLaw, start: MotionFrame | None = None) -> MotionRun:
    """The scene of [motion] over its duration, from its beginning or from a frame of a run before.

    InputError for what cannot begin, NotConverged if the curtain at rest that it begins with is none. A step that fails
    ends the run with a status; the frames so far are kept, as they are when Ctrl-C stops it.
    """
    begin = time.perf_counter()
    frames: list[MotionFrame] = []
    status, message = MotionStatus.CONVERGED, "every step is solved"
    try:
        for frame in motion_frames(scene, law, start):
            frames.append(frame)
    except _Failed as failed:
        status, message = failed.status, str(failed)
    except KeyboardInterrupt:
        if not frames:
            raise
        status, message = MotionStatus.STOPPED, f"stopped after {frames[-1].moment.t:.6g} s; the steps so far are kept"
    return MotionRun(scene, tuple(frames), status, message, time.perf_counter() - begin)


class _Failed(Exception):
    def __init__(self, status: MotionStatus, message: str) -> None:
        super().__init__(message)
        self.status = status


def motion_frames(scene: Scene, law: MembraneLaw, start: MotionFrame | None = None) -> Iterator[MotionFrame]:
    """The frames of `solve_motion`, each as soon as it is known; the first one is that at the start."""
    motion = scene.motion
    if motion is None:
        raise InputError(f"{scene.source}: [motion]: is missing, so nothing moves; give its duration in s")
    law = with_material(law, dict(scene.material), f"{scene.source}: [material]")
    mesh = build_mesh(scene_at(scene, 0.0), law.cell)
    stage = Stage(scene, law, mesh)
    least = SMALLEST * (motion.step or motion.duration / FIRST_STEPS)
    if start is None:
        first = _first_frame(scene, law, mesh, stage)
        start = replace(first, pace=Pace(least / SMALLEST))
    frame = start
    yield frame
    while (left := motion.duration - frame.moment.t) > 1e-9 * motion.duration:
        t = frame.moment.t
        tell(f"{mesh.mesh.t.shape[1]} cells in motion, {t:.4g} of {motion.duration:.4g} s", t / motion.duration)
        frame = _accurate_frame(stage, motion, frame, left, least)
        yield frame


def _accurate_frame(stage: Stage, motion: Motion, frame: MotionFrame, left: float, least: float) -> MotionFrame:
    """The next frame, by a step that is as accurate as asked for and no longer than what is `left`, s."""
    now, pace = frame.moment, frame.pace
    h, before = pace.h, pace.before
    while True:
        h = left / max(1, np.ceil(left / h - 1e-9)) if left < 2.0 * h else h
        following = _next_frame(stage, motion, frame, before, h)
        is_impact = before is not None and _is_impact(frame, following, pace.most)
        if is_impact:
            following = _next_frame(stage, motion, frame, None, h)
        after = h
        if motion.step is None:
            guess = predicted(now, pace.last, h)
            away = np.sqrt(((following.moment.x - guess) ** 2).sum(axis=1).mean()) / stage.mesh.size
            factor = SAFETY * (motion.accuracy / max(away, 1e-300)) ** (1.0 / 3.0)
            if away > motion.accuracy and h > least:
                h = max(least, h * min(0.5, max(LEAST_CHANGE, factor)))
                continue
            after = max(least, h * min(MOST_CHANGE, max(LEAST_CHANGE, factor)))
        most = max(pace.most, following.account.kinetic)
        return replace(following, pace=Pace(after, None if is_impact or motion.scheme == "euler" else now, now, most))


def _is_impact(start: MotionFrame, end: MotionFrame, most: float) -> bool:
    """Whether a step takes energy for good; `most`: the largest kinetic energy so far, N mm.

    In smooth motion on the locked surface the loss by locking, of order h^2, and the gain of the scheme cancel to h^3.
    An impact keeps part of its loss. Differences over it would make rings that lock and nodes that touch rebound, which
    also shows in a gain. Euler's step then takes its place, and the next step is Euler's as well.
    """
    locking = end.account.lost_by_locking - start.account.lost_by_locking
    scheme = end.account.lost_by_scheme - start.account.lost_by_scheme
    lost = locking + scheme
    is_lost = locking > LEAST_IMPACT * most and lost > IMPACT * locking
    return is_lost or lost < -GAIN * most


def _first_frame(scene: Scene, law: MembraneLaw, mesh: CurtainMesh, stage: Stage) -> MotionFrame:
    """The curtain at rest at t = 0, hung or in its reference state, and the bodies."""
    assert scene.motion is not None
    balls = scene.of(Ball)
    if scene.motion.start == "hung":
        if not scene.support:
            raise InputError(f"{scene.source}: [motion] start = 'hung': nothing holds the curtain, use 'reference'")
        hung = solve_problem(make_problem(scene_at(scene, 0.0), law, mesh))
        if hung.status != "converged":
            raise NotConverged(f"{scene.source}: the curtain at rest at t = 0 is {hung.status}: {hung.message}")
        problem, _ = stage.at(0.0)
        x, P, S, cones = hung.x, hung.P, hung.S, hung.cones
        forces = hung.reactions
    else:
        problem, _ = stage.at(0.0)
        x = in_space_of(problem.disc.nodes, problem.fem.d)
        away = np.where(problem.supports.mask, problem.supports.positions - x, 0.0)
        if np.abs(away).max(initial=0.0) > 1e-6 * mesh.size:
            raise InputError(
                f"{scene.source}: [motion] start = 'reference': supports hold points up to {np.abs(away).max():.4g} mm "
                f"from where they are there; use 'hung', or a history that begins there"
            )
        P = np.zeros((problem.disc.n_points, problem.fem.d, 2))
        S, cones, forces = np.zeros((len(P), 3)), None, np.zeros_like(x)
    contacts = Contacts(problem, balls)
    place = np.vstack([x, *[np.array([ball.at]) for ball in balls]])
    contacts.check_start(place)
    v = np.vstack([np.zeros_like(x), *[np.array([ball.velocity]) for ball in balls]])
    mass = masses_of(problem, balls)
    stored = stored_energy(problem, problem.fem.gradient(problem.fem.unknowns(x))) if is_elastic(problem.scene) else 0.0
    account = Account(
        kinetic=kinetic_energy(mass, v),
        potential=-float((weights_of(problem, balls) * place).sum()),
        stored=stored,
    )
    return MotionFrame(Moment(0.0, place, v), P, S, account, forces, 0.0, problem, cones)


def _next_frame(stage: Stage, motion: Motion, frame: MotionFrame, before: Moment | None, h: float) -> MotionFrame:
    """The frame after a step h."""
    now, balls = frame.moment, stage.scene.of(Ball)
    problem, fem = stage.at(now.t + h)
    elastic = is_elastic(problem.scene)
    moving = Moving(
        fem,
        problem.elastic_law if elastic else problem.law,
        masses_of(problem, balls),
        problem.elastic_law.compliance if elastic else np.zeros((3, 3)),
        stage.mesh.size,
    )
    change = difference(now, before, h)
    forces = forces_at(problem, balls, now, motion.damping)
    n = problem.disc.n_nodes
    way = h * sum(float(np.linalg.norm(v, axis=1).max(initial=0.0)) for v in (now.v[:n], now.v[n:]))
    for reach in (way + REST, np.inf):
        contacts = Contacts(problem, balls, frame.problem, reach)
        end = solve_step(moving, change, forces, now.x, frame.cones, contacts.tangents)
        _check(end, now.t + h)
        if not contacts.misses(end.x):
            break
    F = [gradient(fem.disc, x) for x in (now.x, end.x)]
    P = end.result.P
    stored = stored_energy(problem, F[1]) - stored_energy(problem, F[0]) if elastic else 0.0
    inner = float((fem.weight[:, None, None] * P * (F[1] - F[0])).sum())
    held = support_forces(moving, change, forces, end, internal_force(fem.disc, P))
    worked = Worked(held, inner, stored, *contacts.work(end, now.x))
    account = next_account(frame.account, moving, change, now, forces, end, worked)
    moment = Moment(now.t + h, end.x, change.velocity(end.x))
    gap = end.result.evidence.gap
    n = problem.disc.n_nodes
    return MotionFrame(
        moment, P, end.result.S, account, held[:n], gap, problem, end.result.cones, end.result.iterations
    )


def _check(end: Stepped, t: float) -> None:
    """Raise for a step that is not solved."""
    found = end.result
    if found.converged or (found.evidence.is_finite and found.evidence.error <= ROUNDING):
        return
    if found.stop in ("infeasible", "blocked"):
        raise _Failed(
            MotionStatus.INFEASIBLE,
            f"at {t:.6g} s supports and obstacles leave the curtain no place: move them less far apart",
        )
    raise _Failed(
        MotionStatus.STALLED,
        f"the step to {t:.6g} s stopped at an error of {found.evidence.error:.1e} ({found.stop}): use a smaller step",
    )
