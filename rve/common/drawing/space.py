"""Pictures in space: plotters of pyvista without a screen, their parts and cameras.

Coordinates are mm and the second axis points up. The name of an actor is its text in the legend, unless `UNLISTED`.
"""

from __future__ import annotations

from ctypes import CDLL
from ctypes.util import find_library
from itertools import product
from typing import Any

import numpy as np

from rve.common.drawing.plane import OVER, Scale
from rve.common.errors import InputError, require
from rve.common.optional import Plotter, PolyData
from rve.common.records import Array

PANEL = (1400, 1240)
"""Pixels of a panel before matplotlib makes it smaller, which smooths edges."""
FRONT, THREE_QUARTERS = (0.0, -0.12, -1.0), (-0.75, -0.45, -1.0)
UNLISTED = ("_shadow", "_ground", "_ruler", "_length")
"""Parts without a line in the legend."""
BODY, BODY_OPACITY = "#c9b18f", 0.75
"""Colour of bodies that a mesh meets, and how much they hide."""
MEASURE = "#8d96a1"
"""Colour of what stands or lies beside for the scale."""
INK = "#2b2f36"
MATT: dict[str, Any] = {"ambient": 0.4, "diffuse": 0.7, "specular": 0.1, "smooth_shading": True}
FLAT: dict[str, Any] = {"lighting": False, "ambient": 0.0, "diffuse": 1.0, "specular": 0.0}


def new_plotter(panels: int = 1) -> Plotter:
    """An empty plotter with panels side by side; InputError without pyvista."""
    require("pyvista", "three-d", "a view in space")
    import pyvista

    pyvista.vtk_verbosity("off")  # else VTK says on standard error that there is no screen
    # Pixels of all panels side by side at most, which what draws without a screen can hold.
    less = min(1.0, 8400 / (panels * PANEL[0]))
    size, shape = [panels * int(less * PANEL[0]), int(less * PANEL[1])], (1, panels)
    plotter = pyvista.Plotter(off_screen=True, shape=shape, border=False, window_size=size, lighting="light kit")
    plotter.set_background("white")  # type: ignore[arg-type]
    return plotter


def check_render(purpose: str, instead: str = "ask for --no-picture") -> None:
    """InputError if pyvista is missing, or the system has no OpenGL that draws without a screen.

    VTK ends the interpreter when the library of the last kind of window that it tries is missing.
    """
    require("pyvista", "three-d", purpose, instead)
    try:
        window: Any = new_plotter().render_window
        if window.GetClassName() == "vtkOSOpenGLRenderWindow":
            CDLL(find_library("OSMesa") or "libOSMesa.so")
    except (ImportError, OSError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{purpose} needs OpenGL ({reason}): install libosmesa6, or {instead}") from error


def add(plotter: Plotter, name: str, mesh: PolyData, colour: str | Scale, **style: Any) -> None:
    """Add a mesh in one colour, or coloured by its array `colour.label`; nothing if the mesh is empty. Of meshes of one
    name the second is NAME 2, and so on. style: of pyvista, and `in_front` for what is seen through all else."""
    import pyvista

    if not mesh.n_points:
        return
    each = (name, *(f"{name} {k}" for k in range(2, len(plotter.actors) + 2)))
    name = next(one for one in each if one not in plotter.actors)
    style = MATT | {"name": name, "reset_camera": False, "render": False} | style
    style |= {"render_lines_as_tubes": True, "smooth_shading": False} if mesh.n_lines else {}
    is_in_front = style.pop("in_front", False)
    if isinstance(colour, str):
        actor = plotter.add_mesh(mesh, color=colour, **style)
        if is_in_front:
            actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
            # Shift of the depth of what is seen through all else, in the unit of VTK: half of the whole range and
            # more.
            actor.mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(0.0, -40000.0)
        return
    style |= {"above_color": OVER} if colour.is_exceeded else {}
    style |= {"scalars": colour.label, "clim": (colour.low, colour.top), "log_scale": colour.spread == "log"}
    actor = plotter.add_mesh(mesh, cmap=colour.colour_map(), show_scalar_bar=False, **style)
    pyvista.set_new_attribute(actor, "colour_scale", colour)


def surface(points: Array, corners: Any) -> PolyData:
    """Triangles (n, 3) or quadrilaterals (n, 4) of points (p, 3)."""
    import pyvista

    return pyvista.PolyData.from_regular_faces(points, corners)


def lines(points: Array) -> PolyData:
    """Lines (n, k, 3) of k points each."""
    import pyvista

    n, k = points.shape[:2]
    cells = np.column_stack([np.full(n, k), np.arange(n * k).reshape(n, k)])
    return pyvista.PolyData(points.reshape(-1, 3), lines=cells.ravel())


def balls(points: Array, radius: float, resolution: int = 16) -> PolyData:
    """Balls around points (n, 3); large ones are smooth with a resolution of 64."""
    import pyvista

    middles = pyvista.PolyData(np.array(points, float).reshape(-1, 3))
    ball = pyvista.Sphere(radius=radius, theta_resolution=resolution, phi_resolution=resolution)
    return middles.glyph(geom=ball, scale=False, orient=False) if len(points) else middles


def arrows(tails: Array, vectors: Array, least: float = 0.0) -> PolyData:
    """Arrows from `tails` along `vectors` (n, 3); those not longer than `least` are left out."""
    import pyvista

    length = np.linalg.norm(vectors, axis=1)
    drawn = length > max(least, 1e-12)
    ends = pyvista.PolyData(np.array(tails[drawn], float).reshape(-1, 3))
    if not drawn.any():
        return ends
    ends["along"], ends["length"] = vectors[drawn], length[drawn]
    shape = pyvista.Arrow(tip_length=0.25, tip_radius=0.06, shaft_radius=0.022)
    return ends.glyph(geom=shape, orient="along", scale="length")


def sheet_axes(points: Array) -> Array:
    """Unit vectors (3, 3) to the right in, up in, and to the front of the plane that lies nearest to points (n, 3)."""
    away = points - points.mean(axis=0)
    front = np.linalg.svd(away, full_matrices=False)[2][-1] if len(points) > 2 else np.array([0.0, 0.0, 1.0])
    front *= np.sign(front[np.abs(front).argmax()])
    right = np.cross([0.0, 1.0, 0.0] if abs(front[1]) < 0.9 else [0.0, 0.0, -1.0], front)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(front, right), front])


