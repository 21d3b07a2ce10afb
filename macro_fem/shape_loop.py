"""Curtains whose problem depends on their own shape: bodies to stay outside of, wind on the present shape.

At a shape x each body is replaced by tangent half-spaces, at its points closest to the nodes and to the middles of
sides and cells, and the wind by dead forces (`macro_fem.drag`); the answer to that convex problem (`macro_fem.curtain`)
is the next shape. The half-spaces of a convex body exclude it, and x satisfies those found at x: without such wind
every round is admissible and lowers the potential. Rounds end when neither half-spaces nor forces turn any more.

Which side of a body a node is on is decided before the first round: by the last load step, or by where the sheet starts
([start], or the curtain without bodies), pushed along by the bodies as they move into place.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from macro_fem.curtain import CurtainProblem, CurtainSolution, tangent_walls, wind_density
from macro_fem.fem.assembly import load_vector
from macro_fem.fem.discretization import FINE
from macro_fem.scene.loads import wind_per_area
from macro_fem.scene.obstacles import PlacedObstacle
from macro_fem.solvers.status import Settling, load_scale
from macro_fem.solvers.walls import TOUCHED, Walls
from rve.common import Array, digits, part_of

ROUNDS = 60
"""Most rounds; one costs a convex solve."""
SETTLED = 1e-6
"""Forces that may still turn between two rounds, over the loads. Smaller values take more rounds."""
DAMPING, LEAST_DAMPING = 0.5, 0.25
"""First and least part of the way to the next shape at which wind is evaluated, far from the answer. Larger parts let a
sheet collapse before the pressure opens it, smaller ones take more rounds."""
MIXED_FROM = 0.2
"""Relative change of the wind's forces from which rounds are mixed. Farther away changes are not nearly linear."""
MEMORY = 20
"""Rounds before, of whose pressures the next one is mixed so that the changes cancel."""
IDLE = 25
"""Rounds without a smaller change after which rounds end: the curtain has no rest near the last shapes."""
DRAG_SETTLED, DRAG_IDLE = 1e-4, 5
"""What drag along the wind may still turn, over the loads, after so many idle rounds: rigid rings of a gathered sheet
leave open how far single cells fold, and those take turns at some 1e-5."""
SMOOTHING = (1e-3, 3e-3, 1e-2)
"""Stabilising tensions in drag for cells that fold now one way and now the other; mean heights + 0 to 0.7 %."""
STRIDES = 40
"""Parts into which a move of bodies is cut while they push nodes along. More follow round bodies better."""
PACE = 0.5
"""Largest move of a body at once, over half its least width. Larger ones may leave nodes beside it."""
SHORTEST = 1.0 / 32
"""Least part of the way of supports and bodies that is tried at once before the curtain counts as blocked."""
STEEP_PART = 0.1
"""First part of a change that is taken of wind that follows with a speed, whose force falls much faster than the sheet
turns out of it. Larger parts begin with more detours."""
STEEP_SETTLED, STEEP_TOLERANCE = 1e-3, 1e-12
"""What such wind, and drag after the last round, may still turn, over the loads, and the largest gap of the convex
solves of such wind: positions are known to the square root of the gap, and forces on a sheet at 8 degrees to the wind
to thirteen times that. With 1e-9 some strips find no rest."""
LEAST_PART = 0.02
"""Least part of a change that is taken. Less hardly moves."""
FAR = 2.0
"""Changes this many times the least one are not built upon. Smaller values go back from every detour."""
KEPT = 3
"""Rounds that are remembered on the way back."""
GROWTH = 1.3
"""How much larger the part becomes with every least change."""
FLAT = 1e-4
"""Relative singular values of changes that are noise. With 1e-8 mixed forces were noise of solvers, multiplied."""

Solve = Callable[[CurtainProblem, CurtainSolution | None], CurtainSolution]
"""The solver of a convex problem, from a curtain before."""


