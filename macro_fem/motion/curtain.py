"""A curtain in motion, step by step: the step, its account, its record, and what is written and drawn of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from homogenize import MembraneLaw
from macro_fem.curtain import (
    CurtainProblem,
    CurtainSolution,
    InnerForces,
    check_breadth,
    is_alike,
    make_problem,
    solve_problem,
)
from macro_fem.fem.assembly import internal_force, load_vector
from macro_fem.fem.cells import in_space_of, padded
from macro_fem.fem.supported import SupportedFem, with_loose_nodes
from macro_fem.judged import utilisation
from macro_fem.motion.pace import Failed, Frame, Mover
from macro_fem.motion.stage import Contacts, let_go, masses_of, scene_at, step_of, weights_of, winds_at
from macro_fem.motion.step import Account, Moment, end_of, solve_step, stored_energy
from macro_fem.output.files import curtain_mesh
from macro_fem.output.images import Draw
from macro_fem.output.space_view import views
from macro_fem.scene.checks import check_sizes
from macro_fem.scene.loads import meet
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.obstacles import Sphere
from macro_fem.scene.scene import Scene
from macro_fem.scene.support_kinds import Support
from macro_fem.scene.tables import Item
from macro_fem.solvers.cones import Cones
from macro_fem.solvers.path import PathResult, times
from macro_fem.solvers.status import ROUNDING, Evidence
from macro_fem.solvers.walls import TOUCHED, Walls
from rve.common import Array, NotConverged, digits
from rve.common.files import write_mesh_file

REST = 10.0
"""mm that nodes at rest may go in a step before balls are looked at again."""
GRAZED = 0.05
"""Depth of ways of points through a body over half its width with which a step is halved; those that meet it: 0.015."""


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

    @property
    def seen(self) -> tuple[Array, Array, Array, float]:
        disc = self.problem.disc
        x, share = padded(self.moment.x[: disc.n_nodes]), load_vector(disc, np.array([1.0]))[:, 0]
        return x, share, self.supports, self.relative_gap


class MovingCurtain(Mover[MotionFrame, tuple[CurtainProblem, SupportedFem]]):
    """The curtain of a scene by a law, and its balls, whose nodes are the last ones; what acts on it is a problem, and
    its discretisation with the nodes of balls."""

    def __init__(self, scene: Scene, law: MembraneLaw) -> None:
        scene, self.law = meet(scene, law)
        super().__init__(scene)
        check_sizes(scene, None if self.law.cell is None else self.law.cell.r1_mm)
        self.mesh = build_mesh(scene_at(scene, 0.0), self.law.cell)
        self.what, self.size = f"{self.mesh.mesh.t.shape[1]} cells", self.mesh.size
        self.is_rigid = not scene.solver.is_elastic
        self.told: tuple[MotionFrame, CurtainSolution] | None = None
        for ball in self.balls:
            check_breadth(scene, f"[[body]] {ball.name}", ball.radius, self.mesh.longest_side)

    def act(self, t: float) -> tuple[CurtainProblem, SupportedFem]:
        problem = make_problem(scene_at(self.scene, t), self.law, self.mesh, released=self.released)
        if self.acting is None or not is_alike(problem.fem, self.acting[0].fem):
            return problem, with_loose_nodes(problem.fem, len(self.balls))
        x_held = np.vstack([problem.fem.x_held, np.zeros((len(self.balls), problem.fem.d))])
        return problem, self.acting[1].moved(x_held)

    def first_frame(self) -> MotionFrame:
        """The curtain at rest at t = 0, hung or in its reference state, where [start] lays it, and the bodies."""
        scene, balls = self.scene, self.balls
        problem, _ = self.at(0.0)
        if self.motion.start == "hung":
            hung = solve_problem(make_problem(scene_at(scene, 0.0), self.law, self.mesh))
            if hung.status != "converged":
                words = f"{hung.status}: {hung.message} (load steps do not go with [motion]; start = 'reference' does)"
                raise NotConverged(f"{scene.source}: the curtain at rest at t = 0 is {words}")
            x, P, S, cones, forces = hung.x, hung.P, hung.S, hung.cones, hung.reactions
        else:
            X = problem.disc.nodes
            x = in_space_of(X, problem.fem.d) if scene.start is None else scene.start.places(X)
            held = self.at(self.near)[0].supports  # without those that let go at t = 0
            away = np.where(held.mask, held.positions - x, 0.0)
            if np.abs(away).max(initial=0.0) > 1e-6 * self.size:
                scene.refuse(
                    f"[motion] start = 'reference': supports hold points up to {digits(np.abs(away).max(), 4)} mm from "
                    "where they are there; use 'hung', or a history that begins there"
                )
            P = np.zeros((problem.disc.n_points, problem.fem.d, 2))
            S, cones, forces = np.zeros((len(P), 3)), None, np.zeros_like(x)
        place = np.vstack([x, *[np.array([ball.at]) for ball in balls]])
        Contacts(problem, balls).check_start(place, self.motion.start == "hung")
        masses, weights = masses_of(problem, balls), weights_of(problem, balls)
        moment, account = self.at_start(place, masses, weights, stored_energy(problem, x) or 0.0)
        return MotionFrame(moment=moment, account=account, P=P, S=S, supports=forces, problem=problem, cones=cones)

    def next_frame(self, frame: MotionFrame, before: Moment | None, h: float) -> MotionFrame:
        now, balls = frame.moment, self.balls
        problem, fem = self.at(now.t + h)
        step, n = step_of(problem, balls, now, before, h, self.motion.damping), problem.disc.n_nodes
        way = h * sum(float(np.linalg.norm(v, axis=1).max(initial=0.0)) for v in (now.v[:n], now.v[n:]))
        for reach in (way + REST, np.inf):
            contacts = Contacts(problem, balls, frame.problem, reach)
            result, walls = solve_step(problem, fem, step, frame.cones, contacts.tangents)
            _check(result, now.t + h)
            if max(contacts.depths(fem.positions(result.z)), default=0.0) <= TOUCHED * self.size + 1e-7 * reach:
                break  # else points without a half-space are inside a ball
        if contacts.passed(now.x, fem.positions(result.z)) > GRAZED:
            words = f"in the step to {now.t + h:.6g} s a body passes the mesh: use shorter steps"
            raise Failed("pierced", words)
        pushed, moves, touched = contacts.work(walls, result.wall_forces, now.x)
        end = replace(end_of(problem, fem, step, result, walls), pushed=pushed, moves=moves, touched=touched)
        return MotionFrame(
            **step.finish(frame.account, end, frame.forces),
            iterations=result.iterations,
            P=result.P,
            S=result.S,
            supports=end.supports[:n],
            relative_gap=result.evidence.gap,
            problem=problem,
            cones=result.cones,
        )

    def peaks(self, frame: MotionFrame) -> list[float]:
        """The largest principal line load, N/mm, and utilisation of its rings, nan where it is not known."""
        solution = self.as_solution(frame)
        used = utilisation(solution)
        load = float(solution.principal()[0].max(initial=0.0))
        return [load, np.nan if used is None else float(used.max(initial=0.0))]

    def summary(self, last: MotionFrame, t: Array, peaks: Array) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, unit, values in (("line_load", "_N_per_mm", peaks[:, 0]), ("utilisation", "", peaks[:, 1])):
            if np.isfinite(values).all():
                found |= {f"peak_{name}{unit}": float(values.max()), f"peak_{name}_at_s": float(t[values.argmax()])}
        disc = last.problem.disc
        found |= {"cells": disc.n_cells, "element": disc.element, "law": last.problem.law.name}
        return found | {"notes": list(self.mesh.notes)}

    def pack(self, frame: MotionFrame) -> dict[str, Any]:
        cones = {} if frame.cones is None else {f"cone_{name}": one for name, one in vars(frame.cones).items()}
        kept = {"P": frame.P, "S": frame.S, "supports": frame.supports, "relative_gap": frame.relative_gap} | cones
        return {name: one for name, one in kept.items() if one is not None}

    def unpack(self, moment: Moment, account: Account, kept: dict[str, Any]) -> MotionFrame:
        cones = {name.removeprefix("cone_"): kept.pop(name) for name in list(kept) if name.startswith("cone_")}
        found = MotionFrame(moment=moment, account=account, problem=self.at(moment.t)[0], **kept)
        return replace(found, cones=Cones(**cones)) if cones else found

    def as_solution(self, frame: MotionFrame) -> CurtainSolution:
        """`_solution`, of the last frame without computing it again."""
        if self.told is None or self.told[0] is not frame:
            self.told = frame, self._solution(frame)
        return self.told[1]

    def _solution(self, frame: MotionFrame) -> CurtainSolution:
        """The curtain at a frame, with balls as obstacles of the scene and without supports that have let go.

        Its load is what line loads and supports balance: outer forces, pushes, and those of inertia. Winds with a speed
        press its cells by the velocity relative to them.
        """
        problem, n = frame.problem, frame.problem.disc.n_nodes
        gone = let_go(self.scene, frame.moment.t)
        kept: list[Item] = [item for number, item in enumerate(problem.scene.support) if number not in gone]
        kept += [item for item in problem.scene.items if not isinstance(item, Support)]
        for ball, place in zip(self.balls, frame.moment.x[n:], strict=True):
            kept.append(Sphere(tuple(place), ball.radius, name=ball.name))
        scene = replace(problem.scene, items=tuple(kept))
        dead, wind = internal_force(problem.disc, frame.P) - frame.supports, None
        if problem.winds:
            blown, blocks = winds_at(problem, frame.moment.v, frame.moment)
            blown -= times(blocks, frame.moment.v[:n])
            wind = (blown / load_vector(problem.disc, np.array([1.0])))[problem.disc.cell_dofs].mean(axis=1)
            dead -= load_vector(problem.disc, wind)
        told = replace(problem, scene=scene, dead=dead, wind=wind, walls=Walls.none(problem.force.shape))
        inner, asked = InnerForces(frame.P, frame.S, 0.0, np.zeros(0)), Evidence(1.0, 1.0, 1.0)
        return CurtainSolution(told, "converged", asked, frame.moment.x[:n], inner, 0.0, 0.0, frame.iterations, 0.0)

    def write_vtu(self, path: Path, frame: MotionFrame) -> None:
        write_mesh_file(path, curtain_mesh(self.as_solution(frame)))

    def views(self, frames: Sequence[MotionFrame]) -> list[Draw]:
        return views([self.as_solution(one) for one in frames])


def _check(found: PathResult, t: float) -> None:
    """Raise for a step that is not solved."""
    if found.status == "converged" or (found.evidence.is_finite and found.evidence.error <= ROUNDING):
        return
    if found.stop in ("infeasible", "blocked"):
        words = "supports and obstacles leave the curtain no place: move them less far apart"
        raise Failed("infeasible", f"at {t:.6g} s {words}")
    why = f"an error of {found.evidence.error:.1e} ({found.stop})"
    raise Failed("stalled", f"the step to {t:.6g} s stopped at {why}: use another step")
