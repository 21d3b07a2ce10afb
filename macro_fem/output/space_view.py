"""A solved curtain as a view in space: line loads, supports, forces, obstacles, ground, shadow and a scale figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from macro_fem.fem.space import padded
from macro_fem.output.files import corner_positions
from macro_fem.output.space_bodies import ground_level, obstacles
from macro_fem.output.space_forces import LONGEST, arrows, pulls, pushes
from macro_fem.scene.cables import track_of
from macro_fem.scene.meshing.places import counterclockwise
from macro_fem.scene.obstacles import Floor
from macro_fem.scene.tables import Hooks, Track
from macro_fem.solution import CurtainSolution
from rve.common.cells import as_triangles, mean_at_corners
from rve.common.drawing.solids import PERSON_MM, Solid, person, rectangle, sphere
from rve.common.drawing.views import Lines, Scale, Surface, View, merged, rounded_up
from rve.common.types import Array

HELD, TRACK, REACTION, PUSH = "#1f4e79", "#4a4f57", "#d7263d", "#e07b00"
GROUND, SHADOW, FIGURE = "#ebedf0", "#cdd2d8", "#8d96a1"
LEAST_FOR_PERSON = 800.0
"""Scenes of this size in mm and larger are shown beside a person, smaller ones beside a bar of a round length."""
LIGHT = np.array([0.3, -1.0, -0.45])
"""Direction of the light that throws the shadow: from the left, above and the front."""


def positions(solution: CurtainSolution) -> Array:
    """Deformed corners of the mesh (n_corners, 3), mm."""
    return padded(corner_positions(solution))


def line_load_scale(steps: Sequence[CurtainSolution]) -> Scale:
    """One scale for the largest principal line loads of all steps."""
    values = np.concatenate([step.principal()[0][:, 0] for step in steps])
    return Scale.of(values, "line load, N/mm of reference, square-root scale")


@dataclass(frozen=True, eq=False)
class Frame:
    """What pictures of a series share: colours, box (2, 3) of the curtain in mm, force of the longest arrow in N, and
    y of the lowest tip of an arrow in mm."""

    scale: Scale
    room: Array
    force: float
    lowest: float

    @classmethod
    def of(cls, steps: Sequence[CurtainSolution]) -> Frame:
        """The frame of one solution, or of all load steps."""
        both = [forces(step) for step in steps for forces in (pulls, pushes)]
        at, force = (np.concatenate(parts) for parts in zip(*both, strict=True))
        largest = float(np.linalg.norm(force, axis=1).max(initial=0.0))
        room = box_of(steps)
        way = LONGEST * float(np.linalg.norm(room[1] - room[0])) / max(largest, 1e-300)
        return cls(line_load_scale(steps), room, largest, float((at + way * force)[:, 1].min(initial=np.inf)))


def curtain_view(solution: CurtainSolution, frame: Frame | None = None) -> View:
    """The curtain with all around it; `frame`: that of a series, else its own."""
    frame = Frame.of([solution]) if frame is None else frame
    room, size = frame.room, float(np.linalg.norm(frame.room[1] - frame.room[0]))
    ground = ground_level(solution, room, frame.lowest)
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
