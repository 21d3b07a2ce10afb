"""Curtains whose problem depends on their own shape: bodies to stay outside of, pressure normal to the surface.

Neither is convex. At a shape x each body is replaced by tangent half-spaces, at its points closest to the nodes and to
the middles of sides and cells, and the pressure by dead nodal forces; that is a convex problem (`macro_fem.curtain`),
whose answer is the next shape. The half-spaces of a convex body exclude the body, and x satisfies those found at x:
without following pressure every round is admissible and lowers the potential. The rounds end when neither half-spaces
nor forces turn any more; the record tells by how much they still do.

Which side of a body a node is on is decided once, before the first round: by the last load step, or by where the sheet
starts ([start], or the curtain without bodies), pushed along by the bodies as they move into place.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from macro_fem.fem.assembly import gradient, load_vector
from macro_fem.fem.discretization import FINE
from macro_fem.scene.loads import wind_per_area
from macro_fem.scene.obstacles import Body, Placed, breadth, placed, unit
from macro_fem.solution import CurtainSolution, Problem, meeting_points, tangent_walls, unit_tensors
from macro_fem.solvers.status import Settling, load_scale
from macro_fem.solvers.walls import TOUCHED, Walls
from rve.common.errors import InputError
from rve.common.progress import part_of, way
from rve.common.types import Array
from rve.common.values import Options, number, whole


@dataclass(frozen=True)
class ShapeOptions(Options):
    """When the rounds end; InputError for values that make no sense."""

    rounds: int = whole(60, least=1, most=10_000)
    """Most rounds; one costs a convex solve."""
    settled: float = number(1e-6, above=0.0, most=1.0)
    """Forces that may still turn between two rounds, over the loads. Smaller values take more rounds."""
    damping: float = number(0.5, above=0.0, most=1.0)
    """Part of the way to the next shape at which following pressure is evaluated, far from the answer. Larger parts let
    a sheet collapse before the pressure opens it, smaller ones take more rounds."""
    memory: int = whole(6, least=0, most=50)
    """Rounds before, of whose pressures the next one is mixed so that the changes cancel. 0 mixes none."""
    strides: int = whole(40, least=1, most=10_000)
    """Parts into which a move of bodies is cut while they push nodes along. More follow round bodies better."""
    pace: float = number(0.5, above=0.0, most=1e3)
    """Largest move of a body at once, over half its least width. Larger ones may leave nodes beside it."""
    shortest: float = number(1.0 / 32, above=0.0, most=1.0)
    """Least part of the way of supports and bodies that is tried at once before the curtain counts as blocked."""


SHAPE = ShapeOptions()
"""The defaults."""

Solve = Callable[[Problem, CurtainSolution | None], CurtainSolution]
"""The solver of a convex problem, from a curtain before."""


def solve_shape(
    problem: Problem, start: CurtainSolution | None, solve: Solve, options: ShapeOptions = SHAPE
) -> CurtainSolution:
    """The curtain of a problem with bodies or following pressure, by `solve` for each round.

    InputError if the curtain is inside a body to begin with. An answer whose rounds have not settled has the status
    "unsettled"; one that is impossible in some round has the status of that round.
    """
    begin = time.perf_counter()
    sense = _sense(problem)
    first = start if start is not None else _first(problem, solve)
    shape, mixer = first.F, _Mixer(options.memory)
    force = following(problem, shape, sense)
    watch = _Watch(problem, 0.0 if start is None or start.settling is None else start.settling.crossed)
    normals, found = _approached(problem, first, force, start, solve, options, watch)
    record, misfits = None, list[float]()
    for rounds in range(1, options.rounds + 1):
        if found.status in ("infeasible", "not_finite"):
            break
        change = following(problem, found.F, sense) - force
        turned = _normals(problem.bodies, problem, found.x)
        record = replace(_record(problem, found, turned, change, rounds, options), crossed=watch.deepest)
        if record.is_settled:
            break
        misfits.append(record.misfit)
        normals = turned
        if np.linalg.norm(change) > MIXED_FROM * np.linalg.norm(force):
            shape = shape + options.damping * (found.F - shape)
            force = following(problem, shape, sense)
        else:
            shape, force = found.F, mixer.next(force, change)
        if rounds < options.rounds:
            share = way(misfits[0], record.misfit, options.settled)
            with part_of(f"shape of the curtain, round {rounds}", share, share):
                last, found = found, solve(_posed(problem, normals, force), found)
            watch.look(problem.bodies, last.x, found.x)
    own = replace(found.problem, bodies=problem.bodies, follows=problem.follows)
    return replace(found, problem=own, settling=record, wall_s=time.perf_counter() - begin)


def _approached(
    problem: Problem,
    first: CurtainSolution,
    force: Array,
    start: CurtainSolution | None,
    solve: Solve,
    options: ShapeOptions,
    watch: _Watch,
) -> tuple[list[Array], CurtainSolution]:
    """The first tangent half-spaces and the curtain in them, after supports and bodies have moved into place.

    In as large strides as the half-spaces leave room for: those found at one shape may exclude every state of a curtain
    whose supports are elsewhere. After `options.shortest` the last curtain says that it is blocked.
    """
    held = np.where(problem.fem.held, first.x, 0.0)
    before = 0.0 if start is None else start.problem.factor
    done, stride, x, last = 0.0, _stride(problem, before, options), first.x, start
    while True:
        part = min(1.0, done + stride)
        factors = (before + done * (problem.factor - before), before + part * (problem.factor - before))
        bodies = tuple(placed(one.number, one.obstacle, factors[1], one.d) for one in problem.bodies)
        fem = problem.fem.moved((1.0 - part) * held + part * problem.fem.x_held) if part < 1.0 else problem.fem
        pushed = _ploughed(problem, x, *factors, options, watch)
        normals = _normals(bodies, problem, pushed)
        with part_of(f"moving into place, {100.0 * done:.0f} % done", done, part):
            found = solve(_posed(replace(problem, fem=fem, bodies=bodies), normals, force), last)
        if found.status == "infeasible" and stride > options.shortest:
            stride *= 0.5
            continue
        watch.look(bodies, pushed, found.x)
        if found.status == "infeasible" or part == 1.0:
            return normals, found
        done, x, last = part, found.x, found


def _normals(bodies: Sequence[Placed], problem: Problem, x: Array) -> list[Array]:
    """Normals (m, d) of the half-spaces that touch each body, at the points where the mesh meets bodies."""
    return [body.normal(meeting_points(body.obstacle, problem.disc).places(x)) for body in bodies]


MIXED_FROM = 0.2
"""Relative change of the pressure's forces from which rounds are mixed. Farther away changes are not nearly linear."""


