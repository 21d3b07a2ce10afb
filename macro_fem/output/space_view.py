"""A solved curtain as a view in space: line loads, supports, reactions, obstacles, ground, shadow and a scale figure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any


import numpy as np

from macro_fem.fem.space import padded
from macro_fem.output.files import corner_positions
from macro_fem.scene.places import counterclockwise
from macro_fem.scene.cables import track_of
from macro_fem.scene.obstacles import Box, Cylinder, Floor, Obstacle, Sphere, Wall
from macro_fem.scene.tables import Hooks, Track, in_3d
from macro_fem.solution import CurtainSolution
from rve.common.cells import as_triangles, mean_at_corners
from rve.common.solids import PERSON_MM, Solid, arrow, box, cylinder, person, rectangle, sphere
from rve.common.types import Array
from rve.common.views import Lines, Scale, Surface, View, merged, rounded_up

HELD, TRACK, REACTION, PUSH, OBSTACLE, GROUND, SHADOW, FIGURE = "#1f4e79", "#4a4f57", "#d7263d", "#e07b00", "#c9b18f", "#ebedf0", "#cdd2d8", "#8d96a1"
LEAST_FOR_PERSON = 800.0
"""Scenes of this size in mm and larger are shown beside a person, smaller ones beside a bar of a round length."""
LIGHT = np.array([0.3, -1.0, -0.45])
"""Direction of the light that throws the shadow: from the left, above and the front."""
MOST_ARROWS = 14
"""Forces of a support along an edge, and of all obstacles, are summed up into this many arrows."""
SHRUNK = 0.003
"""Obstacles are drawn smaller by this part of the size of the curtain."""
LEAST_ARROW = 0.04
"""Forces below this part of the largest one have no arrow."""
LONGEST = 0.16
"""Length of the largest reaction's arrow over the size of the scene."""


def positions(solution: CurtainSolution) -> Array:
    """Deformed corners of the mesh (n_corners, 3), mm."""
    return padded(corner_positions(solution))


def line_load_scale(steps: Sequence[CurtainSolution]) -> Scale:
    """One scale for the largest principal line loads of all steps."""
    values = np.concatenate([step.principal()[0][:, 0] for step in steps])
    return Scale.of(values, "largest principal line load, N/mm (reference length)")


@dataclass(frozen=True, eq=False)
class Frame:
    """What the pictures of a series share: colours, box (2, 3) of the curtain in mm, force of the longest arrow in N."""

    scale: Scale
    room: Array
    force: float

    @classmethod
    def of(cls, steps: Sequence[CurtainSolution]) -> Frame:
        """The frame of one solution, or of all load steps."""
        forces = [force for step in steps for _, force in (pulls(step), pushes(step))]
        largest = float(np.linalg.norm(np.concatenate(forces), axis=1).max(initial=0.0))
        return cls(line_load_scale(steps), box_of(steps), largest)


def curtain_view(solution: CurtainSolution, frame: Frame | None = None) -> View:
    """The curtain with all around it; `frame`: that of a series, else its own."""
    frame = Frame.of([solution]) if frame is None else frame
    room, size = frame.room, float(np.linalg.norm(frame.room[1] - frame.room[0]))
    ground = ground_level(solution, room)
    surface = sheet(solution, frame.scale)
    bodies = obstacles(solution, room, ground)
    parts: list[Surface | Lines] = [surface, *supports(solution, size), *bodies]
    parts += arrows("force of supports", REACTION, pulls(solution), size, frame.force)
    parts += arrows("force of obstacles", PUSH, pushes(solution), size, frame.force)
    parts += surroundings([surface, *bodies], room, ground)
    return View(title(solution), tuple(parts), frame.scale, notes=notes(solution))


def box_of(steps: Sequence[CurtainSolution]) -> Array:
    """The box (2, 3) around the curtain at all steps, mm."""
    points = np.concatenate([positions(step) for step in steps])
    return np.stack([points.min(axis=0), points.max(axis=0)])


def title(solution: CurtainSolution) -> str:
    """What a picture is headed by."""
    load = float(np.linalg.norm(solution.problem.force.sum(axis=0)))
    height = f"mean height {solution.mean_height():.1f} mm, lowest point {solution.x[:, 1].min():.1f} mm"
    return f"total load {load:.4g} N, {height}"


def sheet(solution: CurtainSolution, scale: Scale) -> Surface:
    """The deformed curtain with the largest principal line load at its corners."""
    mesh = solution.problem.mesh.mesh
    cells, values = counterclockwise(mesh.p.T, mesh.t.T), solution.principal()[0][:, 0]
    each = np.repeat(values[:, None], cells.shape[1], axis=1)
    at_corners = mean_at_corners(cells, each, solution.problem.disc.cell_area)
    return Surface("curtain", positions(solution), as_triangles(cells)[0], values=at_corners)


