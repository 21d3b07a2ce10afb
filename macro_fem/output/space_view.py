"""A solved curtain as a view in space: line loads, supports, reactions, obstacles, ground, shadow and a scale figure."""

from __future__ import annotations

from collections.abc import Sequence


import numpy as np

from macro_fem.fem.space import padded
from macro_fem.output.files import corner_positions
from macro_fem.scene.places import counterclockwise
from macro_fem.solution import CurtainSolution
from rve.common.cells import as_triangles, mean_at_corners
from rve.common.solids import PERSON_MM, Solid, arrow, box, cylinder, person, quads_cut, rectangle, sphere
from rve.common.types import Array
from rve.common.views import Lines, Scale, Surface, View, merged, rounded_up

HELD, REACTION, OBSTACLE, GROUND, SHADOW, FIGURE = "#1f4e79", "#c1121f", "#c9b18f", "#eef0f2", "#c3c8ce", "#8d96a1"
LEAST_FOR_PERSON = 800.0
"""Scenes of this size in mm and larger are shown beside a person, smaller ones beside a bar of a round length."""
LIGHT = np.array([0.3, -1.0, -0.45])
"""Direction of the light that throws the shadow: from the left, above and the front."""
MOST_ARROWS = 14
"""Reactions of a support along an edge are summed up into this many arrows."""
LONGEST = 0.16
"""Length of the largest reaction's arrow over the size of the scene."""


def positions(solution: CurtainSolution) -> Array:
    """Deformed corners of the mesh (n_corners, 3), mm."""
    return padded(corner_positions(solution))


def line_load_scale(steps: Sequence[CurtainSolution]) -> Scale:
    """One scale for the largest principal line loads of all steps."""
    values = np.concatenate([step.principal()[0][:, 0] for step in steps])
    return Scale.of(values, "largest principal line load, N/mm (reference length)")


def curtain_view(solution: CurtainSolution, scale: Scale | None = None, room: Array | None = None) -> View:
    """The curtain with all around it. `scale`, `room` (2, 3): fixed colours and box of a series, else its own."""
    scale = line_load_scale([solution]) if scale is None else scale
    corners = positions(solution)
    room = box_of([solution]) if room is None else room
    size = float(np.linalg.norm(room[1] - room[0]))
    ground = ground_level(solution, room)
    surface = sheet(solution, scale)
    parts: list[Surface | Lines] = [surface, *supports(solution, size), *reactions(solution, size)]
    parts += obstacles(solution, room, ground)
    parts += surroundings(corners, surface, room, ground)
    return View(title(solution), tuple(parts), scale, notes=notes(solution, room))


def box_of(steps: Sequence[CurtainSolution]) -> Array:
    """The box (2, 3) around the curtain at all steps, mm."""
    points = np.concatenate([positions(step) for step in steps])
    return np.stack([points.min(axis=0), points.max(axis=0)])


def title(solution: CurtainSolution) -> str:
    """What a picture is headed by."""
    load = float(np.linalg.norm(solution.problem.force.sum(axis=0)))
    height = f"mean height {solution.mean_height():.1f} mm, lowest point {solution.x[:, 1].min():.1f} mm"
    part = "" if solution.problem.factor == 1.0 else f"{100.0 * solution.problem.factor:.0f} % of live loads and moves, "
    return f"{part}total load {load:.4g} N, {height}"


def sheet(solution: CurtainSolution, scale: Scale) -> Surface:
    """The deformed curtain with the largest principal line load at its corners."""
    mesh = solution.problem.mesh.mesh
    cells, values = counterclockwise(mesh.p.T, mesh.t.T), solution.principal()[0][:, 0]
    each = np.repeat(values[:, None], cells.shape[1], axis=1)
    at_corners = mean_at_corners(cells, each, solution.problem.disc.cell_area)
    return Surface("curtain", positions(solution), as_triangles(cells)[0], values=at_corners)


def supports(solution: CurtainSolution, size: float) -> list[Surface | Lines]:
    """Held edges as tubes, held points and runners as balls."""
    mesh, corners, x = solution.problem.mesh.mesh, positions(solution), padded(solution.x)
    lines, balls = [], []
    for held in solution.problem.supports.held:
        lines.append(corners[mesh.facets[:, held.facets].T])
        if not len(held.facets):
            balls += [sphere(point, 0.007 * size, 16) for point in x[held.nodes]]
    edges = np.concatenate(lines)
    parts: list[Surface | Lines] = []
    if len(edges):
        parts.append(Lines("held edge", edges, 0.004 * size, HELD, width=6.0))
    if balls:
        parts.append(merged("hooks and held points", balls, HELD))
    return parts


