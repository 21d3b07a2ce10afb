"""Views as pictures (PNG) and animations (GIF) by pyvista and matplotlib, without a display.

`render` does it in a process of its own, `python -m rve.common.drawing.render OUT`, because a renderer without a
screen may crash. That process reads the views, `packed`, from its standard input.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rve.common.drawing.views import Camera, Lines, Scale, Surface, View, packed, unpacked
from rve.common.errors import NotConverged, require
from rve.common.progress import tell
from rve.common.storage.files import atomic_path
from rve.common.types import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PANEL_INCHES, PANEL_DPI = (7.0, 6.2), 130
"""Size of the picture of one camera."""
FINER = 2
"""Each pixel is the mean of this number squared: edges are smooth without a graphics card."""
FRAME_MS, LAST_MS = 120, 1500
"""How long a frame of an animation is shown, and its last one."""
MARGIN = 1.04


def check_render(purpose: str, instead: str = "ask for --no-picture") -> None:
    """InputError if pyvista or matplotlib is missing."""
    require("pyvista", "three-d", purpose, instead)
    require("matplotlib", "three-d", purpose, instead)


def render(path: str | os.PathLike[str], views: Sequence[View]) -> None:
    """Write the first view as PNG, or all of them as the frames of a GIF if the name of `path` ends in .gif.

    Atomic. InputError if pyvista is missing, NotConverged with the renderer's last words if it fails.
    """
    check_render(str(path))
    tell(f"drawing {Path(path).name}")
    here = str(Path(__file__).resolve().parents[3])
    paths = os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
    with atomic_path(path) as temporary:
        command = [sys.executable, "-m", "rve.common.drawing.render", str(temporary)]
        run = subprocess.run(command, input=packed(views), capture_output=True, env=os.environ | {"PYTHONPATH": paths})
        if run.returncode:
            last = (run.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
            raise NotConverged(
                f"{path}: the renderer ended with code {run.returncode} ({last}); install libosmesa6 or ask for "
                "no picture"
            )


@dataclass(frozen=True)
class Aim:
    """Where a camera stands: middle of what it sees (3,), direction and up (3,), half the height of the picture, mm."""

    middle: Array
    direction: Array
    up: Array
    half_height: float
    depth: float


def aim(camera: Camera, box: Array) -> Aim:
    """The aim of a camera that sees the whole box (2, 3), or the box around its own focus, in a panel."""
    if camera.focus is not None:
        box = np.stack([camera.focus.min(axis=0), camera.focus.max(axis=0)])
    direction = np.array(camera.direction) / np.linalg.norm(camera.direction)
    right = np.cross(direction, camera.up)
    right /= np.linalg.norm(right)
    up = np.cross(right, direction)
    corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    seen = corners @ np.stack([right, up, direction], axis=1)
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle = np.stack([right, up, direction], axis=1) @ (0.5 * (low + high))
    aspect = PANEL_INCHES[0] / PANEL_INCHES[1]
    half = 0.5 * max(high[1] - low[1], (high[0] - low[0]) / aspect, 1e-6)
    return Aim(middle, direction, up, MARGIN * float(half), float(high[2] - low[2]))


def panel(view: View, target: Aim, hidden: Sequence[str] = ()) -> Array:
    """The picture (h, w, 3) of a view from one aim without the hidden parts, values from 0 to 255."""
    import pyvista
    from PIL import Image

    size = [round(FINER * PANEL_DPI * inches) for inches in PANEL_INCHES]
    plotter: Any = pyvista.Plotter(off_screen=True, window_size=size, lighting="light kit")
    plotter.set_background("white")
    for part in view.parts:
        if part.name not in hidden:
            _add(plotter, part, view.scale)
    eye = target.middle - (10.0 * target.half_height + 2.0 * target.depth) * target.direction
    plotter.camera_position = [tuple(eye), tuple(target.middle), tuple(target.up)]
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = target.half_height
    plotter.reset_camera_clipping_range()
    image = plotter.screenshot(return_img=True)
    plotter.close()
    small = (size[0] // FINER, size[1] // FINER)
    return np.asarray(Image.fromarray(image[..., :3]).resize(small, Image.Resampling.BOX))


def _add(plotter: Any, part: Surface | Lines, scale: Scale | None) -> None:
    mesh = _tubes(part) if isinstance(part, Lines) else _poly(part.points, part.triangles)
    values = part.values
    if isinstance(part, Lines) and values is not None:
        values = np.repeat(values, mesh.n_points // len(part.points))
    style: dict[str, Any] = {"smooth_shading": True, "ambient": 0.32, "diffuse": 0.75, "specular": 0.08}
    if isinstance(part, Surface):
        style |= {"opacity": part.opacity, "smooth_shading": part.is_smooth}
    if values is None or scale is None:
        is_lit = isinstance(part, Lines) or part.is_lit
        shade = {"ambient": 0.5, "diffuse": 0.65} if is_lit else {"ambient": 1.0, "diffuse": 0.0, "specular": 0.0}
        plotter.add_mesh(mesh, color=part.colour, **style | shade)
        return
    mesh.point_data["shown"] = scale.share(values).astype(np.float32)
    style |= {"above_color": scale.over} if scale.is_exceeded else {}
    plotter.add_mesh(mesh, scalars="shown", cmap=colour_map(scale), clim=(0.0, 1.0), show_scalar_bar=False, **style)


def _poly(points: Array, triangles: Any) -> Any:
    import pyvista

    faces = np.column_stack([np.full(len(triangles), 3), triangles]).ravel()
    return pyvista.PolyData(np.asarray(points, dtype=np.float32), faces)


AROUND = 8
"""Points around a tube."""


def _tubes(part: Lines) -> Any:
    """Tubes around lines: rings of points in planes normal to the line, carried along without twist."""
    n, k = part.points.shape[:2]
    along = np.gradient(part.points, axis=1) if k > 2 else np.repeat(np.diff(part.points, axis=1), k, axis=1)
    is_closed = np.linalg.norm(part.points[:, 0] - part.points[:, -1], axis=-1) < 1e-6 * part.radius
    along[is_closed, 0] = along[is_closed, -1] = (part.points[:, 1] - part.points[:, -2])[is_closed]
    along /= np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-300)
    spread = np.abs(along).sum(axis=1)
    first = np.eye(3)[np.argmin(spread, axis=1)][:, None]  # the axis that a line is least along
    e1 = np.cross(along, first)
    e1 /= np.maximum(np.linalg.norm(e1, axis=-1, keepdims=True), 1e-300)
    e2 = np.cross(along, e1)
    t = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)[:, None]
    points = part.points[:, :, None] + part.radius * (np.cos(t) * e1[:, :, None] + np.sin(t) * e2[:, :, None])
    here = np.arange(k - 1)[:, None] * AROUND + np.arange(AROUND)
    right = np.roll(here, -1, axis=1)
    one = np.concatenate(
        [np.stack([here, right, right + AROUND], -1), np.stack([here, right + AROUND, here + AROUND], -1)]
    )
    start = k * AROUND * np.arange(n)[:, None, None]
    return _poly(points.reshape(-1, 3), (one.reshape(1, -1, 3) + start).reshape(-1, 3))


def colour_map(scale: Scale) -> Any:
    """The colours of a scale for matplotlib, with that of values above its top."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("scale", scale.colours, N=256).with_extremes(over=scale.over)


