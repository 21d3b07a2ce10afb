"""Curtains whose problem depends on their own shape: bodies to stay outside of, wind on the present shape.

At a shape x each body is replaced by tangent half-spaces, at its points closest to the nodes and to the middles of
sides and cells (`macro_fem.curtain.contact`), and the wind by dead forces (`macro_fem.curtain.wind`); the answer to
that convex problem is the next shape. The half-spaces of a convex body exclude it, and x satisfies those found at x:
without such wind every round is admissible and lowers the potential. Rounds end when neither half-spaces nor forces
turn any more.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from macro_fem.curtain.contact import Solve, Watch, approach, pose
from macro_fem.curtain.problem import CurtainProblem, tangent_walls
from macro_fem.curtain.solution import CurtainSolution
from macro_fem.curtain.wind import Mixer, wind_density
from macro_fem.fem.assembly import load_vector
from macro_fem.scene.loads import wind_per_area
from macro_fem.solvers.status import Settling, load_scale
from macro_fem.solvers.walls import TOUCHED, Walls
from rve.common import Array, digits, part_of


@dataclass(frozen=True)
class ShapeOptions:
    """Numbers of the rounds in which a shape settles, and of the wind in them."""

    rounds: int = 60
    """Most rounds; one costs a convex solve."""
    settled: float = 1e-6
    """Forces that may still turn between two rounds, over the loads. Smaller values take more rounds."""
    damping: float = 0.5
    least_damping: float = 0.25
    """First and least part of the way to the next shape at which wind is evaluated, far from the answer. Larger parts
    let a sheet collapse before the pressure opens it, smaller ones take more rounds."""
    mixed_from: float = 0.2
    """Relative change of the wind's forces from which rounds are mixed. Farther away changes are not nearly linear."""
    idle: int = 25
    """Rounds without a smaller change after which rounds end: the curtain has no rest near the last shapes."""
    drag_settled: float = 1e-4
    drag_idle: int = 5
    """What drag along the wind may still turn, over the loads, after so many idle rounds: rigid rings of a gathered
    sheet leave open how far single cells fold, and those take turns at some 1e-5."""
    smoothing: tuple[float, ...] = (1e-3, 3e-3, 1e-2)
    """Stabilising tensions in drag for cells that fold now one way and now the other; mean heights + 0 to 0.7 %."""
    steep_part: float = 0.1
    """First part of a change that is taken of wind that follows with a speed, whose force falls much faster than the
    sheet turns out of it. Larger parts begin with more detours."""
    steep_settled: float = 1e-3
    steep_tolerance: float = 1e-12
    """What such wind, and drag after the last round, may still turn, over the loads, and the largest gap of the convex
    solves of such wind: positions are known to the square root of the gap, and forces on a sheet at 8 degrees to the
    wind to thirteen times that. With 1e-9 some strips find no rest."""


SHAPE = ShapeOptions()


