"""A scene in motion, step by step: the step, its account and its record."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from homogenize import MembraneLaw, with_material
from macro_fem.curtain import is_elastic, solve_problem
from macro_fem.fem.assembly import gradient, internal_force
from macro_fem.fem.cells import in_space_of
from macro_fem.motion.account import Account, Worked, kinetic_energy, next_account, support_forces
from macro_fem.motion.contact import Contacts
from macro_fem.motion.pace import Failed, Frame, MotionStatus, Pace, Run, collected, first_step, motion_of, stepped
from macro_fem.motion.scheme import Moment, difference
from macro_fem.motion.stage import Stage, forces_at, masses_of, scene_at, stored_energy, weights_of
from macro_fem.motion.step import Moving, Stepped, solve_step
from macro_fem.problem import CurtainProblem, make_problem
from macro_fem.scene.meshing.mesh import CurtainMesh, build_mesh
from macro_fem.scene.moving import Ball, Motion
from macro_fem.scene.schema import Scene
from macro_fem.solvers.cones import Cones
from macro_fem.solvers.status import ROUNDING
from rve.common import Array, InputError, NotConverged

REST = 10.0
"""mm that nodes at rest may go in a step before balls are looked at again."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MotionFrame(Frame):
    """A curtain of nodes and bodies: line loads P (nq, d, 2) and S (nq, 3) in N/mm, forces of the supports on it
    (n_nodes, d) in N, and the relative gap and half-spaces of the step."""

    P: Array
    S: Array
    supports: Array
    relative_gap: float = 0.0
    problem: CurtainProblem
    cones: Cones | None = None


MotionRun = Run[MotionFrame]


def solve_motion(scene: Scene, law: MembraneLaw, start: MotionFrame | None = None) -> MotionRun:
    """The scene of [motion] over its duration, from its beginning or from a frame of a run before.

    InputError for what cannot begin, NotConverged if the curtain at rest that it begins with is none. A step that fails
    ends the run with a status; the frames so far are kept, as they are when Ctrl-C stops it.
    """
    return collected(scene, motion_frames(scene, law, start))


def motion_frames(scene: Scene, law: MembraneLaw, start: MotionFrame | None = None) -> Iterator[MotionFrame]:
    """The frames of `solve_motion`, each as soon as it is known; the first one is that at the start."""
    motion = motion_of(scene)
    law = with_material(law, dict(scene.material), f"{scene.source}: [material]")
    mesh = build_mesh(scene_at(scene, 0.0), law.cell)
    stage = Stage(scene, law, mesh)
    if start is None:
        start = _first_frame(scene, law, mesh, stage, Pace(first_step(motion)))

    def advance(frame: MotionFrame, before: Moment | None, h: float) -> MotionFrame:
        return _next_frame(stage, motion, frame, before, h)

    yield from stepped(scene, start, advance, mesh.size, f"{mesh.mesh.t.shape[1]} cells")


def _first_frame(scene: Scene, law: MembraneLaw, mesh: CurtainMesh, stage: Stage, pace: Pace) -> MotionFrame:
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
        kinetic=kinetic_energy(mass, v), potential=-float((weights_of(problem, balls) * place).sum()), stored=stored
    )
    moment = Moment(0.0, place, v)
    return MotionFrame(
        moment=moment, account=account, pace=pace, P=P, S=S, supports=forces, problem=problem, cones=cones
    )


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
    stored = stored_energy(problem, F[1]) - stored_energy(problem, F[0]) if elastic else None
    inner = float((fem.weight[:, None, None] * P * (F[1] - F[0])).sum())
    held = support_forces(moving, change, forces, end, internal_force(fem.disc, P))
    worked = Worked(held, end.pushes, inner, stored, *contacts.work(end, now.x))
    account = next_account(frame.account, moving.mass, change, now, forces, end.x, worked)
    return MotionFrame(
        moment=Moment(now.t + h, end.x, change.velocity(end.x)),
        account=account,
        iterations=end.result.iterations,
        P=P,
        S=end.result.S,
        supports=held[:n],
        relative_gap=end.result.evidence.gap,
        problem=problem,
        cones=end.result.cones,
    )


def _check(end: Stepped, t: float) -> None:
    """Raise for a step that is not solved."""
    found = end.result
    if found.converged or (found.evidence.is_finite and found.evidence.error <= ROUNDING):
        return
    if found.stop in ("infeasible", "blocked"):
        raise Failed(
            MotionStatus.INFEASIBLE,
            f"at {t:.6g} s supports and obstacles leave the curtain no place: move them less far apart",
        )
    raise Failed(
        MotionStatus.STALLED,
        f"the step to {t:.6g} s stopped at an error of {found.evidence.error:.1e} ({found.stop}): use another step",
    )