def picture(view: View, aims: Sequence[Aim] | None = None) -> Figure:
    """All cameras of a view side by side, with title, bar of colours, legend and notes, as a matplotlib figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    aims = [aim(camera, view.box()) for camera in view.cameras] if aims is None else aims
    below = 1.35 if len(aims) > 1 else 2.0
    width, height = len(aims) * PANEL_INCHES[0], PANEL_INCHES[1] + below + 0.6
    figure = Figure(figsize=(width, height), dpi=PANEL_DPI)
    FigureCanvasAgg(figure)
    for i, (camera, target) in enumerate(zip(view.cameras, aims, strict=True)):
        ax = figure.add_axes((i / len(aims), below / height, 1.0 / len(aims), PANEL_INCHES[1] / height))
        ax.imshow(panel(view, target, camera.hides), interpolation="none", aspect="auto")
        ax.set_axis_off()
        if len(aims) > 1:
            ax.text(0.03, 0.97, camera.name, transform=ax.transAxes, fontsize=13, color="0.35", va="top")
    size = 16 if len(aims) > 1 else 12.5
    figure.text(0.5, 1.0 - 0.35 / height, view.title, ha="center", va="center", fontsize=size, linespacing=1.4)
    if view.scale is not None:
        _bar(figure, view.scale, (width, height), below)
    _legend(figure, view)
    for i, note in enumerate(reversed(view.notes)):
        figure.text(0.98, (0.10 + 0.22 * i) / height, note, ha="right", va="bottom", fontsize=11, color="0.35")
    return figure


def _bar(figure: Figure, scale: Scale, size: tuple[float, float], top: float) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    width, height = size
    ax = figure.add_axes((0.55 / width, (top - 0.63) / height, 5.2 / width, 0.2 / height))
    colours = colour_map(scale)
    extend = "max" if scale.is_exceeded else "neither"
    bar = figure.colorbar(ScalarMappable(Normalize(0.0, 1.0), colours), cax=ax, orientation="horizontal", extend=extend)
    values = scale.ticks()
    bar.set_ticks(scale.share(np.array(values)).tolist(), labels=scale.tick_labels())
    letters = 13 if width > PANEL_INCHES[0] else 11
    bar.ax.tick_params(labelsize=letters)
    above = f"; arrow: up to {scale.largest:.3g}" if scale.is_exceeded else ""
    figure.text(0.55 / width, (top - 0.33) / height, scale.label + above, fontsize=letters, va="bottom")


def _legend(figure: Figure, view: View) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    marks: list[Any] = []
    for part in view.parts:
        if not part.in_legend or (part.values is not None and view.scale is not None):
            continue
        if isinstance(part, Surface):
            marks.append(Patch(color=part.colour, label=part.name, alpha=part.opacity, lw=0))
        else:
            marks.append(Line2D([], [], color=part.colour, lw=4, label=part.name))
    if marks:
        is_wide = len(view.cameras) > 1
        columns = 2 if len(marks) < 7 or not is_wide else 3
        low = (0.1 + 0.22 * len(view.notes)) / figure.get_figheight()
        figure.legend(
            handles=marks, loc="lower right", bbox_to_anchor=(0.985, low), fontsize=13 if is_wide else 11,
            ncols=columns, frameon=False, borderaxespad=0.0, columnspacing=1.4, handlelength=1.4,
        )  # fmt: skip


def write_gif(path: str | os.PathLike[str], frames: Sequence[Array]) -> None:
    """Write pictures (h, w, 3) of one size, values from 0 to 255, as an animation that repeats; atomic."""
    from PIL import Image

    images = [Image.fromarray(np.asarray(frame, dtype=np.uint8)) for frame in frames]
    thinned = np.concatenate([np.asarray(frame, dtype=np.uint8)[::3, ::3] for frame in frames])
    palette = Image.fromarray(thinned).quantize(256, kmeans=2)  # one palette: colours do not flicker
    shown = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    times = [FRAME_MS] * (len(shown) - 1) + [LAST_MS]
    with atomic_path(path) as temporary:
        shown[0].save(temporary, "GIF", save_all=True, append_images=shown[1:], duration=times, loop=0, optimize=False)


def pixels(figure: Figure) -> Array:
    """The picture (h, w, 3) of a matplotlib figure, values from 0 to 255."""
    canvas: Any = figure.canvas
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _save(path: Path, views: Sequence[View]) -> None:
    from PIL import Image

    if path.suffix != ".gif":
        Image.fromarray(pixels(picture(views[0]))).save(path, "PNG", optimize=True)
        return
    boxes = np.stack([view.box() for view in views])
    box = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    aims = [aim(camera, box) for camera in views[0].cameras]
    write_gif(path, [pixels(picture(view, aims)) for view in views])


if __name__ == "__main__":
    _save(Path(sys.argv[1]), unpacked(sys.stdin.buffer.read()))
