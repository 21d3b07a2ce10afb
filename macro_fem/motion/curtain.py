"""A curtain in motion, step by step: the step, its account, its record, and what is written and drawn of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from homogenize import MembraneLaw
from macro_fem.curtain import (
    NOT_UNIQUE,
    CurtainProblem,
    CurtainState,
    InnerForces,
    check_breadth,
    is_alike,
    make_problem,
    placed_obstacles,
    self_balanced,
    solve_problem,
)
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.supported import SupportedFem, with_loose_nodes
from macro_fem.judged import judge_strength, links, severity, support_forces, utilisation
from macro_fem.motion.pace import Failed, Frame, Kept, Mover
from macro_fem.motion.stage import Contacts, masses_of, scene_at, step_of, weights_of, winds_at
from macro_fem.motion.step import Account, Moment, end_of, solve_step, stored_energy
from macro_fem.motion_summary import CurtainMotionSummary, MotionNumbers
from macro_fem.output.files import curtain_mesh
from macro_fem.output.images import Draw
from macro_fem.output.space_view import views
from macro_fem.scene.checks import check_sizes
from macro_fem.scene.loads import meet
from macro_fem.scene.meshing.mesh import build_mesh
from macro_fem.scene.moving import Ball
from macro_fem.scene.obstacles import PlacedObstacle, Sphere
from macro_fem.scene.scene import Scene
from macro_fem.solvers.cones import Cones
from macro_fem.solvers.path import PathResult, times
from macro_fem.solvers.status import ROUNDING
from macro_fem.solvers.walls import TOUCHED
from rve.common import Array, NotConverged, digits
from rve.common.files import write_mesh_file
from rve.geometry import padded

AT_IMPACTS = (
    "whether it holds at impacts is not known: rigid rings take each in one step ({}), and forces there grow with "
    'shorter steps; kind = "elastic" under [solver] gives them'
)
"""What the verdict of rigid rings does not know."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MotionFrame(Frame, CurtainState):
    """A curtain of nodes and bodies: forces (n_nodes, d) of the supports on it and (k, n_nodes, d) of each of the
    `obstacles`, N, the relative gap, and the half-spaces of the step with their multipliers."""

    supports: Array
    pushes: Array
    balls: tuple[Ball, ...]
    relative_gap: float = 0.0
    cones: Cones | None = None
    lam: Array | None = None

    reactions = property(lambda self: self.supports)
    pushed = property(lambda self: self.pushes)

    @property
    def obstacles(self) -> list[PlacedObstacle]:
        places = self.moment.x[len(self.x) :]
        balls = (Sphere(tuple(at), one.radius, name=one.name) for one, at in zip(self.balls, places, strict=True))
        return placed_obstacles(self.problem) + [PlacedObstacle(-1 - k, one, 1.0, 3) for k, one in enumerate(balls)]

    @property
    def blown(self) -> Array:
        if not self.problem.winds:
            return np.zeros_like(self.x)
        blown, blocks = winds_at(self.problem, self.moment.v, self.moment)
        return blown - times(blocks, self.moment.v[: len(self.x)])

    @property
    def seen(self) -> tuple[Array, Array, Array, float]:
        share = load_vector(self.problem.disc, np.array([1.0]))[:, 0]
        return padded(self.x), share, self.supports, self.relative_gap


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
            x, inner, cones, forces, pushed = hung.x, hung.inner, hung.cones, hung.reactions, hung.pushed
        else:
            X = problem.disc.nodes
            x = padded(X, problem.fem.d) if scene.start is None else scene.start.places(X)
            held = self.at(self.near)[0].supports  # without those that let go at t = 0
            away = np.where(held.mask, held.positions - x, 0.0)
            if np.abs(away).max(initial=0.0) > 1e-6 * self.size:
                scene.refuse(
                    f"[motion] start = 'reference': supports hold points up to {digits(np.abs(away).max(), 4)} mm from "
                    "where they are there; use 'hung', or a history that begins there"
                )
            n, d = problem.disc.n_points, problem.fem.d
            inner, cones, forces = InnerForces(np.zeros((n, d, 2)), np.zeros((n, 3))), None, np.zeros_like(x)
            pushed = np.zeros((len(scene.obstacle), *x.shape))
        place = np.vstack([x, *[np.array([ball.at]) for ball in balls]])
        Contacts(problem, balls).check_start(place, self.motion.start == "hung")
        masses, weights = masses_of(problem, balls), weights_of(problem, balls)
        moment, account = self.at_start(place, masses, weights, stored_energy(problem, x) or 0.0)
        pushed = np.concatenate([pushed, np.zeros((len(balls), *x.shape))])
        return MotionFrame(
            moment=moment,
            account=account,
            problem=problem,
            x=x,
            inner=InnerForces(inner.P, inner.S),
            supports=forces,
            pushes=pushed,
            balls=balls,
            cones=cones,
        )

    def next_frame(self, frame: MotionFrame, before: Moment | None, h: float) -> MotionFrame:
        now, balls = frame.moment, self.balls
        problem, fem = self.at(now.t + h)
        step, n = step_of(problem, balls, now, before, h, self.motion.damping), problem.disc.n_nodes
        way = h * sum(float(np.linalg.norm(v, axis=1).max(initial=0.0)) for v in (now.v[:n], now.v[n:]))
        # mm that nodes at rest may go in a step before balls are looked at again.
        for reach in (way + 10.0, np.inf):
            contacts = Contacts(problem, balls, frame.problem, reach)
            result, walls = solve_step(problem, fem, step, (frame.cones, frame.lam), contacts.tangents)
            _check(result, now.t + h)
            if max(contacts.depths(fem.positions(result.z)), default=0.0) <= TOUCHED * self.size + 1e-7 * reach:
                break  # else points without a half-space are inside a ball
        # Depth of ways of points through a body over half its width with which a step is halved; those that meet it:
        # 0.015.
        if contacts.passed(now.x, fem.positions(result.z)) > 0.05:
            words = f"in the step to {now.t + h:.6g} s a body passes the mesh: use shorter steps"
            raise Failed("pierced", words)
        pushed, moves, touched = contacts.work(walls, result.wall_forces, now.x)
        end = replace(end_of(problem, fem, step, result, walls), pushed=pushed, moves=moves, touched=touched)
        reached = step.finish(frame.account, end, frame.forces)
        return MotionFrame(
            **vars(reached),
            iterations=result.iterations,
            problem=problem,
            x=reached.moment.x[:n],
            inner=InnerForces(result.P, result.S),
            supports=end.supports[:n],
            pushes=contacts.pushes(walls, result.wall_forces),
            balls=balls,
            relative_gap=result.evidence.gap,
            cones=result.cones,
            lam=result.lam,
        )

    def peaks(self, frame: MotionFrame) -> list[float]:
        """The largest principal line load, N/mm, pointwise utilisation of rings, nan where it is not known, and the
        `severity`."""
        used = utilisation(frame)
        load = float(frame.principal()[0].max(initial=0.0))
        return [load, np.nan if used is None else float(used.max(initial=0.0)), severity(frame)]

    def summary(
        self, told: MotionNumbers, last: MotionFrame, weakest: MotionFrame, t: Array, peaks: Array
    ) -> CurtainMotionSummary:
        load, used, _ = peaks.T
        is_known, disc, strength = bool(np.isfinite(used).all()), last.problem.disc, judge_strength(weakest)
        supports, notes = support_forces(weakest), [told.message] * (told.status != "converged")
        least = next(iter(links(strength, supports)), None)
        if least is not None and strength.utilisation_max is None:
            notes.append(f"the strength of the mesh is not known: {strength.strength_note}")
        if self.is_rigid and (struck := told.impacts):
            at = f"{struck} impact{'s' * (struck > 1)}, the largest at {told.largest_impact_at_s:.6g} s"
            notes.append(AT_IMPACTS.format(at))
        if self.is_rigid and self_balanced(weakest.problem, weakest.x):
            notes.append(NOT_UNIQUE)
        is_open = told.status != "converged" or (self.is_rigid and told.impacts > 0)
        factor = None if least is None else least.factor
        return CurtainMotionSummary(
            **told.parts(),
            **strength.parts(),
            holds=None if factor is None or (is_open and factor >= 1.0) else factor >= 1.0,
            smallest_factor=factor,
            at_s=weakest.moment.t,
            weakest=least and least.name,
            weakest_place=least and least.place,
            verdict_note="; ".join(notes) or None,
            support_forces=supports,
            peak_line_load_N_per_mm=float(load.max()),
            peak_line_load_at_s=float(t[load.argmax()]),
            peak_utilisation=float(used.max()) if is_known else None,
            peak_utilisation_at_s=float(t[used.argmax()]) if is_known else None,
            cells=disc.n_cells,
            element=disc.element,
            law=last.problem.law.name,
        )

    @property
    def notes(self) -> list[str]:
        return list(self.mesh.notes)

    def pack(self, frame: MotionFrame) -> Kept:
        cones = {} if frame.cones is None else {f"cone_{name}": one for name, one in vars(frame.cones).items()}
        of_law: Kept = {"P": frame.P, "S": frame.S, "supports": frame.supports, "pushes": frame.pushes}
        kept = of_law | {"relative_gap": frame.relative_gap, "lam": frame.lam} | cones
        return {name: one for name, one in kept.items() if one is not None}

    def unpack(self, moment: Moment, account: Account, kept: Kept) -> MotionFrame:
        cones = {name.removeprefix("cone_"): kept.pop(name) for name in list(kept) if name.startswith("cone_")}
        problem, inner = self.at(moment.t)[0], InnerForces(kept.pop("P"), kept.pop("S"))
        x, balls = moment.x[: problem.disc.n_nodes], self.balls
        found = MotionFrame(moment=moment, account=account, x=x, balls=balls, problem=problem, inner=inner, **kept)
        return replace(found, cones=Cones(**cones)) if cones else found

    def write_vtu(self, path: Path, frame: MotionFrame) -> None:
        write_mesh_file(path, curtain_mesh(frame))

    def views(self, frames: Sequence[MotionFrame]) -> list[Draw]:
        return views(frames)


def _check(found: PathResult, t: float) -> None:
    """Raise for a step that is not solved."""
    if found.status == "converged" or (found.evidence.is_finite and found.evidence.error <= ROUNDING):
        return
    if found.stop in ("infeasible", "blocked"):
        words = "supports and obstacles leave the curtain no place: move them less far apart"
        raise Failed("infeasible", f"at {t:.6g} s {words}")
    why = f"an error of {found.evidence.error:.1e} ({found.stop})"
    raise Failed("stalled", f"the step to {t:.6g} s stopped at {why}: use another step")