def add_length(plotter: Plotter, points: Array, size: float, axes: Array | None = None) -> None:
    """Add a ruler of a round length, in five parts, along the first of the `axes` (3, 3), by default x, and a little
    below `points` (n, 3), which it does not hide, beside what has this size in mm."""
    import pyvista

    axes = np.eye(3) if axes is None else axes
    local = points @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    start = np.array([low[0], low[1] - 0.06 * np.linalg.norm(high - low), high[2]])
    unit = 10.0 ** np.floor(np.log10(0.3 * size))
    length = max(part * unit for part in (1.0, 2.0, 5.0) if part * unit <= 0.3 * size)
    ends = start + np.linspace(0.0, length, 6)[:, None] * [1.0, 0.0, 0.0]
    pieces = np.stack([ends[:-1], ends[1:]], axis=1) @ axes
    add(plotter, f"ruler, {length:g} mm in parts of {length / 5:g} mm", lines(pieces[::2]), INK, line_width=9)
    add(plotter, "_ruler", lines(pieces[1::2]), MEASURE, line_width=9)
    text = pyvista.Text3D(f"{length:g} mm", depth=1e-3 * size, height=0.025 * size, center=(0.0, 0.0, 0.0))
    text.points = (text.points + start + [0.5 * length, 0.025 * size, 0.0]) @ axes
    add(plotter, "_length", text, INK, in_front=True, **FLAT)


def look(plotter: Plotter, direction: Any, up: Any = (0.0, 1.0, 0.0), box: Array | None = None) -> None:
    """Aim the camera of the active panel along `direction` so that the box (2, 3), by default all, fills the panel."""
    box = np.reshape(plotter.renderer.bounds, (3, 2)).T if box is None else box
    forward = np.array(direction) / np.linalg.norm(direction)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, forward), forward])
    seen = np.array(list(product(*box.T))) @ axes.T
    middle, half = 0.5 * (seen.min(axis=0) + seen.max(axis=0)), 0.5 * np.ptp(seen, axis=0)
    camera = plotter.camera
    camera.focal_point = middle @ axes
    camera.position = (middle - [0.0, 0.0, 10.0 * np.linalg.norm(half)]) @ axes
    camera.up = axes[1]
    camera.parallel_projection = True
    camera.parallel_scale = 1.04 * max(half[1], half[0] * PANEL[1] / PANEL[0], 1e-9)
    plotter.renderer.camera_set = True
    plotter.renderer.reset_camera_clipping_range()
    near, far = camera.clipping_range
    camera.clipping_range = (near - 2.0 * (far - near), far)  # room for what is in front