def supports(solution: CurtainSolution, size: float) -> list[Surface | Lines]:
    """Held edges and tracks as tubes, held points, hooks and runners as balls."""
    problem = solution.problem
    mesh, corners, x = problem.mesh.mesh, positions(solution), padded(solution.x)
    edges, parts = [], []
    balls: dict[str, list[Solid]] = {}
    for item, held in zip(problem.scene.support, problem.supports.held, strict=True):
        if isinstance(item, Track):
            _, _, curve = track_of(item, problem.mesh, "track")
            line = curve.at(np.linspace(0.0, curve.length, 200))
            parts.append(Lines("track", line[None], 0.004 * size, TRACK, width=6.0))
        elif len(held.facets):
            edges.append(corners[mesh.facets[:, held.facets].T])
        if not len(held.facets):
            name = "runners" if isinstance(item, Track) else "hooks" if isinstance(item, Hooks) else "held points"
            balls.setdefault(name, []).extend(sphere(point, 0.006 * size, 16) for point in x[held.nodes])
    if edges:
        parts.append(Lines("held edge", np.concatenate(edges), 0.004 * size, HELD, width=6.0))
    return [*parts, *(merged(name, solids, HELD) for name, solids in balls.items())]


def arrows(name: str, colour: str, forces: tuple[Array, Array], size: float, largest: float) -> list[Surface]:
    """Forces at places (k, 3), (k, 3) in N as arrows of one name; `largest` N has the longest one."""
    at, force = forces
    share = np.linalg.norm(force, axis=1) / max(largest, 1e-300)
    drawn = np.flatnonzero(share > LEAST_ARROW)
    if not len(drawn):
        return []
    solids = [arrow(at[i], LONGEST * size * force[i] / largest, 0.005 * size) for i in drawn]
    return [merged(f"{name}, longest {largest * share.max():.3g} N", solids, colour)]


def pushes(solution: CurtainSolution) -> tuple[Array, Array]:
    """Places (k, 3) and forces (k, 3) of obstacles on the curtain, summed up over patches of it."""
    walls = solution.problem.walls
    if walls is None or not len(solution.wall_forces):
        return np.zeros((0, 3)), np.zeros((0, 3))
    x = padded(solution.x)
    nodal = padded(walls.nodal(solution.wall_forces, len(x)))
    size = np.linalg.norm(nodal, axis=1)
    nodes = np.flatnonzero(size > 1e-6 * size.max(initial=0.0))
    found = [part for part in patches(x[nodes], MOST_ARROWS) if len(part)]
    if not found:
        return np.zeros((0, 3)), np.zeros((0, 3))
    groups = [nodes[part] for part in found]
    at = [np.average(x[group], axis=0, weights=size[group]) for group in groups]
    return np.stack(at), np.stack([nodal[group].sum(axis=0) for group in groups])