def solve_shape(
    problem: CurtainProblem,
    start: CurtainSolution | None,
    solve: Solve,
    smoothing: float = 0.0,
    options: ShapeOptions = SHAPE,
) -> CurtainSolution:
    """The curtain of a problem with bodies or wind on its shape, by `solve` for each round.

    InputError if the curtain is inside a body to begin with. Rounds that do not settle end as "unsettled", impossible
    ones with their own status. A sheet that finds no rest in drag along the wind is tried again with a stabilising
    tension of `ShapeOptions.smoothing`, as `smoothing` tells.
    """
    begin, scene = time.perf_counter(), problem.scene
    is_steep = any(wind.follows and wind.speed is not None for wind in problem.winds)
    settled, part = (options.steep_settled, options.steep_part) if is_steep else (options.settled, 1.0)
    is_drag = not problem.bodies and not any(wind.follows for wind in problem.winds)
    if is_steep:
        exact = replace(scene.solver, tolerance=min(scene.solver.tolerance, options.steep_tolerance))
        problem = replace(problem, scene=replace(scene, solver=exact))
    mixer = Mixer(problem.exact.weight, part, 0.5 if is_steep else 1.0)
    first, shape = (start, start.x) if start is not None else _first(problem, solve)
    wind = wind_density(problem, shape)
    watch = Watch(problem, 0.0 if start is None or start.settling is None else start.settling.crossed)
    tangents, found = approach(problem, first, wind, start, solve, watch)
    record, misfits, damping = None, list[float](), options.damping
    for rounds in range(1, options.rounds + 1):
        if found.status in ("infeasible", "not_finite"):
            break
        change = wind_density(problem, found.x) - wind
        turned = [tangent_walls(body, problem.fem, found.x) for body in problem.bodies]
        record = _measure_settling(problem, found, turned, change, settled)
        record = replace(record, rounds=rounds, crossed=watch.deepest, smoothing=smoothing)
        is_last = rounds == options.rounds or bool(problem.winds and mixer.idle > options.idle)
        if is_drag and (is_last or mixer.idle > options.drag_idle):
            record = replace(record, asked=options.steep_settled if is_last else options.drag_settled)
        if record.is_settled or is_last:
            break
        misfits.append(record.misfit)
        tangents = turned
        if not is_steep and np.linalg.norm(change) > options.mixed_from * np.linalg.norm(wind):
            is_worse = len(misfits) > 1 and misfits[-1] > misfits[-2]
            damping = max(options.least_damping, 0.5 * damping) if is_worse else damping
            shape = shape + damping * (found.x - shape)
            wind = wind_density(problem, shape)
        else:
            shape, wind = found.x, mixer.next(wind, change)
        with part_of(f"shape of the curtain, round {rounds}, change {record.misfit:.0e} down to {settled:.0e}"):
            last, found = found, solve(pose(problem, tangents, wind), found)
        watch.look(problem.bodies, last.x, found.x)
    own = replace(found.problem, scene=scene, bodies=problem.bodies, winds=problem.winds)
    found = replace(found, problem=own, settling=record)
    higher = [tension for tension in options.smoothing if tension > scene.solver.stabilising_tension]
    if is_drag and found.status == "unsettled" and higher:
        tense = replace(scene, solver=replace(scene.solver, stabilising_tension=higher[0]))
        found = solve_shape(replace(problem, scene=tense), found, solve, higher[0], options)
    return replace(found, wall_s=time.perf_counter() - begin)


def _first(problem: CurtainProblem, solve: Solve) -> tuple[CurtainSolution, Array]:
    """The sheet at its start, or the curtain without bodies in dead wind, and the shape (n_nodes, d) that wind meets:
    under a pressure the flat sheet, before anything pulls it out of its plane. InputError for a point inside a body.
    """
    scene, disc = problem.scene, problem.disc
    per_area = sum((wind_per_area(wind, scene, problem.law.cell) for wind in problem.winds), np.zeros(3))
    found = solve(pose(problem, [], np.tile(problem.factor * per_area, (disc.n_points, 1))), None)
    if scene.start is not None:
        x = scene.start.places(disc.nodes)
        found = replace(found, x=x)
    for body in problem.bodies:
        here = replace(body, factor=0.0)
        deep = -float(here.gap(disc.lattice @ found.x).min())
        if deep > TOUCHED * problem.mesh.size:
            scene.refuse(
                f"[obstacle] {body.obstacle.name}: the curtain is up to {digits(deep, 4)} mm inside it before anything "
                "moves; lay the sheet beside it by [start], or let it come by move"
            )
    if all(wind.speed is not None for wind in problem.winds):
        return found, found.x
    return found, disc.nodes @ problem.frame.T if scene.start is None else found.x


def _measure_settling(
    problem: CurtainProblem, found: CurtainSolution, turned: list[Walls], change: Array, settled: float
) -> Settling:
    """The residuals of a round: how much its reactions and the wind turn at its own shape."""
    walls, x = found.problem.walls, found.x
    total = load_scale(found.problem.force, problem.disc.weight)
    turning = load_vector(problem.exact, change) if problem.winds else np.zeros((0, 3))
    misfit, product, deepest, depth = float(np.linalg.norm(turning, axis=1).sum()), 0.0, 0.0, 0.0
    for body, now in zip(problem.bodies, turned, strict=True):
        of_body = walls.owner == body.number
        own, push = walls.take(of_body), found.wall_forces[of_body]
        misfit += float(push @ np.linalg.norm(now.normal - own.normal, axis=1))
        product += float(push @ np.abs(body.gap(own.at @ x)))
        inside = max(0.0, -float(body.gap(problem.disc.lattice @ x).min()))
        deepest, depth = max(deepest, inside), max(depth, inside / body.obstacle.breadth)
    product /= total * problem.mesh.size
    return Settling(0, misfit / total, product, settled, deepest, depth, is_wind=not problem.bodies)
