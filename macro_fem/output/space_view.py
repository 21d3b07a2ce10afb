"""A solved curtain in space: line loads, supports, forces, obstacles, ground, shadow, and a person for the scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from macro_fem.curtain import CurtainSolution, CurtainState
from macro_fem.fem.cells import counterclockwise, mean_at_corners
from macro_fem.output.arrows import FORCES
from macro_fem.output.images import Draw
from macro_fem.scene.obstacles import Box, Cylinder, Floor, PlacedObstacle, Sphere, Wall, unit
from macro_fem.scene.support_kinds import Hanging
from macro_fem.scene.tables import in_3d
from rve.common import Array, digits
from rve.common.drawing import space
from rve.common.drawing.plane import Scale
from rve.common.optional import Plotter, PolyData
from rve.geometry import padded

HELD, TRACK = "#1f4e79", "#4a4f57"
GROUND, SHADOW = "#ebedf0", "#cdd2d8"
PERSON_MM = 1750.0
LIGHT = np.array([0.12, -1.0, -0.25])
"""Direction of the light that throws the shadow: from the left, above and the front."""
LONGEST, LEAST_ARROW, ROUNDED = 0.16, 0.04, 1e-6
"""Length of the arrow of the largest force of its kind over the size of the scene; forces below this part of it have no
arrow; a kind whose largest one is below this part of that of all kinds is rounding, and has none."""
SHRUNK, REACH = 0.003, 0.25
"""Obstacles are drawn smaller by this part of the size of the curtain, to see it on them, and cut off this far away."""


def line_load_scale(steps: Sequence[CurtainState]) -> Scale:
    """One scale for the largest principal line loads of all steps."""
    values = np.concatenate([step.principal()[0][:, 0] for step in steps])
    return Scale.of(values, "line load, N/mm of reference")


def box_of(points: Array) -> Array:
    """The least and the largest coordinates (2, 3) of points (n, 3)."""
    return np.stack([points.min(axis=0), points.max(axis=0)])


@dataclass(frozen=True, eq=False)
class PictureFrame:
    """What pictures of a series share: colours; boxes (2, 3) of the curtain, and with arrows and obstacles, mm; size of
    the former, mm; of each of `FORCES` the length of arrows, mm/N, and the largest one, N; y of the ground where no
    floor is, mm."""

    scale: Scale
    room: Array
    around: Array
    size: float
    arrow: tuple[float, ...]
    largest: tuple[float, ...]
    lowest: float

    @classmethod
    def of(cls, steps: Sequence[CurtainState]) -> PictureFrame:
        """The frame of one solution, or of all load steps."""
        each = [[forces(step) for step in steps] for _, _, forces, _ in FORCES]  # places and forces (n, 3)
        sizes = ([np.linalg.norm(force, axis=1).max(initial=0.0) for _, force in kind] for kind in each)
        most = [float(max(kind)) for kind in sizes]
        largest = tuple(one if one > ROUNDED * max(most) else 0.0 for one in most)
        room = box_of(np.concatenate([padded(step.corners) for step in steps]))
        size = float(np.linalg.norm(room[1] - room[0]))
        arrow = tuple(LONGEST * size / one if one else 0.0 for one in largest)
        ends = [
            at + way * length * force
            for (*_, way), length, kind in zip(FORCES, arrow, each, strict=True)
            for at, force in kind
        ]
        around = box_of(np.concatenate([room, *ends]))
        lowest = float(around[0, 1] - 0.06 * size)  # the ruler and its words are below arrows
        frame = cls(line_load_scale(steps), room, around, size, arrow, largest, lowest)
        bodies = [obstacle_mesh(one, frame, lowest) for step in steps for one in step.obstacles]
        bounds = [np.reshape(one.bounds, (3, 2)).T for one in bodies if one is not None]
        return replace(frame, around=box_of(np.concatenate([around, *bounds])))


def draw_curtain(
    solution: CurtainState, plotter: Plotter | None = None, frame: PictureFrame | None = None,
    direction: tuple[float, float, float] = space.THREE_QUARTERS,
) -> Plotter:  # fmt: skip
    """Draw the curtain with all around it into the active panel of a plotter, by default a new one; the plotter.

    frame: that of a series, by default its own; direction: that the camera looks along.
    """
    plotter = space.new_plotter() if plotter is None else plotter
    frame = PictureFrame.of([solution]) if frame is None else frame
    placed, curtain = solution.obstacles, sheet(solution, frame.scale)
    floors = [one.obstacle.height + one.shift[1] for one in placed if isinstance(one.obstacle, Floor)]
    ground = float(max(floors, default=frame.lowest))
    # Cells that meet at more degrees are drawn with the fold between them, others as one smooth surface.
    space.add(plotter, "curtain", curtain, frame.scale, split_sharp_edges=True, feature_angle=35.0)
    add_supports(plotter, solution, frame.size)
    for one in placed:
        mesh, item = obstacle_mesh(one, frame, ground), one.obstacle
        if mesh is not None:
            opacity = 0.35 if isinstance(item, Wall) else space.BODY_OPACITY
            is_round = isinstance(item, Sphere | Cylinder)
            space.add(plotter, item.name, mesh, space.BODY, opacity=opacity, smooth_shading=is_round)
    for (name, colour, forces, way), largest, length in zip(FORCES, frame.largest, frame.arrow, strict=True):
        at, force = forces(solution)
        begin = at - (way < 0) * length * force
        shown = space.arrows(begin, length * force, LEAST_ARROW * LONGEST * frame.size)
        space.add(plotter, f"{name}, longest {digits(largest)} N", shown, colour, in_front=True)
    down = np.abs(solution.problem.scene.load.acceleration)
    if down[1] == down.max():  # a sheet whose weight acts along z lies level: nobody stands beside it
        _add_surroundings(plotter, curtain, frame, ground, is_right_end=direction[0] > 0.0)
    space.look(plotter, direction, box=box_of(np.vstack([frame.around, np.reshape(plotter.renderer.bounds, (3, 2)).T])))
    return plotter


def views(steps: Sequence[CurtainState]) -> list[Draw]:
    """How to draw solutions on one scale and with one camera."""
    frame = PictureFrame.of(steps)
    return [partial(draw_curtain, one, frame=frame) for one in steps]


def title(solution: CurtainSolution) -> str:
    """What a picture is headed by."""
    load = float(np.linalg.norm(solution.problem.force.sum(axis=0)))
    if (sag := solution.sag()) is not None:
        return f"total load {digits(load, 4)} N, mean sag {sag[0]:.1f} mm, largest {sag[1]:.1f} mm"
    height = f"mean height {solution.mean_height():.1f} mm, lowest point {solution.x[:, 1].min():.1f} mm"
    out = np.abs(solution.x[:, 2:]).max(initial=0.0)
    return f"total load {digits(load, 4)} N, {height}" + (f", |z| up to {out:.1f} mm" if out > 0.05 else "")


def sheet(solution: CurtainState, scale: Scale) -> PolyData:
    """The deformed curtain with the largest principal line load at its corners."""
    mesh = solution.problem.mesh.mesh
    cells, values = counterclockwise(mesh.p.T, mesh.t.T), solution.principal()[0][:, 0]
    shown = space.surface(padded(solution.corners), cells)
    shown[scale.label] = mean_at_corners(cells, values, solution.problem.disc.cell_area)
    return shown


def obstacle_mesh(placed: PlacedObstacle, frame: PictureFrame, ground: float) -> PolyData | None:
    """The part of an obstacle that is near the curtain and above the ground; None for a floor, which is the ground."""
    import pyvista

    room, less, middle, shift = frame.room, SHRUNK * frame.size, frame.room.mean(axis=0), placed.shift
    match item := placed.obstacle:
        case Sphere():
            return space.balls(item.centre + shift, max(item.radius - less, 0.9 * item.radius), 64)
        case Cylinder():
            axis, point = unit(item.axis), np.array(in_3d(item.point)) + shift
            height = 1.08 * float((room[1] - room[0]) @ np.abs(axis))
            radius, centre = max(item.radius - less, 0.9 * item.radius), point + ((middle - point) @ axis) * axis
            return pyvista.Cylinder(center=centre, direction=axis, radius=radius, height=height, resolution=72)
        case Wall():
            normal = unit(item.facing)
            centre = middle - ((middle - np.array(in_3d(item.point)) - shift) @ normal + less) * normal
            return pyvista.Plane(center=centre, direction=normal, i_size=frame.size, j_size=frame.size)
        case Box():  # a ball whose eight parts are moved to the corners, cut off far from the curtain
            low, high = item.corner + shift + less, item.corner + shift + np.array(item.size) - less
            radius = min(item.rounding or 0.0, 0.499 * float((high - low).min()))
            mesh = space.balls(np.zeros(3), 1.0, 64)
            way = np.sign(np.round(mesh.points, 6)) * (0.5 * (high - low) - radius) + radius * mesh.points
            least, most = room[0] - REACH * frame.size, room[1] + REACH * frame.size
            least[1] = max(least[1], ground)
            apart = (high < least) | (low > most)
            ends = np.where(apart, -np.inf, least), np.where(apart, np.inf, most)
            mesh.points = np.clip(0.5 * (low + high) + way, *ends)
            return mesh
    return None


def add_supports(plotter: Plotter, solution: CurtainState, size: float) -> None:
    """Held edges and tracks as lines, held points, hooks and runners as balls."""
    problem = solution.problem
    mesh, corners, x = problem.mesh.mesh, padded(solution.corners), padded(solution.x)
    edges, held_at = [np.zeros((0, 2, 3))], dict[str, list[Array]]()
    for held in problem.supports.held:
        item = problem.scene.support[held.number]
        if held.track is not None:
            space.add(plotter, held.name, space.lines(held.track[None]), TRACK, line_width=7)
        elif len(held.facets):
            edges.append(corners[mesh.facets[:, held.facets].T])
        if not len(held.facets):
            held_at.setdefault(f"{item.one}s" if isinstance(item, Hanging) else "held points", []).append(x[held.nodes])
    space.add(plotter, "held edge", space.lines(np.concatenate(edges)), HELD, line_width=7)
    for name, places in held_at.items():
        space.add(plotter, name, space.balls(np.concatenate(places), 0.006 * size), HELD)


def _add_surroundings(
    plotter: Plotter, curtain: PolyData, frame: PictureFrame, ground: float, *, is_right_end: bool
) -> None:
    """Ground, the curtain's shadow on it, and for the scale a ruler before it and a person beside a large one, at its
    right end if it is seen from the left."""
    import pyvista

    shadow = curtain.copy()
    shadow.points = curtain.points + (curtain.points[:, 1:2] - ground) * LIGHT
    shadow.points[:, 1] = ground
    box, size = frame.room, frame.size
    foot = np.array([box[0, 0], ground, box[1, 2] + 0.05 * size])
    # Scenes of this size in mm and larger are shown beside a person, smaller ones beside a ruler alone.
    is_large = float((box[1] - box[0]).max()) >= 2000.0
    feet = foot.copy()
    if is_large:
        feet[0] = box[1, 0] + 0.3 * PERSON_MM if is_right_end else box[0, 0] - 0.3 * PERSON_MM
        up = PERSON_MM * np.array([0.0, 1.0, 0.0])
        radius, length = 0.08 * PERSON_MM, 0.68 * PERSON_MM
        body = pyvista.Capsule(center=feet + 0.42 * up, direction=up, radius=radius, cylinder_length=length)
        head = pyvista.Sphere(radius=0.065 * PERSON_MM, center=feet + 0.93 * up)
        space.add(plotter, "person, 1.75 m", body + head, space.MEASURE)
    space.add_length(plotter, foot[None] + [0.0, 0.006 * size, 0.0], size)
    space.add(plotter, "_shadow", shadow, SHADOW, **space.FLAT)
    thrown = box + max(box[1, 1] - ground, 0.0) * LIGHT  # the patch is as large in all pictures of a series
    beside = feet + np.outer([-1.0, 1.0] if is_large else [0.0], [0.1 * PERSON_MM, 0.0, 0.0])
    (x0, _, z0), (x1, _, z1) = box_of(np.concatenate([frame.around, thrown, beside]))
    middle, room = (0.5 * (x0 + x1), ground - 1e-3 * size, 0.5 * (z0 + z1)), 0.05 * size
    floor = pyvista.Plane(center=middle, direction=(0.0, 1.0, 0.0), i_size=z1 - z0 + room, j_size=x1 - x0 + room)
    space.add(plotter, "_ground", floor, GROUND, **space.FLAT)
