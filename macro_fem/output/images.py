"""Plotters of pyvista as images: PNG and GIF beneath a title, with the bar of colours and a legend."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from math import ceil
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from rve.common import atomic_path, tell
from rve.common.drawing.plane import Scale, as_typed
from rve.common.drawing.space import UNLISTED, new_plotter
from rve.common.optional import Figure, Plotter, PolyData

Draw = Callable[[Plotter], Plotter]
"""Draws into the active panel of a plotter, which it returns."""
WIDTH, DPI = 6.3, 250
"""Of a picture, inches: 160 mm, at which its letters have 9 points or more; and pixels of an inch."""
FRAME_MS, LAST_MS = 120, 1500
"""How long a frame of an animation is shown, and its last one."""


def parts(plotter: Plotter, panel: int = 0) -> dict[str, tuple[PolyData, Any, Scale | None]]:
    """Mesh, actor and scale of colours of each part of a panel by its name."""
    found = plotter.renderers[panel].actors.items()
    return {name: (one.mapper.dataset, one, getattr(one, "colour_scale", None)) for name, one in found}


def compose(
    plotter: Plotter, title: str, captions: Sequence[str] = (), width: float = WIDTH, *, is_still: bool = True
) -> Figure:
    """The panels of a plotter in rows with their captions, beneath a title, above a bar of colours and a legend, as a
    figure of matplotlib of a width in inches, by default of a page, and as high as all this needs. is_still: what is
    white in all panels is cut off around them; images of an animation keep their size."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    panels = len(plotter.renderers)
    columns = -(-panels // 2) if 4 <= panels <= 8 else min(panels, 4)
    rows = -(-panels // columns)
    plotter.render()  # a screenshot alone shows what was last rendered
    images = np.stack(np.split(np.asarray(plotter.screenshot(return_img=True)), panels, axis=1))
    if is_still:
        is_seen = images.min(axis=3).min(axis=0) < 250
        (top, bottom), (left, right) = (_ends(is_seen.any(axis=axis)) for axis in (1, 0))
        images = images[:, top:bottom, left:right]
    shape = images.shape[1] / images.shape[2]
    shown = {name: part for panel in range(panels) for name, part in parts(plotter, panel).items()}
    plain = {name: one for name, (*one, scale) in shown.items() if scale is None and name not in UNLISTED}
    scales = {scale for *_, scale in shown.values() if scale is not None}
    if (lines := ceil(len(title) / (13.0 * width))) > 1 and "\n" not in title:  # of one length, that end at commas
        clauses = re.sub(r"(?<![,;:]) ", "\N{NO-BREAK SPACE}", title)
        title = fill(clauses, len(title) // lines + 9, break_long_words=False, break_on_hyphens=False)
    # Room of a name in a legend, inches.
    named = max(int(width / 3.0), 1)
    room = 0.6 * len(scales) + 0.2 * -(-len(plain) // named) + 0.25 * rows * bool(captions)
    room += 0.2 * title.count("\n") + (0.3 if title else 0.1)
    figure = Figure(figsize=(width, rows * width / columns * shape + room), dpi=DPI)
    figure.set_layout_engine("constrained", h_pad=0.04, w_pad=0.04)
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.flat:
        ax.set_axis_off()
    for ax, image in zip(axes.flat, images, strict=False):
        ax.imshow(image, interpolation="antialiased")
    for ax, caption in zip(axes.flat, captions, strict=False):
        ax.set_title(caption, fontsize=9)
    figure.suptitle(title, fontsize=10, wrap=True)
    for scale in scales:
        scale.add_bar(*axes.flat, location="bottom", shrink=0.7, aspect=40, pad=0.01)
    marks = [
        Line2D([], [], color=one.prop.color.float_rgb, lw=3 if mesh.n_lines else 9, solid_capstyle="butt")
        for mesh, one in plain.values()
    ]
    if marks:
        unnamed = ["part"] * len(marks)  # a label that begins with "_" is left out
        legend = figure.legend(marks, unnamed, loc="outside lower center", ncols=named, frameon=False, fontsize=9)
        for text, name in zip(legend.get_texts(), plain, strict=True):
            text.set_text(name)
    return as_typed(figure)


def _ends(is_seen: Any) -> tuple[int, int]:
    """The first and the last of the rows or columns that are seen, with a little room."""
    at, room = np.flatnonzero(is_seen), len(is_seen) // 100
    return (max(int(at[0]) - room, 0), int(at[-1]) + room + 1) if len(at) else (0, len(is_seen))


def save_picture(path: Path, plotter: Plotter, title: str, captions: Sequence[str] = ()) -> None:
    """Write the composed picture of a plotter as PNG, atomically."""
    tell(f"drawing {path.name}")
    figure = compose(plotter, title, captions)
    plotter.close()
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png")


def save_view(path: Path, plotter: Plotter) -> None:
    """Write what a plotter shows as PNG, atomically, without what is white around it."""
    from PIL import Image

    image = np.asarray(plotter.screenshot(return_img=True))
    plotter.close()
    is_seen = image.min(axis=2) < 250
    (top, bottom), (left, right) = (_ends(is_seen.any(axis=axis)) for axis in (1, 0))
    with atomic_path(path) as temporary:
        Image.fromarray(image[top:bottom, left:right]).save(temporary, "PNG")


def save_panels(path: Path, views: Sequence[Draw], title: str, captions: Sequence[str] = ()) -> None:
    """Write views as panels with their captions beneath a title as PNG, atomically."""
    plotter = new_plotter(len(views))
    for panel, draw in enumerate(views):
        plotter.subplot(0, panel)
        draw(plotter)
    save_picture(path, plotter, title, captions)


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
        figure = compose(plotter, words, is_still=False)
        figure.set_dpi(130)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        frames.append(np.asarray(canvas.buffer_rgba())[..., :3])
    palette = Image.fromarray(np.concatenate([frame[::3, ::3] for frame in frames])).quantize(256, kmeans=2)
    first, *rest = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    times = [FRAME_MS] * len(rest) + [LAST_MS]
    with atomic_path(path) as temporary:
        first.save(temporary, "GIF", save_all=True, append_images=rest, duration=times, loop=0)