def solve_shape(
    problem: CurtainProblem, start: CurtainSolution | None, solve: Solve, smoothing: float = 0.0
) -> CurtainSolution:
    """The curtain of a problem with bodies or wind on its shape, by `solve` for each round.

    InputError if the curtain is inside a body to begin with. Rounds that do not settle end as "unsettled", impossible
    ones with their own status. A sheet that finds no rest in drag along the wind is tried again with a stabilising
    tension of `SMOOTHING`, as `smoothing` tells.
    """
    begin, scene = time.perf_counter(), problem.scene
    is_steep = any(wind.follows and wind.speed is not None for wind in problem.winds)
    settled, part = (STEEP_SETTLED, STEEP_PART) if is_steep else (SETTLED, 1.0)
    is_drag = not problem.bodies and not any(wind.follows for wind in problem.winds)
    if is_steep:
        exact = replace(scene.solver, tolerance=min(scene.solver.tolerance, STEEP_TOLERANCE))
        problem = replace(problem, scene=replace(scene, solver=exact))
    first = start if start is not None else _first(problem, solve)
    shape = first.x
    mixer = Mixer(problem.exact.weight, MEMORY, part, 0.5 if is_steep else 1.0)
    if start is None and any(wind.speed is None for wind in problem.winds):
        X = problem.disc.nodes  # the sheet before anything pulls it out of its plane
        shape = X @ problem.frame.T if scene.start is None else scene.start.places(X)
    wind = wind_density(problem, shape)
    watch = _Watch(problem, 0.0 if start is None or start.settling is None else start.settling.crossed)
    tangents, found = _approach(problem, first, wind, start, solve, watch)
    record, misfits, damping = None, list[float](), DAMPING
    for rounds in range(1, ROUNDS + 1):
        if found.status in ("infeasible", "not_finite"):
            break
        change = wind_density(problem, found.x) - wind
        turned = [tangent_walls(body, problem.fem, found.x) for body in problem.bodies]
        record = _measure_settling(problem, found, turned, change, settled)
        record = replace(record, rounds=rounds, crossed=watch.deepest, smoothing=smoothing)
        is_last = rounds == ROUNDS or bool(problem.winds and mixer.idle > IDLE)
        if is_drag and (is_last or mixer.idle > DRAG_IDLE):
            record = replace(record, asked=STEEP_SETTLED if is_last else DRAG_SETTLED)
        if record.is_settled or is_last:
            break
        misfits.append(record.misfit)
        tangents = turned
        if not is_steep and np.linalg.norm(change) > MIXED_FROM * np.linalg.norm(wind):
            damping = max(LEAST_DAMPING, 0.5 * damping) if len(misfits) > 1 and misfits[-1] > misfits[-2] else damping
            shape = shape + damping * (found.x - shape)
            wind = wind_density(problem, shape)
        else:
            shape, wind = found.x, mixer.next(wind, change)
        with part_of(f"shape of the curtain, round {rounds}, change {record.misfit:.0e} down to {settled:.0e}"):
            last, found = found, solve(_pose(problem, tangents, wind), found)
        watch.look(problem.bodies, last.x, found.x)
    own = replace(found.problem, scene=scene, bodies=problem.bodies, winds=problem.winds)
    found = replace(found, problem=own, settling=record)
    higher = [tension for tension in SMOOTHING if tension > scene.solver.stabilising_tension]
    if is_drag and found.status == "unsettled" and higher:
        tense = replace(scene, solver=replace(scene.solver, stabilising_tension=higher[0]))
        found = solve_shape(replace(problem, scene=tense), found, solve, higher[0])
    return replace(found, wall_s=time.perf_counter() - begin)


def _approach(
    problem: CurtainProblem,
    first: CurtainSolution,
    wind: Array,
    start: CurtainSolution | None,
    solve: Solve,
    watch: _Watch,
) -> tuple[list[Walls], CurtainSolution]:
    """The first tangent half-spaces and the curtain in them, after supports and bodies have moved into place: in as
    large strides as leave a state in the half-spaces found before. After `SHORTEST` the curtain says it is blocked.
    """
    held = np.where(problem.fem.held, first.x, 0.0)
    before = 0.0 if start is None else start.problem.factor
    # the part of their moves that no body should exceed at once: farther, and it may pass between nodes
    parts = [one.obstacle.breadth / max(float(np.linalg.norm(one.obstacle.move)), 1e-300) for one in problem.bodies]
    stride = max(SHORTEST, min([1.0, *(PACE * part / max(problem.factor - before, 1e-300) for part in parts)]))
    done, x, last = 0.0, first.x, start
    while True:
        part = min(1.0, done + stride)
        factors = (before + done * (problem.factor - before), before + part * (problem.factor - before))
        bodies = tuple(replace(one, factor=factors[1]) for one in problem.bodies)
        fem = problem.fem.moved((1.0 - part) * held + part * problem.fem.x_held) if part < 1.0 else problem.fem
        pushed, here = _push_out(problem, x, *factors, watch), replace(problem, fem=fem, bodies=bodies)
        tangents = [tangent_walls(body, fem, pushed) for body in bodies]
        with part_of(f"moving into place, {100.0 * done:.0f} % done"):
            found = solve(_pose(here, tangents, wind), last)
        if found.status == "infeasible" and stride > SHORTEST:
            stride *= 0.5
            continue
        watch.look(bodies, pushed, found.x)
        if found.status == "infeasible" or part == 1.0:
            return tangents, found
        done, x, last = part, found.x, found


