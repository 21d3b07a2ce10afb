"""rings.png: the whole curtain ring by ring, and its worst cell close by.

Run as `python -m rve.localization.picture FOLDER`.

A process of its own, because a renderer without a screen may crash; it draws from rings.vtu and localize.json.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rve.common.files import atomic_path
from rve.common.solids import quads_cut
from rve.common.types import Array
from rve.common.views import THREE_QUARTERS, Lines, Scale, Surface, View
from rve.localization.files import LINE, TUBE, circles, tubes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEAST = 3e-3
"""Contact forces below this part of the greatest one are drawn as none."""
STEPS = ("#8b9bab", "#c7b08a", "#e39a3c", "#d2491f", "#9c1127", "#3f0d1f")
"""Colours from no force to the greatest: steel, then ever hotter."""
FINE = (36, 12)
MOST_TUBES, MOST_POINTS = 1000, 300_000
"""In a page this number of rings have the thickness of the wire; more are lines with this many points together."""


def colours(count: int = 64) -> list[str]:
    """STEPS with even shades in between, for a logarithmic scale."""
    rgb = np.array([[int(step[i : i + 2], 16) for i in (1, 3, 5)] for step in STEPS], dtype=float)
    at = np.linspace(0.0, len(STEPS) - 1.0, count)
    shades = np.column_stack([np.interp(at, np.arange(len(STEPS)), channel) for channel in rgb.T])
    return [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in np.round(shades).astype(int)]


def read_rings(path: Path) -> tuple[Array, Array, dict[str, Array]]:
    """Centres and normals (n, 3) and numbers per ring from a rings.vtu of lines or of tubes."""
    import pyvista

    mesh = pyvista.read(path)
    ring = np.asarray(mesh.cell_data["ring"])
    first = np.unique(ring, return_index=True)[1]
    points = np.asarray(mesh.points, dtype=float).reshape(len(first), -1, 3)
    if len(first) < mesh.n_cells:  # tubes: more than one cell per ring
        points = points.reshape(len(first), *TUBE, 3).mean(axis=2)
    centre = points.mean(axis=1)
    quarter = points.shape[1] // 4
    normal = np.cross(points[:, 0] - centre, points[:, quarter] - centre)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return centre, normal, {name: np.asarray(values)[first] for name, values in mesh.cell_data.items()}


def plot_rings(centre: Array, normal: Array, r1: float, force: Array, ax: Axes | None = None) -> Axes:
    """Centre lines of rings at `centre` with unit `normal` (n, 3), mm, seen along z, coloured by force (n,) in N."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import ListedColormap, LogNorm
    from matplotlib.figure import Figure

    if ax is None:
        ax = Figure(figsize=(7.0, 6.0), layout="constrained").subplots()
    top = top_force(force)
    lines = circles(centre, normal, r1, LINE[0])[0][:, :, :2]
    drawn = LineCollection(
        list(np.concatenate([lines, lines[:, :1]], axis=1)),
        array=np.maximum(force, LEAST * top),
        cmap=ListedColormap(colours()),
        norm=LogNorm(LEAST * top, top),
        linewidths=0.7,
    )
    ax.add_collection(drawn)
    ax.figure.colorbar(drawn, ax=ax, shrink=0.75, label="largest contact force on the ring, N")
    ax.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", title=f"{len(force)} rings")
    ax.autoscale_view()
    return ax


