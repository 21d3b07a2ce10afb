"""Plotters of pyvista as images: PNG and GIF beneath a title, with the bar of colours and a legend."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rve.common import atomic_path, tell
from rve.common.drawing.plane import Scale, as_typed
from rve.common.drawing.space import UNLISTED, new_plotter
from rve.common.optional import Figure, Plotter, PolyData

Draw = Callable[[Plotter], Plotter]
"""Draws into the active panel of a plotter, which it returns."""
FRAME_MS, LAST_MS = 120, 1500
"""How long a frame of an animation is shown, and its last one."""


def parts(plotter: Plotter, panel: int = 0) -> dict[str, tuple[PolyData, Any, Scale | None]]:
    """Mesh, actor and scale of colours of each part of a panel by its name."""
    found = plotter.renderers[panel].actors.items()
    return {name: (one.mapper.dataset, one, getattr(one, "colour_scale", None)) for name, one in found}


def compose(plotter: Plotter, title: str) -> Figure:
    """The panels of a plotter beneath a title, above a bar of colours and a legend, as a matplotlib figure."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    panels = len(plotter.renderers)
    figure = Figure(figsize=(6.8 * panels, 7.6), dpi=130)
    figure.set_layout_engine("constrained", h_pad=0.1)
    ax = figure.subplots()
    plotter.render()  # a screenshot alone shows what was last rendered
    ax.imshow(np.asarray(plotter.screenshot(return_img=True)), interpolation="antialiased")
    ax.set_axis_off()
    figure.suptitle(title, fontsize=15 if panels > 1 else 12, wrap=True)
    shown = {name: part for panel in range(panels) for name, part in parts(plotter, panel).items()}
    scales = {scale for *_, scale in shown.values() if scale is not None}
    for scale in scales:
        scale.add_bar(ax, location="bottom", shrink=0.5 if panels > 1 else 0.8, aspect=40, pad=0.01)
    plain = {name: one for name, (*one, scale) in shown.items() if scale is None and name not in UNLISTED}
    marks = [
        Line2D([], [], color=one.prop.color.float_rgb, lw=3 if mesh.n_lines else 9, solid_capstyle="butt")
        for mesh, one in plain.values()
    ]
    if marks:
        columns, unnamed = 4 if panels > 1 else 2, ["part"] * len(marks)  # a label that begins with "_" is left out
        legend = figure.legend(marks, unnamed, loc="outside lower center", ncols=columns, frameon=False, fontsize=11)
        for text, name in zip(legend.get_texts(), plain, strict=True):
            text.set_text(name)
    return as_typed(figure)


def save_picture(path: Path, plotter: Plotter, title: str) -> None:
    """Write the composed picture of a plotter as PNG, atomically."""
    tell(f"drawing {path.name}")
    figure = compose(plotter, title)
    plotter.close()
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png")


def save_panels(path: Path, views: Sequence[Draw], title: str) -> None:
    """Write views side by side beneath a title as PNG, atomically."""
    plotter = new_plotter(len(views))
    for panel, draw in enumerate(views):
        plotter.subplot(0, panel)
        draw(plotter)
    save_picture(path, plotter, title)


def in_turn(views: Iterable[tuple[str, Draw]]) -> Iterator[tuple[str, Plotter]]:
    """One plotter with each of the views, after the other, and its title."""
    plotter = new_plotter()
    for words, draw in views:
        yield words, draw(plotter)
        plotter.clear_actors()
    plotter.close()


def save_animation(path: Path, drawn: Iterable[tuple[str, Plotter]]) -> None:
    """Write what a plotter shows in turn, each beneath its title, as an animation (GIF) that repeats, atomically."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    tell(f"drawing {path.name}")
    frames = []
    for words, plotter in drawn:
        figure = compose(plotter, words)
        figure.set_dpi(100)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        frames.append(np.asarray(canvas.buffer_rgba())[..., :3])
    palette = Image.fromarray(np.concatenate([frame[::3, ::3] for frame in frames])).quantize(256, kmeans=2)
    first, *rest = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    times = [FRAME_MS] * len(rest) + [LAST_MS]
    with atomic_path(path) as temporary:
        first.save(temporary, "GIF", save_all=True, append_images=rest, duration=times, loop=0)
