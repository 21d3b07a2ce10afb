"""A solved curtain in space: line loads, supports, forces, obstacles, ground, shadow, and a person for the scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from macro_fem.fem.cells import as_triangles, counterclockwise, mean_at_corners
from macro_fem.fem.space import padded
from macro_fem.output.files import corner_positions
from macro_fem.output.obstacle_meshes import ground_level, moved_obstacles, obstacle_mesh
from macro_fem.output.space_forces import LEAST_ARROW, LONGEST, pulls, pushes
from macro_fem.scene.obstacles import Cylinder, Floor, Sphere, Wall
from macro_fem.scene.support_kinds import Hooks
from macro_fem.scene.tracks import Track, track_of
from macro_fem.solution import CurtainSolution
from rve.common.drawing.scale import Scale, rounded_up
from rve.common.drawing.space import FLAT, THREE_QUARTERS, add, arrows, balls, lines, look, new_plotter, surface
from rve.common.types import Array

if TYPE_CHECKING:
    from pyvista import Plotter, PolyData

HELD, TRACK, REACTION, PUSH = "#1f4e79", "#4a4f57", "#d7263d", "#e07b00"
OBSTACLE, GROUND, SHADOW, FIGURE = "#c9b18f", "#ebedf0", "#cdd2d8", "#8d96a1"
LEAST_FOR_PERSON = 800.0
"""Scenes of this size in mm and larger are shown beside a person, smaller ones beside a bar of a round length."""
PERSON_MM = 1750.0
LIGHT = np.array([0.3, -1.0, -0.45])
"""Direction of the light that throws the shadow: from the left, above and the front."""


def line_load_scale(steps: Sequence[CurtainSolution]) -> Scale:
    """One scale for the largest principal line loads of all steps."""
    values = np.concatenate([step.principal()[0][:, 0] for step in steps])
    return Scale.of(values, "line load, N/mm of reference")


@dataclass(frozen=True, eq=False)
class PictureFrame:
    """What pictures of a series share: colours, box (2, 3) of the curtain in mm, force of the longest arrow in N, and
    y of the lowest tip of an arrow in mm."""

    scale: Scale
    room: Array
    force: float
    lowest: float

    @classmethod
    def of(cls, steps: Sequence[CurtainSolution]) -> PictureFrame:
        """The frame of one solution, or of all load steps."""
        both = [forces(step) for step in steps for forces in (pulls, pushes)]
        at, force = (np.concatenate(parts) for parts in zip(*both, strict=True))
        largest = float(np.linalg.norm(force, axis=1).max(initial=0.0))
        points = np.concatenate([padded(corner_positions(step)) for step in steps])
        room = np.stack([points.min(axis=0), points.max(axis=0)])
        way = LONGEST * float(np.linalg.norm(room[1] - room[0])) / max(largest, 1e-300)
        return cls(line_load_scale(steps), room, largest, float((at + way * force)[:, 1].min(initial=np.inf)))

    @property
    def size(self) -> float:
        """Diagonal of the box, mm."""
        return float(np.linalg.norm(self.room[1] - self.room[0]))


def draw_curtain(
    solution: CurtainSolution, plotter: Plotter | None = None, frame: PictureFrame | None = None,
    direction: tuple[float, float, float] = THREE_QUARTERS,
) -> Plotter:  # fmt: skip
    """Draw the curtain with all around it into the active panel of a plotter, by default a new one; the plotter.

    frame: that of a series, by default its own; direction: that the camera looks along.
    """
    plotter = new_plotter() if plotter is None else plotter
    frame = PictureFrame.of([solution]) if frame is None else frame
    ground, curtain = ground_level(solution, frame.room, frame.lowest), sheet(solution, frame.scale)
    add(plotter, "curtain", curtain, frame.scale)
    _add_supports(plotter, solution, frame.size)
    for item, shift in moved_obstacles(solution):
        mesh = obstacle_mesh(item, shift, frame.room, ground)
        if mesh is not None:
            style = {"opacity": 0.35 if isinstance(item, Wall) else 0.75}
            add(plotter, item.name, mesh, OBSTACLE, smooth_shading=isinstance(item, Sphere | Cylinder), **style)
    for name, colour, (at, force) in (("supports", REACTION, pulls(solution)), ("obstacles", PUSH, pushes(solution))):
        longest, way = np.linalg.norm(force, axis=1).max(initial=0.0), LONGEST * frame.size / max(frame.force, 1e-300)
        shown = arrows(at, way * force, LEAST_ARROW * LONGEST * frame.size)
        add(plotter, f"force of {name}, longest {longest:.3g} N", shown, colour)
    _add_surroundings(plotter, curtain, frame, ground)
    look(plotter, direction)
    return plotter


def title(solution: CurtainSolution) -> str:
    """What a picture is headed by."""
    load = float(np.linalg.norm(solution.problem.force.sum(axis=0)))
    height = f"mean height {solution.mean_height():.1f} mm, lowest point {solution.x[:, 1].min():.1f} mm"
    return f"total load {load:.4g} N, {height}"


def note(solution: CurtainSolution) -> str:
    """What a reader must know besides."""
    has_floor = any(isinstance(item, Floor) for item in solution.problem.scene.obstacle)
    return "" if has_floor else "the ground is drawn a little below the lowest point"


def sheet(solution: CurtainSolution, scale: Scale) -> PolyData:
    """The deformed curtain with the largest principal line load at its corners."""
    mesh = solution.problem.mesh.mesh
    cells, values = counterclockwise(mesh.p.T, mesh.t.T), solution.principal()[0][:, 0]
    each = np.repeat(values[:, None], cells.shape[1], axis=1)
    shown = surface(padded(corner_positions(solution)), as_triangles(cells)[0])
    shown[scale.label] = mean_at_corners(cells, each, solution.problem.disc.cell_area)
    return shown


def _add_supports(plotter: Plotter, solution: CurtainSolution, size: float) -> None:
    """Held edges and tracks as lines, held points, hooks and runners as balls."""
    problem = solution.problem
    mesh, corners, x = problem.mesh.mesh, padded(corner_positions(solution)), padded(solution.x)
    edges: list[Array] = []
    held_at: dict[str, list[Array]] = {}
    for item, held in zip(problem.scene.support, problem.supports.held, strict=True):
        if isinstance(item, Track):
            _, _, curve = track_of(item, problem.mesh, "track")
            line = curve.at(np.linspace(0.0, curve.length, 200))
            add(plotter, "track", lines(line[None]), TRACK, line_width=7)
        elif len(held.facets):
            edges.append(corners[mesh.facets[:, held.facets].T])
        if not len(held.facets):
            name = "runners" if isinstance(item, Track) else "hooks" if isinstance(item, Hooks) else "held points"
            held_at.setdefault(name, []).append(x[held.nodes])
    if edges:
        add(plotter, "held edge", lines(np.concatenate(edges)), HELD, line_width=7)
    for name, places in held_at.items():
        add(plotter, name, balls(np.concatenate(places), 0.006 * size), HELD)


def _add_surroundings(plotter: Plotter, curtain: PolyData, frame: PictureFrame, ground: float) -> None:
    """Ground, the curtain's shadow on it, and a person for the scale, or a bar before a small curtain."""
    import pyvista

    shadow = curtain.copy()
    shadow.points = curtain.points + (curtain.points[:, 1:2] - ground) * LIGHT
    shadow.points[:, 1] = ground
    box, size = frame.room, frame.size
    if float((box[1] - box[0]).max()) >= LEAST_FOR_PERSON:
        foot = np.array([box[0, 0] - 0.4 * PERSON_MM, ground, box[1, 2] + 0.05 * size])
        add(plotter, "person, 1.75 m", person(foot), FIGURE)
    else:
        length = rounded_up(0.12 * size, (1.0, 2.0, 5.0, 10.0))
        start = np.array([box[0, 0], ground + 0.006 * size, box[1, 2] + 0.05 * size])
        bar = lines(np.stack([start, start + np.array([length, 0.0, 0.0])])[None])
        add(plotter, f"bar of {length:g} mm", bar, FIGURE, line_width=9)
    add(plotter, "_shadow", shadow, SHADOW, **FLAT)
    x0, x1, _, _, z0, z1 = plotter.renderer.bounds
    middle, room = (0.5 * (x0 + x1), ground - 1e-3 * size, 0.5 * (z0 + z1)), 0.12 * size
    floor = pyvista.Plane(center=middle, direction=(0.0, 1.0, 0.0), i_size=z1 - z0 + room, j_size=x1 - x0 + room)
    add(plotter, "_ground", floor, GROUND, **FLAT)


def person(foot: Array) -> PolyData:
    """A standing person with the feet at `foot` (3,), facing the viewer: limbs from (x, y) to (x, y) with a radius."""
    import pyvista

    legs = [((s * 0.05, 0.03), (s * 0.05, 0.47), 0.036) for s in (-1, 1)]
    arms = [((s * 0.15, 0.42), (s * 0.1, 0.78), 0.024) for s in (-1, 1)]
    body = [((0.0, 0.49), (0.0, 0.74), 0.085), ((0.0, 0.8), (0.0, 0.87), 0.034), ((0.0, 0.92), (0.0, 0.945), 0.053)]
    made = []
    for start, end, radius in (*legs, *arms, *body):
        ends = PERSON_MM * np.array([[*start, 0.0], [*end, 0.0]])
        length = float(np.linalg.norm(ends[1] - ends[0]))
        made.append(
            pyvista.Capsule(
                center=foot + ends.mean(axis=0), direction=ends[1] - ends[0], radius=PERSON_MM * radius,
                cylinder_length=length,
            )
        )  # fmt: skip
    return pyvista.merge(made)