def ring_view(title: str, placed: tuple[Array, Array], radii: tuple[float, float], force: Array) -> View:
    """Rings with centres and unit normals (n, 3), radii (r1, r2) in mm, coloured by contact force (n,) in N."""
    top = top_force(force)
    largest = float(force.max(initial=0.0))
    label = "largest contact force on the ring, N"
    scale = Scale(label, LEAST * top, top, largest, STEPS, over="#000000", spread="log")
    part: Surface | Lines
    if len(force) <= MOST_TUBES:
        around = (20, 6)
        points, quads = tubes(*placed, radii, around)
        values = np.repeat(force, around[0] * around[1])
        part = Surface("rings", points, quads_cut(quads.reshape(-1, 4)), values=values)
    else:
        count = int(np.clip(MOST_POINTS // len(force), 8, LINE[0]))
        line = circles(*placed, radii[0], count)[0]
        part = Lines("rings", np.concatenate([line, line[:, :1]], axis=1), radii[1], values=force, width=2.0)
    return View(title, (part,), scale, (THREE_QUARTERS,))


def top_force(force: Array) -> float:
    """The force, N, at which the scale of colours ends: all but the greatest 0.2 % of the rings are below it."""
    return max(float(np.quantile(force, 0.998)), 1e-12)


def add_rings(plotter: Any, placed: tuple[Array, Array], radii: tuple[float, float], force: Array, style: Any) -> None:
    """Adds tori coloured by contact force (n,) in N to a plotter.

    style: points along and around a ring, greatest force of the scale, arguments of the scalar bar or None.
    """
    import pyvista

    around, top, bar = style
    points, quads = tubes(*placed, radii, around)
    faces = quads.reshape(-1, 4)
    mesh = pyvista.PolyData(points.astype(np.float32), np.column_stack([np.full(len(faces), 4), faces]).ravel())
    mesh.point_data["N"] = np.repeat(np.maximum(force, LEAST * top), around[0] * around[1]).astype(np.float32)
    plotter.add_mesh(
        mesh,
        scalars="N",
        cmap=colours(),
        log_scale=True,
        clim=(LEAST * top, top),
        smooth_shading=True,
        ambient=0.25,
        diffuse=0.8,
        specular=0.5,
        specular_power=20,
        show_scalar_bar=bar is not None,
        scalar_bar_args=bar,
    )


def draw(folder: Path) -> None:
    """Writes rings.png beside rings.vtu."""
    import pyvista
    from PIL import Image

    summary = json.loads((folder / "localize.json").read_text(encoding="utf-8"))
    centre, normal, data = read_rings(folder / "rings.vtu")
    radii = (summary["r1_mm"], summary["r2_mm"])
    force = np.asarray(data["contact_force_N"], dtype=float)
    top = top_force(force)
    at = int(np.argmin(((data["reference_mm"][:, :2] - summary["worst_cell"]["reference_mm"]) ** 2).sum(axis=1)))
    plotter: Any = pyvista.Plotter(off_screen=True, shape=(1, 2), window_size=[1600, 800], border=False)
    plotter.set_background("white")
    plotter.subplot(0, 0)
    around = (24, 6) if len(centre) < 6000 else (14, 4)
    # Wire thinner than a pixel fades away: seen from afar it is drawn a pixel thick.
    thick = max(radii[1], 0.6e-3 * float(np.ptp(centre, axis=0).max()))
    bar = {
        "title": "largest contact force on the ring, N\n",
        "width": 0.6,
        "position_x": 0.2,
        "position_y": 0.02,
        "color": "black",
        "fmt": "%.2g",
        "n_labels": 4,
        "title_font_size": 18,
        "label_font_size": 16,
    }
    add_rings(plotter, (centre, normal), (radii[0], thick), force, (around, top, bar))
    half = 8.0 * radii[0]
    middle = _middle(centre, data["reference_mm"][:, :2], at, half)
    axes = axes_of_sheet(np.array(summary["worst_cell"]["normal"]))
    plotter.add_mesh(_frame(middle, half, axes), color="black", line_width=2)
    _look(plotter, centre, 0.62)
    plotter.subplot(0, 1)
    near = (np.abs(centre - middle) < 1.5 * half).all(axis=1)
    add_rings(plotter, (centre[near], normal[near]), radii, force[near], (FINE, top, None))
    _tilted(plotter, middle, half, axes)
    image = plotter.screenshot(return_img=True)
    plotter.close()
    with atomic_path(folder / "rings.png") as temporary:
        # 256 colours are plenty for rings in shades of one scale, in a third of the bytes.
        Image.fromarray(image).quantize(256).save(temporary, optimize=True)


def is_plane(centre: Array) -> bool:
    """Whether rings at `centre` (n, 3) lie in the plane z = 0, but for what their centres leave it by in a cell."""
    return bool(np.abs(centre[:, 2]).max() <= 1e-9 * np.abs(centre).max())


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def _middle(centre: Array, reference: Array, at: int, half: float) -> Array:
    """The middle of the close-up. The worst ring `at` is often in a corner: the window stays inside the curtain."""
    places = centre if is_plane(centre) else reference
    low, high = places.min(axis=0), places.max(axis=0)
    edge = np.minimum(0.85 * half, 0.5 * (high - low))
    middle = np.clip(places[at], low + edge, high - edge)
    return middle if is_plane(centre) else centre[np.argmin(((reference - middle) ** 2).sum(axis=1))]


def axes_of_sheet(normal: Array) -> Array:
    """Columns (3, 3): to the right, up and towards the viewer, for a sheet with this normal seen from its front."""
    front = normal if normal[2] >= 0.0 else -normal
    upward = np.array([0.0, 1.0, 0.0]) if abs(front[1]) < 0.9 else np.array([0.0, 0.0, -1.0])
    up = upward - (upward @ front) * front
    up /= np.linalg.norm(up)
    return np.stack([np.cross(up, front), up, front], axis=1)


def _frame(middle: Array, half: float, axes: Array) -> Any:
    import pyvista

    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]])
    return pyvista.lines_from_points(middle + half * corners @ axes.T)


def _look(plotter: Any, centre: Array, share: float) -> None:
    """Straight from the front, from three quarters in space, the whole curtain in the upper part of the panel."""
    view = np.eye(3) if is_plane(centre) else axes_of_sheet(_unit(-np.array(THREE_QUARTERS.direction)))
    seen = centre @ view
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle, size = view @ (0.5 * (low + high)), float((high - low)[:2].max()) + 30.0
    eye, focus = middle + 10.0 * size * view[:, 2], middle - 0.06 * size * view[:, 1]
    plotter.camera_position = [tuple(eye), tuple(focus), tuple(view[:, 1])]
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = share * size


def _tilted(plotter: Any, middle: Array, half: float, axes: Array) -> None:
    """From below and from the side, so that one sees how the rings lie."""
    eye = middle + half * axes @ np.array([0.6, -2.2, 4.2])
    plotter.camera_position = [tuple(eye), tuple(middle), tuple(axes[:, 1])]
    plotter.camera.view_angle = 24.0


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