def _stride(problem: Problem, before: float, options: ShapeOptions) -> float:
    """The part of their moves that no body should exceed at once: farther, and it may pass between nodes."""
    parts = [1.0]
    for body in problem.bodies:
        way = (problem.factor - before) * float(np.linalg.norm(body.obstacle.move))
        parts.append(options.pace * breadth(cast(Body, body.obstacle)) / max(way, 1e-300))
    return max(options.shortest, min(parts))


class _Watch:
    """How deep points of the mesh, at its nodes and between them, have been inside a body, over half its least width.

    They lie a third of that apart. Cells at held nodes are left out, as supports take these along.
    """

    def __init__(self, problem: Problem, deepest: float) -> None:
        disc, half = problem.disc, min([breadth(cast(Body, body.obstacle)) for body in problem.bodies], default=np.inf)
        fine = max(FINE, math.ceil(3.0 * problem.mesh.longest_side / half))
        lattice = disc.lattice if fine == FINE else disc.lattice_of(fine)
        is_held = np.isin(lattice.node, np.flatnonzero(problem.fem.held.any(axis=1)))
        is_held = (is_held & (lattice.share != 0.0)).any(axis=1)
        self.lattice = lattice.only(np.flatnonzero(~is_held))
        self.deepest = deepest

    def look(self, bodies: Sequence[Placed], before: Array, after: Array) -> None:
        """Look at straight ways between two shapes (n_nodes, d)."""
        start, end = self.lattice.places(before), self.lattice.places(after)
        way = np.linalg.norm(end - start, axis=1)
        for body in bodies:
            half = breadth(cast(Body, body.obstacle))
            may = np.flatnonzero(0.5 * (body.gap(start) + body.gap(end) - way) < -self.deepest * half)
            deep = -float(body.least_gap(start[may], end[may]).min(initial=0.0))
            self.deepest = max(self.deepest, deep / half)


class _Mixer:
    """Anderson's mixing of the forces of a fixed point f = G(f), from forces and their changes G(f) - f.

    D. G. Anderson, J. ACM 12 (1965); where the change grows its memory is cleared.
    """

    def __init__(self, memory: int) -> None:
        self.memory = memory
        self.forces: list[Array] = []
        self.changes: list[Array] = []

    def next(self, force: Array, change: Array) -> Array:
        """The force (n_nodes, d) to try after one that the present shape would change by `change`."""
        if self.changes and np.linalg.norm(change) > np.linalg.norm(self.changes[-1]):
            self.forces, self.changes = [], []
        self.forces = [*self.forces, force][-self.memory - 1 :]
        self.changes = [*self.changes, change][-self.memory - 1 :]
        if len(self.changes) == 1:
            return force + change
        dg = np.stack([(change - old).ravel() for old in self.changes[:-1]], axis=1)
        df = np.stack([(force - old).ravel() for old in self.forces[:-1]], axis=1)
        weights = np.linalg.lstsq(dg, change.ravel(), rcond=1e-8)[0]
        return np.asarray(force + change - ((df + dg) @ weights).reshape(force.shape))