def patches(points: Array, most: int) -> list[np.ndarray]:
    """Numbers of points (n, 3) in at most `most` patches: the widest one is halved until there are so many.

    >>> [part.tolist() for part in patches(np.array([[3.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]]), 2)]
    [[1], [2, 0]]
    """
    parts = [np.arange(len(points))]
    while len(parts) < min(most, len(points)):
        widths = [float(np.ptp(points[part], axis=0).max(initial=0.0)) if len(part) else 0.0 for part in parts]
        part = parts.pop(int(np.argmax(widths)))
        axis = int(np.argmax(np.ptp(points[part], axis=0)))
        order = part[np.argsort(points[part, axis], kind="stable")]
        parts += [order[: len(order) // 2], order[len(order) // 2 :]]
    return parts


def pulls(solution: CurtainSolution) -> tuple[Array, Array]:
    """Places (k, 3) and forces (k, 3) of supports: those at points, and those of edges summed up by equal lengths."""
    x, forces = padded(solution.x), padded(solution.reactions)
    taken = np.zeros(len(x), bool)
    places, sums = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for held in solution.problem.supports.held:
        nodes = held.nodes[~taken[held.nodes]]
        taken[nodes] = True
        order = along_edge(solution.problem.disc.nodes[nodes])
        is_edge = len(held.facets) and len(nodes) > MOST_ARROWS
        at, force = x[nodes[order]], forces[nodes[order]]
        at, force = summed_up(at, force, MOST_ARROWS) if is_edge else (at, force)
        places.append(at)
        sums.append(force)
    return np.concatenate(places), np.concatenate(sums)


def along_edge(points: Array) -> Array:
    """Order (n,) of points (n, 2) along the edge they lie on: by angle around a rim, else along its longer extent.

    >>> along_edge(np.array([[3.0, 0.0], [1.0, 0.0], [2.0, 0.1]])).tolist()
    [1, 2, 0]
    """
    if not len(points):
        return np.zeros(0, int)
    away = points - points.mean(axis=0)
    angle = np.sort(np.arctan2(away[:, 1], away[:, 0]))
    is_rim = len(points) > 3 and float(np.diff(angle, append=angle[0] + 2.0 * np.pi).max()) < 0.5 * np.pi
    axis = int(np.argmax(np.ptp(points, axis=0)))
    return np.argsort(np.arctan2(away[:, 1], away[:, 0]) if is_rim else points[:, axis], kind="stable")


def summed_up(at: Array, force: Array, count: int) -> tuple[Array, Array]:
    """Places and forces (count, 3) of `count` equal lengths of a line with nodal forces `force` (n, 3) at `at` (n, 3).

    A nodal force is spread evenly over the length half-way to its neighbours, so that an even line load has equal sums.

    >>> at = np.linspace([0.0, 0.0, 0.0], [8.0, 0.0, 0.0], 9)
    >>> even = np.array([[0.0, 0.5, 0.0], *[[0.0, 1.0, 0.0]] * 7, [0.0, 0.5, 0.0]])
    >>> summed_up(at, even, 3)[1][:, 1].round(9).tolist()
    [2.666666667, 2.666666667, 2.666666667]
    """
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(at, axis=0), axis=1)))
    ends = np.concatenate([s[:1], 0.5 * (s[1:] + s[:-1]), s[-1:]])
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(force, axis=0)])
    edges = np.linspace(0.0, s[-1], count + 1)
    sums = np.diff(np.stack([np.interp(edges, ends, column) for column in total.T], axis=1), axis=0)
    middle = 0.5 * (edges[1:] + edges[:-1])
    return np.stack([np.interp(middle, s, column) for column in at.T], axis=1), sums


def ground_level(solution: CurtainSolution, room: Array) -> float:
    """Height of the floor of the scene, or of a ground a little below the lowest point."""
    floors = [item.height + shift[1] for item, shift in _obstacles(solution) if isinstance(item, Floor)]
    return float(max(floors)) if floors else float(room[0, 1] - 0.06 * np.linalg.norm(room[1] - room[0]))


def _obstacles(solution: CurtainSolution) -> list[tuple[Obstacle, Array]]:
    """The obstacles of the scene and how far each is moved (3,) at this load step, mm."""
    problem = solution.problem
    return [(item, problem.factor * np.array(in_3d(item.move))) for item in problem.scene.obstacle]


def obstacles(solution: CurtainSolution, room: Array, ground: float) -> list[Surface]:
    """What the curtain lies on, where it is at this load step, `SHRUNK` a little so that the curtain is seen on it.

    A kind that has no drawing of its own is shown by plates at the nodes that are pushed. A floor is the ground.
    """
    beside = Beside(room, ground, SHRUNK * float(np.linalg.norm(room[1] - room[0])))
    found = []
    for item, shift in _obstacles(solution):
        draw = DRAWN.get(type(item))
        solids = plates(solution, room) if draw is None else [draw(item, shift, beside)]
        if solids and not isinstance(item, Floor):
            opacity = 0.35 if isinstance(item, Wall) else 0.75
            is_smooth = isinstance(item, Sphere | Cylinder)
            found.append(merged(item.name, solids, OBSTACLE, is_smooth=is_smooth, opacity=opacity))
    return found


@dataclass(frozen=True, eq=False)
class Beside:
    """What an obstacle is drawn beside: the box (2, 3) of the curtain, the ground, and by how much it is made smaller."""

    room: Array
    ground: float
    less: float

    @property
    def size(self) -> float:
        """Diagonal of the box, mm."""
        return float(np.linalg.norm(self.room[1] - self.room[0]))


def _sphere(item: Sphere, shift: Array, beside: Beside) -> Solid:
    return sphere(np.array(item.centre) + shift, item.radius - min(beside.less, 0.1 * item.radius), 64)