def reactions(solution: CurtainSolution, size: float) -> list[Surface]:
    """Forces of supports on the curtain as arrows; those along an edge are summed up in groups."""
    x, forces = padded(solution.x), padded(solution.reactions)
    at, total = [], []
    taken = np.zeros(len(x), bool)
    for held in solution.problem.supports.held:
        nodes = held.nodes[~taken[held.nodes]]
        taken[nodes] = True
        for group in groups(x[nodes], MOST_ARROWS if len(held.facets) else len(nodes)):
            force = forces[nodes[group]]
            weight = np.linalg.norm(force, axis=1) + 1e-300
            at.append(weight @ x[nodes[group]] / weight.sum())
            total.append(force.sum(axis=0))
    if not at:
        return []
    length = np.linalg.norm(total, axis=1)
    largest = float(length.max())
    if not largest > 0.0:
        return []
    solids = [
        arrow(point, LONGEST * size * force / largest, 0.005 * size)
        for point, force, share in zip(at, total, length / largest, strict=True)
        if share > 0.02
    ]
    return [merged(f"reaction, longest arrow {largest:.3g} N", solids, REACTION)]


def groups(points: Array, most: int) -> list[np.ndarray]:
    """Numbers of points (n, 3) in at most `most` groups of neighbours along their longest extent.

    >>> [group.tolist() for group in groups(np.array([[3.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]]), 2)]
    [[1, 2], [0]]
    """
    if not len(points):
        return []
    axis = int(np.argmax(np.ptp(points, axis=0)))
    return [part for part in np.array_split(np.argsort(points[:, axis], kind="stable"), min(most, len(points)))]


def ground_level(solution: CurtainSolution, room: Array) -> float:
    """Height of the floor of the scene, or of a ground a little below the lowest point."""
    floors = [item.height for item in getattr(solution.problem.scene, "obstacle", ()) if type(item).__name__ == "Floor"]
    return float(max(floors)) if floors else float(room[0, 1] - 0.06 * np.linalg.norm(room[1] - room[0]))


def obstacles(solution: CurtainSolution, room: Array, ground: float) -> list[Surface]:
    """What the curtain lies on, where it is at this share of the moves."""
    return []


def surroundings(corners: Array, surface: Surface, room: Array, ground: float) -> list[Surface | Lines]:
    """Ground, the curtain's shadow on it, and what shows the scale: a person beside a large one, a bar before others."""
    size = float(np.linalg.norm(room[1] - room[0]))
    shadow = corners + (corners[:, 1:2] - ground) * LIGHT
    shadow[:, 1] = ground
    foot = np.array([room[0, 0] - 0.45 * PERSON_MM, ground, 0.5 * (room[0, 2] + room[1, 2])])
    is_large = float((room[1] - room[0]).max()) >= LEAST_FOR_PERSON
    extent = np.concatenate([room, shadow, *([foot[None]] if is_large else [])])
    low, high = extent.min(axis=0) - 0.06 * size, extent.max(axis=0) + 0.06 * size
    low[1] = high[1] = ground - 1e-3 * size
    ends = np.array([0.5 * (high[0] - low[0]), 0.0, 0.0]), np.array([0.0, 0.0, 0.5 * (high[2] - low[2])])
    scale = merged("person, 1.75 m", person(foot), FIGURE) if is_large else scale_bar(room, ground)
    return [
        Surface("ground", *rectangle(0.5 * (low + high), *ends), GROUND, is_smooth=False, in_legend=False),
        Surface("shadow", shadow, surface.triangles, SHADOW, is_smooth=False, in_legend=False),
        scale,
    ]


def scale_bar(room: Array, ground: float) -> Lines:
    """A bar of a round length on the ground in front of a small curtain."""
    size = float(np.linalg.norm(room[1] - room[0]))
    length = rounded_up(0.2 * size)
    start = np.array([room[0, 0], ground + 0.006 * size, room[1, 2] + 0.05 * size])
    line = np.stack([start, start + np.array([length, 0.0, 0.0])])
    return Lines(f"bar of {length:g} mm", line[None], 0.006 * size, FIGURE, width=8.0)


def notes(solution: CurtainSolution, room: Array) -> tuple[str, ...]:
    """What a reader must know besides."""
    has_floor = any(type(item).__name__ == "Floor" for item in getattr(solution.problem.scene, "obstacle", ()))
    return () if has_floor else ("the ground is drawn a little below the lowest point",)
