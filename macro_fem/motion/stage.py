"""What acts in a scene in motion at a moment: histories, masses lumped at the nodes, weights, winds; half-spaces of
obstacles at their places at the end of a step, of bodies with mass, and of small motions."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from macro_fem.curtain import (
    CurtainProblem,
    CurtainSolution,
    kept_outside,
    placed_obstacles,
    tangent_walls,
    touching_walls,
    wind_density,
)
from macro_fem.fem.assembly import load_vector
from macro_fem.motion.step import Moment, TimeStep, predicted
from macro_fem.scene.loads import BREEZE, PER_MM2, areal_mass, bar_masses, breeze, nodal_forces
from macro_fem.scene.moving import Ball, at_time
from macro_fem.scene.obstacles import Body, PlacedObstacle, Sphere, unit
from macro_fem.scene.scene import Scene
from macro_fem.scene.tables import Timed, Wind
from macro_fem.solvers.walls import TOUCHED, Walls
from rve.common import Array, digits

TONNE = 1e-3
"""N s2/mm per kg: with lengths in mm and forces in N."""


@dataclass(frozen=True)
class StageOptions:
    """Numbers of what acts in a step."""

    reach: float = 2.0
    """Points farther from a ball than this many times the way that they may go in a step get no half-space."""
    turn: float = 1e-6
    """Step over the size of the curtain in which normals of obstacles are seen to turn."""


STAGE = StageOptions()


def scene_at(scene: Scene, t: float) -> Scene:
    """The scene without its motion and bodies, as its histories say at the time t."""
    items = tuple(at_time(item, t) if isinstance(item, Timed) else item for item in scene.items)
    solver = replace(scene.solver, space=scene.solver.space or scene.in_space, bounds=False, adapt=0)
    kept = tuple(item for item in items if not isinstance(item, Ball))
    return replace(scene, items=kept, motion=None, solver=solver)


def let_go(scene: Scene, t: float) -> frozenset[int]:
    """Numbers of the supports that have let go before the end of a step at t."""
    times = [np.inf if item.release is None else item.release for item in scene.support]
    return frozenset(number for number, release in enumerate(times) if release < t * (1.0 - 1e-9))


def mesh_masses(problem: CurtainProblem) -> Array:
    """Masses (n_nodes,) of the mesh alone, N s2/mm; InputError for P2."""
    scene, disc = problem.scene, problem.disc
    if disc.element != "P1":
        scene.refuse(f"[mesh] element = {disc.element!r}: motion needs P1")
    per_area = areal_mass(scene, problem.law.cell) * PER_MM2 * TONNE
    return np.asarray(per_area * load_vector(disc, np.array([1.0]))[:, 0])


def masses_of(problem: CurtainProblem, balls: tuple[Ball, ...] = ()) -> Array:
    """Masses (n,) of nodes, with the bars in edges, and of bodies, N s2/mm; InputError for P2."""
    own = mesh_masses(problem) + TONNE * bar_masses(problem.scene, problem.mesh, problem.disc, turning=True)
    return np.append(own, [TONNE * ball.mass for ball in balls])


def weights_of(problem: CurtainProblem, balls: tuple[Ball, ...]) -> Array:
    """Weights of nodes and bodies (n, d), N."""
    scene = problem.scene
    own = nodal_forces(scene, problem.mesh, problem.disc, problem.law.cell, 0.0)
    g = np.array(scene.load.acceleration[: scene.d])
    return np.vstack([own, *[ball.mass * g[None] for ball in balls]])


def step_of(
    problem: CurtainProblem, balls: tuple[Ball, ...], now: Moment, before: Moment | None, h: float, damping: float
) -> TimeStep:
    """The step of nodes and bodies; winds with a speed press by the velocity relative to the mesh."""
    dead, n = weights_of(problem, balls), problem.disc.n_nodes
    live, drag = np.zeros_like(dead), None
    live[:n] = problem.dead - dead[:n]
    if problem.winds:
        drag = np.zeros((len(dead), 3, 3))
        blown, drag[:n] = winds_at(problem, now.v, predicted(now, before, h))
        live[:n] += blown
    resist = np.where(np.arange(len(dead)) < n, damping, 0.0)  # not of bodies
    return TimeStep(now, before, h, masses_of(problem, balls), dead, live, drag, resist)


def winds_at(problem: CurtainProblem, v: Array, ahead: Moment) -> tuple[Array, Array]:
    """Forces (n_nodes, 3) of winds on the shape of the moment `ahead` by the velocity relative to the mesh, and their
    blocks, see `relative_wind`; v: the last velocities of nodes and bodies."""
    n = problem.disc.n_nodes
    force, blocks = np.zeros((n, 3)), np.zeros((n, 3, 3))
    for wind in problem.winds:
        one = replace(problem, winds=(breeze(wind),))
        pressed = load_vector(problem.exact, wind_density(one, ahead.x[:n]))
        own, block = relative_wind(wind, pressed, v[:n], ahead.v[:n])
        force += own
        blocks += block
    return force, blocks


def relative_wind(wind: Wind, force: Array, v: Array, ahead: Array) -> tuple[Array, Array]:
    """The force (n, 3) F of a wind less C v+, by the velocity relative to it, and the blocks C (n, 3, 3), >= 0.

    It is e |e| / W^2 of the `force` (n, 3) of `breeze(wind)`, which has the speed W, with e = U - v+.w of the speed U
    along w: in v+ the part along the force is linear about the last velocities v, e |e| = |e_n| (2 e - e_n), which
    settles however stiff the drag is; the part across it is that of velocities `ahead` (n, 3).
    """
    if wind.speed is None:
        return force, np.zeros((len(force), 3, 3))
    U, W, w = 1e3 * wind.speed, 1e3 * BREEZE, unit(wind.direction)
    size = np.linalg.norm(force, axis=1)
    way = force / np.maximum(size, 1e-300)[:, None]
    share = np.maximum(way @ w, 0.0)
    across = U - ahead @ w + share * (ahead * way).sum(axis=1)
    last = across - share * (v * way).sum(axis=1)
    slope = 2.0 * np.abs(last) / W**2
    own = (slope * (across - 0.5 * last))[:, None] * force
    return own, (slope * size * share)[:, None, None] * way[:, :, None] * way[:, None, :]


class Contacts:
    """Tangent half-spaces of the obstacles of a problem, and of balls whose centres are the last nodes.

    before: the problem at the start of the step, whose obstacles may be elsewhere. way: how far nodes may come towards
    a ball during the step, mm.
    """

    def __init__(
        self,
        problem: CurtainProblem,
        balls: tuple[Ball, ...],
        before: CurtainProblem | None = None,
        way: float = np.inf,
    ) -> None:
        self.problem, self.balls, self.way, self.n = problem, balls, way, problem.disc.n_nodes
        self.obstacles, self.old = placed_obstacles(problem), placed_obstacles(before or problem)
        self.near: dict[int, np.ndarray] = {}

    def tangents(self, x: Array) -> Walls:
        """Half-spaces that touch obstacles and balls where they are closest to points of nodes at x (n, d)."""
        placed = [tangent_walls(one, self.problem.fem, x[: self.n]) for one in self.obstacles]
        return Walls.joined([*placed, *self._of_balls(x), *self._between(x[self.n :])])

    def _of_balls(self, x: Array) -> list[Walls]:
        points, found, centre = self.problem.disc.meeting, [], np.eye(len(self.balls))
        at = points @ x[: self.n]
        for k, ball in enumerate(self.balls):
            away = at - x[self.n + k]
            distance = np.linalg.norm(away, axis=1)
            near = self.near.setdefault(k, np.flatnonzero(distance < ball.radius + STAGE.reach * self.way))
            less = sparse.hstack([points[near], np.tile(-centre[k], (len(near), 1))], format="csr")
            normal = away[near] / np.maximum(distance[near], 1e-300)[:, None]
            owner = np.full(len(near), -1 - k)
            found.append(Walls(less, normal, np.full(len(near), ball.radius), owner))
        return found

    def _between(self, centres: Array) -> list[Walls]:
        """Half-spaces that keep balls with these centres (b, d) off obstacles and each other."""
        count, radius = len(self.balls), np.array([ball.radius for ball in self.balls])
        at = sparse.eye(count, self.n + count, self.n, format="csr")
        found = [touching_walls(one, at, centres, radius) for one in self.obstacles if count]
        i, j = (np.asarray(one) for one in np.triu_indices(count, 1))
        away = centres[i] - centres[j]
        normal = away / np.maximum(np.linalg.norm(away, axis=1), 1e-300)[:, None]
        return [*found, Walls(at[i] - at[j], normal, radius[i] + radius[j], -1 - i)]

    def depths(self, x: Array) -> list[float]:
        """Largest depth of points of the curtain inside each ball, mm; negative where all are outside."""
        at = self.problem.disc.meeting @ x[: self.n]
        pairs = zip(self.balls, x[self.n :], strict=True)
        return [ball.radius - float(np.linalg.norm(at - centre, axis=1).min()) for ball, centre in pairs]

    def passed(self, start: Array, end: Array) -> float:
        """How deep in a body points of the curtain have been on straight ways, seen from it, over half its width."""
        fem, n, pairs = self.problem.fem, self.n, zip(self.obstacles, self.old, strict=True)
        met = [(new, new.shift - old.shift) for new, old in pairs if isinstance(new.obstacle, Body)]
        for ball, old, new in zip(self.balls, start[n:], end[n:], strict=True):
            met.append((PlacedObstacle(-1, Sphere(tuple(new), ball.radius), 1.0, 3), new - old))
        points = ((one, way, kept_outside(one, fem)) for one, way in met)
        deep = (one.deepest(at @ start[:n] + way, at @ end[:n]) / one.obstacle.breadth for one, way, at in points)
        return max(deep, default=0.0)

    def check_start(self, x: Array, is_hung: bool) -> None:
        """InputError for a ball that the curtain, an obstacle or another ball is inside of, and for an obstacle that
        the curtain is inside of, unless it is hung, which keeps it outside."""
        named = zip(self.balls, self.depths(x), strict=True)
        met = [(f"[[body]] {ball.name}: the curtain", deep) for ball, deep in named]
        words = "[[body]]: an obstacle or another body"
        met += [(words, -float(walls.gap(x).min(initial=0.0))) for walls in self._between(x[self.n :])]
        for one in () if is_hung else self.obstacles:
            deep = -float(one.gap(kept_outside(one, self.problem.fem) @ x[: self.n]).min())
            met.append((f"[obstacle] {one.obstacle.name}: the curtain", deep))
        for words, deep in met:
            if deep > TOUCHED * self.problem.mesh.size:
                self.problem.scene.refuse(
                    f"{words} is {digits(deep, 4)} mm inside it at the start; put it farther away"
                )

    def work(self, walls: Walls, force: Array, x: Array) -> tuple[Array, Array, float]:
        """Pushes `force` (m,) of tangent half-spaces: the sum of those of each obstacle (k, 3) in N, its move (k, 3) in
        mm, and pushes times the gaps at the start x (n, d), N mm."""
        pushed, touched = np.zeros((len(self.obstacles), 3)), 0.0
        moves = np.array([new.shift - old.shift for new, old in zip(self.obstacles, self.old, strict=True)])
        for number in np.unique(walls.owner):
            which = np.flatnonzero(walls.owner == number)
            own, push = walls.take(which), force[which]
            if number < 0:
                touched += float(push @ (np.linalg.norm(own.at @ x, axis=1) - own.offset))
                continue
            old, new = self.old[number], self.obstacles[number]
            pushed[number, : own.normal.shape[1]] = push @ own.normal
            touched += float(
                push @ (old.gap(own.at @ x) - (own.offset - new.offset(own.normal)))
            )  # less a ball's radius
        return pushed, moves.reshape(-1, 3), touched

    def pushes(self, walls: Walls, force: Array) -> Array:
        """Forces (k, n_nodes, d) of each obstacle, then of each ball, on the nodes of the curtain, N."""
        owners = [*(one.number for one in self.obstacles), *(-1 - k for k in range(len(self.balls)))]
        each = [walls.nodal(np.where(walls.owner == one, force, 0.0))[: self.n] for one in owners]
        return np.reshape(each, (len(each), self.n, self.problem.fem.d))


def pushed_points(solution: CurtainSolution, carries: float) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Of small motions w of the nodes in space (3 n_nodes,): rows normal.w of the points that obstacles push, by more
    than this part of the largest push, and the matrix of pushes times how the normals turn there, N/mm."""
    problem, walls, force = solution.problem, solution.problem.walls, solution.wall_forces
    which = np.flatnonzero(force > carries * force.max(initial=0.0))
    walls, force, n = walls.take(which), force[which], 3 * problem.disc.n_nodes
    if not len(which):
        return walls.matrix, sparse.csr_matrix((n, n))
    rows = walls.matrix
    rows = sparse.csr_matrix(sparse.diags(1.0 / sparse.linalg.norm(rows, axis=1)) @ rows)
    turn, at, step = np.zeros((len(which), 3, 3)), walls.at @ solution.x, STAGE.turn * problem.mesh.size
    for one in placed_obstacles(problem):
        own = np.flatnonzero(walls.owner == one.number)
        for axis, way in enumerate(step * np.eye(3)):
            turn[own, :, axis] = (one.normal(at[own] + way) - one.normal(at[own] - way)) / (2.0 * step)
    G = sparse.kron(walls.at, sparse.eye(3))
    return rows, sparse.csr_matrix(G.T @ sparse.block_diag(force[:, None, None] * turn) @ G)