class _Watch:
    """How deep points of the mesh, a third of half a body's least width apart, have been inside it, over that half.

    Cells at held nodes are left out, as supports take these along.
    """

    def __init__(self, problem: CurtainProblem, deepest: float) -> None:
        disc, half = problem.disc, min([body.obstacle.breadth for body in problem.bodies], default=np.inf)
        fine = max(FINE, math.ceil(3.0 * problem.mesh.longest_side / half))
        lattice = disc.lattice_of(fine)
        self.lattice = lattice[np.flatnonzero(abs(lattice) @ problem.fem.held.any(axis=1) == 0.0)]
        self.deepest = deepest

    def look(self, bodies: Sequence[PlacedObstacle], before: Array, after: Array) -> None:
        """Look at straight ways between two shapes (n_nodes, d)."""
        start, end = self.lattice @ before, self.lattice @ after
        for body in bodies:
            half = body.obstacle.breadth
            self.deepest = body.deepest(start, end, self.deepest * half) / half


def _pose(problem: CurtainProblem, tangents: list[Walls], wind: Array) -> CurtainProblem:
    """The convex problem with tangent half-spaces and dead wind (n_points, d) in N/mm2."""
    walls = Walls.joined([problem.walls, *tangents])
    return replace(problem, bodies=(), winds=(), wind=wind if problem.winds else None, walls=walls)


def _first(problem: CurtainProblem, solve: Solve) -> CurtainSolution:
    """The sheet at its start, or the curtain without bodies in dead wind; InputError for a point inside a body."""
    scene, disc = problem.scene, problem.disc
    per_area = sum((wind_per_area(wind, scene, problem.law.cell) for wind in problem.winds), np.zeros(3))
    found = solve(_pose(problem, [], np.tile(problem.factor * per_area, (disc.n_points, 1))), None)
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
    return found


def _push_out(problem: CurtainProblem, x: Array, before: float, after: float, watch: _Watch) -> Array:
    """Places (n_nodes, d) after bodies, from one share of their moves to another, have pushed the nodes they meet."""
    for factor in np.linspace(before, after, STRIDES + 1)[1:]:
        for body in problem.bodies:
            if any(body.obstacle.move):
                here = replace(body, factor=float(factor))
                x = x + np.maximum(-here.gap(x), 0.0)[:, None] * here.normal(x)
                watch.look([here], x, x)
    return x


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


class Mixer:
    """Fixed points of forces by Anderson's mixing, with a way back (D. G. Anderson, J. ACM 12, 1965).

    Forces f are looked for that a map G leaves: G(f) - f = 0. The next ones are those at which the changes seen so far,
    if they were linear, would cancel, plus a part of what then remains. Where a change is far larger than the least
    one, the forces of that one are tried again with half the part, and all but the newest few are forgotten: the slope
    of G may be far below -1, so that rounds swing between a curtain that flies and one that hangs.

    Forces (n_points, d) of `memory` rounds at points of the areas `weight` (n_points,), and the least changed ones.

    part: of a change that is taken at first and `most` later. `idle`: rounds since the change was least.
    """

    def __init__(self, weight: Array, memory: int, part: float, most: float) -> None:
        self.scale, self.memory = np.sqrt(weight)[:, None], memory
        self.part, self.most, self.idle = part, most, 0
        self.rounds: list[Array] = []  # forces and their changes (2, n_points, d)
        self.best: tuple[Array, Array] | None = None
        self.least = self.far = np.inf

    def next(self, force: Array, change: Array) -> Array:
        """The force (n_points, d) to try after one that the present shape would change by `change`."""
        size = float(np.linalg.norm(self.scale * change))
        if self.best is not None and size > self.far:
            return self._back()
        if size < self.least:
            self.least, self.best, self.idle = size, (force, change), 0
            self.part = min(self.most, GROWTH * self.part)
        else:
            self.idle += 1
        self.far = FAR * self.least
        self.rounds = [*self.rounds, np.stack([force, change])][-self.memory - 1 :]
        return self._mixed(force, change)

    def _back(self) -> Array:
        """The best forces and a smaller part of their change."""
        assert self.best is not None
        self.part = max(0.5 * self.part, LEAST_PART)
        self.far *= FAR
        self.idle += 1
        self.rounds = self.rounds[-KEPT:]
        return np.asarray(self.best[0] + self.part * self.best[1])

    def _mixed(self, force: Array, change: Array) -> Array:
        """Force and change less the sum of earlier ones that cancels the change best."""
        if len(self.rounds) == 1:
            return force + self.part * change
        df, dg = np.stack([self.rounds[-1] - before for before in self.rounds[:-1]], axis=-1)
        scaled = (self.scale[:, :, None] * dg).reshape(-1, dg.shape[-1])
        sizes = np.maximum(np.linalg.norm(scaled, axis=0), 1e-300)
        weights = np.linalg.lstsq(scaled / sizes, (self.scale * change).ravel(), rcond=FLAT)[0] / sizes
        return np.asarray(force + self.part * change - (df + self.part * dg) @ weights)