def _posed(problem: Problem, normals: list[Array], force: Array) -> Problem:
    """The convex problem with tangent half-spaces of these normals and dead forces (n_nodes, d) for the pressure."""
    flat = [] if problem.walls is None else [problem.walls]
    tangent = [tangent_walls(body, problem.fem, normal) for body, normal in zip(problem.bodies, normals, strict=True)]
    walls = Walls.joined([*flat, *tangent])
    return replace(problem, bodies=(), follows=(), walls=walls, force=problem.force + force)


def _first(problem: Problem, solve: Solve) -> CurtainSolution:
    """Where nodes are before bodies move: the sheet at its start, or the curtain without bodies, in dead wind.

    InputError for a point of the mesh inside a body.
    """
    scene, disc = problem.scene, problem.disc
    dead = problem.force
    for wind in problem.follows:
        dead = dead + load_vector(disc, problem.factor * wind_per_area(wind, problem.scene, problem.law.cell))
    found = solve(replace(problem, bodies=(), follows=(), force=dead), None)
    if scene.start is not None:
        x = scene.start.places(disc.nodes)
        found = replace(found, x=x, F=gradient(disc, x))
    elif problem.follows:
        found = replace(found, F=unit_tensors(problem))
    for body in problem.bodies:
        here = placed(body.number, body.obstacle, 0.0, body.d)
        deep = -float(here.gap(disc.lattice.places(found.x)).min())
        if deep > TOUCHED * problem.mesh.size:
            raise InputError(
                f"{scene.source}: [obstacle] {body.obstacle.name}: the curtain is up to {deep:.4g} mm inside it before "
                "anything moves; lay the sheet beside it by [start], or let it come by move"
            )
    return found


def _ploughed(problem: Problem, x: Array, before: float, after: float, options: ShapeOptions, watch: _Watch) -> Array:
    """Places (n_nodes, d) after the bodies have gone from one share of their moves to another.

    Nodes that a body meets are pushed to its surface.
    """
    for factor in np.linspace(before, after, options.strides + 1)[1:]:
        for body in problem.bodies:
            if any(body.obstacle.move):
                here = placed(body.number, body.obstacle, float(factor), body.d)
                x = x + np.maximum(-here.gap(x), 0.0)[:, None] * here.normal(x)
                watch.look([here], x, x)
    return x


def _sense(problem: Problem) -> list[float]:
    """1 for each following pressure that blows along F_1 x F_2 of the flat sheet where it starts, -1 against it.

    InputError for one that blows along the flat sheet.
    """
    if not problem.follows:
        return []
    start = problem.scene.start
    axes = problem.frame.T if start is None else (unit(start.x_axis), unit(start.y_axis))
    normal = np.cross(*axes)
    signs = []
    for wind in problem.follows:
        along = float(normal @ unit(wind.direction))
        if abs(along) < 1e-3:
            raise InputError(
                f"{problem.scene.source}: [load.wind] direction = {list(wind.direction)}: lies in the flat sheet, so "
                "that it tells no side for follows = true; lay the sheet across it by [start]"
            )
        signs.append(float(np.sign(along)))
    return signs


def following(problem: Problem, F: Array, sense: list[float]) -> Array:
    """Nodal forces (n_nodes, d), N, of following pressure on a shape with gradients F (nq, 3, 2).

    The normal times the present area per reference area is F_1 x F_2.
    """
    total = np.zeros_like(problem.force)
    for wind, sign in zip(problem.follows, sense, strict=True):
        per_area = wind_per_area(wind, problem.scene, problem.law.cell)
        pressure = sign * problem.factor * float(unit(wind.direction) @ per_area)
        total += load_vector(problem.disc, pressure * np.cross(F[:, :, 0], F[:, :, 1]))
    return total


def _record(
    problem: Problem, found: CurtainSolution, turned: list[Array], change: Array, rounds: int, options: ShapeOptions
) -> Settling:
    """The residuals of a round: how much its reactions and the pressure turn at its own shape."""
    walls, x = found.problem.walls, found.x
    total = load_scale(found.problem.force, problem.disc.weight)
    misfit, product, deepest, depth = float(np.linalg.norm(change, axis=1).sum()), 0.0, 0.0, 0.0
    for body, normal in zip(problem.bodies, turned, strict=True):
        assert walls is not None
        of_body = walls.owner == body.number
        own, push = walls.only(of_body), found.wall_forces[of_body]
        now = tangent_walls(body, problem.fem, normal)
        misfit += float(push @ np.linalg.norm(now.normal - own.normal, axis=1))
        product += float(push @ np.abs(body.gap(own.places(x))))
        inside = max(0.0, -float(body.gap(problem.disc.lattice.places(x)).min()))
        deepest, depth = max(deepest, inside), max(depth, inside / breadth(cast(Body, body.obstacle)))
    product /= total * problem.mesh.size
    return Settling(rounds, misfit / total, product, options.settled, deepest, depth)