def _cylinder(item: Cylinder, shift: Array, beside: Beside) -> Solid:
    """The part of the endless cylinder beside the curtain."""
    axis = np.array(in_3d(item.axis)) / np.linalg.norm(item.axis)
    point, room = np.array(in_3d(item.point)) + shift, beside.room
    corners = np.array([[room[i, 0], room[j, 1], room[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    along = (corners - point) @ axis
    start, end = along.min() - 0.04 * beside.size, along.max() + 0.04 * beside.size
    return cylinder(point + start * axis, point + end * axis, item.radius - min(beside.less, 0.1 * item.radius), 72)


def _box(item: Box, shift: Array, beside: Beside) -> Solid:
    """The part of the box above the ground and not far from the curtain."""
    reach = 0.25 * beside.size
    corner = np.array(item.corner) + shift
    low = np.maximum(corner + beside.less, [-np.inf, beside.ground, -np.inf])
    return box(
        np.maximum(low, beside.room[0] - reach),
        np.minimum(corner + np.array(item.size) - beside.less, beside.room[1] + reach),
    )


def _wall(item: Wall, shift: Array, beside: Beside) -> Solid:
    """The part of the endless wall beside the curtain."""
    normal = np.array(in_3d(item.facing)) / np.linalg.norm(item.facing)
    point, middle = np.array(in_3d(item.point)) + shift, 0.5 * (beside.room[0] + beside.room[1])
    centre = middle - ((middle - point) @ normal + beside.less) * normal
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    return rectangle(centre, 0.5 * beside.size * first, 0.5 * beside.size * np.cross(normal, first))


DRAWN: dict[type, Callable[[Any, Array, Beside], Solid]] = {
    Sphere: _sphere,
    Cylinder: _cylinder,
    Box: _box,
    Wall: _wall,
}
"""How obstacles of each kind are drawn."""


def plates(solution: CurtainSolution, room: Array) -> list[Solid]:
    """Small plates under the nodes that half-spaces push, along their planes."""
    walls, x = solution.problem.walls, padded(solution.x)
    if walls is None or not len(solution.wall_forces):
        return []
    size, force = float(np.linalg.norm(room[1] - room[0])), solution.wall_forces
    pushed = np.flatnonzero(force > 1e-3 * force.max(initial=0.0))
    normals = padded(walls.normal[pushed])
    ends = zip(x[walls.node[pushed]], normals, strict=True)
    return [cylinder(at - 0.004 * size * n, at, 0.01 * size, 12) for at, n in ends]


def surroundings(surfaces: Sequence[Surface], room: Array, ground: float) -> list[Surface | Lines]:
    """Ground, the curtain's shadow on it, and what shows the scale: a person beside a large one, a bar before others.

    surfaces: the curtain and the obstacles.
    """
    size = float(np.linalg.norm(room[1] - room[0]))
    sheet = surfaces[0]
    shadow = sheet.points + (sheet.points[:, 1:2] - ground) * LIGHT
    shadow[:, 1] = ground
    foot = np.array([room[0, 0] - 0.4 * PERSON_MM, ground, room[1, 2] + 0.05 * size])
    is_large = float((room[1] - room[0]).max()) >= LEAST_FOR_PERSON
    extent = np.concatenate([shadow, *(surface.points for surface in surfaces), *([foot[None]] if is_large else [])])
    low, high = extent.min(axis=0) - 0.06 * size, extent.max(axis=0) + 0.06 * size
    low[1] = high[1] = ground - 1e-3 * size
    ends = np.array([0.5 * (high[0] - low[0]), 0.0, 0.0]), np.array([0.0, 0.0, 0.5 * (high[2] - low[2])])
    scale = merged("person, 1.75 m", person(foot), FIGURE) if is_large else scale_bar(room, ground)
    return [
        Surface("ground", *rectangle(0.5 * (low + high), *ends), GROUND, is_lit=False, in_legend=False),
        Surface("shadow", shadow, sheet.triangles, SHADOW, is_lit=False, in_legend=False),
        scale,
    ]


def scale_bar(room: Array, ground: float) -> Lines:
    """A bar of a round length on the ground in front of a small curtain."""
    size = float(np.linalg.norm(room[1] - room[0]))
    length = rounded_up(0.12 * size, (1.0, 2.0, 5.0, 10.0))
    start = np.array([room[0, 0], ground + 0.006 * size, room[1, 2] + 0.05 * size])
    line = np.stack([start, start + np.array([length, 0.0, 0.0])])
    return Lines(f"bar of {length:g} mm", line[None], 0.006 * size, FIGURE, width=8.0)


def notes(solution: CurtainSolution) -> tuple[str, ...]:
    """What a reader must know besides."""
    has_floor = any(isinstance(item, Floor) for item in solution.problem.scene.obstacle)
    return () if has_floor else ("the ground is drawn a little below the lowest point",)
